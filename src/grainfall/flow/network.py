"""Flow and conduction through a pore network between two faces of the volume."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from grainfall.network import Network, subnetwork, to_openpnm


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
