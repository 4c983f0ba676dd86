"""What is poured, in which order: phases by volume quota, radii by quantile, shapes by size class."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pandas as pd

from grainfall.errors import InputError

GOLDEN = (5**0.5 - 1) / 2

DUST = 0.02
"""Least radius of a grain that is poured, over the median of its mineral: inversions whose bins begin at 0
let some be far smaller than a pixel, and the smallest grain sets the time step of all."""


class Sizes(Protocol):
    """A distribution of equal-volume radii, as :class:`grainfall.stereology.SizeDistribution`."""

    def quantile(self, q: np.ndarray, which: str = "f3d") -> np.ndarray:
        """Radii (um) at the number quantiles ``q``."""


def phase_probabilities(fractions: np.ndarray, mean_volumes: np.ndarray) -> np.ndarray:
    """Probability that the next grain is of phase i, so that the phases get their share of the solid volume.

    From phi_i = p_i V_i / sum_j(p_j V_j) follows p_i = (phi_i / V_i) / sum_j(phi_j / V_j).

    Parameters
    ----------
    fractions : (M,) float
        Volume fractions of the phases in the solid; normalised here.
    mean_volumes : (M,) float
        Mean grain volume of each phase (any one unit).

    Returns
    -------
    (M,) float
    """
    phi, v = _checked(fractions, mean_volumes)
    p = phi / v
    return p / p.sum()


def phase_probabilities_linear(
    fractions: np.ndarray, mean_volumes: np.ndarray, as_printed: bool = False
) -> np.ndarray:
    """The same probabilities from the paper's linear system B p = c, corrected.

    Replacing p_M = 1 - sum(p) in phi_i sum_j(p_j V_j) = p_i V_i gives, for i, j < M,

        b_ij = phi_i (V_j - V_M) - delta_ij V_j,    c_i = -phi_i V_M.

    The paper prints b_ij without the term -phi_i V_M.

    Parameters
    ----------
    fractions, mean_volumes : (M,) float
    as_printed : bool
        Leave the term out, as printed, to show what comes of it: phi = (1/2, 1/2) and equal volumes give
        (1, 0).
    """
    phi, v = _checked(fractions, mean_volumes)
    last = 0.0 if as_printed else v[-1]
    matrix = np.outer(phi[:-1], v[:-1] - last) - np.diag(v[:-1])
    p = np.linalg.solve(matrix, -phi[:-1] * v[-1])
    p = np.append(p, 1 - p.sum())
    return p / p.sum()


def _checked(fractions, mean_volumes) -> tuple[np.ndarray, np.ndarray]:
    phi, v = np.asarray(fractions, float), np.asarray(mean_volumes, float)
    if phi.shape != v.shape or phi.ndim != 1 or not len(phi):
        raise InputError(
            "phase fractions", f"{phi.shape} fractions, {v.shape} mean volumes", "one of each per phase"
        )
    if not (np.isfinite(phi).all() and (phi >= 0).all() and phi.sum() > 0):
        raise InputError("phase fractions", f"{phi.tolist()}", "give fractions >= 0, not all 0")
    if not (np.isfinite(v).all() and (v > 0).all()):
        raise InputError("mean grain volumes", f"{v.tolist()}", "each must be positive")
    return phi / phi.sum(), v


@dataclass(frozen=True)
class Mixture:
    """What is poured: grains of M phases, and virtual spheres among them.

    Attributes
    ----------
    sizes : mapping of phase -> Sizes
        Radii of the grains of each phase.
    fractions : mapping of phase -> float
        Volume fractions in the solid (normalised here).
    which : {"f3d", "f2d"}
        Unfolded or apparent sizes (variant without inversion).
    spheres : Sizes, optional
        Radii of the virtual spheres.
    p_sphere : float
        Probability that the next body is a virtual sphere.
    void_from_um : float
        Radius from which virtual spheres take the shapes of the library's voids; by default none does.
    void_scale : float
        Radius (of equal volume) of a body that takes one, over that of its sphere.
    """

    sizes: Mapping[int, Sizes]
    fractions: Mapping[int, float]
    which: str = "f3d"
    spheres: Sizes | None = None
    p_sphere: float = 0.0
    void_from_um: float = np.inf
    void_scale: float = 1.0

    @property
    def phases(self) -> list[int]:
        """Phases that have a share, ascending."""
        return sorted(k for k in self.sizes if self.fractions.get(k, 0.0) > 0)

    @property
    def probabilities(self) -> np.ndarray:
        """Number probability of each of :attr:`phases` among the grains."""
        volumes = [self.moment(self.sizes[k], 3) for k in self.phases]
        return phase_probabilities([self.fractions[k] for k in self.phases], volumes)

    def moment(self, sizes: Sizes, power: int) -> float:
        """Mean of r^power over the very quantiles that :func:`draw_population` runs through."""
        u = (np.arange(4096) + 0.5) / 4096
        return float((self._radii(sizes, u) ** power).mean())

    def _radii(self, sizes: Sizes, u: np.ndarray) -> np.ndarray:
        if sizes is self.spheres:
            radii = np.asarray(sizes.quantile(u), float)
            return np.where(radii < self.void_from_um, radii, self.void_scale * radii)
        radii = np.asarray(sizes.quantile(u, self.which), float)
        return np.maximum(radii, DUST * sizes.quantile(np.array([0.5]), self.which))

    @property
    def mean_grain_volume(self) -> float:
        """Mean volume of a grain over all phases, um^3: V_p of the paper."""
        cubes = [self.moment(self.sizes[k], 3) for k in self.phases]
        return float(4 / 3 * np.pi * np.dot(self.probabilities, cubes))

    @property
    def mean_sphere_volume(self) -> float:
        """Mean volume of a virtual sphere, um^3: V_sp of the paper."""
        return 4 / 3 * np.pi * self.moment(self.spheres, 3) if self.spheres is not None else 0.0

    @property
    def mean_grain_diameter(self) -> float:
        """Mean equal-volume diameter of a grain by number, um."""
        return float(2 * np.dot(self.probabilities, [self.moment(self.sizes[k], 1) for k in self.phases]))

    @property
    def mean_volume(self) -> float:
        """Mean volume of a poured body, um^3."""
        return (1 - self.p_sphere) * self.mean_grain_volume + self.p_sphere * self.mean_sphere_volume


def draw_population(mixture: Mixture, library, volume_um3: float, rng: np.random.Generator) -> pd.DataFrame:
    """Bodies to pour, in order, of a given total volume.

    Minerals follow each other by quota: the next grain is always of the one farthest behind its number share,
    so every batch holds the right mix to within one grain. Radii of a mineral run through its quantiles in
    steps of the golden ratio from a random start: any stretch of the supply is a stratified sample. Virtual
    spheres come at random, each body with the same chance, and so do their radii, as the paper has it: by
    quota voids would lie more evenly above each other than side by side. Of one generator more spheres are
    the same ones and others among them. A grain's shape is drawn at random among the library's shapes of its
    phase in the nearest size class (``r2d_um``).

    Parameters
    ----------
    mixture : Mixture
    library : grainfall.grains.Library
        ``table`` with columns shape, phase, r2d_um.
    volume_um3 : float
        Volume to reach, virtual spheres included.
    rng : numpy.random.Generator

    Returns
    -------
    DataFrame
        kind (``grain``, ``virtual``), phase (0 for virtual), shape (-1 for a sphere), scale (um).

    Raises
    ------
    InputError
        When the library has no shape of a phase, or nothing is left to pour.
    """
    phases = mixture.phases
    if not phases:
        raise InputError("phase fractions", "no phase has a share", "give at least one fraction > 0")
    if not 0 <= mixture.p_sphere < 1:
        raise InputError("p_sphere", f"{mixture.p_sphere} is outside [0, 1)", "grains must be poured too")
    if mixture.p_sphere > 0 and mixture.spheres is None:
        raise InputError("p_sphere", "no sizes of virtual spheres", "give them or set p_sphere to 0")
    n = max(1, int(np.ceil(volume_um3 / mixture.mean_volume)))
    chance, place = rng.spawn(1)[0].random((n, 2)).T
    virtual = chance < mixture.p_sphere
    component = np.full(n, len(phases))
    component[~virtual] = _interleave(mixture.probabilities, n - virtual.sum())
    scale = np.empty(n)
    shape = np.full(n, -1)
    for c, phase in enumerate(phases):
        mine = np.flatnonzero(component == c)
        u = (rng.random() + GOLDEN * np.arange(len(mine))) % 1.0
        scale[mine] = mixture._radii(mixture.sizes[phase], u)
        shape[mine] = _shapes(library.table, phase, scale[mine], rng)
    if virtual.any():
        mine = np.flatnonzero(virtual)
        scale[mine] = mixture._radii(mixture.spheres, place[mine])
        radii = mixture.spheres.quantile(place[mine])
        large = radii >= mixture.void_from_um
        if large.any():
            from grainfall.grains import VOID  # here: to plan a scene takes no grains

            shape[mine[large]] = _shapes(library.table, VOID, radii[large], rng)
    return pd.DataFrame(
        {
            "kind": np.where(virtual, "virtual", "grain"),
            "phase": np.where(virtual, 0, np.array([*phases, 0])[component]),
            "shape": shape,
            "scale": scale,
        }
    )


def draw_zones(
    mixture: Mixture, library, volume_um3: float, share: float, rng: np.random.Generator
) -> pd.DataFrame:
    """The supply in two streams, each with its own quota: over the region of interest, and around it.

    Walls keep large grains at a distance, so one quota for the whole box leaves the region richer in the
    coarser mineral than the box is; and its few hundred grains would scatter about the mean. A stream of
    its own holds the region to its quota.

    Parameters
    ----------
    mixture, library, volume_um3, rng
        See :func:`draw_population`.
    share : float
        Share of the box's floor that lies under the region, in (0, 1].

    Returns
    -------
    DataFrame
        As :func:`draw_population`, with ``over_roi``: released over the region (True) or around it.
    """
    streams = [
        draw_population(mixture, library, part * volume_um3, rng).assign(over_roi=over)
        for over, part in ((True, share), (False, 1 - share))
        if part > 0
    ]
    counts = np.array([len(stream) for stream in streams])
    order = np.argsort(_interleave(counts / counts.sum(), counts.sum()), kind="stable")
    merged = pd.concat(streams, ignore_index=True)
    return merged.iloc[np.argsort(order, kind="stable")].reset_index(drop=True)


def _interleave(shares: np.ndarray, n: int) -> np.ndarray:
    """Component of each of ``n`` bodies: always the one most behind its share (ties: the first)."""
    component = np.empty(n, int)
    given = np.zeros(len(shares))
    for k in range(n):
        behind = shares * (k + 1) - given
        component[k] = behind.argmax()
        given[component[k]] += 1
    return component


def _shapes(table: pd.DataFrame, phase: int, radii: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A shape for each radius: at random among the tenth of the phase's shapes (at least 3) nearest in size.

    The tenth is counted in shapes, so that where they are rare none serves all grains. Sections are smaller
    than their grains, and radii are looked up as they are: shapes of large sections, which pass near the
    middle of large grains, serve most.
    """
    mine = table[table["phase"] == phase].sort_values(["r2d_um", "shape"])
    if mine.empty:
        raise InputError(
            "grain library", f"no shape of phase {phase}", "outline at least one uncut grain of it"
        )
    ids = mine["shape"].to_numpy(int)
    width = min(len(ids), max(3, len(ids) // 10))
    first = np.searchsorted(mine["r2d_um"].to_numpy(float), radii) - width // 2
    first = np.clip(first, 0, len(ids) - width)
    return ids[first + rng.integers(0, width, len(radii))]
