"""Permeability and formation factor of a voxel image along its three axes."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pandas as pd

from grainfall.errors import InputError
from grainfall.flow import direct, elliptic
from grainfall.flow.elliptic import AXES
from grainfall.flow.estimate import kozeny_carman, percolates, specific_surface
from grainfall.flow.network import conductances, spanning, two_face_conductance
from grainfall.network import Network, extract
from grainfall.units import um2_to_millidarcy

__all__ = [
    "AXES",
    "METHODS",
    "conductances",
    "direct",
    "elliptic",
    "kozeny_carman",
    "percolates",
    "permeability",
    "spanning",
    "specific_surface",
    "two_face_conductance",
]

METHODS = ("estimate", "network", "elliptic", "direct")
"""From the cheapest to the dearest."""


def permeability(
    pore: np.ndarray,
    voxel_size_um: float,
    method: str = "network",
    *,
    network: Network | None = None,
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
        ``network``: Stokes flow and Ohmic conduction through the pore network, every pore-throat-pore
        conduit a cuboid between two truncated pyramids (:func:`conductances`).
        ``elliptic``: a lower bound from two scalar equations on the voxels
        (:func:`grainfall.flow.elliptic.solve`). ``direct``: Stokes flow on the voxels
        (:func:`grainfall.flow.direct.solve`). Both hold the pressure at the two faces, seal the sides, and
        take the formation factor from conduction through the voxels.
    network : dict, optional
        The pore network of the volume, if it is at hand; extracted by snow2 if omitted.
    progress : callable, optional
        Told how a long solution goes, a line at a time.

    Returns
    -------
    DataFrame
        Columns method, axis, k_md, formation_factor, wall_s (what the axes share, divided equally),
        a row per axis x, y, z. Where no path leads from face to face K is exactly 0 and the formation factor,
        which has no finite value, is empty. A volume without solid has no walls: K is empty, F is 1.

    Raises
    ------
    InputError
        For an unknown method.
    """
    if method not in METHODS:
        raise InputError("flow method", f"unknown method {method!r}", f"choose one of {', '.join(METHODS)}")
    pore = np.asarray(pore).astype(bool)
    if pore.all():
        return _table(method, [(np.nan, 1.0, 0.0)] * 3)
    begin = time.perf_counter()
    if method == "estimate":
        k_md, factor = kozeny_carman(pore, voxel_size_um)
        values = [(k_md, factor) if is_open else (0.0, np.nan) for is_open in percolates(pore)]
    elif method == "network":
        network = extract(pore, voxel_size_um) if network is None else network
        size_um = voxel_size_um * np.array(pore.shape[::-1], float)
    share = (time.perf_counter() - begin) / 3
    rows = []
    for axis, name in enumerate(AXES):
        begin = time.perf_counter()
        if method == "estimate":
            k_md, factor = values[axis]
        elif method == "network":
            hydraulic, electrical = conductances(network, name)
            length_per_area = size_um[axis] / np.prod(np.delete(size_um, axis))
            k_md = um2_to_millidarcy(hydraulic * length_per_area)
            factor = 1 / (electrical * length_per_area) if electrical > 0 else np.nan
        else:
            k_md, factor = _through_voxels(pore, voxel_size_um, method, name, progress)
        # the last digits may follow the linear algebra library; results must not
        rows.append((float(f"{k_md:.10g}"), float(f"{factor:.10g}"), share + time.perf_counter() - begin))
    return _table(method, rows)


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
