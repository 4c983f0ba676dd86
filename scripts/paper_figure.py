"""One figure of the paper from our cases as SVG, PDF and PNG; a sentence where there is nothing to draw."""

from pathlib import Path

from _stage import stage

from grainfall.report import save_figure
from grainfall.report.figures import note_figure
from grainfall.report.paper_figures import FIGURES, Cases

with stage(snakemake):
    name = snakemake.wildcards.paper_figure
    figure = FIGURES[name].draw(
        Cases(Path("results"), {case: study["samples"] for case, study in snakemake.params.cases.items()})
    )
    if figure is None:
        figure = note_figure(
            f"{name.replace('_', ' ')}: the case behind this figure has no finished twin yet"
        )
    for path in snakemake.output:
        save_figure(figure, path)
