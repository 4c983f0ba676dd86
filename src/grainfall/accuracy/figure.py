"""Error against cost of every setting on one page, the Pareto fronts marked."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from grainfall.accuracy.table import PACKING, TWIN
from grainfall.presets import METRICS
from grainfall.report.figures import (
    FIRST,
    MINERALS,
    PORE_CIRCLE,
    SECTION,
    TRUTH,
    WIDTH,
    styled,
)
from grainfall.report.figures import (
    TWIN as TWIN_COLOUR,
)

CHANCE = "chance"

KNOB_LOOKS: dict[str, tuple[str, str]] = {
    "base": (SECTION, "*"),
    "time_step": (MINERALS[0], "o"),
    "solver_iterations": (FIRST, "s"),
    "hull_vertices": (TWIN_COLOUR, "^"),
    "contact_points": (TRUTH, "D"),
    "collision_shape": (MINERALS[1], "v"),
    "engine": (PORE_CIRCLE, "P"),
    "together": (MINERALS[2], "X"),
}
"""Colour and marker of the packing's knobs; others are grey circles."""

METRIC_LOOKS: dict[str, tuple[str, str]] = {
    "porosity": (MINERALS[0], "o"),
    "pore_sizes": (MINERALS[1], "s"),
    "s2": (TRUTH, "^"),
    "k": (TWIN_COLOUR, "D"),
    "coordination": (FIRST, "v"),
    "overlap": (PORE_CIRCLE, "P"),
    "grain_sizes": (SECTION, "X"),
}
"""Colour and marker of the metrics where they share a panel."""

TITLES = {
    "flow_tier": "flow tier",
    "network_method": "pore network",
    "voxels_per_grain": "voxels across a grain",
    "coarsen": "voxels joined before the network",
    "grains_across": "grains across the box",
    "realizations": "realizations",
    "slices": "slices behind S₂",
    "stereology_rule": "stereology: rule and bins",
    "sections": "sections behind the sizes",
}
PER_ROW = 3


@styled
def accuracy_figure(table: pd.DataFrame, sweep: Mapping) -> Figure:
    """The page.

    Parameters
    ----------
    table : DataFrame
        results/accuracy/accuracy.csv.
    sweep : mapping
        The config's ``accuracy_sweep``.

    Returns
    -------
    Figure
        A panel a metric for the packing and for the presets, a panel a knob for the analysis.
    """
    table = table[table["cpu_s"].notna()]
    packing, presets = (table[table["scene"] == scene] for scene in (PACKING, TWIN))
    known = [knob for knob in sweep["known"] if (table["scene"] == knob).any()]
    blocks = [
        (f"Packing: first packings against {sweep['against']}", _metrics(packing), packing, _packing_panel),
        ("Presets: whole twins against the 3D truth", _metrics(presets), presets, _preset_panel),
        ("Analysis: volumes and sections of known truth", known, table, _known_panel),
    ]
    blocks = [block for block in blocks if block[1]]
    rows = [-(-len(panels) // PER_ROW) for _, panels, _, _ in blocks]
    figure = Figure(figsize=(WIDTH, 1.75 * sum(rows) + 0.45 * len(rows)))
    parts = np.atleast_1d(figure.subfigures(len(blocks), 1, height_ratios=[n + 0.3 for n in rows]))
    for part, n, (title, panels, found, draw) in zip(parts, rows, blocks, strict=True):
        part.suptitle(title, fontsize=10, fontweight="bold", x=0.01, ha="left")
        axes = part.subplots(n, PER_ROW, squeeze=False)
        for axis, name in zip(axes.flat, panels, strict=False):
            draw(axis, found, name)
            axis.set_xscale("log")
            _plain_ticks(axis.xaxis)
            axis.tick_params(labelsize=7)
        for axis in list(axes.flat)[len(panels) :]:
            axis.set_axis_off()
        for axis in axes[-1]:
            axis.set_xlabel("CPU time, s", fontsize=8)
        if draw is not _preset_panel:
            _legend(part, panels, found, draw)
    return figure


def _metrics(rows: pd.DataFrame) -> list[str]:
    return [name for name in METRICS if (rows["metric"] == name).any()]


def _legend(part, panels: list[str], found: pd.DataFrame, draw) -> None:
    if draw is _packing_panel:
        looks = {k: look for k, look in KNOB_LOOKS.items() if (found["knob"] == k).any()}
        words = {k: k.replace("_", " ") for k in looks}
    else:
        used = set(found[found["scene"].isin(panels)]["metric"])
        looks = {k: look for k, look in METRIC_LOOKS.items() if k in used}
        words = {k: METRICS[k].label for k in looks}
    handles = [
        Line2D([], [], ls="", marker=marker, ms=4.5, color=colour, label=words[k])
        for k, (colour, marker) in looks.items()
    ]
    handles.append(Line2D([], [], ls="-", lw=1, color="#888888", marker="o", ms=4.5, label="on the front"))
    handles.append(Line2D([], [], ls="", marker="o", ms=4.5, mfc="white", mec="#888888", label="dominated"))
    if draw is _packing_panel:
        handles.append(Line2D([], [], ls="--", lw=0.8, color="#999999", label="chance: the same again"))
    if found["error"].isna().any():
        handles.append(Line2D([], [], ls=":", lw=0.8, color="#999999", label="cost of the finest"))
    part.legend(
        handles=handles, loc="outside lower center", ncols=5, fontsize=7, handletextpad=0.2, columnspacing=1
    )


def _points(axis, rows: pd.DataFrame, look, floor: float | None = None, label=None, line="#888888") -> None:
    """Markers with their intervals, filled on the front, and the front's steps."""
    for cost in rows.loc[rows["error"].isna(), "cpu_s"]:  # of what the others are held against
        axis.axvline(cost, color="#999999", lw=0.8, ls=":", zorder=0)
    rows = rows[rows["error"].notna()]
    for row in rows.itertuples():
        colour, marker = look(row)
        low = row.lower if floor is None else max(row.lower, floor)
        if np.isfinite(row.upper):
            axis.plot(
                [row.cpu_s] * 2, [min(low, row.error), row.upper], color=colour, lw=0.7, alpha=0.6, zorder=1
            )
        axis.plot(
            row.cpu_s, row.error, marker=marker, ms=5, color=colour, mfc=colour if row.front else "white",
            mew=0.9, zorder=3,
        )  # fmt: skip
        if label and row.front:
            axis.annotate(
                label(row), (row.cpu_s, row.error), (3, 3), textcoords="offset points", fontsize=5.5, zorder=4
            )
    chosen = rows[rows["front"]].sort_values("cpu_s")
    axis.plot(chosen["cpu_s"], chosen["error"], drawstyle="steps-post", color=line, lw=0.9, zorder=2)


def _packing_panel(axis, table: pd.DataFrame, metric: str) -> None:
    rows = table[table["metric"] == metric]
    chance, rows = rows[rows["knob"] == CHANCE], rows[rows["knob"] != CHANCE]
    for row in chance.itertuples():
        if metric != "overlap":
            axis.axhline(row.error, color="#999999", lw=0.8, ls="--", zorder=0)
    grey = ("#777777", "o")
    _points(axis, rows, lambda row: KNOB_LOOKS.get(row.knob, grey), label=_setting)
    _from_zero(axis, 1.25 * pd.concat([rows["error"], chance["error"]]).max())
    axis.set_title(METRICS[metric].label, fontsize=8)
    axis.set_ylabel(_error(metric), fontsize=7)


def _from_zero(axis, top: float) -> None:
    """An axis from 0; where nothing has an error yet, its end is anywhere."""
    axis.set_ylim(0, top if top > 0 else None)


def _preset_panel(axis, table: pd.DataFrame, metric: str) -> None:
    rows = table[table["metric"] == metric]
    _points(axis, rows, lambda row: (TWIN_COLOUR, "o"))
    for row in rows.itertuples():
        axis.annotate(row.setting, (row.cpu_s, row.error), (4, 4), textcoords="offset points", fontsize=6.5)
    _from_zero(axis, 1.1 * rows[["error", "upper"]].max(axis=None))
    axis.margins(x=0.3)
    axis.set_title(METRICS[metric].label, fontsize=8)
    axis.set_ylabel(_error(metric), fontsize=7)


def _known_panel(axis, table: pd.DataFrame, knob: str) -> None:
    axis.set_title(TITLES[knob], fontsize=8)
    rows = table[(table["scene"] == knob) & ~(table["error"] <= 0)]
    if rows["error"].isna().all():
        axis.text(0.5, 0.5, "no setting is off", transform=axis.transAxes, ha="center", fontsize=7)
        return
    floor = 0.5 * rows["error"].min()
    for metric in _metrics(rows):
        own = rows[rows["metric"] == metric]
        first = metric == _metrics(rows)[0]
        look = METRIC_LOOKS[metric]
        _points(axis, own, lambda row, look=look: look, floor, _setting if first else None, look[0])
    axis.set_yscale("log")
    _plain_ticks(axis.yaxis)
    axis.set_ylim(floor, 2 * rows["error"].max())
    axis.set_ylabel("error", fontsize=7)


def _plain_ticks(axis) -> None:
    """1, 2 and 5 on a logarithmic axis, as plain numbers: the house's style reads no formulas."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1,) if high > 30 * low else (1, 2, 5), numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _setting(row) -> str:
    return str(row.setting).replace("_", " ")


def _error(metric: str) -> str:
    return (
        METRICS[metric]
        .error.replace(" over the mean radius", " / mean r")
        .replace("Wasserstein distance", "W₁")
    )
