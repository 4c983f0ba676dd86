"""Where in the bed the region of interest lies: moved a little where chance put too many or too few voids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

FARTHEST, FROM_WALLS = 0.5, 1.5
"""How far a region is moved at most along each axis, and how far it then keeps from walls, floor and surface,
mean grain diameters."""


@dataclass(frozen=True)
class Place:
    """Where a region lies in its bed.

    Attributes
    ----------
    moved_um : (x, y, z) tuple of float
        From the middle of the bed.
    porosity, middle : float
        Of the region there, and in the middle.
    """

    moved_um: tuple[float, float, float]
    porosity: float
    middle: float

    @classmethod
    def unmoved(cls, porosity: float) -> Place:
        """In the middle."""
        return cls((0.0, 0.0, 0.0), porosity, porosity)


def reach_voxels(scene: Mapping) -> int:
    """How far a region may be moved along each axis, in voxels.

    Parameters
    ----------
    scene : mapping
        margin_um, mean_diameter_um, voxel_size_um.
    """
    diameter = scene["mean_diameter_um"]
    room = min(FARTHEST * diameter, scene["margin_um"] - FROM_WALLS * diameter)
    return max(0, int(room / scene["voxel_size_um"] + 1e-9))


def nearest_place(porosity: np.ndarray, aim: float, voxel_size_um: float) -> Place:
    """The place whose porosity is nearest the aim; of equals the one nearest the middle.

    Parameters
    ----------
    porosity : (2 r + 1,) * 3 array of float
        Of regions moved by up to r voxels, by z, y and x (:func:`grainfall.volume.porosity_about`).
    aim : float
    voxel_size_um : float
    """
    reach = porosity.shape[0] // 2
    steps = np.indices(porosity.shape).reshape(3, -1) - reach
    order = np.lexsort(((steps**2).sum(axis=0), np.abs(porosity.ravel() - aim)))
    found = steps[:, order[0]]
    moved = tuple(float(n) * voxel_size_um for n in found[::-1])
    return Place(moved, float(porosity.ravel()[order[0]]), float(porosity[(reach,) * 3]))


def move(bodies: pd.DataFrame, by_um: tuple[float, float, float]) -> pd.DataFrame:
    """Bodies whose coordinates are counted from the corner of a region moved by so much.

    Parameters
    ----------
    bodies : DataFrame
        x, y, z.
    by_um : (x, y, z)
    """
    if not any(by_um):
        return bodies
    return bodies.assign(**{axis: bodies[axis] - by for axis, by in zip("xyz", by_um, strict=True)})


def as_placed(scene: Mapping, placement: Mapping) -> dict:
    """The scene, its margin what is left of it on the side to which the region was moved.

    Parameters
    ----------
    scene : mapping
        margin_um.
    placement : mapping
        Of the second packing's report: moved_um.
    """
    return {**scene, "margin_um": scene["margin_um"] - max(map(abs, placement["moved_um"]))}
