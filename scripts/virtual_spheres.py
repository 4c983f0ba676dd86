"""Virtual spheres: pore circles of the section against those of the first packing."""

from _stage import stage

from grainfall import io, morphology, packing, random, stereology

with stage(snakemake) as progress:
    files, settings = snakemake.input, snakemake.params.settings
    scene = io.read_json(files.scene)
    phase, attributes = io.read_volume(files.volume, "phase")
    rng = random.generator(**snakemake.params.stream, chapter="packing/slices")
    _, pores = morphology.measure_slices(
        phase,
        attributes["voxel_size_um"],
        random.slices(rng, phase.shape, settings["correlation"]["slices"]),
        **settings["morphology"],
    )
    target, first = (
        stereology.unfold_table(table, method=settings["stereology"]["method"], bootstrap=0)
        for table in (io.read_table(files.section_pores), pores)
    )
    sizes, plan = packing.plan_spheres(
        scene,
        target,
        first,
        float((phase == 0).mean()),
        sum(p * v for p, v in zip(scene["probabilities"], scene["mean_volumes_um3"], strict=True)),
        enabled=settings["virtual_spheres"]["enabled"] == "auto",
        limit=settings["correction"]["limit"],
    )
    io.write_table(snakemake.output.pores, pores)
    io.write_table(snakemake.output.sizes, sizes.to_table())
    io.write_json(snakemake.output.plan, plan)
    progress.say(("spheres: " if plan["called_for"] else "no spheres: ") + plan["reason"])
