"""What the first packing lacks of the section, pores of which sizes, and what surface it has too much."""

from _stage import stage

from grainfall import grains, io, morphology, packing, random, stereology, volume
from grainfall.section import resample
from grainfall.surface import SolidSurface, core, solid_surface

with stage(snakemake) as progress:
    files, settings = snakemake.input, snakemake.params.settings
    scene = io.read_json(files.scene)
    phase, attributes = io.read_volume(files.volume, "phase")
    porosity = float((phase == 0).mean())
    resolution = scene["resolution_um"]
    phase = resample(phase, attributes["voxel_size_um"], resolution)
    section_pores = io.read_table(files.section_pores)
    _, pores = morphology.measure_slices(
        phase,
        resolution,
        random.slices(
            random.generator(**snakemake.params.stream, chapter="packing/slices"),
            phase.shape,
            settings["correlation"]["slices"],
        ),
        **settings["morphology"],
    )
    particle, shaped = stereology.SPHERE, settings["effects"]["void_shapes"]
    if shaped != "off":
        particle = stereology.particle_of(io.read_arrays(files.circles)["radii"])
    target, first = (
        stereology.unfold_table(table, **settings["stereology"], particle=particle)
        for table in (section_pores, pores)
    )
    between = io.read_json(files.section_intergranular)
    surface = SolidSurface(**io.read_json(files.section_surface))
    bed = core(phase)
    sizes, deficit = packing.plan_deficit(
        scene,
        target,
        first,
        packing.pore_tail(
            section_pores,
            pores,
            scene["porosity_target"],
            porosity,
            random.generator(**snakemake.params.stream, chapter="packing/tail"),
        ),
        packing.Overgrowth(
            surface,
            solid_surface(bed, resolution),
            volume.fill_to_surface(bed, resolution, surface.per_um),
        ),
        porosity,
        sum(p * v for p, v in zip(scene["probabilities"], scene["mean_volumes_um3"], strict=True)),
        voids=int((grains.Library.load(files.library).table["phase"] == grains.VOID).sum()),
        between=morphology.Intergranular(**between) if between else None,
        switch=settings["effects"]["virtual_spheres"],
        cement=settings["effects"]["cement"],
        void_shapes=shaped,
        limit=settings["feedback"]["limit"],
    )
    io.write_table(snakemake.output.pores, pores)
    io.write_table(snakemake.output.sizes, sizes.to_table())
    io.write_json(snakemake.output.deficit, deficit)
    spheres = deficit["virtual_spheres"]
    progress.say(("spheres: " if spheres["on"] else "no spheres: ") + spheres["reason"])
    rims = deficit["overgrowth"]
    progress.say(("rims: " if rims["on"] else "no rims: ") + rims["reason"])
