"""Wicksell's corpuscle problem: the radii of sections become the radii of the particles that were cut.

A plane meets a sphere of radius R with probability proportional to R, at a distance from the centre that is
uniform on (0, R). Number densities of particles (f3D) and of sections (f2D) therefore obey

    f2D(r) = r / E[R] * integral over R > r of f3D(R) / sqrt(R^2 - r^2) dR .

Everything here is a number density per micrometre of radius; other shapes than spheres enter through their
equivalent radii only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy  # its parts load when they are first used

from grainfall.errors import InputError

METHODS = ("adaptive", "tikhonov", "paper", "none")
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
        Pointwise 95 % bootstrap band of ``f3d``; NaN where no bootstrap was asked for.
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


def section_kernel(section_edges: np.ndarray, edges: np.ndarray) -> np.ndarray:
    r"""Probability that a particle drawn and cut gives a section in bin i, exact for flat bins.

    With a number density that is constant on the particle bin [a, b], the chance that a section of such a
    particle exceeds x is ``(G(b, x) - G(a, x)) / (G(b, 0) - G(a, 0))`` where

    .. math:: G(R, x) = \int_x^R \sqrt{\rho^2 - x^2}\, d\rho
                      = \tfrac12 \left( R\sqrt{R^2 - x^2} - x^2 \operatorname{arccosh}(R / x) \right)

    and G = 0 for R < x: the survival function of Wicksell's equation, integrated over the bin.

    Parameters
    ----------
    section_edges : (m + 1,) ndarray
        Increasing edges of the section bins, >= 0.
    edges : (n + 1,) ndarray
        Increasing edges of the particle bins, >= 0.

    Returns
    -------
    (m, n) ndarray
        Column j sums to 1 where the section bins cover [0, edges[j + 1]]. A particle is cut in proportion
        to its radius: multiply column j by the bin's mean radius to start from number densities.
    """
    x = np.asarray(section_edges, dtype=float)[:, None]
    radius = np.maximum(np.asarray(edges, dtype=float)[None, :], x)
    ratio = np.divide(radius, x, out=np.ones_like(radius), where=x > 0)
    primitive = 0.5 * (radius * np.sqrt((radius - x) * (radius + x)) - x**2 * np.arccosh(ratio))
    survival = np.diff(primitive, axis=1)
    return -np.diff(survival, axis=0) / (0.5 * np.diff(np.asarray(edges, dtype=float) ** 2))


def midpoint_kernel(edges: np.ndarray) -> np.ndarray:
    """The paper's matrix **A**: section densities at bin midpoints from particle densities (up to a factor).

    a_ij = r_mi [ln((R + s) / (R - s))] between max(r_(j-1), r_mi) and max(r_j, r_mi), s = sqrt(R^2 - r_mi^2).
    The paper's lower limit r_(j-1) is below r_mi on the diagonal, where the root is imaginary (NaN);
    particles smaller than the section cannot have made it, so the integral starts at r_mi.
    Half the logarithm is arccosh(R / r_mi), which does not cancel.

    Parameters
    ----------
    edges : (n + 1,) ndarray

    Returns
    -------
    (n, n) ndarray
    """
    middle = 0.5 * (edges[1:] + edges[:-1])[:, None]
    limits = np.maximum(edges[None, :], middle)
    return 2.0 * middle * np.diff(np.arccosh(limits / middle), axis=1)


def unfold(
    radii_um: np.ndarray,
    weights: np.ndarray | None = None,
    *,
    method: str = "adaptive",
    edges_um: np.ndarray | None = None,
    smallest_um: float = 0.0,
    bootstrap: int = 200,
    rng: np.random.Generator | None = None,
) -> SizeDistribution:
    """Distribution of particle radii from the radii of their sections.

    Parameters
    ----------
    radii_um : (n,) array
        Section radii, > 0, micrometres.
    weights : (n,) array, optional
        Edge corrections (Miles-Lantuejoul), >= 0; sections of weight 0 are left out. Equal by default.
    method : {"adaptive", "tikhonov", "paper", "none"}
        ``adaptive``: exact kernel; a sieve of gamma densities, its bins and size chosen from the data.
        ``tikhonov``: exact kernel, 80 bins, NNLS with a second-difference penalty by cross-validation.
        ``paper``: midpoint kernel, bins up to 2 max r, identity penalty by generalised cross-validation.
        ``none``: f3D := f2D.
    edges_um : (m + 1,) array, optional
        Bins of the result, increasing, >= 0, that hold all radii; chosen from the data otherwise.
    smallest_um : float
        Radius below which sections were left out, as specks: that none is there then says nothing. Heeded by
        ``adaptive`` only; the others take what is missing for absent.
    bootstrap : int
        Resamples of the sections behind the 95 % band. ``adaptive`` weighs its numbers of components anew for
        each of them, the other methods hold their regularisation.
    rng : numpy.random.Generator, optional
        Draws the resamples. Without it there is no band: ``lower`` and ``upper`` are NaN.

    Returns
    -------
    SizeDistribution

    Raises
    ------
    InputError
        When there is no section, a radius is not a positive number, or weights or bins do not fit. A phase
        (or pore space) without sections has no size distribution; the caller leaves it out.
    """
    radii, weights = _checked(radii_um, weights)
    if not 0 <= smallest_um <= radii[0]:
        raise InputError(
            "smallest section", f"{smallest_um:g} um", f"from 0 to the smallest radius, {radii[0]:g} um"
        )
    if method not in METHODS:
        raise InputError("stereology method", f"{method!r} is not known", f"one of {', '.join(METHODS)}")
    if edges_um is not None:
        edges_um = _checked_edges(edges_um, radii)

    inversion = _INVERSIONS[method](radii, weights, edges_um, smallest_um)
    grid = inversion.edges
    edges = grid if edges_um is None else edges_um

    def on_edges(density: np.ndarray) -> np.ndarray:
        """On the bins asked for, all particles in them: the sieve's reach beyond the largest section."""
        return density if edges is grid else _density(_rebinned(grid, density, edges), edges)

    f3d = on_edges(inversion.f3d)
    f2d = _histogram(radii, weights, edges)
    lower = upper = np.full_like(f3d, np.nan)
    if rng is not None and bootstrap > 0:
        n = len(radii)
        copies = weights * rng.multinomial(n, np.full(n, 1.0 / n), size=bootstrap)
        replicas = [on_edges(inversion.again(w)) for w in copies]
        lower, upper = np.quantile(replicas, [0.025, 0.975], axis=0)
        lower, upper = np.minimum(lower, f3d), np.maximum(upper, f3d)
    return SizeDistribution(edges, f2d, f3d, lower, upper, method, inversion.regularisation)


class _Inversion(NamedTuple):
    edges: np.ndarray
    f3d: np.ndarray
    again: Callable[[np.ndarray], np.ndarray]  # weights of a resample -> its f3d
    regularisation: float


def _checked(radii_um: np.ndarray, weights: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Sorted radii of positive weight, and their weights."""
    radii = np.asarray(radii_um, dtype=float).ravel()
    weights = np.ones_like(radii) if weights is None else np.asarray(weights, dtype=float).ravel()
    if weights.shape != radii.shape:
        raise InputError("section weights", f"{weights.size} for {radii.size} radii", "one weight for each")
    if not np.all(np.isfinite(weights) & (weights >= 0)):
        raise InputError("section weights", "negative or not finite", "weights are numbers >= 0")
    radii, weights = radii[weights > 0], weights[weights > 0]
    if radii.size == 0:
        raise InputError("section radii", "there is no uncut section to unfold", "leave this phase out")
    if not np.all(np.isfinite(radii) & (radii > 0)):
        raise InputError("section radii", "zero, negative or not finite", "radii are numbers > 0 in um")
    order = np.argsort(radii, kind="stable")
    return radii[order], weights[order]


def _checked_edges(edges_um: np.ndarray, radii: np.ndarray | None = None) -> np.ndarray:
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


def _histogram(radii: np.ndarray, weights: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Density of weighted radii on bins that hold them all."""
    counts = np.histogram(radii, edges, weights=weights)[0]
    return counts / (weights.sum() * np.diff(edges))


def _density(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    return values / (values @ np.diff(edges))


def _none(
    radii: np.ndarray, weights: np.ndarray, edges_um: np.ndarray | None, smallest_um: float
) -> _Inversion:
    edges = _Sieve(radii, weights).edges if edges_um is None else edges_um
    return _Inversion(edges, _histogram(radii, weights, edges), lambda w: _histogram(radii, w, edges), np.nan)


def _paper(
    radii: np.ndarray, weights: np.ndarray, edges_um: np.ndarray | None, smallest_um: float, bins: int = 40
) -> _Inversion:
    """The paper's inversion; it leaves the number of bins and the penalty's weight open (here: 40, GCV)."""
    edges = np.linspace(0.0, 2.0 * radii[-1], bins + 1) if edges_um is None else edges_um
    matrix = midpoint_kernel(edges)
    left, singular, _ = np.linalg.svd(matrix)
    singular **= 2
    data = (left.T @ _histogram(radii, weights, edges)) ** 2
    identity = np.eye(len(singular))

    def gcv(penalty: float) -> float:
        damped = penalty / (singular + penalty)
        return damped**2 @ data / damped.sum() ** 2

    def solve(w: np.ndarray) -> np.ndarray:
        target = np.concatenate([_histogram(radii, w, edges), np.zeros(len(singular))])
        return _density(
            scipy.optimize.nnls(np.vstack([matrix, np.sqrt(penalty) * identity]), target)[0], edges
        )

    penalty = min(singular[0] * np.logspace(-8, -2, 25), key=gcv)
    return _Inversion(edges, solve(weights), solve, float(penalty))


def _tikhonov(
    radii: np.ndarray, weights: np.ndarray, edges_um: np.ndarray | None, smallest_um: float
) -> _Inversion:
    """NNLS on the exact kernel with a second-difference penalty, its weight by five-fold cross-validation.

    The score is the squared distance of section distribution functions: closer to what the result is used for
    (sizes drawn from it) than the misfit of single bins.
    """
    edges = np.linspace(0.0, radii[-1] * (1 + 1e-9), 81)
    matrix = section_kernel(edges, edges) * np.diff(edges**2)
    matrix /= np.linalg.norm(matrix, 2)
    rough = np.diff(np.eye(len(edges) - 1), 2, axis=0)
    bin_of = np.searchsorted(edges, radii, side="right") - 1
    fold = np.arange(len(radii)) % 5  # the radii are sorted: every fold holds all sizes

    def shares(w: np.ndarray) -> np.ndarray:
        return np.bincount(bin_of, w, len(edges) - 1) / w.sum()

    def solve(w: np.ndarray, penalty: float) -> np.ndarray:
        system = np.vstack([matrix, np.sqrt(penalty) * rough])
        return scipy.optimize.nnls(system, np.concatenate([shares(w), np.zeros(len(rough))]))[0]

    def held_out(penalty: float) -> float:
        score = 0.0
        for k in range(5):
            model = matrix @ solve(weights * (fold != k), penalty)
            score += np.sum(np.cumsum(model / model.sum() - shares(weights * (fold == k))) ** 2)
        return score

    penalties = np.logspace(1, -8, 19)
    penalty = min(penalties, key=held_out) if len(radii) >= 10 else penalties[-1]

    def again(w: np.ndarray) -> np.ndarray:
        return _density(solve(w, penalty), edges)

    return _Inversion(edges, again(weights), again, float(penalty))


def _adaptive(
    radii: np.ndarray, weights: np.ndarray, edges_um: np.ndarray | None, smallest_um: float
) -> _Inversion:
    """Mixtures of gamma densities by maximum likelihood, averaged over their number.

    A roughness penalty has one width for all sizes: wide enough for the few small sections, it smears a
    narrow peak. Here every component brings its own width, from below a bin to as wide as its mean, and the
    number of components, priced by Hannan and Quinn's criterion, takes the place of the penalty. The
    likelihood is that of the binned sections under the exact kernel, given that they are large enough to be
    kept. A mixture of gammas comes as close as one likes to any density on positive sizes, so the estimate
    follows the data as their number grows.
    """
    sieve = _Sieve(radii, weights, smallest_um)
    fits = sieve.fit(sieve.counts(weights))

    def again(w: np.ndarray) -> np.ndarray:
        counts = sieve.counts(w)
        climbs = [sieve.climb(fit.theta, counts, 15) for fit in fits]
        return sieve.mix(climbs, _trust(climbs))

    trust = _trust(fits)
    return _Inversion(sieve.edges, sieve.mix(fits, trust), again, float(trust @ np.arange(1, len(fits) + 1)))


class _Fit(NamedTuple):
    criterion: float  # Hannan and Quinn's: -2 log likelihood + 2 parameters log log sections
    theta: np.ndarray  # log odds of the k - 1 later components against the first, k log means, k log CVs


def _trust(fits: list[_Fit]) -> np.ndarray:
    """Weights of models by their criterion (Akaike weights)."""
    criterion = np.array([fit.criterion for fit in fits])
    trust = np.exp(-0.5 * (criterion - criterion.min()))
    return trust / trust.sum()


class _Sieve:
    """Finite mixtures of gamma densities (of particle numbers), seen through the exact kernel.

    Bins are equal in log radius, so every size is resolved alike, and as narrow as the sample allows: what n
    sections tell of a radius has an error that falls no faster than n**(-1/2).
    """

    MAX_COMPONENTS = 8
    DEPTH = 6.0  # particles below exp(-6) of the largest section are not modelled
    BEYOND = 0.5  # nor above exp(0.5) of it
    SEEN = 0.75  # no component has its mean where fewer sections are seen: their number would be a guess

    def __init__(self, radii: np.ndarray, weights: np.ndarray, smallest_um: float = 0.0):
        # Kish's effective number: what weighted sections are worth.
        self.sections = weights.sum() ** 2 / np.sum(weights**2)
        step = float(np.clip(0.16 * self.sections**-0.3, 0.008, 0.03))
        top = np.log(radii[-1]) + 1e-9
        below = int(np.ceil(min(top - np.log(radii[0]), self.DEPTH) / step)) + 1
        inner = np.exp(top + step * np.arange(-below, int(self.BEYOND / step) + 1))
        self.edges = np.concatenate([[0.0], inner])
        self._inner = inner
        self._middle = 0.5 * (inner[1:] + inner[:-1])
        # In proportion to the chance that a plane cuts a particle of each bin so that it is seen.
        self._chance = self._middle
        if smallest_um > 0:
            self._chance = self._middle * section_kernel([smallest_um, inner[-1]], inner)[0]
        # Bins without sections add nothing to the likelihood: every component has the total chance 1.
        section_edges = np.unique(np.maximum(_section_edges(self.edges, radii), smallest_um))
        bin_of = np.searchsorted(section_edges, radii, side="right") - 1
        filled, self._row = np.unique(bin_of, return_inverse=True)
        self._kernel = section_kernel(section_edges, inner)[filled] * self._middle
        seen = smallest_um / np.sqrt(1 - self.SEEN**2)
        lowest = np.log(max(inner[1], min(seen, np.exp(top - self.BEYOND))))
        self._bounds = (lowest, top + 0.6 * self.BEYOND), (np.log(step / 3), 0.0)
        # Where the search may start: every size at every width.
        (low, _), (narrow, wide) = self._bounds
        starts = np.meshgrid(np.arange(low, top, 0.06), np.linspace(narrow, wide, 9), indexing="ij")
        self._starts = np.column_stack([start.ravel() for start in starts])
        self._dictionary = self._seen(*self._starts.T)

    def counts(self, weights: np.ndarray) -> np.ndarray:
        """Effective sections in the bins that hold any."""
        return np.bincount(self._row, weights) * self.sections / weights.sum()

    @staticmethod
    def components(theta: np.ndarray) -> int:
        return (len(theta) + 1) // 3

    def _split(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Shares of the sections, log means, log coefficients of variation."""
        k = self.components(theta)
        odds = np.concatenate([[0.0], theta[: k - 1]])
        share = np.exp(odds - odds.max())
        return share / share.sum(), theta[k - 1 : 2 * k - 1], theta[2 * k - 1 :]

    def _numbers(self, log_mean: np.ndarray, log_cv: np.ndarray) -> np.ndarray:
        """Particle numbers (bins, k) of gamma components, scaled to the same chance of being cut and seen."""
        shape = np.exp(-2.0 * log_cv)
        below = scipy.special.gammainc(shape, shape * np.exp(-log_mean) * self._inner[:, None])
        numbers = np.diff(below, axis=0)
        return numbers / np.maximum(self._chance @ numbers, 1e-300)

    def _seen(self, log_mean: np.ndarray, log_cv: np.ndarray) -> np.ndarray:
        """Share of each component's sections in the filled bins, (bins, k)."""
        return self._kernel @ self._numbers(log_mean, log_cv)

    def mix(self, fits: list[_Fit], trust: np.ndarray) -> np.ndarray:
        """Number density on ``edges``, averaged over fits."""
        total = np.zeros(len(self._middle))
        for fit, weight in zip(fits, trust, strict=True):
            share, log_mean, log_cv = self._split(fit.theta)
            numbers = self._numbers(log_mean, log_cv) @ share
            total += weight * numbers / numbers.sum()
        return np.concatenate([[0.0], total]) / np.diff(self.edges)

    def climb(self, theta: np.ndarray, counts: np.ndarray, iterations: int) -> _Fit:
        """Maximise the likelihood of ``counts`` from ``theta``."""
        k, delta = self.components(theta), 1e-5

        def loss(theta: np.ndarray) -> tuple[float, np.ndarray]:
            share, log_mean, log_cv = self._split(theta)
            # One pass gives the components and their derivatives by differences.
            seen = self._seen(
                np.concatenate([log_mean, log_mean + delta, log_mean]),
                np.concatenate([log_cv, log_cv, log_cv - delta]),
            )
            here, moved, narrowed = seen[:, :k], seen[:, k : 2 * k], seen[:, 2 * k :]
            density = np.maximum(here @ share, 1e-12)
            pull = counts / density
            gain = pull @ here
            by_share = (share * (gain - gain @ share))[1:]
            by_mean = share * (pull @ (moved - here)) / delta
            by_cv = share * (pull @ (here - narrowed)) / delta
            return -counts @ np.log(density), -np.concatenate([by_share, by_mean, by_cv])

        bounds = [(-12.0, 12.0)] * (k - 1) + [self._bounds[0]] * k + [self._bounds[1]] * k
        options = {"maxiter": iterations}
        found = scipy.optimize.minimize(
            loss, theta, jac=True, bounds=bounds, method="L-BFGS-B", options=options
        )
        # Never below Akaike's price of 2 a parameter, where log log n means little.
        price = 2.0 * max(1.0, np.log(max(np.log(self.sections), 1.0)))
        return _Fit(float(2.0 * found.fun + price * len(theta)), found.x)

    def _additions(self, theta: np.ndarray, counts: np.ndarray) -> list[np.ndarray]:
        """``theta`` and one component more: the one that helps most at each of three shares."""
        share, log_mean, log_cv = self._split(theta)
        now = (self._seen(log_mean, log_cv) @ share)[:, None]
        additions = []
        for new in (0.02, 0.1, 0.3):
            seen = (1.0 - new) * now + new * self._dictionary
            best_mean, best_cv = self._starts[np.argmax(counts @ np.log(np.maximum(seen, 1e-12)))]
            odds = np.log(np.append(share * (1.0 - new), new) / share[0] / (1.0 - new))[1:]
            additions.append(np.concatenate([odds, log_mean, [best_mean], log_cv, [best_cv]]))
        return additions

    def fit(self, counts: np.ndarray) -> list[_Fit]:
        """Best mixtures of 1, 2, ... components, until two more did not pay."""
        gain = counts @ np.log(np.maximum(self._dictionary, 1e-12))
        starts = list(self._starts[np.argsort(-gain)[:2]])
        fits: list[_Fit] = []
        for k in range(1, self.MAX_COMPONENTS + 1):
            fits.append(min((self.climb(s, counts, 60 * k) for s in starts), key=lambda fit: fit.criterion))
            since_best = k - 1 - int(np.argmin([fit.criterion for fit in fits]))
            if since_best == 2 or 3 * k > self.sections:
                break
            starts = self._additions(fits[-1].theta, counts)
        return fits


def _section_edges(grid: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Bins of sections: ``grid``, but no bin cuts what one value of sorted radii stands for.

    Radii that were measured in pixels are repeated values of a lattice; each stands for all radii up to half
    way to its neighbours. A grid that is not in step with the lattice would see peaks in it.
    """
    values, copies = np.unique(radii, return_counts=True)
    if len(values) < 2:
        return grid
    lattice = ((copies[1:] > 1) | (copies[:-1] > 1)) & (np.diff(np.log(values)) < 0.5)
    # One value more at either end gives the last ones their outer halves.
    values = np.concatenate([[values[0] ** 2 / values[1]], values, [values[-1] ** 2 / values[-2]]])
    lattice = lattice[np.r_[0, 0 : len(lattice), -1]]
    above = np.clip(np.searchsorted(values, grid), 1, len(values) - 1)
    moves = lattice[above - 1] & (grid > values[0]) & (grid <= values[-1])
    return np.unique(np.where(moves, np.sqrt(values[above - 1] * values[above]), grid))


_INVERSIONS = {"adaptive": _adaptive, "tikhonov": _tikhonov, "paper": _paper, "none": _none}


def _rebinned(edges: np.ndarray, density: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """A density that is constant within ``edges`` averaged over the bins ``onto``."""
    if edges is onto:
        return density
    cumulative = np.concatenate([[0.0], np.cumsum(density * np.diff(edges))])
    return np.diff(np.interp(onto, edges, cumulative)) / np.diff(onto)


def rebin(distribution: SizeDistribution, edges_um: np.ndarray) -> SizeDistribution:
    """The same distribution on other bins; each bin keeps its number of particles.

    Parameters
    ----------
    distribution : SizeDistribution
    edges_um : (m + 1,) array
        Increasing edges that hold the whole distribution.

    Returns
    -------
    SizeDistribution
        The band's ends are averaged over the new bins like the densities, which is on the wide side.

    Raises
    ------
    InputError
        When the edges do not increase or would cut particles or sections off.
    """
    old, new = distribution.edges_um, _checked_edges(edges_um)
    filled = np.flatnonzero((distribution.f2d > 0) | (distribution.f3d > 0))
    _checked_edges(new, old[[filled[0], filled[-1] + 1]])
    densities = (
        _rebinned(old, getattr(distribution, name), new) for name in ("f2d", "f3d", "lower", "upper")
    )
    return SizeDistribution(new, *densities, distribution.method, distribution.regularisation)


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


def unfold_table(table: pd.DataFrame, **options) -> SizeDistribution | None:
    """Unfold the ``r_um`` of a measured table's uncut objects by their weights; None where all are cut.

    Parameters
    ----------
    table : DataFrame
        Columns r_um and weight, as the morphology chapter measures grains and pores.
    **options
        See :func:`unfold`.
    """
    uncut = table[table["weight"] > 0]
    return None if uncut.empty else unfold(uncut["r_um"], uncut["weight"], **options)
