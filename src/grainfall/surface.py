"""Surface between solid and pores, from how often lines along the axes cross it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CELLS = 64
"""Cells of an image between which its surface scatters: 8 x 8 of a section, 4 x 4 x 4 of a volume."""

TILES = 4
"""Tiles along an edge of a section between which what it says of K scatters."""

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
    crossings = sum(np.count_nonzero(np.diff(pore, axis=axis)) for axis in range(pore.ndim))
    return 2.0 / pore.ndim * crossings / (pore.size * spacing_um)


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
    faces, volume = _by_cells(_crossings(solid), parts), _by_cells(solid, parts)
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
    faces, grain = _by_cells(_crossings(solid), TILES), _by_cells(solid, TILES)
    area = _by_cells(np.ones(solid.shape, np.uint8), TILES)
    pore = area - grain
    if not (pore.any() and faces.any()):
        return SamplingErrors(np.nan, np.nan, np.nan)
    pores, crossings, solids, whole = (tiles / tiles.sum() for tiles in (pore, faces, grain, area))
    return SamplingErrors(
        float(ratio_of_sums(pore, area)[1]),
        float(ratio_of_sums(3 * pores - 2 * crossings, whole)[1]),
        float(2 * ratio_of_sums(crossings, solids)[1]),
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


def _crossings(solid: np.ndarray) -> np.ndarray:
    """How many lines cross the surface right before each pixel or voxel."""
    crossings = np.zeros(solid.shape, np.uint8)
    for axis in range(solid.ndim):
        crossings[(*(slice(None),) * axis, slice(1, None))] += np.diff(solid, axis=axis)
    return crossings


def _by_cells(values: np.ndarray, parts: int) -> np.ndarray:
    """Sums over cells, so many along an edge, as floats."""
    for axis, n in enumerate(values.shape):
        starts = np.unique(np.arange(parts) * n // parts)
        values = np.add.reduceat(values, starts, axis=axis, dtype=np.int64)
    return values.ravel().astype(float)
