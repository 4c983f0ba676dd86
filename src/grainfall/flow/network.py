"""Flow and conduction through a pore network between two faces of the volume."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from grainfall.network import CIRCLE, Network, conduit_lengths, subnetwork, to_openpnm


def spanning(network: Network, axis: str) -> np.ndarray:
    """Pores (n,) bool of the clusters that reach from face to face along ``axis``; others do not conduct."""
    n = len(network["pore.coords"])
    i, j = network["throat.conns"].T
    _, cluster = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
    both = np.intersect1d(cluster[network[f"pore.{axis}min"]], cluster[network[f"pore.{axis}max"]])
    return np.isin(cluster, both)


def conductances(network: Network, axis: str, model: str = "shape_factor") -> tuple[float, float]:
    """Hydraulic and electrical conductance of a network between its two faces across ``axis``.

    Poiseuille flow with unit viscosity and conduction with unit conductivity.

    Parameters
    ----------
    network : dict
        See :func:`grainfall.network.extract`.
    axis : {"x", "y", "z"}
    model : {"shape_factor", "pyramids"}
        ``shape_factor``: pore, throat and pore in series, ducts of circular, square or triangular section by
        their shape factors (:func:`by_shape_factor`). ``pyramids``: OpenPNM's ``pyramids_and_cuboids``,
        conduits of square section that narrow linearly over the pores' radii from the pores' diameters
        (spheres of the regions' volumes) to the throat's (largest sphere inscribed) and are straight in
        between, with the diameters and lengths that its example of an extracted network takes.

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
    network = subnetwork(network, keep)
    inlet, outlet = (np.flatnonzero(network[f"pore.{axis}{end}"]) for end in ("min", "max"))
    conns = network["throat.conns"]
    hydraulic, electrical = MODELS[model](network)
    apart = conns[:, 0] != conns[:, 1]
    rates = (two_face_conductance(conns[apart], g[apart], inlet, outlet) for g in (hydraulic, electrical))
    return tuple(rates)


def by_shape_factor(network: Network) -> tuple[np.ndarray, np.ndarray]:
    """Hydraulic (m,) um^3 and electrical (m,) um conductances of pore, throat and pore in series.

    Each is a duct of area A = R^2 / 4G about the inscribed circle of radius R, and of conductance
    c G A^2 / L by its shape factor G: a triangle's with c = 3/5 up to that of the equilateral one, a square's
    (0.5623) or a circle's (1/2), whichever is nearer, above (Patzek & Silin 2001; Valvatne & Blunt 2004). The
    lengths are :func:`grainfall.network.conduit_lengths`.
    """
    conns = network["throat.conns"]
    columns = []
    for name in ("inscribed_diameter", "shape_factor"):
        pores = network[f"pore.{name}"][conns]
        columns.append(np.stack([pores[:, 0], network[f"throat.{name}"], pores[:, 1]], axis=1))
    diameter, shape = columns
    area = diameter**2 / (16 * shape)
    limits = [TRIANGLE, (SQUARE + CIRCLE) / 2]
    factor = np.array([0.6, 0.5623, 0.5])[np.digitize(shape, limits, right=True)]
    length = conduit_lengths(network)
    hydraulic = 1 / (length / (factor * shape * area**2)).sum(axis=1)
    return hydraulic, 1 / (length / area).sum(axis=1)


TRIANGLE = 3**0.5 / 36
"""Shape factor of the equilateral triangle, the largest of any."""

SQUARE = 1 / 16


def by_pyramids(network: Network) -> tuple[np.ndarray, np.ndarray]:
    """Hydraulic (m,) um^3 and electrical (m,) um conductances by OpenPNM's ``pyramids_and_cuboids``.

    Where one pore reaches beyond the centre of the other, a length comes out negative: such throats are those
    of :func:`by_shape_factor`.
    """
    import openpnm

    pn = to_openpnm(network)
    geometry = openpnm.models.geometry
    try:
        factors = [
            kind.pyramids_and_cuboids(pn)
            for kind in (geometry.hydraulic_size_factors, geometry.diffusive_size_factors)
        ]
    finally:
        openpnm.Workspace().close_project(pn.project)
    sound = np.all([(f > 0).all(axis=1) & np.isfinite(f).all(axis=1) for f in factors], axis=0)
    with np.errstate(divide="ignore"):
        found = [si / (1 / f).sum(axis=1) for f, si in zip(factors, (1e18, 1e6), strict=True)]
    pairs = zip(found, by_shape_factor(network), strict=True)
    hydraulic, electrical = (np.where(sound, own, otherwise) for own, otherwise in pairs)
    return hydraulic, electrical


MODELS = {"shape_factor": by_shape_factor, "pyramids": by_pyramids}
"""Conductances of throats: network -> hydraulic, electrical."""


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
