"""Mobility of the faces of voxels: the velocity there under a uniform unit force along the face's normal.

Each component of it satisfies -lap w = 1 with w = 0 on the walls, where friction alone holds the flow back:
exact in straight ducts of any section. The volume's sides are open to flow across them and walls along them.
Lengths are voxels, viscosity is 1.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import edt
import numpy as np
from numba import njit

CLOSE = 1e-2
"""Residual: flow through any mobility keeps to the bound, which is at its flattest here."""

MOST_STEPS = 500
"""Of conjugate gradients; ten to thirty do."""

MARGIN = 2
"""Of a block, in radii of the widest pore: what is cut off there is felt to a few thousandths."""

BLOCK = 256
"""Edge in voxels of what is solved at once, margins aside: bounds the memory."""


class Mobility(NamedTuple):
    """Mobilities of the faces of N pore voxels of a volume (nz, ny, nx).

    Attributes
    ----------
    voxels : (N,) int
        Flat indices, rising.
    lower : (N, 3) float32
        Of the lower face of each across axes 0, 1, 2; 0 where it is closed.
    upper : three arrays (ny, nx), (nz, nx), (nz, ny) of float32
        Of the volume's upper sides.
    """

    voxels: np.ndarray
    lower: np.ndarray
    upper: tuple[np.ndarray, np.ndarray, np.ndarray]


def mobility(pore: np.ndarray, close: float = CLOSE, block: int = BLOCK) -> Mobility:
    """Mobilities of a pore space, solved for block by block with margins about each.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
    close : float
        Residual.
    block : int
        Edge of a block in voxels; no less than twice the margin.

    Returns
    -------
    Mobility
    """
    voxels = np.flatnonzero(pore)
    if pore.size < 2**31:
        voxels = voxels.astype(np.int32)
    lower = np.empty((len(voxels), 3), np.float32)
    upper = tuple(np.zeros(np.delete(pore.shape, axis), np.float32) for axis in range(3))
    margin = 0
    if max(pore.shape) > block:
        margin = int(np.ceil(MARGIN * np.sqrt(edt.edtsq(pore, black_border=False).max())))
        block = max(block, 2 * margin)
    size = np.array(pore.shape)
    edges = [np.linspace(0, n, -(-n // block) + 1).astype(int) for n in size]
    for corner in product(*(range(len(e) - 1) for e in edges)):
        first, last = (np.array([e[i + k] for e, i in zip(edges, corner, strict=True)]) for k in (0, 1))
        start, stop = np.maximum(first - margin, 0), np.minimum(last + margin, size)
        part = pore[tuple(slice(*ends) for ends in zip(start, stop, strict=True))]
        solution = _solve(part, np.stack([start > 0, stop < size], axis=1), close)
        _store(pore, *solution, start, first, last, voxels, lower, *upper)
    return Mobility(voxels, lower, upper)


@njit(cache=True)
def _store(pore, number, found, start, first, last, voxels, lower, upper0, upper1, upper2):
    """Take the part of a block's solution from ``first`` to ``last`` over."""
    nz, ny, nx = pore.shape
    for z in range(first[0], last[0]):
        for y in range(first[1], last[1]):
            i = np.searchsorted(voxels, (z * ny + y) * nx + first[2])
            for x in range(first[2], last[2]):
                if not pore[z, y, x]:
                    continue
                a, b, c = z - start[0], y - start[1], x - start[2]
                lower[i] = found[number[a, b, c]]
                i += 1
                if z == nz - 1:
                    upper0[y, x] = found[number[a + 1, b, c], 0]
                if y == ny - 1:
                    upper1[z, x] = found[number[a, b + 1, c], 1]
                if x == nx - 1:
                    upper2[z, y] = found[number[a, b, c + 1], 2]


@njit(cache=True)
def _solve(pore, cut, close):
    """Mobilities (count, 3) of the faces below each place, and the places' numbers (nz + 1, ny + 1, nx + 1).

    Conjugate gradients with incomplete factors in Eisenstat's form (1981). Where ``cut`` (3, 2) says that the
    volume goes on beyond a side, nothing changes across that side.
    """
    nz, ny, nx = pore.shape
    number = np.full((nz + 1, ny + 1, nx + 1), -1, np.int32)
    count = 0
    for z in range(nz + 1):
        for y in range(ny + 1):
            for x in range(nx + 1):
                if _opened(pore, 0, z, y, x) or _opened(pore, 1, z, y, x) or _opened(pore, 2, z, y, x):
                    number[z, y, x] = count
                    count += 1
    link = np.full((count, 6), count, np.int32)
    # place `count`, always 0, stands for walls
    source, diagonal = np.zeros((count + 1, 3), np.float32), np.zeros((count + 1, 3), np.float32)
    size = np.array([nz, ny, nx])
    at = np.empty(3, np.int64)
    for z in range(nz + 1):
        for y in range(ny + 1):
            for x in range(nx + 1):
                i = number[z, y, x]
                if i < 0:
                    continue
                for s in range(6):
                    d = s // 2
                    at[:] = z, y, x
                    at[d] += 2 * (s % 2) - 1
                    if 0 <= at[d] <= size[d] and number[at[0], at[1], at[2]] >= 0:
                        link[i, s] = number[at[0], at[1], at[2]]
                    for c in range(3):
                        if not _opened(pore, c, z, y, x):
                            continue
                        source[i, c] = 1
                        if at[d] < 0 or at[d] >= size[d] + (d == c):
                            diagonal[i, c] += 0 if d == c or cut[d, s % 2] else 2
                        elif d == c or _opened(pore, c, at[0], at[1], at[2]):
                            diagonal[i, c] += 1
                        else:
                            diagonal[i, c] += 2
    pivot, inverse = np.zeros_like(source), np.zeros_like(source)
    for i in range(count):
        for c in range(3):
            if source[i, c] > 0:
                pivot[i, c] = diagonal[i, c]
                for s in range(0, 6, 2):
                    pivot[i, c] -= inverse[link[i, s], c]
                inverse[i, c] = 1 / pivot[i, c]
    found = _gradients(link, diagonal, pivot, inverse, source, close)
    return number, found


@njit(cache=True)
def _opened(pore, c, z, y, x):
    """Whether the lower face across axis c of a place is open: pore, or beyond the volume, on both sides."""
    nz, ny, nx = pore.shape
    if (c != 0 and z == nz) or (c != 1 and y == ny) or (c != 2 and x == nx):
        return False
    if (z < nz and y < ny and x < nx) and not pore[z, y, x]:
        return False
    z, y, x = z - (c == 0), y - (c == 1), x - (c == 2)
    return z < 0 or y < 0 or x < 0 or pore[z, y, x]


@njit(cache=True)
def _gradients(link, diagonal, pivot, inverse, source, close):
    """Solution for a source, which is overwritten; pivots and their inverses are 0 on closed faces."""
    n = len(link)
    x, direction = np.zeros_like(source), np.zeros_like(source)
    ahead, behind = np.zeros_like(source), np.zeros_like(source)
    residual = source
    rho = 0.0
    for i in range(n):
        a, b, c = link[i, 0], link[i, 2], link[i, 4]
        for m in range(3):
            direction[i, m] = residual[i, m] + residual[a, m] + residual[b, m] + residual[c, m]
            residual[i, m] = inverse[i, m] * direction[i, m]
            rho += direction[i, m] * residual[i, m]
    target = close**2 * rho
    for _ in range(MOST_STEPS):
        if rho <= target:
            break
        for i in range(n - 1, -1, -1):
            a, b, c = link[i, 1], link[i, 3], link[i, 5]
            for m in range(3):
                ahead[i, m] = inverse[i, m] * (direction[i, m] + ahead[a, m] + ahead[b, m] + ahead[c, m])
        power = 0.0
        for i in range(n):
            a, b, c = link[i, 0], link[i, 2], link[i, 4]
            for m in range(3):
                rest = direction[i, m] - (2 * pivot[i, m] - diagonal[i, m]) * ahead[i, m]
                behind[i, m] = inverse[i, m] * (rest + behind[a, m] + behind[b, m] + behind[c, m])
                power += direction[i, m] * (ahead[i, m] + behind[i, m])
        step = np.float32(rho / power)
        before, rho = rho, 0.0
        for i in range(n):
            for m in range(3):
                x[i, m] += step * ahead[i, m]
                residual[i, m] -= step * (ahead[i, m] + behind[i, m])
                rho += pivot[i, m] * residual[i, m] * residual[i, m]
        slope = np.float32(rho / before)
        for i in range(n):
            for m in range(3):
                direction[i, m] = pivot[i, m] * residual[i, m] + slope * direction[i, m]
    return x
