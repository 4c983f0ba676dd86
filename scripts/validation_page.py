"""The validation page."""

from pathlib import Path

from _stage import results_folder, stage

from grainfall import io
from grainfall.report.validation_page import build_validation

with stage(snakemake):
    build_validation(
        results_folder(snakemake),
        io.read_table(snakemake.input.table),
        snakemake.output.page,
        {Path(path).stem: Path(path) for path in snakemake.input.figures},
        io.read_json(snakemake.input.left_out),
    )
