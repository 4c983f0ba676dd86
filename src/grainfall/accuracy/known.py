"""Settings of the analysis tried on volumes and sections whose truth is known, without packing anything.

Every function takes the settings to try, random numbers and ``run``, which measures what one call costs,
and yields a :class:`Trial` a setting. The truth is a formula where there is one (regular spheres, sections of
known radii), else the finest setting or the whole volume, on the same volume.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from scipy import stats

from grainfall import correlation, flow, network, random, stereology
from grainfall.accuracy.observe import axial_s2, differences, observe, pooled, relative_distance
from grainfall.errors import InputError
from grainfall.section import Mineral, synthesise
from grainfall.volume import coarsen as joined

ZICK_HOMSY = 42.1
"""Drag over 6 pi mu a U of touching spheres in a simple cubic array (Zick & Homsy 1982)."""

CV = 0.25
"""Spread of the radii where spheres are not equal."""


class Cost(NamedTuple):
    """What one call took; memory is the largest that its process ever held."""

    wall_s: float
    cpu_s: float
    peak_rss_mb: float


class Trial(NamedTuple):
    """One setting on one volume: errors by metric, and what they are errors against."""

    setting: str
    against: str
    differences: dict[str, float]
    cost: Cost


Run = Callable[[Callable[[], object]], tuple[object, Cost]]


def alone(work: Callable[[], object]) -> tuple[object, Cost]:
    """Do the work in a process of its own, which inherits all that is loaded and compiled.

    Returns
    -------
    value : object
        What the work returned.
    cost : Cost
        Without start-up.

    Raises
    ------
    RuntimeError
        Where the process ended without an answer.
    """
    context = get_context("fork")
    here, there = context.Pipe(duplex=False)

    def child() -> None:
        wall, cpu = time.perf_counter(), time.process_time()
        value = work()
        cost = Cost(
            time.perf_counter() - wall,
            time.process_time() - cpu,
            resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        )
        there.send((value, cost))

    process = context.Process(target=child)
    process.start()
    there.close()
    try:
        return here.recv()
    except EOFError:
        raise RuntimeError("a setting ended without an answer") from None
    finally:
        process.join()


def warm_up() -> None:
    """Load and compile what the trials use, so that none of them pays for it."""
    ball = spheres(8.0, 2, (0.0, 0.0, 0.0))
    observe(ball, 1.0)
    network.extract(ball, 1.0, "snow2")
    for tier in ("elliptic", "direct"):
        flow.permeability(ball, 1.0, tier)
    flow.permeability(ball, 1.0, "network", conductance="shape_factor")
    flow.direct.solve(ball, "x", ends="periodic", sides="periodic")
    correlation.s2_of_slices(~ball, [(0, 0)], 1.0)
    for method in stereology.METHODS:
        stereology.unfold(np.linspace(0.5, 1.5, 50), method=method)


def pack(rng: np.random.Generator, across: float, voxels: float, porosity: float = 0.38) -> np.ndarray:
    """Pores (n, n, n) of a periodic pack of spheres of different sizes.

    Parameters
    ----------
    rng : numpy.random.Generator
    across, voxels : float
        Edge in mean diameters, mean diameter in voxels.
    porosity : float
        Met to a voxel.
    """
    edge = round(across * voxels)
    glass = Mineral("glass", 1.0, voxels / 2, CV, 0.0)
    return synthesise(rng, (edge,) * 3, 1.0, [glass], exponent=2, packed_porosity=porosity).phase == 0


def spheres(voxels: float, cells: int, shift: Sequence[float]) -> np.ndarray:
    """Pores (n, n, n) of touching spheres in a simple cubic array, whole cells with pores at their centres.

    Parameters
    ----------
    voxels : float
        Diameter, voxels; the box is rounded to whole ones, and the spheres with it.
    cells : int
        Spheres along an edge.
    shift : (3,) floats
        Of the array along z, y, x, voxels.
    """
    n = round(voxels * cells)
    at = (np.arange(n) + 0.5) * cells / n
    z, y, x = (np.abs((at + s * cells / n + 0.5) % 1 - 0.5) ** 2 for s in shift)
    return z[:, None, None] + y[:, None] + x > 0.25


def spheres_s2(lag: np.ndarray) -> np.ndarray:
    """S2 of the solid of touching spheres in a simple cubic array, along an axis of it.

    Parameters
    ----------
    lag : array
        In diameters. Two spheres of radius R, centres h apart, share pi (4R + h)(2R - h)^2 / 12; along an
        axis only a sphere's own image and its neighbour's can meet it.
    """
    h = np.asarray(lag) % 1
    return sum(np.pi / 12 * (2 + d) * (1 - d) ** 2 for d in (h, 1 - h))


# ---- the knobs


def flow_tier(settings: Sequence[str], rng: np.random.Generator, run: Run) -> Iterator[Trial]:
    """K of one pack by every tier; ``network`` by local solutions, ``shape_factor`` by ducts."""
    pore = pack(rng, 5, 12)

    def k(tier: str) -> float:
        if tier == "shape_factor":
            return flow.permeability(pore, 1.0, "network", conductance=tier).k_md.mean()
        return flow.permeability(pore, 1.0, tier).k_md.mean()

    yield from _against("direct", settings, lambda s: run(lambda: {"k_md": k(s)}))


def network_method(settings: Sequence[str], rng: np.random.Generator, run: Run) -> Iterator[Trial]:
    """Pore radii of regular spheres and K of a pack by each method; ``persistence_0.4`` with that threshold.

    The largest sphere between eight touching ones has (sqrt(3) - 1) of their radius.
    """
    whole = pack(rng, 5, 12)
    direct = {"k_md": flow.permeability(whole, 1.0, "direct").k_md.mean()}
    voxels, cells = 12.0, 4
    pore = spheres(voxels, cells, rng.uniform(-0.5, 0.5, 3))
    exact = {"pores": _one_pore((np.sqrt(3) - 1) * voxels / 2)}

    for setting in settings:
        method, _, value = setting.partition("_")
        options = {"persistence": float(value)} if value else {}

        def k(method: str = method, options: dict = options) -> dict:
            if method == "persistence":
                return {"k_md": flow.permeability(whole, 1.0, **options).k_md.mean()}
            found = network.extract(whole, 1.0, method)
            table = flow.permeability(whole, 1.0, conductance="pyramids", network=found)
            return {"k_md": table.k_md.mean()}

        found, cost = run(lambda m=method, o=options: network.extract(pore, 1.0, m, **o))
        yield Trial(setting, "formula", differences({"pores": network.element_sizes(found)}, exact), cost)
        found, cost = run(k)
        yield Trial(setting, "direct", differences(found, direct), cost)


def voxels_per_grain(settings: Sequence[str], rng: np.random.Generator, run: Run) -> Iterator[Trial]:
    """Porosity, pore radii, S2 and K of regular spheres on ever finer voxels, K by ``direct``."""
    shift = rng.uniform(-0.5, 0.5, 3)
    cells = 3

    def seen(voxels: float) -> dict:
        pore = spheres(voxels, cells, shift)
        one = spheres(voxels, 1, shift)
        k = flow.direct.solve(one, "x", ends="periodic", sides="periodic").k / voxels**2
        return {**_shapes(pore, 1 / voxels), "k_md": k}

    for setting in settings:
        voxels = float(setting)
        found, cost = run(lambda v=voxels: seen(v))
        lag = np.arange(round(voxels) + 1) / voxels
        exact = {
            "porosity": 1 - np.pi / 6,
            "pores": _one_pore((np.sqrt(3) - 1) / 2),
            "lag_um": lag,
            "s2": spheres_s2(lag),
            "k_md": 2 * 0.25 / (9 * (np.pi / 6) * ZICK_HOMSY),
        }
        yield Trial(setting, "formula", differences(found, exact), cost)


def coarsen(settings: Sequence[str], rng: np.random.Generator, run: Run) -> Iterator[Trial]:
    """Pore radii and K of a pack of 32 voxels a grain, some of them joined before the network is measured."""
    fine = pack(rng, 4, 32)

    def seen(factor: int) -> dict:
        pore, voxel = joined(fine, 1.0, factor)
        found = network.extract(pore, voxel)
        k = flow.permeability(pore, voxel, network=found).k_md.mean()
        return {"k_md": k, "pores": network.element_sizes(found)}

    yield from _against("1", settings, lambda s: run(lambda: seen(int(s))))


def _shapes(pore: np.ndarray, voxel: float) -> dict:
    """Porosity, S2 along x and pore radii of a periodic volume."""
    table = correlation.s2_volume(~pore, voxel, periodic=True, radial=False)
    along = table[table["axis"] == "x"]
    return {
        "porosity": float(pore.mean()),
        "lag_um": along["lag_um"].to_numpy(),
        "s2": along["s2"].to_numpy(),
        "pores": network.element_sizes(network.extract(pore, voxel)),
    }


def _one_pore(radius: float) -> dict:
    """Sizes of a network whose pores are all alike."""
    return {"pore_radius_um": np.array([radius]), "pore_volume_um3": np.ones(1)}


def grains_across(settings: Sequence[str], rng: np.random.Generator, run: Run) -> Iterator[Trial]:
    """Cubes cut from a larger pack at random, against the whole of it (the representative volume)."""
    voxels = 10
    whole = pack(rng, 12, voxels)
    corner = rng.random(3)
    held, _ = run(lambda: observe(whole, 1.0))
    for setting in settings:
        cube = _cut(whole, round(float(setting) * voxels), corner)
        found, cost = run(lambda c=cube: observe(c, 1.0))
        yield Trial(setting, "12 grains across", differences(found, held), cost)


def realizations(settings: Sequence[str], rng: np.random.Generator, run: Run) -> Iterator[Trial]:
    """Means over so many cubes five grains across, out of a larger pack, against the whole of it."""
    voxels = 10
    whole = pack(rng, 12, voxels)
    corners = rng.random((max(map(int, settings)), 3))
    held, _ = run(lambda: observe(whole, 1.0))
    seen = [run(lambda c=corner: observe(_cut(whole, 5 * voxels, c), 1.0)) for corner in corners]
    for setting in settings:
        found, costs = zip(*seen[: int(setting)], strict=True)
        cost = Cost(*np.sum(costs, axis=0)[:2], max(c.peak_rss_mb for c in costs))
        yield Trial(setting, "12 grains across", differences(pooled(found), held), cost)


def slices(settings: Sequence[str], rng: np.random.Generator, run: Run) -> Iterator[Trial]:
    """S2 by so many slices of one volume against that of all of it."""
    pore = pack(rng, 8, 12)
    solid = ~pore
    exact = dict(zip(("lag_um", "s2"), axial_s2(pore, 1.0), strict=True))
    for setting in settings:
        chosen = random.slices(rng, solid.shape, int(setting))
        found, cost = run(lambda c=chosen: _slice_s2(solid, c))
        yield Trial(setting, "volume", differences(found, exact), cost)


def _slice_s2(solid: np.ndarray, chosen: Sequence[tuple[int, int]]) -> dict:
    table = correlation.s2_of_slices(solid, chosen, 1.0)
    mean = table.groupby("lag_um")["s2"].mean()
    return {"lag_um": mean.index.to_numpy(), "s2": mean.to_numpy()}


def stereology_rule(settings: Sequence[str], rng: np.random.Generator, run: Run) -> Iterator[Trial]:
    """Radii unfolded from 1,000 sections of lognormal spheres by every rule; ``paper_20`` with 20 bins."""
    sections = _sections(1000, rng)
    for setting in settings:
        found, cost = run(lambda s=setting: _unfolded(sections, s))
        yield Trial(setting, "formula", {"grain_sizes": found}, cost)


def sections(settings: Sequence[str], rng: np.random.Generator, run: Run) -> Iterator[Trial]:
    """Radii unfolded from so many sections of lognormal spheres by the default rule."""
    radii = _sections(max(map(int, settings)), rng)
    for setting in settings:
        found, cost = run(lambda n=int(setting): _unfolded(radii[:n], "adaptive"))
        yield Trial(setting, "formula", {"grain_sizes": found}, cost)


TRUE_RADII = stats.lognorm(CV)


def _sections(n: int, rng: np.random.Generator) -> np.ndarray:
    """Radii of sections: spheres are cut in proportion to their radius, at a uniform distance of the centre.

    Weighing a lognormal distribution by the radius multiplies its median by exp(sigma^2).
    """
    cut = TRUE_RADII.rvs(n, random_state=rng) * np.exp(CV**2)
    return cut * np.sqrt(1 - rng.random(n) ** 2)


def _unfolded(radii: np.ndarray, setting: str) -> float:
    """Wasserstein distance of the unfolded radii to the true ones, over their mean."""
    method, _, bins = setting.partition("_")
    edges = np.linspace(0, 2 * radii.max(), int(bins) + 1) if bins else None
    sizes = stereology.unfold(radii, method=method, edges_um=edges)
    share = (np.arange(20_000) + 0.5) / 20_000
    which = "f2d" if method == "none" else "f3d"
    return relative_distance(sizes.quantile(share, which), TRUE_RADII.ppf(share))


def _cut(whole: np.ndarray, edge: int, corner: np.ndarray) -> np.ndarray:
    """A cube of a volume, its corner given in shares of the room that there is."""
    start = (corner * (np.array(whole.shape) - edge + 1)).astype(int)
    return whole[tuple(slice(s, s + edge) for s in start)]


def _against(
    reference: str, settings: Sequence[str], tried: Callable[[str], tuple[dict, Cost]]
) -> Iterator[Trial]:
    """Every setting against one of them, which has a cost and no error that could be told."""
    if reference not in settings:
        raise InputError(
            "accuracy_sweep.known",
            f"{reference} is not among {', '.join(settings)}",
            "name what the others are held against, too",
        )
    found = {setting: tried(setting) for setting in settings}
    held = found[reference][0]
    for setting, (value, cost) in found.items():
        errors = differences(value, held)
        yield Trial(
            setting, reference, errors if setting != reference else dict.fromkeys(errors, np.nan), cost
        )


KNOBS: dict[str, Callable[..., Iterator[Trial]]] = {
    "flow_tier": flow_tier,
    "network_method": network_method,
    "voxels_per_grain": voxels_per_grain,
    "coarsen": coarsen,
    "grains_across": grains_across,
    "realizations": realizations,
    "slices": slices,
    "stereology_rule": stereology_rule,
    "sections": sections,
}
"""Every knob of the analysis by its name in the config."""
