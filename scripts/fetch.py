"""A published file, checked and kept."""

from _stage import stage

from grainfall.section import keep_published

with stage(snakemake):
    keep_published(snakemake.input.published, snakemake.params.known["files"], snakemake.output.kept)
