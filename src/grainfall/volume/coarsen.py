"""Fewer voxels for what does not need them all."""

from __future__ import annotations

import numpy as np
import skimage  # its parts load when they are first used

from grainfall.errors import InputError


def coarsen(pore: np.ndarray, voxel_size_um: float, factor: int) -> tuple[np.ndarray, float]:
    """Blocks of ``factor`` voxels along each axis become one voxel: what most of them are.

    Of even halves, which only an even factor knows, every other block becomes pore, so that the porosity
    stays. Voxels left over at the upper faces are cut.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
    voxel_size_um : float
    factor : int
        1 gives the volume as it is.

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
    if min(pore.shape) < factor:
        shape = " x ".join(map(str, pore.shape))
        raise InputError("network.coarsen", f"{factor} is more than a volume of {shape} has", "a smaller one")
    whole = pore[tuple(slice(n - n % factor) for n in pore.shape)]
    twice = 2 * skimage.measure.block_reduce(whole, factor, np.sum)
    z, y, x = np.ogrid[tuple(map(slice, twice.shape))]
    every_other = (z + y + x) % 2 == 0
    return (twice > factor**3) | ((twice == factor**3) & every_other), voxel_size_um * factor
