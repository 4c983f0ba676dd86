"""Error against cost of every setting on one page, the Pareto fronts marked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from grainfall.accuracy.observe import DISTANCES
from grainfall.accuracy.table import CHANCE, PACKING, TWIN, beyond_chance
from grainfall.presets import METRICS
from grainfall.report.figures import FIRST, MINERALS, PORE_CIRCLE, SECTION, TRUTH, WIDTH, styled
from grainfall.report.figures import TWIN as TWIN_COLOUR

GREY = "#999999"

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

PANEL_POINTS = 130.0, 60.0
"""Width and height of one of three panels in a row, about."""

PRESET_MARKERS = ("o", "s", "^", "D", "v", "P")

TITLES = {
    "flow_tier": "flow tier",
    "network_method": "pore network",
    "voxels_per_grain": "voxels across a grain",
    "coarsen": "voxels joined first",
    "grains_across": "grains across the box",
    "realizations": "realizations",
    "slices": "slices behind S₂",
    "stereology_rule": "stereology: rule, bins",
    "sections": "grains on the section",
}
"""Of the knobs of the analysis."""


@dataclass(frozen=True)
class Block:
    """A part of the page: panels that are drawn alike, and what their marks mean."""

    title: str
    panels: list[str]
    rows: pd.DataFrame
    across: int
    draw: Callable
    marks: Callable[[pd.DataFrame], list[Line2D]]

    @property
    def n_rows(self) -> int:
        return -(-len(self.panels) // self.across)


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
        A panel per metric for the packing and for the presets, one per knob for the analysis.
    """
    table = table[table["cpu_s"].notna()]
    packing, presets = (table[table["scene"] == scene] for scene in (PACKING, TWIN))
    known = [knob for knob in sweep["known"] if (table["scene"] == knob).any()]
    analysis = table[table["scene"].isin(known)]
    against = sweep["against"]
    blocks = [
        Block(
            f"Packing: first packings against {against}; bars are 95 % intervals",
            _metrics(packing),
            packing,
            3,
            _packing_panel,
            _packing_marks,
        ),
        Block(
            "Presets: whole twins against the truth",
            _metrics(presets),
            presets,
            5,
            _preset_panel,
            _preset_marks,
        ),
        Block(
            "Analysis: volumes and sections of known truth", known, analysis, 3, _known_panel, _known_marks
        ),
    ]
    blocks = [block for block in blocks if block.panels]
    heights = [1.35 * block.n_rows + 0.6 for block in blocks]
    figure = Figure(figsize=(WIDTH, sum(heights)))
    parts = np.atleast_1d(figure.subfigures(len(blocks), 1, height_ratios=heights))
    for part, block in zip(parts, blocks, strict=True):
        part.suptitle(block.title, fontsize=9.5, fontweight="bold", x=0.01, ha="left")
        axes = part.subplots(block.n_rows, block.across, squeeze=False)
        for axis, name in zip(axes.flat, block.panels, strict=False):
            axis.set_xscale("log")
            axis.margins(x=0.15)
            block.draw(axis, block.rows, name)
            _plain_ticks(axis.xaxis)
            axis.tick_params(labelsize=6.5)
        for axis in list(axes.flat)[len(block.panels) :]:
            axis.set_axis_off()
        for axis in axes[-1]:
            axis.set_xlabel("CPU time, s", fontsize=7)
        marks = block.marks(block.rows)
        columns = len(marks) if len(marks) <= 6 else -(-len(marks) // 2)
        look = {"ncols": columns, "fontsize": 6.5, "handletextpad": 0.3, "columnspacing": 1.2}
        part.legend(handles=marks, loc="outside lower center", **look)
    return figure


def _metrics(rows: pd.DataFrame) -> list[str]:
    return [name for name in METRICS if (rows["metric"] == name).any()]


# ---- what marks mean


def _mark(label: str, marker: str = "", colour: str = GREY, line: str = "", hollow: bool = False) -> Line2D:
    face = "white" if hollow else colour
    return Line2D([], [], ls=line, lw=0.9, marker=marker, ms=4.5, color=colour, mfc=face, label=label)


def _front_marks() -> list[Line2D]:
    return [_mark("on the front", "o", SECTION, "-"), _mark("dominated", "o", SECTION, hollow=True)]


def _packing_marks(rows: pd.DataFrame) -> list[Line2D]:
    marks = [
        _mark("beyond chance, named", "o", TWIN_COLOUR),
        _mark("not told from chance", "o", GREY),
    ]
    marks += _front_marks()
    if (rows["knob"] == CHANCE).any():
        marks.append(_mark("chance: the same again", line="--"))
    return marks + _finest_mark(rows)


def _preset_looks(rows: pd.DataFrame) -> dict[str, str]:
    """Marker of each preset."""
    return dict(zip(rows["setting"].unique(), PRESET_MARKERS, strict=False))


def _preset_marks(rows: pd.DataFrame) -> list[Line2D]:
    cost = rows.groupby("setting")["cpu_s"].first()
    marks = [
        _mark(f"{preset}, {cost[preset]:.0f} CPU s", marker, TWIN_COLOUR)
        for preset, marker in _preset_looks(rows).items()
    ]
    return marks + _front_marks()


def _known_marks(rows: pd.DataFrame) -> list[Line2D]:
    looks = {name: METRIC_LOOKS[name] for name in _metrics(rows)}
    marks = [
        _mark(f"{METRICS[name].label}, {_error(name)}", marker, colour)
        for name, (colour, marker) in looks.items()
    ]
    return marks + _front_marks() + _finest_mark(rows)


def _finest_mark(rows: pd.DataFrame) -> list[Line2D]:
    return [_mark("cost of the finest", line=":")] if rows["error"].isna().any() else []


# ---- panels


def _points(axis, rows: pd.DataFrame, look, floor: float | None = None, line: str = GREY) -> None:
    """Markers with their intervals, filled on the front, and the front's steps."""
    for cost in rows.loc[rows["error"].isna(), "cpu_s"]:  # of what the others are held against
        axis.axvline(cost, color=GREY, lw=0.8, ls=":", zorder=0)
    rows = rows[rows["error"].notna()]
    for row in rows.itertuples():
        colour, marker = look(row)
        low = row.lower if floor is None else max(row.lower, floor)
        above = 1 if colour == GREY else 2
        if np.isfinite(row.upper):
            ends = [min(low, row.error), row.upper]
            axis.plot([row.cpu_s] * 2, ends, color=colour, lw=0.7, alpha=0.6, zorder=above)
        face = colour if row.front else "white"
        axis.plot(
            row.cpu_s, row.error, marker=marker, ms=4.5, color=colour, mfc=face, mew=0.9, zorder=above + 2
        )
    chosen = rows[rows["front"]].sort_values("cpu_s")
    axis.plot(chosen["cpu_s"], chosen["error"], drawstyle="steps-post", color=line, lw=0.9, zorder=1)


def _names(axis, rows: pd.DataFrame) -> None:
    """Settings beside their markers, each where it covers no other; limits have to be set."""
    width, height = PANEL_POINTS
    taken: list[tuple[float, float, float, float]] = []
    for row in rows.sort_values("cpu_s").itertuples():
        text = str(row.setting).replace("_", " ")
        long, high = 3.4 * len(text), 6.5  # about, of letters of six points
        at = axis.transLimits.transform(axis.transScale.transform((row.cpu_s, row.error)))
        x, y = at[0] * width, at[1] * height
        left = -3 - long
        for dx, dy in ((3, 3), (3, -9), (left, 3), (left, -9), (3, 10), (3, -16), (left, 10), (left, -16)):
            box = x + dx, y + dy, x + dx + long, y + dy + high
            if box[2] < width + 12 and not any(
                box[0] < o[2] and o[0] < box[2] and box[1] < o[3] and o[1] < box[3] for o in taken
            ):
                break
        taken.append(box)
        axis.annotate(
            text, (row.cpu_s, row.error), (dx, dy), textcoords="offset points", fontsize=6, zorder=6,
            path_effects=[withStroke(linewidth=1.5, foreground="white")],
        )  # fmt: skip


def _packing_panel(axis, table: pd.DataFrame, metric: str) -> None:
    rows = table[table["metric"] == metric]
    chance, rows = rows[rows["knob"] == CHANCE], rows[rows["knob"] != CHANCE]
    overlap = metric == "overlap"  # no difference, but how deep grains overlap: chance has no part in it
    rows = rows.assign(told=True if overlap else beyond_chance(rows, chance))
    if metric in DISTANCES:  # which are never 0; differences with a sign are told from none
        for error in chance["error"]:
            axis.axhline(error, color=GREY, lw=0.8, ls="--", zorder=0)
    _points(axis, rows, lambda row: (TWIN_COLOUR if row.told else GREY, "o"))
    _titled(axis, metric, pd.concat([rows["error"], chance["error"]]), 1.25)
    _names(axis, rows[rows["told"] & rows["error"].notna() & (rows["front"] if overlap else True)])


def _preset_panel(axis, table: pd.DataFrame, metric: str) -> None:
    rows = table[table["metric"] == metric]
    looks = _preset_looks(table)
    _points(axis, rows, lambda row: (TWIN_COLOUR, looks[row.setting]))
    _titled(axis, metric, pd.concat([rows["error"], rows["upper"]]), 1.1)


def _titled(axis, metric: str, errors: pd.Series, room: float) -> None:
    """What an axis says, from 0; where nothing has an error yet, its end is anywhere."""
    top = room * errors.max()
    axis.set_ylim(0, top if top > 0 else None)
    axis.set_title(METRICS[metric].label.removeprefix("the ").removesuffix(" asked for"), fontsize=7.5)
    axis.set_ylabel(_error(metric), fontsize=6.5)


def _known_panel(axis, table: pd.DataFrame, knob: str) -> None:
    axis.set_title(TITLES[knob], fontsize=7.5)
    rows = table[(table["scene"] == knob) & ~(table["error"] <= 0)]
    if rows["error"].isna().all():
        axis.text(0.5, 0.5, "no setting is off", transform=axis.transAxes, ha="center", fontsize=7)
        return
    floor = 0.5 * rows["error"].min()
    for metric in _metrics(rows):
        look = METRIC_LOOKS[metric]
        _points(axis, rows[rows["metric"] == metric], lambda row, look=look: look, floor, look[0])
    axis.set_yscale("log")
    axis.set_ylim(floor, 3 * rows["error"].max())
    _plain_ticks(axis.yaxis)
    axis.set_ylabel("error", fontsize=6.5)
    # one name for all metrics that a run gave, where settings differ
    named = rows.dropna(subset="error")
    differ = named.groupby("metric")["error"].transform("nunique") > 1
    named = named[differ] if differ.any() else named
    _names(axis, named.sort_values("error").drop_duplicates(["setting", "cpu_s"], keep="last"))


def _plain_ticks(axis) -> None:
    """1, 2 and 5 on a logarithmic axis, as plain numbers: the house's style reads no formulas."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1,) if high > 30 * low else (1, 2, 5), numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _error(metric: str) -> str:
    return (
        METRICS[metric]
        .error.replace(" over the mean radius", " / mean r")
        .replace("Wasserstein distance", "W₁")
        .replace(" by pore volume", "")
        .replace(" by number", "")
        .replace("smaller radius", "smaller r")
        .replace("relative difference", "relative")
    )
