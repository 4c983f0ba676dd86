"""First packing: reconstructed grains alone, poured under gravity."""

from _stage import stage

from grainfall import grains, io, packing, random, stereology

with stage(snakemake) as progress:
    scene = io.read_json(snakemake.input.scene)
    setting = snakemake.params.settings["packing"]
    bodies, report = packing.pack(
        scene,
        stereology.from_table(io.read_table(snakemake.input.sizes)),
        grains.Library.load(snakemake.input.library),
        packing.Parameters.named(setting["parameters"], engine=setting["engine"], **setting["overrides"]),
        random.generator(**snakemake.params.stream, chapter="packing/first"),
        progress=progress,
    )
    io.write_table(snakemake.output.bodies, bodies)
    io.write_json(snakemake.output.packing, report)
