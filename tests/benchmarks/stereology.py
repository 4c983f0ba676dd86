"""How well are particle sizes known from n sections? -> results/benchmarks/stereology.csv

Sections are drawn exactly: a particle with probability proportional to its radius, cut at a uniform distance
from its centre. The error is the Wasserstein-1 distance between the estimated and the true distribution
of radii by number, in percent of the true mean radius. A row is the median over the repeats with a 95 %
bootstrap interval of that median; "mean of ..." is the mean of a set's medians. The second set shows whether
what holds for the first carries over.

Run it as ``python tests/benchmarks/stereology.py [--repeats 20] [--out FILE]``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats
from scipy.optimize import nnls

from grainfall.io import write_table
from grainfall.random import generator
from grainfall.stereology import section_kernel, unfold

SECTIONS = (200, 1_000, 10_000)
Estimate = tuple[np.ndarray, np.ndarray]  # edges, probability of each bin


@dataclass(frozen=True)
class Truth:
    """A mixture of SciPy distributions (a plain number stands for equal spheres of that radius)."""

    name: str
    parts: tuple
    shares: tuple[float, ...] = (1.0,)

    @property
    def mean(self) -> float:
        return sum(s * (p if isinstance(p, float) else p.mean()) for s, p in self._both())

    @property
    def largest(self) -> float:
        return max(p if isinstance(p, float) else p.ppf(1 - 1e-9) for p in self.parts)

    def _both(self) -> list[tuple[float, object]]:
        return list(zip(self.shares, self.parts, strict=True))

    def cdf(self, x: np.ndarray) -> np.ndarray:
        return sum(s * ((x >= p) if isinstance(p, float) else p.cdf(x)) for s, p in self._both())

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Radii of n particles."""
        part = rng.choice(len(self.parts), n, p=self.shares)
        draws = [np.full(n, p) if isinstance(p, float) else p.rvs(n, random_state=rng) for p in self.parts]
        return np.choose(part, draws)

    def sections(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Radii of n sections: size-weighted particles by rejection, then a uniform distance of the cut."""
        kept = np.empty(0)
        while len(kept) < n:
            radii = self.draw(4 * n, rng)
            kept = np.append(kept, radii[rng.random(4 * n) * self.largest < radii])
        return kept[:n] * np.sqrt(1.0 - rng.random(n) ** 2)


SETS = {
    "five": (
        Truth("equal", (1.0,)),
        Truth("lognormal 0.25", (stats.lognorm(0.25),)),
        Truth("lognormal 0.5", (stats.lognorm(0.5),)),
        Truth("two normals", (stats.norm(0.6, 0.06), stats.norm(1.4, 0.1)), (0.7, 0.3)),
        Truth("weibull 2", (stats.weibull_min(2.0),)),
    ),
    "five others": (
        Truth("uniform", (stats.uniform(0.5, 1.0),)),
        Truth("exponential + 0.1", (stats.expon(0.1),)),
        Truth("beta 5 2", (stats.beta(5, 2),)),
        Truth("triangle", (stats.triang(0.2, 0.2, 1.0),)),
        Truth("two sizes", (0.7, 1.2), (0.5, 0.5)),
    ),
}


def wasserstein(estimate: Estimate, truth: Truth) -> float:
    """Percent of the true mean radius."""
    edges, masses = estimate
    grid = np.linspace(0.0, max(truth.largest, edges[-1]), 40_001)
    grid = np.union1d(grid, edges)
    middle = 0.5 * (grid[1:] + grid[:-1])
    cumulative = np.concatenate([[0.0], np.cumsum(masses) / np.sum(masses)])
    gap = np.abs(np.interp(middle, edges, cumulative) - truth.cdf(middle))
    return 100.0 * float(gap @ np.diff(grid)) / truth.mean


def empirical(radii: np.ndarray) -> Estimate:
    """The radii themselves, each in a bin of no width to speak of."""
    sizes, counts = np.unique(radii, return_counts=True)
    edges = np.column_stack([sizes * (1 - 1e-9), sizes]).ravel()
    return edges, np.insert(counts, np.arange(1, len(counts)), 0).astype(float)


def saltykov(radii: np.ndarray, bins: int = 20) -> Estimate:
    """Saltykov's successive subtraction: particles of a class have its upper size; below zero is zero."""
    edges = np.linspace(0.0, radii.max() * (1 + 1e-9), bins + 1)
    upper = edges[1:]
    root = np.sqrt(np.maximum(upper[None, :] ** 2 - edges[:, None] ** 2, 0.0))
    numbers = np.linalg.solve(root[:-1] - root[1:], np.histogram(radii, edges)[0].astype(float))
    atoms = np.column_stack([upper * (1 - 1e-9), upper]).ravel()
    return atoms, np.insert(np.maximum(numbers, 0.0), np.arange(1, bins), 0.0)


def expectation_maximisation(radii: np.ndarray, bins: int = 20, iterations: int = 2_000) -> Estimate:
    """Maximum likelihood of the binned sections under the exact kernel."""
    edges = np.linspace(0.0, radii.max() * (1 + 1e-9), bins + 1)
    kernel = section_kernel(edges, edges)
    counts = np.histogram(radii, edges)[0] / len(radii)
    cut = np.full(bins, 1.0 / bins)
    for _ in range(iterations):
        cut *= kernel.T @ (counts / np.maximum(kernel @ cut, 1e-300))
    return edges, cut / (edges[1:] + edges[:-1])


def discrepancy(radii: np.ndarray, bins: int = 80) -> Estimate:
    """NNLS + second differences: the smoothest fit whose misfit is no larger than the counting noise."""
    edges = np.linspace(0.0, radii.max() * (1 + 1e-9), bins + 1)
    kernel = section_kernel(edges, edges) * np.diff(edges**2)
    kernel /= np.linalg.norm(kernel, 2)
    share = np.histogram(radii, edges)[0] / len(radii)
    rough = np.diff(np.eye(bins), 2, axis=0)
    noise = np.sum(share * (1.0 - share)) / len(radii)
    for penalty in np.logspace(2, -10, 49):
        found = nnls(np.vstack([kernel, np.sqrt(penalty) * rough]), np.append(share, np.zeros(bins - 2)))[0]
        if np.sum((kernel @ found - share) ** 2) <= noise:
            break
    return edges, found


def ours(method: str) -> Callable[[np.ndarray], Estimate]:
    def estimate(radii: np.ndarray) -> Estimate:
        found = unfold(radii, method=method)
        return found.edges_um, found.masses()

    return estimate


METHODS: dict[str, Callable[[np.ndarray], Estimate]] = {
    "none": empirical,
    "saltykov-20": saltykov,
    "em": expectation_maximisation,
    "paper": ours("paper"),
    "second-difference discrepancy": discrepancy,
    "tikhonov": ours("tikhonov"),
    "adaptive": ours("adaptive"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Accuracy of the stereological inversion")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--methods", nargs="*", default=[*METHODS, "direct"])
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks/stereology.csv"))
    arguments = parser.parse_args()

    columns = ("method", "distribution", "n", "w1_percent", "lower", "upper")
    rows = []
    for label, truths in SETS.items():
        for n in SECTIONS:
            errors = {method: [] for method in arguments.methods}
            for truth in truths:
                draws = [generator(0, truth.name, k, f"benchmark/{n}") for k in range(arguments.repeats)]
                samples = [(truth.sections(n, rng), truth.draw(n, rng)) for rng in draws]
                for method in arguments.methods:
                    found = [
                        empirical(particles) if method == "direct" else METHODS[method](radii)
                        for radii, particles in samples
                    ]
                    errors[method].append([wasserstein(f, truth) for f in found])
            for method, by_truth in errors.items():
                table = np.array(by_truth)  # (distributions, repeats)
                resample = generator(0, method, n, "benchmark/interval").integers(
                    arguments.repeats, size=(999, arguments.repeats)
                )
                medians, copies = np.median(table, axis=1), np.median(table[:, resample], axis=2)
                names = [*(t.name for t in truths), f"mean of {label}"]
                centre = np.append(medians, medians.mean())
                lower, upper = np.quantile(np.vstack([copies, copies.mean(axis=0)]), [0.025, 0.975], axis=1)
                rows += [
                    dict(zip(columns, (method, d, n, c, lo, hi), strict=True))
                    for d, c, lo, hi in zip(names, centre, lower, upper, strict=True)
                ]
    table = pd.DataFrame(rows)
    write_table(arguments.out, table.round(3))
    summary = table[table.distribution.str.startswith("mean of")]
    print(summary.pivot_table("w1_percent", ["distribution", "method"], "n", sort=False).round(1).to_string())


if __name__ == "__main__":
    main()
