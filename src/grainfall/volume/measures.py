"""Porosity, Euler number and touching bodies of a voxel volume."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pandas as pd
from numba import njit, types
from numba.typed import Dict

PAIR = types.UniTuple(types.int64, 2)

SLAB = 128
"""Planes looked at together: the chunks of a volume file."""


def porosity(phase: np.ndarray) -> float:
    """Fraction of voxels (pixels) that are pore, label 0."""
    return 1.0 - int(np.count_nonzero(phase)) / phase.size


def euler_number(pore: np.ndarray) -> int:
    """Euler number of the pore space: components - loops + cavities.

    Pore voxels are joined through faces (6-connectivity), as flow is, and so solid voxels through faces,
    edges and corners (26-connectivity). The Euler number is then that of the cell complex with a vertex for
    each pore voxel, an edge for each pair of face neighbours, a square for each 2 x 2 and a cube for each 2
    x 2 x 2 block of pore voxels. Nothing is added outside the volume.

    Parameters
    ----------
    pore : (nz, ny, nx) bool

    Returns
    -------
    int
    """
    return int(_euler(np.ascontiguousarray(pore, dtype=np.bool_)))


@njit(cache=True, nogil=True)
def _euler(pore):
    nz, ny, nx = pore.shape
    total = 0
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                if not pore[k, j, i]:
                    continue
                x = i + 1 < nx and pore[k, j, i + 1]
                y = j + 1 < ny and pore[k, j + 1, i]
                z = k + 1 < nz and pore[k + 1, j, i]
                xy = x and y and pore[k, j + 1, i + 1]
                xz = x and z and pore[k + 1, j, i + 1]
                yz = y and z and pore[k + 1, j + 1, i]
                xyz = xy and xz and yz and pore[k + 1, j + 1, i + 1]
                total += 1 - (x + y + z) + (xy + xz + yz) - xyz
    return total


def describe(slabs: Iterable[np.ndarray], voxel_size_um: float) -> dict:
    """Porosity, topology and contacts of a volume that comes slab by slab.

    Parameters
    ----------
    slabs : iterable of (<= nz, ny, nx) int
        Labels of the bodies, 0 pore, one slab of planes after the other.
    voxel_size_um : float
        Edge of a voxel.

    Returns
    -------
    dict
        porosity; euler, of the pore space (:func:`euler_number`); contacts, pairs of bodies that share voxel
        faces, and contact_area_um2 (:func:`adjacent_pairs`).
    """
    solid = voxels = euler = 0
    tallies = []
    for z, shared, body in _overlapping(slabs):
        pore = body == 0
        solid += pore.size - int(np.count_nonzero(pore))
        voxels += pore.size
        euler += euler_number(pore)
        if shared:
            solid -= pore[0].size - int(np.count_nonzero(pore[0]))
            voxels -= pore[0].size
            euler -= euler_number(pore[:1])
        tallies.append(_adjacent(body, z, shared))
    pairs = _pairs_of(tallies, voxel_size_um)
    return {
        "porosity": 1.0 - solid / voxels,
        "euler": euler,
        "contacts": len(pairs),
        "contact_area_um2": float(pairs["area_um2"].sum()),
    }


def adjacent_pairs(body: np.ndarray, voxel_size_um: float) -> pd.DataFrame:
    """Pairs of bodies that share voxel faces.

    Parameters
    ----------
    body : (nz, ny, nx) int
        Labels, 0 pore; an open volume file will do.
    voxel_size_um : float
        Edge of a voxel.

    Returns
    -------
    DataFrame
        One row per pair, sorted: body_a < body_b (labels as in the array: body id + 1); faces_x, faces_y,
        faces_z (shared voxel faces by normal axis); area_um2; x, y, z (mean of the shared faces' centres,
        um from the volume's corner); nx, ny, nz (unit mean normal from a to b; missing where the shared
        faces cancel).

    Notes
    -----
    The staircase of a flat contact of area A and normal n shows ``A |n_i| / h^2`` faces along axis i, all of
    one sign. So the length of the signed sum of faces times h^2 is A at any orientation, while (2/3) h^2
    times their number (Cauchy-Crofton, mean ``|n_x| + |n_y| + |n_z| = 3/2``) is right only on average over
    orientations: 0.67 A for a contact along an axis, 1.15 A along the diagonal. ``area_um2`` is the former;
    on a curved contact it is the area of the flat patch with the same rim.
    """
    slabs = (np.asarray(body[z : z + SLAB]) for z in range(0, len(body), SLAB))
    return _pairs_of([_adjacent(part, z, shared) for z, shared, part in _overlapping(slabs)], voxel_size_um)


def _overlapping(slabs: Iterable[np.ndarray]) -> Iterator[tuple[int, bool, np.ndarray]]:
    """Slabs, each with the last plane of the one before it: first plane, whether it is shared, slab."""
    z, before = 0, None
    for slab in slabs:
        if before is None:
            yield z, False, np.ascontiguousarray(slab)
        else:
            yield z - 1, True, np.concatenate([before, slab])
        z, before = z + len(slab), slab[-1:].copy()


def _pairs_of(tallies: list[tuple[np.ndarray, np.ndarray]], voxel_size_um: float) -> pd.DataFrame:
    """The table of :func:`adjacent_pairs` from what slabs have counted."""
    pairs, sums = (np.concatenate(parts) for parts in zip(*tallies, strict=True))
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    pairs, sums = pairs[order], sums[order]
    first = np.flatnonzero(np.any(np.diff(pairs, axis=0, prepend=-1), axis=1))
    pairs, sums = pairs[first], np.add.reduceat(sums, first) if len(first) else sums
    faces, signed, centre = sums[:, 0:3], sums[:, 3:6], sums[:, 6:9]
    length = np.sqrt((signed.astype(float) ** 2).sum(axis=1))
    with np.errstate(invalid="ignore"):
        normal = signed / np.where(length > 0, length, np.nan)[:, None]
    # Centres were summed in half voxels to stay whole numbers.
    mean = centre / (2.0 * faces.sum(axis=1)[:, None]) * voxel_size_um
    return pd.DataFrame(
        {
            "body_a": pairs[:, 0],
            "body_b": pairs[:, 1],
            **{f"faces_{a}": faces[:, i] for i, a in enumerate("xyz")},
            "area_um2": length * voxel_size_um**2,
            **{a: mean[:, i] for i, a in enumerate("xyz")},
            **{f"n{a}": normal[:, i] for i, a in enumerate("xyz")},
        }
    )


@njit(cache=True, nogil=True)
def _adjacent(body, first, shared):
    """Label pairs (n, 2) and (n, 9) sums over their faces: counts, signed counts, centres in half voxels.

    The first plane is the volume's plane ``first``; where it is ``shared`` with the slab before, its own
    faces were counted there.
    """
    nz, ny, nx = body.shape
    row_of = Dict.empty(PAIR, types.int64)
    pairs = np.empty((1024, 2), np.int64)
    sums = np.zeros((1024, 9), np.int64)
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                here = np.int64(body[k, j, i])
                if here == 0:
                    continue
                for axis in range(2 if shared and k == 0 else 0, 3):
                    if axis == 0:
                        there = np.int64(body[k, j, i + 1]) if i + 1 < nx else here
                    elif axis == 1:
                        there = np.int64(body[k, j + 1, i]) if j + 1 < ny else here
                    else:
                        there = np.int64(body[k + 1, j, i]) if k + 1 < nz else here
                    if there == 0 or there == here:
                        continue
                    pair = (min(here, there), max(here, there))
                    if pair in row_of:
                        row = row_of[pair]
                    else:
                        row = len(row_of)
                        if row == len(pairs):
                            pairs = np.concatenate((pairs, np.empty_like(pairs)))
                            sums = np.concatenate((sums, np.zeros_like(sums)))
                        row_of[pair] = row
                        pairs[row, 0], pairs[row, 1] = pair
                    sums[row, axis] += 1
                    sums[row, 3 + axis] += 1 if here < there else -1
                    sums[row, 6] += 2 * i + 1 + (axis == 0)
                    sums[row, 7] += 2 * j + 1 + (axis == 1)
                    sums[row, 8] += 2 * (first + k) + 1 + (axis == 2)
    return pairs[: len(row_of)].copy(), sums[: len(row_of)].copy()
