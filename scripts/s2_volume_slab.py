"""Pairs of the solid in a slab, by lag."""

from _stage import part, stage

from grainfall import correlation, io

with stage(snakemake), io.open_volume(snakemake.input.volume) as (phase, _):
    which, of = part(snakemake.wildcards)
    io.write_arrays(snakemake.output.counts, correlation.pair_counts(phase, part=which, parts=of))
