"""Surface between solid and pores, from how often lines along the axes cross it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CELLS = 64
"""Cells of an image between which its surface scatters: 8 x 8 of a section, 4 x 4 x 4 of a volume."""

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
    loses what the spacing does not resolve: compare images of one spacing only.
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
    crossings = np.zeros(solid.shape, np.uint8)
    for axis in range(solid.ndim):
        here = (slice(None),) * axis
        crossings[(*here, slice(1, None))] += np.diff(solid, axis=axis)
    faces, volume = _by_cells(crossings), _by_cells(solid)
    if not volume.sum():
        return SolidSurface(np.inf, np.inf)
    ratio, error = ratio_of_sums(faces, volume)
    to_surface = 2.0 / solid.ndim / spacing_um
    return SolidSurface(float(to_surface * ratio), float(to_surface * error))


def ratio_of_sums(part: np.ndarray, whole: np.ndarray) -> tuple[float, float]:
    """Sum of one over the sum of the other, both (n,) by tiles of an image, and its standard error.

    The error is that of the ratio estimator: residuals about the common ratio, whose spread over tiles holds
    the spatial correlation that counting pixels would ignore.
    """
    n, ratio = len(part), part.sum() / whole.sum()
    residual = part - ratio * whole
    return ratio, np.sqrt(n / max(1, n - 1) * (residual**2).sum()) / whole.sum()


def _by_cells(values: np.ndarray) -> np.ndarray:
    """Sums over the cells, as floats."""
    parts = round(CELLS ** (1 / values.ndim))
    for axis, n in enumerate(values.shape):
        starts = np.unique(np.arange(parts) * n // parts)
        values = np.add.reduceat(values, starts, axis=axis, dtype=np.int64)
    return values.ravel().astype(float)
