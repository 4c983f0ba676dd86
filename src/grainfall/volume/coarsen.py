"""Fewer voxels for what does not need them all."""

from __future__ import annotations

import numpy as np
import skimage  # its parts load when they are first used

from grainfall.errors import InputError
from grainfall.io import CHUNK, Volume


def coarsen(
    pore: np.ndarray, voxel_size_um: float, factor: int, first_plane: int = 0
) -> tuple[np.ndarray, float]:
    """Blocks of ``factor`` voxels along each axis become one voxel: what most of them are.

    Of even halves, which only an even factor knows, every other block becomes pore, so that the porosity
    stays. Voxels left over at the upper faces are cut.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
    voxel_size_um : float
    factor : int
        1 gives the volume as it is.
    first_plane : int
        Of a slab of a volume: its place there, in planes of the coarse volume.

    Returns
    -------
    pore : (nz // factor, ny // factor, nx // factor) ndarray of bool
    voxel_size_um : float

    Raises
    ------
    InputError
        When no whole block fits in.
    """
    pore = np.asarray(pore, bool)
    if factor == 1:
        return pore, voxel_size_um
    coarse_shape(pore.shape, factor)
    whole = pore[tuple(slice(n - n % factor) for n in pore.shape)]
    twice = 2 * skimage.measure.block_reduce(whole, factor, np.sum)
    z, y, x = np.ogrid[tuple(map(slice, twice.shape))]
    every_other = (first_plane + z + y + x) % 2 == 0
    return (twice > factor**3) | ((twice == factor**3) & every_other), voxel_size_um * factor


def coarse_shape(shape: tuple[int, int, int], factor: int) -> tuple[int, ...]:
    """Shape that :func:`coarsen` leaves of a volume.

    Raises
    ------
    InputError
        When no whole block fits in.
    """
    if min(shape) < factor:
        shown = " x ".join(map(str, shape))
        raise InputError("network.coarsen", f"{factor} is more than a volume of {shown} has", "a smaller one")
    return tuple(n // factor for n in shape)


def read_pore_space(
    phase: np.ndarray | Volume, voxel_size_um: float, factor: int = 1
) -> tuple[np.ndarray, float]:
    """Pore space of a volume of phases, read a few planes at a time, and coarsened.

    Parameters
    ----------
    phase : (nz, ny, nx) array of int, or Volume
        0 in the pores.
    voxel_size_um, factor
        As for :func:`coarsen`.

    Returns
    -------
    pore, voxel_size_um
        As of :func:`coarsen`.
    """
    shape = coarse_shape(phase.shape, factor)
    pore = np.empty(shape, bool)
    planes = max(1, CHUNK // factor)
    for first in range(0, shape[0], planes):
        last = min(first + planes, shape[0])
        block = np.asarray(phase[first * factor : last * factor]) == 0
        pore[first:last], _ = coarsen(block, voxel_size_um, factor, first)
    return pore, voxel_size_um * factor
