"""Permeability and formation factor of a voxel image along its three axes."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pandas as pd

from grainfall.errors import InputError
from grainfall.flow import direct, elliptic, local
from grainfall.flow.elliptic import AXES
from grainfall.flow.estimate import kozeny_carman, percolates
from grainfall.flow.network import MODELS, conductances, spanning, two_face_conductance
from grainfall.network import PERSISTENCE, Network, extract, find_interfaces, partition, pore_space
from grainfall.units import um2_to_millidarcy

__all__ = [
    "AXES",
    "CONDUCTANCES",
    "METHODS",
    "conductances",
    "direct",
    "elliptic",
    "kozeny_carman",
    "local",
    "percolates",
    "permeability",
    "spanning",
    "two_face_conductance",
]

METHODS = ("estimate", "network", "elliptic", "direct")
"""From the cheapest to the dearest."""

CONDUCTANCES = ("local", *MODELS)
"""Of pores and throats, from the best to the simplest."""


def permeability(
    pore: np.ndarray,
    voxel_size_um: float,
    method: str = "network",
    *,
    conductance: str = "local",
    network: Network | None = None,
    persistence: float = PERSISTENCE,
    threads: int = 1,
    progress: Callable[[str], None] | None = None,
) -> pd.DataFrame:
    """Permeability and formation factor along x, y and z.

    Darcy's law with the whole cross-section and length of the volume, K = mu q L / (A dP), and the formation
    factor F = A / (L G) with G the conductance of the pore space filled with a fluid of unit conductivity.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
        True in the pore space.
    voxel_size_um : float
        Edge of a voxel in micrometres.
    method : {"network", "estimate", "elliptic", "direct"}
        ``estimate``: Kozeny-Carman from porosity and specific surface and F = porosity^(-3/2) (Bruggeman),
        the same along every axis along which the pore space percolates: a rough figure, no simulation.
        ``network``: Stokes flow and Ohmic conduction through the pore network, by ``conductance``.
        ``elliptic``: a lower bound from two scalar equations on the voxels
        (:func:`grainfall.flow.elliptic.solve`). ``direct``: Stokes flow on the voxels
        (:func:`grainfall.flow.direct.solve`). Both hold the pressure at the two faces, seal the sides, and
        take the formation factor from conduction through the voxels.
    conductance : {"local", "shape_factor", "pyramids"}
        For method network. ``local``: from local solutions on the voxels of every pore of
        :func:`grainfall.network.partition` (:mod:`grainfall.flow.local`). ``shape_factor``, ``pyramids``:
        from the sizes in ``network`` (:func:`conductances`).
    network : dict, optional
        The pore network of the volume, if it is at hand; if it is needed and omitted, it is extracted.
    persistence : float
        Of the pores; see :func:`grainfall.network.extract`.
    threads : int
        Of the local solutions; the result does not depend on it.
    progress : callable, optional
        Told how a long solution goes, a line at a time.

    Returns
    -------
    DataFrame
        Columns method, axis, k_md, formation_factor, wall_s (what the axes share, divided equally),
        a row per axis x, y, z. Where no path leads from face to face K is exactly 0 and the formation factor,
        which has no finite value, is empty. A volume without solid has no walls: K is empty, F is 1. Both are
        empty where a network of another method (snow2) misses the only paths.

    Raises
    ------
    InputError
        For an unknown method or conductance, and for what is no volume of booleans: phases, 0 the pore, would
        be taken for the flow through the grains.
    """
    for name, value, known in (("method", method, METHODS), ("conductance", conductance, CONDUCTANCES)):
        if value not in known:
            raise InputError(f"flow {name}", f"unknown {name} {value!r}", f"choose one of {', '.join(known)}")
    pore = pore_space(pore, voxel_size_um)
    if pore.all():
        return _table(method, [(np.nan, 1.0, 0.0)] * 3)
    begin = time.perf_counter()
    if method == "estimate":
        k_md, factor = kozeny_carman(pore, voxel_size_um)
        values = [(k_md, factor) if is_open else (0.0, np.nan) for is_open in percolates(pore)]
    elif method == "network":
        values = _through_network(pore, voxel_size_um, conductance, network, persistence, threads)
    share = (time.perf_counter() - begin) / 3
    rows = []
    for axis, name in enumerate(AXES):
        begin = time.perf_counter()
        if method in ("estimate", "network"):
            k_md, factor = values[axis]
        else:
            k_md, factor = _through_voxels(pore, voxel_size_um, method, name, progress)
        # the last digits may follow the linear algebra library; results must not
        rows.append((float(f"{k_md:.10g}"), float(f"{factor:.10g}"), share + time.perf_counter() - begin))
    return _table(method, rows)


def _through_network(
    pore: np.ndarray,
    voxel_size_um: float,
    conductance: str,
    network: Network | None,
    persistence: float,
    threads: int,
) -> list[tuple[float, float]]:
    size_um = voxel_size_um * np.array(pore.shape[::-1], float)
    if conductance == "local":
        parts = partition(pore, persistence=persistence)
        labels, found = parts.labels, find_interfaces(parts)
        del parts  # what else it holds is as large as all that follows
        rates = local.solve(labels, found, threads).values()
        through = [(r.hydraulic * voxel_size_um**3, r.electrical * voxel_size_um) for r in rates]
    else:
        network = extract(pore, voxel_size_um, persistence=persistence) if network is None else network
        through = [conductances(network, name, conductance) for name in AXES]
    length_per_area = size_um**2 / size_um.prod()
    missed = percolates(pore) if any(h == 0 for h, _ in through) else (False,) * 3
    return [
        (np.nan if h == 0 and there else um2_to_millidarcy(h * per), 1 / (e * per) if e > 0 else np.nan)
        for (h, e), per, there in zip(through, length_per_area, missed, strict=True)
    ]


def _through_voxels(
    pore: np.ndarray, voxel_size_um: float, method: str, axis: str, progress: Callable[[str], None] | None
) -> tuple[float, float]:
    if method == "elliptic":
        k = elliptic.solve(pore, axis).k
    else:
        told = (lambda line: progress(f"{axis}: {line}")) if progress else None
        k = direct.solve(pore, axis, progress=told).k
    return um2_to_millidarcy(k * voxel_size_um**2), elliptic.formation_factor(pore, axis)


def _table(method: str, rows: list[tuple[float, float, float]]) -> pd.DataFrame:
    k_md, factor, wall_s = zip(*rows, strict=True)
    return pd.DataFrame(
        {"method": method, "axis": AXES, "k_md": k_md, "formation_factor": factor, "wall_s": wall_s}
    )
