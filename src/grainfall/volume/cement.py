"""Cement: overgrowth rims on the grains, down to the target porosity, and the surface that they take away."""

from __future__ import annotations

import time

import edt
import numpy as np
import pandas as pd

from grainfall.surface import CORE, specific_surface
from grainfall.volume.measures import porosity
from grainfall.volume.scan import Meshes, surface_distances, voxelise

FIRST_STEP, STEP = 0.005, 0.0005
"""Share of the pores that is tried first as filled, and the one to which it is found."""

MOST_FILLED = 0.95
"""Share of the pores that rims are tried up to."""

SCATTER = np.array([3518319155, 2882110345, 2360945575], np.uint64)
"""Multipliers of the additive recurrence in three dimensions: 2^32 over powers of the root of x^4 = x + 1."""


def cement(
    bodies: pd.DataFrame,
    library: Meshes,
    shape: tuple[int, int, int],
    voxel_size_um: float,
    target: float,
    label: int,
    *,
    threads: int = 1,
) -> tuple[np.ndarray, np.ndarray, dict]:
    """Bodies as voxels, with rims of even thickness down to the target porosity.

    Parameters
    ----------
    bodies : DataFrame
        Grains in um from the region's corner (columns as :func:`grainfall.volume.voxelise` takes), those
        around the region too: their rims grow into it.
    library : Library
        Meshes of the shapes.
    shape : (nz, ny, nx)
        Voxels of the region.
    voxel_size_um : float
        Edge of a voxel.
    target : float
        Porosity wanted; nothing grows where it is reached, or where the region holds no grain.
    label : int
        Phase of the cement.
    threads : int
        Slabs voxelised at the same time.

    Returns
    -------
    phase : (nz, ny, nx) uint8
        0 pore, the grains' phases, ``label`` in the rims.
    body : (nz, ny, nx) int32
        Body id + 1, 0 pore; a rim belongs to the grain it grew on, the nearest.
    report : dict
        target, before and after (porosity), share (of the region), rim_um (its thickness), wall_s.

    Notes
    -----
    Overgrowth in proportion to nothing but the distance is the isotropic cementation of process-based
    reconstructions (Bakke and Øren, SPE Journal 2, 136, 1997, with exponent 0). A voxel is cemented when its
    centre lies within the rim, as it is solid when it lies in the grain: distances are those to the grains'
    own surfaces. Distances to voxels would grow rims by whole shells, and whatever part of the last shell is
    filled first would smooth or roughen all surfaces: the surface left would scatter by a tenth with the
    thickness, and permeability with it.
    """
    started = time.perf_counter()
    shape = tuple(int(n) for n in shape)
    rims = _Rims(bodies, library, shape, voxel_size_um, threads=threads)
    before = porosity(rims.phase)
    rim, number = 0.0, _missing(rims.phase, target)
    if number > 0 and rims.phase.any():
        filled, rim = rims.first(number)
        nearest = rims.nearest.ravel()[filled]
        rims.phase.ravel()[filled] = label
        rims.body.ravel()[filled] = nearest
    return (
        rims.phase,
        rims.body,
        {
            "target": float(target),
            "before": before,
            "after": porosity(rims.phase),
            "share": int(np.count_nonzero(rims.phase == label)) / rims.phase.size,
            "rim_um": rim,
            "wall_s": time.perf_counter() - started,
        },
    )


def with_rims(
    bodies: pd.DataFrame,
    library: Meshes,
    shape: tuple[int, int, int],
    voxel_size_um: float,
    target: float,
    *,
    threads: int = 1,
) -> tuple[float, np.ndarray]:
    """Porosity of a bed, and whether a voxel is solid once rims have brought it to the target.

    Parameters are those of :func:`cement`.

    Returns
    -------
    porosity : float
        Without rims.
    solid : (nz, ny, nx) bool
    """
    phase, _, report = cement(bodies, library, shape, voxel_size_um, target, 1, threads=threads)
    return report["before"], phase > 0


def fill_to_surface(
    bodies: pd.DataFrame,
    library: Meshes,
    shape: tuple[int, int, int],
    voxel_size_um: float,
    per_um: float,
    *,
    threads: int = 1,
) -> float:
    """Share of a bed's pores that rims have filled when its grains have so little surface left.

    Where grains meet, rims close the gap between them: a bed of grains that touch in points loses surface as
    it is cemented, more than the solid gains in size. How much goes by the share of the pores that they
    fill, nearly whatever the bed: touching spheres on a simple, a body-centred and a face-centred cubic
    lattice (porosity 0.48, 0.32, 0.26) keep 0.6 of theirs with 0.53 to 0.59 of the pores filled, though the
    grains have then grown in volume by 0.5, 0.3 and 0.2. So a loose bed tells what rims do in a denser one.

    Parameters
    ----------
    bodies, library, shape, voxel_size_um, threads
        The bed, as :func:`cement` takes it; a large region is looked at in its
        :func:`~grainfall.surface.core`.
    per_um : float
        Surface wanted by volume of the solid, 1/um, of a bed whose grains are with their rims as large as
        these are without.

    Returns
    -------
    float
        At most :data:`MOST_FILLED`; 0 where the bed has no more surface than that, or no pore.
    """
    corner = tuple(max(0, (int(n) - CORE) // 2) * voxel_size_um for n in shape[::-1])
    within = tuple(min(int(n), CORE) for n in shape)
    rims = _Rims(bodies, library, within, voxel_size_um, corner, threads=threads)
    size = rims.phase.size
    pores = int(np.count_nonzero(rims.phase == 0))
    solid = size - pores
    if not (solid and pores):
        return 0.0

    def surface(number: int) -> float:
        pore = rims.phase == 0
        if number:
            pore.ravel()[rims.first(number)[0]] = False
        growth = ((solid + number) / solid) ** (1 / 3)
        # by the size that the grains have when room is made for their rims
        return growth * specific_surface(pore, voxel_size_um) * size / (solid + number)

    most = int(MOST_FILLED * pores)
    if surface(0) <= per_um:
        return 0.0
    low, high = 0, min(most, 1 + int(FIRST_STEP * pores))
    while high < most and surface(high) > per_um:
        low, high = high, min(most, 1 + 3 * high // 2)
    while high - low > max(1, STEP * pores):
        middle = (low + high) // 2
        low, high = (middle, high) if surface(middle) > per_um else (low, middle)
    return high / pores


class _Rims:
    """A bed as voxels, and its pores in the order in which rims of even thickness reach them."""

    def __init__(self, bodies, library, shape, voxel_size_um, origin_um=(0.0, 0.0, 0.0), *, threads=1):
        self.bed = bodies, library
        self.voxel, self.origin, self.threads = voxel_size_um, origin_um, threads
        self.phase, self.body = voxelise(bodies, library, shape, voxel_size_um, origin_um, threads=threads)
        self.known = 0  # pores whose distance is known, the nearest ones
        self.distance: np.ndarray | None = None
        self.nearest: np.ndarray | None = None

    def first(self, number: int) -> tuple[np.ndarray, float]:
        """Flat indices of that many pores nearest to the grains, and the distance of the last, um.

        Of pores equally far, as on a wall along the grid, those come first that an additive recurrence takes:
        evenly over the volume.
        """
        if number > self.known:
            self._look(number)
        within = np.flatnonzero(np.isfinite(self.distance))
        found = self.distance.ravel()[within]
        last = np.partition(found, number - 1)[number - 1]
        nearer, level = within[found < last], within[found == last]
        at = np.stack(np.unravel_index(level, self.phase.shape)).astype(np.uint64)
        order = np.argsort((SCATTER[:, None] * at).sum(axis=0) & np.uint64(0xFFFFFFFF), kind="stable")
        return np.concatenate([nearer, level[order[: number - len(nearer)]]]), float(last)

    def _look(self, number: int) -> None:
        """Find the distances of at least so many pores."""
        # Centres of solid voxels lie in the grains, so that distances to them are bounds from above.
        squared = edt.edtsq(self.phase == 0, black_border=False, parallel=self.threads)
        shells = np.zeros(int(squared.max()) + 1, np.int64)
        for plane in squared:
            shells += np.bincount(np.rint(plane).astype(np.int64).ravel(), minlength=len(shells))
        shells[0] = 0  # solid
        del squared
        number = min(4 * number // 3, int(shells.sum())) if self.known else number
        most = int(np.searchsorted(np.cumsum(shells), number)) ** 0.5
        self.distance, self.nearest = surface_distances(
            *self.bed, self.phase, self.voxel, most * self.voxel * 1.001, self.origin, threads=self.threads
        )
        self.known = int(np.count_nonzero(np.isfinite(self.distance)))


def as_minerals(phase: np.ndarray, body: np.ndarray, bodies: pd.DataFrame) -> np.ndarray:
    """The phases as a section shows them: a rim has the mineral of the grain it grew on.

    Overgrowth is of the grain's own mineral and takes its crystal's orientation, so that sections (and those
    who outline their grains) seldom tell the two apart.

    Parameters
    ----------
    phase : (nz, ny, nx) uint8
    body : (nz, ny, nx) int32
        Body id + 1, 0 pore.
    bodies : DataFrame
        Columns id and phase.

    Returns
    -------
    (nz, ny, nx) uint8
    """
    mineral = np.zeros(int(bodies["id"].max()) + 2 if len(bodies) else 1, phase.dtype)
    mineral[bodies["id"].to_numpy() + 1] = bodies["phase"]
    return np.where(phase == 0, phase, mineral[body])


def _missing(phase: np.ndarray, target: float) -> int:
    """Voxels to be filled for the target porosity."""
    return int(np.count_nonzero(phase == 0)) - round(target * phase.size)
