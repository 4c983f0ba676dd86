"""What taking section radii for radii in space does to permeability, on packs of spheres."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy import stats

from grainfall import flow, morphology, stereology
from grainfall.section import Mineral, Truth, synthesise

PIXEL = 0.5
"""Pixel of the section, voxels of the packs."""


def packs(
    cv: float,
    stream: Callable[[str], np.random.Generator],
    *,
    porosity: float,
    voxels_per_radius: float,
    edge: int,
    grains: int,
) -> Iterator[dict]:
    """A truth, and packs of the sizes that its section tells with and without the inversion.

    Radii are gamma distributed: the tail of a lognormal distribution would not fit into the box. Both packs
    draw from one stream of numbers, so that the comparison is paired.

    Parameters
    ----------
    cv : float
        Standard deviation of the radii over their mean.
    stream : callable
        Name of a chapter to its random numbers.
    porosity : float
        Of all packs.
    voxels_per_radius : float
        Mean radius of the truth, voxels.
    edge : int
        Least edge of a pack, voxels; more where two of its largest spheres would not fit beside each other.
    grains : int
        Whole grains that the section of the truth is to show: it is as large as that takes, and a tenth more.

    Yields
    ------
    dict
        variant (truth, full or no_inversion), sections (grains measured), porosity, r_um and r_sauter_um
        (mean radius and sum r^3 over sum r^2, for voxels of 1 um), k_md (mean of three axes).
    """
    share = (np.arange(1000) + 0.5) / 1000
    quantiles = stats.gamma.ppf(share, 1 / cv**2, scale=voxels_per_radius * cv**2)

    def room(radii: np.ndarray) -> int:
        return max(edge, int(np.ceil(4.2 * radii.max())))

    def spheres(chapter: str, shape: tuple[int, int, int], radii: np.ndarray) -> Truth:
        glass = Mineral("glass", 1.0, radii.mean(), 0.0, 0.0, radii)
        return synthesise(stream(chapter), shape, 1.0, [glass], exponent=2, packed_porosity=porosity)

    side = section_side(quantiles, porosity, 1.1 * grains)
    truth = spheres("section/synthetic", (room(quantiles), side, side), quantiles)
    phase, grain = truth.section(PIXEL)
    section = morphology.analyse(phase, PIXEL, instances=grain)
    seen, smallest = section.grains, section.smallest_um
    sizes = stereology.unfold_table(seen, method="adaptive", smallest_um=smallest, bootstrap=0)
    for variant, which in (("truth", None), ("full", "f3d"), ("no_inversion", "f2d")):
        if which is None:
            pack, solid = truth, truth.cubes(edge)[0]
        else:
            drawn = np.sort(stereology.draw_radii(sizes, 20_000, stream("sizes"), which))
            pack = spheres("packing", (room(drawn),) * 3, drawn)
            solid = pack.phase  # all of its periodic box, which has the porosity to a voxel
        r = pack.sizes().r_um
        yield {
            "variant": variant,
            "sections": int((seen.weight > 0).sum()),
            "porosity": (solid == 0).mean(),
            "r_um": r.mean(),
            "r_sauter_um": (r**3).sum() / (r**2).sum(),
            "k_md": flow.permeability(solid == 0, 1.0, "network").k_md.mean(),
        }


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
