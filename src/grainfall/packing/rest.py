"""Grains set free and left to themselves until they rest: how firm a packing really stands."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd

from grainfall.packing.bed import Bed
from grainfall.packing.parameters import Parameters

WINDOW = 300
"""Steps over which a bed's drift is judged."""

AT_REST = 1e-3
"""Mean way of a body in a window, mean grain radii, below which a bed rests."""


def settle(
    bodies: pd.DataFrame,
    library,
    box,
    parameters: Parameters,
    *,
    windows: int | None = None,
    rest: float = AT_REST,
    every: bool = True,
    taps: int = 0,
    progress: Callable[[str], None] | None = None,
) -> tuple[pd.DataFrame, dict]:
    """All bodies set free where they are, under gravity, until they rest again.

    Bodies that lie deep in others, which rigid ones cannot, fall from above them instead (:func:`part`).

    Parameters
    ----------
    bodies : DataFrame
        Columns of bodies.csv, um from the corner of the region of interest.
    library : grainfall.grains.Library
    box : grainfall.packing.Box
    parameters : Parameters
    windows : int, optional
        Most windows of :data:`WINDOW` steps; ``parameters.rest_windows`` if omitted.
    rest : float
        Mean way of a body in a window, mean grain radii, below which the bed rests.
    every : bool
        Whether each single body must be asleep as well.
    taps : int
        Times that the bed is shaken first.
    progress : callable, optional
        Called with a line of text.

    Returns
    -------
    bodies : DataFrame
        The same bodies (ids as given) where they came to rest.
    report : dict
        As :func:`relax` gives it, with ``moved_mean`` and ``moved_max`` (mean grain radii), ``max_overlap``,
        ``mean_overlap``, ``escaped``, ``wall_s``, and ``forces`` (a DataFrame of ids a < b and force_n).
    """
    started = time.perf_counter()
    bed = Bed.of(bodies, library, box, parameters)
    part(bed)
    before = bed.position.copy()
    for i in range(taps):
        shake(bed)
        if progress:
            progress(f"tapped {i + 1} of {taps} times")
    report = relax(bed, windows=windows, rest=rest, every=every, progress=progress)
    moved = np.linalg.norm(bed.position - before, axis=1)
    table = bed.table(report.pop("asleep_each"))
    table["id"] = bodies["id"].to_numpy()
    forces = report["forces"]
    forces[["a", "b"]] = bodies["id"].to_numpy()[forces[["a", "b"]].to_numpy(int)]
    overlap = bed.overlaps()
    return table, {
        **report,
        "moved_mean": float(moved.mean()) if len(moved) else 0.0,
        "moved_max": float(moved.max(initial=0.0)),
        "max_overlap": overlap[0],
        "mean_overlap": overlap[1],
        "escaped": bed.escaped(),
        "wall_s": time.perf_counter() - started,
    }


def moved_share(before: pd.DataFrame, after: pd.DataFrame, limit: float = 0.1) -> float:
    """Share of bodies (same rows) whose way is longer than ``limit`` of their own radius."""
    way = np.linalg.norm(after[["x", "y", "z"]].to_numpy() - before[["x", "y", "z"]].to_numpy(), axis=1)
    return float((way > limit * before["scale"].to_numpy()).mean())


RESETTLED = 0.01
"""Drift, as :data:`AT_REST`, of a skeleton that fell when its virtual spheres left it: a bed of 25 radii that
settles by another 0.01 of them changes its porosity by 0.0003."""


def part(bed: Bed) -> None:
    """Lift bodies that lie deep in others out of the bed, onto a grid of places above it.

    A solver would throw them apart at a speed of depth over step. Of two bodies the later one is lifted.
    """
    lifted = np.zeros(len(bed), bool)
    for a, b in bed.deep_pairs(DEEP):
        lifted[b] |= not lifted[a]
    ids = np.flatnonzero(lifted)
    if not len(ids):
        return
    cell = 2.02 * bed.bound[ids].max()
    across = np.maximum(1, bed.sides // cell).astype(int)
    top = max(0.0, (bed.position[~lifted, 2] + bed.bound[~lifted]).max(initial=0.0))
    layer, place = np.divmod(np.arange(len(ids)), across.prod())
    bed.position[ids, :2] = (
        (np.column_stack([place // across[1], place % across[1]]) + 0.5) * bed.sides / across
    )
    bed.position[ids, 2] = top + (layer + 0.5) * cell


DEEP = 0.1
"""Depth of penetration, radii of the smaller body, of bodies that :func:`part` takes apart."""


def relax(
    bed: Bed,
    *,
    windows: int | None = None,
    rest: float = AT_REST,
    every: bool = True,
    progress: Callable[[str], None] | None = None,
) -> dict:
    """Let a bed come to rest with all its bodies free, in finer steps than it was poured in.

    A solver's residual velocity is about g dt / 2, so a grain that should rest wanders by a share of
    g dt^2 / 2 a step: half the step leaves a quarter of that (a tenth of it would drown in single precision).
    Contact points are found anew in each step, since points kept from step to step let a bed creep, the
    faster the smaller the step is (``make bench-creep``). Motion is damped while the bed settles, and not in
    the last window, over which drift, force balance and energy are judged.

    A few grains go on for long while the bed about them rests. They and their neighbours are moved on alone,
    the others fixed, before all are set free again: otherwise the more grains there are, the longer all of
    them wait for the last one. That is no help where a whole bed creeps: set free, it sags anew, until its
    windows are used up. Whatever still moves then comes to rest among the others as they are.

    Parameters
    ----------
    bed : Bed
        Left where it came to rest, without an engine.
    windows : int, optional
        Most windows of :data:`WINDOW` steps of all bodies; ``bed.parameters.rest_windows`` if omitted.
    rest : float
        Mean way of a body in a window, mean grain radii, below which the bed rests.
    every : bool
        Whether each single body must be asleep in the end: of thousands set free together, some few always
        roll on. They come to rest among the others as those are, which costs most of the steps.
    progress : callable, optional
        Called with a line of text.

    Returns
    -------
    dict
        steps; at_rest; drift_mean, drift_p99 and drift_max (way of a body in the last window of all, mean
        grain radii); net_force (mean net force on a body over its weight: momentum gained in that window);
        net_force_contacts (the same from the engine's contact forces where those are complete, else None);
        energy_rise (largest rise of total mechanical energy above its lowest so far, over the total);
        asleep_each (bool, per body, in the last window in which it was free); forces (DataFrame: a, b,
        force_n).
    """
    given = bed.parameters
    fine = replace(given, dt=given.dt * REFINEMENT, contact_manifold="full")
    windows = given.rest_windows if windows is None else windows
    bed.close()  # the engine that poured has other steps than these
    bed.velocity[:] = bed.spin[:] = 0.0
    energy: list[float] = []
    steps = 0

    def window(free: np.ndarray, damping: float) -> np.ndarray:
        """Way of each body over one window in which these are free."""
        nonlocal steps
        if bed.engine is None or (bed.fixed == free).any():
            bed.fixed = ~free
            bed.start(fine)
        bed.engine.damp(given.linear_damping + damping / fine.dt, given.angular_damping + damping / fine.dt)
        before = bed.position.copy()
        energy.append(bed.energy())
        for _ in range(10):
            bed.engine.step(WINDOW // 10)
            bed.read()
            energy.append(bed.energy())
        steps += WINDOW
        way = np.linalg.norm(bed.position - before, axis=1)
        if progress:
            moving = f"{np.count_nonzero(~asleep(way))} of {len(bed)} bodies move"
            progress(f"coming to rest, step {steps}: {moving}, mean drift {way.mean():.2g} radii")
        return way

    def asleep(way: np.ndarray) -> np.ndarray:
        return way < given.sleep_speed * WINDOW * fine.dt

    everybody = np.ones(len(bed), bool)
    spent = 0.0  # windows of all bodies
    quiet = False
    draws = PATIENCE
    while True:
        judged = quiet or spent >= windows - 1
        _draw_apart(bed, fine)
        velocity = bed.velocity.copy()
        way = window(everybody, 0.0 if judged else DAMPING)
        spent += 1
        gained = np.linalg.norm(bed.velocity - velocity, axis=1) / (WINDOW * fine.dt)
        awake = ~asleep(way)
        ended = judged and (way.mean() < rest or spent >= windows)
        quiet = way[~awake].sum() < rest * len(bed)
        restless = awake & every
        while True:
            if ended and draws:
                drawn = _draw_apart(bed, fine)
                restless = restless | drawn
                draws -= drawn.any()
            if not restless.any() or spent >= PATIENCE * windows:
                break
            free = bed.around(restless)
            if not (ended or quiet) and free.mean() > FEW:
                break
            spent += free.mean()
            awake = restless = ~asleep(window(free, ALONE))
        if ended:
            break
    lowest = np.minimum.accumulate(energy)
    report = {
        "steps": steps,
        "at_rest": bool(way.mean() < rest and not (every and awake.any())),
        "drift_mean": float(way.mean()),
        "drift_p99": float(np.quantile(way, 0.99)),
        "drift_max": float(way.max()),
        "net_force": float(gained.mean() / fine.gravity),
        "net_force_contacts": None,
        "energy_rise": float((energy - lowest).max() / abs(energy[-1])),
        "asleep_each": ~awake,
    }
    if bed.engine is None or bed.fixed.any():
        bed.fixed[:] = False
        bed.start(fine)
        bed.engine.step(WINDOW // 10)
    report |= _balance(bed)
    bed.close()
    bed.parameters = given
    return report


REFINEMENT = 0.5
"""Step of the relaxation over that of the pouring."""


def _draw_apart(bed: Bed, parameters: Parameters) -> np.ndarray:
    """Separate bodies that lie in each other unseen; which they were, and those about them (mask).

    PhysX's narrow phase goes by what it found in the step before, and at times overlooks two hulls of many
    facets until they are a tenth of a radius deep in each other. A new engine sees them in its first step,
    and needs no others than those about them: among ten thousand bodies there is nearly always such a pair.
    """
    free = bed.around(bed.around(_overlooked(bed)))  # those next to them have to make room
    if free.any():
        ids = np.flatnonzero(bed.around(free))
        few = bed.some(ids)
        few.fixed = ~free[ids]
        for _ in range(TRIES):
            few.start(parameters)
            few.engine.step(1)
            few.read()
            if not _overlooked(few).any():
                break
        few.close()
        bed.take(ids, few)
    return free


def _overlooked(bed: Bed) -> np.ndarray:
    """Bodies (mask) that lie in others, though PhysX should not have let them."""
    found = np.zeros(len(bed), bool)
    if bed.parameters.engine == "physx":
        found[bed.deep_pairs(UNSEEN)] = True
    return found


UNSEEN, TRIES = 0.01, 40
"""Depth, radii of the smaller body, from which a pair is drawn apart, and the most steps taken for it."""

FEW = 0.1
"""Share of bodies, neighbours counted, that are moved on alone also while the others do not rest yet."""

PATIENCE = 4
"""Times the windows that a bed is given at most, those of a few bodies counted by their share of all, and the
times that pairs are drawn apart in the end."""

DAMPING, ALONE = 0.02, 0.005
"""Share of its speed that a body loses in a step of the relaxation: with all others, or while those that rest
are fixed. What is left then has a way to fall or to roll: damped as much it would go it as in syrup."""


def _balance(bed: Bed, steps: int = 20) -> dict:
    """Contact forces, means over some steps, and how well they carry the grains."""
    n = len(bed)
    total, sums, known = np.zeros((n + 1, 3)), [], True
    for _ in range(steps):
        bed.engine.step(1)
        found = bed.engine.contacts()
        known = found.friction_known
        np.add.at(total, found.pairs[:, 0], found.vector)
        np.add.at(total, found.pairs[:, 1], -found.vector)
        sums.append(bed.forces(found))
    forces = pd.concat(sums).groupby(["a", "b"], as_index=False)["force_n"].sum()
    forces["force_n"] /= steps
    net = total[:n] / steps
    weight = bed.mass * bed.parameters.gravity
    net[:, 2] -= weight
    complete = known or bed.parameters.friction_dynamic == bed.parameters.friction_static == 0
    share = float((np.linalg.norm(net, axis=1) / weight).mean())
    return {"forces": forces, "net_force_contacts": share if complete else None}


def shake(bed: Bed) -> None:
    """One tap: the bed is thrown up by a tenth of a mean grain radius and falls back."""
    bed.fixed[:] = False
    bed.velocity[:] = bed.spin[:] = 0.0
    speed = (2 * bed.parameters.gravity * TAP_HEIGHT) ** 0.5
    bed.velocity[:, 2] = speed
    bed.start()
    flight = 2 * speed / bed.parameters.gravity
    bed.engine.step(int(np.ceil(2 * flight / bed.parameters.dt)) + 50)
    bed.read()
    bed.close()


TAP_HEIGHT = 0.1
"""Height of a tap, mean grain radii."""
