"""Parameters of a sweep beside what came of them."""

from _stage import stage

from grainfall import io, report

with stage(snakemake):
    summary = io.read_table(snakemake.input.summary)
    io.write_table(snakemake.output[0], report.sweep_table(summary, snakemake.params.parameters))
