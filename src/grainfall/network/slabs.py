"""The pore network of a volume in slabs of planes: the very network of the whole, to the last bit.

Five things are done to every slab, each by itself, and between them three are done to what the slabs have in
common, which is no more than the planes where they touch and the graph of pores and throats. Slabs hand on
dictionaries of arrays; what is called a field holds voxels, what is called a graph does not.

========================= =================================================================================
``solid_columns``         first and last solid plane of every column
``squared_distances``     squared distances, with the nearest solid plane of the other slabs
:func:`grow_basins`       ways up from all voxels, to a maximum or out of the slab; saddles between them
:func:`join_slabs`        where the ways that leave a slab end; basins joined by persistence: pores
:func:`find_throat_parts` pores of all voxels; classes of edges, and what can be summed of throats and pores
:func:`glue_slabs`        classes of all slabs made one; throats, centres, openings
:func:`measure_slab`      walls, rims, reach
:func:`finish`            the network
========================= =================================================================================

The first two are of :mod:`grainfall.network.distance`. Why nothing depends on where the volume is cut:

- A voxel's way up depends on the planes up to three away, and so on no more than :data:`BEFORE` and
  :data:`BEHIND` planes of the other slabs.
- A saddle that closes a circle of higher ones, in the slab alone, would be passed over when basins are joined
  in the whole, too: each slab names a forest of saddles. That ends of ways are not yet known makes circles
  fewer, and the forest larger, no more.
- Classes of edges are a least fixed point (:func:`grainfall.network.topology.find_classes`). Slabs share the
  voxels of a plane, every square lies in one of them, and an edge in the plane they share is of one class.
- A class is born with its first edge in the filtration: of what classes become one, the first counts.
- What the relations end, and which pieces they make one throat, does not depend on their order
  (:func:`grainfall.network.topology.number_throats`).
- Counts and sums of whole or half numbers are exact in any order; other sums are added up in the order of the
  voxels (``later`` in :func:`grainfall.network.geometry.measure_walls`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import TypeAlias

import numpy as np
from numba import njit

from grainfall import volume
from grainfall.network.distance import nearest_columns, solid_columns, squared_distances
from grainfall.network.elements import Network, assemble, empty
from grainfall.network.geometry import (
    FACES_OUT,
    centres,
    cross_sections,
    face_heights,
    find_peaks,
    measure_opening,
    measure_rims,
    measure_walls,
    middles,
    pores_of,
    rind,
    sum_faces,
    throats_of,
)
from grainfall.network.partition import (
    PERSISTENCE,
    Partition,
    Saddles,
    check_persistence,
    find_basins,
    find_root,
    join_basins,
    join_trees,
    number_voxels,
)
from grainfall.network.topology import ends_of_faces, find_classes, number_throats, settle

Arrays: TypeAlias = Mapping[str, np.ndarray]
"""What one step hands on to others, by name; io.write_arrays writes it."""

BEFORE, BEHIND = 3, 4
"""Planes of other slabs that a slab is looked at with: what is around the neighbours of its voxels and, as
the edges to the plane behind are its own, around those of that plane's voxels."""


def extract_slabs(
    pore: np.ndarray,
    voxel_size_um: float,
    parts: Sequence[Slab],
    *,
    persistence: float = PERSISTENCE,
    threads: int = 1,
) -> Network:
    """All the steps, on a volume that is there as a whole.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
        True in the pore space.
    voxel_size_um : float
    parts : sequence of Slab
        All of them, in order.
    persistence : float
        As for :func:`grainfall.network.partition`.
    threads : int
        Slabs that are worked on at a time.
    """
    check_persistence(persistence)
    with ThreadPoolExecutor(threads) as pool:
        planes = [pore[slab.start : slab.stop] for slab in parts]
        starts = [slab.start for slab in parts]
        columns = list(pool.map(solid_columns, planes, starts))
        beyond = [nearest_columns(columns[:i][::-1], columns[i + 1 :]) for i in range(len(parts))]
        squared = list(pool.map(squared_distances, planes, starts, *zip(*beyond, strict=True)))
        windows = [window_of(slab, zip(parts, squared, strict=True)) for slab in parts]
        del squared
        fields, graphs = zip(*pool.map(grow_basins, windows, parts), strict=True)
        joined = join_slabs(graphs, persistence)
        fields, graphs = zip(*pool.map(find_throat_parts, fields, joined), strict=True)
        asked, known = glue_slabs(graphs)
        return finish(known, list(pool.map(measure_slab, fields, asked)), voxel_size_um)


@dataclass(frozen=True)
class Slab:
    """Planes of a volume.

    Attributes
    ----------
    shape : tuple of int
        (nz, ny, nx) of the volume.
    start, stop : int
        The planes are those from ``start`` on, before ``stop``.
    """

    shape: tuple[int, int, int]
    start: int
    stop: int

    @classmethod
    def of(cls, arrays: Arrays) -> Slab:
        """The slab that a field or a graph is of."""
        *shape, start, stop = arrays["slab"].tolist()
        return cls(tuple(shape), start, stop)

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return np.array([*self.shape, self.start, self.stop], dtype)

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def window(self) -> tuple[int, int]:
        """First of the planes that it is looked at with, and the plane behind them; none if it has none."""
        if self.start == self.stop:
            return self.start, self.stop
        return max(self.start - BEFORE, 0), min(self.stop + BEHIND, self.shape[0])

    @property
    def plane(self) -> int:
        """Voxels of a plane."""
        return self.shape[1] * self.shape[2]

    @property
    def offset(self) -> int:
        """Flat index in the volume of the window's first voxel."""
        return self.window[0] * self.plane

    @property
    def own(self) -> slice:
        """Its planes in its window."""
        return slice(self.start - self.window[0], self.stop - self.window[0])


def cut(shape: tuple[int, int, int], slabs: int) -> list[Slab]:
    """Cut a volume into slabs.

    Parameters
    ----------
    shape : tuple of int
        (nz, ny, nx) of the volume.
    slabs : int
        How many are asked for.

    Returns
    -------
    list of Slab
        As many, of as many planes or one more, and no fewer than :data:`BEHIND` so that their windows hold
        planes of their neighbours only. Where planes are too few for that the last have none.
    """
    nz = shape[0]
    count = max(min(slabs, nz // BEHIND), 1)
    ends = [nz * i // count for i in range(count)] + [nz] * (slabs - count + 1)
    return [Slab(tuple(shape), *ends[i : i + 2]) for i in range(slabs)]


def read_slab(phase: np.ndarray, part: int, parts: int, coarsen: int = 1) -> tuple[np.ndarray, Slab]:
    """Pore space of a slab of a phase volume.

    Parameters
    ----------
    phase : (nz, ny, nx) array of int
        0 in the pores; an open volume file will do.
    part, parts : int
        Which slab, from 1, of how many.
    coarsen : int
        Voxels along an axis that become one (:func:`grainfall.volume.coarsen`).

    Returns
    -------
    pore : (n, ny // coarsen, nx // coarsen) ndarray of bool
    slab : Slab
        Of the volume of these voxels.

    Raises
    ------
    InputError
        When no whole block fits into the volume.
    """
    slab = cut(volume.coarse_shape(phase.shape, coarsen), parts)[part - 1]
    if len(slab) == 0:
        return np.zeros((0, *slab.shape[1:]), bool), slab
    pore = np.asarray(phase[slab.start * coarsen : slab.stop * coarsen]) == 0
    return volume.coarsen(pore, 1.0, coarsen, slab.start)[0], slab


def window_of(slab: Slab, parts: Iterable[tuple[Slab, np.ndarray]]) -> np.ndarray:
    """The planes of a slab's window, from slabs that hold them all, in order, with their own planes."""
    first, last = slab.window
    planes = [array[max(first - part.start, 0) : max(last - part.start, 0)] for part, array in parts]
    return np.concatenate(planes)  # of several types the one that holds all


def grow_basins(squared: np.ndarray, slab: Slab) -> tuple[Arrays, Arrays]:
    """Basins of a slab: where the ways up from its voxels end or leave it, and the saddles between them.

    Parameters
    ----------
    squared : (w, ny, nx) array of uint16 or uint32
        Squared distances in the slab's window.
    slab : Slab

    Returns
    -------
    field : dict
        ``squared`` as given, ``labels`` and ``tree`` of the window as in :class:`Basins`.
    graph : dict
        ``tops``, ``heights``, ``around`` of its maxima; ``count`` of labels and of those ``before`` the
        maxima's; ``first`` and ``last``, labels of the pore voxels in its first and its last plane;
        ``faces``, ``ends``, ``saddle_heights``, ``saddle_around`` of its saddles. Places are in the volume.
    """
    own = slab.own
    found = find_basins(squared, own.start, own.stop)
    count = int(found.labels.max(initial=0))
    saddles = found.saddles.sort()
    saddles = saddles[_forest(saddles.ends, count)]
    plane = found.labels[own][:1], found.labels[own][-1:]
    before = np.count_nonzero(squared[own.start - 1]) if own.start > 0 else 0
    graph = {
        "slab": np.array(slab),
        "tops": found.tops + slab.offset,
        "heights": found.heights,
        "around": found.around,
        "count": np.array(count),
        "before": np.array(before),
        "first": plane[0][plane[0] > 0],
        "last": plane[1][plane[1] > 0],
        "faces": saddles.faces + 3 * slab.offset,
        "ends": saddles.ends,
        "saddle_heights": saddles.heights,
        "saddle_around": saddles.around,
    }
    field = {"squared": squared, "labels": found.labels, "tree": found.tree}
    return {"slab": np.array(slab)} | field, graph


@njit(cache=True, nogil=True)
def _forest(ends, count):
    """Which edges, in this order, close no circle of earlier ones."""
    parent = np.arange(count + 1)
    keep = np.zeros(ends.shape[0], np.bool_)
    for i in range(ends.shape[0]):
        one, other = find_root(parent, ends[i, 0]), find_root(parent, ends[i, 1])
        keep[i] = one != other
        parent[max(one, other)] = min(one, other)
    return keep


def join_slabs(graphs: Sequence[Arrays], persistence: float = PERSISTENCE) -> list[Arrays]:
    """Pores of the volume, from the graphs of :func:`grow_basins`.

    Parameters
    ----------
    graphs : sequence of mappings
        Of all slabs, in order; arrays are taken one by one, and may be read from a file when they are.
    persistence : float
        As for :func:`grainfall.network.partition`.

    Returns
    -------
    list of dict
        Per slab: ``number``, pore of each of its labels, from 1, and 0 of 0; ``pores``, the pores among them
        in order, and ``peaks``, their largest squared distances; ``joined``, faces in the slab and in the
        plane behind it across which basins were joined.
    """
    counts = [int(graph["count"]) for graph in graphs]
    offset = np.concatenate([[0], np.cumsum(counts)])
    # of the way from each label's voxels; labels of one slab after another
    end = np.arange(offset[-1], dtype=np.int32 if offset[-1] < 2**31 else np.int64)
    is_top = np.zeros(len(end), bool)
    for i, graph in enumerate(graphs):
        first = offset[i] + int(graph["before"])
        behind = first + len(graph["tops"])
        is_top[first:behind] = True
        if first > offset[i]:
            end[offset[i] : first] = offset[i - 1] + graphs[i - 1]["last"] - 1
        if behind < offset[i + 1]:
            end[behind : offset[i + 1]] = offset[i + 1] + graphs[i + 1]["first"] - 1
    while not is_top[end].all():  # ways may cross and come back; each turn doubles how far they are followed
        end = end[end]
    heights, around = (_chain(graphs, name) for name in ("heights", "around"))
    falling = np.lexsort((-around, -heights))
    rank = np.zeros(len(end), np.int32)
    rank[np.flatnonzero(is_top)[falling]] = np.arange(1, len(falling) + 1)
    rank = rank[end]
    forests = []
    for i, graph in enumerate(graphs):
        ends = rank[graph["ends"] - 1 + offset[i]]
        saddles = Saddles(graph["faces"], ends, graph["saddle_heights"], graph["saddle_around"])
        forests.append(saddles[_forest(ends, len(falling))])  # few, now that the ends of ways are known
    names = (field.name for field in fields(Saddles))
    saddles = Saddles(*(np.concatenate([getattr(f, name) for f in forests]) for name in names)).sort()
    pores, joined = join_basins(heights[falling], saddles.ends, saddles.heights, persistence)
    peaks = heights[falling][np.unique(pores[1:], return_index=True)[1]]
    faces = np.sort(saddles.faces[joined])
    found = []
    for i, slab in enumerate(map(Slab.of, graphs)):
        number = np.concatenate([[0], pores[rank[offset[i] : offset[i + 1]]]]).astype(np.int32)
        inside = np.searchsorted(faces, [3 * slab.plane * z for z in (slab.start, slab.stop + 1)])
        own = np.unique(number[1:])
        found.append(
            {"number": number, "pores": own, "peaks": peaks[own - 1], "joined": faces[slice(*inside)]}
        )
    return found


def _chain(graphs: Sequence[Arrays], name: str) -> np.ndarray:
    return np.concatenate([graph[name] for graph in graphs])


def find_throat_parts(field: Arrays, joined: Arrays) -> tuple[Arrays, Arrays]:
    """Pores of a slab's voxels, and its part of whatever is to become a throat.

    Parameters
    ----------
    field : dict
        Of :func:`grow_basins`; its arrays are written to.
    joined : dict
        Of :func:`join_slabs`.

    Returns
    -------
    field : dict
        ``labels``, of the window: places in ``pores`` of the graph, from 1, in the slab and the planes next
        to it, beyond them 1 in the pores; ``squared`` as it was; ``faces``, ``classes``: the slab's edges
        that are of a class, by their places in the window.
    graph : dict
        Of pores: ``pores``, ``volume``, ``peaks`` (squared distances), and the highest voxels by
        ``peak_pores`` (places in ``pores``), ``peak_voxels``, ``peak_around``.
        Of classes: ``births`` (faces), ``heights``, ``turns``, ``ways``, which order them, ``ends`` (pores),
        ``relations``, ``vector``, ``count``, and the widest faces by ``wide_classes``, ``wide_faces``,
        ``wide_around``; which edges are of which class in the planes shared with the slabs before and behind:
        ``first_faces``, ``first_classes``, ``last_faces``, ``last_classes``.
        Of the image's faces: labels ``rind0`` ... ``rind5`` and squared distances ``outer0`` ... ``outer5``.
    """
    labels, squared, tree = field["labels"], field["squared"], field["tree"]
    slab, pores = Slab.of(field), joined["pores"]
    own = slab.own
    number = np.searchsorted(pores, joined["number"]).astype(np.int32) + np.int32(1)
    number[0] = 0
    number_voxels(labels.reshape(-1), number)
    for beyond in (slice(0, max(own.start - 1, 0)), slice(own.stop + 1, None)):
        labels[beyond] = squared[beyond] > 0
    join_trees(tree, joined["joined"] - 3 * slab.offset)
    peaks = joined["peaks"].astype(float)
    volume, peak_pores, peak_voxels, peak_around = find_peaks(labels, squared, own.start, own.stop, peaks)

    shared = slice(own.start, own.stop + 1)
    part = Partition(labels[shared], squared[shared], tree[shared], np.empty(0, np.int64))
    found = find_classes(part)
    heights = face_heights(part.squared_distance, found.births).astype(np.int64)
    turns, ways = _turns(part.squared_distance, found.births)
    behind = found.keys // 3 >= len(slab) * slab.plane
    known = found.classes > 0
    first = known & (found.keys < 3 * slab.plane) & (found.keys % 3 > 0) & (slab.start > 0)
    last = known & behind
    mine = np.flatnonzero(known & ~behind)
    mine = mine[np.lexsort((found.keys[mine], found.classes[mine]))]
    faces, classes = found.keys[mine] + 3 * own.start * slab.plane, found.classes[mine]
    vector, count, widest, wide_around = sum_faces(labels, squared, faces, classes - 1, heights.astype(float))
    start = slab.start * slab.plane
    of_volume = np.concatenate([[0], pores]).astype(np.int32)
    graph = {
        "slab": field["slab"],
        "pores": pores,
        "volume": volume,
        "peaks": joined["peaks"],
        "peak_pores": peak_pores,
        "peak_voxels": peak_voxels + slab.offset,
        "peak_around": peak_around,
        "births": found.births + 3 * start,
        "heights": heights.astype(np.uint32),
        "turns": turns + start,
        "ways": ways.astype(np.uint8),
        "ends": of_volume[ends_of_faces(part.labels, found.births)],
        "relations": np.unique(found.relations, axis=0),
        "vector": vector,
        "count": count,
        "wide_classes": classes[widest],
        "wide_faces": faces[widest] + 3 * slab.offset,
        "wide_around": wide_around,
        "first_faces": found.keys[first] + 3 * start,
        "first_classes": found.classes[first],
        "last_faces": found.keys[last] + 3 * start,
        "last_classes": found.classes[last],
    }
    for i, face in enumerate(FACES_OUT):
        if face[0] > 0:
            layers, outer = rind(face, labels[own], squared[own])
        elif slab.start < slab.stop and (slab.stop == slab.shape[0] if face[1] else slab.start == 0):
            layers, outer = rind(face, labels, squared)  # the window ends where the image does
        else:
            continue
        graph[f"rind{i}"], graph[f"outer{i}"] = of_volume[layers], outer
    field = {"slab": field["slab"], "labels": labels, "squared": squared, "faces": faces, "classes": classes}
    return field, graph


def _turns(squared: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The voxel that brings each edge into the filtration, and in which direction from it the edge lies."""
    _, ny, nx = squared.shape
    flat, before, axes = squared.reshape(-1), faces // 3, faces % 3
    behind = before + np.array([ny * nx, nx, 1])[axes]
    ahead = flat[behind] > flat[before]
    return np.where(ahead, before, behind), 2 * axes + ahead


def glue_slabs(graphs: Sequence[Arrays]) -> tuple[list[Arrays], Arrays]:
    """Throats of the volume, from the graphs of :func:`find_throat_parts`, and what is left to measure.

    Parameters
    ----------
    graphs : sequence of mappings
        As for :func:`join_slabs`.

    Returns
    -------
    asked : list of dict
        Per slab: ``pores`` from 0, their ``centres``, and which come ``later`` there than in other slabs;
        ``throats`` from 0, their ``normals``, and which come ``throats_later``; ``number``, place of each of
        its classes among the throats, from 1, or 0.
    known : dict
        Of the whole: figures of pores, throats and openings.
    """
    shape = Slab.of(graphs[0]).shape
    heights, turns, ways = (_chain(graphs, name) for name in ("heights", "turns", "ways"))
    falling = np.lexsort((ways, turns, -heights.astype(np.int64)))
    order = np.zeros(len(falling), np.int32)
    order[falling] = np.arange(1, len(falling) + 1)
    by_slab = np.split(order, np.cumsum([len(graph["births"]) for graph in graphs])[:-1])
    orders = [np.concatenate([[0], own]).astype(np.int32) for own in by_slab]
    relations = [own[graph["relations"]] for own, graph in zip(orders, graphs, strict=True)]
    for i in range(len(graphs) - 1):
        relations.append(_same(graphs[i], orders[i], graphs[i + 1], orders[i + 1]))
    parent = np.arange(len(order) + 1, dtype=np.int32)
    number, between = settle(parent, np.concatenate(relations))
    between = np.unique(between, axis=0)
    between = between[np.argsort(between.max(axis=1, initial=0), kind="stable")]
    births = falling[np.flatnonzero(parent == np.arange(len(parent)))[1:] - 1]  # of the classes that are left
    ends = _chain(graphs, "ends")[births] - 1
    ends.sort(axis=1)
    throat, first, disc = number_throats(ends, between)
    throat_heights = heights[births][first]
    throats = [throat[number[own]] for own in orders]  # of the classes of each slab, -1 of none

    n, m = max(int(graph["pores"].max(initial=0)) for graph in graphs), len(first)
    volume, peaks = np.zeros(n), np.zeros(n)
    vector, count = np.zeros((m, 3)), np.zeros(m)
    highest, widest = [], []  # owner, place and surroundings, of pores and of throats
    for graph, own in zip(graphs, throats, strict=True):
        pores = graph["pores"] - 1
        volume[pores] += graph["volume"]
        peaks[pores] = graph["peaks"]
        highest.append((pores[graph["peak_pores"]], graph["peak_voxels"], graph["peak_around"]))
        some = np.flatnonzero(own[1:] >= 0)
        np.add.at(vector, own[1:][some], graph["vector"][some])
        np.add.at(count, own[1:][some], graph["count"][some])
        owner, high = own[graph["wide_classes"]], graph["heights"][graph["wide_classes"] - 1]
        some = np.flatnonzero(owner >= 0)
        some = some[
            high[some] == throat_heights[owner[some]]
        ]  # the widest of a part may be none of its throat's
        some = some[np.argsort(graph["wide_faces"][some])]
        widest.append((owner[some], graph["wide_faces"][some], graph["wide_around"][some]))
    centre = centres(*map(np.concatenate, zip(*highest, strict=True)), shape, n)
    place = middles(*map(np.concatenate, zip(*widest, strict=True)), shape, m)
    area, normals = cross_sections(vector, count)

    asked = []
    seen, seen_throats = np.zeros(n, bool), np.zeros(m, bool)
    for graph, own in zip(graphs, throats, strict=True):
        mine = graph["pores"] - 1
        has = np.unique(own[1:][(own[1:] >= 0) & (graph["count"] > 0)])
        to = np.where(np.isin(own, has), np.searchsorted(has, own) + 1, 0).astype(np.int32)
        asked.append(
            {
                "pores": mine,
                "centres": centre[mine],
                "later": seen[mine],
                "number": to,
                "throats": has,
                "normals": normals[has],
                "throats_later": seen_throats[has],
            }
        )
        seen[mine[graph["volume"] > 0]] = True
        seen_throats[has] = True
    known = {
        "volume": volume,
        "peaks": peaks,
        "centres": centre,
        "conns": ends[first],
        "disc": disc,
        "radius": np.sqrt(throat_heights.astype(float)),
        "area": area,
        "places": place,
    }
    for i, face in enumerate(FACES_OUT):
        layers = [graph[f"rind{i}"] for graph in graphs if f"rind{i}" in graph]
        outer = [graph[f"outer{i}"] for graph in graphs if f"outer{i}" in graph]
        opening = measure_opening(*face, np.concatenate(layers), np.concatenate(outer), shape)
        known |= {f"opening{i}.{name}": values for name, values in opening.items()}
    return asked, known


def _same(below: Arrays, below_order: np.ndarray, above: Arrays, above_order: np.ndarray) -> np.ndarray:
    """Relations (k, 4): in the plane that two slabs share their edges are of one class."""
    faces = np.union1d(below["last_faces"], above["first_faces"])
    rows = np.zeros((len(faces), 4), np.int32)
    for column, graph, name, order in ((0, below, "last", below_order), (1, above, "first", above_order)):
        places = np.searchsorted(faces, graph[f"{name}_faces"])
        rows[places, column] = order[graph[f"{name}_classes"]]
    return np.unique(rows, axis=0)


def measure_slab(field: Arrays, asked: Arrays) -> Arrays:
    """What can be measured only where pores' centres and throats' normals are known.

    Parameters
    ----------
    field : dict
        Of :func:`find_throat_parts`.
    asked : dict
        Of :func:`glue_slabs`.

    Returns
    -------
    dict
        ``pores``, ``wall`` and ``reach``, with ``wall_pores`` and ``wall_terms`` of what comes later (as
        :func:`grainfall.network.geometry.measure_walls` has it); ``throats``, ``rim``, ``rim_throats`` and
        ``rim_terms``. By their numbers in the volume, from 0.
    """
    labels, slab = field["labels"], Slab.of(field)
    own = slab.own
    centre = asked["centres"] - [slab.window[0], 0, 0]
    wall, reach, wall_pores, wall_terms = measure_walls(
        labels, field["squared"], own.start, own.stop, centre, asked["later"]
    )
    owner = asked["number"][field["classes"]] - 1
    some = np.flatnonzero(owner >= 0)
    # a throat of several classes: its faces by place
    some = some[np.lexsort((field["faces"][some], owner[some]))]
    rim, rim_throats, rim_terms = measure_rims(
        labels, field["faces"][some], owner[some], asked["normals"], asked["throats_later"]
    )
    return {
        "pores": asked["pores"],
        "wall": wall,
        "reach": reach,
        "wall_pores": asked["pores"][wall_pores],
        "wall_terms": wall_terms,
        "throats": asked["throats"],
        "rim": rim,
        "rim_throats": asked["throats"][rim_throats],
        "rim_terms": rim_terms,
    }


def finish(known: Arrays, measured: Sequence[Arrays], voxel_size_um: float) -> Network:
    """The network, from what :func:`glue_slabs` knows and :func:`measure_slab` has measured."""
    n, m = len(known["volume"]), len(known["conns"])
    if n == 0:
        return empty()
    wall, reach, rim = np.zeros(n), np.zeros(n), np.zeros(m)
    for part in measured:
        wall[part["pores"]] += part["wall"]
        np.maximum.at(reach, part["pores"], part["reach"])
        _add_in_order(wall, part["wall_pores"], part["wall_terms"])
        rim[part["throats"]] += part["rim"]
        _add_in_order(rim, part["rim_throats"], part["rim_terms"])
    pores = pores_of(known["volume"], wall, reach, known["peaks"], known["centres"])
    throats = throats_of(known["radius"], known["area"], rim, known["places"])
    openings = [
        {name.split(".")[1]: values for name, values in known.items() if name.startswith(f"opening{i}.")}
        for i in range(len(FACES_OUT))
    ]
    return assemble(pores, throats, openings, known["conns"], known["disc"], voxel_size_um)


@njit(cache=True, nogil=True)
def _add_in_order(sums, owner, terms):
    for i in range(owner.size):
        sums[owner[i]] += terms[i]
