"""Cement: overgrowth rims on the grains, down to the target porosity, and the surface that they take away."""

from __future__ import annotations

import time

import edt
import numpy as np
import pandas as pd
import scipy  # its transforms load when they are first used
from numba import njit

from grainfall.surface import specific_surface
from grainfall.volume.measures import porosity
from grainfall.volume.scan import Meshes, voxelise

SUPPORT = 5
"""Edge, voxels, of the neighbourhood whose solid voxels rank pore voxels equally far from the grains."""

SLAB = 64
"""Planes whose voxels are given to their nearest grains at a time: that takes some 20 bytes a voxel."""

FIRST_STEP, STEP = 0.005, 0.0005
"""Share of the pores that is tried first as filled, and the one to which it is found."""

SCATTER = np.array([3518319155, 2882110345, 2360945575], np.uint64)
"""Multipliers of the additive recurrence in three dimensions: 2^32 over powers of the root of x^4 = x + 1."""


def cement(
    bodies: pd.DataFrame,
    library: Meshes,
    shape: tuple[int, int, int],
    voxel_size_um: float,
    target: float,
    label: int,
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
    phase, body = voxelise(bodies, library, shape, voxel_size_um)
    before = porosity(phase)
    rim = 0.0
    if _missing(phase, target) > 0 and phase.any():
        # The rim without the grains around is an upper bound: more solid near by only shortens distances.
        voxels = _shells(phase)[1]
        margin = int(np.ceil(np.sqrt(_last_shell(voxels, _missing(phase, target))))) + 1
        wide = tuple(n + 2 * margin for n in shape)
        origin = (-margin * voxel_size_um,) * 3
        around = voxelise(bodies, library, wide, voxel_size_um, origin)
        within = (slice(margin, -margin),) * 3
        for whole, part in zip(around, (phase, body), strict=True):
            whole[within] = part  # the same grains to the last voxel, whatever the shifted origin rounds to
        del phase, body, whole, part
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
        0 pore. Changed, as ``body`` is: a large region has no room for copies.
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
        Views of them without the margin; cement has ``label`` and the body of the grain nearest to it.
    rim : float
        Thickness, voxels: distance of the last shell filled from the nearest solid voxel, of one that is
        filled in part as much of the way to it; 0 for none.

    Notes
    -----
    Overgrowth in proportion to nothing but the distance is the isotropic cementation of process-based
    reconstructions (Bakke and Øren, SPE Journal 2, 136, 1997, with exponent 0).
    """
    within = tuple(slice(margin, n - margin) for n in phase.shape)
    wanted = _missing(phase[within], target)
    if wanted <= 0 or not phase.any():
        return phase[within], body[within], 0.0
    squared, voxels = _shells(phase, margin)
    filled, last = _filled(phase, squared, voxels, wanted, margin)
    del squared  # as large as the bodies
    reach = int(np.ceil(np.sqrt(last)))
    before = int(np.flatnonzero(voxels[:last])[-1]) if voxels[:last].any() else 0
    of_last = 1 - (int(voxels[: last + 1].sum()) - wanted) / voxels[last]
    rim = float(np.sqrt(before) + of_last * (np.sqrt(last) - np.sqrt(before)))
    grains, owner = phase[within], body[within]
    slabs = [slice(z, min(z + SLAB, len(grains))) for z in range(0, len(grains), SLAB)]
    grown = []
    for slab in slabs:
        nearest = _nearest(body, reach + 1, slab.start + margin, slab.stop + margin)
        grown.append(nearest[:, within[1], within[2]][filled[slab]])
    # no sooner: a rim is no grain on which the next one grows
    for slab, of in zip(slabs, grown, strict=True):
        owner[slab][filled[slab]] = of
    grains[filled] = label
    return grains, owner, rim


def fill_to_surface(phase: np.ndarray, voxel_size_um: float, per_um: float) -> float:
    """Share of a bed's pores that rims have filled when its grains have so little surface left.

    Where grains meet, rims close the gap between them: a bed of grains that touch in points loses surface as
    it is cemented, more than the solid gains in size. How much goes by the share of the pores that they
    fill, nearly whatever the bed: touching spheres on a simple, a body-centred and a face-centred cubic
    lattice (porosity 0.48, 0.32, 0.26) keep 0.6 of theirs with 0.53 to 0.59 of the pores filled, though the
    grains have then grown in volume by 0.5, 0.3 and 0.2. So a loose bed tells what rims do in a denser one.

    Parameters
    ----------
    phase : (nz, ny, nx) int
        A bed, 0 pore; :func:`grainfall.surface.core` gives enough of a large one.
    voxel_size_um : float
    per_um : float
        Surface wanted by volume of the solid, 1/um, of a bed whose grains are with their rims as large as
        these are without.

    Returns
    -------
    float
        At most 0.95; 0 where the bed has no more surface than that, or no pore.
    """
    pores = int(np.count_nonzero(phase == 0))
    solid = phase.size - pores
    if not (solid and pores):
        return 0.0
    squared, voxels = _shells(phase)

    def surface(wanted: int) -> float:
        filled, _ = _filled(phase, squared, voxels, wanted)
        pore = (phase == 0) & ~filled
        growth = ((solid + wanted) / solid) ** (1 / 3)
        # by the size that the grains have when room is made for their rims
        return growth * specific_surface(pore, voxel_size_um) * phase.size / (solid + wanted)

    most = pores * 19 // 20
    if surface(0) <= per_um:
        return 0.0
    # the first share that does: a shell half filled is rougher than the grain was
    low, high = 0, min(most, 1 + int(FIRST_STEP * pores))
    while high < most and surface(high) > per_um:
        low, high = high, min(most, 1 + 3 * high // 2)
    while high - low > max(1, STEP * pores):
        middle = (low + high) // 2
        low, high = (middle, high) if surface(middle) > per_um else (low, middle)
    return high / pores


def with_rims(phase: np.ndarray, target: float) -> np.ndarray:
    """Whether a voxel is solid once rims have brought a bed, (nz, ny, nx) with 0 for pores, to a porosity."""
    missing = _missing(phase, target)
    if missing <= 0 or not phase.any():
        return phase > 0
    filled, _ = _filled(phase, *_shells(phase), missing)
    return (phase > 0) | filled


def _shells(phase: np.ndarray, margin: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Squared distances to the solid within the margin, and how many pore voxels lie at each."""
    squared = edt.edtsq(np.ascontiguousarray(phase == 0), black_border=False)
    within = tuple(slice(margin, n - margin) for n in phase.shape)
    squared = np.rint(squared, out=squared)[within]
    voxels = np.zeros(int(squared.max()) + 1, np.int64)
    for plane in squared:
        voxels += np.bincount(plane.astype(np.int64).ravel(), minlength=len(voxels))
    voxels[0] = 0  # solid
    return squared, voxels


def _last_shell(voxels: np.ndarray, wanted: int) -> int:
    """Squared distance of the shell with which ``wanted`` voxels are filled."""
    return int(np.searchsorted(np.cumsum(voxels), wanted))


def _filled(
    phase: np.ndarray, squared: np.ndarray, voxels: np.ndarray, wanted: int, margin: int = 0
) -> tuple[np.ndarray, int]:
    """Which voxels within the margin rims fill, and the squared distance of the last shell of them.

    Plane by plane: a shell may have a tenth of all voxels, of which a sort would take many times the memory
    of the volume.
    """
    filled, last = np.zeros(squared.shape, bool), _last_shell(voxels, wanted)
    if not last:
        return filled, last

    def of_last(z: int) -> tuple[np.ndarray, np.ndarray]:
        return np.nonzero(squared[z] == last)

    def even(z: int, *at: np.ndarray) -> np.ndarray:
        y, x = (along.astype(np.uint64) for along in at)
        return (SCATTER[0] * np.uint64(z) + SCATTER[1] * y + SCATTER[2] * x).astype(np.uint32)

    support = []
    for z in range(len(squared)):
        y, x = of_last(z)
        support.append(_support(phase, np.full(len(y), z + margin), y + margin, x + margin).astype(np.uint8))
    # of the least support that is still filled some are, the first of the recurrence
    number = sum(np.bincount(of_plane, minlength=SUPPORT**3 + 1) for of_plane in support)
    at_least = np.cumsum(number[::-1])[::-1]
    rest = wanted - int(voxels[:last].sum())
    least = int(np.flatnonzero(at_least >= rest)[-1])
    rest -= int(at_least[least] - number[least])
    among = [even(z, *(at[of == least] for at in of_last(z))) for z, of in enumerate(support)]
    bound = np.partition(np.concatenate(among), rest - 1)[rest - 1]
    ties = rest - sum(int(np.count_nonzero(of_plane < bound)) for of_plane in among)
    for z, of_plane in enumerate(support):
        np.logical_and(squared[z] > 0, squared[z] < last, out=filled[z])
        first = among[z] < bound
        same = np.flatnonzero(among[z] == bound)[:ties]
        first[same] = True
        ties -= len(same)
        taken = of_plane > least
        taken[of_plane == least] = first
        y, x = of_last(z)
        filled[z, y[taken], x[taken]] = True
    return filled, last


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


@njit(cache=True, nogil=True)
def _support(phase, z, y, x):
    """Solid voxels in a cube about each of the voxels given; the volume goes on beyond its faces."""
    nz, ny, nx = phase.shape
    half = SUPPORT // 2
    found = np.zeros(len(z), np.int64)
    for i in range(len(z)):
        for a in range(z[i] - half, z[i] + half + 1):
            for b in range(y[i] - half, y[i] + half + 1):
                for c in range(x[i] - half, x[i] + half + 1):
                    here = phase[min(max(a, 0), nz - 1), min(max(b, 0), ny - 1), min(max(c, 0), nx - 1)]
                    found[i] += here > 0
    return found


def _nearest(body: np.ndarray, reach: int, start: int, stop: int) -> np.ndarray:
    """Body of the nearest solid voxel on planes from start to stop, right within ``reach`` voxels of it."""
    first = max(0, start - reach)
    part = body[first : stop + reach]
    index = scipy.ndimage.distance_transform_edt(part == 0, return_distances=False, return_indices=True)
    return part[tuple(index[:, start - first : stop - first])]
