"""Pore network of a voxel image: pores, throats and their geometry, in OpenPNM's names.

A network is a plain ``dict`` of arrays named as OpenPNM names them (``pore.coords``, ``throat.conns``, ...).
Lengths are micrometres, coordinates are (x, y, z) from the corner of the region of interest, x along axis 2
of the image. :func:`to_openpnm` gives the same network in metres as an ``openpnm.network.Network``.
"""

from grainfall.network.elements import (
    FACES,
    LENGTH_POWER,
    Network,
    betti_numbers,
    conduit_lengths,
    coordination_numbers,
    element_sizes,
    empty,
    mean_pore_radius,
    pooled_sizes,
    pore_radius_quantile,
    pore_size_distance,
    pore_volume_below,
    subnetwork,
    summarise,
)
from grainfall.network.export import load, save, save_openpnm, save_statoil, save_vtp, to_openpnm
from grainfall.network.extraction import METHODS, extract, measure, pore_space
from grainfall.network.geometry import CIRCLE
from grainfall.network.partition import PERSISTENCE, Partition, partition
from grainfall.network.topology import Interfaces, find_interfaces, pore_betti_numbers

__all__ = [
    "CIRCLE",
    "FACES",
    "LENGTH_POWER",
    "METHODS",
    "PERSISTENCE",
    "Interfaces",
    "Network",
    "Partition",
    "betti_numbers",
    "conduit_lengths",
    "coordination_numbers",
    "element_sizes",
    "empty",
    "extract",
    "find_interfaces",
    "load",
    "mean_pore_radius",
    "measure",
    "partition",
    "pooled_sizes",
    "pore_betti_numbers",
    "pore_radius_quantile",
    "pore_size_distance",
    "pore_space",
    "pore_volume_below",
    "save",
    "save_openpnm",
    "save_statoil",
    "save_vtp",
    "subnetwork",
    "summarise",
    "to_openpnm",
]
