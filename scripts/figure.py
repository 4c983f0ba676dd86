"""One figure of a sample or of one twin, as vector and as PNG."""

from _stage import results_folder, stage

from grainfall import report

with stage(snakemake):
    origin = snakemake.wildcards
    of_twin = (origin.variant, int(origin.realization)) if hasattr(origin, "variant") else ()
    figure = report.figure_files(results_folder(snakemake), origin.sample, *of_twin)[origin.figure]
    for path in snakemake.output:
        figure.save(path)
