"""Estimates from porosity and surface, and what percolates: instant, no simulation."""

from __future__ import annotations

import numpy as np
import skimage  # its parts load when they are first used

from grainfall.network import pore_space
from grainfall.surface import specific_surface
from grainfall.units import um2_to_millidarcy

KOZENY = 5.0
"""Carman's constant for beds of grains: shape factor 2.5 times squared hydraulic tortuosity 2."""


def percolates(pore: np.ndarray) -> tuple[bool, bool, bool]:
    """Whether pore voxels connected by faces lead through the volume along x, y, z."""
    clusters = skimage.measure.label(np.asarray(pore).astype(bool), connectivity=1)
    return tuple(
        bool(np.intersect1d(clusters.take(0, axis), clusters.take(-1, axis)).any()) for axis in (2, 1, 0)
    )


def kozeny_carman(pore: np.ndarray, voxel_size_um: float) -> tuple[float, float]:
    """Kozeny-Carman permeability phi^3 / (5 S^2) in mD and Bruggeman's formation factor phi^(-3/2).

    ``S`` is the surface per bulk volume (:func:`grainfall.surface.specific_surface`). Estimates: neither
    looks at connections. Both are empty (NaN) without pore; without surface, K is.

    Raises
    ------
    InputError
        When ``pore`` is no volume of booleans, or the voxel size no length.
    """
    pore = pore_space(pore, voxel_size_um)
    phi = float(np.mean(pore))
    surface = specific_surface(pore, voxel_size_um)
    k_md = um2_to_millidarcy(phi**3 / (KOZENY * surface**2)) if surface > 0 else np.nan
    return k_md, phi**-1.5 if phi > 0 else np.nan
