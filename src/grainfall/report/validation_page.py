"""The validation page: the paper's figures and ours side by side, for a reader who does not believe us."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
import yaml
from jinja2 import Environment, PackageLoader

from grainfall import __version__, io
from grainfall.report.claims import claims
from grainfall.report.html import data_uri, shown_uri
from grainfall.report.numbers import number
from grainfall.report.paper_figures import FIGURES
from grainfall.report.texts import case_names, cases_in_words
from grainfall.report.validation import describe

_BENCHMARKS = Path(__file__).with_name("templates") / "benchmarks.yaml"


def benchmarks_in_words() -> dict[str, dict]:
    """Of each benchmark that the page shows: title, done, command, columns (heading to column, or to those of
    a mean and the ends of its interval)."""
    return yaml.safe_load(_BENCHMARKS.read_text(encoding="utf-8"))


def build_validation(
    results: str | Path,
    table: pd.DataFrame,
    out: str | Path,
    drawn: Mapping[str, Path],
    left_out: Sequence[str] = (),
) -> None:
    """Write the page as one HTML file that needs nothing else.

    Parameters
    ----------
    results : path
        The tables of benchmarks that lie in it are shown, too.
    table : DataFrame
        As :func:`grainfall.report.validation.validation_table` gives it.
    out : path
    drawn : mapping
        Figure name to its SVG file; those that are missing, or but a note, are said to be.
    left_out : sequence of str
        What the table is without, and why.
    """
    environment = Environment(
        loader=PackageLoader("grainfall.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = number
    environment.filters["words"] = lambda text: str(text).replace("_", " ")
    every = claims(table)
    parts = []
    words = cases_in_words()
    for case, said in words.items():
        rows = table[table["case"] == case]
        if rows.empty:
            continue
        parts.append(
            {
                "case": case,
                **said,
                "claims": [c for c in every if c.case == case],
                "rows": [_row(r) for r in rows.to_dict("records")],
                "figures": [_figure(name, drawn.get(name), f"make case-{case}") for name in said["figures"]],
            }
        )
    page = environment.get_template("validation.html.j2").render(
        parts=parts,
        benchmarks=_benchmarks(Path(results) / "benchmarks"),
        shown={part["case"] for part in parts},
        claims=every,
        names={case: name.replace(" ", "\u00a0", 1) for case, name in case_names().items()},
        overview=_figure("permeability", drawn.get("permeability"), "make cases"),
        version=__version__,
        twins=_twins(Path(results)),
        left_out=left_out,
        missing=[said["title"] for case, said in words.items() if case not in set(table["case"])],
    )
    io.write_text(out, page)


def _row(row: Mapping) -> dict:
    known = describe(row["quantity"])
    interval = "" if math.isnan(row["lower"]) else f"{number(row['lower'])} to {number(row['upper'])}"
    cells = {k: number(row[k], 4) for k in ("paper", "truth", "mean")}
    if row["variant"] == "truth" and row["truth"] == row["mean"]:
        cells["truth"] = ""
    return {
        **row,
        **cells,
        "label": known.label,
        "unit": "" if known.unit == "1" else known.unit,
        "interval": interval,
    }


def _benchmarks(folder: Path) -> list[dict]:
    found = []
    for name, said in benchmarks_in_words().items():
        table, drawn = folder / f"{name}.csv", folder / f"{name}.svg"
        if table.exists():
            rows = io.read_table(table).to_dict("records")
            cells = [[_cell(row, columns) for columns in said["columns"].values()] for row in rows]
            image = data_uri(drawn) if drawn.exists() else None
            found.append({"name": name, **said, "rows": cells, "image": image})
    return found


def _cell(row: Mapping, columns: str | list[str]) -> str:
    """A value, with its interval where there is one; nothing where it was not measured."""
    value, *ends = (row.get(c) for c in ([columns] if isinstance(columns, str) else columns))
    if isinstance(value, str):
        return value.replace("_", " ")
    lower, upper = map(number, ends or (None, None))
    return number(value) + (f" ({lower}\u00a0to\u00a0{upper})" if lower else "")


def _figure(name: str, path: Path | None, command: str) -> dict:
    entry = FIGURES[name]
    image = None if path is None else shown_uri(path)
    return {"name": name, "caption": entry.caption, "paper": entry.paper, "image": image, "command": command}


def _twins(root: Path) -> int:
    return len(list(root.glob("*/*/*/metrics.csv")))
