"""A synthetic granular rock of known 3D truth, made by a process independent of the reconstruction.

Hard superellipsoids, relaxed without gravity in a periodic box, lose some of their number to
"dissolution". Nothing here pours, unfolds or joins masks, so the truth can judge all three.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numba import njit
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from grainfall.errors import InputError

EXPONENT = 3
"""Superellipsoid |u/a|^3 + |v/b|^3 + |w/c|^3 = 1: a block with rounded edges, between ball and box."""

_UNIT_VOLUME = 8 * math.gamma(1 + 1 / EXPONENT) ** 3 / math.gamma(1 + 3 / EXPONENT)


@dataclass(frozen=True)
class Mineral:
    """One granular phase of the synthetic rock.

    Parameters
    ----------
    name : str
    fraction : float
        Share of the solid volume before dissolution, 0 to 1.
    radius_um : float
        Mean equal-volume radius in micrometres.
    cv : float
        Coefficient of variation of the radius (lognormal).
    elongation : float
        Standard deviation of the logarithm of the half-axes; 0 gives equal axes.
    """

    name: str
    fraction: float
    radius_um: float
    cv: float = 0.25
    elongation: float = 0.15


@dataclass(frozen=True)
class Truth:
    """The synthetic rock on its voxels.

    Attributes
    ----------
    phase : ndarray of uint8, (z, y, x)
        0 pore, 1…M minerals in the order given.
    grain : ndarray of int32, (z, y, x)
        Grain number + 1, 0 in the pores.
    voxel_size_um : float
    phases : tuple of str
        ``("pore", mineral, …)``.
    """

    phase: np.ndarray
    grain: np.ndarray
    voxel_size_um: float
    phases: tuple[str, ...]

    def section(self, z: int | None = None) -> np.ndarray:
        """The phase map (y, x) of one horizontal plane; the middle one if not said otherwise."""
        return self.phase[self.phase.shape[0] // 2 if z is None else z]

    def sizes(self) -> pd.DataFrame:
        """True grains, whole as the box is periodic: phase and r_um, the equal-volume radius as voxelised."""
        count = np.bincount(self.grain.ravel())
        phase = np.zeros(count.size, dtype=np.int64)
        phase[self.grain.ravel()] = self.phase.ravel()
        kept = np.flatnonzero(count[1:]) + 1
        radius = (3 * count[kept] / (4 * np.pi)) ** (1 / 3) * self.voxel_size_um
        return pd.DataFrame({"phase": phase[kept], "r_um": radius})


def synthesise(
    rng: np.random.Generator,
    shape: Sequence[int],
    voxel_size_um: float,
    minerals: Sequence[Mineral],
    *,
    solid_fraction: float = 0.6,
    dissolved: float = 0.0,
) -> Truth:
    """Make a synthetic granular rock.

    Radii are lognormal per mineral and fill ``solid_fraction`` of a periodic box; spheres of those
    radii are relaxed from random positions until none overlaps by more than a percent; each becomes a
    superellipsoid of the same volume with random axes and orientation, and a voxel within two of
    them belongs to the one it lies deeper in. Then ``dissolved`` of all grains, drawn at random, are removed.

    Parameters
    ----------
    rng : numpy.random.Generator
    shape : sequence of 3 int
        Voxels (z, y, x).
    voxel_size_um : float
    minerals : sequence of Mineral
    solid_fraction : float
        Solid volume over box volume before shapes clip each other; must stay below random close
        packing, about 0.64.
    dissolved : float
        Share of the grains removed, 0 to below 1.

    Returns
    -------
    Truth

    Raises
    ------
    InputError
        When a fraction cannot be had.
    """
    if not 0 < solid_fraction <= 0.63:
        raise InputError(
            "synthetic.solid_fraction",
            f"{solid_fraction} cannot be relaxed to hard grains",
            "0 < solid_fraction <= 0.63",
        )
    if not 0 <= dissolved < 1:
        raise InputError("synthetic.dissolved", f"{dissolved} is no share", "0 <= dissolved < 1")
    total = sum(m.fraction for m in minerals)
    if not minerals or total <= 0:
        raise InputError("synthetic.minerals", "no solid", "at least one mineral with fraction > 0")

    box = np.array(shape[::-1], dtype=float) * voxel_size_um
    solid = box.prod() * solid_fraction
    radius, phase, axes = [], [], []
    for number, mineral in enumerate(minerals, start=1):
        r = _radii(rng, mineral, solid * mineral.fraction / total)
        stretch = rng.normal(0.0, mineral.elongation, (r.size, 3))
        radius.append(r)
        phase.append(np.full(r.size, number, dtype=np.uint8))
        axes.append(np.exp(stretch - stretch.mean(axis=1, keepdims=True)))
    radius, phase, axes = np.concatenate(radius), np.concatenate(phase), np.concatenate(axes)
    if 4 * radius.max() > box.min():
        raise InputError(
            "synthetic.shape", "the box is less than two of its largest grains wide", "a larger shape"
        )

    centre = _relax(rng.random((radius.size, 3)) * box, radius, box)
    keep = rng.random(radius.size) >= dissolved
    half = axes * (radius * (4 * np.pi / 3 / _UNIT_VOLUME) ** (1 / 3))[:, None]
    frame = Rotation.random(radius.size, rng=rng).as_matrix() / half[:, :, None]
    grain = _voxelise(
        centre[keep] / voxel_size_um,
        frame[keep] * voxel_size_um,
        np.sqrt((half[keep] ** 2).sum(axis=1)) / voxel_size_um,
        tuple(int(n) for n in shape),
    )
    lut = np.concatenate([[0], phase[keep]]).astype(np.uint8)
    return Truth(lut[grain], grain, float(voxel_size_um), ("pore", *(m.name for m in minerals)))


def _radii(rng: np.random.Generator, mineral: Mineral, volume: float) -> np.ndarray:
    """Lognormal radii whose spheres add up to ``volume`` as nearly as whole grains can."""
    sigma2 = math.log(1 + mineral.cv**2)
    mean_volume = 4 / 3 * np.pi * mineral.radius_um**3 * math.exp(3 * sigma2)
    n = max(4, int(2 * volume / mean_volume) + 16)
    r = rng.lognormal(math.log(mineral.radius_um) - sigma2 / 2, math.sqrt(sigma2), n)
    filled = np.cumsum(4 / 3 * np.pi * r**3)
    return r[: max(1, int(np.searchsorted(filled, volume)) + 1)]


def _relax(
    x: np.ndarray, r: np.ndarray, box: np.ndarray, tolerance: float = 0.01, most: int = 4000
) -> np.ndarray:
    """Push overlapping periodic spheres apart until the largest overlap is below ``tolerance`` radii."""
    skin = 0.3 * r.mean()
    pairs, moved = None, np.inf
    for _ in range(most):
        if moved > skin / 2:
            x %= box
            x[x >= box] = 0.0  # the remainder of a tiny negative number rounds up to the box itself
            pairs = cKDTree(x, boxsize=box).query_pairs(2 * r.max() + skin, output_type="ndarray")
            near = _gap(x, r, box, pairs) < skin
            pairs = pairs[near]
            pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
            start = x.copy()
        worst = _push(x, r, box, pairs)
        if worst < tolerance:
            break
        moved = np.sqrt(((x - start) ** 2).sum(axis=1)).max()
    return x % box


def _gap(x: np.ndarray, r: np.ndarray, box: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    d = x[pairs[:, 0]] - x[pairs[:, 1]]
    d -= box * np.round(d / box)
    return np.sqrt((d**2).sum(axis=1)) - r[pairs[:, 0]] - r[pairs[:, 1]]


@njit(cache=True)
def _push(x, r, box, pairs):
    """One sweep parts each overlapping pair, the smaller sphere moving more; the largest relative overlap."""
    worst = 0.0
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        d2 = 0.0
        d = np.empty(3)
        for c in range(3):
            d[c] = x[i, c] - x[j, c]
            d[c] -= box[c] * np.round(d[c] / box[c])
            d2 += d[c] * d[c]
        reach = r[i] + r[j]
        if d2 >= reach * reach:
            continue
        length = max(np.sqrt(d2), 1e-9 * reach)
        overlap = reach - length
        worst = max(worst, overlap / min(r[i], r[j]))
        share = r[j] ** 3 / (r[i] ** 3 + r[j] ** 3)
        for c in range(3):
            step = 0.6 * overlap * d[c] / length
            x[i, c] += step * share
            x[j, c] -= step * (1 - share)
    return worst


@njit(cache=True)
def _voxelise(centre, frame, reach, shape):
    """Grain number + 1 on a periodic grid; the deeper superellipsoid wins where two meet."""
    nz, ny, nx = shape
    grain = np.zeros((nz, ny, nx), dtype=np.int32)
    depth = np.ones((nz, ny, nx), dtype=np.float32)
    for g in range(centre.shape[0]):
        cx, cy, cz = centre[g]
        m = frame[g]
        h = reach[g]
        for kz in range(int(np.floor(cz - h)), int(np.ceil(cz + h)) + 1):
            dz = kz + 0.5 - cz
            for ky in range(int(np.floor(cy - h)), int(np.ceil(cy + h)) + 1):
                dy = ky + 0.5 - cy
                for kx in range(int(np.floor(cx - h)), int(np.ceil(cx + h)) + 1):
                    dx = kx + 0.5 - cx
                    u = abs(m[0, 0] * dx + m[0, 1] * dy + m[0, 2] * dz)
                    v = abs(m[1, 0] * dx + m[1, 1] * dy + m[1, 2] * dz)
                    w = abs(m[2, 0] * dx + m[2, 1] * dy + m[2, 2] * dz)
                    f = np.float32(u * u * u + v * v * v + w * w * w)
                    z, y, x = kz % nz, ky % ny, kx % nx
                    if f < depth[z, y, x]:
                        depth[z, y, x] = f
                        grain[z, y, x] = g + 1
    return grain
