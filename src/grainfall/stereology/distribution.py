"""Radii in sections and in space as histograms on common bins: moments, quantiles, draws, tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from grainfall.errors import InputError

COLUMNS = ["phase", "kind", "r_lo_um", "r_hi_um", "f2d", "f3d", "lower", "upper"]


@dataclass(frozen=True)
class SizeDistribution:
    """Radii in sections and in space as histograms on common bins.

    Attributes
    ----------
    edges_um : (n + 1,) ndarray
        Bin edges, increasing, micrometres.
    f2d, f3d : (n,) ndarray
        Number densities of section radii and of particle radii, per micrometre; each integrates to 1.
    lower, upper : (n,) ndarray
        Pointwise range of 95 % of bootstrap refits about ``f3d``: how much it scatters, not how far it is
        off; NaN where no bootstrap was asked for.
    method : str
        How ``f3d`` was found.
    regularisation : float
        What the data chose: the (mean) number of components of ``adaptive``, the weight of the penalty of
        ``tikhonov`` and ``paper``; NaN where there is none.
    """

    edges_um: np.ndarray
    f2d: np.ndarray
    f3d: np.ndarray
    lower: np.ndarray = field(repr=False)
    upper: np.ndarray = field(repr=False)
    method: str
    regularisation: float

    def masses(self, which: str = "f3d") -> np.ndarray:
        """Probability of each bin, (n,), for ``which`` of ``"f3d"`` and ``"f2d"``."""
        return _which(self, which) * np.diff(self.edges_um)

    def moment(self, power: int, which: str = "f3d") -> float:
        """E[r**power] in um**power, exact for a density that is constant within bins."""
        edges = self.edges_um
        integral = np.diff(edges ** (power + 1)) / (power + 1)
        return float(_which(self, which) @ integral)

    def mean(self, which: str = "f3d") -> float:
        """Mean radius, micrometres."""
        return self.moment(1, which)

    def mean_volume(self, which: str = "f3d") -> float:
        """Mean volume of a sphere, cubic micrometres."""
        return 4.0 / 3.0 * np.pi * self.moment(3, which)

    def cdf(self, radii_um: np.ndarray | float, which: str = "f3d") -> np.ndarray | float:
        """Probability of a radius at most ``radii_um`` (any shape)."""
        cumulative = np.concatenate([[0.0], np.cumsum(self.masses(which))])
        return np.interp(radii_um, self.edges_um, cumulative / cumulative[-1])

    def quantile(self, q: np.ndarray | float, which: str = "f3d") -> np.ndarray | float:
        """Smallest radius (um) at which the distribution function reaches ``q`` (any shape)."""
        cumulative = np.concatenate([[0.0], np.cumsum(self.masses(which))])
        cumulative /= cumulative[-1]
        q = np.asarray(q, dtype=float)
        if np.any((q < 0) | (q > 1)):
            raise ValueError("a quantile lies between 0 and 1")
        # Empty bins make flat pieces, which np.interp would not resolve to the left end.
        right = np.clip(np.searchsorted(cumulative, q, side="left"), 1, len(cumulative) - 1)
        low, high = cumulative[right - 1], cumulative[right]
        share = np.divide(q - low, high - low, out=np.zeros_like(q), where=high > low)
        first = int(np.argmax(self.masses(which) > 0))
        found = self.edges_um[right - 1] + share * np.diff(self.edges_um)[right - 1]
        return np.maximum(found, self.edges_um[first])[()]


def _which(distribution: SizeDistribution, which: str) -> np.ndarray:
    if which not in ("f3d", "f2d"):
        raise ValueError(f"which = {which!r}: f3d or f2d")
    return getattr(distribution, which)


def checked_edges(edges_um: np.ndarray, radii: np.ndarray | None = None) -> np.ndarray:
    """Bins as floats, when they increase from 0 or above and hold all ``radii`` (sorted)."""
    edges = np.asarray(edges_um, dtype=float).ravel()
    if edges.size < 2 or not np.all(np.isfinite(edges)) or edges[0] < 0 or np.any(np.diff(edges) <= 0):
        raise InputError("size bins", "not increasing from 0 or above", "give at least two finite edges")
    if radii is not None and not edges[0] <= radii[0] <= radii[-1] <= edges[-1]:
        raise InputError(
            "size bins",
            f"{edges[0]:g} to {edges[-1]:g} um does not hold the radii",
            f"cover {radii[0]:g} to {radii[-1]:g} um",
        )
    return edges


def rebinned(edges: np.ndarray, density: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """A density that is constant within ``edges`` averaged over the bins ``onto``."""
    if edges is onto:
        return density
    cumulative = np.concatenate([[0.0], np.cumsum(density * np.diff(edges))])
    return np.diff(np.interp(onto, edges, cumulative)) / np.diff(onto)


def draw_radii(
    distribution: SizeDistribution, n: int, rng: np.random.Generator, which: str = "f3d"
) -> np.ndarray:
    """Radii of ``n`` particles: one from each of n equally probable strata, in random order.

    Parameters
    ----------
    distribution : SizeDistribution
    n : int
    rng : numpy.random.Generator
    which : {"f3d", "f2d"}

    Returns
    -------
    (n,) ndarray
        Micrometres. Their distribution function differs from the distribution's by at most 1 / n.
    """
    strata = (np.arange(n) + rng.random(n)) / max(n, 1)
    return rng.permutation(distribution.quantile(strata, which))


def to_table(distributions: Mapping[tuple[int, str], SizeDistribution]) -> pd.DataFrame:
    """One row a bin, columns as in ``sizes.csv``.

    Parameters
    ----------
    distributions : mapping of (phase, kind) to SizeDistribution
        Kind is ``grain`` or ``pore``. What has no sections has no key and no rows.
    """
    rows = [
        pd.DataFrame(
            {
                "phase": phase,
                "kind": kind,
                "r_lo_um": d.edges_um[:-1],
                "r_hi_um": d.edges_um[1:],
                "f2d": d.f2d,
                "f3d": d.f3d,
                "lower": d.lower,
                "upper": d.upper,
            }
        )
        for (phase, kind), d in distributions.items()
    ]
    return pd.concat(rows, ignore_index=True) if rows else pd.DataFrame(columns=COLUMNS)


def from_table(table: pd.DataFrame) -> dict[tuple[int, str], SizeDistribution]:
    """The distributions of a table made by :func:`to_table`, by (phase, kind).

    The table holds no method and no regularisation: they read ``"table"`` and NaN.
    """
    found = {}
    for (phase, kind), rows in table.groupby(["phase", "kind"], sort=False):
        edges = np.append(rows["r_lo_um"].to_numpy(), rows["r_hi_um"].iloc[-1])
        columns = (rows[name].to_numpy(dtype=float) for name in ("f2d", "f3d", "lower", "upper"))
        found[int(phase), str(kind)] = SizeDistribution(edges, *columns, "table", np.nan)
    return found
