"""Error against cost, on one page."""

from _stage import stage

from grainfall import io
from grainfall.accuracy.figure import accuracy_figure
from grainfall.report import save_figure
from grainfall.report.figures import note_figure

with stage(snakemake):
    table = io.read_table(snakemake.input.table)
    if len(table):
        figure = accuracy_figure(table, snakemake.params.sweep)
    else:
        figure = note_figure("nothing of the sweep is measured yet")
    for path in snakemake.output:
        save_figure(figure, path)
