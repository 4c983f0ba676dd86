"""Cement: overgrowth rims on the grains, down to the target porosity that no packing of them reaches."""

from __future__ import annotations

import time

import edt
import numpy as np
import pandas as pd
from scipy.ndimage import convolve1d, distance_transform_edt

from grainfall.volume.measures import porosity
from grainfall.volume.scan import Meshes, voxelise

SUPPORT = 5
"""Edge, voxels, of the neighbourhood whose solid voxels rank pore voxels equally far from the grains."""

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
    """Bodies as voxels, cemented down to the target porosity.

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
        Body id + 1, 0 pore; a rim belongs to the grain it grew on.
    report : dict
        target, before and after (porosity), share (of the region), rim_um (its thickness), wall_s.
    """
    started = time.perf_counter()
    shape = tuple(int(n) for n in shape)
    phase, body = voxelise(bodies, library, shape, voxel_size_um, threads=threads)
    before = porosity(phase)
    rim = 0.0
    if _missing(phase, target) > 0 and phase.any():
        # The rim without the grains around is an upper bound: more solid near by only shortens distances.
        _, _, bound = grow_rims(phase, body, target, label)
        margin = int(np.ceil(bound)) + 1
        wide = tuple(n + 2 * margin for n in shape)
        origin = (-margin * voxel_size_um,) * 3
        around = voxelise(bodies, library, wide, voxel_size_um, origin, threads=threads)
        within = (slice(margin, -margin),) * 3
        for whole, part in zip(around, (phase, body), strict=True):
            whole[within] = part  # the same grains to the last voxel, whatever the shifted origin rounds to
        phase, body, rim = grow_rims(*around, target, label, margin)
    return (
        phase,
        body,
        {
            "target": float(target),
            "before": before,
            "after": porosity(phase),
            "share": int(np.count_nonzero(phase == label)) / phase.size,
            "rim_um": rim * voxel_size_um,
            "wall_s": time.perf_counter() - started,
        },
    )


def grow_rims(
    phase: np.ndarray, body: np.ndarray, target: float, label: int, margin: int = 0
) -> tuple[np.ndarray, np.ndarray, float]:
    """Rims of even thickness on all grains, by as many voxels as the target porosity wants.

    Pore voxels are filled in the order of their Euclidean distance to the solid. Whole shells of voxels are
    equally far on a grid; among those of the last shell the ones with more solid near by come first (the
    true surface passes nearer to them), and what is equal even then is taken evenly over the volume by an
    additive recurrence.

    Parameters
    ----------
    phase : (nz, ny, nx) uint8
        0 pore.
    body : (nz, ny, nx) int
        Body id + 1, 0 pore.
    target : float
        Porosity wanted of the volume within the margin.
    label : int
        Phase of the cement.
    margin : int
        Voxels on each side that only lend their grains.

    Returns
    -------
    phase, body : ndarray
        Without the margin; cement voxels have ``label`` and the body of the grain nearest to them.
    rim : float
        Thickness, voxels: distance of the last voxel filled from the nearest solid voxel; 0 for none.

    Notes
    -----
    Overgrowth in proportion to nothing but the distance is the isotropic cementation of process-based
    reconstructions (Bakke and Øren, SPE Journal 2, 136, 1997, with exponent 0).
    """
    within = tuple(slice(margin, n - margin) for n in phase.shape)
    grains, owner = phase[within], body[within]
    wanted = _missing(grains, target)
    if wanted <= 0 or not phase.any():
        return grains.copy(), owner.copy(), 0.0
    squared = edt.edtsq(np.ascontiguousarray(phase == 0), black_border=False)[within]
    pore = np.flatnonzero(grains == 0)
    shell = np.rint(squared.ravel()[pore]).astype(np.int64)
    del squared
    up_to = np.cumsum(np.bincount(shell))
    last = int(np.searchsorted(up_to, wanted))
    rest = wanted - (int(up_to[last - 1]) if last else 0)
    edge = pore[shell == last]
    place = np.stack(np.unravel_index(edge, grains.shape)).astype(np.uint64)
    even = (SCATTER[:, None] * place).sum(axis=0) & np.uint64(0xFFFFFFFF)
    order = np.lexsort((even, -_support(phase)[within].ravel()[edge]))
    filled = np.zeros(grains.size, bool)
    filled[pore[shell < last]] = True
    filled[edge[order[:rest]]] = True
    filled = filled.reshape(grains.shape)
    rim = float(np.sqrt(last))
    return (
        np.where(filled, np.uint8(label), grains),
        np.where(filled, _nearest(body, int(np.ceil(rim)) + 1)[within], owner),
        rim,
    )


def as_minerals(phase: np.ndarray, body: np.ndarray, bodies: pd.DataFrame) -> np.ndarray:
    """The phases as a section shows them: a rim has the mineral of the grain it grew on.

    Overgrowth is of the grain's own mineral and takes its crystal's orientation, so that sections (and those
    who outline their grains) seldom tell the two apart.

    Parameters
    ----------
    phase : (nz, ny, nx) uint8
    body : (nz, ny, nx) int
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


def _support(phase: np.ndarray) -> np.ndarray:
    """Solid voxels in a cube about each voxel."""
    found = (phase > 0).astype(np.int16)
    for axis in range(3):
        found = convolve1d(found, np.ones(SUPPORT, np.int16), axis=axis, mode="nearest")
    return found


def _nearest(body: np.ndarray, reach: int, slab: int = 64) -> np.ndarray:
    """Body of the nearest solid voxel, right within ``reach`` voxels of it; slab by slab to save memory."""
    found = np.empty_like(body)
    for z in range(0, len(body), slab):
        first = max(0, z - reach)
        part = body[first : z + slab + reach]
        index = distance_transform_edt(part == 0, return_distances=False, return_indices=True)
        found[z : z + slab] = part[tuple(index)][z - first : z - first + slab]
    return found
