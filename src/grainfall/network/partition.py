"""The pore space parted into pores: maxima of the distance map merged by persistence, and their basins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from grainfall.errors import InputError
from grainfall.network.distance import squared_distances

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


def partition(pore: np.ndarray, *, persistence: float = PERSISTENCE) -> Partition:
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

    Returns
    -------
    Partition

    Raises
    ------
    InputError
        When the parameter is out of its range.
    """
    check_persistence(persistence)
    squared = squared_distances(pore)
    basins = find_basins(squared, 0, len(squared))
    tops = np.lexsort((-basins.around, -basins.heights))
    rank = np.zeros(len(tops) + 1, np.int32)
    rank[1:][tops] = np.arange(1, len(tops) + 1)
    saddles = basins.saddles.sort()
    pores, joined = join_basins(basins.heights[tops], rank[saddles.ends], saddles.heights, persistence)
    join_trees(basins.tree, saddles.faces[joined])
    number_voxels(basins.labels.reshape(-1), pores[rank])
    peaks = basins.tops[tops][np.unique(pores[1:], return_index=True)[1]]
    return Partition(basins.labels, squared, basins.tree, peaks)


def check_persistence(persistence: float) -> None:
    """Raise an InputError where a persistence is out of its range."""
    if not 0 <= persistence < 1:
        raise InputError("network.persistence", f"{persistence} is out of range", "0 ≤ persistence < 1")


@dataclass(frozen=True)
class Saddles:
    """Faces between basins.

    Attributes
    ----------
    faces : (k,) ndarray of int64
        3 * flat index of the voxel before the face + axis of its normal.
    ends : (k, 2) ndarray of int32
        The basins before and behind it.
    heights : (k,) ndarray of int64
        Squared distance of the lower voxel, times 2^32, and of the higher.
    around : (k,) ndarray of int64
        Sum of the :func:`surroundings` of both.
    """

    faces: np.ndarray
    ends: np.ndarray
    heights: np.ndarray
    around: np.ndarray

    def sort(self) -> Saddles:
        """The same in falling order, ties by place."""
        return self[np.lexsort((self.faces, -self.around, -self.heights))]

    def __getitem__(self, which: np.ndarray) -> Saddles:
        return Saddles(self.faces[which], self.ends[which], self.heights[which], self.around[which])


@dataclass(frozen=True)
class Basins:
    """The basins of some planes of a volume, before any are joined.

    Attributes
    ----------
    labels : (nz, ny, nx) ndarray of int32
        Where the way up from each voxel ends, or leaves those planes: the pore voxels of the plane before
        come first, then the maxima, then the pore voxels of the plane behind, from 1; 0 elsewhere.
    tree : (nz, ny, nx) ndarray of uint8
        As in :class:`Partition`, by the ways up from the voxels of those planes and of the one behind.
    tops : (n,) ndarray of int64
        Flat indices of the maxima.
    heights, around : (n,) ndarray of int64
        Their squared distances and :func:`surroundings`.
    saddles : Saddles
        Faces between basins, those to the plane behind among them, by place.
    """

    labels: np.ndarray
    tree: np.ndarray
    tops: np.ndarray
    heights: np.ndarray
    around: np.ndarray
    saddles: Saddles


def find_basins(squared: np.ndarray, start: int, stop: int) -> Basins:
    """Basins of the maxima of the distance in some planes, and the ways out of them.

    Parameters
    ----------
    squared : (nz, ny, nx) array of uint16 or uint32
        Squared distance in those planes, in three or more before them and in four or more behind, or as many
        as there are.
    start, stop : int
        The planes are those from ``start`` on, before ``stop``.

    Returns
    -------
    Basins
    """
    shape, flat = squared.shape, squared.reshape(-1)
    labels, tree = np.zeros(shape, np.int32), np.zeros(shape, np.uint8)
    ways, numbers = tree.reshape(-1), labels.reshape(-1)
    tops = np.empty(_ascend(flat, shape, start, stop, ways), np.int64)
    around = np.empty(len(tops), np.int64)
    _find_tops(flat, shape, ways, tops, around)
    if stop < len(squared):  # ways down into the last plane are edges of the tree like others
        _ascend(flat, shape, stop, stop + 1, ways)
    plane = shape[1] * shape[2]
    beside = [
        np.flatnonzero(flat[max(z, 0) * plane : (z + 1) * plane]) + z * plane for z in (start - 1, stop)
    ]
    seeds = np.concatenate([beside[0], tops, beside[1]])
    numbers[seeds] = np.arange(1, len(seeds) + 1)
    _descend(shape, ways, numbers)
    faces, before, behind, *known = _find_saddles(flat, shape, start, stop, numbers)
    saddles = Saddles(faces, np.stack([before, behind], axis=1), *known)
    return Basins(labels, tree, tops, flat[tops].astype(np.int64), around, saddles)


def join_basins(
    tops: np.ndarray, ends: np.ndarray, heights: np.ndarray, persistence: float
) -> tuple[np.ndarray, np.ndarray]:
    """Join basins across saddles until every maximum persists.

    Parameters
    ----------
    tops : (n,) array of int
        Squared distance of the maxima in falling order.
    ends : (k, 2) array of int
        Basins on the two sides of the saddles, 1 ... n, in falling order of these.
    heights : (k,) array of int64
        Of the saddles, as :class:`Saddles` has them.
    persistence : float
        As for :func:`partition`.

    Returns
    -------
    pores : (n + 1,) ndarray of int32
        Pore of each basin; 0 of 0, the solid.
    joined : (k,) ndarray of bool
        Saddles across which basins were joined.
    """
    basin, joined = _cancel(tops, ends, heights >> 32, persistence)
    alive = basin == np.arange(len(basin))  # the solid, 0, is a basin of its own
    return (np.cumsum(alive, dtype=np.int32) - 1)[basin], joined


def join_trees(tree: np.ndarray, faces: np.ndarray) -> None:
    """Join the trees on the two sides of faces, 3 * voxel + axis."""
    bits = np.left_shift(1, faces % 3).astype(np.uint8)
    np.bitwise_or.at(tree.reshape(-1), faces // 3, bits)  # a voxel may stand before several faces


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def grown(values):
    """The values in an array twice as long."""
    twice = np.empty(2 * values.size, values.dtype)
    twice[: values.size] = values
    return twice


@njit(cache=True, nogil=True)
def find_root(parent, i):
    """Root of i in a forest, halving the path to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _ascend(squared, shape, start, stop, tree):
    """Draw the way up from every voxel of some planes, and note it (1 ... 6, maxima 7) above the tree's bits.

    Returns the number of maxima.
    """
    near = np.empty(6, np.int64)
    tops = 0
    for v in range(start * shape[1] * shape[2], stop * shape[1] * shape[2]):
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


@njit(cache=True, nogil=True)
def _find_tops(squared, shape, tree, tops, around):
    count = 0
    for v in range(tree.size):
        if tree[v] >> 3 == 7:
            tops[count], around[count] = v, surroundings(squared, shape, v)
            count += 1


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _find_saddles(squared, shape, start, stop, labels):
    """Faces between two basins, without those beside a higher one of the same, as :class:`Saddles` has them,
    the basins before and behind one after the other."""
    nz, ny, nx = shape
    faces, before, behind = np.empty(1024, np.int64), np.empty(1024, np.int32), np.empty(1024, np.int32)
    heights, around = np.empty(1024, np.int64), np.empty(1024, np.int64)
    steps = (ny * nx, nx, 1)
    count, v = 0, start * ny * nx - 1
    for z in range(start, stop):
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
                    if count == faces.size:
                        faces, before, behind = grown(faces), grown(before), grown(behind)
                        heights, around = grown(heights), grown(around)
                    faces[count], heights[count] = 3 * v + axis, height
                    before[count], behind[count] = labels[v], labels[w]
                    around[count] = surroundings(squared, shape, v) + surroundings(squared, shape, w)
                    count += 1
    return faces[:count], before[:count], behind[:count], heights[:count], around[:count]


@njit(cache=True, nogil=True)
def _saddle(squared, v, w):
    """Height of the face between two voxels: the lower one's distance, then the higher one's."""
    low, high = np.int64(min(squared[v], squared[w])), np.int64(max(squared[v], squared[w]))
    return (low << 32) + high


@njit(cache=True, nogil=True)
def _cancel(tops, ends, lows, share):
    """Join basins across the saddles, in this order, whose lower maximum does not persist.

    The merge tree of the superlevel sets is followed beside the cancellations, both with the earliest, that
    is highest, maximum as root. Returns the basin of each, and which saddles have joined two.
    """
    component, basin = np.arange(tops.size + 1), np.arange(tops.size + 1)
    joined = np.zeros(lows.size, np.bool_)
    for i in range(lows.size):
        v, w = ends[i]
        elder, younger = find_root(component, v), find_root(component, w)
        if elder == younger:
            continue
        if younger < elder:
            elder, younger = younger, elder
        component[younger] = elder
        peak, saddle = np.sqrt(tops[younger - 1]), np.sqrt(lows[i])
        if peak - saddle < max(share * peak, DIGITISATION_VOXELS):
            one, other = find_root(basin, v), find_root(basin, w)
            basin[max(one, other)] = min(one, other)
            joined[i] = True
    for i in range(basin.size):
        basin[i] = find_root(basin, i)
    return basin, joined


@njit(cache=True, nogil=True)
def number_voxels(labels, number):
    """Replace labels by their numbers, in place."""
    for i in range(labels.size):
        labels[i] = number[labels[i]]


@njit(cache=True, nogil=True)
def _join(tree, v, w, axis):
    tree[min(v, w)] |= np.uint8(1 << axis)
