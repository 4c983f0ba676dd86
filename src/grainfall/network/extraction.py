"""Extraction of a pore network from a binary volume, by any method."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from grainfall.errors import InputError
from grainfall.network.elements import Network, assemble, empty
from grainfall.network.geometry import measure_openings, measure_pores, measure_throats
from grainfall.network.partition import PERSISTENCE, Partition, partition
from grainfall.network.slabs import cut, extract_slabs
from grainfall.network.snow import snow2
from grainfall.network.topology import Interfaces, find_interfaces


def extract(
    pore: np.ndarray,
    voxel_size_um: float,
    method: str = "persistence",
    *,
    persistence: float = PERSISTENCE,
    threads: int = 1,
    **options: object,
) -> Network:
    """Extract the pore network of a binary volume, with boundary pores on all six faces.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
        True in the pore space.
    voxel_size_um : float
        Edge of a voxel in micrometres.
    method : {"persistence", "snow2"}
        Extraction method; see :data:`METHODS`. ``persistence``: pores are the basins of the distance map's
        maxima, merged by persistence (:func:`grainfall.network.partition`), and every connected piece of
        their interfaces is a throat, so that components and loops are those of the pore space
        (:mod:`grainfall.network.topology`). ``snow2``: the marker-based watershed of PoreSpy.
    persistence : float
        For method persistence, in [0, 1): the share of its radius by which the way from a pore to a larger
        one must narrow, or it is part of that one.
    threads : int
        For method persistence; the network does not depend on it.
    **options
        Passed to the method; snow2 takes ``sigma`` (0.4, blur of the distance map in voxels) and ``r_max``
        (4, radius in voxels within which a maximum must stand alone).

    Returns
    -------
    dict of str to ndarray
        ``pore.coords`` (n, 3) um, ``pore.boundary`` and ``pore.xmin`` ... ``pore.zmax`` (n,) bool,
        ``throat.conns`` (m, 2) int, ``throat.disc_bounding`` (m,) bool: closes a loop that bounds a disc in
        the pore space (it conducts all the same; snow2 does not know), and the properties of
        :data:`LENGTH_POWER` (um to that power; how they are measured: :mod:`grainfall.network.geometry`):

        - ``pore.inscribed_diameter``: largest sphere about the pore's centre (snow2: in its own region);
          ``pore.extended_diameter``: the same in the whole pore space; ``pore.equivalent_diameter``: sphere
          of the region's volume (of boundary pores, whose ``pore.volume`` is 0 as they lie outside, circle
          of the opening's area; snow2: sphere of a layer of voxels)
        - ``pore.surface_area``: wall (snow2: whole surface of the region)
        - ``throat.inscribed_diameter``: largest sphere centred on the interface; ``throat.half_lengths``
          (m, 2): from the centre of each pore to the throat's; ``throat.total_length``: their sum (snow2:
          as PoreSpy measures it); ``throat.direct_length``: from pore to pore.

        Several throats may join the same two pores, and a throat may join a pore that is a ring to itself.
        Without pore voxels, and without solid voxels (no walls: nothing to partition), the network is empty.

    Raises
    ------
    InputError
        For an unknown method, a persistence out of its range, and as :func:`pore_space`.
    """
    if method not in METHODS:
        raise InputError(
            "network method", f"unknown method {method!r}", f"choose one of {', '.join(METHODS)}"
        )
    pore = pore_space(pore, voxel_size_um)
    if pore.all() or not pore.any():
        return empty()
    if method == "persistence":
        options |= {"persistence": persistence, "threads": threads}
    return METHODS[method](pore, float(voxel_size_um), **options)


def pore_space(pore: np.ndarray, voxel_size_um: float) -> np.ndarray:
    """A volume (nz, ny, nx) of booleans, if it is one.

    Raises
    ------
    InputError
        For other shapes and types: of phases, 0 the pore, the grains would be taken for the pore space. For a
        voxel size that is no length.
    """
    pore = np.asarray(pore)
    if pore.ndim != 3 or not pore.size:
        raise InputError("pore", f"an image of shape {pore.shape}", "give a volume (z, y, x)")
    if pore.dtype != bool:
        raise InputError("pore", f"an image of {pore.dtype}", "booleans, True in the pore: phase == 0")
    if not 0 < voxel_size_um < np.inf:
        raise InputError("voxel_size_um", f"{voxel_size_um:g} is no length", "micrometres, above 0")
    return pore


def by_persistence(
    pore: np.ndarray, voxel_size_um: float, *, persistence: float = PERSISTENCE, threads: int = 1
) -> Network:
    """The network of :func:`grainfall.network.partition`, measured; by several threads, slab by slab."""
    if threads > 1:
        return extract_slabs(
            pore, voxel_size_um, cut(pore.shape, threads), persistence=persistence, threads=threads
        )
    parts = partition(pore, persistence=persistence)
    return measure(parts, find_interfaces(parts), voxel_size_um)


def measure(parts: Partition, found: Interfaces, voxel_size_um: float) -> Network:
    """The network of a partition and its interfaces, with boundary pores where a pore opens onto a face.

    Pores are numbered as in the partition, boundary pores (one per connected opening of a pore, half a voxel
    outside it) come after them; throats as in the interfaces, those to boundary pores after them.
    """
    pores, throats = measure_pores(parts), measure_throats(parts, found)
    return assemble(pores, throats, measure_openings(parts), found.conns, found.disc, voxel_size_um)


METHODS: dict[str, Callable[..., Network]] = {"persistence": by_persistence, "snow2": snow2}
"""Extraction methods: (pore, voxel_size_um, **options) -> network."""
