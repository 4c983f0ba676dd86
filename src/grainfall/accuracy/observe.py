"""One volume's porosity, pores, S2 and permeability, and how far they lie from another's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import scipy  # its stats take half a second to load, and do so when they are first used

from grainfall import correlation, flow, network


def observe(pore: np.ndarray, voxel_size_um: float) -> dict:
    """What is compared of a volume.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
        True in the pore space.
    voxel_size_um : float

    Returns
    -------
    dict
        porosity; k_md (by the network, mean of three axes); lag_um and s2 (of the solid, mean of three axes);
        pores (as :func:`grainfall.network.element_sizes` gives them).
    """
    pore = np.asarray(pore, bool)
    found = network.extract(pore, voxel_size_um)
    lags, s2 = axial_s2(pore, voxel_size_um)
    return {
        "porosity": float(pore.mean()),
        "k_md": float(flow.permeability(pore, voxel_size_um, "network").k_md.mean()),
        "lag_um": lags,
        "s2": s2,
        "pores": network.element_sizes(found),
    }


def pooled(volumes: Sequence[Mapping]) -> dict:
    """One observation of several volumes of a rock, of one shape: their means, and the pores of all.

    Parameters
    ----------
    volumes : sequence of mapping
        As :func:`observe` gives them.
    """
    mean = {key: np.mean([one[key] for one in volumes], axis=0) for key in ("porosity", "k_md", "s2")}
    pores = network.pooled_sizes([one["pores"] for one in volumes])
    return {**mean, "lag_um": volumes[0]["lag_um"], "pores": pores}


def axial_s2(pore: np.ndarray, voxel_size_um: float) -> tuple[np.ndarray, np.ndarray]:
    """Lags (um) and S2 of the solid, mean of three axes."""
    return correlation.along_axes(correlation.s2_volume(~pore, voxel_size_um, radial=False))


def from_tables(s2: pd.DataFrame, flow: pd.DataFrame, method: str, sizes: Mapping) -> dict:
    """The same of a volume that is measured already, all but its porosity.

    Parameters
    ----------
    s2, flow : DataFrame
        s2_volume.csv and flow.csv.
    method : str
        Whose permeability counts.
    sizes : mapping
        As :func:`grainfall.network.element_sizes` gives them.
    """
    lag_um, mean = correlation.along_axes(s2)
    return {
        "k_md": flow.loc[flow["method"] == method, "k_md"].mean(),
        "lag_um": lag_um,
        "s2": mean,
        "pores": sizes,
    }


DISTANCES = ("pore_sizes", "s2", "grain_sizes")
"""Metrics whose differences have no sign."""


def differences(found: Mapping, held: Mapping) -> dict[str, float]:
    """How far one volume lies from another, by the names of :data:`grainfall.presets.METRICS`.

    Parameters
    ----------
    found, held : mapping
        As :func:`observe` gives them; ``coordination`` and ``overlap`` where known. Rigid grains do not
        overlap: an overlap is its own error, whatever ``held`` has.

    Returns
    -------
    dict
        Signed where a sign makes sense; what either side lacks is left out.
    """
    errors: dict[str, float] = {}
    if "porosity" in found and "porosity" in held:
        errors["porosity"] = found["porosity"] - held["porosity"]
    for name, key in (("coordination", "coordination"), ("k", "k_md")):
        if found.get(key) is not None and held.get(key):
            errors[name] = found[key] / held[key] - 1
    if "pores" in found and "pores" in held:
        distance = network.pore_size_distance(found["pores"], held["pores"])
        if distance is not None:
            errors["pore_sizes"] = distance / network.mean_pore_radius(held["pores"])
    if "s2" in found and "s2" in held:
        lags = np.asarray(held["lag_um"])
        seen = lags <= max(found["lag_um"])
        gap = np.interp(lags[seen], found["lag_um"], found["s2"]) - np.asarray(held["s2"])[seen]
        errors["s2"] = float(np.abs(gap).max())
    if found.get("overlap") is not None:
        errors["overlap"] = found["overlap"]
    return errors


def relative_distance(radii: np.ndarray, true: np.ndarray) -> float:
    """Wasserstein distance of two samples over the mean of the second."""
    return float(scipy.stats.wasserstein_distance(radii, true) / np.mean(true))
