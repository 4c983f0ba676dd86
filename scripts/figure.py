"""One figure of one twin, as vector and as PNG."""

from _stage import stage

from grainfall import report

with stage(snakemake):
    origin = snakemake.wildcards
    figure = report.figure_files("results", origin.sample, origin.variant, int(origin.realization))[
        origin.figure
    ]
    for path in snakemake.output:
        figure.save(path)
