"""Compaction: grains pressed into each other, where rims alone would leave too little surface."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import pandas as pd

from grainfall.packing.plan import decide
from grainfall.section.resample import resample
from grainfall.surface import solid_surface
from grainfall.volume.cement import with_rims
from grainfall.volume.measures import porosity
from grainfall.volume.scan import Meshes, voxelise

RESOLUTION = 0.002
"""To which the factor on the sizes is found."""


def compact(
    bodies: pd.DataFrame,
    library: Meshes,
    scene: Mapping,
    per_um: float,
    *,
    dense: bool,
    switch: str = "auto",
    progress: Callable[[str], None] | None = None,
) -> tuple[pd.DataFrame, dict]:
    """Grains pressed into each other, as far as the section's surface says; rims are to take what is left.

    Rock closes its pores in two ways: grains dissolve where they press on each other, and cement grows on
    them. Contacts flatten by the first and the free surface stays as rough as it was; the second smooths it.
    Of a bed with the room for it made, the first is the grains drawn larger in their own shapes, so that
    they overlap where they touch (distances, in radii, shrink), the second an even rim. Where the second
    alone would leave less surface than the section shows, the first takes as much as brings it back. That
    the rock was compacted is told by its being denser than its grains pour to; how much, by the
    surface: an estimate, with the sampling error of the section, not a test.

    Parameters
    ----------
    bodies : DataFrame
        Grains in um from the region's corner (columns as :func:`grainfall.volume.voxelise` takes), smaller by
        what pressing and rims are to add.
    library : Library
        Meshes of the shapes.
    scene : mapping
        shape_zyx, voxel_size_um, resolution_um, porosity_target.
    per_um : float
        The section's surface by volume of the solid, 1/um, at that resolution.
    dense : bool
        Whether densification was called for: only a rock denser than its grains pour to has been compacted.
    switch : {"auto", "on", "off"}
    progress : callable, optional
        Called with a line of text at each trial.

    Returns
    -------
    bodies : DataFrame
        With the ``scale`` of all grains multiplied by one factor.
    report : dict
        on, forced, called_for, reason, factor (on the sizes, 1 for none), porosity (before the rims), wall_s.

    Notes
    -----
    Process-based reconstructions let grains overlap in their compaction likewise (Bakke and Øren, SPE
    Journal 2, 136, 1997), by a factor that is given; here the section gives it.
    """
    started = time.perf_counter()
    shape, voxel, target = scene["shape_zyx"], scene["voxel_size_um"], scene["porosity_target"]
    resolution = scene["resolution_um"]

    def pressed(factor: float) -> pd.DataFrame:
        return bodies.assign(scale=factor * bodies["scale"])

    def at(factor: float) -> tuple[float, float]:
        phase = voxelise(pressed(factor), library, shape, voxel)[0]
        seen = resample(with_rims(phase, target), voxel, resolution)
        return porosity(phase), solid_surface(seen, resolution).per_um

    left, rims = at(1.0)
    short = left > target and rims < per_um
    effect = decide(
        switch,
        dense and short,
        f"the rock is {'' if dense else 'no '}denser than its grains pour to, and with rims alone the twin "
        f"has {rims:.4g} µm² of surface a µm³ of solid, {'' if short else 'no '}less than the section's "
        f"{per_um:.4g}",
        possible=short,
    )
    factor, surface = 1.0, rims
    if effect["on"]:
        # Where grains fill the target alone, pressing has done all it can.
        high = 2.0
        while high - factor > RESOLUTION:
            # the first trials near 1, as the pores are filled by a few per cent
            middle = factor + min((high - factor) / 2, 0.05)
            found, now = at(middle)
            if progress:
                progress(
                    f"grains pressed to {100 / middle:.3g} % of their distances: {now:.4g} µm² of surface "
                    f"a µm³ of solid, the section has {per_um:.4g}"
                )
            if found > target and now < per_um:
                factor, left, surface = middle, found, now
            else:
                high = middle
        effect["reason"] += (
            f"; grains pressed to {100 / factor:.3g} % of their distances bring it to {surface:.4g}"
            if factor > 1
            else f"; the least that they can be pressed by ({100 * RESOLUTION:g} % of distances) is too much"
        )
    return pressed(factor) if factor > 1 else bodies, {
        **effect,
        "factor": factor,
        "porosity": left,
        "wall_s": time.perf_counter() - started,
    }
