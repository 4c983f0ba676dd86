"""Voids: the shapes of a section's pores that are wider than its grains, for bodies that hold such open."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from grainfall.grains.library import Library, build_library
from grainfall.morphology import (
    NARROWEST_PX,
    inscribed_circles,
    measure_grains,
    solid_radius,
    split_pores,
    voids,
)

VOID = 0
"""Phase of the shapes of voids."""

FEWEST = 12
"""Voids below which a section tells no shapes: as many masks as a size bin of grains has."""

SHAPES = 40
"""Shapes made: a region holds some dozens of voids, and to cut one into convex pieces takes seconds."""


def void_shapes(
    phase: np.ndarray,
    grains2d: pd.DataFrame,
    pixel_size_um: float,
    rng: np.random.Generator,
    *,
    number: int = SHAPES,
    pore_persistence: float,
    min_radius_px: float,
    progress: Callable[[str], None] | None = None,
) -> Library | None:
    """Shapes of a section's voids, each from three masks as grains are.

    A void is a pore that would hold a grain (:func:`~grainfall.morphology.voids`, by a disc as large as the
    grain section in which the mean point of the solid lies). Voids that run into each other are parted as
    pores are.

    Parameters
    ----------
    phase : (y, x) ndarray of uint8
        0 pore.
    grains2d : DataFrame
        The section's grains: r_um and weight.
    pixel_size_um : float
    rng : numpy.random.Generator
    number : int
        Shapes to make.
    pore_persistence, min_radius_px : float
        See :func:`~grainfall.morphology.split_pores`.
    progress : callable, optional
        Is told in a line of each shape made.

    Returns
    -------
    Library or None
        Shapes of phase :data:`VOID`; ``r2d_um`` is the radius of the inscribed circle of the mask that chose
        the size bin. None where the section has fewer than :data:`FEWEST` voids, or too coarse pixels.
    """
    radius = solid_radius(grains2d)
    if radius < NARROWEST_PX * pixel_size_um:
        return None
    wide = voids(phase == 0, radius / pixel_size_um)
    labels = split_pores(np.uint8(~wide), persistence=pore_persistence, min_radius_px=min_radius_px)
    found = measure_grains(labels, np.zeros_like(labels), pixel_size_um)
    circles = inscribed_circles(labels, pixel_size_um).set_index("pore")
    # by their circles, as the bodies are that are to take their shapes
    found["r_um"] = circles["r_um"].loc[found["grain"]].to_numpy()
    found = found[~found["border"] & (found["r_um"] >= radius)].reset_index(drop=True)
    return build_library(labels, found, number, rng, progress=progress) if len(found) >= FEWEST else None
