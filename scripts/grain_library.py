"""3D grains, each from three masks of one size class and mineral."""

from _stage import stage

from grainfall import grains, io, random

with stage(snakemake) as progress:
    labels, _ = io.read_volume(snakemake.input.labels, "grains")
    library = grains.build_library(
        labels,
        io.read_table(snakemake.input.grains),
        rng=random.generator(**snakemake.params.stream, chapter="grains"),
        progress=progress,
        **snakemake.params.settings["grains"],
    )
    library.save(snakemake.output.library)
    progress.say(f"{len(library.table)} shapes")
