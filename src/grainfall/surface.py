"""Surface between solid and pores, from how often lines along the axes cross it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # its stats take half a second to load, and do so when they are first used

CELLS = 64
"""Cells of an image between which its surface scatters: 8 x 8 of a section, 4 x 4 x 4 of a volume."""

TILES = 4
"""Tiles along an edge of a section between which what it says of K scatters."""

ALIGNED, BY_CHANCE = 1.2, 0.001
"""From what ratio of crossings, and below what share of chance, a section is said to be aligned."""

CORE = 256
"""Edge, voxels, of the core of a volume on which its surface is looked at."""


@dataclass(frozen=True)
class SolidSurface:
    """Surface of the solid against the pores, by volume of the solid.

    Attributes
    ----------
    per_um : float
        In 1/um: 3 / R for spheres of one radius that touch in points, less where grains have grown together.
    error : float
        Its standard error, 1/um.
    """

    per_um: float
    error: float


@dataclass(frozen=True)
class Alignment:
    """How far what a section shows lies in one direction.

    Attributes
    ----------
    ratio : float
        Surface crossed by lines across what lies aligned, over that crossed along it; 1 where all directions
        are alike.
    along_deg : float
        The direction along which it lies, in [0, 180): counter-clockwise from x, as the image is seen.
    p : float
        How often chance does as much to a section of no direction.
    """

    ratio: float
    along_deg: float
    p: float


@dataclass(frozen=True)
class SamplingErrors:
    """What one section leaves open of its rock, whatever is built from it: standard errors.

    Attributes
    ----------
    porosity : float
    k : float
        Of ln K, where porosity and surface are both the section's.
    k_at_porosity : float
        Of ln K, where the porosity is known otherwise.
    """

    porosity: float
    k: float
    k_at_porosity: float


def specific_surface(pore: np.ndarray, spacing_um: float) -> float:
    """Pore-solid surface by bulk volume, 1/um.

    Parameters
    ----------
    pore : (ny, nx) or (nz, ny, nx) array of bool
        A section will do: what is the same in all directions is crossed as often on it as in space.
    spacing_um : float
        Edge of a pixel or voxel.

    Notes
    -----
    Twice the crossings by length of line (Saltykov's S_V = 2 P_L), of lines along the axes. A smooth surface
    loses what the spacing does not resolve: compare images of one spacing only, none of them resampled from a
    coarser one.
    """
    pore = np.asarray(pore).astype(bool)
    return float(2.0 / pore.ndim * _crossings(pore, 1).sum() / (pore.size * spacing_um))


def core(phase: np.ndarray) -> np.ndarray:
    """The middle of a large volume, at most :data:`CORE` voxels an edge: surfaces differ little beyond it."""
    return phase[tuple(slice(max(0, (n - CORE) // 2), (n + CORE) // 2) for n in phase.shape)]


def solid_surface(phase: np.ndarray, spacing_um: float) -> SolidSurface:
    """Surface of the solid by its volume, with a standard error from the scatter over cells of the image.

    Parameters
    ----------
    phase : (ny, nx) or (nz, ny, nx) array of int
        0 pore.
    spacing_um : float
        Edge of a pixel or voxel.

    Returns
    -------
    SolidSurface
        Without solid, infinite: no grain there can be held against another's surface.
    """
    solid = np.asarray(phase) > 0
    parts = round(CELLS ** (1 / solid.ndim))
    faces, volume = _crossings(solid, parts), by_cells(solid, parts)
    if not volume.sum():
        return SolidSurface(np.inf, np.inf)
    ratio, error = ratio_of_sums(faces, volume)
    to_surface = 2.0 / solid.ndim / spacing_um
    return SolidSurface(float(to_surface * ratio), float(to_surface * error))


def sampling_errors(phase: np.ndarray) -> SamplingErrors:
    """How far one section's own sampling leaves porosity and permeability open.

    Parameters
    ----------
    phase : (ny, nx) array of int
        0 pore.

    Returns
    -------
    SamplingErrors
        Not a number where the section shows no pore or no surface.

    Notes
    -----
    By Kozeny-Carman K goes as phi^3 / S_V^2: of a section with pore area P and F crossings of lines,
    ln K = 3 ln P - 2 ln F + const, and to first order each of its tiles adds 3 p / P - 2 f / F. At a known
    porosity K goes as the inverse square of the surface by the volume of the solid. The errors are those of
    sums over tiles that are taken as independent: what varies over lengths beyond a tile's is missed.
    """
    solid = np.asarray(phase) > 0
    faces, grain = _crossings(solid, TILES), by_cells(solid, TILES)
    area = by_cells(np.ones(solid.shape, np.uint8), TILES)
    pore = area - grain
    if not (pore.any() and faces.any()):
        return SamplingErrors(np.nan, np.nan, np.nan)
    pores, crossings, solids, whole = (tiles / tiles.sum() for tiles in (pore, faces, grain, area))
    return SamplingErrors(
        float(ratio_of_sums(pore, area)[1]),
        float(ratio_of_sums(3 * pores - 2 * crossings, whole)[1]),
        float(2 * ratio_of_sums(crossings, solids)[1]),
    )


def alignment(phase: np.ndarray) -> Alignment:
    """How far a section's solid lies aligned.

    Parameters
    ----------
    phase : (ny, nx) array of int
        0 pore.

    Returns
    -------
    Alignment
        Not a number where the section is too small for :data:`TILES`, or shows too little surface.

    Notes
    -----
    Crossings by length of line along x, y and both diagonals, P_L(t) = a + b cos 2t + c sin 2t (the second
    harmonic of Saltykov's rose). Whether (b, c) / a differs from zero is Hotelling's test of its scatter over
    tiles, which are taken as independent.
    """
    solid = np.asarray(phase) > 0
    if min(solid.shape) < 2:
        return Alignment(np.nan, np.nan, np.nan)
    here = solid[:-1, :-1]
    beside, across, below = solid[:-1, 1:], solid[1:, 1:], solid[1:, :-1]
    lines = ((here, beside, 1.0), (here, across, np.sqrt(2)), (here, below, 1.0), (beside, below, np.sqrt(2)))
    x, falling, y, rising = (by_cells(one ^ other, TILES) / step for one, other, step in lines)
    mean, harmonic = (x + falling + y + rising) / 4, np.array([x - y, falling - rising]) / 2
    n = len(mean)
    if n < TILES**2 or not mean.sum():
        return Alignment(np.nan, np.nan, np.nan)
    found = harmonic.sum(axis=1) / mean.sum()
    residual = (harmonic - found[:, None] * mean) / mean.sum()
    scatter = n / (n - 1) * residual @ residual.T
    if np.linalg.matrix_rank(scatter, hermitian=True) < 2:
        return Alignment(np.nan, np.nan, np.nan)
    squared = found @ np.linalg.solve(scatter, found)
    p = scipy.stats.f.sf(squared * (n - 2) / (2 * (n - 1)), 2, n - 2)
    size = np.hypot(*found)
    most_crossed = np.degrees(np.arctan2(found[1], found[0])) / 2  # from x towards y, which points down
    return Alignment(float((1 + size) / (1 - size)), float((90 - most_crossed) % 180), float(p))


def lies_aligned(section: Alignment) -> str | None:
    """What to know of an aligned section, in words; None where nothing shows that it is one."""
    if not (section.p < BY_CHANCE and section.ratio > ALIGNED):
        return None
    return (
        f"The section lies aligned, at {section.along_deg:.0f} degrees from x (counter-clockwise): lines "
        f"across meet its surface {section.ratio:.3g} times as often as lines along. A twin does not keep "
        "directions: its permeabilities along x, y and z differ by how grains settle, not by this"
    )


def left_open(k: float, porosity: float | None = None) -> str:
    """What one section leaves open, in words: twice the standard errors of ln K and of the porosity."""
    of_porosity = "" if porosity is None else f", and the rock's porosity by {2 * porosity:.2g}"
    return (
        f"One section like this leaves K open by a factor of {np.exp(2 * k):.3g} either way{of_porosity} "
        "(two standard errors of its own sampling, Kozeny-Carman), whatever is built from it"
    )


def ratio_of_sums(part: np.ndarray, whole: np.ndarray) -> tuple[float, float]:
    """Sum of one over the sum of the other, both (n,) by tiles of an image, and its standard error.

    The error is that of the ratio estimator: residuals about the common ratio, whose spread over tiles holds
    the spatial correlation that counting pixels would ignore.
    """
    n, ratio = len(part), part.sum() / whole.sum()
    residual = part - ratio * whole
    return ratio, np.sqrt(n / max(1, n - 1) * (residual**2).sum()) / whole.sum()


def _crossings(solid: np.ndarray, parts: int) -> np.ndarray:
    """How many lines along the axes cross the surface right before the pixels or voxels of each cell.

    A line of n pixels has n - 1 places for a crossing and stands for the length of n.
    """
    crossings = 0.0
    for axis, n in enumerate(solid.shape):
        before = np.zeros(solid.shape, np.uint8)
        before[(*(slice(None),) * axis, slice(1, None))] = np.diff(solid, axis=axis)
        crossings = crossings + by_cells(before, parts) * n / max(1, n - 1)
    return crossings


def by_cells(values: np.ndarray, parts: int) -> np.ndarray:
    """Sums over cells, so many along an edge, as floats."""
    for axis, n in enumerate(values.shape):
        starts = np.unique(np.arange(parts) * n // parts)
        values = np.add.reduceat(values, starts, axis=axis, dtype=np.int64)
    return values.ravel().astype(float)
