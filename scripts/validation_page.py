"""The validation page."""

from pathlib import Path

from _stage import stage

from grainfall.report.validation import validation_table
from grainfall.report.validation_page import build_validation

with stage(snakemake):
    table, left_out = validation_table("results", snakemake.params.cases)
    build_validation(
        "results",
        table,
        snakemake.output.page,
        {Path(path).stem: Path(path) for path in snakemake.input.figures},
        left_out,
    )
