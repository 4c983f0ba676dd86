"""Densification: a bed poured with lubricated grains, then tapped, until it is as dense as the target."""

from __future__ import annotations

from collections.abc import Callable
from math import log2

SLICK = 0.1
"""Least factor on friction: without any, grains hardly come to rest while others are poured upon them, and a
bed of 300 took eight times as long as at full friction."""

FIRST_TAPS = 8
"""Taps of the first tapped packing, doubled in each further one: compaction goes with their logarithm."""

MOST_TAPS = 32
"""Taps of the last one, which four passes come to. Each doubling takes as long as all before it: sixteen took
a bed of Berea eight times as long as to pour it. More passes are for lubrication and spheres."""


def match_density(
    porosity_with: Callable[[float, int], float],
    loose: float,
    target: float,
    tolerance: float = 0.01,
    max_passes: int = 4,
) -> str:
    """Feedback on lubrication, then on taps, until the porosity is within the tolerance of the target.

    Friction holds a bed open, so its coefficients are multiplied by a factor in [:data:`SLICK`, 1],
    ``lubrication``. The first pass has as little friction as that: it tells whether lubrication suffices.
    If so, the factor is bracketed by that pass and the loose packing and found by regula falsi in its
    logarithm, with which porosity goes about linearly; if not, the slick bed is tapped, twice as often in
    each pass up to :data:`MOST_TAPS`, as long as what the last one gained with a doubling of its taps would
    do if each of those left gained as much. The aim is a quarter of the tolerance above the target, because
    contracting positions is a gentler correction than pulling grains apart.

    Parameters
    ----------
    porosity_with : callable
        (lubrication, taps) -> porosity. Packings of one seed are paired, so it falls with either.
    loose : float
        Porosity with full friction and no taps, above the target.
    target : float
        Porosity wanted.
    tolerance : float
        Largest ``|porosity - target|`` that ends the passes.
    max_passes : int
        At most so many packings.

    Returns
    -------
    str
        Plain words where the target was not met; empty otherwise.
    """
    aim = target + tolerance / 4
    found = porosity_with(SLICK, 0)
    nearest, left = found, max_passes - 1
    if found < target - tolerance:
        slick, rough = (SLICK, found), (1.0, loose)
        while left and abs(nearest - target) > tolerance:
            # kept off the ends, so that the bracket shrinks on both sides
            share = min(max((aim - slick[1]) / (rough[1] - slick[1]), 0.1), 0.9)
            factor = slick[0] * (rough[0] / slick[0]) ** share
            found = porosity_with(factor, 0)
            left -= 1
            nearest = min(nearest, found, key=lambda porosity: abs(porosity - target))
            if found > aim:
                rough = factor, found
            else:
                slick = factor, found
            if rough[1] <= slick[1]:
                break  # scatter between packings is all that is left between the two
    else:
        few, many, taps = (0, found), None, FIRST_TAPS
        while left and abs(nearest - target) > tolerance and taps not in (few[0], many and many[0]):
            found = porosity_with(SLICK, taps)
            left -= 1
            nearest = min(nearest, found, key=lambda porosity: abs(porosity - target))
            if found <= aim:
                many = taps, found
            else:
                gained = (few[1] - found) / log2((1 + taps) / (1 + few[0]))
                doublings = min(left, log2(MOST_TAPS / taps))
                few = taps, found
                if many is None and doublings * gained < found - target - tolerance:
                    break  # the next ones do no more each, and together they would not do
            taps = 2 * taps if many is None else (few[0] + many[0]) // 2
    if abs(nearest - target) <= tolerance:
        return ""
    return f"lubrication and tapping came to {nearest:.4f} in {max_passes - left} passes, target {target:.4f}"
