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


CHUNK = 1 << 16
"""First length of what grows during a sweep."""


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
    order : (N,) ndarray of int32 or int64
        Flat indices of the pore voxels by falling distance, ties by index: the filtration.
    peaks : (n,) ndarray of int64
        Flat index of the first voxel of each pore in that order, a maximum of the distance.
    """

    labels: np.ndarray
    squared_distance: np.ndarray
    tree: np.ndarray
    order: np.ndarray
    peaks: np.ndarray


def partition(pore: np.ndarray, *, persistence: float = PERSISTENCE, threads: int = 1) -> Partition:
    r"""Part the pore space at the necks of its distance map.

    The superlevel sets of the distance :math:`d` to the solid are swept downwards, pore voxels only,
    neighbours by faces (6-connected; so the solid is 26-connected). A voxel joins the basin of its highest
    neighbour or, being a maximum, opens one. Where two components meet, at a saddle :math:`d_s`, the lower
    maximum
    :math:`d_m` dies (elder rule); it stays a pore of its own if its persistence

    .. math:: d_m - d_s \ge \max(h\,d_m,\ 1\,\mathrm{voxel})

    and otherwise its basin is merged with that across the saddle: the threshold grows with the pore, so that
    the answer does not depend on the magnification. The number of pores does not depend on how ties are
    broken.

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
    squared = squared.astype(np.uint16 if squared.max() < 2**16 else np.uint32).reshape(-1)
    order = np.empty(np.count_nonzero(squared), np.int32 if squared.size < 2**31 else np.int64)
    _sort_falling(squared, order)
    labels, tree = np.zeros(squared.size, np.int32), np.zeros(squared.size, np.uint8)
    component, basin, top = (np.zeros(CHUNK, kind) for kind in (np.int32, np.int32, np.int64))
    saddles = np.zeros((3, CHUNK), np.int64)
    at = np.zeros(3, np.int64)
    rule = (persistence, DIGITISATION_VOXELS)
    while not _flood(squared, order, pore.shape, *rule, labels, tree, component, basin, top, saddles, at):
        component, basin, top = (longer(a) for a in (component, basin, top))
        saddles = np.concatenate([saddles, np.zeros_like(saddles)], axis=1)
    peaks = _number(labels, basin, top, at[1])
    whole = (a.reshape(pore.shape) for a in (labels, squared, tree))
    return Partition(*whole, order, peaks)


@njit(cache=True)
def _sort_falling(squared, order):
    """Indices of the positive values by falling value, ties by index: a counting sort of whole numbers."""
    largest = np.int64(squared.max())
    start = np.zeros(largest + 2, np.int64)
    for i in range(squared.size):
        start[largest - np.int64(squared[i]) + 1] += 1
    for k in range(1, largest + 2):
        start[k] += start[k - 1]
    for i in range(squared.size):
        value = np.int64(squared[i])
        if value > 0:
            order[start[largest - value]] = i
            start[largest - value] += 1


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


def longer(values: np.ndarray) -> np.ndarray:
    """The array with as many zeros after it."""
    return np.concatenate([values, np.zeros_like(values)])


@njit(cache=True)
def _flood(squared, order, shape, share, floor, labels, tree, component, basin, top, saddles, at):
    """Sweep the filtration on from `at` (voxels swept, maxima, saddles waiting): whether it is finished.

    Stops where an array might overflow (arrays that grow in the loop itself cost more than all its work).
    `component` follows the merge tree of the superlevel sets, `basin` the cancellations, both with the
    earliest, that is highest, maximum as root; `top` is its voxel. Saddles (voxel, way to the neighbour,
    height of what lies around both) wait for the others of their height and are taken by that rank, which
    does not depend on the order of the axes.
    """
    nz, ny, nx = shape
    steps = np.array([ny * nx, nx, 1])
    near = np.empty(6, np.int64)
    first, count, waiting = at
    for turn in range(first, order.size):
        if count + 2 > top.size or waiting + 6 > saddles.shape[1]:
            at[:] = turn, count, waiting
            return False
        v = np.int64(order[turn])
        face_neighbours(v, nz, ny, nx, near)
        own = np.int64(squared[v])
        best, height, way = 0, own, 0
        for k in range(6):
            w = near[k]
            if w < 0:
                continue
            level = np.int64(squared[w])
            if level < height or labels[w] == 0:
                continue  # the lower have not been swept
            if (
                level > height
                or best == 0
                or (labels[w] != best and _precedes(squared, shape, w, labels[w], near[way], best))
            ):
                best, height, way = labels[w], level, k
        if best == 0:
            count += 1
            component[count] = basin[count] = count
            top[count] = v
            labels[v] = count
        else:
            best = find_root(basin, best)
            labels[v] = best
            _join(tree, v, near[way], way)
            for k in range(6):
                w = near[k]
                if w < 0 or squared[w] < own or labels[w] == 0 or labels[w] == best:
                    continue
                if find_root(component, best) != find_root(component, labels[w]):
                    saddles[0, waiting], saddles[1, waiting] = v, k
                    rank = surroundings(squared, shape, v) + surroundings(squared, shape, w)
                    saddles[2, waiting] = -rank
                    waiting += 1
        if waiting == 0 or (turn + 1 < order.size and squared[order[turn + 1]] == squared[v]):
            continue
        depth = np.sqrt(squared[v])
        for i in np.argsort(saddles[2, :waiting], kind="mergesort"):
            v, k = saddles[0, i], saddles[1, i]
            w = v + (1 if k % 2 else -1) * steps[k // 2]
            elder, younger = find_root(component, labels[v]), find_root(component, labels[w])
            if elder == younger:
                continue
            if younger < elder:
                elder, younger = younger, elder
            component[younger] = elder
            peak = np.sqrt(squared[top[younger]])
            if peak - depth < max(share * peak, floor):
                one, other = find_root(basin, labels[v]), find_root(basin, labels[w])
                basin[max(one, other)] = min(one, other)
                _join(tree, v, w, k)
        waiting = 0
    at[:] = order.size, count, 0
    return True


@njit(cache=True)
def _number(labels, basin, top, count):
    """Number the pores by their maxima, in the order these were met, and return the maxima's voxels."""
    number = np.zeros(count + 1, np.int32)
    pores = 0
    for i in range(1, count + 1):
        root = find_root(basin, i)
        if root == i:
            pores += 1
            number[i] = pores
            top[pores] = top[i]
        else:
            number[i] = number[root]
    for i in range(labels.size):
        labels[i] = number[labels[i]]
    return top[1 : pores + 1].copy()


@njit(cache=True)
def _precedes(squared, shape, v, one, w, other):
    """Whether of two equally high voxels of basins `one` and `other` the first is the way up.

    By the height of what lies around them, which does not depend on the order of the axes, then by that of
    the basins.
    """
    here, there = surroundings(squared, shape, v), surroundings(squared, shape, w)
    return here > there or (here == there and one < other)


@njit(cache=True)
def surroundings(squared, shape, v):
    """Sum of the 5 x 5 x 5 values around a voxel, the image going on beyond its faces."""
    nz, ny, nx = shape
    z = v // (ny * nx)
    y = v // nx - z * ny
    x = v - (z * ny + y) * nx
    total = 0
    for i in range(z - 2, z + 3):
        for j in range(y - 2, y + 3):
            row = (min(max(i, 0), nz - 1) * ny + min(max(j, 0), ny - 1)) * nx
            for k in range(x - 2, x + 3):
                total += np.int64(squared[row + min(max(k, 0), nx - 1)])
    return total


@njit(cache=True)
def _join(tree, v, w, way):
    tree[min(v, w)] |= np.uint8(1 << (way // 2))
