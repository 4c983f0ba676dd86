r"""Loops of the pore space and of its network.

The pore space is the cubical complex :math:`X` whose vertices are the pore voxels, with an edge for two
that share a face, a square for four around an edge and a cube for eight around a corner: pore is 6-connected,
solid 26-connected. Its Betti numbers follow from counts, :math:`\beta_1 = \beta_0 + \beta_2 - \chi`, with
:math:`\beta_2` the closed pieces of solid (:func:`pore_betti_numbers`).

Give every pore the spanning tree along which it was grown. Tree edges are contracted; every other edge
generates a loop, and every square says that its four edges sum to nothing (over :math:`Z_2`; a part of space
has no torsion). Edges equal by these relations are one class: between two pores a piece of their interface,
inside a pore a cut through a ring. Pieces that differ by cuts only are one throat. What remains are relations
of three or four classes, where three pores meet along a line.

- The network of :math:`n` pores in :math:`\beta_0` components and :math:`m` throats has
  :math:`m - n + \beta_0` loops, of which those that the relations span, :math:`r` independent ones, bound
  discs in the pore space.
- The loops inside pores, that is the cuts modulo all relations, are :math:`s` more: self-loops.
- With them :math:`\beta_1(X) = m - n + \beta_0 - r + s`, whatever the partition: every loop of :math:`X` is a
  closed walk over edges, which the network's walks cover, and what that map forgets lies inside pores.

Which throats close the loops that bound discs is the persistence pairing of the filtration by distance
(Edelsbrunner, Letscher & Zomorodian 2002): every relation, in falling order, ends the youngest, that is
narrowest, throat that it can.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from grainfall.network.partition import Partition, face_neighbours, find_root, grown
from grainfall.volume.measures import euler_number

CHUNK = 1 << 16
"""First length of what grows during a sweep."""


@dataclass(frozen=True)
class Interfaces:
    """Where pores meet, and where a pore that is a ring meets itself.

    Attributes
    ----------
    voxels : (f,) ndarray of int64
        Flat index of the voxel on the lower side of each face of an interface.
    axes : (f,) ndarray of int8
        Axis of the face's normal: the other voxel is the next along it.
    throats : (f,) ndarray of int32
        Throat of each face, from 0.
    conns : (m, 2) ndarray of int32
        Pores of each throat, from 0, the lower first; equal for a self-loop.
    saddles : (m,) ndarray of int64
        First face of each throat in the filtration, which holds its largest distance.
    disc : (m,) ndarray of bool
        The throat closes a loop of the network that bounds a disc in the pore space.
    """

    voxels: np.ndarray
    axes: np.ndarray
    throats: np.ndarray
    conns: np.ndarray
    saddles: np.ndarray
    disc: np.ndarray


def find_interfaces(parts: Partition) -> Interfaces:
    """Throats of a partition as the faces of their interfaces, with the topology of the pore space.

    Throats come in falling order of their largest distance.

    Parameters
    ----------
    parts : Partition

    Returns
    -------
    Interfaces
    """
    found = find_classes(parts)
    ends = ends_of_faces(parts.labels, found.births) - 1
    ends.sort(axis=1)
    throat, first, disc = number_throats(ends, found.relations)
    final = throat[found.classes]
    inside = final >= 0
    keys, final = found.keys[inside], final[inside]
    by_throat = np.lexsort((keys, final))
    keys, final = keys[by_throat], final[by_throat]
    saddles = np.flatnonzero(keys == found.births[first][final])
    return Interfaces(keys // 3, (keys % 3).astype(np.int8), final, ends[first], saddles, disc)


def ends_of_faces(labels: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Labels (k, 2) before and behind faces, 3 * voxel + axis."""
    _, ny, nx = labels.shape
    before, flat = faces // 3, labels.reshape(-1)
    return np.stack([flat[before], flat[before + np.array([ny * nx, nx, 1])[faces % 3]]], axis=1)


def number_throats(ends: np.ndarray, relations: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Throats that classes of edges make up.

    Parameters
    ----------
    ends : (c, 2) array of int
        Pores that each class joins, the lower first.
    relations : (k, 4) array of int32
        As in :class:`Classes`; what comes out does not depend on their order.

    Returns
    -------
    throat : (c + 1,) ndarray of int32
        Throat of each class, from 0; -1 where it is of none, as class 0.
    first : (m,) ndarray of int64
        First class of each throat, from 0.
    disc : (m,) ndarray of bool
        As in :class:`Interfaces`.
    """
    cut = np.concatenate([[False], ends[:, 0] == ends[:, 1]])  # classes count from 1
    throat = _pieces_of_one(relations, cut)
    disc = _ended(np.where(cut, 0, throat)[relations], len(ends))
    # with cuts older than all throats, what the relations end of them are the cuts that others make up for
    number = np.zeros(len(cut), np.int32)
    number[1:][np.argsort(~cut[1:], kind="stable")] = np.arange(1, len(cut))
    keep = np.where(cut, ~_ended(number[relations], len(ends))[number], throat == np.arange(len(cut)))
    keep[0] = False
    final = np.where(keep, np.cumsum(keep, dtype=np.int32) - 1, np.int32(-1))[throat]
    first = np.flatnonzero(keep[1:])
    return final, first, (disc & ~cut)[1:][first]


@njit(cache=True, nogil=True)
def _pieces_of_one(relations, cut):
    """First class of the throat of every class: pieces of interface are one where only cuts part them."""
    parent = np.arange(cut.size, dtype=np.int32)
    for row in relations:
        one, two, pieces = 0, 0, 0
        for c in row:
            if c > 0 and not cut[c]:
                pieces += 1
                one, two = two, c
        if pieces == 2:
            one, two = find_root(parent, one), find_root(parent, two)
            parent[max(one, two)] = min(one, two)
    for c in range(cut.size):
        parent[c] = find_root(parent, c)
    return parent


@njit(cache=True, nogil=True)
def _slot(table, keys, key):
    """Place of a key in an open-addressing table of positions in `keys`, or the empty place for it."""
    mask = table.size - 1
    h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    i = np.int64(h >> np.uint64(20)) & mask
    while table[i] >= 0 and keys[table[i]] != key:
        i = (i + 1) & mask
    return i


@njit(cache=True, nogil=True)
def _enter(keys, count, size):
    """A table with the first `count` keys."""
    table = np.full(size, -1, np.int32)
    for p in range(count):
        table[_slot(table, keys, keys[p])] = p
    return table


@njit(cache=True, nogil=True)
def _reduce(terms, count):
    """Sum over Z2 of `count` classes in place: sorted, pairs and zeros gone; returns how many are left."""
    for i in range(1, count):
        t, j = terms[i], i
        while j > 0 and terms[j - 1] > t:
            terms[j] = terms[j - 1]
            j -= 1
        terms[j] = t
    left = 0
    for i in range(count):
        if terms[i] == 0:
            continue
        if left > 0 and terms[left - 1] == terms[i]:
            left -= 1
        else:
            terms[left] = terms[i]
            left += 1
    return left


@dataclass(frozen=True)
class Classes:
    """Classes of the edges of a partition that its trees do not contract.

    Attributes
    ----------
    keys : (f,) ndarray of int64
        Edges that were of a class, as 3 * voxel + axis.
    classes : (f,) ndarray of int32
        Their classes, 1 ... c by falling birth, or 0 where it has turned out to be contracted.
    births : (c,) ndarray of int64
        The edge with which each class was born: its first in the filtration, and of those that one voxel
        brings the first in the order of :func:`face_neighbours`.
    relations : (k, 4) ndarray of int32
        Classes that sum to nothing, three or four and the rest 0; in falling order where one sweep has found
        them.
    """

    keys: np.ndarray
    classes: np.ndarray
    births: np.ndarray
    relations: np.ndarray


def find_classes(parts: Partition) -> Classes:
    """Classes of the edges of a partition.

    They are the least fixed point of what squares say: one whose edges, without pairs and contracted ones,
    are of one class contracts it, one with two classes makes them one. What a square says stays true
    whatever others do, so that the order in which they are looked at does not matter.
    """
    shape, tree = parts.labels.shape, parts.tree.reshape(-1)
    squared = parts.squared_distance.reshape(-1)
    order = np.empty(np.count_nonzero(squared), np.int32 if squared.size < 2**31 else np.int64)
    if len(order):
        _sort_falling(squared, order)
    sweep = (squared, order, tree, shape)
    keys, classes = np.zeros(CHUNK, np.int64), np.zeros(CHUNK, np.int32)
    table = np.full(2 * CHUNK, -1, np.int32)
    parent, birth = np.zeros(CHUNK, np.int32), np.zeros(CHUNK, np.int64)
    relations, recent = np.zeros((CHUNK, 4), np.int32), np.zeros((CHUNK, 4), np.int32)
    at = np.zeros(4, np.int64)
    while not _sweep(*sweep, keys, classes, table, parent, birth, relations, recent, at):
        _, faces, count, related = at
        if faces + 6 > len(keys):
            keys, classes = longer(keys), longer(classes)
            table = _enter(keys, faces, 2 * len(table))
        if count + 7 > len(parent):
            parent, birth = longer(parent), longer(birth)
        if related + 12 > len(relations):
            relations = longer(relations)
    _, faces, count, related = at
    keys, classes, parent = keys[:faces], classes[:faces], parent[: count + 1]
    tree[keys // 3] &= np.uint8(7)
    number, relations = settle(parent, relations[:related])
    return Classes(
        keys, number[classes], birth[np.flatnonzero(parent == np.arange(len(parent)))[1:]], relations
    )


def settle(parent: np.ndarray, relations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number the classes that are left when relations unite no more.

    Parameters
    ----------
    parent : (c + 1,) array of int32
        A class that each class is one with, no higher than itself; changed in place.
    relations : (k, 4) array of int32
        Classes that sum to nothing, the rest 0; changed in place.

    Returns
    -------
    number : (c + 1,) ndarray of int32
        The classes that are left, from 1 in the same order; 0 for those that are contracted.
    relations : (j, 4) ndarray of int32
        Those of three or four of them.
    """
    relations = relations[: _unite(parent, relations)]
    roots = parent == np.arange(len(parent))
    number = np.where(roots, np.cumsum(roots, dtype=np.int32) - 1, np.int32(0))[parent]
    return number, number[relations]


def longer(values: np.ndarray) -> np.ndarray:
    """The array with as many zeros after it."""
    return np.concatenate([values, np.zeros_like(values)])


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _sweep(squared, order, tree, shape, keys, classes, table, parent, birth, relations, recent, at):
    """Sweep the filtration on from `at` (voxels swept, faces, classes, relations): whether it is finished.

    Class 0 is contracted. A class is born with an edge that no square ties to earlier ones, and is united
    with another, or with 0, by squares of two, or one, classes; squares of more are kept as relations, each
    but once where it comes again soon. Stops where an array might overflow.
    """
    nz, ny, nx = shape
    near = np.empty(6, np.int64)
    own = np.empty(6, np.int32)
    linked = np.empty(6, np.int64)
    opposite = np.empty((2, 6, 6), np.int32)
    square = np.empty((6, 6), np.bool_)
    terms = np.empty(4, np.int32)
    first, faces, count, related = at
    for turn in range(first, order.size):
        if faces + 6 > keys.size or count + 7 > parent.size or related + 12 > relations.shape[0]:
            at[:] = turn, faces, count, related
            return False
        v = np.int64(order[turn])
        face_neighbours(v, nz, ny, nx, near)
        height = squared[v]
        earlier = 0
        for k in range(6):
            w = near[k]
            if w >= 0 and (squared[w] > height or (squared[w] == height and w < v)):
                earlier += 1
            else:
                near[k] = -1
        if earlier == 0:
            continue
        unknown, reached, all_near, flat_squares = 0, 0, 0, True
        for k in range(6):
            linked[k] = 0
            if near[k] >= 0:
                all_near |= 1 << k
                if tree[min(v, near[k])] & np.uint8(1 << (k // 2)):
                    own[k] = 0
                    reached |= 1 << k
                else:
                    own[k] = -1
                    unknown += 1
        for a in range(5):
            if near[a] < 0:
                continue
            for b in range(2 * (a // 2) + 2, 6):
                square[a, b] = square[b, a] = False
                if near[b] < 0:
                    continue
                w = near[a] + near[b] - v
                if squared[w] > height or (squared[w] == height and w < v):
                    square[a, b] = square[b, a] = True
                    for other in range(2):
                        corner, axis = (near[b], a // 2) if other else (near[a], b // 2)
                        c = np.int32(0)
                        if tree[min(corner, w)] & np.uint8(8 << axis):
                            key = min(corner, w) * 3 + axis
                            c = np.int32(find_root(parent, classes[table[_slot(table, keys, key)]]))
                        opposite[other, a, b] = opposite[other, b, a] = c
                        flat_squares &= c == 0
                    linked[a] |= 1 << b
                    linked[b] |= 1 << a
        if earlier == 1 and unknown == 0:
            continue  # an edge of the tree alone
        if flat_squares:
            # nearly everywhere all edges are tied to a tree edge by squares that are otherwise contracted
            before = 0
            while reached != before:
                before = reached
                for k in range(6):
                    if reached & (1 << k):
                        reached |= linked[k]
            if reached == all_near:
                continue
        while unknown > 0:
            found = True
            while found and unknown > 0:
                found = False
                for b in range(6):
                    if near[b] < 0 or own[b] >= 0:
                        continue
                    for a in range(6):
                        if a // 2 == b // 2 or near[a] < 0 or own[a] < 0 or not square[a, b]:
                            continue
                        terms[0], terms[1], terms[2] = own[a], opposite[0, a, b], opposite[1, a, b]
                        left = _reduce(terms, 3)
                        if left < 2:
                            own[b] = terms[0] if left else 0
                            unknown -= 1
                            found = True
                            break
            if unknown > 0:
                for b in range(6):
                    if near[b] >= 0 and own[b] < 0:
                        count += 1
                        parent[count] = count
                        birth[count] = min(v, near[b]) * 3 + b // 2
                        own[b] = count
                        unknown -= 1
                        break
        for a in range(5):
            if near[a] < 0:
                continue
            for b in range(2 * (a // 2) + 2, 6):
                if near[b] < 0 or not square[a, b]:
                    continue
                if own[a] == own[b] and opposite[0, a, b] == opposite[1, a, b]:
                    continue
                terms[0] = find_root(parent, own[a])
                terms[1] = find_root(parent, own[b])
                terms[2] = find_root(parent, opposite[0, a, b])
                terms[3] = find_root(parent, opposite[1, a, b])
                left = _reduce(terms, 4)
                if left == 1:
                    parent[terms[0]] = 0
                elif left == 2:
                    parent[terms[1]] = terms[0]
                elif left > 2:
                    for i in range(left, 4):
                        terms[i] = 0
                    h = terms[0] * 73856093 ^ terms[1] * 19349663 ^ terms[2] * 83492791 ^ terms[3] * 49979687
                    h &= recent.shape[0] - 1
                    again = True
                    for i in range(4):
                        again &= recent[h, i] == terms[i]
                        recent[h, i] = relations[related, i] = terms[i]
                    related += not again
        for k in range(6):
            if near[k] >= 0 and own[k] > 0:
                low = min(v, near[k])
                tree[low] |= np.uint8(8 << (k // 2))
                keys[faces] = low * 3 + k // 2
                classes[faces] = own[k]
                table[_slot(table, keys, keys[faces])] = faces
                faces += 1
    at[:] = order.size, faces, count, related
    return True


@njit(cache=True, nogil=True)
def _unite(parent, relations):
    """Unite classes by the relations until none is of fewer than three; returns how many relations are left.

    Relations that the unions have shortened unite further classes.
    """
    terms = np.empty(4, np.int32)
    changed, related = True, relations.shape[0]
    while changed:
        changed = False
        kept = 0
        for r in range(related):
            for i in range(4):
                terms[i] = find_root(parent, relations[r, i])
            left = _reduce(terms, 4)
            if left == 1:
                parent[terms[0]] = 0
                changed = True
            elif left == 2:
                parent[terms[1]] = terms[0]
                changed = True
            elif left > 2:
                relations[kept, :left] = terms[:left]
                relations[kept, left:] = 0
                kept += 1
        related = kept
    for c in range(parent.size):
        parent[c] = find_root(parent, c)
    return related


@njit(cache=True, nogil=True)
def _push(heap, size, value):
    if size == heap.size:
        heap = grown(heap)
    i = size
    while i > 0 and heap[(i - 1) // 2] < value:
        heap[i] = heap[(i - 1) // 2]
        i = (i - 1) // 2
    heap[i] = value
    return heap, size + 1


@njit(cache=True, nogil=True)
def _pop(heap, size):
    """Drop the largest value of the heap."""
    size -= 1
    value = heap[size]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and heap[child + 1] > heap[child]:
            child += 1
        if heap[child] <= value:
            break
        heap[i] = heap[child]
        i = child
    heap[i] = value
    return size


@njit(cache=True, nogil=True)
def _pop_odd(heap, size):
    """Take out the largest value that is there an odd number of times (pairs cancel), 0 if none is, and the
    size left."""
    while size > 0:
        value = heap[0]
        size = _pop(heap, size)
        if size == 0 or heap[0] != value:
            return value, size
        size = _pop(heap, size)
    return np.int32(0), size


@njit(cache=True, nogil=True)
def _ended(relations, count):
    """Classes 0 ... `count`, the older the lower, that the relations end: (count + 1,) bool.

    The standard reduction of persistent homology: every relation is added to by earlier ones until its
    youngest class is no earlier one's, or nothing is left of it.
    """
    ends = np.zeros(count + 1, np.bool_)
    start = np.zeros(count + 1, np.int64)  # in `reduced`, of the relation that ends a class
    length = np.zeros(count + 1, np.int32)
    reduced = np.empty(1 << 12, np.int32)
    used = 0
    heap = np.empty(64, np.int32)
    for r in range(relations.shape[0]):
        size = 0
        for i in range(4):
            if relations[r, i] > 0:
                heap, size = _push(heap, size, relations[r, i])
        youngest, size = _pop_odd(heap, size)
        while youngest > 0:
            if length[youngest] == 0:
                ends[youngest] = True
                start[youngest] = used
                while used + size + 1 > reduced.size:
                    reduced = grown(reduced)
                value = youngest
                while value > 0:
                    reduced[used] = value
                    used += 1
                    length[youngest] += 1
                    value, size = _pop_odd(heap, size)
                break
            for p in range(start[youngest] + 1, start[youngest] + length[youngest]):
                heap, size = _push(heap, size, reduced[p])
            youngest, size = _pop_odd(heap, size)
    return ends


def pore_betti_numbers(pore: np.ndarray) -> tuple[int, int, int]:
    """Components, loops and cavities of the pore space.

    Pore voxels are connected by faces, solid ones by faces, edges and corners; what lies outside the image is
    one with the solid that touches its faces.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool

    Returns
    -------
    components, loops, cavities : int
    """
    pore = np.ascontiguousarray(pore, bool)
    components = _count_pieces(pore, True, False)
    cavities = _count_pieces(pore, False, True) - 1
    return components, components + cavities - euler_number(pore), cavities


@njit(cache=True, nogil=True)
def _count_pieces(image, value, corners):
    """Pieces of the voxels of a value, by faces or by corners too; the latter with what lies outside.

    One pass, two planes of provisional numbers and a forest: no image of labels.
    """
    nz, ny, nx = image.shape
    parent = np.zeros(1 << 12, np.int32)
    count = 1 if corners else 0  # the outside is number 1
    pieces = count
    parent[1] = 1
    below = np.zeros((ny + 2, nx + 2), np.int32)
    plane = np.zeros((ny + 2, nx + 2), np.int32)
    for z in range(nz):
        below, plane = plane, below
        plane[:] = 0
        for y in range(ny):
            for x in range(nx):
                if image[z, y, x] != value:
                    continue
                own = 0
                edge = z == 0 or y == 0 or x == 0 or z == nz - 1 or y == ny - 1 or x == nx - 1
                for k in range(14 if corners else 3):
                    if not corners:
                        other = (
                            plane[y + 1, x] if k == 0 else plane[y, x + 1] if k == 1 else below[y + 1, x + 1]
                        )
                    elif k == 0:
                        other = plane[y + 1, x]
                    elif k < 4:
                        other = plane[y, x + k - 1]
                    elif k < 13:
                        other = below[y + (k - 4) // 3, x + (k - 4) % 3]
                    else:
                        other = 1 if edge else 0
                    if other == 0 or other == own:
                        continue
                    if own == 0:
                        own = other
                        continue
                    one, two = find_root(parent, own), find_root(parent, other)
                    if one != two:
                        parent[max(one, two)] = min(one, two)
                        pieces -= 1
                if own == 0:
                    count += 1
                    pieces += 1
                    if count == parent.size:
                        parent = grown(parent)
                    own = parent[count] = count
                plane[y + 1, x + 1] = own
    return pieces
