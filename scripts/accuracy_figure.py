"""Error against cost, on one page."""

from _stage import stage

from grainfall import io
from grainfall.accuracy.figure import accuracy_figure
from grainfall.report import save_figure

with stage(snakemake):
    figure = accuracy_figure(io.read_table(snakemake.input.table), snakemake.params.sweep)
    for path in snakemake.output:
        save_figure(figure, path)
