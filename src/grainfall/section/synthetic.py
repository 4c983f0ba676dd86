"""A synthetic granular rock of known 3D truth, made by a process independent of the reconstruction.

Hard spheres relaxed without gravity in a periodic box become superellipsoids; these grow, as far as their
neighbours let them, to the porosity of the packed rock; then some are dissolved, one by one or vug by vug.
Nothing here pours, unfolds or joins masks, so the truth can judge all three.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numba import njit
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from grainfall.errors import InputError

EXPONENT = 3.0
"""Superellipsoid |u/a|^3 + |v/b|^3 + |w/c|^3 = 1: a block with rounded edges, between ball and box."""

RAREST_VUG = 1e-3
"""Share of random points within a vug's radius of a grain's centre below which drawing vugs would not end."""

MOST_GROWTH = 1.6
"""Largest linear growth of a grain towards the porosity of the packed rock."""


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
    sizes : ndarray, optional
        Radii to draw from instead of a lognormal distribution.
    """

    name: str
    fraction: float
    radius_um: float
    cv: float = 0.25
    elongation: float = 0.15
    sizes: np.ndarray | None = None


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
    bodies : _Bodies
        The grains behind the voxels, so that a plane can be cut at any pixel size.
    """

    phase: np.ndarray
    grain: np.ndarray
    voxel_size_um: float
    phases: tuple[str, ...]
    bodies: _Bodies

    def section(self, pixel_size_um: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The middle horizontal plane, cut from the grains themselves.

        Parameters
        ----------
        pixel_size_um : float, optional
            Edge of a pixel, the voxel's if omitted.

        Returns
        -------
        phase : ndarray of uint8, (y, x)
        grain : ndarray of int32, (y, x)
            Grain number + 1, 0 in the pores.

        Raises
        ------
        InputError
            When the box is no whole number of pixels wide.
        """
        pixel = self.voxel_size_um if pixel_size_um is None else float(pixel_size_um)
        shape = tuple(round(n * self.voxel_size_um / pixel) for n in self.phase.shape)
        if not np.allclose(np.array(shape) * pixel, np.array(self.phase.shape) * self.voxel_size_um):
            raise InputError(
                "pixel_size_um",
                f"{pixel} does not divide the truth's box",
                f"{self.voxel_size_um} um over a whole number",
            )
        grain = self.bodies.voxels(pixel, shape, (shape[0] // 2, shape[0] // 2 + 1))[0][0]
        return self.bodies.phase[grain], grain

    def cubes(self, edge: int, number: int = 1) -> list[np.ndarray]:
        """The phases of cubes that stand for the whole.

        Of those in steps of half an edge, the ones whose porosity is nearest to the truth's, without a voxel
        in common; the nearest first.

        Parameters
        ----------
        edge : int
            Voxels; as much of each axis as there is where the truth is shorter.
        number : int

        Returns
        -------
        list of ndarray of uint8, (z, y, x)

        Raises
        ------
        InputError
            When there are not so many.
        """
        edges = [min(edge, n) for n in self.phase.shape]
        steps = [range(0, n - e + 1, max(1, edge // 2)) for n, e in zip(self.phase.shape, edges, strict=True)]
        whole = np.count_nonzero(self.phase == 0) / self.phase.size

        def cube(corner: tuple[int, ...]) -> np.ndarray:
            return self.phase[tuple(slice(c, c + e) for c, e in zip(corner, edges, strict=True))]

        def miss(corner: tuple[int, ...]) -> float:
            return abs(np.count_nonzero(cube(corner) == 0) / math.prod(edges) - whole)

        def apart(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
            return any(abs(a - b) >= e for a, b, e in zip(one, other, edges, strict=True))

        taken: list[tuple[int, ...]] = []
        for corner in sorted(itertools.product(*steps), key=miss):
            if len(taken) < number and all(apart(corner, other) for other in taken):
                taken.append(corner)
        if len(taken) < number:
            raise InputError(
                "reference_cubes",
                f"only {len(taken)} cubes of {edge} voxels, each the nearest to the truth's porosity that "
                f"shares no voxel with those before it, were found, not {number}",
                "a larger synthetic.shape (cv_sweep.grains), a smaller synthetic.reference_edge "
                "(cv_sweep.edge), or fewer",
            )
        return [cube(corner) for corner in taken]

    def sizes(self) -> pd.DataFrame:
        """True grains, whole as the box is periodic: phase and r_um, the equal-volume radius as voxelised."""
        count = np.bincount(self.grain.ravel(), minlength=self.bodies.phase.size)
        kept = np.flatnonzero(count[1:]) + 1
        radius = (3 * count[kept] / (4 * np.pi)) ** (1 / 3) * self.voxel_size_um
        return pd.DataFrame({"phase": self.bodies.phase[kept].astype(int), "r_um": radius})


@dataclass(frozen=True)
class _Bodies:
    """Superellipsoids in a periodic box; a point belongs to the one in which its level is least.

    Attributes
    ----------
    centre : (n, 3) float
        x, y, z in micrometres.
    frame : (n, 3, 3) float
        Lab to body axes over the half-axes, per micrometre: the level at ``d`` from the centre is
        sum |frame d|^exponent, 1 on the surface as relaxed.
    reach : (n,) float
        Distance beyond which the level exceeds 1, micrometres.
    level : (n,) float
        Level up to which each grain is solid: above 1 grown, 0 dissolved.
    phase : (n + 1,) uint8
        Mineral by grain number + 1; 0 for the pore.
    exponent : float
    """

    centre: np.ndarray
    frame: np.ndarray
    reach: np.ndarray
    level: np.ndarray
    phase: np.ndarray
    exponent: float

    def voxels(
        self, voxel_um: float, shape: tuple[int, ...], planes: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Grain number + 1 and level on planes [first, last) of a periodic grid of ``shape`` (z, y, x)."""
        most = float(self.level.max())
        grain, level = _voxelise(
            self.centre / voxel_um, self.frame * voxel_um,
            self.reach / voxel_um * most ** (1 / self.exponent), shape, planes, most, self.exponent,
        )  # fmt: skip
        grain[level >= np.concatenate([[np.inf], self.level]).astype(np.float32)[grain]] = 0
        return grain, level


def synthesise(
    rng: np.random.Generator,
    shape: Sequence[int],
    voxel_size_um: float,
    minerals: Sequence[Mineral],
    *,
    exponent: float = EXPONENT,
    solid_fraction: float = 0.6,
    packed_porosity: float | None = None,
    dissolved: float = 0.0,
    porosity: float | None = None,
    vug_radius_um: float = 0.0,
) -> Truth:
    """Make a synthetic granular rock.

    Radii are lognormal per mineral. Spheres in their proportions, filling ``solid_fraction`` of a periodic
    box, are relaxed from random positions until none overlaps by more than a percent (near a fraction of
    0.63, two); each becomes a superellipsoid of the same volume with random axes and orientation, and a voxel
    within two of them belongs to the one in which its level is lower. Where a ``packed_porosity`` is asked
    for, all grow (or shrink) to the one level that leaves it, and flatten where they meet; the radii asked
    for are those of the grown grains. Then a share of the grains, drawn at random, is dissolved; or vugs are,
    until a porosity is met.

    Parameters
    ----------
    rng : numpy.random.Generator
    shape : sequence of 3 int
        Voxels (z, y, x).
    voxel_size_um : float
    minerals : sequence of Mineral
    exponent : float
        Of the superellipsoids: 2 gives ellipsoids, larger ones blocks.
    solid_fraction : float
        Solid volume over box volume of the relaxed spheres; must stay below random close packing, about 0.64.
    packed_porosity : float, optional
        Porosity before dissolution, met to a voxel; as relaxed if omitted.
    dissolved : float
        Share of the grains removed, 0 to below 1.
    porosity : float, optional
        Porosity after dissolution, met to a voxel instead of by ``dissolved``: the last grain dissolves from
        its surface inwards.
    vug_radius_um : float
        With ``porosity``: all grains whose centre lies so near to a random point go together, the nearest
        first; 0 takes single grains.

    Returns
    -------
    Truth

    Raises
    ------
    InputError
        When a fraction cannot be had.
    """
    _check_fractions(solid_fraction, packed_porosity, dissolved, porosity)
    total = sum(m.fraction for m in minerals)
    if not minerals or total <= 0:
        raise InputError("synthetic.minerals", "no solid", "at least one mineral with fraction > 0")

    shape = tuple(int(n) for n in shape)
    box = np.array(shape[::-1], dtype=float) * voxel_size_um
    wanted = solid_fraction if packed_porosity is None else 1 - packed_porosity
    radius, phase, axes = [], [], []
    for number, mineral in enumerate(minerals, start=1):
        r = _radii(rng, mineral, box.prod() * wanted * mineral.fraction / total)
        stretch = rng.normal(0.0, mineral.elongation, (r.size, 3))
        radius.append(r * (solid_fraction / wanted) ** (1 / 3))
        phase.append(np.full(r.size, number, dtype=np.uint8))
        axes.append(np.exp(stretch - stretch.mean(axis=1, keepdims=True)))
    radius, phase, axes = np.concatenate(radius), np.concatenate(phase), np.concatenate(axes)
    if 4 * radius.max() > box.min():
        raise InputError(
            "synthetic.shape", "the box is less than two of its largest grains wide", "a larger shape"
        )

    centre = _relax(rng.random((radius.size, 3)) * box, radius, box)
    unit_volume = 8 * math.gamma(1 + 1 / exponent) ** 3 / math.gamma(1 + 3 / exponent)
    half = axes * (radius * (4 * np.pi / 3 / unit_volume) ** (1 / 3))[:, None]
    frame = Rotation.random(radius.size, rng=rng).as_matrix() / half[:, :, None]
    # a superellipsoid of a higher exponent than 2 reaches out to its corners
    reach = np.sqrt((half**2).sum(axis=1)) if exponent > 2 else half.max(axis=1)
    whole = np.concatenate([[0], phase]).astype(np.uint8)

    def bodies(level: np.ndarray) -> _Bodies:
        return _Bodies(centre, frame, reach, level, whole, float(exponent))

    most = 1.0 if packed_porosity is None else MOST_GROWTH**exponent
    grain, levels = bodies(np.full(radius.size, most)).voxels(voxel_size_um, shape, (0, shape[0]))
    surface = most
    if packed_porosity is not None:
        count = round((1 - packed_porosity) * grain.size)
        if np.count_nonzero(grain) < count:
            raise InputError(
                "synthetic.packed_porosity",
                f"{packed_porosity} needs grains to grow beyond {MOST_GROWTH:g} times their size",
                "a larger solid_fraction or porosity",
            )
        surface = _first_to_go(levels.ravel(), count)
        grain[levels >= surface] = 0
    level = np.full(radius.size, float(surface))
    if porosity is not None:
        _dissolve_to(rng, porosity, vug_radius_um, box, centre, level, grain, levels)
    else:
        level[rng.random(radius.size) < dissolved] = 0.0
    grain[levels >= np.concatenate([[np.inf], level]).astype(np.float32)[grain]] = 0
    return Truth(
        whole[grain], grain, float(voxel_size_um), ("pore", *(m.name for m in minerals)), bodies(level)
    )


def _check_fractions(
    solid_fraction: float, packed_porosity: float | None, dissolved: float, porosity: float | None
) -> None:
    if not 0 < solid_fraction <= 0.63:
        raise InputError(
            "synthetic.solid_fraction",
            f"{solid_fraction} cannot be relaxed to hard grains",
            "0 < solid_fraction <= 0.63",
        )
    if not 0 <= dissolved < 1:
        raise InputError("synthetic.dissolved", f"{dissolved} is no share", "0 <= dissolved < 1")
    for name, value in (("packed_porosity", packed_porosity), ("porosity", porosity)):
        if value is not None and not 0 < value < 1:
            raise InputError(f"synthetic.{name}", f"{value} is no porosity", "between 0 and 1")
    if porosity is not None and dissolved:
        raise InputError("synthetic.dissolved", "is given beside a porosity to dissolve to", "leave it 0")
    packed = 1 - solid_fraction if packed_porosity is None else packed_porosity
    if porosity is not None and porosity < packed:
        raise InputError(
            "synthetic.porosity",
            f"{porosity} is below the {packed:.4g} of the packed rock",
            "a smaller packed_porosity: dissolution opens pores only",
        )


def _first_to_go(levels: np.ndarray, count: int) -> np.float32:
    """The level such that ``count`` values lie below it (ties aside)."""
    if count >= levels.size:
        return np.float32(np.inf)
    return np.partition(levels, count)[count]


def _dissolve_to(rng, porosity, vug_radius_um, box, centre, level, grain, levels) -> None:
    """Lower the levels of grains, vug by vug, until what is left has the porosity."""
    volume = np.bincount(grain.ravel(), minlength=len(level) + 1)[1:]
    surplus = int(volume.sum()) - round((1 - porosity) * grain.size)
    tree = cKDTree(centre % box, boxsize=box)
    hit = len(level) * 4 / 3 * np.pi * vug_radius_um**3 / box.prod()
    if surplus > 0 and 0 < hit < RAREST_VUG:
        raise InputError(
            "synthetic.vug_radius_um",
            f"a vug of {vug_radius_um:.4g} um meets a grain's centre once in {1 / hit:.2g} times",
            "a radius about that of a grain or larger; 0 dissolves grains one by one",
        )
    while surplus > 0:
        point = rng.random(3) * box
        alive = np.flatnonzero(level > 0)
        near = [g for g in tree.query_ball_point(point, vug_radius_um) if level[g] > 0]
        if not near and not vug_radius_um:
            near = [alive[np.argmin(_distance(centre[alive], point, box))]]
        for g in sorted(near, key=lambda g: (_distance(centre[g], point, box), g)):
            if surplus <= 0:
                break
            if volume[g] <= surplus:
                level[g] = 0.0
            else:
                own = levels[grain == g + 1]
                level[g] = float(_first_to_go(own, volume[g] - surplus))
            surplus -= min(volume[g], surplus)


def _distance(x: np.ndarray, point: np.ndarray, box: np.ndarray) -> np.ndarray:
    d = x - point
    return np.sqrt(((d - box * np.round(d / box)) ** 2).sum(axis=-1))


def _radii(rng: np.random.Generator, mineral: Mineral, volume: float) -> np.ndarray:
    """Radii whose spheres add up to ``volume``, the last of them to a little more."""
    sigma2 = math.log(1 + mineral.cv**2)
    cubed = (
        mineral.radius_um**3 * math.exp(3 * sigma2) if mineral.sizes is None else (mineral.sizes**3).mean()
    )
    n = max(4, int(2 * volume / (4 / 3 * np.pi * cubed)) + 16)
    if mineral.sizes is None:
        r = rng.lognormal(math.log(mineral.radius_um) - sigma2 / 2, math.sqrt(sigma2), n)
    else:
        r = rng.choice(mineral.sizes, n)
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
def _voxelise(centre, frame, reach, shape, planes, most, exponent):
    """Number + 1 of the grain with the lowest level below ``most``, and that level, on planes of a periodic
    grid."""
    nz, ny, nx = shape
    first, last = planes
    grain = np.zeros((last - first, ny, nx), dtype=np.int32)
    level = np.full((last - first, ny, nx), np.float32(most), dtype=np.float32)
    for g in range(centre.shape[0]):
        cx, cy, cz = centre[g]
        m = frame[g]
        h = reach[g]
        for kz in range(int(np.floor(cz - h)), int(np.ceil(cz + h)) + 1):
            z = kz % nz - first
            if z < 0 or z >= last - first:
                continue
            dz = kz + 0.5 - cz
            for ky in range(int(np.floor(cy - h)), int(np.ceil(cy + h)) + 1):
                dy = ky + 0.5 - cy
                for kx in range(int(np.floor(cx - h)), int(np.ceil(cx + h)) + 1):
                    dx = kx + 0.5 - cx
                    u = abs(m[0, 0] * dx + m[0, 1] * dy + m[0, 2] * dz)
                    v = abs(m[1, 0] * dx + m[1, 1] * dy + m[1, 2] * dz)
                    w = abs(m[2, 0] * dx + m[2, 1] * dy + m[2, 2] * dz)
                    if exponent == 2.0:
                        f = np.float32(u * u + v * v + w * w)
                    elif exponent == 3.0:
                        f = np.float32(u * u * u + v * v * v + w * w * w)
                    else:
                        f = np.float32(u**exponent + v**exponent + w**exponent)
                    y, x = ky % ny, kx % nx
                    if f < level[z, y, x]:
                        level[z, y, x] = f
                        grain[z, y, x] = g + 1
    return grain, level
