"""Optional effects: which of them a scene calls for, why, and what each cost or saved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from grainfall.packing.parameters import Parameters


def decide(switch: str, called_for: bool, reason: str, possible: bool = True) -> dict:
    """Whether an effect acts.

    Parameters
    ----------
    switch : {"auto", "on", "off"}
        What the config says.
    called_for : bool
        Whether the scene calls for it, as measured.
    reason : str
        The measurement behind that, as a clause.
    possible : bool
        Whether it has anything to act on: forced on where it has not, it does nothing.

    Returns
    -------
    dict
        on, forced, called_for, reason.
    """
    forced = switch != "auto"
    on = possible and (called_for if not forced else switch == "on")
    words = reason
    if switch == "off":
        words = f"switched off in the config, {'although ' if called_for else ''}{reason}"
    elif forced and not on:
        words = f"forced on in the config, with nothing to do: {reason}"
    elif forced and not called_for:
        words = f"forced on in the config, although {reason}"
    return {"on": bool(on), "forced": forced, "called_for": bool(called_for), "reason": words}


def effects_plan(
    shapes: Mapping,
    scene: Mapping,
    first: Mapping,
    deficit: Mapping,
    second: Mapping,
    scaling: Mapping,
    cement: Mapping,
) -> dict:
    """The plan of one twin, each effect with the measured reason behind it.

    Parameters
    ----------
    shapes : mapping
        As :func:`grainfall.stereology.own_shapes` gives it.
    scene : mapping
        As :func:`plan_scene` gives it.
    first, second : mapping
        Reports of the two packings.
    deficit : mapping
        As :func:`plan_deficit` gives it.
    scaling, cement : mapping
        Reports of the position scaling and of the cement.

    Returns
    -------
    dict
        Effect to ``on``, ``forced``, ``reason``, ``cost_s`` (what it took) and ``saved_s`` (an estimate of
        what it would have taken, where it was not needed); None where an effect has no cost of its own, or
        where there is nothing to estimate it from.

    Notes
    -----
    Estimates: a packing takes as long as the first one, a refined one (half the step) twice as long; a pass
    of scaling as long as its first voxelisation, cement two of them, compaction ten.
    """
    refinement = first["refinement"]
    once = first["wall_s"] - (refinement["cost_s"] or 0.0)
    voxelising = scaling["wall_s"] / scaling["passes"]
    passes = second["passes"]
    between = second["between"]
    lubricated = [one for one in passes if between is None and (one["lubrication"] < 1 or one["taps"])]
    spheres = [one for one in passes if one not in lubricated]
    return {
        "own_shapes": _entry(shapes),
        "gravity_packing": _entry(
            {"on": True, "forced": False},
            f"{first['poured']} grains poured by {first['engine']}, {first['steps']} steps",
            once,
        ),
        "decomposition": _entry(
            {"on": first["n_decomposed"] > 0, "forced": first["parameters"]["decomposition"] != "auto"},
            f"{first['n_hulls']} grains collide as convex hulls, {first['n_decomposed']} as convex parts, "
            f"{first['n_spheres']} as spheres: on average {100 * first['collision_excess']:.1f} % larger "
            f"than the grains (hulls alone {100 * first['hull_excess']:.1f} %), porosity that true shapes "
            "would not leave",
        ),
        "refinement": _entry(refinement, cost_s=refinement["cost_s"], saved_s=2 * once),
        "weight_limit": _weight_limit(first, second),
        "phase_mixing": _entry(scene["phase_mixing"]),
        "virtual_spheres": _entry(deficit["virtual_spheres"], cost_s=_seconds(spheres), saved_s=once),
        "void_shapes": _void_shapes(deficit["void_shapes"], second["voids"]),
        "densification": _entry(
            second["densification"],
            cost_s=_seconds(lubricated) if between is None else between["wall_s"],
            saved_s=once,
        ),
        "placement": _entry(second["placement"], saved_s=None),
        "position_scaling": _entry(
            {**scaling, "on": scaling["applied"]}, cost_s=scaling["wall_s"], saved_s=voxelising
        ),
        "compaction": _entry(
            cement["compaction"], cost_s=cement["compaction"]["wall_s"], saved_s=10 * voxelising
        ),
        "cement": _entry(cement, cost_s=cement["wall_s"], saved_s=2 * voxelising),
    }


def _weight_limit(first: Mapping, second: Mapping) -> dict:
    limit = first["parameters"]["heavy"]
    largest = max(first["largest"], second["largest"])
    return _entry(
        {"on": largest >= limit, "forced": limit != Parameters.heavy},
        f"the largest body has {largest:.2f} mean grain radii; from {limit:g} on, bodies weigh no more",
    )


def _void_shapes(shaped: Mapping, voids: Mapping | None) -> dict:
    if voids is None:
        return _entry(shaped)
    found = "no void lay in the region as a whole, so volumes were kept"
    if voids["width"] is not None:
        found = (
            f"voids came out {voids['width']:.3f} times as wide as spheres of their bodies' volumes, so "
            f"bodies were poured {voids['scale']:.3f} times as wide"
        )
    return _entry(shaped, f"{shaped['reason']}; {found}", voids["wall_s"])


def _seconds(passes: Iterable[Mapping]) -> float:
    return float(sum(one["wall_s"] for one in passes))


def _entry(
    effect: Mapping, reason: str | None = None, cost_s: float | None = None, saved_s: float | None = None
) -> dict:
    return {
        "on": bool(effect["on"]),
        "forced": bool(effect["forced"]),
        "reason": reason or effect["reason"],
        "cost_s": cost_s if effect["on"] else None,
        "saved_s": None if effect["on"] else saved_s,
    }
