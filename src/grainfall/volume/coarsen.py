"""Fewer voxels for what does not need them all."""

from __future__ import annotations

import numpy as np
from numba import njit

from grainfall.errors import InputError


def coarsen(pore: np.ndarray, factor: int) -> np.ndarray:
    """Blocks of ``factor`` voxels along each axis become one voxel: what most of them are.

    Of even halves, which only an even factor knows, every other block becomes pore, so that the porosity
    stays. Voxels left over at the upper faces are cut.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
    factor : int
        1 gives the volume as it is.

    Returns
    -------
    (nz // factor, ny // factor, nx // factor) ndarray of bool

    Raises
    ------
    InputError
        When no whole block fits in.
    """
    if factor == 1:
        return np.asarray(pore, bool)
    if min(pore.shape) < factor:
        shape = " x ".join(map(str, pore.shape))
        raise InputError("network.coarsen", f"{factor} is more than a volume of {shape} has", "a smaller one")
    return _majority(np.ascontiguousarray(pore, bool), factor)


@njit(cache=True)
def _majority(pore, factor):
    coarse = np.empty((pore.shape[0] // factor, pore.shape[1] // factor, pore.shape[2] // factor), np.bool_)
    for k in range(coarse.shape[0]):
        for j in range(coarse.shape[1]):
            for i in range(coarse.shape[2]):
                twice = 0
                for z in range(k * factor, (k + 1) * factor):
                    for y in range(j * factor, (j + 1) * factor):
                        for x in range(i * factor, (i + 1) * factor):
                            twice += 2 * pore[z, y, x]
                coarse[k, j, i] = twice > factor**3 or (twice == factor**3 and (i + j + k) % 2 == 0)
    return coarse
