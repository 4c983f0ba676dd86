"""Voids of an image, as wide as its grains or wider, and how porous it is between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
import skimage  # its parts load when they are first used

from grainfall.surface import CELLS, by_cells, ratio_of_sums

NARROWEST_PX = 3.0
"""Radius, pixels, of a disc that still resembles one."""


@dataclass(frozen=True)
class Intergranular:
    """Porosity between the voids, of an image or of several.

    Attributes
    ----------
    radius_um : float
        Of the disc by which pores are opened for their voids.
    voids : float
        Share of the area that voids have.
    porosity : float
        Of what lies between them.
    error : float
        Its standard error, from the scatter over cells of the image; neighbouring images are not independent,
        so of several it is too small.
    """

    radius_um: float
    voids: float
    porosity: float
    error: float


def solid_radius(grains2d: pd.DataFrame) -> float:
    """Radius of the grain section in which the mean point of the solid lies, um; 0 without any.

    Parameters
    ----------
    grains2d : DataFrame
        r_um and weight of the sections of grains.
    """
    area = grains2d["weight"].to_numpy(float) * grains2d["r_um"].to_numpy(float) ** 2
    return float(np.average(grains2d["r_um"], weights=area)) if area.sum() > 0 else 0.0


def voids(pore: np.ndarray, radius_px: float) -> np.ndarray:
    """What the pore space keeps when it is opened by a disc: pores that would hold a grain of that radius.

    Grains alone leave hardly any. What lies beyond the edge of the image counts as pore.

    Parameters
    ----------
    pore : (y, x) ndarray of bool
    radius_px : float

    Returns
    -------
    (y, x) ndarray of bool
    """
    centres = skimage.morphology.isotropic_erosion(pore, radius_px)
    if not centres.any():
        return centres  # a dilation of nothing is undefined
    return skimage.morphology.isotropic_dilation(centres, radius_px)


def intergranular(
    images: Iterable[np.ndarray], pixel_size_um: float, radius_um: float
) -> Intergranular | None:
    """How porous a rock is between its voids.

        phi_between = (phi - v) / (1 - v)

    for porosity phi and void share v. A rim of two radii, where voids reach beyond the image, is left out.

    Parameters
    ----------
    images : iterable of (y, x) ndarray of bool
        Pores of a section, or of slices of a bed.
    pixel_size_um : float
    radius_um : float
        See :func:`solid_radius`.

    Returns
    -------
    Intergranular or None
        None where an image is no wider than its rim, nothing lies between voids, or the disc is of too few
        pixels.
    """
    if radius_um < NARROWEST_PX * pixel_size_um:
        return None
    rim = int(np.ceil(2 * radius_um / pixel_size_um))
    parts = round(CELLS**0.5)
    pores, between, size = [], [], 0
    for pore in images:
        if min(pore.shape) < 2 * rim + parts:
            return None
        inside = np.s_[rim : pore.shape[0] - rim, rim : pore.shape[1] - rim]
        outside = ~voids(pore, radius_um / pixel_size_um)[inside]
        pores.append(by_cells(pore[inside] & outside, parts))
        between.append(by_cells(outside, parts))
        size += outside.size
    part, whole = np.concatenate(pores), np.concatenate(between)
    if not whole.sum():
        return None
    porosity, error = ratio_of_sums(part, whole)
    return Intergranular(float(radius_um), float(1 - whole.sum() / size), float(porosity), float(error))
