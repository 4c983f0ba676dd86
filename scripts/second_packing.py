"""Second packing: virtual spheres and denser beds, until the porosity without the spheres is the target's."""

from _stage import resumable_stage

from grainfall import grains, io, packing, random, stereology, volume

with resumable_stage(snakemake) as (progress, checkpoints):
    files, settings = snakemake.input, snakemake.params.settings
    scene, deficit = io.read_json(files.scene), io.read_json(files.deficit)
    sizes = stereology.from_table(io.read_table(files.sizes))
    library = grains.Library.load(files.library)
    spheres = packing.VirtualSizes.from_table(io.read_table(files.spheres))
    first_report = io.read_json(files.first_report) | {"forces": io.read_table(files.first_forces)}
    parameters = packing.parameters_of(settings["packing"], settings["effects"])
    if first_report["refinement"]["on"]:
        parameters = parameters.refined()

    shaped = deficit["void_shapes"]["on"]
    void_scale = 1.0

    def pour_with(p_sphere, lubrication):
        progress.say(f"sphere probability {p_sphere:.4f}, friction times {lubrication:.3g}")
        return packing.pack(
            scene,
            sizes,
            library,
            parameters.lubricated(lubrication),
            # numbers of the first packing where only the friction differs: a paired comparison
            random.generator(
                **snakemake.params.stream, chapter="packing/second" if p_sphere else "packing/first"
            ),
            spheres=spheres,
            p_sphere=p_sphere,
            void_shapes=shaped,
            void_scale=void_scale,
            rest=False,
            progress=progress,
            checkpoints=checkpoints,
        )

    def rested(poured, lubrication, taps):
        if taps:
            progress.say(f"{taps} taps")
        return packing.let_rest(
            poured, scene, library, parameters.lubricated(lubrication), taps, progress=progress
        )

    def porosity_of(bodies):
        porosity = volume.packed_porosity(bodies, library, scene["shape_zyx"], scene["voxel_size_um"])
        if (bodies["kind"] == "grain").all():
            progress.say(f"porosity {porosity:.4f}, wanted {deficit['overgrowth']['porosity']:.4f}")
        else:
            progress.say(f"porosity {porosity:.4f} beside grains and virtual bodies")
        return porosity

    def place_of(bodies, aim):
        porosity = volume.porosity_about(
            bodies, library, scene["shape_zyx"], scene["voxel_size_um"], packing.reach_voxels(scene)
        )
        place = packing.nearest_place(porosity, aim, scene["voxel_size_um"])
        progress.say(f"porosity {place.porosity:.4f} with the region moved by {place.moved_um} µm")
        return place

    def between_of(bodies):
        held = deficit["between"]
        if held is None:
            return None
        found = volume.bed_between_voids(bodies, library, scene, held["radius_um"])
        if found is None:
            return None
        progress.say(f"porosity between voids {found.porosity:.4f}, wanted {held['wanted']:.4f}")
        return found.porosity

    voids = None
    if shaped:
        voids = packing.size_voids(
            deficit,
            lambda p_sphere: pour_with(p_sphere, 1.0),
            lambda bodies: volume.void_width(bodies, library, scene["shape_zyx"], scene["voxel_size_um"]),
            lambda scale: packing.mean_void_volume(spheres, library, scale),
            porosity_of,
            between_of,
        )
        void_scale = voids["scale"]
        deficit["virtual_spheres"]["p_sp"] = voids["p_sp"]
        progress.say(f"voids as wide as their spheres at {void_scale:.3f} times their radii")
    bodies, report = packing.pack_again(
        deficit,
        pour_with,
        rested,
        porosity_of,
        (io.read_table(files.first), first_report),
        between_of,
        voids=voids,
        place_of=place_of,
        densification=settings["effects"]["densification"],
        placement=settings["effects"]["placement"],
        **settings["feedback"],
    )
    io.write_table(snakemake.output.bodies, bodies)
    io.write_table(snakemake.output.forces, report.pop("forces"))
    io.write_json(snakemake.output.packing, {**report, "voids": voids})
