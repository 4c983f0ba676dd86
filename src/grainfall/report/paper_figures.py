"""The data figures of the paper, drawn from our own cases.

Each takes the cases and gives a figure, or None where the case behind it has not come so far. Colours and
second cues are those of :mod:`grainfall.report.figures`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import skimage  # its parts load when they are first used
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from grainfall import correlation, io, network, random
from grainfall.report import figures
from grainfall.report.ensembles import t_interval
from grainfall.report.figures import (
    FIRST,
    PORE_CIRCLE,
    SECTION,
    TRUTH,
    TWIN,
    WIDTH,
    mineral_colour,
    phase_colours,
    styled,
)
from grainfall.report.html import PACKED, Results, drawn_grains, gallery
from grainfall.report.texts import case_names
from grainfall.report.validation import (
    BEREA_PUBLISHED_MD,
    CUBES,
    PAPER,
    describe,
    mean_s2,
    network_sizes,
    size_bias,
)

DASHED, DOTTED = (0, (4, 1.5)), (0, (1, 1.2))
MARKS = "osD^v<>p*h"
"""Markers that tell sections of one volume apart, from the first again where there are more."""
GRAINS_SHOWN = 14
"""Mean grain diameters across a window in which single grains are to be seen."""


def _letter(axes, letter: str, title: str = "") -> None:
    axes.set_title(f"({letter}) {title}".rstrip(), fontsize=9, fontweight="normal", loc="left")


@dataclass(frozen=True)
class Cases:
    """Where the results of the cases are.

    Attributes
    ----------
    root : Path
        The results folder.
    samples : mapping
        Case to the names of its samples.
    """

    root: Path
    samples: Mapping[str, Sequence[str]]

    def paths(self, case: str, pattern: str) -> list[Path]:
        """Files of a case below the folders of its samples, in order."""
        return [
            path for name in self.samples.get(case, ()) for path in sorted((self.root / name).glob(pattern))
        ]

    def stems(self, case: str, pattern: str) -> list[Path]:
        """Networks of a case: their paths without what tells pores from throats."""
        found = self.paths(case, f"{pattern}_pores.csv")
        return [path.with_name(path.name.removesuffix("_pores.csv")) for path in found]

    def references(self, case: str) -> list[Path]:
        """Networks of the reference cubes of a case."""
        return self.stems(case, "reference_network") + self.stems(case, f"{CUBES}/reference_network")

    def twin(self, case: str, variant: str = "full", *, packings: bool = False) -> Results | None:
        """The first twin of a case whose volume is there, and those of its packings where asked for."""
        volumes = ["twin.zarr.zip"] + ["first/volume.zarr.zip", "second/volume.zarr.zip"] * packings
        for path in self.paths(case, f"{variant}/*/metrics.csv"):
            if all((path.parent / volume).exists() for volume in volumes):
                return Results(self.root, path.parents[2].name, variant, int(path.parent.name))
        return None


DARK, LIGHT = to_rgb("#151515"), to_rgb("#999999")
"""Pore and solid, where a picture has no colours but theirs: dark and light as in a tomogram."""
PHANTOM = "#F0E442"
"""Pores of a tomogram that the rock has not: brighter than solid and pore, in grey as in colour."""
BINARY = [
    Patch(facecolor=LIGHT, edgecolor="black", lw=0.5, label="solid"),
    Patch(facecolor=DARK, edgecolor="black", lw=0.5, label="pore"),
]


def _binary(solid: np.ndarray) -> np.ndarray:
    """Colours of solid and pore."""
    return np.where(solid[..., None], LIGHT, DARK)


def _image(axes, picture: np.ndarray, pixel: float, *, up: bool = False) -> None:
    """Colours (y, x, 3), or the grey (y, x) of a tomogram, in which 1 is solid."""
    height, width = (n * pixel for n in picture.shape[:2])
    axes.imshow(
        picture,
        origin="lower" if up else "upper",
        extent=(0, width, 0, height) if up else (0, width, height, 0),
        interpolation="nearest",
        **({"cmap": "gray", "vmin": 0, "vmax": 1.2} if picture.ndim == 2 else {}),
    )
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(True)


def _plane(axes, r: Results, name: str) -> None:
    """The vertical slice through the middle of a volume of a twin."""
    with r.opened(f"twin:{name}.zarr.zip") as (volume,):
        phase = np.asarray(volume[:, volume.shape[1] // 2])
    voxel = _voxel(r)
    _image(axes, phase_colours(phase, r.twin_phases), voxel, up=True)
    if (phase == figures.VIRTUAL_LABEL).any():
        axes.contour(
            (phase == figures.VIRTUAL_LABEL).astype(float), [0.5], colors="black", linewidths=0.6,
            extent=(0, phase.shape[1] * voxel, 0, phase.shape[0] * voxel),
        )  # fmt: skip


def _bar(axes, width_um: float) -> None:
    """A scale bar of a round length, about a quarter of the width."""
    size = 10 ** np.floor(np.log10(width_um / 4))
    size *= max(m for m in (1, 2, 5) if m * size <= width_um / 4) if width_um / 4 >= size else 1
    x0, x1 = axes.get_xlim()
    y0, y1 = axes.get_ylim()
    left, y = x0 + 0.05 * (x1 - x0), y0 + 0.06 * (y1 - y0)
    axes.plot([left, left + size], [y, y], color="white", lw=5, solid_capstyle="butt")
    axes.plot([left, left + size], [y, y], color="black", lw=2.5, solid_capstyle="butt")
    axes.text(
        left, y + 0.025 * (y1 - y0), f"{size:g} µm", va="bottom", fontsize=7,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85},
    )  # fmt: skip


def _window(r: Results, edge_um: float) -> tuple[slice, slice]:
    """Pixels of a square window in the middle of the section."""
    shape, pixel = r.section_phase.shape, r.pixel_size_um
    half = min(int(edge_um / pixel), *shape) // 2
    return tuple(slice(n // 2 - half, n // 2 + half) for n in shape)


def _grain_um(r: Results) -> float:
    return float(r.json("variant:scene.json")["mean_diameter_um"])


def _voxel(r: Results, name: str = "twin:twin.zarr.zip") -> float:
    return float(r.attributes(name)[0]["voxel_size_um"])


CIRCLE = {"facecolor": to_rgba(PORE_CIRCLE, 0.85), "edgecolor": "#7A2E58", "linewidth": 0.5}
PORE_CIRCLES = Patch(**CIRCLE, label="pore circle")


ON_GREY = {**CIRCLE, "edgecolor": "white", "linewidth": 0.9}
"""The same where pores are dark and solids grey: without colours its face is like a solid's."""


def _circles(axes, pores: pd.DataFrame, offset=(0.0, 0.0), look: Mapping = CIRCLE) -> None:
    r = pores["r_um"].to_numpy()
    axes.add_collection(
        EllipseCollection(
            2 * r, 2 * r, np.zeros(len(r)), units="xy",
            offsets=pores[["x_um", "y_um"]].to_numpy() - np.asarray(offset),
            offset_transform=axes.transData, **look,
        )
    )  # fmt: skip


def _section_panels(r: Results, edge_um: float):
    window = _window(r, edge_um)
    corner = (window[1].start * r.pixel_size_um, window[0].start * r.pixel_size_um)
    labels = r.volume("sample:labels.zarr.zip", "grains")[window]
    return r.section_phase[window], labels, r.table("sample:pores2d.csv"), corner


def _outlines(axes, labels: np.ndarray, pixel: float, colour: str = "#C00000", width: float = 0.9) -> None:
    """Boundaries between labels and of labels with the pore."""
    lines = []
    for label in np.unique(labels)[1:]:
        mask = np.pad(labels == label, 1)
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        corner = rows[0] - 1, columns[0] - 1
        part = mask[corner[0] : rows[-1] + 2, corner[1] : columns[-1] + 2].astype(float)
        found = skimage.measure.find_contours(part, 0.5)
        lines += [(line + np.array(corner) - 0.5)[:, ::-1] * pixel for line in found]
    axes.add_collection(LineCollection(lines, colors=colour, linewidths=width))


# ---- the method


@styled
def pipeline(cases: Cases) -> Figure | None:
    """The workflow in seven pictures, each from the same sample."""
    r = cases.twin("virtual_spheres", packings=True)
    if r is None:
        return None
    phase, labels, pores, corner = _section_panels(r, GRAINS_SHOWN * _grain_um(r))
    pixel = r.pixel_size_um
    figure = Figure(figsize=(WIDTH, 4.3))
    grid = figure.add_gridspec(2, 4, wspace=0.12)
    names = ("section", "grains and pores", "2D and 3D sizes", "grains from masks", "first packing",
             "second packing", "twin")  # fmt: skip
    places = [(0, 0), (0, 1), (0, 2), (0, 3), (1, 3), (1, 2), (1, 1)]
    panels = []
    for letter, name, place in zip("abcdefg", names, places, strict=True):
        flat = name != "grains from masks"
        axes = figure.add_subplot(grid[place], **({} if flat else {"projection": "3d"}))
        _letter(axes, letter, name)
        panels.append(axes)
    colours = phase_colours(phase, r.phases)
    _image(panels[0], colours, pixel)
    _bar(panels[0], phase.shape[1] * pixel)
    _image(panels[1], 0.5 * colours + 0.5, pixel)
    _outlines(panels[1], labels, pixel, "black", 0.6)
    limits = panels[1].get_xlim(), panels[1].get_ylim()
    _circles(panels[1], pores, corner)
    panels[1].set(xlim=limits[0], ylim=limits[1])
    sizes = r.table("sample:sizes.csv")
    table = sizes[(sizes["kind"] == "grain") & (sizes["phase"] == 1)]
    edges = np.append(table["r_lo_um"], table["r_hi_um"].iloc[-1])
    f2d, f3d = table["f2d"].to_numpy(), table["f3d"].to_numpy()
    last = figures.reach(edges, f2d, f3d)
    wide, f2d = figures.rebinned(edges, f2d, last)
    _, f3d = figures.rebinned(edges, f3d, last)
    panels[2].stairs(f2d, wide, fill=True, color=to_rgba(mineral_colour(1, r.phases), 0.4), label="2D")
    panels[2].stairs(f3d, wide, color="black", label="3D")
    panels[2].set(yticks=[], xlabel="radius (µm)")
    panels[2].legend(fontsize=7)
    chosen = gallery(r, 6)
    grain = chosen[len(chosen) // 4]
    figures.draw_mesh(panels[3], grain["vertices"], grain["faces"], mineral_colour(grain["phase"], r.phases))
    for axes, name in zip(panels[4:], ("first/volume", "second/volume", "twin"), strict=True):
        _plane(axes, r, name)
    hidden = figure.add_subplot(grid[1, 0])
    hidden.set_axis_off()
    handles = figures.mineral_handles(r.twin_phases)
    handles += [PORE_CIRCLES, Patch(facecolor=figures.VIRTUAL, edgecolor="black", label="virtual sphere")]
    hidden.legend(handles=handles, loc="center", fontsize=8)
    figure.draw_without_rendering()
    boxes = [axes.get_position() for axes in panels]
    for one, two in pairwise(boxes):
        same_row = abs(one.y0 - two.y0) < 0.1
        if same_row and one.x0 < two.x0:
            ends = (one.x1, one.y0 + one.height / 2), (two.x0, one.y0 + one.height / 2)
        elif same_row:
            ends = (one.x0, one.y0 + one.height / 2), (two.x1, one.y0 + one.height / 2)
        else:
            x = two.x0 + two.width / 2
            ends = (x, one.y0), (x, two.y1 + 0.05)
        figure.add_artist(
            FancyArrowPatch(*ends, transform=figure.transFigure, arrowstyle="-|>", mutation_scale=9, lw=1.2,
                            color="black")
        )  # fmt: skip
    return figure


@styled
def masks(cases: Cases) -> Figure | None:
    """Pore and solid; grain masks; minerals; inscribed circles."""
    r = cases.twin("stereology") or cases.twin("virtual_spheres")
    if r is None:
        return None
    phase, labels, pores, corner = _section_panels(r, 9 * _grain_um(r))
    pixel = r.pixel_size_um
    figure = Figure(figsize=(WIDTH, 2.5))
    panels = figure.subplots(1, 4)
    solid = phase > 0
    minerals = np.where(solid[..., None], phase_colours(phase, r.phases), DARK)
    for axes, picture in zip(panels, (_binary(solid), _binary(solid), minerals, _binary(solid)), strict=True):
        _image(axes, picture, pixel)
    _outlines(panels[1], labels, pixel)
    limits = panels[3].get_xlim(), panels[3].get_ylim()
    _circles(panels[3], pores, corner, ON_GREY)
    panels[3].set(xlim=limits[0], ylim=limits[1])
    handles = [*BINARY, *figures.mineral_handles(r.phases), PORE_CIRCLES]
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    names = ("solid and pore", "grain masks", "minerals", "pore circles")
    for axes, letter, name in zip(panels, "abcd", names, strict=True):
        _letter(axes, letter, name)
        _bar(axes, phase.shape[1] * pixel)
    return figure


@styled
def sizes2d(cases: Cases) -> Figure | None:
    """f2D of both minerals and of the pore circles."""
    r = cases.twin("stereology") or cases.twin("virtual_spheres")
    if r is None:
        return None
    figure = Figure(figsize=(WIDTH / 2, 2.6))
    axes = figure.add_subplot()
    hatches = {0: "....", 1: "", 2: "////"}
    handles = []
    for (kind, phase), table in r.table("sample:sizes.csv").groupby(["kind", "phase"], sort=True):
        pore = kind == "pore"
        colour = PORE_CIRCLE if pore else mineral_colour(int(phase), r.phases)
        edges = np.append(table["r_lo_um"], table["r_hi_um"].iloc[-1])
        f2d = table["f2d"].to_numpy()
        wide, f2d = figures.rebinned(edges, f2d, figures.reach(edges, f2d))
        name = "pore circles" if pore else r.phases[int(phase)]
        # of one patch, a browser's paper has the fill cover what lies below it, hatches and all
        axes.stairs(f2d, wide, fill=True, facecolor=to_rgba(colour, 0.3), lw=0)
        axes.stairs(f2d, wide, fill=True, facecolor="none", edgecolor=colour, lw=1.2,
                    hatch=hatches.get(int(phase), ""))  # fmt: skip
        handles.append(Patch(facecolor=to_rgba(colour, 0.3), edgecolor=colour, lw=1.2,
                             hatch=hatches.get(int(phase), ""), label=name))  # fmt: skip
    axes.set(xlabel="radius in the section (µm)", ylabel="$f_{2D}$ (1/µm)", xlim=(0, None), ylim=(0, None))
    axes.yaxis.label.set_parse_math(True)
    axes.legend(handles=handles)
    return figure


@styled
def grain(cases: Cases) -> Figure | None:
    """Three masks at right angles, and the grain that has them as its central sections."""
    r = cases.twin("stereology") or cases.twin("virtual_spheres")
    chosen = gallery(r, 6) if r else []
    if not chosen:
        return None
    one = chosen[len(chosen) // 3]
    vertices = one["vertices"] - (one["vertices"].max(0) + one["vertices"].min(0)) / 2
    reach = np.abs(vertices).max()
    colour = mineral_colour(one["phase"], r.phases)
    figure = Figure(figsize=(WIDTH * 0.75, 2.7))
    left, right = (figure.add_subplot(1, 2, k, projection="3d") for k in (1, 2))
    spans = np.ptp(vertices, axis=0)
    for mask, (a, b), shade in zip(one["masks"], ((0, 1), (0, 2), (1, 2)), (0.9, 0.65, 0.4), strict=True):
        line = max(skimage.measure.find_contours(np.pad(mask, 1).astype(float), 0.5), key=len)[:, ::-1]
        line = line - (line.max(0) + line.min(0)) / 2
        points = np.zeros((len(line), 3))
        points[:, [a, b]] = line / np.ptp(line, axis=0) * spans[[a, b]] * (1, -1)
        face = to_rgba(np.array(to_rgb(colour)) * shade + (1 - shade) * 0.8, 0.55)
        left.add_collection3d(Poly3DCollection([points], facecolor=face, edgecolor="black", lw=0.9))
    left.view_init(elev=24, azim=-60)
    left.set(**{f"{axis}lim": (-reach, reach) for axis in "xyz"})
    left.set_box_aspect((1, 1, 1), zoom=1.5)
    left.set_axis_off()
    figures.draw_mesh(right, vertices, one["faces"], colour)
    _letter(left, "a", "three masks, stretched to meet")
    _letter(right, "b", "the grain")
    return figure


def two_packing(cases: Cases) -> Figure | None:
    """The same vertical slice of the first packing, of the second and of the twin."""
    r = cases.twin("virtual_spheres", packings=True)
    if r is None:
        return None
    values = r.table("twin:metrics.csv").set_index("metric")["value"]
    porosities = [values.get(k) for k in ("porosity_first", "porosity_second", "porosity")]
    with r.opened(*PACKED) as volumes:
        return figures.packings_figure(*volumes, _voxel(r), r.twin_phases, porosities)


def virtual_sizes(cases: Cases) -> Figure | None:
    """Sizes of the virtual spheres: target, first packing, difference, used."""
    r = cases.twin("virtual_spheres")
    if r is None:
        return None
    return figures.virtual_figure(
        r.table("twin:virtual_spheres.csv"), r.json("twin:second/packing.json")["p_sp"]
    )


# ---- sample 1


@styled
def _sample1(cases: Cases, variant: str) -> Figure | None:
    r = cases.twin("stereology", variant)
    if r is None:
        return None
    edge = 10 * _grain_um(r)
    phases = range(1, len(r.phases))
    figure = Figure(figsize=(WIDTH, 4.6))
    grid = figure.add_gridspec(2, 1 + len(phases), width_ratios=[1, *[2.5 / len(phases)] * len(phases)])
    left = [figure.add_subplot(grid[i, 0]) for i in (0, 1)]
    window = _window(r, edge)
    _image(left[0], phase_colours(r.section_phase[window], r.phases), r.pixel_size_um)
    _plane(left[1], r, "twin")
    _letter(left[0], "a", "original, the section")
    _letter(left[1], "b", "reconstructed, slice")
    for axes in left:
        _bar(axes, edge)
    truth, bodies = r.table("sample:truth_sizes.csv"), drawn_grains(r)
    seen = [r.table("sample:grains2d.csv"), r.table("twin:grains2d.csv")]
    for column, phase in enumerate(phases):
        colour = mineral_colour(phase, r.phases)
        top, bottom = (figure.add_subplot(grid[i, 1 + column]) for i in (0, 1))
        last = truth.loc[truth["phase"] == phase, "r_um"].quantile(0.999)
        edges = np.linspace(0, last, 22)
        of = [t[(t["phase"] == phase) & (t["weight"] > 0)] for t in seen]
        _histograms(top, [(t["r_um"], t["weight"]) for t in of], edges, colour)
        own = bodies[(bodies["kind"] == "grain") & (bodies["phase"] == phase)]["scale"]
        _histograms(bottom, [(truth.loc[truth["phase"] == phase, "r_um"], None), (own, None)], edges, colour)
        first = ord("c") + column
        _letter(top, chr(first), f"{r.phases[phase]}, 2D")
        _letter(bottom, chr(first + len(phases)), f"{r.phases[phase]}, 3D")
        bottom.set_xlabel("radius (µm)")
        if column == 0:
            top.set_ylabel("density on slices (1/µm)")
            bottom.set_ylabel("density in 3D (1/µm)")
    handles = figures.mineral_handles(r.twin_phases)
    handles += [
        Patch(facecolor="#BBBBBB", edgecolor="black", label="original"),
        Line2D([], [], color=TWIN, lw=1.8, label="reconstructed"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return figure


def _histograms(axes, samples: Sequence[tuple], edges: np.ndarray, colour: str) -> None:
    """Densities of the original (filled) and the reconstructed (line)."""
    for k, (values, weights) in enumerate(samples):
        values = np.asarray(values, float)
        weights = np.ones(len(values)) if weights is None else np.asarray(weights, float)
        density = np.histogram(values, edges, weights=weights)[0] / weights.sum() / np.diff(edges)
        if k == 0:
            axes.stairs(density, edges, fill=True, facecolor=to_rgba(colour, 0.4), edgecolor="black", lw=0.8)
        else:
            axes.stairs(density, edges, color=TWIN, lw=1.8)
    axes.set(xlim=(0, edges[-1]), ylim=(0, None))


def sample1_full(cases: Cases) -> Figure | None:
    """Sample 1 with the inversion."""
    return _sample1(cases, "full")


def sample1_no_inversion(cases: Cases) -> Figure | None:
    """Sample 1 without the inversion."""
    return _sample1(cases, "no_inversion")


S2_OF_TRUTH = ("reference_s2.csv", f"{CUBES}/reference_s2.csv")


def _s2_ensemble(axes, cases: Cases, case: str, variants: Sequence[tuple]) -> bool:
    """S2 in 3D: mean and range of the truths' cubes, and of each variant every twin and their mean."""
    truth = [mean_s2(path) for name in S2_OF_TRUTH for path in cases.paths(case, name)]
    if not truth or not cases.paths(case, "*/*/s2_volume.csv"):
        return False
    grid = truth[0][0][truth[0][0] <= 0.5 * truth[0][0][-1]]

    def on(curve):
        return np.interp(grid, *curve)

    for variant, colour, style, label in variants:
        own = [on(mean_s2(path)) for path in cases.paths(case, f"{variant}/*/s2_volume.csv")]
        for curve in own:
            axes.plot(grid, curve, color=to_rgba(colour, 0.25), lw=0.7, ls=style)
        if own:
            axes.plot(
                grid, np.mean(own, 0), color=colour, ls=style, lw=1.9, label=f"{label} (n = {len(own)})"
            )
    each = np.array([on(c) for c in truth])
    if len(each) > 1:
        axes.fill_between(grid, each.min(0), each.max(0), color=to_rgba(TRUTH, 0.25), lw=0)
    axes.plot(
        grid,
        each.mean(0),
        color=TRUTH,
        ls=DASHED,
        lw=2.2,
        label=f"original ({len(each)} cube{'s' if len(each) > 1 else ''})",
    )
    axes.set(xlabel="lag (µm)", ylabel="S₂ of the solid (probability)", xlim=(0, grid[-1]))
    axes.legend()
    return True


@styled
def sample1_s2(cases: Cases) -> Figure | None:
    """S2 in 3D of the truths, with the inversion and without."""
    figure = Figure(figsize=(WIDTH, 3.1))
    left, right = figure.subplots(1, 2)
    variants = (("full", TWIN, "-", "with the inversion"), ("no_inversion", FIRST, DOTTED, "without"))
    if not _s2_ensemble(left, cases, "stereology", variants):
        return None
    _letter(left, "a")
    _letter(right, "b", "less its own truth's, mean of sections")
    for variant, colour, style, label in variants:
        off = []
        for sample in cases.samples["stereology"]:
            own, truth = (
                [mean_s2(p) for name in names for p in sorted((cases.root / sample).glob(name))]
                for names in ([f"{variant}/*/s2_volume.csv"], S2_OF_TRUTH)
            )
            if own and truth:
                lags = truth[0][0][truth[0][0] <= 0.5 * truth[0][0][-1]]
                one, other = (np.mean([np.interp(lags, *c) for c in of], axis=0) for of in (own, truth))
                off.append(one - other)
        if off:
            mean, lower, upper = np.transpose([t_interval(of)[1:] for of in np.transpose(off)])
            right.plot(lags, mean, color=colour, ls=style, lw=1.9, label=label)
            if len(off) > 2:
                right.fill_between(lags, lower, upper, color=to_rgba(colour, 0.25), lw=0)
    right.axhline(0, color=TRUTH, ls=DASHED, lw=1.6)
    right.set(xlabel="lag (µm)", ylabel="difference of S₂", xlim=left.get_xlim())
    return figure


# ---- sample 2


@styled
def sample2(cases: Cases) -> Figure | None:
    """Original block, slices of the original and of both packings."""
    r = cases.twin("virtual_spheres", packings=True)
    if r is None:
        return None
    edge = _voxel(r) * r.attributes("twin:twin.zarr.zip")[1]["phase"][0]
    figure = Figure(figsize=(WIDTH, 5.3))
    grid = figure.subplots(2, 3).ravel()
    reference = r.volume("sample:reference.zarr.zip", "phase")
    figures.draw_block(grid[0], reference, r.phases)
    phase, _, pores, corner = _section_panels(r, edge)
    for axes in grid[1:3]:
        _image(axes, phase_colours(phase, r.phases), r.pixel_size_um)
    limits = grid[2].get_xlim(), grid[2].get_ylim()
    _circles(grid[2], pores, corner)
    grid[2].set(xlim=limits[0], ylim=limits[1])
    for axes, name in zip(grid[3:], ("first/volume", "second/volume", "twin"), strict=True):
        _plane(axes, r, name)
    for axes in grid[1:]:
        _bar(axes, edge)
    names = ("original", "original, slice", "with inscribed circles", "first packing", "second packing",
             "final")  # fmt: skip
    for axes, letter, name in zip(grid, "abcdef", names, strict=True):
        _letter(axes, letter, name)
    handles = figures.mineral_handles(r.twin_phases)
    handles += [PORE_CIRCLES, Patch(facecolor=figures.VIRTUAL, edgecolor="black", label="virtual sphere")]
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return figure


def _network_panel(axes, r: Results, slab_um: float) -> None:
    """Pores and throats whose ends lie in a slab, seen from above."""
    net = network.load(r.path("twin:network_pores.csv"), r.path("twin:network_throats.csv"))
    place, inner = net["pore.coords"], ~net["pore.boundary"]
    middle = (place[inner, 2].min() + place[inner, 2].max()) / 2
    shown = inner & (np.abs(place[:, 2] - middle) < slab_um / 2)
    ends = net["throat.conns"][shown[net["throat.conns"]].all(axis=1)]
    axes.add_collection(
        LineCollection([place[pair][:, :2] for pair in ends], colors="#777777", linewidths=0.6)
    )
    size = net["pore.extended_diameter"][shown]
    axes.add_collection(
        EllipseCollection(
            size, size, np.zeros(len(size)), units="xy", offsets=place[shown, :2],
            offset_transform=axes.transData, facecolor=to_rgba(TWIN, 0.55), edgecolor="black", linewidths=0.4,
        )
    )  # fmt: skip
    edge = place[inner, :2].max()
    axes.set(xlim=(0, edge), ylim=(0, edge), aspect="equal", xlabel="x (µm)", ylabel="y (µm)")


def _pore_sizes(axes, volumes: Sequence[tuple], *, by_number: bool = False) -> None:
    """Share of the pore volume, or of all pores, in network pores up to a radius, pooled over twins."""
    drawn = []
    for of_each, colour, style, name in volumes:
        if of_each:
            sizes = network.pooled_sizes(of_each)
            if by_number:
                sizes = sizes | {"pore_volume_um3": np.ones(len(sizes["pore_radius_um"]))}
            drawn.append((sizes, {"color": colour, "ls": style, "lw": 1.6, "label": name}))
    figures.draw_pore_volume_below(axes, drawn)
    what = "pores" if by_number else "pore volume"
    axes.set(xlabel="network pore radius (µm)", ylabel=f"share of {what} below")
    axes.legend(fontsize=7, loc="lower right")


def _pores(stems: Sequence[Path]) -> list[dict[str, np.ndarray]]:
    return [network_sizes(stem) for stem in stems]


@styled
def sample2_analysis(cases: Cases) -> Figure | None:
    """Pore network, its sizes and S2, with the virtual spheres and without."""
    r = cases.twin("virtual_spheres")
    if r is None:
        return None
    figure = Figure(figsize=(WIDTH, 3.1))
    figure.get_layout_engine().set(w_pad=0.08)
    panels = figure.subplots(1, 3)
    _network_panel(panels[0], r, 2 * _grain_um(r))
    _pore_sizes(
        panels[1],
        (
            (_pores(cases.references("virtual_spheres")), TRUTH, DASHED, "original"),
            (_pores(cases.stems("virtual_spheres", "grains_only/*/network")), FIRST, DOTTED, "grains alone"),
            (_pores(cases.stems("virtual_spheres", "full/*/network")), TWIN, "-", "with spheres"),
        ),
    )
    variants = (("full", TWIN, "-", "with spheres"), ("grains_only", FIRST, DOTTED, "grains alone"))
    _s2_ensemble(panels[2], cases, "virtual_spheres", variants)
    for axes, letter, name in zip(
        panels, "abc", ("network of a twin, slab", "pores", "S₂ in 3D"), strict=True
    ):
        _letter(axes, letter, name)
    return figure


# ---- sample 3


def _tomogram_panels(cases: Cases):
    r = cases.twin("xct")
    if r is None or r.volume("sample:tomogram/grey.zarr.zip") is None:
        return None
    rock = r.volume("sample:reference.zarr.zip", "phase")
    grey = r.volume("sample:tomogram/grey.zarr.zip").astype(float)
    solid = r.volume("sample:tomogram/reference.zarr.zip", "phase")
    return r, rock, grey, solid, _voxel(r, "sample:tomogram/reference.zarr.zip")


def _phantom(rock: np.ndarray, solid: np.ndarray, plane: int, binning: int) -> np.ndarray:
    """Where a plane of a thresholded tomogram shows pore though all of the rock behind its voxel is solid."""
    ny, nx = solid.shape[1:]
    behind = rock[plane * binning :][:binning, : ny * binning, : nx * binning] > 0
    return (solid[plane] == 0) & behind.reshape(-1, ny, binning, nx, binning).all(axis=(0, 2, 4))


@styled
def motivation(cases: Cases) -> Figure | None:
    """The same plane of a rock as a section shows it and as a tomogram does."""
    found = _tomogram_panels(cases)
    if found is None:
        return None
    r, rock, grey, solid, voxel = found
    plane = len(solid) // 2
    figure = Figure(figsize=(WIDTH, 2.75))
    panels = figure.subplots(1, 3)
    fine = rock[rock.shape[0] * plane // len(solid)]
    _image(panels[0], _binary(fine > 0), _voxel(r, "sample:reference.zarr.zip"))
    _image(panels[1], grey[plane], voxel)
    picture = _binary(solid[plane] > 0)
    binning = round(voxel / _voxel(r, "sample:reference.zarr.zip"))
    picture[_phantom(rock, solid, plane, binning)] = to_rgb(PHANTOM)
    _image(panels[2], picture, voxel)
    names = ("a plane of the rock", "its tomogram", "thresholded")
    for axes, letter, name in zip(panels, "abc", names, strict=True):
        _letter(axes, letter, name)
        _bar(axes, solid.shape[2] * voxel)
    handles = [
        *BINARY,
        Patch(facecolor=PHANTOM, edgecolor="black", lw=0.5, label="phantom pore: solid in the rock"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


@styled
def sample3(cases: Cases) -> Figure | None:
    """Tomogram, its binary image, the section, and slices of the reconstruction."""
    found = _tomogram_panels(cases)
    if found is None:
        return None
    r, _, grey, solid, voxel = found
    edge = solid.shape[2] * voxel
    figure = Figure(figsize=(WIDTH, 5.4))
    grid = figure.subplots(2, 3).ravel()
    plane = len(solid) // 2
    _image(grid[0], grey[plane], voxel)
    _image(grid[1], _binary(solid[plane] > 0), voxel)
    phase, labels, _, _ = _section_panels(r, edge)
    _image(grid[2], _binary(phase > 0), r.pixel_size_um)
    _image(grid[3], phase_colours(phase, r.phases), r.pixel_size_um)
    _outlines(grid[3], labels, r.pixel_size_um, "black", 0.5)
    for axes, name in zip(grid[4:], ("first/volume", "twin"), strict=True):
        _plane(axes, r, name)
    names = (
        "tomogram, slice",
        "tomogram, thresholded",
        "section",
        "section, grains",
        "first packing",
        "final",
    )
    for axes, letter, name in zip(grid, "abcdef", names, strict=True):
        _letter(axes, letter, name)
        _bar(axes, edge)
    white = Patch(facecolor=figures.PORE, edgecolor="black", lw=0.5, label="pore (d to f)")
    handles = [*BINARY, *figures.mineral_handles(r.twin_phases), white]
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return figure


def _cloud(axes, volume: np.ndarray, voxel: float, colour: str, label: str, seed: int) -> np.ndarray:
    """S2 of 20 random slices of a volume, and their mean."""
    drawn = random.slices(np.random.default_rng(seed), volume.shape, 20)
    table = correlation.s2_of_slices(volume, drawn, voxel)
    curves = [g[["lag_um", "s2"]].to_numpy() for _, g in table.groupby("slice")]
    axes.add_collection(LineCollection(curves, colors=to_rgba(colour, 0.35), linewidths=0.7))
    mean = table.groupby("lag_um")["s2"].mean()
    axes.plot(mean.index, mean, color=colour, lw=1.8, label=label)
    return mean.index.to_numpy()


@styled
def sample3_analysis(cases: Cases) -> Figure | None:
    """The twin, pore sizes of rock, tomogram and twin by volume and by number, and clouds of S2 on slices."""
    found = _tomogram_panels(cases)
    if found is None:
        return None
    r, _, _, solid, voxel = found
    figure = Figure(figsize=(WIDTH, 5.4))
    block, by_volume, by_number, s2 = panels = figure.subplots(2, 2).ravel()
    twin = r.volume("twin:twin.zarr.zip", "phase")
    figures.draw_block(block, twin, r.twin_phases)
    volumes = (
        (_pores(cases.references("xct")), TRUTH, DASHED, "the rock"),
        (_pores(cases.stems("xct", "tomogram/reference_network")), FIRST, DOTTED, "tomogram"),
        (_pores(cases.stems("xct", "full/*/network")), TWIN, "-", "twin"),
    )
    _pore_sizes(by_volume, volumes)
    _pore_sizes(by_number, volumes, by_number=True)
    section = correlation.s2_image(r.section_phase > 0)
    lags = _cloud(s2, solid, voxel, FIRST, "tomogram, 20 slices", 0)
    _cloud(s2, twin, _voxel(r), TWIN, "twin, 20 slices", 1)
    rock = mean_s2(r.path("sample:reference_s2.csv"))
    s2.plot(*rock, color=TRUTH, ls=DASHED, lw=2, label="the rock, 3D")
    s2.plot(np.arange(len(section)) * r.pixel_size_um, section, color=SECTION, lw=1.2, label="section")
    s2.set(xlim=(0, lags[-1] / 2), xlabel="lag (µm)", ylabel="S₂ of the solid (probability)")
    s2.legend()
    names = ("twin", "pores by volume", "pores by number", "S₂ on slices")
    for axes, letter, name in zip(panels, "abcd", names, strict=True):
        _letter(axes, letter, name)
    return figure


@styled
def berea(cases: Cases) -> Figure | None:
    """A slice of the sandstone and of its twin, S2, pore sizes and K along the axes."""
    r = cases.twin("berea")
    volume = cases.root / "data/berea/reference.zarr.zip"
    if r is None or not volume.exists():
        return None
    figure = Figure(figsize=(WIDTH, 5.0))
    figure.get_layout_engine().set(w_pad=0.08)
    grid = figure.subplots(2, 3).ravel()
    phase, pixel = r.section_phase, r.pixel_size_um
    twin = r.volume("twin:twin.zarr.zip", "phase")
    n = min(twin.shape[0], phase.shape[0])
    _image(grid[0], phase_colours(phase[:n, :n], r.phases), pixel)
    _image(grid[1], phase_colours(twin[:, twin.shape[1] // 2][:n, :n], r.twin_phases), _voxel(r), up=True)
    for axes in grid[:2]:
        _bar(axes, n * pixel)
    handles = figures.mineral_handles(r.twin_phases)
    grid[1].legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=2, fontsize=7)
    lags, s2 = mean_s2(cases.root / "data/berea/reference_s2.csv")
    _s2_twins(grid[2], cases, lags[lags < 0.4 * r.pixel_size_um * 200])
    grid[2].plot(lags, s2, color=TRUTH, ls=DASHED, lw=2.2, label="Berea")
    grid[2].legend()
    _pore_sizes(
        grid[3],
        (
            (_pores([cases.root / "data/berea/reference_network"]), TRUTH, DASHED, "Berea"),
            (_pores(cases.stems("berea", "full/*/network")), TWIN, "-", "twins"),
        ),
    )
    every = io.read_volume(volume, "phase")[0] == 0
    for axis, (name, style) in enumerate(zip("zyx", ("-", DASHED, DOTTED), strict=True)):
        planes = every.mean(axis=tuple(a for a in range(3) if a != axis))
        place = (np.arange(len(planes)) + 0.5) * pixel
        grid[4].plot(place, planes, ls=style, lw=0.9, color="#777777", label=name)
        for mark, path in zip(cycle(MARKS), cases.paths("berea", "section.json"), strict=False):
            cut = io.read_json(path)["notes"]["slice"]  # such as x100
            if cut[0] == name:
                at = int(cut[1:])
                grid[4].plot(place[at], planes[at], mark, color=SECTION, ms=4.5, zorder=3)
    grid[4].axhline(every.mean(), color=TRUTH, ls=DASHED, lw=1.8)
    grid[4].set(xlabel="place of the slice (µm)", ylabel="porosity of a slice")
    grid[4].set(xlim=(0, len(planes) * pixel), ylim=(0.93 * grid[4].get_ylim()[0], None))
    grid[4].legend(title="normal to", title_fontsize=7, fontsize=7, ncols=3, loc="lower center")
    _k_axes(grid[5], cases)
    names = ("Berea, the slice seen", "a twin, slice", "S₂ in 3D", "pores", "one slice's porosity",
             "permeability")  # fmt: skip
    for axes, letter, name in zip(grid, "abcdef", names, strict=True):
        _letter(axes, letter, name)
    return figure


def _s2_twins(axes, cases: Cases, grid: np.ndarray) -> None:
    own = [mean_s2(p) for p in cases.paths("berea", "full/*/s2_volume.csv")]
    for curve in own:
        axes.plot(grid, np.interp(grid, *curve), color=to_rgba(TWIN, 0.35), lw=0.8)
    if own:
        mean = np.mean([np.interp(grid, *c) for c in own], axis=0)
        axes.plot(grid, mean, color=TWIN, lw=1.9, label=f"twins (n = {len(own)})")
    axes.set(xlabel="lag (µm)", ylabel="S₂ of the solid (probability)", xlim=(0, grid[-1]))


def _k_axes(axes, cases: Cases) -> None:
    sections = [sorted((cases.root / name).glob("full/*/flow.csv")) for name in cases.samples["berea"]]
    marked = zip(cycle(MARKS), sections, strict=False)
    tables = [(mark, io.read_table(path)) for mark, paths in marked for path in paths]
    reference = io.read_table(cases.root / "data/berea/reference_flow.csv")

    def along(table, axis):
        return table[(table["method"] == table["method"].iloc[0]) & (table["axis"] == axis)]["k_md"].iloc[0]

    for x, axis in enumerate("xyz"):
        for beside, (mark, table) in zip(np.linspace(-0.25, 0.25, len(tables)), tables, strict=True):
            axes.plot(x + beside, along(table, axis), mark, color=TWIN, ms=3.5)
        axes.plot([x - 0.3, x + 0.3], [along(reference, axis)] * 2, color=TRUTH, ls=DASHED, lw=2,
                  label="Berea, same method" if x == 0 else None)  # fmt: skip
    axes.plot([], [], MARKS[0], color=TWIN, ms=4, label="twins")
    axes.axhline(BEREA_PUBLISHED_MD, color=SECTION, lw=1, ls=DOTTED, label="published mean of cubes")
    axes.set(xticks=range(3), xticklabels=list("xyz"), xlabel="axis", ylabel="K (mD)")
    axes.set_ylim(0, 1.08 * axes.get_ylim()[1])
    axes.legend(fontsize=6.5)


# ---- across the cases


@styled
def cv_sweep(cases: Cases) -> Figure | None:
    """Mean radius, K, K/R² and K over the squared Sauter radius against the spread of sizes."""
    ratios = size_bias(cases.root)
    if ratios.empty:
        return None
    # of every truth the mean of its packs
    means = ratios.groupby(["variant", "cv", "truth"]).mean(numeric_only=True)
    figure = Figure(figsize=(WIDTH, 2.7))
    panels = figure.subplots(1, 4)
    for axes in panels[2:]:
        axes.sharey(panels[1])
    names = (("r_mean_ratio", "mean radius over the truth's"), ("k_ratio", "K over the truth's"),
             ("k_over_r2_ratio", "K/R² over the truth's"),
             ("k_over_rs2_ratio", "K/R₃₂² over the truth's"))  # fmt: skip
    looks = (("full", TWIN, "o", "with the inversion"), ("no_inversion", FIRST, "s", "without"))
    for axes, letter, (column, label) in zip(panels, "abcd", names, strict=True):
        for shift, (variant, colour, mark, name) in zip((-0.006, 0.006), looks, strict=True):
            ratio = means.loc[variant, column].groupby("cv")
            mean, n = ratio.mean(), ratio.size()
            at = ratio.obj.index.get_level_values("cv") + shift
            axes.plot(at, ratio.obj, mark, ms=2.5, color=to_rgba(colour, 0.45))
            count = f"{n.max()}" if n.min() == n.max() else f"{n.min()} to {n.max()}"
            axes.plot(
                mean.index + shift, mean, color=colour, marker=mark, ms=5, lw=1.3, mec="black", mew=0.5,
                label=f"{name} ({count} truths)",
            )  # fmt: skip
        axes.axhline(1, color="black", lw=0.8)
        if column == "r_mean_ratio":
            cv = np.linspace(0, 0.75, 100)
            axes.plot(cv, np.pi / 4 * (1 + cv**2), color=SECTION, ls=DASHED, lw=1.2, label="(π/4)(1 + CV²)")
        axes.set(xlabel="CV of the true radii", ylabel=label, xlim=(0.03, 0.77))
        _letter(axes, letter)
    panels[1].axhline(
        PAPER["stereology", "no_inversion", "k_ratio"],
        color="#7A7A7A",
        ls=DOTTED,
        lw=1.4,
        label="paper, without",
    )
    handles = {
        label: handle
        for axes in panels
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4)
    return figure


@styled
def permeability(cases: Cases) -> Figure | None:
    """K over the truth's of every case and variant: ours with its interval, and the paper's."""
    table = io.read_table(cases.root / "validation.csv")
    rows = table[(table["quantity"] == "k_ratio") & (table["variant"] != "truth")].reset_index(drop=True)
    if rows.empty:
        return None
    figure = Figure(figsize=(WIDTH * 0.8, 0.9 + 0.33 * len(rows)))
    axes = figure.add_subplot()
    for y, row in rows.iterrows():
        error = (
            None if np.isnan(row["lower"]) else [[row["mean"] - row["lower"]], [row["upper"] - row["mean"]]]
        )
        ours = row["variant"] != "tomogram"  # what the twins are to be held against
        axes.errorbar(row["mean"], y, xerr=error, fmt="o" if ours else "s", color=TWIN if ours else FIRST,
                      ms=5, capsize=3, lw=1.5,
                      label=("twins" if ours else "simulated tomograms") + ", 95 % interval")  # fmt: skip
        if not np.isnan(row["paper"]):
            axes.plot(row["paper"], y, "D", color=SECTION, mfc="none", ms=6)
    if rows["paper"].notna().any():
        axes.plot([], [], "D", color=SECTION, mfc="none", ms=6, label="paper, one realization")
    axes.axvline(1, color=TRUTH, ls=DASHED, lw=1.6, label="truth")
    axes.axvspan(0.9, 1.1, color=to_rgba(TRUTH, 0.12), lw=0, label="within 10 %")
    called = case_names()
    names = [
        f"{called.get(r.case, r.case)}, {r.variant}".replace("_", " ")
        + f"\n{r.n} {'tomogram' if r.variant == 'tomogram' else 'twin'}{'s'[: r.n > 1]}, "
        + f"{r.sections} section{'s'[: r.sections > 1]}"
        for r in rows.itertuples()
    ]
    axes.set(yticks=range(len(rows)), yticklabels=names, xlabel=describe("k_ratio").label, xlim=(0, None))
    axes.set_ylim(len(rows) - 0.5, -0.5)
    once = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    axes.legend(once.values(), once, loc="best", fontsize=7)
    return figure


class Drawn(NamedTuple):
    """A figure of the validation page."""

    draw: Callable[[Cases], Figure | None]
    paper: str
    """The figure of the paper that it stands for."""
    caption: str


FIGURES: dict[str, Drawn] = {
    "permeability": Drawn(
        permeability,
        "-",
        "Permeability over the truth's by the same method, of every case and variant. Dots: our "
        "ensembles (so many twins of so many sections) with 95 % intervals; squares: tomograms, which "
        "the twins are held against; open diamonds, where there are any: the paper's single figures; the "
        "band is 10 % to either side.",
    ),
    "motivation": Drawn(
        motivation,
        "Motivation",
        "One plane of a virtual rock: as it is, as the simulated tomogram shows it, and "
        "the tomogram thresholded. Yellow: phantom pores, solid in the rock.",
    ),
    "pipeline": Drawn(
        pipeline,
        "Overall workflow",
        "The workflow, every picture from one run of case 2.",
    ),
    "masks": Drawn(
        masks,
        "Grain mask extraction",
        "A window of the section: solid and pore, grain masks, minerals, inscribed pore circles.",
    ),
    "sizes2d": Drawn(
        sizes2d,
        "f2D of two granular phases and pore circles",
        "Radii in the section of two minerals and of the pore circles, number densities.",
    ),
    "grain": Drawn(
        grain,
        "Grain reconstruction from three masks",
        "Three masks of the section at right angles, stretched to meet; the grain that has them as "
        "its central sections.",
    ),
    "two_packing": Drawn(
        two_packing,
        "Two-stage packing",
        "One vertical slice: grains alone, grains with virtual spheres, and the twin.",
    ),
    "virtual_sizes": Drawn(
        virtual_sizes,
        "Distributions of virtual spheres",
        "Pore circles of section and first packing, unfolded, drawn by volume; their difference (taken by "
        "number), and its part above zero, bin by bin of the unfolding: the sizes that the spheres got.",
    ),
    "sample1_full": Drawn(
        sample1_full,
        "Sample 1 with recalculation",
        "Case 1 with the inversion. 3D: the truth's grains against the twin's.",
    ),
    "sample1_no_inversion": Drawn(
        sample1_no_inversion,
        "Sample 1 without recalculation",
        "Case 1, radii of the section taken for radii of grains.",
    ),
    "sample1_s2": Drawn(
        sample1_s2,
        "Sample 1: S2",
        "Case 1: S₂ in 3D (thin: single twins; band: the range of the truths), and how far it is from that "
        "of each section's own truth, on average, with 95 % intervals over sections.",
    ),
    "sample2": Drawn(
        sample2,
        "Sample 2: original and reconstructed",
        "Case 2: the original block and slices; first packing, second packing, final twin.",
    ),
    "sample2_analysis": Drawn(
        sample2_analysis,
        "Sample 2: structural analysis",
        "Case 2: pore network of a twin (a slab two grains thick), radii of network pores, cumulative by "
        "pore volume (the paper has histograms), S₂ in 3D.",
    ),
    "sample3": Drawn(
        sample3,
        "Sample 3: experimental and reconstructed",
        "Case 3c: tomogram, tomogram thresholded, section, its grains, first packing, final twin. The "
        "tomogram and the section are different planes of one rock (the paper has an SEM image of it).",
    ),
    "sample3_analysis": Drawn(
        sample3_analysis,
        "Sample 3: structural analysis",
        "Case 3c: a twin, radii of network pores by their volume and by their number (isolated ones left "
        "out), S₂ of 20 slices each of tomogram and twin.",
    ),
    "berea": Drawn(
        berea,
        "-",
        "Case 3a: one slice of Berea and a twin made of it, S₂ in 3D, pore sizes, the porosity of "
        "every single slice, those seen marked, and K along the axes of the twins made of them, so marked.",
    ),
    "cv_sweep": Drawn(
        cv_sweep,
        "-",
        "Spheres: what the section says of the mean radius, and K of packs of those sizes, as "
        "it is and over the squares of their mean and of their Sauter radius (volume to surface), against "
        "the spread of the true radii; with the inversion and without.",
    ),
}
"""Every figure of the validation page by its name, in the order of the paper."""
