"""What taking section radii for radii in space does to permeability, on packs of spheres."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import stats

from grainfall import flow, morphology, stereology
from grainfall.section import Mineral, Truth, synthesise

PIXEL = 0.5
"""Pixel of the section, voxels of the packs."""


def rock(
    cv: float,
    stream: Callable[[str], np.random.Generator],
    *,
    porosity: float,
    voxels_per_radius: float,
    edge: int,
    grains: int,
) -> Truth:
    """A truth: spheres of gamma distributed radii, as the tail of a lognormal distribution would not fit.

    Parameters
    ----------
    cv : float
        Standard deviation of the radii over their mean.
    stream : callable
        Takes the name of a chapter (``chapter=``), gives its random numbers.
    porosity : float
    voxels_per_radius : float
        Mean radius, voxels of 1 um.
    edge : int
        Least edge of the box, voxels; more where two of its largest spheres would not fit beside each other.
    grains : int
        Whole grains that its section is to show: it is as large as that takes, and a tenth more.
    """
    share = (np.arange(1000) + 0.5) / 1000
    radii = stats.gamma.ppf(share, 1 / cv**2, scale=voxels_per_radius * cv**2)
    side = section_side(radii, porosity, 1.1 * grains)
    return _spheres(radii, (_room(radii, edge), side, side), porosity, stream(chapter="section/synthetic"))


def seen(truth: Truth) -> tuple[stereology.SizeDistribution, int]:
    """Sizes that the section of a truth tells, with the inversion and without, and its whole grains."""
    phase, grain = truth.section(PIXEL)
    section = morphology.analyse(phase, PIXEL, instances=grain)
    sizes = stereology.unfold_table(
        section.grains, method="adaptive", smallest_um=section.smallest_um, bootstrap=0
    )
    return sizes, int((section.grains.weight > 0).sum())


def pack(
    sizes: stereology.SizeDistribution,
    which: str,
    stream: Callable[[str], np.random.Generator],
    *,
    porosity: float,
    edge: int,
) -> Truth:
    """Spheres of sizes that a section told, in a periodic cube, all of which has the porosity to a voxel.

    With the inversion and without they draw from one stream of numbers, so that the comparison is paired.

    Parameters
    ----------
    sizes : SizeDistribution
        Voxels.
    which : {"f3d", "f2d"}
        With the inversion, or radii of sections taken for those of spheres.
    stream, porosity, edge
        See :func:`rock`.
    """
    radii = np.sort(stereology.draw_radii(sizes, 20_000, stream(chapter="sizes"), which))
    return _spheres(radii, (_room(radii, edge),) * 3, porosity, stream(chapter="packing"))


def measured(spheres: Truth, phase: np.ndarray) -> dict:
    """Sizes of spheres, and the permeability of a piece of them.

    Parameters
    ----------
    spheres : Truth
    phase : ndarray of uint8, (z, y, x)
        The piece; 0 is pore.

    Returns
    -------
    dict
        porosity, r_um and r_sauter_um (mean radius and sum r^3 over sum r^2), k_md (mean of three axes).
    """
    r = spheres.sizes().r_um
    return {
        "porosity": (phase == 0).mean(),
        "r_um": r.mean(),
        "r_sauter_um": (r**3).sum() / (r**2).sum(),
        "k_md": flow.permeability(phase == 0, 1.0, "network").k_md.mean(),
    }


def _room(radii: np.ndarray, edge: int) -> int:
    """Edge of a box in which two of the largest fit beside each other, voxels."""
    return max(edge, int(np.ceil(4.2 * radii.max())))


def _spheres(
    radii: np.ndarray, shape: tuple[int, int, int], porosity: float, rng: np.random.Generator
) -> Truth:
    glass = Mineral("glass", 1.0, radii.mean(), 0.0, 0.0, radii)
    return synthesise(rng, shape, 1.0, [glass], exponent=2, packed_porosity=porosity)


def section_side(radii: np.ndarray, porosity: float, grains: float) -> int:
    """Edge of a square section that shows so many whole spheres, rounded up.

    A plane cuts N_A = 2 E[R] N_V of them per area, N_V = (1 - porosity) / (4/3 pi E[R^3]); those that its
    border cuts in turn are lost along an edge of one mean section, (pi/2) E[R^2] / E[R].

    Parameters
    ----------
    radii : array
        Radii, any unit of length.
    porosity : float
    grains : float
        Whole sections wanted, in expectation.

    Returns
    -------
    int
        In units of the radii.
    """
    per_area = 2 * radii.mean() * (1 - porosity) / (4 / 3 * np.pi * (radii**3).mean())
    return int(np.ceil((grains / per_area) ** 0.5 + np.pi / 2 * (radii**2).mean() / radii.mean()))
