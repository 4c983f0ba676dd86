"""S2 of this chunk's share of the random slices; every chunking gives the same rows."""

from _stage import part, stage

from grainfall import correlation, io, random

with stage(snakemake), io.open_volume(snakemake.input.volume) as (phase, attributes):
    n = snakemake.params.settings["correlation"]["slices"]
    drawn = random.slices(
        random.generator(**snakemake.params.stream, chapter="correlation/slices"), phase.shape, n
    )
    first, last = io.share(len(drawn), *part(snakemake.wildcards))
    io.write_table(
        snakemake.output.s2,
        correlation.s2_of_slices(phase, drawn[first:last], attributes["voxel_size_um"], start=first),
    )
