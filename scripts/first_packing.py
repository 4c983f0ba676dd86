"""First packing: reconstructed grains alone, poured under gravity."""

from _stage import resumable_stage

from grainfall import grains, io, packing, random, stereology

with resumable_stage(snakemake) as (progress, checkpoints):
    scene = io.read_json(snakemake.input.scene)
    sizes = stereology.from_table(io.read_table(snakemake.input.sizes))
    library = grains.Library.load(snakemake.input.library)
    settings = snakemake.params.settings

    def pack_with(parameters):
        rng = random.generator(**snakemake.params.stream, chapter="packing/first")
        return packing.pack(
            scene, sizes, library, parameters, rng, progress=progress, checkpoints=checkpoints
        )

    bodies, report = packing.pack_first(
        pack_with,
        packing.parameters_of(settings["packing"], settings["effects"]),
        settings["effects"]["refinement"],
        progress,
    )
    io.write_table(snakemake.output.bodies, bodies)
    io.write_table(snakemake.output.forces, report.pop("forces"))
    io.write_json(snakemake.output.packing, report)
