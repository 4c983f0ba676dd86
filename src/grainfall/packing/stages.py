"""The two packings of a twin: grains alone, then whatever brings them to the section's porosity and pores."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from grainfall.errors import InputError
from grainfall.grains import Library
from grainfall.packing.densify import match_density
from grainfall.packing.deposition import Box, Packing, deposit, solid_fraction
from grainfall.packing.mixing import Mixture, draw_zones
from grainfall.packing.overgrowth import STANDARD_ERRORS
from grainfall.packing.parameters import Parameters
from grainfall.packing.placement import Place
from grainfall.packing.plan import decide
from grainfall.packing.rest import settle
from grainfall.packing.trials import Trials
from grainfall.packing.virtual import VirtualSizes, match_porosity
from grainfall.packing.voids import match_between, odds_times, smallest_void
from grainfall.stereology import SizeDistribution

RESTED = (
    "steps",
    "at_rest",
    "drift_mean",
    "drift_p99",
    "drift_max",
    "net_force",
    "net_force_contacts",
    "energy_rise",
)
"""What a packing's report says of its rest, of what :func:`grainfall.packing.rest.relax` finds."""

MOST_OVERLAP = 0.02
"""Overlap, of the smaller radius, above which the solver is too coarse for the scene."""


def parameters_of(packing: Mapping, effects: Mapping) -> Parameters:
    """The parameters that the config's ``packing`` and ``effects`` ask for."""
    return Parameters.named(
        packing["parameters"],
        engine=packing["engine"],
        decomposition=effects["decomposition"],
        **packing["overrides"],
    )


def box_of(scene: Mapping) -> Box:
    """The container of a scene."""
    return Box((scene["edge_um"],) * 3, scene["margin_um"])


def pack(
    scene: Mapping,
    sizes: Mapping[tuple[int, str], SizeDistribution],
    library: Library,
    parameters: Parameters,
    rng: np.random.Generator,
    *,
    spheres: VirtualSizes | None = None,
    p_sphere: float = 0.0,
    void_shapes: bool = False,
    void_scale: float = 1.0,
    rest: bool = True,
    progress: Callable[[str], None] | None = None,
    checkpoints: Path | None = None,
) -> Packing:
    """Draw the bodies of a scene and pour them.

    Parameters
    ----------
    scene : mapping
        As :func:`grainfall.packing.plan_scene` gives it.
    sizes : mapping of (phase, kind) to SizeDistribution
    library : Library
    parameters : Parameters
    rng : numpy.random.Generator
    spheres : VirtualSizes, optional
        Sizes of virtual spheres poured among the grains.
    p_sphere : float
        Probability that the next body is one of them.
    void_shapes : bool
        Whether those as large as the voids of the library take their shapes.
    void_scale : float
        Radius (of equal volume) of such a body over that of its sphere: see :func:`size_voids`.
    rest : bool
        Whether they are set free at the end until they rest; :func:`let_rest` does it later.
    progress : callable, optional
        Called with a line of text as the bed grows.
    checkpoints : Path, optional
        Folder of the states from which a killed packing resumes.

    Returns
    -------
    bodies : DataFrame
        Columns of bodies.csv, um from the corner of the region of interest.
    report : dict
        Content of packing.json, and ``forces``: a DataFrame of normal forces between bodies, a, b (ids) and
        force_n.

    Raises
    ------
    InputError
        When pouring ended before the bed covered the region of interest.
    """
    mixture = Mixture(
        {n: sizes[n, "grain"] for n in range(1, len(scene["phases"]))},
        dict(enumerate(scene["fractions"], start=1)),
        scene["sizes_from"],
        spheres if p_sphere > 0 else None,
        p_sphere,
        smallest_void(library) if void_shapes else np.inf,
        void_scale,
    )
    box = box_of(scene)
    share = scene["edge_um"] ** 2 / np.prod(box.sides_um)
    population = draw_zones(mixture, library, box.solid_um3(), share, rng)

    bodies = deposit(population, library, box, parameters, rng, progress, checkpoints, rest=rest)
    report = {**bodies.attrs.pop("report"), "p_sp": float(p_sphere)}
    if report["surface_um"] < scene["edge_um"]:
        raise InputError(
            "packing",
            f"the bed ends {report['surface_um']:.4g} um high in a region of {scene['edge_um']:.4g} um: "
            + "; ".join(report["notes"]),
            "more packing.overrides.max_idle_steps, or a faster sleep_speed",
        )
    report["forces"] = pd.DataFrame(bodies.attrs.pop("forces"))
    return bodies, report


def let_rest(
    packing: Packing,
    scene: Mapping,
    library: Library,
    parameters: Parameters,
    taps: int = 0,
    *,
    progress: Callable[[str], None] | None = None,
) -> Packing:
    """A packing of :func:`pack`, tapped so many times and set free until it rests.

    Parameters
    ----------
    packing : (bodies, report)
        Left as it is.
    scene, library, parameters, progress
        Those it was packed with.
    taps : int

    Returns
    -------
    bodies : DataFrame
    report : dict
        That of the packing with its rest, forces, overlaps and solid fraction; ``wall_s`` of both. The height
        of the surface is that of the bed as poured.
    """
    bodies, report = packing
    bodies, found = settle(bodies, library, box_of(scene), parameters, taps=taps, progress=progress)
    return bodies, {
        **report,
        "rest": {k: found[k] for k in RESTED},
        "settled": found["moved_mean"],
        "solid_fraction": solid_fraction(bodies, box_of(scene)),
        "asleep": int(bodies["asleep"].sum()),
        "wall_s": report["wall_s"] + found["wall_s"],
        **{k: found[k] for k in ("forces", "escaped", "max_overlap", "mean_overlap")},
    }


def pack_first(
    pack_with: Callable[[Parameters], Packing],
    parameters: Parameters,
    switch: str,
    progress: Callable[[str], None] | None = None,
) -> Packing:
    """The first packing, repeated with a finer solver where grains came to rest too deep in each other.

    Parameters
    ----------
    pack_with : callable
        Parameters to (bodies, report), with the same random numbers each time.
    parameters : Parameters
    switch : {"auto", "on", "off"}
        Of the refinement.
    progress : callable, optional
        Called with a line of text before all is poured again.

    Returns
    -------
    bodies : DataFrame
    report : dict
        That of the packing kept, ``wall_s`` of both, with ``refinement``: on, forced, reason, cost_s.
    """
    bodies, report = pack_with(parameters)
    overlap = report["max_overlap"]
    words = "exceeds" if overlap > MOST_OVERLAP else "is within"
    refinement = decide(
        switch,
        overlap > MOST_OVERLAP,
        f"the largest overlap of the collision shapes, {overlap:.4f} of the smaller radius, {words} "
        f"{MOST_OVERLAP:g}",
    ) | {"cost_s": None}
    if refinement["on"]:
        coarse_s = report["wall_s"]
        if progress:
            progress(f"poured again with half the time step: {refinement['reason']}")
        bodies, report = pack_with(parameters.refined())
        refinement["cost_s"] = report["wall_s"]
        refinement["reason"] += (
            f"; with half the time step and twice the solver iterations it is {report['max_overlap']:.4f}"
        )
        report = {**report, "wall_s": coarse_s + report["wall_s"]}
    return bodies, {**report, "refinement": refinement}


def pack_again(
    deficit: Mapping,
    pour_with: Callable[[float, float], Packing],
    rested: Callable[[Packing, float, int], Packing],
    porosity_of: Callable[[pd.DataFrame], float],
    first: Packing,
    between_of: Callable[[pd.DataFrame], float | None] = lambda grains: None,
    *,
    voids: Mapping | None = None,
    place_of: Callable[[pd.DataFrame, float], Place] | None = None,
    densification: str = "auto",
    placement: str = "auto",
    limit: float = 0.01,
    passes: int = 8,
) -> Packing:
    """The second packing: virtual spheres, then densification, until the grains' porosity is what is wanted:
    the target's, or what leaves room for the rims of grains grown together.

    Where the spheres hold voids open that the section has, grains are first lubricated until they lie as
    densely between them as the section's do (:func:`match_between`).

    Of one share of spheres, beds differ in how many of them the region has, not in how much grains and
    spheres fill of it. So where the porosity misses in the middle of the bed, the region is moved to where it
    does not, if that is near enough.

    Parameters
    ----------
    deficit : mapping
        As :func:`plan_deficit` gives it.
    pour_with : callable
        (probability of a sphere, factor on friction) to (bodies, report) as poured, with the same random
        numbers each time.
    rested : callable
        (such a packing, factor on friction, taps) to the same, tapped so many times and come to rest.
    porosity_of : callable
        Grains alone to their porosity.
    first : (bodies, report)
        The first packing; it is the second where nothing is called for.
    between_of : callable, optional
        Grains to their porosity between voids; None where that cannot be told.
    voids : mapping, optional
        As :func:`size_voids` gives it, where bodies have the shapes of voids.
    place_of : callable, optional
        (grains alone, porosity) to the place near the middle where a region is nearest that
        (:func:`nearest_place`).
    placement : {"auto", "on", "off"}
        Whether the region is moved there: auto where it misses in the middle and not there.
    densification : {"auto", "on", "off"}
        auto where the target is below what the grains pour to, or grains between voids lie looser than the
        section's.
    limit : float
        Distance from the target that ends the passes.
    passes : int
        Most packings tried by the feedback of either effect.

    Returns
    -------
    bodies : DataFrame
    report : dict
        That of the packing kept (solid_fraction and surface_um of the middle), with ``passes`` (p_sphere,
        lubrication, taps, porosity, moved_um, at_rest, wall_s of each; one that misses as poured is not
        brought to rest), ``porosity``, ``reached``, ``reason`` (why not), ``placement``: on, forced,
        called_for, reason, moved_um (the bodies are counted from the corner of the region where it lies),
        ``densification``: on, forced, called_for, reason, too_loose (whether the grains were, not what their
        spheres opened), and ``between``: None, or what :func:`match_between` gives, with ``came_to``:
        porosity between voids of the packing kept.
    """
    target, spheres = deficit["overgrowth"]["porosity"], deficit["virtual_spheres"]
    aim = f"{'porosity' if deficit['overgrowth']['on'] else 'target porosity'} {target:.4f}"
    aim += " before the rims" if deficit["overgrowth"]["on"] else ""
    # Spheres that were to open the bed and opened it too far are a missed feedback, not a bed too loose.
    fillable = spheres["for_tail"] or not spheres["on"]
    trials = Trials(pour_with, rested, porosity_of, place_of, placement, target, limit, fillable)
    missed, dense, between, lubrication = "", None, None, 1.0
    if spheres["on"]:
        p_sphere, loose = spheres["p_sp"], deficit["porosity_first"]
        if deficit["between"] is not None:
            dense, between = _denser_between(deficit, trials, between_of, voids, densification)
        if between is not None:
            p_sphere, lubrication = between["p_sp"], between["lubrication"]
        if spheres["for_tail"]:
            loose = trials(p_sphere)
        left = passes - len(trials.passes)
        if left and (loose < target - limit or not spheres["for_tail"]):
            guess = odds_times(p_sphere, 2) if trials.passes else p_sphere
            missed = match_porosity(
                lambda p: trials(p, lubrication), target, guess, deficit["porosity_first"], limit, left
            )
            p_sphere, loose = trials.kept[0], trials.porosity
    else:
        p_sphere, loose = 0.0, deficit["porosity_first"]
        trials.keep(first, Place.unmoved(loose), at_rest=True, made_with=(0.0, 1.0))
    too_loose = loose - target if fillable else 0.0
    what = "with its virtual spheres" if spheres["on"] else "of grains alone"
    if too_loose > 0 or loose - target > limit:
        reason = f"the {aim} is below the {loose:.4f} of the packing {what}"
        reason += "" if fillable else ", which they opened, not its grains"
    else:
        reason = f"the packing {what} is no looser than the {aim}"
    if dense is None:
        dense = decide(densification, too_loose > limit, reason, possible=too_loose > 0)
    if dense["on"] and between is None:
        missed = match_density(
            lambda lubrication, taps: trials(p_sphere, lubrication, taps), loose, target, limit, passes
        )
        dense["reason"] += f"; {missed}" if missed else ""
    bodies, report = trials.best()
    if between is not None:
        between["came_to"] = between_of(bodies[bodies["kind"] == "grain"])
        dense["reason"] += f"; with friction times {lubrication:.2g}"
        dense["reason"] += "" if between["came_to"] is None else f" it is {between['came_to']:.3f} porous"
    dense["too_loose"] = bool(too_loose > limit)
    reached = abs(trials.porosity - target) <= limit
    return bodies, {
        **report,
        "passes": trials.passes,
        "porosity": trials.porosity,
        "reached": reached,
        "reason": "" if reached else (missed or dense["reason"]) + trials.words,
        "placement": trials.placement(),
        "densification": dense,
        "between": between,
    }


def _denser_between(
    deficit: Mapping,
    trials: Trials,
    between_of: Callable[[pd.DataFrame], float | None],
    voids: Mapping | None,
    switch: str,
) -> tuple[dict, dict | None]:
    """Whether grains are to lie denser between voids, and with what friction they do."""
    held, rough, wall_s = deficit["between"], voids, 0.0
    if rough is None:
        bodies, report = trials.pour(deficit["virtual_spheres"]["p_sp"])
        rough = {
            "filled": float(trials.porosity_of(bodies)),
            "between": between_of(bodies[bodies["kind"] == "grain"]),
            "volume_um3": deficit["mean_sphere_volume_um3"],
        }
        wall_s = report["wall_s"]
    if rough["between"] is None:
        return decide(switch, False, "nothing of the region lies between voids", possible=False), None
    exceeds = rough["between"] - held["wanted"] > STANDARD_ERRORS * held["error"]
    before = f", {held['wanted']:.3f} before the rims," if deficit["overgrowth"]["on"] else ""
    dense = decide(
        switch,
        exceeds,
        f"between voids the packing with its virtual spheres is {rough['between']:.3f} porous, which "
        f"{'exceeds' if exceeds else 'does not exceed'} the section's {held['porosity']:.3f}{before} beyond "
        "the section's sampling",
        possible=rough["between"] > held["wanted"],
    )
    if not dense["on"]:
        return dense, None
    found = match_between(deficit, rough, trials.pour, trials.porosity_of, between_of)
    return dense, {**found, "wall_s": wall_s + found["wall_s"]}
