"""Two-point probability S2(r) of an indicator: the chance that two points r apart are both solid.

S2 along an axis is a count of pairs over the number of pairs that fit, c(r) / (lines (n - r)). The counts are
autocorrelations, taken by zero-padded FFT and rounded to the whole numbers they are: the result is exact to
the last division, whatever the order of the work, so that slices may be scattered in any chunks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy import fft

AXES = ("z", "y", "x")
LINES_AT_ONCE = 4096

BLOCK_BYTES = 2**32
"""Memory in which the lags of all directions are found, the volume itself and their spectrum aside."""


def s2_along(
    indicator: np.ndarray, axis: int, max_lag: int | None = None, *, periodic: bool = False
) -> np.ndarray:
    """S2 along one axis of an image or volume.

    Parameters
    ----------
    indicator : (..., n, ...) array
        Non-zero where the phase is. For the pore space give ``phase == 0``.
    axis : int
        Axis of the lag.
    max_lag : int, optional
        Largest lag in pixels, below n; half the axis if omitted.
    periodic : bool
        Whether the medium repeats beyond its border; otherwise pairs lie inside.

    Returns
    -------
    (max_lag + 1,) float
        S2 at lags 0, 1, 2 ... pixels; S2(0) is the phase fraction.
    """
    counts, pairs = _pairs_along(indicator, axis, max_lag, periodic)
    return counts / pairs


def s2_image(indicator: np.ndarray, max_lag: int | None = None, *, periodic: bool = False) -> np.ndarray:
    """S2 of an image: pairs along both axes pooled into one curve.

    Parameters
    ----------
    indicator : (y, x) array
        Non-zero where the phase is.
    max_lag : int, optional
        Largest lag in pixels; half the shorter edge if omitted.
    periodic : bool
        Whether the image repeats beyond its border.

    Returns
    -------
    (max_lag + 1,) float
        (pairs found along y + pairs found along x) / (pairs that fit along y + pairs that fit along x).
    """
    max_lag = min(indicator.shape) // 2 if max_lag is None else max_lag
    along = [_pairs_along(indicator, axis, max_lag, periodic) for axis in (0, 1)]
    return sum(counts for counts, _ in along) / sum(pairs for _, pairs in along)


def s2_of_slices(
    volume: np.ndarray,
    slices: Sequence[tuple[int, int]],
    voxel_size_um: float,
    max_lag: int | None = None,
    *,
    start: int = 0,
) -> pd.DataFrame:
    """S2 of given slices, each by itself: any chunk of the list gives the same rows.

    Parameters
    ----------
    volume : (nz, ny, nx) array
        Non-zero where the phase is (a phase map's solid); a Zarr array or memory map will do.
    slices : sequence of (axis, index)
    voxel_size_um : float
    max_lag : int, optional
        Largest lag in voxels; half the volume's shortest edge if omitted, so that all curves have the same
        lags.
    start : int
        Number of the first slice, where the list is a chunk of a longer one.

    Returns
    -------
    DataFrame
        slice (number), axis (the normal: z, y or x), lag_um, s2 (both in-plane axes pooled).
    """
    max_lag = min(volume.shape) // 2 if max_lag is None else max_lag
    lag_um = np.arange(max_lag + 1) * float(voxel_size_um)
    curves = [
        pd.DataFrame(
            {
                "slice": start + i,
                "axis": AXES[axis],
                "lag_um": lag_um,
                "s2": s2_image(plane(volume, axis, index), max_lag),
            }
        )
        for i, (axis, index) in enumerate(slices)
    ]
    return pd.concat(curves, ignore_index=True)


def s2_volume(
    volume: np.ndarray,
    voxel_size_um: float,
    max_lag: int | None = None,
    *,
    periodic: bool = False,
    radial: bool = True,
    threads: int = 1,
    block_bytes: int = BLOCK_BYTES,
) -> pd.DataFrame:
    """S2 of a volume along x, y and z, and its average over directions.

    Parameters
    ----------
    volume : (nz, ny, nx) array
        Non-zero where the phase is.
    voxel_size_um : float
    max_lag : int, optional
        Largest lag in voxels; half the shortest edge if omitted.
    periodic : bool
        Whether the medium repeats beyond its border.
    radial : bool
        Whether to average over all directions too, up to half of ``max_lag``.
    threads : int
        Of the transforms; changes time, never the result.
    block_bytes : int
        Memory for the average over all directions; changes time, never the result.

    Returns
    -------
    DataFrame
        axis (x, y, z, and r for the average), lag_um, s2. On ``r`` the lag is the mean distance of the
        pairs in a shell one voxel thick.
    """
    max_lag = min(volume.shape) // 2 if max_lag is None else max_lag
    solid = np.asarray(volume)
    with fft.set_workers(threads):
        curves = {
            name: (np.arange(max_lag + 1.0), s2_along(solid, AXES.index(name), max_lag, periodic=periodic))
            for name in "xyz"
        }
        if radial:
            curves["r"] = _radial(solid, max_lag // 2, periodic, block_bytes)
    return pd.concat(
        [
            pd.DataFrame({"axis": name, "lag_um": lag * voxel_size_um, "s2": s2})
            for name, (lag, s2) in curves.items()
        ],
        ignore_index=True,
    )


def specific_surface(lag_um: np.ndarray, s2: np.ndarray) -> float:
    """Surface per bulk volume of an isotropic medium, from S2'(0) = -S_v / 4 (Debye et al. 1957).

    Parameters
    ----------
    lag_um, s2 : (n,) float
        A 3D curve, or the mean of curves along several axes; lag 0 first.

    Returns
    -------
    float
        1/um.

    Notes
    -----
    The slope is that of the parabola through the first three points: grains in contact give S2 a curvature
    at 0 that a single difference would take for missing surface. The staircase of voxels does not bias it:
    the first step along an axis counts voxel faces normal to it, which make up the surface's projection
    (mean ``|n_x| = 1/2`` of its area), although the area of all voxel faces is 3/2 of the true one.
    """
    h1, h2 = lag_um[1] - lag_um[0], lag_um[2] - lag_um[0]
    slope = ((s2[1] - s2[0]) * h2 / h1 - (s2[2] - s2[0]) * h1 / h2) / (h2 - h1)
    return float(-4.0 * slope)


def plane(volume: np.ndarray, axis: int, index: int) -> np.ndarray:
    """One slice of a volume, normal to ``axis``."""
    return np.asarray(volume[(slice(None),) * axis + (index,)])


def _pairs_along(
    indicator: np.ndarray, axis: int, max_lag: int | None, periodic: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of the phase and pairs that fit, at lags 0 ... max_lag along an axis."""
    n = indicator.shape[axis]
    max_lag = n // 2 if max_lag is None else max_lag
    if not 0 <= max_lag < n:
        raise ValueError(f"largest lag {max_lag} does not fit in {n} pixels")
    lines = np.moveaxis(indicator, axis, -1)
    size = n if periodic else fft.next_fast_len(n + max_lag, real=True)
    power = np.zeros(size // 2 + 1)
    # Planes by planes, so that no transform of the whole volume is ever held.
    step = max(1, LINES_AT_ONCE // int(np.prod(lines.shape[1:-1])))
    for i in range(0, len(lines), step):
        spectrum = fft.rfft((lines[i : i + step] != 0).astype(float), size, axis=-1).reshape(-1, len(power))
        power += np.einsum("ij,ij->j", spectrum.real, spectrum.real)
        power += np.einsum("ij,ij->j", spectrum.imag, spectrum.imag)
    counts = np.rint(fft.irfft(power, size)[: max_lag + 1])
    fits = np.full(max_lag + 1, float(n)) if periodic else n - np.arange(max_lag + 1.0)
    return counts, fits * (indicator.size // n)


def _radial(solid: np.ndarray, reach: int, periodic: bool, block_bytes: int) -> tuple[np.ndarray, np.ndarray]:
    """S2 pooled over lag vectors in shells |r| = 0, 1, ... reach (each half a voxel to either side)."""
    spectrum, size = _lag_spectrum(solid, reach, periodic, block_bytes)
    offsets = np.arange(-reach, reach + 1)
    fits = [np.full(len(offsets), n) if periodic else n - np.abs(offsets) for n in solid.shape]
    plane_fits = np.outer(fits[1], fits[2]).astype(float)
    found, pairs, distance = np.zeros((3, reach + 1))
    for dz in range(reach + 1):
        counts = np.rint(fft.irfft(spectrum[dz], size, axis=-1)[:, offsets])
        r = np.sqrt(dz**2 + offsets[:, None] ** 2 + offsets[None, :] ** 2)
        shell = np.rint(r).astype(int).ravel()
        inside = shell <= reach
        twice = 2.0 if dz else 1.0  # the lag -r has the pairs of r
        fit = (twice * fits[0][reach + dz] * plane_fits).ravel()
        for total, weight in ((found, twice * counts.ravel()), (pairs, fit), (distance, fit * r.ravel())):
            total += np.bincount(shell[inside], weight[inside], reach + 1)
    return distance / pairs, found / pairs


def _lag_spectrum(solid: np.ndarray, reach: int, periodic: bool, block_bytes: int) -> tuple[np.ndarray, int]:
    """Pairs by lag along z (0 ... reach) and y (-reach ... reach), transformed along x, and the padded x.

    The frequencies along x have nothing to do with each other: a block of them at a time is transformed
    along y and z, multiplied with itself, and only the lags wanted are kept on the way back. What the padding
    of y and z takes is never there for all of the volume.
    """
    nz, ny, _ = solid.shape
    size = solid.shape if periodic else [fft.next_fast_len(n + reach, real=True) for n in solid.shape]
    kept = np.arange(-reach, reach + 1)
    frequencies = size[2] // 2 + 1
    spectrum = np.empty((reach + 1, len(kept), frequencies), complex)
    # of a frequency: the planes padded in y, twice where that is being done
    width = max(1, min(frequencies, block_bytes // (16 * 2 * nz * size[1])))
    planes = max(1, LINES_AT_ONCE // ny)
    rows = max(1, block_bytes // (16 * 8 * size[0] * width))
    for k in range(0, frequencies, width):
        block = slice(k, min(k + width, frequencies))
        along_x = np.empty((nz, ny, block.stop - k), complex)
        for z in range(0, nz, planes):
            lines = (solid[z : z + planes] != 0).astype(float)
            along_x[z : z + planes] = fft.rfft(lines, size[2], axis=-1)[..., block]
        along_y = fft.fft(along_x, size[1], axis=1)
        del along_x
        lags = np.empty((reach + 1, size[1], block.stop - k), complex)
        for y in range(0, size[1], rows):
            power = fft.fft(along_y[:, y : y + rows], size[0], axis=0)
            np.square(power.real, out=power.real)
            power.real += np.square(power.imag)
            power.imag = 0.0
            lags[:, y : y + rows] = fft.ifft(power, axis=0, overwrite_x=True)[: reach + 1]
        del along_y
        spectrum[..., block] = fft.ifft(lags, axis=1, overwrite_x=True)[:, kept]
    return spectrum, size[2]
