"""Virtual spheres: temporary bodies that hold open the pores that a packing of grains alone would close."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from grainfall.errors import InputError


def sphere_probability(target: float, first: float, v_sphere: float, v_grain: float) -> float:
    """Probability that the next body poured is a virtual sphere, the paper's closed form.

        p_sp = 1 / (1 + k),    k = (1 - phi_t) / (phi_t - phi_1) * V_sp / V_p

    It assumes that grains and spheres together fill as much space as grains alone did, so one pass misses the
    target when spheres change the total: see :func:`match_porosity`.

    Parameters
    ----------
    target, first : float
        Porosity wanted, and of the first packing.
    v_sphere, v_grain : float
        Mean volume of a virtual sphere and of a grain (any one unit).

    Returns
    -------
    float
        0 where the first packing is already as porous as wanted.
    """
    for name, phi in {"target porosity": target, "first porosity": first}.items():
        if not 0 < phi < 1:
            raise InputError(name, f"{phi} is outside (0, 1)", "give a fraction")
    if not (v_sphere > 0 and v_grain > 0):
        raise InputError("mean volumes", f"sphere {v_sphere}, grain {v_grain}", "both must be positive")
    if target <= first:
        return 0.0
    k = (1 - target) / (target - first) * v_sphere / v_grain
    return 1 / (1 + k)


@dataclass(frozen=True)
class VirtualSizes:
    """Number densities on common bins, per um: what the section has, the first packing has, and the spheres
    get.

    Attributes
    ----------
    edges_um : (n + 1,) float
    target, first : (n,) float
        Normalised densities of pore-circle spheres in the section and in slices of the first packing.
    difference : (n,) float
        target - first.
    used : (n,) float
        The positive part, clipped to feasible radii and normalised; all zero when spheres are not called for.
    called_for : bool
    reason : str
        Why not, or what was clipped; empty otherwise.
    """

    edges_um: np.ndarray
    target: np.ndarray
    first: np.ndarray
    difference: np.ndarray
    used: np.ndarray
    called_for: bool
    reason: str

    def quantile(self, q: np.ndarray, which: str = "f3d") -> np.ndarray:
        """Radii (um) at the number quantiles ``q``: density constant within a bin."""
        mass = np.concatenate([[0.0], np.cumsum(self.used * np.diff(self.edges_um))])
        left = np.flatnonzero(np.diff(mass) > 0)  # bins that hold any
        q = np.clip(np.asarray(q, float), 0, 1)
        bin_ = left[np.clip(np.searchsorted(mass[left + 1], q * mass[-1], side="left"), 0, len(left) - 1)]
        inside = (q * mass[-1] - mass[bin_]) / (mass[bin_ + 1] - mass[bin_])
        return self.edges_um[bin_] + np.clip(inside, 0, 1) * np.diff(self.edges_um)[bin_]

    @property
    def mean_volume(self) -> float:
        """Mean volume of a virtual sphere, um^3 (density constant within a bin); 0 for none."""
        fourth = np.diff(self.edges_um**4) / 4
        return float(4 / 3 * np.pi * (self.used * fourth).sum())

    @classmethod
    def from_table(cls, table: pd.DataFrame) -> VirtualSizes:
        """The inverse of :meth:`to_table`."""
        edges = np.append(table["r_lo_um"], table["r_hi_um"].iloc[-1])
        parts = [table[name].to_numpy(float) for name in ("target", "first", "difference", "used")]
        return cls(edges, *parts, called_for=bool(parts[-1].any()), reason="")

    def to_table(self) -> pd.DataFrame:
        """virtual_spheres.csv: r_lo_um, r_hi_um, target, first, difference, used."""
        return pd.DataFrame(
            {
                "r_lo_um": self.edges_um[:-1],
                "r_hi_um": self.edges_um[1:],
                "target": self.target,
                "first": self.first,
                "difference": self.difference,
                "used": self.used,
            }
        )


def virtual_sizes(
    target, first, *, smallest_um: float | None = None, largest_um: float | None = None
) -> VirtualSizes:
    """Sizes of the virtual spheres: target minus first packing, where positive, normalised.

    Both are number densities that integrate to 1; they are put on the union of their bins first, which is
    exact for piecewise constant densities (bins of different width cannot be subtracted one by one).

    Parameters
    ----------
    target, first : SizeDistribution or None
        ``edges_um`` and ``f3d`` of the pore circles of the section and of slices of the first packing; None
        where no pore circle was found.
    smallest_um : float, optional
        Smallest radius that holds grains apart: a sphere below :data:`THROAT` mean grain radii slips between
        three touching grains, sinks into pores that are there anyway, and comes in hordes. Larger where only
        voids are to be held open.
    largest_um : float, optional
        Largest radius that a packing can hold, for example a quarter of the region of interest: a sphere
        wider than half of it would be the region, not a part of it. What lies outside these limits is left
        out and said in ``reason``.

    Returns
    -------
    VirtualSizes
    """
    if target is None:
        return _none(np.array([0.0, 1.0]), "the section has no pore circles")
    edges = np.asarray(target.edges_um, float)
    if first is not None:
        edges = np.union1d(edges, np.asarray(first.edges_um, float))
    limits = [e for e in (smallest_um, largest_um) if e is not None and edges[0] < e < edges[-1]]
    edges = np.union1d(edges, limits)
    width = np.diff(edges)
    f_target = _normalised(_on(target, edges), width)
    f_first = _normalised(_on(first, edges), width) if first is not None else np.zeros(len(width))
    if not f_target.any():
        return _none(edges, "the section has no pore circles")
    difference = f_target - f_first
    used = np.maximum(difference, 0.0)
    total = (used * width).sum()
    if total <= 1e-9:
        reason = "no radius is short of pore circles in the first packing"
        return VirtualSizes(edges, f_target, f_first, difference, 0 * used, False, reason)
    reasons = []
    for out, words in (
        (edges[1:] <= (smallest_um or 0.0), f"below {smallest_um or 0:.4g} µm have no place to hold open"),
        (edges[:-1] >= (largest_um or np.inf), f"above {largest_um or 0:.4g} µm do not fit"),
    ):
        lost = (used * width)[out].sum() / total
        if lost > 0:
            used = np.where(out, 0.0, used)
            reasons.append(f"spheres {words} and were left out ({100 * lost:.2g} % of them)")
    reason = "; ".join(reasons)
    if not used.any():
        return VirtualSizes(edges, f_target, f_first, difference, used, False, reason)
    return VirtualSizes(edges, f_target, f_first, difference, _normalised(used, width), True, reason)


THROAT = 2 / 3**0.5 - 1
"""Radius of the sphere that just passes between three touching spheres, over theirs."""


def _none(edges: np.ndarray, reason: str) -> VirtualSizes:
    zero = np.zeros(len(edges) - 1)
    return VirtualSizes(edges, zero, zero, zero, zero, False, reason)


def _on(sizes, edges: np.ndarray) -> np.ndarray:
    """The piecewise constant density ``sizes.f3d`` on finer bins ``edges``."""
    own = np.asarray(sizes.edges_um, float)
    middle = (edges[1:] + edges[:-1]) / 2
    bin_ = np.searchsorted(own, middle, side="right") - 1
    inside = (bin_ >= 0) & (bin_ < len(own) - 1)
    return np.where(inside, np.asarray(sizes.f3d, float)[np.clip(bin_, 0, len(own) - 2)], 0.0)


def _normalised(density: np.ndarray, width: np.ndarray) -> np.ndarray:
    total = (density * width).sum()
    return density / total if total > 0 else density


def match_porosity(
    porosity_with: Callable[[float], float],
    target: float,
    p0: float,
    first: float,
    tolerance: float = 0.01,
    max_passes: int = 4,
) -> str:
    """Feedback on the probability of virtual spheres, until the porosity is near enough to the target.

    With odds o = p / (1 - p), solid fraction S of grains and spheres together and c = V_sp / V_p, the
    porosity left when the spheres are removed obeys

        1 / (1 - phi) = (1 + c o) / S.

    The paper's formula is the case S = 1 - phi_1. Spheres among grains change S, so the left side is only
    nearly linear in o: each pass interpolates it linearly between the two passes about the target (the first
    packing is the pass with o = 0), or extrapolates from the last two. The aim is a quarter of the tolerance
    above the target, because contracting positions is a gentler correction than pulling grains apart.

    Parameters
    ----------
    porosity_with : callable
        p_sphere -> porosity without the spheres.
    target, first : float
        Porosity wanted, and of the first packing.
    p0 : float
        First guess, from :func:`sphere_probability`.
    tolerance : float
        Largest ``|porosity - target|`` that ends the passes.
    max_passes : int
        At most so many packings.

    Returns
    -------
    str
        Plain words where the target was not met; empty otherwise.
    """
    if target <= first:
        near = first - target <= tolerance
        return "" if near else f"target not reachable by this plan, nearest {first:.3f}"
    aim = 1 / (1 - min(target + tolerance / 4, EMPTY))
    points = [(0.0, 1 / (1 - first))]
    found = []
    p = float(np.clip(p0, 1e-6, P_MOST))
    for _ in range(max_passes):
        found.append(porosity_with(p))
        if abs(found[-1] - target) <= tolerance:
            return ""
        points.append((p / (1 - p), 1 / (1 - min(found[-1], EMPTY))))
        odds = next_odds(points, aim)
        p, last = min(odds / (1 + odds), P_MOST), p
        if abs(p - last) < 1e-9:
            break
    nearest = min(found, key=lambda porosity: abs(porosity - target))
    return f"target {target:.3f} not met in {len(found)} passes, nearest {nearest:.3f}"


EMPTY = 0.999
"""Largest porosity told from that of a region without a grain."""

P_MOST = 0.999
"""Largest p_sphere tried: spheres may be many and small, but grains must be poured too."""


def next_odds(points: list[tuple[float, float]], aim: float) -> float:
    """Odds at which the line through the two points about ``aim`` (else the last two) meets it."""
    below = [q for q in points if q[1] <= aim]
    above = [q for q in points if q[1] > aim]
    if below and above:
        a, b = max(below), min(above)
        if a[0] >= b[0]:  # scatter between packings has turned the two about
            return (a[0] + b[0]) / 2
    else:
        a, b = sorted(points)[-2:] if below else sorted(points)[:2]
    slope = (b[1] - a[1]) / (b[0] - a[0]) if b[0] != a[0] else 0.0
    if slope <= 0:  # spheres beyond this share do not help: double or halve
        return 2 * b[0] if below and not above else a[0] / 2
    wanted = a[0] + (aim - a[1]) / slope
    # an extrapolation reaches at most four times as far as the passes have gone
    return float(np.clip(wanted, max(points)[0] * 1e-3, 4 * max(points)[0]))
