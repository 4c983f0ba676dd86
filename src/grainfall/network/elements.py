"""What a pore network is: OpenPNM's names, units, and the figures that networks are compared by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import pandas as pd
import scipy  # its parts load when they are first used

Network: TypeAlias = dict[str, np.ndarray]
"""OpenPNM names to arrays; the first axis is the pore or the throat."""

LENGTH_POWER = {
    "pore.coords": 1,
    "pore.volume": 3,
    "pore.surface_area": 2,
    "pore.inscribed_diameter": 1,
    "pore.extended_diameter": 1,
    "pore.equivalent_diameter": 1,
    "pore.shape_factor": 0,
    "throat.coords": 1,
    "throat.cross_sectional_area": 2,
    "throat.perimeter": 1,
    "throat.inscribed_diameter": 1,
    "throat.equivalent_diameter": 1,
    "throat.shape_factor": 0,
    "throat.half_lengths": 1,
    "throat.direct_length": 1,
    "throat.total_length": 1,
}
"""Measured properties of every network and the power of length that each carries."""

COMPONENTS = {"pore.coords": 3, "throat.coords": 3, "throat.half_lengths": 2}
"""Properties that are vectors."""

FACES = ("xmin", "xmax", "ymin", "ymax", "zmin", "zmax")

LABELS = ("pore.boundary", *(f"pore.{face}" for face in FACES), "throat.disc_bounding")
"""What is true or false of an element."""


def empty() -> Network:
    """A network of no pores and no throats that has every property."""
    network: Network = {"throat.conns": np.empty((0, 2), np.int64)}
    for name in LENGTH_POWER:
        network[name] = np.empty((0, COMPONENTS[name]) if name in COMPONENTS else 0)
    for name in LABELS:
        network[name] = np.empty(0, bool)
    return network


def subnetwork(network: Network, keep: np.ndarray) -> Network:
    """The pores ``keep`` (n,) bool and the throats between them, renumbered."""
    conns = network["throat.conns"]
    throats = keep[conns].all(axis=1)
    number = np.cumsum(keep) - 1
    part = {k: v[keep if k.startswith("pore.") else throats] for k, v in network.items()}
    part["throat.conns"] = number[part["throat.conns"]]
    return part


def coordination_numbers(network: Network) -> np.ndarray:
    """Throats from every pore to others (n,) int; one to a boundary pore stands for the link beyond the face.

    What joins a pore to itself, as about a grain in its middle, is a loop of the pore space, no neighbour.
    """
    between = network["throat.conns"][joins_two(network)]
    return np.bincount(between.ravel(), minlength=len(network["pore.coords"]))


def joins_two(network: Network) -> np.ndarray:
    """Whether a throat joins two pores (m,) bool, and not one to itself."""
    one, other = network["throat.conns"].T
    return one != other


def conduit_lengths(network: Network) -> np.ndarray:
    """Lengths (m, 3) of the conduit of every throat: first pore, throat, second pore.

    Parted as by Dong & Blunt (2009): a pore takes 1 - 0.6 r_t / r_p of its half of the way, with the radii
    of throat and pore.
    """
    halves = network["throat.half_lengths"]
    wide = network["pore.inscribed_diameter"][network["throat.conns"]]
    pores = halves * np.maximum(0, 1 - PORE_SHARE * network["throat.inscribed_diameter"][:, None] / wide)
    return np.insert(pores, 1, (halves - pores).sum(axis=1), axis=1)


PORE_SHARE = 0.6
"""How much of a pore's half of the way goes to the throat where both are equally wide (Dong & Blunt 2009)."""


def element_sizes(network: Network) -> dict[str, np.ndarray]:
    """Sizes to compare networks by: of interior pores with a throat, and of throats between two of them.

    Pores without throats are left out: nearly all are specks of a few voxels cut off by the resolution.

    Returns
    -------
    dict
        ``pore_radius_um``: of the largest sphere about the pore's centre in the whole pore space;
        ``pore_volume_um3``: of the same pores; ``throat_radius_um``: of the largest sphere in the throat;
        ``coordination``: throats a pore.
    """
    coordination = coordination_numbers(network)
    inner = ~network["pore.boundary"]
    linked = inner & (coordination > 0)
    between = inner[network["throat.conns"]].all(axis=1) & joins_two(network)
    return {
        "pore_radius_um": network["pore.extended_diameter"][linked] / 2,
        "pore_volume_um3": network["pore.volume"][linked],
        "throat_radius_um": network["throat.inscribed_diameter"][between] / 2,
        "coordination": coordination[linked],
    }


def pooled_sizes(sizes: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Sizes of several networks as those of one; each as of :func:`element_sizes`."""
    return {key: np.concatenate([of[key] for of in sizes]) for key in sizes[0]}


def mean_pore_radius(sizes: Mapping[str, np.ndarray]) -> float:
    """Mean of the pore radii (um) by pore volume, of :func:`element_sizes`."""
    return float(np.average(sizes["pore_radius_um"], weights=sizes["pore_volume_um3"]))


def pore_radius_quantile(sizes: Mapping[str, np.ndarray], share: float) -> float:
    """Radius (um) up to which this share of the pore volume lies, of :func:`element_sizes`."""
    radii, volumes = sizes["pore_radius_um"], sizes["pore_volume_um3"]
    return float(np.quantile(radii, share, weights=volumes, method="inverted_cdf"))


def pore_volume_below(sizes: Mapping[str, np.ndarray], radii_um: np.ndarray) -> np.ndarray:
    """Share of the pore volume in pores up to each of these radii, of :func:`element_sizes`.

    Parameters
    ----------
    sizes : mapping
    radii_um : (n,) float

    Returns
    -------
    (n,) float
    """
    order = np.argsort(sizes["pore_radius_um"])
    volume = np.append(0, sizes["pore_volume_um3"][order].cumsum())
    return volume[np.searchsorted(sizes["pore_radius_um"][order], radii_um, side="right")] / volume[-1]


def pore_size_distance(sizes: Mapping[str, np.ndarray], reference: Mapping[str, np.ndarray]) -> float | None:
    """Wasserstein distance (um) of two networks' pore radii by pore volume.

    By volume, as porosimetry has them: counted by number, crevices a voxel wide, which hold nothing and come
    and go with the resolution, outnumber the pores that hold and conduct the fluid.

    Parameters
    ----------
    sizes, reference : mapping
        As :func:`element_sizes` gives them.

    Returns
    -------
    float or None
        None where either has no pores.
    """
    pores = [(of["pore_radius_um"], of["pore_volume_um3"]) for of in (sizes, reference)]
    if not all(len(radii) for radii, _ in pores):
        return None
    (radii, volumes), (others, weights) = pores
    return float(scipy.stats.wasserstein_distance(radii, others, volumes, weights))


def summarise(network: Network) -> pd.DataFrame:
    """Distribution of each of :func:`element_sizes` in one row.

    Returns
    -------
    DataFrame
        Columns element, n, mean, std, p10, median, p90; statistics of no elements are empty.
    """
    rows = []
    for element, values in element_sizes(network).items():
        row: dict[str, object] = {"element": element, "n": len(values)}
        if len(values):
            p10, median, p90 = np.percentile(values, [10, 50, 90])
            row |= {"mean": values.mean(), "std": values.std(), "p10": p10, "median": median, "p90": p90}
        rows.append(row)
    return pd.DataFrame(rows, columns=["element", "n", "mean", "std", "p10", "median", "p90"])


def betti_numbers(network: Network) -> tuple[int, int]:
    """Components and loops of the network of the pore space, without boundary pores.

    Loops that bound a disc in the pore space are not counted, so that a network that keeps the topology has
    those of :func:`grainfall.network.pore_betti_numbers`.
    """
    network = subnetwork(network, ~network["pore.boundary"])
    n = len(network["pore.coords"])
    i, j = network["throat.conns"].T
    graph = scipy.sparse.coo_array((np.ones(len(i)), (i, j)), shape=(n, n))
    components = int(scipy.sparse.csgraph.connected_components(graph, directed=False)[0]) if n else 0
    return components, int(np.count_nonzero(~network["throat.disc_bounding"])) - n + components


def assemble(
    pores: dict[str, np.ndarray],
    throats: dict[str, np.ndarray],
    openings: list[dict[str, np.ndarray]],
    conns: np.ndarray,
    disc: np.ndarray,
    voxel_size_um: float,
) -> Network:
    """The network of what :mod:`grainfall.network.geometry` has measured, numbered as by :func:`measure`.

    Parameters
    ----------
    pores, throats, openings
        In voxels.
    conns : (m, 2) array of int
        Pores of each throat, from 0.
    disc : (m,) array of bool
        As in :class:`Interfaces`.
    voxel_size_um : float
    """
    n = len(pores["coords"])
    face = np.repeat(np.arange(6), [len(o["pore"]) for o in openings])
    opening = {name: np.concatenate([o[name] for o in openings]) for name in openings[0]}
    k = len(face)
    axis, outward = face // 2, np.where(face % 2, 1, -1)
    outside = opening["coords"].copy()
    outside[np.arange(k), axis] += 0.5 * outward
    nothing = np.zeros(k)
    beyond = {
        "coords": outside,
        "volume": nothing,
        "surface_area": nothing,
        "inscribed_diameter": opening["inscribed_diameter"],
        "extended_diameter": opening["inscribed_diameter"],
        "equivalent_diameter": opening["equivalent_diameter"],
        "shape_factor": opening["shape_factor"],
    }
    conns = np.concatenate([conns, np.stack([opening["pore"], n + np.arange(k)], axis=1)])
    network: Network = {"throat.conns": conns.astype(np.int64)}
    for name, values in pores.items():
        network[f"pore.{name}"] = np.concatenate([values, beyond[name]])
    for name, values in throats.items():
        network[f"throat.{name}"] = np.concatenate([values, opening[name]])
    ends = network["pore.coords"][conns]
    halves = np.linalg.norm(ends - network["throat.coords"][:, None], axis=2)
    network["throat.half_lengths"] = halves
    network["throat.total_length"] = halves.sum(axis=1)
    network["throat.direct_length"] = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    for name, power in LENGTH_POWER.items():
        network[name] = network[name] * voxel_size_um**power
    network["pore.boundary"] = np.arange(n + k) >= n
    for number, name in enumerate(FACES):
        network[f"pore.{name}"] = np.concatenate([np.zeros(n, bool), face == number])
    network["throat.disc_bounding"] = np.concatenate([disc, np.zeros(k, bool)])
    return network
