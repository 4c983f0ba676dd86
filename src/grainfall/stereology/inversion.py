"""From the radii of sections to those of the particles that were cut: four ways to invert the kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy  # its parts load when they are first used

from grainfall.errors import InputError
from grainfall.stereology.distribution import SizeDistribution, checked_edges, rebinned
from grainfall.stereology.kernel import SPHERE, Particle, midpoint_kernel, section_kernel

METHODS = ("adaptive", "tikhonov", "paper", "none")


def unfold(
    radii_um: np.ndarray,
    weights: np.ndarray | None = None,
    *,
    method: str = "adaptive",
    edges_um: np.ndarray | None = None,
    smallest_um: float = 0.0,
    particle: Particle = SPHERE,
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
    particle : Particle
        Shape of the particles, a sphere by default; :func:`grainfall.grains.random_profiles` makes one from
        meshes of grains, :func:`grainfall.volume.void_circles` from those of voids. Heeded by ``adaptive``
        only; the others take all for spheres.
    bootstrap : int
        Resamples of the sections behind the band. ``adaptive`` weighs its numbers of components anew for
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
        edges_um = checked_edges(edges_um, radii)

    if method == "adaptive":
        inversion = _adaptive(radii, weights, smallest_um, particle)
    else:
        inversion = _BY_SPHERES[method](radii, weights, edges_um)
    grid = inversion.edges
    edges = grid if edges_um is None else edges_um

    def on_edges(density: np.ndarray) -> np.ndarray:
        """On the bins asked for, all particles in them: the sieve's reach beyond the largest section."""
        return density if edges is grid else _density(rebinned(grid, density, edges), edges)

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


def _histogram(radii: np.ndarray, weights: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Density of weighted radii on bins that hold them all."""
    counts = np.histogram(radii, edges, weights=weights)[0]
    return counts / (weights.sum() * np.diff(edges))


def _density(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    return values / (values @ np.diff(edges))


def _none(radii: np.ndarray, weights: np.ndarray, edges_um: np.ndarray | None) -> _Inversion:
    edges = _Sieve(radii, weights).edges if edges_um is None else edges_um
    return _Inversion(edges, _histogram(radii, weights, edges), lambda w: _histogram(radii, w, edges), np.nan)


def _paper(
    radii: np.ndarray,
    weights: np.ndarray,
    edges_um: np.ndarray | None,
    bins: int = 40,
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


def _tikhonov(radii: np.ndarray, weights: np.ndarray, edges_um: np.ndarray | None) -> _Inversion:
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


def _adaptive(radii: np.ndarray, weights: np.ndarray, smallest_um: float, particle: Particle) -> _Inversion:
    """Mixtures of gamma densities by maximum likelihood, averaged over their number.

    A roughness penalty has one width for all sizes: wide enough for the few small sections, it smears a
    narrow peak. Here every component brings its own width, from below a bin to as wide as its mean, and the
    number of components, priced by Hannan and Quinn's criterion, takes the place of the penalty. The
    likelihood is that of the binned sections under the exact kernel, given that they are large enough to be
    kept. A mixture of gammas comes as close as one likes to any density on positive sizes, so the estimate
    follows the data as their number grows.
    """
    sieve = _Sieve(radii, weights, smallest_um, particle)
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

    def __init__(
        self,
        radii: np.ndarray,
        weights: np.ndarray,
        smallest_um: float = 0.0,
        particle: Particle = SPHERE,
    ):
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
            beyond_all = 4 * inner[-1]  # of a grain that is no sphere, a section may be wider than its radius
            self._chance = self._middle * section_kernel([smallest_um, beyond_all], inner, particle)[0]
        # Bins without sections add nothing to the likelihood: every component has the total chance 1.
        section_edges = np.unique(np.maximum(_section_edges(self.edges, radii), smallest_um))
        bin_of = np.searchsorted(section_edges, radii, side="right") - 1
        filled, self._row = np.unique(bin_of, return_inverse=True)
        self._kernel = section_kernel(section_edges, inner, particle)[filled] * self._middle
        seen = smallest_um / particle.exceeded(self.SEEN)
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


_BY_SPHERES = {"tikhonov": _tikhonov, "paper": _paper, "none": _none}


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
