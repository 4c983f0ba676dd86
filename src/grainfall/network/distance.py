r"""Squared distance to the solid, slab by slab, exactly.

The square of the distance is separable,

.. math:: d^2(z, y, x) = \min_{y', x'} \left[ (y - y')^2 + (x - x')^2 + \min_{z'} (z - z')^2 \right]

with the inner minimum over the solid voxels of the column :math:`(y', x')`: all that a slab must know of the
others is, for each column, the last solid plane below it and the first above. The rest is done plane by
plane, by the lower envelope of parabolas (Felzenszwalb & Huttenlocher 2012), in whole numbers. What lies
outside the image is no solid.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numba import njit

NONE = -1
"""In the place of a plane: there is no solid."""

FAR = np.int64(2) ** 62
"""Square of the distance to no solid."""


def solid_columns(pore: np.ndarray, first_plane: int) -> tuple[np.ndarray, np.ndarray]:
    """First and last solid plane of every column of a slab.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
        A slab, True in the pore space.
    first_plane : int
        Its place in the volume.

    Returns
    -------
    first, last : (ny, nx) ndarray of int32
        Planes of the volume; -1 where the column is all pore.
    """
    first, last = (np.full(pore.shape[1:], NONE, np.int32) for _ in range(2))
    for z, plane in enumerate(pore, first_plane):
        last[~plane] = z
        first[~plane & (first == NONE)] = z
    return first, last


def nearest_columns(
    below: Iterable[tuple[np.ndarray, np.ndarray]], above: Iterable[tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Solid planes next to a slab, from :func:`solid_columns` of all the others.

    Parameters
    ----------
    below, above : iterable of (first, last)
        Of the slabs below it and of those above, each from the nearest to the farthest.

    Returns
    -------
    last_below, first_above : (ny, nx) ndarray of int32
        -1 in a column without solid there; None where there are no slabs.
    """
    nearest: list[np.ndarray | None] = [None, None]
    for side, slabs in enumerate((below, above)):
        for ends in slabs:
            plane = ends[1 - side]
            known = nearest[side]
            nearest[side] = plane if known is None else np.where(known == NONE, plane, known)
    return nearest[0], nearest[1]


def squared_distances(
    pore: np.ndarray,
    first_plane: int = 0,
    last_below: np.ndarray | None = None,
    first_above: np.ndarray | None = None,
) -> np.ndarray:
    """Squares of the distances to the nearest solid voxel of the whole volume.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
        A slab, True in the pore space.
    first_plane : int
        Its place in the volume.
    last_below, first_above : (ny, nx) array of int or None
        The nearest solid planes beyond the slab, as from :func:`nearest_columns`.

    Returns
    -------
    (nz, ny, nx) ndarray of uint16 or uint32
        Voxels squared, between the voxels' centres; 0 in the solid, and all 0 where the volume has none.
    """
    pore = np.ascontiguousarray(pore, bool)
    nz, ny, nx = pore.shape
    away = np.full(pore.shape, NONE, np.int32)  # along the column
    nearest = np.full((ny, nx), NONE, np.int32) if last_below is None else last_below.astype(np.int32)
    for z in range(nz):
        nearest[~pore[z]] = first_plane + z
        np.subtract(first_plane + z, nearest, out=away[z], where=nearest != NONE)
    nearest = np.full((ny, nx), NONE, np.int32) if first_above is None else first_above.astype(np.int32)
    for z in range(nz)[::-1]:
        nearest[~pore[z]] = first_plane + z
        up = nearest - (first_plane + z)
        np.copyto(away[z], up, where=(nearest != NONE) & ((away[z] == NONE) | (up < away[z])))
    if nz == 0 or (away[0] == NONE).all():  # a column with solid anywhere knows it in every plane
        return np.zeros(pore.shape, np.uint16)
    squared = away.view(np.uint32)  # in its place
    _within_planes(away, squared)
    return squared.astype(np.uint16) if squared.max() < 2**16 else squared


@njit(cache=True, nogil=True)
def _within_planes(away, squared):
    nz, ny, nx = away.shape
    longer = max(ny, nx)
    line, out = np.empty(longer, np.int64), np.empty(longer, np.int64)
    at, start = np.empty(longer, np.int64), np.empty(longer, np.int64)
    plane = np.empty((ny, nx), np.int64)
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                d = np.int64(away[z, y, x])
                line[x] = d * d if d >= 0 else FAR
            _lower_envelope(line, nx, at, start, plane[y])
        for x in range(nx):
            for y in range(ny):
                line[y] = plane[y, x]
            _lower_envelope(line, ny, at, start, out)
            for y in range(ny):
                squared[z, y, x] = out[y]


@njit(cache=True, nogil=True)
def _lower_envelope(line, n, at, start, out):
    """Lowest of the parabolas (i - q)^2 + line[q] at every i; `at` and `start` are room for as many."""
    k = -1
    for q in range(n):
        if line[q] == FAR:
            continue
        begin = np.int64(0)
        while k >= 0:
            p = at[k]
            # where q is no higher than p first: a whole number, rounded up
            begin = -((line[p] + p * p - line[q] - q * q) // (2 * (q - p)))
            if begin > start[k]:
                break
            k -= 1
        if k < 0:
            begin = np.int64(0)
        if begin < n:
            k += 1
            at[k], start[k] = q, begin
    if k < 0:
        out[:n] = FAR
        return
    end = n
    while k >= 0:
        p = at[k]
        for i in range(start[k], end):
            out[i] = (i - p) * (i - p) + line[p]
        end = start[k]
        k -= 1
