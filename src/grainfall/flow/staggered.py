"""Stokes flow on a staggered grid of voxels: velocities on the faces between cells, pressures in the cells.

Lengths are voxels, viscosity and pressure drop are 1. Axis 0 is the axis of flow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.csgraph import connected_components

ENDS = ("pressure", "periodic")
SIDES = ("sealed", "slip", "periodic")

NEAREST_WALL = 1e-2
"""Least distance from a velocity to the wall, in voxels, that its friction is reckoned with."""


@dataclass(frozen=True)
class Staggered:
    """Matrices of a pore space of ``m`` cells and ``n`` open faces, all that does not conduct left out.

    Velocities v (n,) and pressures p (m,) of Stokes flow satisfy ``friction v = drive + gradient p`` and
    ``gradient.T v = 0``; the flow rate through the volume is ``drive . v``.

    Attributes
    ----------
    friction : (n, n) csr_array, or None where not asked for
        Minus the Laplacian of each component of the velocity: v . friction v is the viscous dissipation.
    gradient : (n, m) csr_array
        Force of the pressures before and behind each face; its transpose is the divergence.
    area, volume : (n,) float
        Of the cell about each face: 1 but for what a distance field cuts off; the volume is half the area at
        the two ends. ``gradient`` and ``drive`` hold the area, so the flow rate through a face is area x v.
    drive : (n,) float
        Force of the pressure drop imposed.
    face, cell : (n, 4) and (m, 3) int
        Component and place of each face; place of each cell. Face i lies before cell i.
    shape : tuple of int
        Cells of the whole volume.
    periodic : tuple of bool
        Axes along which the volume repeats itself.
    """

    friction: csr_array | None
    gradient: csr_array
    area: np.ndarray
    volume: np.ndarray
    drive: np.ndarray
    face: np.ndarray
    cell: np.ndarray
    shape: tuple[int, int, int]
    periodic: tuple[bool, bool, bool]

    def held(self) -> bool:
        """Whether some wall slows every velocity, be it through others."""
        parts, part = connected_components(self.friction, directed=False)
        walls = self.friction @ np.ones(len(self.face))
        return bool((np.bincount(part, walls, parts) > 1e-9).all())


def assemble(
    pore: np.ndarray, ends: str = "pressure", sides: str = "sealed", *, friction: bool = True
) -> Staggered | None:
    """Matrices of a pore space; None where no path of open faces leads along axis 0.

    Parameters
    ----------
    pore : (n0, n1, n2) array of bool or float
        True in the pore space, whose walls then are the faces of the voxels; or the distance to the wall in
        voxels at the cells' centres, positive in the pore space.
    ends : {"pressure", "periodic"}
        ``pressure``: 1 and 0 on the planes before and behind axis 0, the flow through them normal to them.
        ``periodic``: a uniform force 1 / n0, the volume repeats itself.
    sides : {"sealed", "slip", "periodic"}
        Of axes 1 and 2: walls, planes of symmetry, or the volume repeats itself.
    """
    pore = np.asarray(pore)
    periodic = (ends == "periodic", sides == "periodic", sides == "periodic")
    opened, distance = [], []
    for c in range(3):
        before, behind = _sides_of_faces(pore, c, periodic[c], closed=c > 0)
        if pore.dtype == bool:
            opened.append(before & behind)
        else:
            distance.append((before + behind) / 2)
            opened.append(distance[c] > 0)
    number = np.full(pore.shape, -1, np.int32)
    for c in range(3):  # a cell is any that an open face leads to
        for shift in (0, 1):
            number[_cells_of_faces(opened[c], c, periodic[c], shift)] = 0
    number[number == 0] = np.arange(np.count_nonzero(number == 0), dtype=np.int32)

    face = np.concatenate([np.insert(np.argwhere(o), 0, c, axis=1) for c, o in enumerate(opened)])
    face = face.astype(np.int32)
    ahead, back = _cell_numbers(face, number, periodic)
    if not len(face):
        return None
    keep_cell = _conducting(face, ahead, back, int(number.max()) + 1, periodic[0], pore.shape[0])
    if not keep_cell.any():
        return None
    keep_face = keep_cell[np.where(ahead >= 0, ahead, back)]
    face, ahead, back = face[keep_face], ahead[keep_face], back[keep_face]
    renumber = np.where(keep_cell, np.cumsum(keep_cell) - 1, -1).astype(np.int32)
    cell = np.argwhere(number >= 0)[keep_cell].astype(np.int32)
    ahead, back = (np.where(side >= 0, renumber[side], -1) for side in (ahead, back))

    n = len(face)
    pairs = np.stack([back, ahead], axis=1)
    inside = pairs >= 0
    gradient = _rows(np.tile([1.0, -1.0], (n, 1)), pairs, len(cell))
    length, drive = np.ones(n), np.zeros(n)
    if periodic[0]:
        drive[face[:, 0] == 0] = 1 / pore.shape[0]
    else:
        length[~inside.all(axis=1)] = 0.5
        drive[back < 0] = 1.0
    if not friction:
        return Staggered(None, gradient, np.ones(n), length, drive, face, cell, pore.shape, periodic)
    beyond = {"pressure": 2.0, "sealed": 2.0, "slip": 0.0, "periodic": 0.0}
    walls = beyond[ends], beyond[sides], beyond[sides]
    matrix, area = _friction(face, opened, distance, length, periodic, walls)
    if distance:
        gradient, drive = csr_array(diags_array(area) @ gradient), area * drive
    return Staggered(matrix, gradient, area, area * length, drive, face, cell, pore.shape, periodic)


def _sides_of_faces(
    pore: np.ndarray, axis: int, periodic: bool, closed: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Values before and behind every face across ``axis``; those beyond the volume's ends close or copy."""
    if periodic:
        return np.roll(pore, 1, axis), pore
    first, last = pore.take([0], axis), pore.take([-1], axis)
    if closed:  # halfway between d and -d lies the wall
        first, last = (np.zeros_like(first), np.zeros_like(last)) if pore.dtype == bool else (-first, -last)
    return np.concatenate([first, pore], axis), np.concatenate([pore, last], axis)


def _cells_of_faces(opened: np.ndarray, axis: int, periodic: bool, shift: int) -> np.ndarray:
    """Mask of the cells behind (shift 0) or before (1) an open face."""
    if periodic:
        return np.roll(opened, -shift, axis)
    cut = [slice(None)] * 3
    cut[axis] = slice(shift, opened.shape[axis] - 1 + shift)
    return opened[tuple(cut)]


def _cell_numbers(face: np.ndarray, number: np.ndarray, periodic: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the cells behind and before each face, -1 beyond the ends."""
    behind = np.empty(len(face), np.int32)
    before = np.empty(len(face), np.int32)
    for c in range(3):
        mine = face[:, 0] == c
        place = face[mine, 1:].copy()
        n = number.shape[c]
        at_end, at_start = place[:, c] == n, place[:, c] == 0
        place[:, c] %= n
        behind[mine] = np.where(at_end, -1, number[tuple(place.T)])
        place = face[mine, 1:].copy()
        place[:, c] = (place[:, c] - 1) % n
        before[mine] = np.where(at_start & (not periodic[c]), -1, number[tuple(place.T)])
    return behind, before


def _conducting(
    face: np.ndarray, ahead: np.ndarray, back: np.ndarray, m: int, periodic: bool, length: int
) -> np.ndarray:
    """Cells (m,) bool of the clusters that lead through the volume along axis 0."""
    link = (ahead >= 0) & (back >= 0)
    i, j = back[link], ahead[link]
    graph = csr_array((np.ones(len(i), np.int8), (i, j)), shape=(m, m))
    _, cluster = connected_components(graph, directed=False)
    if not periodic:
        through = np.intersect1d(cluster[ahead[back < 0]], cluster[back[ahead < 0]])
        return np.isin(cluster, through)
    # In a repeating volume a cluster leads through if some closed path in it comes back displaced.
    step = np.where((face[link, 0] == 0) & (face[link, 1] == 0), 1, 0)
    return _winding(i, j, step, m)


@numba.njit(cache=True)
def _root(parent, offset, i):
    """Root of a cell's tree; the path is shortened to it, so the cell's ``offset`` counts from the root."""
    root, total = i, 0
    while parent[root] != root:
        total += offset[root]
        root = parent[root]
    while i != root:
        following, rest = parent[i], total - offset[i]
        parent[i], offset[i] = root, total
        i, total = following, rest
    return root


@numba.njit(cache=True)
def _winding(i, j, step, m):
    """Cells of clusters with a closed path of links i -> j whose steps do not add up to 0."""
    parent = np.arange(m)
    offset = np.zeros(m, np.int64)
    winds = np.zeros(m, np.bool_)
    for k in range(len(i)):
        a, b = _root(parent, offset, i[k]), _root(parent, offset, j[k])
        mismatch = offset[i[k]] + step[k] - offset[j[k]]
        if a == b:
            winds[a] |= mismatch != 0
        else:
            parent[b], offset[b] = a, mismatch
            winds[a] |= winds[b]
    found = np.zeros(m, np.bool_)
    for cell in range(m):
        found[cell] = winds[_root(parent, offset, cell)]
    return found


def _friction(
    face: np.ndarray,
    opened: list[np.ndarray],
    distance: list[np.ndarray],
    length: np.ndarray,
    periodic: tuple[bool, bool, bool],
    walls: tuple[float, float, float],
) -> tuple[csr_array, np.ndarray]:
    """Minus the Laplacian of the velocity at each face, the solid at rest, and the faces' areas.

    Face by face the velocity next to it along each axis is another unknown, or 0 on the wall between. Along
    the face's own axis the wall is a voxel off, across it half a voxel, also where only one of the two voxels
    there is solid: the edge of that one is at rest. A distance field says where between the two faces it is,
    and the face reaches as far towards it as half the way to a neighbour.
    ``walls``: the same, one over the distance, for the volume's own sides.
    """
    n = len(face)
    columns = np.full((n, 7), -1, np.int32)
    values = np.zeros((n, 7))
    area = np.ones(n)
    columns[:, 0] = np.arange(n)
    for c in range(3):
        mine = np.flatnonzero(face[:, 0] == c)
        place = face[mine, 1:].T
        number = np.full(opened[c].shape, -1, np.int32)
        number[tuple(place)] = mine
        for d in range(3):
            weight = 1.0 if d == c else length[mine]  # at the two ends half of it lies outside
            width = np.zeros(len(mine))
            for slot, step in ((2 * d + 1, -1), (2 * d + 2, 1)):
                beside = place[d] + step
                size = number.shape[d]
                outside = np.zeros(len(mine), bool) if periodic[d] else (beside < 0) | (beside >= size)
                there = (*place[:d], beside % size, *place[d + 1 :])
                other = np.where(outside, -1, number[there])
                if distance:
                    here = distance[c][tuple(place)]
                    share = here / np.maximum(here - distance[c][there], here)
                    share = np.maximum(share, NEAREST_WALL)
                    width += np.where((other >= 0) | outside, 0.5, share / 2)
                    wall = 1 / share
                else:
                    wall = 1.0 if d == c else 2.0
                rest = np.where(outside, 0.0 if d == c else walls[d], wall)
                strength = weight * np.where(other >= 0, 1.0, rest)
                values[mine, 0] += strength
                values[mine, slot] = -strength
                columns[mine, slot] = other
            if distance and d != c:
                area[mine] *= width
    return _rows(values, columns, n), area


def _rows(values: np.ndarray, columns: np.ndarray, width: int) -> csr_array:
    """Matrix of a few entries a row; those of column -1 are none."""
    there = columns >= 0
    starts = np.zeros(len(columns) + 1, np.int64)
    np.cumsum(there.sum(axis=1), out=starts[1:])
    if starts[-1] < np.iinfo(np.int32).max:  # short indices are a third of the memory
        starts, columns = starts.astype(np.int32), columns.astype(np.int32)
    return csr_array((values[there], columns[there], starts), shape=(len(columns), width))
