"""The pore space parted into pores: maxima of the distance map merged by persistence, and their basins."""

from __future__ import annotations

from dataclasses import dataclass

import edt
import numpy as np
from numba import njit

from grainfall.errors import InputError

PERSISTENCE = 0.1
"""Default persistence of a pore: share of its radius by which the way to a larger pore must narrow."""

DIGITISATION_VOXELS = 1.0
"""Two distances measured to voxel centres differ by chance by up to one voxel: no maximum is finer."""

WEIGHTS = (1, 4, 6, 4, 1)
"""Along an axis, of the voxels around one that is compared with its equals."""


@dataclass(frozen=True)
class Partition:
    """The pores of a volume, voxel by voxel.

    Attributes
    ----------
    labels : (nz, ny, nx) ndarray of int32
        Pore of each voxel, 1 ... n by falling radius; 0 in the solid.
    squared_distance : (nz, ny, nx) ndarray of uint16 or uint32
        Square of the distance to the centre of the nearest solid voxel, voxels squared; 0 in the solid.
    tree : (nz, ny, nx) ndarray of uint8
        Bit a is set where the voxel and its next neighbour along axis a are joined in the spanning tree of
        their pore that the ascent of the distance map draws.
    peaks : (n,) ndarray of int64
        Flat index of the highest voxel of each pore, a maximum of the distance.
    """

    labels: np.ndarray
    squared_distance: np.ndarray
    tree: np.ndarray
    peaks: np.ndarray


def partition(pore: np.ndarray, *, persistence: float = PERSISTENCE, threads: int = 1) -> Partition:
    r"""Part the pore space at the necks of its distance map.

    From every pore voxel the way leads up the distance :math:`d` to the solid, to its highest neighbour by a
    face (pore is 6-connected; so the solid is 26-connected), and ends at a maximum: the voxels of one maximum
    are its basin. In falling order of the saddles between basins, where two components of the superlevel sets
    of :math:`d` meet, at a saddle :math:`d_s`, the lower maximum
    :math:`d_m` dies (elder rule); it stays a pore of its own if its persistence

    .. math:: d_m - d_s \ge \max(h\,d_m,\ 1\,\mathrm{voxel})

    and otherwise its basin is merged with that across the saddle: the threshold grows with the pore, so that
    the answer does not depend on the magnification.

    Squared distances are whole numbers, and many are equal. Equals are told apart by the weighted sum of the
    values around them (:func:`surroundings`): like the distance, it does not depend on the order of the axes,
    nor then does what is made of it.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
        True in the pore space; at least one voxel of pore and one of solid.
    persistence : float
        :math:`h` in [0, 1). 0 keeps every maximum that digitisation does not explain; towards 1 nothing that
        is connected is parted.
    threads : int
        For the distance transform; the result does not depend on it.

    Returns
    -------
    Partition

    Raises
    ------
    InputError
        When the parameter is out of its range.
    """
    if not 0 <= persistence < 1:
        raise InputError("network.persistence", f"{persistence} is out of range", "0 ≤ persistence < 1")
    # the faces of the image are no walls
    squared = edt.edtsq(np.ascontiguousarray(pore, bool), black_border=False, parallel=threads)
    # whole numbers, and small ones: half the memory and half the traffic
    squared = squared.astype(np.uint16 if squared.max() < 2**16 else np.uint32)
    flat, labels, tree = squared.reshape(-1), np.zeros(pore.size, np.int32), np.zeros(pore.size, np.uint8)
    tops = np.empty(_ascend(flat, pore.shape, tree), np.int64)
    around = np.empty(len(tops), np.int64)
    _find_tops(flat, pore.shape, tree, tops, around)
    tops = tops[np.lexsort((-around, -flat[tops].astype(np.int64)))]
    labels[tops] = np.arange(1, len(tops) + 1)
    _descend(pore.shape, tree, labels)
    count, kinds = _find_saddles(flat, pore.shape, labels), (np.int64, np.int8, np.int64, np.int64)
    voxels, axes, heights, around = (np.empty(count, kind) for kind in kinds)
    _find_saddles(flat, pore.shape, labels, voxels, axes, heights, around)
    falling = np.lexsort((-around, -heights))
    basin = _cancel(flat, pore.shape, labels, tops, voxels[falling], axes[falling], persistence, tree)
    alive = basin == np.arange(len(basin))  # the solid, 0, is a basin of its own
    _number(labels, np.cumsum(alive, dtype=np.int32)[basin] - 1)
    return Partition(labels.reshape(pore.shape), squared, tree.reshape(pore.shape), tops[alive[1:]])


@njit(cache=True)
def surroundings(squared, shape, v):
    """Weighted sum of the 5 x 5 x 5 values around a voxel, the image going on beyond its faces."""
    nz, ny, nx = shape
    z = v // (ny * nx)
    y = v // nx - z * ny
    x = v - (z * ny + y) * nx
    inside = 2 <= z < nz - 2 and 2 <= y < ny - 2 and 2 <= x < nx - 2
    a, b, c, d = max(x - 2, 0), max(x - 1, 0), min(x + 1, nx - 1), min(x + 2, nx - 1)
    total = 0
    for i in range(5):
        for j in range(5):
            if inside:  # unsigned: numba need not ask whether it counts from the end
                row = np.uint64(v + ((i - 2) * ny + j - 2) * nx - 2)
                far = np.int64(squared[row]) + np.int64(squared[row + np.uint64(4)])
                near = np.int64(squared[row + np.uint64(1)]) + np.int64(squared[row + np.uint64(3)])
                own = np.int64(squared[row + np.uint64(2)])
            else:
                row = (min(max(z + i - 2, 0), nz - 1) * ny + min(max(y + j - 2, 0), ny - 1)) * nx
                far = np.int64(squared[row + a]) + np.int64(squared[row + d])
                near = np.int64(squared[row + b]) + np.int64(squared[row + c])
                own = np.int64(squared[row + x])
            total += WEIGHTS[i] * WEIGHTS[j] * (6 * own + 4 * near + far)
    return total


@njit(cache=True)
def find_root(parent, i):
    """Root of i in a forest, halving the path to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def face_neighbours(v, nz, ny, nx, near):
    """Fill `near` (6,) with the voxels next to v along -z, +z, -y, +y, -x, +x; -1 beyond the volume."""
    plane = ny * nx
    z = v // plane
    y = (v - z * plane) // nx
    x = v - z * plane - y * nx
    near[0] = v - plane if z > 0 else -1
    near[1] = v + plane if z < nz - 1 else -1
    near[2] = v - nx if y > 0 else -1
    near[3] = v + nx if y < ny - 1 else -1
    near[4] = v - 1 if x > 0 else -1
    near[5] = v + 1 if x < nx - 1 else -1


@njit(cache=True)
def _ascend(squared, shape, tree):
    """Draw the way up from every voxel, and note it (1 ... 6, maxima 7) above the bits of the tree.

    Returns the number of maxima.
    """
    near = np.empty(6, np.int64)
    tops = 0
    for v in range(squared.size):
        if squared[v] == 0:
            continue
        face_neighbours(v, shape[0], shape[1], shape[2], near)
        height = squared[v]
        for w in near:
            if w >= 0:
                height = max(height, squared[w])
        way, best, around = 6, v, np.int64(-1)
        for k in range(6):
            w = near[k]
            if w < 0 or squared[w] < height:
                continue
            if squared[best] < height:
                way, best = k, w
                continue
            if around < 0:
                around = surroundings(squared, shape, best)
            also = surroundings(squared, shape, w)
            if also > around or (also == around and w < best):
                way, best, around = k, w, also
        tree[v] |= np.uint8((way + 1) << 3)
        if best == v:
            tops += 1
        else:
            _join(tree, v, best, way // 2)
    return tops


@njit(cache=True)
def _find_tops(squared, shape, tree, tops, around):
    count = 0
    for v in range(tree.size):
        if tree[v] >> 3 == 7:
            tops[count], around[count] = v, surroundings(squared, shape, v)
            count += 1


@njit(cache=True)
def _descend(shape, tree, labels):
    """Give every voxel the label of the maximum above it, and wipe the ways up."""
    steps = np.array([0, -shape[1] * shape[2], shape[1] * shape[2], -shape[2], shape[2], -1, 1])
    for v in range(tree.size):
        if tree[v] >> 3 == 0:
            continue
        u = v
        while labels[u] == 0:
            u += steps[tree[u] >> 3]
        label, u = labels[u], v
        while labels[u] == 0:
            labels[u] = label
            u += steps[tree[u] >> 3]
    for v in range(tree.size):
        tree[v] &= np.uint8(7)


@njit(cache=True)
def _find_saddles(squared, shape, labels, voxels=None, axes=None, heights=None, around=None):
    """Faces between two basins, without those beside a higher one of the same; how many there are.

    If asked for, which: the voxel before each, its axis, its height and the sum of the two surroundings.
    """
    nz, ny, nx = shape
    steps = (ny * nx, nx, 1)
    count, v = 0, -1
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                v += 1
                if labels[v] == 0:
                    continue
                first, last = (z == 0, y == 0, x == 0), (z == nz - 1, y == ny - 1, x == nx - 1)
                for axis in range(3):
                    if last[axis]:
                        continue
                    w = v + steps[axis]
                    if labels[w] == 0 or labels[w] == labels[v]:
                        continue
                    height, passed = _saddle(squared, v, w), False
                    for way in range(6):
                        along, side = way // 2, way % 2
                        if along == axis or (last[along] if side else first[along]):
                            continue
                        step = steps[along] if side else -steps[along]
                        if labels[v + step] == labels[v] and labels[w + step] == labels[w]:
                            passed |= _saddle(squared, v + step, w + step) > height
                    if passed:
                        continue
                    if voxels is not None:
                        voxels[count], axes[count], heights[count] = v, axis, height
                        around[count] = surroundings(squared, shape, v) + surroundings(squared, shape, w)
                    count += 1
    return count


@njit(cache=True)
def _saddle(squared, v, w):
    """Height of the face between two voxels: the lower one's distance, then the higher one's."""
    low, high = np.int64(min(squared[v], squared[w])), np.int64(max(squared[v], squared[w]))
    return (low << 32) + high


@njit(cache=True)
def _cancel(squared, shape, labels, tops, voxels, axes, share, tree):
    """Join basins across the saddles, in this order, whose lower maximum does not persist: basin of each.

    The merge tree of the superlevel sets is followed beside the cancellations, both with the earliest, that
    is highest, maximum as root.
    """
    steps = np.array([shape[1] * shape[2], shape[2], 1])
    component, basin = np.arange(tops.size + 1), np.arange(tops.size + 1)
    for i in range(voxels.size):
        v, w = voxels[i], voxels[i] + steps[axes[i]]
        elder, younger = find_root(component, labels[v]), find_root(component, labels[w])
        if elder == younger:
            continue
        if younger < elder:
            elder, younger = younger, elder
        component[younger] = elder
        peak, saddle = np.sqrt(squared[tops[younger - 1]]), np.sqrt(min(squared[v], squared[w]))
        if peak - saddle < max(share * peak, DIGITISATION_VOXELS):
            one, other = find_root(basin, labels[v]), find_root(basin, labels[w])
            basin[max(one, other)] = min(one, other)
            _join(tree, v, w, axes[i])
    for i in range(basin.size):
        basin[i] = find_root(basin, i)
    return basin


@njit(cache=True)
def _number(labels, number):
    for i in range(labels.size):
        labels[i] = number[labels[i]]


@njit(cache=True)
def _join(tree, v, w, axis):
    tree[min(v, w)] |= np.uint8(1 << axis)
