"""Width of the voids that virtual bodies leave among the grains."""

from __future__ import annotations

import edt
import numpy as np
import pandas as pd
from scipy import ndimage

from grainfall.volume.scan import Meshes, voxelise

EVERY = 2
"""Voxels from one plane to the next: circles of neighbours are all but the same."""


def void_width(
    bodies: pd.DataFrame, library: Meshes, shape: tuple[int, int, int], voxel_size_um: float
) -> float | None:
    """Width of the voids that bodies in the shapes of voids leave, over that of spheres of their volumes.

    On planes across each of the three axes: the largest circle between the grains whose centre lies in the
    body, over the circle in which the plane cuts a sphere of the body's volume about its centre. The
    first are summed over the second, so that wide voids count most.

    Parameters
    ----------
    bodies : DataFrame
        As :func:`~grainfall.volume.voxelise` takes them; grains and virtual bodies.
    library : Library
    shape : (nz, ny, nx)
        Voxels of the region of interest.
    voxel_size_um : float

    Returns
    -------
    float or None
        None where no such body's sphere lies in the region as a whole: beyond it grains are not seen.
    """
    centre, radius = bodies[["z", "y", "x"]].to_numpy(float), bodies["scale"].to_numpy(float)
    edges = np.asarray(shape, int) * voxel_size_um
    whole = ((centre >= radius[:, None]) & (centre <= edges - radius[:, None])).all(axis=1)
    shaped = (bodies["kind"] == "virtual").to_numpy() & (bodies["shape"] >= 0).to_numpy() & whole
    if not shaped.any():
        return None
    pore = voxelise(bodies[bodies["kind"] == "grain"], library, shape, voxel_size_um)[0] == 0
    held = bodies[shaped].assign(id=np.arange(shaped.sum()))
    body = voxelise(held, library, shape, voxel_size_um)[1]
    centre, radius = centre[shaped], radius[shaped]
    circles = discs = 0.0
    for axis in range(3):
        for plane in range(0, shape[axis], EVERY):
            height = (plane + 0.5) * voxel_size_um - centre[:, axis]
            cut = np.flatnonzero(np.abs(height) < radius)
            if not len(cut):
                continue
            at = (slice(None),) * axis + (plane,)
            # from the centre of a voxel to the face of the nearest of a grain; the edge hides what is beyond
            clearance = edt.edt(np.ascontiguousarray(pore[at]), black_border=False, parallel=1) - 0.5
            clearance = np.minimum(clearance, max(pore[at].shape)) * voxel_size_um
            circles += ndimage.maximum(clearance, body[at], cut + 1).sum()
            discs += np.sqrt(radius[cut] ** 2 - height[cut] ** 2).sum()
    return float(circles / discs)
