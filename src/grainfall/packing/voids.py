"""Bodies that hold the section's voids open, and the grains between them: how large, how many, how dense."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

from grainfall.grains import VOID, Library
from grainfall.packing.densify import SLICK
from grainfall.packing.deposition import Packing
from grainfall.packing.mixing import Mixture
from grainfall.packing.virtual import EMPTY, VirtualSizes, sphere_probability


def smallest_void(library: Library) -> float:
    """Radius (um) from which a virtual body takes the shape of a void of the library."""
    return float(library.table.loc[library.table["phase"] == VOID, "r2d_um"].min())


def mean_void_volume(spheres: VirtualSizes, library: Library, void_scale: float) -> float:
    """Mean volume (um^3) of the virtual bodies, of which those in the shapes of voids are so scaled.

    Parameters
    ----------
    spheres : VirtualSizes
    library : Library
        With shapes of voids: spheres smaller than all of these stay spheres, and as large as they are.
    void_scale : float
        As :func:`pack` takes it.
    """
    return Mixture(
        {}, {}, spheres=spheres, void_from_um=smallest_void(library), void_scale=void_scale
    ).mean_sphere_volume


def size_voids(
    deficit: Mapping,
    pour: Callable[[float], Packing],
    width_of: Callable[[pd.DataFrame], float | None],
    volume_of: Callable[[float], float],
    porosity_of: Callable[[pd.DataFrame], float],
    between_of: Callable[[pd.DataFrame], float | None] = lambda bodies: None,
) -> dict:
    """How large to pour bodies in the shapes of voids, for voids as wide as their spheres were to be.

    Grains touch such a body here and there and leave gaps between, so the void that it leaves is wider than a
    sphere of its volume. Radii are those of voids whose circles are as wide as a sphere's in the mean: it is
    the circles on sections that have to agree. They are found on a packing of bodies with the volumes of the
    spheres; bodies are then poured smaller by the width found.

    As many are poured as :func:`sphere_probability` says, with what grains and bodies together fill of that
    packing in place of what grains alone do. Beds of one share of bodies differ in how many of them the
    region has, a tenth of all with a hundred of them, and hardly in how much is filled, so the porosity of
    the grains alone would tell less.

    Parameters
    ----------
    deficit : mapping
        As :func:`plan_deficit` gives it.
    pour : callable
        Probability of a sphere to (bodies, report) as poured, with volumes kept.
    width_of : callable
        Bodies to the width of their voids over that of their spheres (:func:`grainfall.volume.void_width`).
    volume_of : callable
        Scale to the mean volume of a virtual body (:func:`mean_void_volume`).
    porosity_of : callable
        Bodies to the porosity that is left beside them.
    between_of : callable, optional
        Bodies to their grains' porosity between voids.

    Returns
    -------
    dict
        width (None where no void could be measured), scale (1 / width), volume_um3 (mean volume of a body so
        scaled), p_sp (next guess of the probability; the share is kept where the large pores alone call for
        bodies), and of that packing filled (porosity beside grains and bodies), between (porosity between
        voids, or None) and wall_s.
    """
    bodies, report = pour(deficit["virtual_spheres"]["p_sp"])
    width = width_of(bodies)
    scale = 1.0 if width is None else 1.0 / width
    filled, volume = float(porosity_of(bodies)), volume_of(scale)
    p_sp = odds_times(deficit["virtual_spheres"]["p_sp"], volume_of(1.0) / volume)
    if not deficit["virtual_spheres"]["for_tail"]:
        p_sp = _share(deficit, filled, volume, p_sp)
    return {
        "width": width,
        "scale": scale,
        "volume_um3": volume,
        "p_sp": p_sp,
        "filled": filled,
        "between": between_of(bodies),
        "wall_s": report["wall_s"],
    }


FRICTIONS = 3
"""Beds tried at most between full friction and the least."""


def match_between(
    deficit: Mapping,
    rough: Mapping,
    pour: Callable[[float, float], Packing],
    porosity_of: Callable[[pd.DataFrame], float],
    between_of: Callable[[pd.DataFrame], float | None],
) -> dict:
    """Friction at which grains lie as densely between the voids as the section's do.

    Virtual spheres loosen the grains about them. Where the porosity is met, a bed that is too loose between
    its voids has too few of them:

        1 - phi = (1 - v) (1 - phi_between)

    for void share v. A bed is poured with as little friction as lubrication allows and as many spheres more
    as v has to grow, and the factor on friction is interpolated between the two: porosity goes about with the
    logarithm of friction, and so does what grains and spheres fill together, which tells how many spheres the
    target then takes (:func:`sphere_probability`). What is found there takes the place of one of the two,
    until it is what the section's is known to: bodies poured smaller are more, and loosen a bed further. Beds
    scatter about as much as that, so the best of :data:`FRICTIONS` has to do.

    Parameters
    ----------
    deficit : mapping
        As :func:`plan_deficit` gives it.
    rough : mapping
        Of a bed of ``p_sp`` at full friction: filled (porosity beside grains and spheres), between (porosity
        between voids), volume_um3 (mean volume of a sphere).
    pour : callable
        (probability of a sphere, factor on friction) to (bodies, report) as poured.
    porosity_of : callable
        Bodies to the porosity that is left beside them.
    between_of : callable
        Grains alone to their porosity between voids.

    Returns
    -------
    dict
        lubrication (factor on friction), p_sp (next guess of the probability), rough and slick (porosity
        between voids with full and with the least friction), tries (lubrication, p_sp and between of the beds
        between those), wall_s (of all beds but the last try where that is the best: it is then the first pass
        of what follows).
    """
    wanted, p_sp = deficit["between"]["wanted"], deficit["virtual_spheres"]["p_sp"]
    held, needed = (
        1 - (1 - deficit["overgrowth"]["porosity"]) / (1 - min(matrix, EMPTY))
        for matrix in (rough["between"], wanted)
    )
    p_sp = odds_times(p_sp, needed / held if held > 0 and needed > 0 else 1.0)
    bodies, report = pour(p_sp, SLICK)
    slick, filled = between_of(bodies[bodies["kind"] == "grain"]), float(porosity_of(bodies))
    found = {"rough": float(rough["between"]), "slick": slick, "tries": []}
    wall_s = report["wall_s"]
    if slick is None or slick >= wanted:
        p_sp = _share(deficit, filled, rough["volume_um3"], p_sp)
        return found | {"lubrication": SLICK, "p_sp": p_sp, "wall_s": wall_s}
    looser, denser = (0.0, rough["between"], rough["filled"]), (1.0, slick, filled)
    for _ in range(FRICTIONS):
        share = (looser[1] - wanted) / (looser[1] - denser[1])
        way, filled = (a + share * (b - a) for a, b in zip(looser[::2], denser[::2], strict=True))
        lubrication, p_sp = float(SLICK**way), _share(deficit, filled, rough["volume_um3"], p_sp)
        wall_s += report["wall_s"] if found["tries"] else 0.0
        bodies, report = pour(p_sp, lubrication)
        between = between_of(bodies[bodies["kind"] == "grain"])
        found["tries"].append({"lubrication": lubrication, "p_sp": p_sp, "between": between})
        if between is None or abs(between - wanted) <= deficit["between"]["error"]:
            break
        there = way, between, float(porosity_of(bodies))
        looser, denser = (there, denser) if between > wanted else (looser, there)
    best = min(
        found["tries"], key=lambda one: np.inf if one["between"] is None else abs(one["between"] - wanted)
    )
    wall_s += 0.0 if best is found["tries"][-1] else report["wall_s"]
    return found | {"lubrication": best["lubrication"], "p_sp": best["p_sp"], "wall_s": wall_s}


def _share(deficit: Mapping, filled: float, volume_um3: float, otherwise: float) -> float:
    """Probability of a body of this mean volume, where grains and bodies leave a porosity beside them."""
    wanted = deficit["overgrowth"]["porosity"]
    if not 0 < filled < wanted:
        return otherwise
    return sphere_probability(wanted, filled, volume_um3, deficit["mean_grain_volume_um3"])


def odds_times(p: float, factor: float) -> float:
    """The probability whose odds are so many times those of another."""
    odds = p / (1 - p) * factor
    return odds / (1 + odds)
