"""Figures of the report: each a function of arrays and tables that returns a matplotlib ``Figure``.

No pyplot, no global state. One colour per concept (Okabe and Ito's palette), always joined by a second cue
(line style, outline, marker or label), so that the figures hold in greyscale and for the colour-blind.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import matplotlib.style
import numpy as np
import pandas as pd
import skimage  # its parts load when they are first used
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import EngFormatter
from matplotlib.transforms import Affine2D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from grainfall.correlation import section_windows
from grainfall.io import atomic_path
from grainfall.network import pore_volume_below
from grainfall.report.judgement import PERMEABILITY_TOLERANCE, POROSITY_TOLERANCE
from grainfall.report.metrics import METRICS
from grainfall.report.numbers import number
from grainfall.stereology.distribution import rebinned as averaged

PORE = "#FFFFFF"
MINERALS = ("#0072B2", "#E69F00", "#7A7A7A", "#B9B9B9", "#4D4D4D")
CEMENT = "#A9744F"
SECTION = "#000000"
TRUTH = "#009E73"
TWIN = "#D55E00"
FIRST = "#56B4E9"
PORE_CIRCLE = "#CC79A7"
VIRTUAL = "#F0E442"
VIRTUAL_LABEL = 255
"""Label of virtual spheres in the volume of the second packing."""

STYLE = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "lines.linewidth": 1.6,
    "text.parse_math": False,  # a mineral may be called $x
    "figure.constrained_layout.use": True,
    "figure.facecolor": "white",
    "savefig.dpi": 200,
    "svg.hashsalt": "grainfall",
    "svg.fonttype": "path",
}

MOST_PANELS = 6
"""Most columns of the size histograms."""

WIDTH = 7.2
"""Width of a full figure in inches."""


_METADATA = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}
"""What a file would say of its making, and must not."""


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Draw in the house's style."""

    @functools.wraps(draw)
    def wrapper(*args, **kwargs) -> Figure:
        with matplotlib.style.context(["default", STYLE]):
            return draw(*args, **kwargs)

    return wrapper


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure atomically as SVG, PDF or PNG (by the suffix); equal content gives equal bytes."""
    path = Path(path)
    kind = path.suffix.lstrip(".").lower()
    if kind not in _METADATA:
        raise ValueError(f"{path}: figures are .svg, .pdf or .png")
    metadata = _METADATA[kind]
    with matplotlib.style.context(["default", STYLE]), atomic_path(path) as part:
        figure.savefig(part, format=kind, metadata=metadata)


NOTE = "note-in-place-of-a-figure"
"""Name of the sentence of :func:`note_figure` in an SVG file."""


@styled
def note_figure(text: str) -> Figure:
    """A sentence where a picture would stand, for what a plan did not call for or a run did not compute."""
    figure = Figure(figsize=(WIDTH, 1.0))
    look = {"ha": "center", "va": "center", "wrap": True, "style": "italic", "color": "#333333"}
    figure.text(0.5, 0.5, text, gid=NOTE, **look)
    return figure


# ---- the section


def mineral_colour(phase: int, phases: Sequence[str] = ()) -> str:
    """Colour of a mineral by its number; cement has one of its own, by its name."""
    if phase < len(phases) and phases[phase] == "cement":
        return CEMENT
    return MINERALS[(phase - 1) % len(MINERALS)]


def phase_colours(phase: np.ndarray, phases: Sequence[str] = ()) -> np.ndarray:
    """Colours (…, 3) of a phase image: pores white, minerals in their colours, virtual spheres yellow."""
    minerals = [mineral_colour(i, phases) for i in range(1, VIRTUAL_LABEL)]
    return np.array([to_rgb(colour) for colour in (PORE, *minerals, VIRTUAL)])[phase]


def mineral_handles(phases: Sequence[str], most: int = 9) -> list[Patch]:
    """Legend entries of the minerals, the first ``most`` of them."""
    handles = [
        Patch(facecolor=mineral_colour(i, phases), edgecolor="black", lw=0.5, label=name)
        for i, name in enumerate(phases[1:], start=1)
    ]
    rest = len(handles) - most
    return handles if rest <= 0 else [*handles[:most], Patch(alpha=0, label=f"and {rest} more")]


PORE_HANDLE = Patch(facecolor=PORE, edgecolor="black", lw=0.5, label="pore")
MOST_PIXELS = 2000
"""Pixels along an edge of an image that is drawn: more would not be seen, and cost memory."""


@styled
def section_figure(
    phase: np.ndarray,
    pixel_size_um: float,
    phases: Sequence[str] = (),
    labels: np.ndarray | None = None,
    pores: pd.DataFrame | None = None,
    grains: pd.DataFrame | None = None,
    grey: np.ndarray | None = None,
) -> Figure:
    """The section, and a window of it with grain outlines and inscribed pore circles.

    Parameters
    ----------
    phase : ndarray of uint8, (y, x)
    pixel_size_um : float
    phases : sequence of str
        Names; index 0 is the pore.
    labels : ndarray of int32, (y, x), optional
        Grains; 0 none.
    pores, grains : DataFrame, optional
        pores2d.csv and grains2d.csv; grains cut by the border are outlined with dots.
    grey : ndarray, (y, x), optional
        The greyscale input, shown instead of the phases on the left.
    """
    height, width = (n * pixel_size_um for n in phase.shape)
    aspect = float(np.clip(phase.shape[0] / phase.shape[1], 0.4, 1.6))
    figure = Figure(figsize=(WIDTH, (WIDTH / 2 - 0.45) * aspect + 0.95))
    left, right = figure.subplots(1, 2)
    step = -(-max(phase.shape) // MOST_PIXELS)
    rows, columns = (step * pixel_size_um * -(-n // step) for n in phase.shape)
    if grey is not None:
        left.imshow(grey[::step, ::step], cmap="gray", extent=(0, columns, rows, 0))
    else:
        left.imshow(phase_colours(phase[::step, ::step], phases), extent=(0, columns, rows, 0))
    left.set(title="The section", xlim=(0, width), ylim=(height, 0))

    handles = mineral_handles(phases)
    # a window in which single outlines can be seen; the whole section where it holds few grains
    span = max(height, width)
    if grains is not None and len(grains):
        span = min(span, 28 * float(grains["r_um"].mean()))
    window_w, window_h = min(span, width), min(span * height / width, height)
    x0, y0 = (width - window_w) / 2, (height - window_h) / 2
    window = np.array([[y0, x0], [y0 + window_h, x0 + window_w]]) / pixel_size_um
    (top, first), (bottom, last) = np.stack([np.floor(window[0]), np.ceil(window[1])]).astype(int)
    colours = phase_colours(phase[top:bottom, first:last], phases)
    extent = np.array([first, first + colours.shape[1], top + colours.shape[0], top]) * pixel_size_um
    right.imshow(0.45 * colours + 0.55, extent=extent)
    right.set(xlim=(x0, x0 + window_w), ylim=(y0 + window_h, y0), title="Grains and inscribed pore circles")
    if window_w < width:
        for colour, thick, style in (("black", 1.6, "-"), ("white", 0.7, "--")):
            frame = Rectangle((x0, y0), window_w, window_h, fill=False, ec=colour, lw=thick, ls=style)
            left.add_patch(frame)
    if labels is not None:
        cut = set() if grains is None else set(grains.loc[grains["border"].astype(bool), "grain"])
        lines: dict[bool, list] = {False: [], True: []}
        for region in skimage.measure.regionprops(labels):
            top_left, bottom_right = np.reshape(region.bbox, (2, 2))
            if (bottom_right > window[0]).all() and (top_left < window[1]).all():
                lines[region.label in cut] += _outline(region, pixel_size_um)
        for crossing, style in ((False, "-"), (True, (0, (1, 1.5)))):
            right.add_collection(
                LineCollection(lines[crossing], colors="black", linewidths=0.8, linestyles=[style])
            )
    if pores is not None and len(pores):
        r, x, y = (pores[c].to_numpy() for c in ("r_um", "x_um", "y_um"))
        seen = (x + r > x0) & (x - r < x0 + window_w) & (y + r > y0) & (y - r < y0 + window_h)
        size = 2 * r[seen]
        look = {"facecolor": to_rgba(PORE_CIRCLE, 0.55), "edgecolor": "#7A2E58"}
        right.add_collection(
            EllipseCollection(
                size,
                size,
                np.zeros(len(size)),
                units="xy",
                offsets=np.stack([x, y], axis=1)[seen],
                offset_transform=right.transData,
                linewidths=0.5,
                **look,
            )
        )
        handles.append(Patch(label="pore circle", **look))
    for axes in (left, right):
        axes.set_xlabel("x (µm)")
        axes.spines[:].set_visible(True)
    left.set_ylabel("y (µm)")
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return figure


def _outline(region, pixel: float) -> list[np.ndarray]:
    """Outlines of one labelled region as (n, 2) x, y in µm."""
    corner = np.array(region.bbox[:2])
    lines = skimage.measure.find_contours(np.pad(region.image, 1).astype(float), 0.5)
    simple = (skimage.measure.approximate_polygon(line, 0.35) for line in lines)
    return [((line + corner - 0.5) * pixel)[:, ::-1] for line in simple]


# ---- sizes


@styled
def sizes_figure(
    sizes: pd.DataFrame,
    phases: Sequence[str] = (),
    truth: pd.DataFrame | None = None,
    twin_grains: pd.DataFrame | None = None,
    twin_pores: pd.DataFrame | None = None,
    bodies: pd.DataFrame | None = None,
) -> Figure:
    """2D sizes on slices above, unfolded 3D sizes below; a column for each mineral and the pore circles.

    Parameters
    ----------
    sizes : DataFrame
        sizes.csv: phase, kind, r_lo_um, r_hi_um, f2d, f3d, lower, upper (densities per µm).
    phases : sequence of str
    truth : DataFrame, optional
        True 3D radii: phase, r_um.
    twin_grains, twin_pores : DataFrame, optional
        Measured on slices of the twin, with weights.
    bodies : DataFrame, optional
        bodies.csv of the twin; grain radii are its ``scale``.
    """
    groups = list(sizes.groupby(["kind", "phase"], sort=True))
    hidden = max(0, len(groups) - MOST_PANELS)
    # too many columns cannot be read: the last minerals go first, the pore circles (sorted last) stay
    groups = groups[: MOST_PANELS - 1] + groups[-1:] if hidden else groups
    columns = max(1, len(groups))
    figure = Figure(figsize=(max(WIDTH, 2.6 * columns), 4.9))
    rows = figure.subplots(2, columns, squeeze=False, sharex="col")
    for column, ((kind, phase), table) in enumerate(groups):
        phase = int(phase)
        pore = kind == "pore"
        colour = PORE_CIRCLE if pore else mineral_colour(phase, phases)
        edges = np.append(table["r_lo_um"].to_numpy(), table["r_hi_um"].iloc[-1])
        top, bottom = rows[0, column], rows[1, column]
        name = "pore circles" if pore else (phases[phase] if phase < len(phases) else f"mineral {phase}")
        top.set_title(name)

        # all on wider bins than the unfolding used, or noise is all one sees
        f2d, f3d, lower, upper = (table[c].to_numpy() for c in ("f2d", "f3d", "lower", "upper"))
        last = reach(edges, f2d, f3d)
        (wide, f2d), (_, f3d) = (rebinned(edges, density, last) for density in (f2d, f3d))
        top.stairs(f2d, wide, fill=True, color=to_rgba(colour, 0.45))
        top.stairs(f2d, wide, color=SECTION, lw=1.0, label="section, as seen")
        seen = twin_pores if pore else twin_grains
        if seen is not None:
            seen = seen[seen["weight"] > 0]
            if not pore:
                seen = seen[seen["phase"] == phase]
            _density(top, seen["r_um"], seen["weight"], wide, TWIN, "-", "twin, slices")

        # but for the band: that of wider bins is not the mean of the narrow ones'
        if np.any(lower < upper):  # neither empty, nor as without a bootstrap
            bottom.stairs(
                upper, edges, baseline=lower, fill=True, color=to_rgba(colour, 0.35), label="bootstrap band"
            )
        bottom.stairs(f3d, wide, color=SECTION, lw=1.4, label="section, unfolded")
        highest = [f3d.max()]
        if truth is not None and not pore:
            of_phase = truth.loc[truth["phase"] == phase, "r_um"]
            highest.append(_density(bottom, of_phase, None, wide, TRUTH, (0, (4, 1.5)), "truth"))
        if bodies is not None and not pore:
            of_phase = bodies[(bodies["kind"] == "grain") & (bodies["phase"] == phase)]
            highest.append(_density(bottom, of_phase["scale"], None, wide, TWIN, "-", "twin, bodies"))
        top.set_ylim(bottom=0)
        # where resamples gather many grains in one narrow bin, the band would leave the rest to be flat
        bottom.set(xlabel="radius (µm)", xlim=(0, last), ylim=(0, 1.5 * max(highest)))
    rows[0, 0].set_ylabel("2D: density on slices (1/µm)")
    rows[1, 0].set_ylabel("3D: density (1/µm)")
    if hidden:
        figure.suptitle(f"{hidden} further minerals are in sizes.csv", fontsize=9, style="italic")
    entries: dict[str, object] = {}
    for axes in rows.ravel():
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    # the band carries its panel's colour: one grey patch stands for all of them
    if "bootstrap band" in entries:
        entries["bootstrap band"] = Patch(facecolor="#BBBBBB")
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=3)
    return figure


def reach(edges: np.ndarray, *densities: np.ndarray) -> float:
    """Radius below which 99.9 % of each histogram lies: the last of a long tail would squeeze the rest."""
    masses = [density * np.diff(edges) for density in densities]
    return max(float(edges[1:][mass.cumsum() >= 0.999 * mass.sum()][0]) for mass in masses)


def rebinned(edges: np.ndarray, density: np.ndarray, last: float) -> tuple[np.ndarray, np.ndarray]:
    """A histogram on 24 bins up to ``last``, each of the area that it has there."""
    wide = np.linspace(0, last, 25)
    return wide, averaged(edges, density, wide)


def _density(axes, radii, weights, edges, colour, style, label) -> float:
    """Number density per µm of a sample on given bins, and its highest; what lies outside them counts in the
    norm."""
    radii = np.asarray(radii, float)
    if len(radii) == 0:
        return 0.0
    weights = np.ones(len(radii)) if weights is None else np.asarray(weights, float)
    counts, _ = np.histogram(radii, edges, weights=weights)
    density = counts / weights.sum() / np.diff(edges)
    axes.stairs(density, edges, color=colour, ls=style, lw=1.5, label=label)
    return density.max()


# ---- grains


@styled
def gallery_figure(grains: Sequence[Mapping], phases: Sequence[str] = ()) -> Figure:
    """3D grains, each beside the three masks it was made from.

    Parameters
    ----------
    grains : sequence of mapping
        ``vertices`` (n, 3), ``faces`` (m, 3), ``phase``, ``masks`` (three bool arrays: xy, xz, yz), optional
        ``words`` (a short caption).
    """
    per_row = 2
    rows = -(-len(grains) // per_row)
    figure = Figure(figsize=(WIDTH, 1.25 * rows + 0.3))
    grid = figure.add_gridspec(rows, 4 * per_row, width_ratios=[1.5, 1, 1, 1] * per_row)
    for k, grain in enumerate(grains):
        row, first = k // per_row, 4 * (k % per_row)
        colour = mineral_colour(int(grain["phase"]), phases)
        axes = figure.add_subplot(grid[row, first], projection="3d")
        draw_mesh(axes, grain["vertices"], grain["faces"], colour)
        if grain.get("words"):
            axes.set_title(grain["words"], fontsize=7, fontweight="normal", pad=0, loc="center")
        for j, (mask, plane) in enumerate(zip(grain["masks"], ("xy", "xz", "yz"), strict=True)):
            axes = figure.add_subplot(grid[row, first + 1 + j])
            side = max(mask.shape)
            gap = [((side - n) // 2, side - n - (side - n) // 2) for n in mask.shape]
            square = np.pad(np.pad(mask, gap), 1)
            axes.imshow(np.where(square[..., None], to_rgb(colour), 1.0))
            axes.contour(square, [0.5], colors="black", linewidths=0.6)
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(True)
            axes.spines[:].set_color("#BBBBBB")
            if row == 0:
                axes.set_title(plane, fontsize=8, fontweight="normal", loc="center")
    figure.legend(handles=mineral_handles(phases), loc="outside lower center", ncols=6)
    return figure


def draw_mesh(axes, vertices: np.ndarray, faces: np.ndarray, colour: str) -> None:
    """A closed, outward triangle mesh in a 3D axes: lit from above left, equal scales, no frame."""
    triangles = vertices[faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    elevation, azimuth = np.radians([24, -60])
    eye = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    light = np.array([-0.1, -0.62, 0.78])
    front = normals @ eye > 0
    shade = (0.42 + 0.58 * np.clip(normals[front] @ light, 0, 1))[:, None]
    glint = 0.18 * np.clip(normals[front] @ light, 0, 1)[:, None] ** 8
    colours = np.clip(shade * to_rgb(colour) + glint, 0, 1)
    mesh = Poly3DCollection(triangles[front], facecolors=colours, edgecolors=colours, linewidths=0.3)
    mesh.set_rasterized(True)
    axes.add_collection3d(mesh)
    axes.view_init(elev=24, azim=-60)
    middle, reach = (vertices.max(0) + vertices.min(0)) / 2, np.ptp(vertices, axis=0).max() / 2
    axes.set(**{f"{a}lim": (m - reach, m + reach) for a, m in zip("xyz", middle, strict=True)})
    axes.set_box_aspect((1, 1, 1), zoom=1.5)
    axes.set_axis_off()


# ---- packing


@styled
def packings_figure(
    first: np.ndarray | None,
    second: np.ndarray | None,
    twin: np.ndarray,
    voxel_size_um: float,
    phases: Sequence[str] = (),
    porosities: Sequence[float | None] = (None, None, None),
) -> Figure:
    """One vertical slice through the first packing, the second with its virtual spheres, and the twin.

    Parameters
    ----------
    first, second, twin : ndarray or open volume of uint8, (z, y, x), or None
        Phase volumes; virtual spheres carry the label 255.
    voxel_size_um : float
    phases : sequence of str
    porosities : three floats or None
        Shown over the panels.
    """
    titles = ("First packing", "Second packing", "Twin")
    panels = [
        (t, v, p) for t, v, p in zip(titles, (first, second, twin), porosities, strict=True) if v is not None
    ]
    ratio = twin.shape[0] / twin.shape[2]
    figure = Figure(figsize=(WIDTH, WIDTH / 3 * ratio + 0.95))
    spheres = False
    for axes, (title, volume, porosity) in zip(
        figure.subplots(1, len(panels), squeeze=False, sharey=True)[0], panels, strict=True
    ):
        image = volume[:, volume.shape[1] // 2, :]
        height, width = (n * voxel_size_um for n in image.shape)
        axes.imshow(phase_colours(image, phases), origin="lower", extent=(0, width, 0, height))
        if (image == VIRTUAL_LABEL).any():
            spheres = True
            # an outline besides the colour: yellow on white vanishes in greyscale
            axes.contour(
                (image == VIRTUAL_LABEL).astype(float), [0.5], colors="black", linewidths=0.6,
                extent=(0, width, 0, height),
            )  # fmt: skip
        note = "\n" if porosity is None else f"\nporosity {number(porosity)}"
        axes.set_title(title + note, fontsize=9)
        axes.set_xlabel("x (µm)")
        axes.spines[:].set_visible(True)
        if axes.get_subplotspec().is_first_col():
            axes.set_ylabel("z, up (µm)")
    handles = [*mineral_handles(phases), PORE_HANDLE]
    if spheres:
        handles.append(Patch(facecolor=VIRTUAL, edgecolor="black", lw=0.8, label="virtual sphere"))
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return figure


def draw_block(axes, phase: np.ndarray, phases: Sequence[str] = ()) -> None:
    """A volume (z, y, x) in isometric view in an axes: its top and two of its sides, no frame."""
    nz, ny, nx = phase.shape
    cos, sin = np.cos(np.pi / 6), 0.5
    # paper position of a voxel: x runs right and down, y right and up, z up
    ex, ey, ez = np.array([cos, -sin]), np.array([cos, sin]), np.array([0.0, 1.0])
    faces = (
        (phase[-1], ex, ey, nz * ez, 1.0, (nx, ny)),  # top: columns x, rows y
        (phase[:, 0], ex, ez, 0 * ez, 0.86, (nx, nz)),  # front: columns x, rows z
        (phase[:, :, -1], ey, ez, nx * ex, 0.72, (ny, nz)),  # right: columns y, rows z
    )
    for image, across, up, corner, shade, (columns, rows) in faces:
        affine = Affine2D(np.array([[across[0], up[0], corner[0]], [across[1], up[1], corner[1]], [0, 0, 1]]))
        shown = axes.imshow(
            phase_colours(image, phases) * shade,
            origin="lower",
            extent=(0, columns, 0, rows),
            interpolation="nearest",
        )
        shown.set_transform(affine + axes.transData)
        outline = affine.transform([(0, 0), (columns, 0), (columns, rows), (0, rows), (0, 0)])
        axes.plot(*outline.T, color="black", lw=1.0)
    axes.set(xlim=(-2, (nx + ny) * cos + 2), ylim=(-nx * sin - 2, nz + ny * sin + 2), aspect="equal")
    axes.set_axis_off()


@styled
def twin_figure(
    section: np.ndarray,
    pixel_size_um: float,
    twin: np.ndarray,
    voxel_size_um: float,
    phases: Sequence[str] = (),
) -> Figure:
    """The middle window of the section and a slice of the twin at one scale, and the twin as a block.

    Parameters
    ----------
    section : ndarray of uint8, (y, x)
    pixel_size_um : float
    twin : ndarray or open volume of uint8, (z, y, x)
    voxel_size_um : float
    phases : sequence of str
        Names of the twin's phases; index 0 is the pore.
    """
    nz, ny, nx = twin.shape
    across = np.round(np.array([nz, nx]) * voxel_size_um / pixel_size_um).astype(int)
    part = section_windows(section, tuple(np.minimum(section.shape, across)))[0]
    figure = Figure(figsize=(WIDTH, WIDTH / 3 * max(1.0, nz / nx) + 0.95))
    left, middle, right = figure.subplots(1, 3)
    where = "the section" if part.shape == section.shape else "the section, its middle window"
    for axes, image, size, name in (
        (left, part[::-1], pixel_size_um, where),
        (middle, twin[:, ny // 2, :], voxel_size_um, "the twin, a vertical slice"),
    ):
        height, width = (n * size for n in image.shape)
        axes.imshow(phase_colours(image, phases), origin="lower", extent=(0, width, 0, height))
        axes.set(xlim=(0, nx * voxel_size_um), ylim=(0, nz * voxel_size_um), xlabel="µm")
        axes.set_title(f"{name}\nporosity {number((image == 0).mean())}", fontsize=9)
        axes.spines[:].set_visible(True)
    draw_block(right, twin, phases)
    size = " × ".join(number(n * voxel_size_um) for n in (nx, ny, nz))
    right.set_title(f"the twin in 3D\n{size} µm", fontsize=9)
    figure.legend(handles=[*mineral_handles(phases), PORE_HANDLE], loc="outside lower center", ncols=6)
    return figure


MOST_FORCE = 6
"""Forces that are shown, in their mean: beyond are few, over a long way."""


@styled
def forces_figure(
    contacts: pd.DataFrame, bodies: pd.DataFrame, edge_um: float, grain_um: float
) -> Figure | None:
    """Force chains: contacts of grains in a vertical slab, as thick as the force they carry.

    Parameters
    ----------
    contacts : DataFrame
        contacts.csv.
    bodies : DataFrame
        bodies.csv.
    edge_um : float
        Edge of the region of interest.
    grain_um : float
        Mean grain diameter: the slab is two of them thick.

    Returns
    -------
    Figure or None
        None without contacts in the slab.
    """
    near = contacts[(contacts["y"] - edge_um / 2).abs() < grain_um]
    near = near[near["x"].between(0, edge_um) & near["z"].between(0, edge_um)]
    if near.empty:
        return None
    place = bodies.set_index("id")[["x", "z"]]
    ends = np.stack([place.loc[near[g]].to_numpy() for g in ("grain_a", "grain_b")], axis=1)
    force = near["force_n"].fillna(0.0).to_numpy()
    mean = force[force > 0].mean() if (force > 0).any() else 1.0
    figure = Figure(figsize=(WIDTH, 3.6))
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1])
    left.add_collection(LineCollection(ends[force <= 0], colors="#bbbbbb", linewidths=0.5))
    widths = np.clip(1.2 * force[force > 0] / mean, 0.2, 6)
    left.add_collection(LineCollection(ends[force > 0], colors=TWIN, linewidths=widths, capstyle="round"))
    left.set(xlim=(0, edge_um), ylim=(0, edge_um), aspect="equal", xlabel="x (µm)", ylabel="z (µm)")
    left.set_title("Contact forces")
    every = contacts["force_n"].to_numpy(float)
    every = every[every > 0]
    if len(every):
        edges = np.linspace(0, MOST_FORCE, 31)
        density = np.histogram(every / every.mean(), edges)[0] / len(every) / np.diff(edges)
        right.stairs(density, edges, fill=True, color=to_rgba(TWIN, 0.35))
        right.stairs(density, edges, color=TWIN)
        right.set_yscale("log")
        right.yaxis.set_major_formatter("{x:g}")
        force = EngFormatter("N", places=1)(every.mean())
        right.set_title(f"{number(len(every))} contacts with margin,\nmean {force}")
        beyond = (every > MOST_FORCE * every.mean()).mean()
        right.text(1, 1, f"{100 * beyond:.2g} % beyond", ha="right", va="top", transform=right.transAxes)
    right.set(xlabel="normal force over its mean", ylabel="density", xlim=(0, MOST_FORCE))
    return figure


@styled
def virtual_figure(table: pd.DataFrame, p_sp: float | None = None) -> Figure:
    """Sizes behind the virtual spheres: target and first packing, their difference, and what was used.

    Parameters
    ----------
    table : DataFrame
        virtual_spheres.csv: r_lo_um, r_hi_um, target, first, difference, used (densities per µm).
    p_sp : float, optional
        Share of virtual spheres among the bodies poured; of 0, sizes that were left over were not used.
    """
    fine = np.append(table["r_lo_um"].to_numpy(), table["r_hi_um"].iloc[-1])
    volumes = table[["first", "target", "difference", "used"]].fillna(0)
    # the table has the used part of the difference as a distribution of its own
    volumes["used"] = volumes["difference"].where(volumes["used"] > 0, 0)
    # by volume: the many small circles hold little of the pore
    cubes = np.diff(fine**4) / 4
    whole = volumes["target"] @ cubes or 1.0  # a section without pore circles has none
    volumes = volumes.mul(cubes / np.diff(fine) / whole, axis=0).to_numpy().T
    last = reach(fine, *volumes[:2])
    first, target, difference, used = (rebinned(fine, density, last)[1] for density in volumes)
    edges = np.linspace(0, last, len(first) + 1)
    figure = Figure(figsize=(WIDTH, 3.1))
    left, right = figure.subplots(1, 2, sharex=True)
    left.stairs(first, edges, fill=True, color=to_rgba(FIRST, 0.5))
    left.stairs(first, edges, color="#1F6A99", ls=(0, (4, 1.5)), label="first packing")
    left.stairs(target, edges, color=SECTION, label="target: the section")
    left.set_title("Pore circles, unfolded")
    left.set_ylim(bottom=0)
    left.set_ylabel("volume, of the target's (1/µm)")
    right.axhline(0, color="black", lw=0.6)
    right.stairs(difference, edges, color=SECTION, ls=(0, (1, 1.2)), lw=1.3, label="target − first packing")
    right.set_title("Virtual spheres")
    right.set_ylabel("volume, of the target's (1/µm)")
    if used.any() and p_sp != 0:
        right.stairs(used, edges, fill=True, color=VIRTUAL, zorder=0)
        share = "" if p_sp is None else f", {100 * p_sp:.3g} % of the bodies"
        right.stairs(used, edges, color="#6B6300", lw=1.2, label=f"used{share}", zorder=0.5)
    else:
        right.text(0.5, 0.9, "none called for", ha="center", transform=right.transAxes, style="italic")
    for axes in (left, right):
        axes.set(xlabel="radius (µm)", xlim=(0, last))
    figure.legend(loc="outside lower center", ncols=4)
    return figure


# ---- correlation


@styled
def s2_figure(
    slices: pd.DataFrame | None = None,
    envelope: pd.DataFrame | None = None,
    envelope_result: Mapping | None = None,
    reference: pd.DataFrame | None = None,
) -> Figure:
    """S₂ of the solid: the cloud of slices with the section's curve, and the global envelope.

    Parameters
    ----------
    slices : DataFrame, optional
        s2_slices.csv: slice, axis, lag_um, s2.
    envelope : DataFrame, optional
        s2_envelope.csv: lag_um, observed, lower, upper, mean, section.
    envelope_result : mapping, optional
        s2_envelope.json: p, n_slices, n_windows, windows_rejected, window_um.
    reference : DataFrame, optional
        reference_s2.csv: axis, lag_um, s2.
    """
    figure = Figure(figsize=(WIDTH, 3.1))
    left, right = figure.subplots(1, 2, sharey=True)
    last = np.inf if envelope is None else float(envelope["lag_um"].max())
    if slices is not None:
        curves = [g[["lag_um", "s2"]].to_numpy() for _, g in slices.groupby(["axis", "slice"])]
        last = min(last, float(slices["lag_um"].max()))
        left.add_collection(LineCollection(curves, colors=to_rgba(TWIN, 0.35), linewidths=0.8))
        left.plot([], [], color=TWIN, alpha=0.6, lw=0.8, label=f"twin, {len(curves)} slices")
        mean = slices.groupby("lag_um")["s2"].mean()
        left.plot(mean.index, mean, color=TWIN, lw=1.8, label="twin, mean")
    if reference is not None:
        along = reference[reference["axis"].isin(["x", "y", "z"])]
        mean = along.groupby("lag_um")["s2"].mean()
        left.plot(mean.index, mean, color=TRUTH, ls=(0, (4, 1.5)), lw=1.8, label="reference volume")
    if envelope is not None:
        told = envelope_result or {}
        windows = told.get("n_windows", 1)
        # the mean scatters less than single slices do: it is to be seen beside their mean only
        mean_of = "section" if windows == 1 else f"section, mean of {windows} windows"
        left.plot(envelope["lag_um"], envelope["section"], color=SECTION, lw=1.3, label=mean_of)
        edges = told.get("window_um")
        middle = "section" if windows == 1 else "section, its middle window"
        middle += "" if edges is None else f"\n({' × '.join(map(number, edges[::-1]))} µm)"
        n = told.get("n_slices")
        right.fill_between(
            envelope["lag_um"], envelope["lower"], envelope["upper"], color=to_rgba(TWIN, 0.3), lw=0,
            label="global 95 % envelope" + (f", {n} slices" if n else ""),
        )  # fmt: skip
        right.plot(envelope["lag_um"], envelope["mean"], color=TWIN, lw=1.0, label="mean of the slices")
        right.plot(envelope["lag_um"], envelope["observed"], color=SECTION, lw=1.3, label=middle)
        p = told.get("p")
        title = "Global envelope" + ("" if p is None else f": p = {number(p, 2)}")
        if windows > 1:
            out = round(told["windows_rejected"] * windows)
            title += f"\n{out} of {windows} windows rejected"
        right.set_title(title)
        right.legend()
    else:
        right.text(
            0.5, 0.5, "envelope test not computed", ha="center", transform=right.transAxes, style="italic"
        )
    left.set_title("Cloud of slices")
    left.legend()
    left.set_ylabel("S₂ of the solid (probability)")
    for axes in (left, right):
        axes.set_xlabel("lag (µm)")
        if np.isfinite(last):
            axes.set_xlim(0, last)
    left.autoscale_view(scalex=False)
    return figure


# ---- network and flow


@styled
def draw_pore_volume_below(axes, networks: Sequence[tuple[Mapping[str, np.ndarray], Mapping]]) -> None:
    """Share of the pore volume in pores up to a radius: (sizes of its elements, look of the line) of each.

    Cumulative, as a few large pores hold much of the volume and radii are no finer than voxels: bins would
    rise and fall with each. What lies between two curves is their Wasserstein distance.
    """
    radii = np.linspace(0, max(sizes["pore_radius_um"].max() for sizes, _ in networks), 400)
    for sizes, look in networks:
        axes.plot(radii, pore_volume_below(sizes, radii), **look)
    axes.set(xlim=(0, radii[-1]), ylim=(0, 1.02))


def network_figure(
    sizes: Mapping[str, np.ndarray],
    reference: Mapping[str, np.ndarray] | None = None,
    voxel_um: float = 0.0,
) -> Figure:
    """Size distributions of the pore network: twin against reference.

    Parameters
    ----------
    sizes, reference : mapping
        As :func:`grainfall.network.element_sizes` gives them.
    voxel_um : float
        Edge of the network's voxels: radii tell no narrower bins apart.
    """
    figure = Figure(figsize=(WIDTH, 2.9))
    samples = {"twin": sizes} if reference is None else {"twin": sizes, "reference": reference}
    panels = (
        ("pore_radius_um", "Pores", "radius (µm)", "share of pore volume below"),
        ("throat_radius_um", "Throats", "radius (µm)", "density (1/µm)"),
        ("coordination", "Coordination", "throats per pore", "share of pores"),
    )
    for axes, (kind, title, x_label, y_label) in zip(figure.subplots(1, 3), panels, strict=True):
        axes.set(xlabel=x_label, ylabel=y_label)
        axes.set_title(title)
        values = {name: np.asarray(of[kind], float) for name, of in samples.items() if len(of[kind])}
        if not values:
            axes.text(0.5, 0.5, "none", ha="center", transform=axes.transAxes, style="italic")
            continue
        if kind == "pore_radius_um":
            looks = {"twin": {"color": TWIN}, "reference": {"color": TRUTH, "ls": (0, (4, 1.5)), "lw": 1.8}}
            draw_pore_volume_below(axes, [(samples[name], looks[name]) for name in values])
            continue
        # the last half per cent of a long tail would squeeze the rest
        last = np.quantile(np.concatenate(list(values.values())), 0.995)
        if kind == "coordination":
            step = np.ceil((last + 1) / 25)
            edges = np.arange(-0.5, last + 0.5 + step, step)
        else:
            step = max(last / 24, voxel_um)
            edges = np.arange(np.ceil(last / step) + 1) * step
        width = 1 if kind == "coordination" else np.diff(edges)
        for name, sample in values.items():
            density = np.histogram(sample, edges)[0] / len(sample) / width
            if name == "twin":
                axes.stairs(density, edges, fill=True, color=to_rgba(TWIN, 0.35))
                axes.stairs(density, edges, color=TWIN)
            else:
                axes.stairs(density, edges, color=TRUTH, ls=(0, (4, 1.5)), lw=1.8)
        axes.set_ylim(bottom=0)
    counts = {
        name: f"{name}: {number(len(of['pore_radius_um']))} pores, "
        f"{number(len(of['throat_radius_um']))} throats"
        for name, of in samples.items()
    }
    handles = [Patch(facecolor=to_rgba(TWIN, 0.35), edgecolor=TWIN, label=counts["twin"])]
    if reference is not None:
        handles.append(Line2D([], [], color=TRUTH, ls=(0, (4, 1.5)), lw=1.8, label=counts["reference"]))
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


NARROWEST = 0.1
"""Least width of an axis that compares twins, of what it shows."""


@styled
def comparison_figure(summary: pd.DataFrame, intervals: pd.DataFrame) -> Figure:
    """Every ensemble's realizations, mean and, from three realizations on, 95 % interval; a panel per metric.

    Parameters
    ----------
    summary : DataFrame
        Rows of summary.csv of one sample.
    intervals : DataFrame
        From :func:`grainfall.report.ensembles.intervals` on the same rows, by variant and engine.
    """
    metrics = list(dict.fromkeys(intervals["metric"]))
    columns = 3
    rows = -(-len(metrics) // columns)
    ensembles = list(dict.fromkeys(zip(intervals["variant"], intervals["engine"], strict=True)))
    figure = Figure(figsize=(WIDTH, (0.85 + 0.34 * len(ensembles)) * rows + 0.2))
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes, name in zip(grid.ravel(), metrics, strict=False):
        shown = []
        for y, (variant, engine) in enumerate(ensembles):
            of = (summary["variant"] == variant) & (summary["engine"] == engine)
            values = pd.to_numeric(summary.loc[of, name], errors="coerce").dropna()
            axes.plot(values, np.full(len(values), y + 0.18), "|", color="#555555", ms=6, mew=1)
            shown += [*values]
            row = intervals[
                (intervals["metric"] == name)
                & (intervals["variant"] == variant)
                & (intervals["engine"] == engine)
            ]
            if len(row):
                n, mean, lower, upper = row[["n", "mean", "lower", "upper"]].iloc[0]
                axes.plot(mean, y - 0.1, "o", color=TWIN, ms=4.5)
                if n > 2:
                    axes.plot([lower, upper], [y - 0.1] * 2, "|-", color=TWIN, ms=6, mew=1.4, lw=1.4)
                    shown += [lower, upper]
        goal = {"porosity": "porosity_target", "k_x_md": "k_ref_x_md", "k_y_md": "k_ref_y_md",
                "k_z_md": "k_ref_z_md"}.get(name)  # fmt: skip
        # never so near that what is met looks missed, or chance like an effect
        least = NARROWEST * max(map(abs, shown))
        if goal in summary and summary[goal].notna().any():
            aim = summary[goal].astype(float).mean()
            slack = POROSITY_TOLERANCE if name == "porosity" else PERMEABILITY_TOLERANCE * aim
            axes.axvspan(aim - slack, aim + slack, color=to_rgba(TRUTH, 0.15), lw=0)
            axes.axvline(aim, color=TRUTH, ls=(0, (4, 1.5)), lw=1.4)
            shown, least = [*shown, aim - 1.5 * slack, aim + 1.5 * slack], 0
        known = METRICS[name]
        axes.set_xlabel(short_label(name) + ("" if known.unit == "1" else f" ({known.unit})"), fontsize=8)
        axes.set_yticks(range(len(ensembles)), [f"{v} ({e})" for v, e in ensembles])
        axes.set_ylim(len(ensembles) - 0.5, -0.6)
        middle, half = (min(shown) + max(shown)) / 2, 0.65 * max(max(shown) - min(shown), least)
        if half > 0:
            axes.set_xlim(middle - half, middle + half)
        axes.locator_params(axis="x", nbins=3)
        axes.ticklabel_format(axis="x", useOffset=False)  # the offset would stand on the label
    for axes in grid.ravel()[len(metrics) :]:
        axes.set_axis_off()
    return figure


def short_label(name: str) -> str:
    """A metric's label for an axis."""
    return {
        "porosity": "porosity", "s2_inside_envelope": "S₂: lags inside the cloud", "s2_envelope_p": "S₂: p",
        "w1_grains_um": "W₁ of grain radii", "w1_pores_um": "W₁ of pore circles", "k_x_md": "K along x",
        "k_y_md": "K along y", "k_z_md": "K along z", "max_overlap": "largest overlap", "wall_s": "wall time",
        "coordination": "contacts per grain", "porosity_first": "porosity, first packing",
    }.get(name, name.replace("_", " "))  # fmt: skip
