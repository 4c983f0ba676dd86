r"""Loops of the pore space and of its network.

The pore space is the cubical complex :math:`X` whose vertices are the pore voxels, with an edge for two
that share a face, a square for four around an edge and a cube for eight around a corner: pore is 6-connected,
solid 26-connected. Its Betti numbers follow from counts, :math:`\beta_1 = \beta_0 + \beta_2 - \chi`, with
:math:`\beta_2` the closed pieces of solid (:func:`pore_betti_numbers`).

Give every pore the spanning tree along which it was grown. Tree edges are contracted; every other edge
generates a loop, and every square says that its four edges sum to nothing (over :math:`Z_2`; a part of space
has no torsion). Edges equal by these relations are one class (:func:`find_interfaces`): between two pores,
one connected piece of their interface, a throat; inside a pore, a cut through a ring, a self-loop. What
remains are relations of three or four classes, where three pores meet along a line. Of :math:`c` classes, on
:math:`n` pores in :math:`\beta_0` components and with :math:`r` independent relations,

.. math:: \beta_1(X) = c - (n - \beta_0) - r ,

so that :math:`r` of the network's loops bound a disc in the pore space. Which throats close them is the
persistence pairing of the filtration by distance (Edelsbrunner, Letscher & Zomorodian 2002): every relation,
in falling order, ends the youngest, that is narrowest, class that it can (:func:`discs`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from grainfall.network.partition import Partition, _grown, find_root


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

    Throats come in falling order of their largest distance. A self-loop that bounds a disc (a pore around
    another) is none of the pore space and left out.

    Parameters
    ----------
    parts : Partition

    Returns
    -------
    Interfaces
    """
    keys, classes, births, relations = _classes(
        parts.labels.reshape(-1),
        parts.squared_distance.reshape(-1),
        parts.order,
        parts.tree.reshape(-1),
        parts.labels.shape,
    )
    alive = classes > 0
    keys, classes = keys[alive], classes[alive]
    # classes are numbered by falling birth
    disc = _discs(relations, len(births))
    flat = parts.labels.reshape(-1)
    _, ny, nx = parts.labels.shape
    steps = np.array([ny * nx, nx, 1])
    saddle_voxels, saddle_axes = births // 3, births % 3
    ends = np.stack([flat[saddle_voxels], flat[saddle_voxels + steps[saddle_axes]]], axis=1) - 1
    ends.sort(axis=1)
    keep = ~(disc & (ends[:, 0] == ends[:, 1]))
    number = np.cumsum(keep, dtype=np.int32) - 1
    stays = keep[classes - 1]
    keys, classes = keys[stays], number[classes[stays] - 1]
    by_throat = np.lexsort((keys, classes))
    keys, classes = keys[by_throat], classes[by_throat]
    saddles = np.flatnonzero(keys == births[keep][classes])
    return Interfaces(keys // 3, (keys % 3).astype(np.int8), classes, ends[keep], saddles, disc[keep])


@njit(cache=True)
def _slot(table, keys, key):
    """Place of a key in an open-addressing table of positions in `keys`, or the empty place for it."""
    mask = table.size - 1
    h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    i = np.int64(h >> np.uint64(20)) & mask
    while table[i] >= 0 and keys[table[i]] != key:
        i = (i + 1) & mask
    return i


@njit(cache=True)
def _enter(table, keys, count):
    """A table twice as large with the first `count` keys."""
    larger = np.full(2 * table.size, -1, np.int32)
    for p in range(count):
        larger[_slot(larger, keys, keys[p])] = p
    return larger


@njit(cache=True)
def _class_of(p, q, steps_way, parent, marked, table, keys, classes):
    """Class of the edge between two neighbours, both swept; 0 where it is contracted."""
    low = min(p, q)
    if not marked[low] & np.uint8(8 << steps_way):
        return np.int32(0)
    return np.int32(find_root(parent, classes[table[_slot(table, keys, low * 3 + steps_way)]]))


@njit(cache=True)
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


@njit(cache=True)
def _classes(labels, squared, order, tree, shape):
    """Sweep the filtration once more and sort its edges into classes.

    Class 0 is contracted. A class is born with an edge that no square ties to earlier ones, and is united
    with another, or with 0, by squares of two, or one, classes; squares of more are kept as relations.

    Returns the edges that were of a class (3 * voxel + axis) and their classes, 1 ... c by falling birth or
    0, the edge of each birth, and relations (k, 4) of classes, padded by 0, in falling order.
    """
    nz, ny, nx = shape
    plane = ny * nx
    keys = np.empty(1 << 12, np.int64)
    classes = np.empty(1 << 12, np.int32)
    table = np.full(1 << 13, -1, np.int32)
    faces = 0
    parent = np.zeros(1 << 12, np.int32)
    birth = np.empty(1 << 12, np.int64)
    count = 0
    relations = np.empty((1 << 12, 4), np.int32)
    related = 0
    recent = np.zeros((1 << 12, 4), np.int32)
    near = np.empty(6, np.int64)
    own = np.empty(6, np.int32)
    linked = np.empty(6, np.int64)
    first = np.empty((6, 6), np.int32)
    second = np.empty((6, 6), np.int32)
    square = np.empty((6, 6), np.bool_)
    terms = np.empty(4, np.int32)
    for voxel in order:
        v = np.int64(voxel)
        z = v // plane
        y = (v - z * plane) // nx
        x = v - z * plane - y * nx
        near[0] = v - plane if z > 0 else -1
        near[1] = v + plane if z < nz - 1 else -1
        near[2] = v - nx if y > 0 else -1
        near[3] = v + nx if y < ny - 1 else -1
        near[4] = v - 1 if x > 0 else -1
        near[5] = v + 1 if x < nx - 1 else -1
        height = squared[v]
        earlier = 0
        for k in range(6):
            w = near[k]
            if w >= 0 and (squared[w] > height or (squared[w] == height and w < v)):
                earlier += 1
            else:
                near[k] = -1
        if earlier < 2:
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
                    first[a, b] = first[b, a] = _class_of(
                        near[a], w, b // 2, parent, tree, table, keys, classes
                    )
                    second[a, b] = second[b, a] = _class_of(
                        near[b], w, a // 2, parent, tree, table, keys, classes
                    )
                    linked[a] |= 1 << b
                    linked[b] |= 1 << a
                    flat_squares &= first[a, b] == 0 and second[a, b] == 0
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
                        terms[0], terms[1], terms[2] = own[a], first[a, b], second[a, b]
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
                        if count == parent.size:
                            parent, birth = _grown(parent), _grown(birth)
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
                if own[a] == own[b] and first[a, b] == second[a, b]:
                    continue
                terms[0] = find_root(parent, own[a])
                terms[1] = find_root(parent, own[b])
                terms[2] = find_root(parent, first[a, b])
                terms[3] = find_root(parent, second[a, b])
                left = _reduce(terms, 4)
                if left == 1:
                    parent[terms[0]] = 0
                elif left == 2:
                    parent[terms[1]] = terms[0]
                elif left > 2:
                    for i in range(left, 4):
                        terms[i] = 0
                    h = terms[0] * 73856093 ^ terms[1] * 19349663 ^ terms[2] * 83492791 ^ terms[3] * 49979687
                    seen = recent[h & (recent.shape[0] - 1)]
                    if (
                        seen[0] == terms[0]
                        and seen[1] == terms[1]
                        and seen[2] == terms[2]
                        and seen[3] == terms[3]
                    ):
                        continue
                    seen[:] = terms
                    if related == relations.shape[0]:
                        longer = np.empty((2 * related, 4), np.int32)
                        longer[:related] = relations
                        relations = longer
                    relations[related] = terms
                    related += 1
        for k in range(6):
            if near[k] >= 0 and own[k] > 0:
                low = min(v, near[k])
                tree[low] |= np.uint8(8 << (k // 2))
                if faces == keys.size:
                    keys, classes = _grown(keys), _grown(classes)
                if 2 * faces > table.size:
                    table = _enter(table, keys, faces)
                keys[faces] = low * 3 + k // 2
                classes[faces] = own[k]
                table[_slot(table, keys, keys[faces])] = faces
                faces += 1
    # relations that the unions have shortened unite further classes
    changed = True
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
    number = np.zeros(count + 1, np.int32)
    living = 0
    for c in range(1, count + 1):
        if parent[c] == c:
            living += 1
            number[c] = living
            birth[living] = birth[c]
    for f in range(faces):
        tree[keys[f] // 3] &= np.uint8(7)
        classes[f] = number[find_root(parent, classes[f])]
    for r in range(related):
        for i in range(4):
            relations[r, i] = number[relations[r, i]]
    return (
        keys[:faces].copy(),
        classes[:faces].copy(),
        birth[1 : living + 1].copy(),
        relations[:related].copy(),
    )


@njit(cache=True)
def _push(heap, size, value):
    if size == heap.size:
        heap = _grown(heap)
    i = size
    while i > 0 and heap[(i - 1) // 2] < value:
        heap[i] = heap[(i - 1) // 2]
        i = (i - 1) // 2
    heap[i] = value
    return heap, size + 1


@njit(cache=True)
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


@njit(cache=True)
def _discs(relations, count):
    """Classes 1 ... `count`, numbered by falling birth, that the relations end: (count,) bool.

    The standard reduction of persistent homology: every relation is added to by earlier ones until its
    youngest class is no earlier one's, or nothing is left of it.
    """
    ends = np.zeros(count, np.bool_)
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
        while size > 0:
            youngest = heap[0]
            size = _pop(heap, size)
            if size > 0 and heap[0] == youngest:
                size = _pop(heap, size)
                continue
            if length[youngest] == 0:
                ends[youngest - 1] = True
                start[youngest] = used
                length[youngest] = 1
                while used + size + 1 > reduced.size:
                    reduced = _grown(reduced)
                reduced[used] = youngest
                used += 1
                while size > 0:
                    value = heap[0]
                    size = _pop(heap, size)
                    if size > 0 and heap[0] == value:
                        size = _pop(heap, size)
                        continue
                    reduced[used] = value
                    used += 1
                    length[youngest] += 1
                break
            for p in range(start[youngest] + 1, start[youngest] + length[youngest]):
                heap, size = _push(heap, size, reduced[p])
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
    return components, components + cavities - _euler(pore), cavities


@njit(cache=True)
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
                        parent = _grown(parent)
                    own = parent[count] = count
                plane[y + 1, x + 1] = own
    return pieces


@njit(cache=True)
def _euler(pore):
    """Vertices less edges plus squares less cubes of the complex of pore voxels."""
    nz, ny, nx = pore.shape
    total = 0
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                if not pore[z, y, x]:
                    continue
                a = z + 1 < nz and pore[z + 1, y, x]
                b = y + 1 < ny and pore[z, y + 1, x]
                c = x + 1 < nx and pore[z, y, x + 1]
                ab = a and b and pore[z + 1, y + 1, x]
                ac = a and c and pore[z + 1, y, x + 1]
                bc = b and c and pore[z, y + 1, x + 1]
                total += 1 - a - b - c + ab + ac + bc
                if ab and ac and bc and pore[z + 1, y + 1, x + 1]:
                    total -= 1
    return total
