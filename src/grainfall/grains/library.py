"""A library of 3D grains: many shapes for each mineral, each from three masks of one size bin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import lazy_loader
import numpy as np
import pandas as pd
import scipy  # its parts load when they are first used

from grainfall import io
from grainfall.errors import InputError
from grainfall.grains.contours import Unusable
from grainfall.grains.decomposition import decompose, union_volume
from grainfall.grains.shape import (
    Grain,
    agreed_half_axes,
    grain_from_contours,
    half_axes_seen,
    mass_properties,
    unit_contour,
)
from grainfall.morphology import grain_masks

trimesh = lazy_loader.load("trimesh")  # 0.3 s, for jobs that make or write meshes

SPHERE = -1
"""Shape id of a sphere, which is in no library."""

ARRAYS = frozenset(
    ("vertices", "vertex_counts", "faces", "face_counts", "pieces", "piece_counts", "pieces_a_shape")
)
"""What shapes.npz holds."""

SMALLEST_EXCESS = 0.07
"""Volume of the hull over the shape's own, minus 1, below which a shape is not worth cutting: the pieces of a
thin section's grains keep about as much (:data:`grainfall.grains.decomposition.CONCAVITY`)."""

_UNIT_VOLUME = 4 * np.pi / 3
_MASKS_A_BIN, _MOST_BINS = 12, 10
_PLANES = ("xy", "xz", "yz")
_INERTIA = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


@dataclass
class Library:
    """Grain shapes at equal-volume radius 1, each with its centre of mass at the origin.

    Attributes
    ----------
    vertices : list of (n, 3) float ndarray
        In (x, y, z) order. A body lies at ``position + R(q) @ (scale * v)``; its scale is the radius of the
        sphere of equal volume.
    faces : list of (m, 3) int32 ndarray
        Outward triangles.
    table : DataFrame
        One row a shape: shape (its index here), phase, r2d_um (of the mask that chose the size bin), mask_xy,
        mask_xz, mask_yz (grain ids), stretch, iou_xy, iou_xz, iou_yz, reading, hull_excess (V_hull / V − 1),
        aspect_ratio (longest over shortest axis of the ellipsoid of equal inertia), elongation (intermediate
        over longest), flatness (shortest over intermediate), sphericity (area of the equal-volume sphere over
        area), pieces (their number), parts_excess (V_union of the pieces / V − 1; empty without) and
        inertia_xx … inertia_yz (tensor at unit density).
    skipped : DataFrame
        Masks that could not be used: grain, phase, reason.
    pieces : list of tuple of (k, 3) float ndarray
        Vertices of the convex pieces that a non-convex shape is cut into, in the shape's frame; an empty
        tuple where there are none, see :func:`cut`. By default no shape has any.
    """

    vertices: list[np.ndarray]
    faces: list[np.ndarray]
    table: pd.DataFrame
    skipped: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=["grain", "phase", "reason"]))
    pieces: list[tuple[np.ndarray, ...]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.pieces = self.pieces or [()] * len(self.vertices)

    def __len__(self) -> int:
        return len(self.vertices)

    def with_shapes(self, other: Library) -> Library:
        """This library and the shapes of another after its own, whose ids stay what they are."""
        later = other.table.assign(shape=other.table["shape"] + len(self))
        return Library(
            self.vertices + other.vertices,
            self.faces + other.faces,
            pd.concat([self.table, later], ignore_index=True),
            pd.concat([self.skipped, other.skipped], ignore_index=True),
            self.pieces + other.pieces,
        )

    def mesh(self, shape: int) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and faces of a shape; id −1 is a sphere."""
        return sphere() if shape == SPHERE else (self.vertices[shape], self.faces[shape])

    def meshes(self, phase: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Vertices and faces of all shapes of a mineral."""
        return [self.mesh(shape) for shape in self.table.loc[self.table["phase"] == phase, "shape"]]

    def save(self, folder: str | Path) -> None:
        """Write ``shapes.npz``, ``library.csv`` and ``skipped.csv``; equal content gives equal bytes."""
        folder = Path(folder)
        flat = [piece for cut in self.pieces for piece in cut]
        arrays = {
            "vertices": np.concatenate([v.astype(np.float32) for v in self.vertices]),
            "vertex_counts": np.array([len(v) for v in self.vertices], dtype=np.int64),
            "faces": np.concatenate(self.faces).astype(np.int32),
            "face_counts": np.array([len(f) for f in self.faces], dtype=np.int64),
            "pieces": np.concatenate([np.empty((0, 3)), *flat]).astype(np.float32),
            "piece_counts": np.array([len(p) for p in flat], dtype=np.int64),
            "pieces_a_shape": np.array([len(cut) for cut in self.pieces], dtype=np.int64),
        }
        io.write_arrays(folder / "shapes.npz", arrays)
        io.write_table(folder / "library.csv", self.table)
        io.write_table(folder / "skipped.csv", self.skipped)

    @classmethod
    def load(cls, folder: str | Path) -> Library:
        """Read what :meth:`save` wrote.

        Raises
        ------
        InputError
            Where the folder holds no complete library.
        """
        folder = Path(folder)
        arrays = io.read_arrays(folder / "shapes.npz")
        if missing := sorted(ARRAYS - set(arrays)):
            raise InputError(
                folder / "shapes.npz", f"has no {missing[0]}", "delete it, so that it is made again"
            )
        vertices, faces, flat = (
            np.split(arrays[name], np.cumsum(arrays[counts]))[:-1]
            for name, counts in (
                ("vertices", "vertex_counts"),
                ("faces", "face_counts"),
                ("pieces", "piece_counts"),
            )
        )
        ends = np.cumsum(arrays["pieces_a_shape"])
        return cls(
            [v.astype(np.float64) for v in vertices],
            faces,
            io.read_table(folder / "library.csv"),
            io.read_table(folder / "skipped.csv"),
            [
                tuple(piece.astype(np.float64) for piece in flat[end - n : end])
                for end, n in zip(ends, arrays["pieces_a_shape"], strict=True)
            ],
        )


def sphere(subdivisions: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a sphere as library shapes are: volume 4π/3, centre at the origin."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    return ball.vertices * np.cbrt(_UNIT_VOLUME / ball.volume), ball.faces.astype(np.int32)


def build_library(
    labels: np.ndarray,
    grains2d: pd.DataFrame,
    shapes_per_phase: int,
    rng: np.random.Generator,
    *,
    candidates: int = 12,
    resolution: int | None = None,
    pieces: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Library:
    """Draw masks, three to a grain, and build the shapes of every mineral, cut into convex pieces.

    The first mask is drawn from the mineral's uncut grains by their Miles–Lantuéjoul weights, the other two
    by the same weights from its size bin (equal counts of a dozen masks or more, at most ten bins). Each is
    turned at random in its plane, as isotropy has it. Of several such draws of the other two, the one is kept
    that needs the least stretch: masks that could belong to one grain make sections nearer to the masks than
    masks that are forced together.

    Parameters
    ----------
    labels : (y, x) int ndarray
        Grains of the section.
    grains2d : DataFrame
        Columns grain, phase, r_um, border, weight.
    shapes_per_phase : int
    rng : numpy.random.Generator
    candidates : int
        Draws of the second and third mask for each shape; 1 takes the first that comes.
    resolution : int, optional
        Points around the equator, see :func:`~grainfall.grains.grain_from_masks`.
    pieces : bool
        Whether shapes are cut; who only looks at them need not wait for it.
    progress : callable, optional
        Is told in a line of each shape made.

    Returns
    -------
    Library

    Raises
    ------
    InputError
        Where there is no grain, or a phase has no usable mask.
    """
    if grains2d.empty:
        raise InputError("grains2d", "there is no grain", "give a section with grains")
    usable, skipped = _contours(labels, grains2d)
    shapes, rows = [], []
    total = shapes_per_phase * grains2d["phase"].nunique()
    for phase in sorted(grains2d["phase"].unique()):
        masks = usable[usable["phase"] == phase]
        if masks.empty:
            raise InputError(
                f"phase {phase}",
                "no grain of it has a usable mask (uncut by the border, at least 16 pixels and 3 wide)",
                "give a larger or finer section, or merge the phase with another",
            )
        radius, weight = masks["r_um"].to_numpy(), masks["weight"].to_numpy()
        bins = _size_bins(radius)
        for _ in range(shapes_per_phase):
            chosen, contours = _three_masks(masks["contour"].to_list(), bins, weight, candidates, rng)
            grain = grain_from_contours(contours, resolution=resolution)
            vertices, properties = _normalised(grain)
            parts, parts_excess = cut(vertices, grain.faces) if pieces else ((), np.nan)
            shapes.append((vertices, grain.faces, parts))
            rows.append(
                {
                    "shape": len(rows),
                    "phase": int(phase),
                    "r2d_um": radius[chosen[0]],
                    **{
                        f"mask_{p}": int(masks["grain"].iloc[i]) for p, i in zip(_PLANES, chosen, strict=True)
                    },
                    "stretch": grain.stretch,
                    **{f"iou_{p}": value for p, value in zip(_PLANES, grain.iou, strict=True)},
                    "reading": grain.reading,
                    **properties,
                    "pieces": len(parts),
                    "parts_excess": parts_excess,
                }
            )
            if progress is not None:
                excess = f"hull excess {properties['hull_excess']:.3f}"
                excess += f", {parts_excess:.3f} in {len(parts)} pieces" if parts else ", left whole"
                progress(f"shape {len(rows)} of {total}: {excess}")
    vertices, faces, cuts = (list(part) for part in zip(*shapes, strict=True))
    return Library(vertices, faces, pd.DataFrame(rows), skipped, cuts)


def cut(vertices: np.ndarray, faces: np.ndarray) -> tuple[tuple[np.ndarray, ...], float]:
    """Convex pieces of a shape, where they resolve it better than its hull does.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int

    Returns
    -------
    pieces : tuple of (k, 3) ndarray
        As float32 keeps them; none where the hull's excess is below :data:`SMALLEST_EXCESS`, where the mesh
        cannot be cut, or where the union of the pieces is no smaller than the hull.
    excess : float
        V_union / V − 1; NaN without pieces.
    """
    volume = mass_properties(vertices, faces)[0]
    hull_excess = scipy.spatial.ConvexHull(vertices).volume / volume - 1
    if hull_excess < SMALLEST_EXCESS:
        return (), np.nan
    pieces = tuple(p.astype(np.float32).astype(np.float64) for p in decompose(vertices, faces))
    excess = union_volume(pieces) / volume - 1 if len(pieces) > 1 else np.inf
    return (pieces, excess) if excess < hull_excess else ((), np.nan)


def _contours(labels: np.ndarray, grains2d: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Uncut grains with the contours of their masks, and the masks that have none."""
    uncut = grains2d[~grains2d["border"]]
    found, reasons = [], []
    for mask in grain_masks(labels, grains2d):
        try:
            found.append(unit_contour(mask))
            reasons.append("")
        except Unusable as fault:
            found.append(None)
            reasons.append(str(fault))
    uncut = uncut.assign(contour=found, reason=reasons)
    usable = uncut["reason"] == ""
    return uncut[usable], uncut.loc[~usable, ["grain", "phase", "reason"]].reset_index(drop=True)


def _size_bins(radius: np.ndarray) -> np.ndarray:
    """Bin of each radius: bins of equal count, in order of size."""
    count = int(np.clip(len(radius) // _MASKS_A_BIN, 1, _MOST_BINS))
    rank = np.empty(len(radius), dtype=int)
    rank[np.argsort(radius, kind="stable")] = np.arange(len(radius))
    return rank * count // len(radius)


def _draw(rng: np.random.Generator, weight: np.ndarray) -> int:
    return int(rng.choice(len(weight), p=weight / weight.sum()))


def _three_masks(
    contours: list[np.ndarray],
    bins: np.ndarray,
    weight: np.ndarray,
    candidates: int,
    rng: np.random.Generator,
) -> tuple[list[int], list[np.ndarray]]:
    """Masks of one size bin and their turned contours: the draw of least stretch among the candidates."""
    first = _draw(rng, weight)
    near = np.flatnonzero(bins == bins[first])
    best = None
    for _ in range(candidates):
        chosen = [first, *(int(near[_draw(rng, weight[near])]) for _ in range(2))]
        turned = [_turned(contours[i], rng.uniform(0, 2 * np.pi)) for i in chosen]
        _, stretch = agreed_half_axes(np.array([half_axes_seen(c) for c in turned]))
        if best is None or stretch < best[0]:
            best = stretch, chosen, turned
    return best[1:]


def _turned(contour: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return contour @ np.array([[c, s], [-s, c]])


def _normalised(grain: Grain) -> tuple[np.ndarray, dict[str, float]]:
    """Vertices at volume 4π/3 about the centre of mass, as float32 keeps them, and their figures."""
    volume, centre, _ = mass_properties(grain.vertices, grain.faces)
    vertices = (grain.vertices - centre) * np.cbrt(_UNIT_VOLUME / volume)
    vertices = vertices.astype(np.float32).astype(np.float64)
    volume, _, inertia = mass_properties(vertices, grain.faces)
    moments = np.linalg.eigvalsh(inertia)
    axes = np.sqrt(moments.sum() / 2 - moments)  # of the ellipsoid of equal inertia, longest first
    area = trimesh.triangles.area(vertices[grain.faces]).sum()
    return vertices, {
        "hull_excess": scipy.spatial.ConvexHull(vertices).volume / volume - 1,
        "aspect_ratio": axes[0] / axes[2],
        "elongation": axes[1] / axes[0],
        "flatness": axes[2] / axes[1],
        "sphericity": np.cbrt(np.pi) * (6 * volume) ** (2 / 3) / area,
        **{f"inertia_{name}": inertia[k] for name, k in _INERTIA.items()},
    }
