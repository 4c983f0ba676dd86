"""The paper's figures from our cases as SVG, PDF and PNG; a sentence where there is nothing to draw yet."""

from pathlib import Path

from _stage import results_folder, stage

from grainfall.report import save_figure
from grainfall.report.figures import note_figure
from grainfall.report.paper_figures import FIGURES, Cases

with stage(snakemake) as progress:
    cases = Cases(
        Path(results_folder(snakemake)),
        {case: study["samples"] for case, study in snakemake.params.cases.items()},
    )
    figures = {}
    for name, entry in FIGURES.items():
        progress(name)
        figures[name] = entry.draw(cases) or note_figure(
            f"{name.replace('_', ' ')}: what this figure shows is not among the results"
        )
    for path in map(Path, snakemake.output):
        save_figure(figures[path.stem], path)
