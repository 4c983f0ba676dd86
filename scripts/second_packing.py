"""Second packing: grains and virtual spheres, until the porosity without the spheres is the target's."""

from _stage import stage

from grainfall import grains, io, packing, random, stereology, volume

with stage(snakemake) as progress:
    files, settings = snakemake.input, snakemake.params.settings
    scene = io.read_json(files.scene)
    sizes = stereology.from_table(io.read_table(files.sizes))
    library = grains.Library.load(files.library)
    spheres = packing.VirtualSizes.from_table(io.read_table(files.spheres))
    setting = settings["packing"]
    parameters = packing.Parameters.named(
        setting["parameters"], engine=setting["engine"], **setting["overrides"]
    )

    def pack_with(p_sphere):
        rng = random.generator(**snakemake.params.stream, chapter="packing/second")
        progress.say(f"second packing with a sphere probability of {p_sphere:.4f}")
        return packing.pack(
            scene, sizes, library, parameters, rng, spheres=spheres, p_sphere=p_sphere, progress=progress
        )

    def porosity_of(bodies):
        phase, _ = volume.voxelise(bodies, library, scene["shape_zyx"], scene["voxel_size_um"])
        progress.say(f"porosity {volume.porosity(phase):.4f}, target {scene['porosity_target']:.4f}")
        return volume.porosity(phase)

    bodies, report = packing.pack_again(
        io.read_json(files.plan),
        pack_with,
        porosity_of,
        (io.read_table(files.first), io.read_json(files.first_report)),
        tolerance=settings["correction"]["limit"],
        passes=settings["virtual_spheres"]["passes"],
    )
    io.write_table(snakemake.output.bodies, bodies)
    io.write_json(snakemake.output.packing, report)
