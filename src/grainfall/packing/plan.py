"""Which optional effects a twin's scene called for, why, and what each cost."""

from __future__ import annotations

from collections.abc import Mapping


def effects_plan(
    scene: Mapping, first: Mapping, spheres: Mapping, second: Mapping, correction: Mapping, cost_s: Mapping
) -> dict:
    """The plan of one twin, each effect with the measured reason behind it.

    Parameters
    ----------
    scene : mapping
        As :func:`plan_scene` gives it.
    first, second : mapping
        Reports of the two packings.
    spheres : mapping
        Whether virtual spheres were called for: ``called_for``, ``reason``.
    correction : mapping
        Report of the position scaling: ``applied``, ``reason``.
    cost_s : mapping
        Seconds of the jobs first_packing, virtual_spheres, second_packing and twin; a job that is not there
        was not timed.

    Returns
    -------
    dict
        Effect to ``on``, ``reason``, ``cost_s``; None where an effect has no cost of its own.
    """
    minerals = len(scene["phases"]) - 1
    excess = first["collision_excess"]
    return {
        "gravity_packing": {
            "on": True,
            "reason": f"{first['poured']} grains poured by {first['engine']}, {first['steps']} steps",
            "cost_s": cost_s.get("first_packing"),
        },
        "collision_shapes": {
            "on": True,
            "reason": f"{first['n_hulls']} grains collide as convex hulls, {first['n_decomposed']} as convex "
            f"parts, {first['n_spheres']} as spheres: on average {100 * excess:.1f} % larger than the grains "
            f"(hulls alone {100 * first['hull_excess']:.1f} %), porosity that true shapes would not leave",
            "cost_s": None,
        },
        "phase_mixing": {
            "on": minerals > 1,
            "reason": f"{minerals} minerals, mixed by volume quota" if minerals > 1 else "one mineral",
            "cost_s": None,
        },
        "virtual_spheres": {
            "on": bool(spheres["called_for"]),
            "reason": spheres["reason"],
            "cost_s": cost_s.get("second_packing") if spheres["called_for"] else 0.0,
        },
        "position_scaling": {
            "on": bool(correction["applied"]),
            "reason": correction["reason"],
            "cost_s": cost_s.get("twin") if correction["applied"] else 0.0,
        },
    }
