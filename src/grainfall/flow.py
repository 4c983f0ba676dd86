"""Permeability and formation factor of a voxel image along its three axes."""

from __future__ import annotations

import time

import numpy as np
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from skimage.measure import label

from grainfall.errors import InputError
from grainfall.network import Network, extract, subnetwork, to_openpnm
from grainfall.units import um2_to_millidarcy

AXES = ("x", "y", "z")
"""Axis names in the order of the rows; x is along axis 2 of the image."""

KOZENY = 5.0
"""Carman's constant for beds of grains: shape factor 2.5 times squared hydraulic tortuosity 2."""

FACE_TO_SURFACE = 2.0 / 3.0
"""Area of an isotropic smooth surface over that of its voxel faces, 1/<|n_x| + |n_y| + |n_z|>."""

METHODS = ("network", "estimate")


def permeability(
    pore: np.ndarray,
    voxel_size_um: float,
    method: str = "network",
    *,
    network: Network | None = None,
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
    method : {"network", "estimate"}
        ``network``: Stokes flow and Ohmic conduction through the pore network, every pore-throat-pore
        conduit a cuboid between two truncated pyramids (:func:`conductances`).
        ``estimate``: Kozeny-Carman from porosity and specific surface and F = porosity^(-3/2) (Bruggeman),
        the same along every axis along which the pore space percolates: a rough figure, no simulation.
    network : dict, optional
        The pore network of the volume, if it is at hand; extracted by snow2 if omitted.

    Returns
    -------
    DataFrame
        Columns method, axis, k_md, formation_factor, wall_s (network extraction shared equally by the axes),
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
    begin = time.perf_counter()
    if pore.all():
        return _table(method, [(np.nan, 1.0, 0.0)] * 3)
    if method == "estimate":
        k_md, factor = kozeny_carman(pore, voxel_size_um)
        open_axes = percolates(pore)
        share = (time.perf_counter() - begin) / 3
        return _table(
            method, [(k_md, factor, share) if is_open else (0.0, np.nan, share) for is_open in open_axes]
        )
    if network is None:
        network = extract(pore, voxel_size_um, "snow2")
    size_um = voxel_size_um * np.array(pore.shape[::-1], float)
    share = (time.perf_counter() - begin) / 3
    rows = []
    for axis, name in enumerate(AXES):
        begin = time.perf_counter()
        hydraulic, electrical = conductances(network, name)
        length_per_area = size_um[axis] / np.prod(np.delete(size_um, axis))
        k_md = um2_to_millidarcy(hydraulic * length_per_area)
        factor = 1 / (electrical * length_per_area) if electrical > 0 else np.nan
        # the last digits may follow the linear algebra library; results must not
        rows.append((float(f"{k_md:.10g}"), float(f"{factor:.10g}"), share + time.perf_counter() - begin))
    return _table(method, rows)


def _table(method: str, rows: list[tuple[float, float, float]]) -> pd.DataFrame:
    k_md, factor, wall_s = zip(*rows, strict=True)
    return pd.DataFrame(
        {"method": method, "axis": AXES, "k_md": k_md, "formation_factor": factor, "wall_s": wall_s}
    )


def spanning(network: Network, axis: str) -> np.ndarray:
    """Pores (n,) bool of the clusters that reach from face to face along ``axis``; others do not conduct."""
    n = len(network["pore.coords"])
    i, j = network["throat.conns"].T
    _, cluster = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
    both = np.intersect1d(cluster[network[f"pore.{axis}min"]], cluster[network[f"pore.{axis}max"]])
    return np.isin(cluster, both)


def conductances(network: Network, axis: str) -> tuple[float, float]:
    """Hydraulic and electrical conductance of a network between its two faces across ``axis``.

    Poiseuille flow with unit viscosity and conduction with unit conductivity, in conduits of square section
    that narrow linearly over the pores' radii from the pores' diameters (spheres of the regions' volumes) to
    the throat's (largest sphere inscribed) and are straight in between: OpenPNM's ``pyramids_and_cuboids``
    with the diameters and lengths that its example of an extracted network takes.

    Parameters
    ----------
    network : dict
        See :func:`grainfall.network.extract`.
    axis : {"x", "y", "z"}

    Returns
    -------
    hydraulic : float
        Flow rate times viscosity over pressure drop, um^3; 0 where nothing spans.
    electrical : float
        Current over voltage and conductivity, um; 0 where nothing spans.
    """
    keep = spanning(network, axis)
    if not keep.any():
        return 0.0, 0.0
    import openpnm

    pn = to_openpnm(subnetwork(network, keep))
    geometry = openpnm.models.geometry
    try:
        inlet, outlet = pn.pores(f"{axis}min"), pn.pores(f"{axis}max")
        rates = [
            two_face_conductance(pn.conns, 1 / (1 / kind.pyramids_and_cuboids(pn)).sum(axis=1), inlet, outlet)
            for kind in (geometry.hydraulic_size_factors, geometry.diffusive_size_factors)
        ]
    finally:
        openpnm.Workspace().close_project(pn.project)
    return rates[0] * 1e18, rates[1] * 1e6


def two_face_conductance(
    conns: np.ndarray, conductance: np.ndarray, inlet: np.ndarray, outlet: np.ndarray
) -> float:
    """Conductance of a network of resistors between two sets of its nodes, which may not share one.

    The rate is what the flow dissipates at unit pressure drop, sum g (p_i - p_j)^2: it is least at the
    solution (Thomson), so errors of the pressures enter squared, while the flow counted at a face drowns in
    rounding where a wide throat meets narrow ones. For the same reason the residual of the direct solution is
    formed from differences of pressure, and the solution refined with it.

    Parameters
    ----------
    conns : (m, 2) int
        Nodes at the ends of each resistor.
    conductance : (m,) float
        > 0, any range.
    inlet, outlet : (k,) int
        Nodes held at 1 and at 0. Every other node must be connected to one of them.

    Returns
    -------
    float
        In the unit of ``conductance``.
    """
    n = int(conns.max()) + 1
    g = conductance / conductance.max()
    i, j = conns.T
    held = np.zeros(n, bool)
    held[inlet] = held[outlet] = True
    pressure = np.zeros(n)
    pressure[inlet] = 1.0
    free = np.flatnonzero(~held)
    if len(free):
        degree = np.bincount(np.append(i, j), np.tile(g, 2), n)
        matrix = coo_array(
            (
                np.concatenate([-g, -g, degree]),
                (np.concatenate([i, j, np.arange(n)]), np.concatenate([j, i, np.arange(n)])),
            ),
            shape=(n, n),
        ).tocsc()[free][:, free]
        # a direct solver: no tolerance to choose, and no sums that depend on the number of threads
        solve = splu(matrix.tocsc()).solve

    def dissipated(p: np.ndarray) -> float:
        return float((g * (p[i] - p[j]) ** 2).sum())

    rate = np.inf
    for _ in range(MOST_REFINEMENTS if len(free) else 0):
        flux = g * (pressure[i] - pressure[j])
        excess = np.bincount(j, flux, n) - np.bincount(i, flux, n)
        trial = pressure.copy()
        trial[free] += solve(excess[free])
        if not dissipated(trial) < rate * (1 - 1e-14):
            break
        pressure, rate = trial, dissipated(trial)
    return float(dissipated(pressure) * conductance.max())


MOST_REFINEMENTS = 50
"""Two do where conductances are alike; more only where rounding eats the first solution."""


def percolates(pore: np.ndarray) -> tuple[bool, bool, bool]:
    """Whether pore voxels connected by faces lead through the volume along x, y, z."""
    clusters = label(np.asarray(pore).astype(bool), connectivity=1)
    return tuple(
        bool(np.intersect1d(clusters.take(0, axis), clusters.take(-1, axis)).any()) for axis in (2, 1, 0)
    )


def specific_surface(pore: np.ndarray, voxel_size_um: float) -> float:
    """Pore-solid surface per bulk volume in 1/um: 2/3 of the voxel faces (isotropic smooth surface)."""
    pore = np.asarray(pore).astype(bool)
    faces = sum(np.count_nonzero(np.diff(pore, axis=axis)) for axis in range(3))
    return FACE_TO_SURFACE * faces / (pore.size * voxel_size_um)


def kozeny_carman(pore: np.ndarray, voxel_size_um: float) -> tuple[float, float]:
    """Kozeny-Carman permeability phi^3 / (5 S^2) in mD and Bruggeman's formation factor phi^(-3/2).

    ``S`` is the surface per bulk volume (:func:`specific_surface`). Estimates: neither looks at connections.
    Both are empty (NaN) without pore; without surface, K is.
    """
    phi = float(np.mean(pore))
    surface = specific_surface(pore, voxel_size_um)
    k_md = um2_to_millidarcy(phi**3 / (KOZENY * surface**2)) if surface > 0 else np.nan
    return k_md, phi**-1.5 if phi > 0 else np.nan
