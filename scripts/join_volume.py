"""Slabs of a volume joined into its file."""

from _stage import stage

from grainfall import io

with stage(snakemake):
    io.join_volumes(snakemake.output.volume, snakemake.input.slabs)
