"""What an X-ray tomogram would show of a rock: the artefacts that a section does not have."""

from __future__ import annotations

from dataclasses import dataclass

import edt
import numpy as np
from scipy import ndimage
from skimage.filters import threshold_otsu

from grainfall.errors import InputError


@dataclass(frozen=True)
class Tomogram:
    """A simulated tomogram and its segmentation.

    Attributes
    ----------
    grey : (z, y, x) float32
        Attenuation as reconstructed; about 0 in open pores, 1 in solid.
    solid : (z, y, x) bool
        Above Otsu's threshold.
    voxel_size_um : float
    phantom : float
        Phantom pores: share of the voxels that are all solid in the rock, compaction aside, and were taken
        for pore.
    """

    grey: np.ndarray
    solid: np.ndarray
    voxel_size_um: float
    phantom: float


def simulate_tomogram(
    solid: np.ndarray,
    voxel_size_um: float,
    rng: np.random.Generator,
    *,
    binning: int = 2,
    blur_voxels: float = 0.6,
    noise: float = 0.2,
    cupping: float = 0.12,
    rim_um: float = 0.0,
    crush_um: float = 0.0,
) -> Tomogram:
    """Scan a rock, reconstruct it and threshold it.

    A plug is the cylinder along z that circumscribes the volume. In order: crushed grains line the pores of
    the plug's rim; cubes of ``binning`` voxels share a detector voxel (partial volume); the point spread
    blurs; photon noise, correlated over the reconstruction's kernel, is added; beam hardening leaves the
    inside of the plug darker than its rim; Otsu's threshold makes it pore and solid.

    Parameters
    ----------
    solid : (z, y, x) array of bool
    voxel_size_um : float
    rng : numpy.random.Generator
    binning : int
        Voxels of the rock along a voxel of the tomogram.
    blur_voxels : float
        Standard deviation of the point spread, voxels of the tomogram.
    noise : float
        Standard deviation of the noise over the contrast of solid and pore.
    cupping : float
        Loss of attenuation on the plug's axis, fraction.
    rim_um, crush_um : float
        Depth of the compacted rim, and thickness of the lining at its outside, falling to 0 over the depth.

    Returns
    -------
    Tomogram

    Raises
    ------
    InputError
        When the volume is not a few voxels of the tomogram wide.
    """
    edges = [n // max(binning, 1) for n in solid.shape]
    if binning < 1 or min(edges) < 8:
        raise InputError("tomogram.binning", f"{binning} leaves {edges} voxels", "at least 8 along each axis")
    rock = np.ascontiguousarray(solid[tuple(slice(0, n * binning) for n in edges)] > 0)
    ny, nx = rock.shape[1:]
    y, x = (np.arange(n) - (n - 1) / 2 for n in (ny, nx))
    radius = np.hypot(y[:, None], x[None, :])
    seen = rock
    if rim_um > 0 and crush_um > 0:
        depth = (radius.max() - radius) * voxel_size_um
        lining = crush_um / voxel_size_um * np.clip(1 - depth / rim_um, 0, 1)
        seen = rock | (edt.edt(~rock, parallel=1) < 0.5 + lining) & (lining > 0)

    def binned(volume: np.ndarray) -> np.ndarray:
        blocks = volume.reshape(edges[0], binning, edges[1], binning, edges[2], binning)
        return blocks.mean(axis=(1, 3, 5), dtype=np.float32)

    grey = ndimage.gaussian_filter(binned(seen), blur_voxels, mode="nearest")
    speckle = ndimage.gaussian_filter(rng.standard_normal(grey.shape, dtype=np.float32), 0.5, mode="wrap")
    grey += speckle * np.float32(noise / speckle.std())
    coarse = radius.reshape(edges[1], binning, edges[2], binning).mean(axis=(1, 3)) / radius.max()
    grey *= (1 - cupping * (1 - coarse**2)).astype(np.float32)
    found = grey > threshold_otsu(grey)
    whole = binned(rock) == 1
    phantom = float(np.count_nonzero(whole & ~found) / max(1, np.count_nonzero(whole)))
    return Tomogram(grey, found, voxel_size_um * binning, phantom)
