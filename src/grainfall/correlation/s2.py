"""Two-point probability S2(r) of an indicator: the chance that two points r apart are both solid.

S2 along an axis is a count of pairs over the number of pairs that fit, c(r) / (lines (n - r)). The counts are
correlations, taken by zero-padded FFT and rounded to the whole numbers they are: the result is exact to the
last division, whatever the order of the work, so that slices may be scattered in any chunks, and a volume's
pairs counted slab by slab.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod

import numpy as np
import pandas as pd
import scipy  # its parts load when they are first used

from grainfall.io import share

AXES = ("z", "y", "x")
LINES_AT_ONCE = 4096

BLOCK_BYTES = 2**32
"""Memory in which the lags of all directions are found, and as much again for their spectrum."""


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
    max_lag = indicator.shape[axis] // 2 if max_lag is None else max_lag
    counts = _counts_along(indicator, axis, max_lag, periodic)
    return counts / _fits_along(indicator.shape, axis, max_lag, periodic)


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
    counts = sum(_counts_along(indicator, axis, max_lag, periodic) for axis in (0, 1))
    return counts / sum(_fits_along(indicator.shape, axis, max_lag, periodic) for axis in (0, 1))


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
        slice (number), axis (the normal: z, y or x), lag_um, s2 (both in-plane axes pooled); no rows of no
        slices.
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
    if not curves:
        whole, real = np.empty(0, int), np.empty(0)
        return pd.DataFrame({"slice": whole, "axis": real.astype(str), "lag_um": real, "s2": real})
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
    counts = pair_counts(
        volume, max_lag, periodic=periodic, radial=radial, threads=threads, block_bytes=block_bytes
    )
    return s2_of_counts([counts], volume.shape, voxel_size_um, periodic=periodic)


def pair_counts(
    volume: np.ndarray,
    max_lag: int | None = None,
    *,
    part: int = 1,
    parts: int = 1,
    periodic: bool = False,
    radial: bool = True,
    threads: int = 1,
    block_bytes: int = BLOCK_BYTES,
) -> dict[str, np.ndarray]:
    """Pairs of the phase in one slab of a volume, by lag; those of all slabs add up to those of the volume.

    Along x and y, a slab has the pairs in its planes; over all directions, those whose lower point lies in
    its planes, for which it reads ``max_lag // 2`` planes beyond them. Along z, it has the pairs in its share
    of the rows, read from bottom to top, and needs no planes of others.

    Parameters
    ----------
    volume : (nz, ny, nx) array
        Non-zero where the phase is; of an open volume file, no more is read than this slab needs.
    max_lag : int, optional
        Largest lag in voxels; half the shortest edge if omitted.
    part, parts : int
        Which slab, from 1, of how many. There may be more of them than planes: some are empty then.
    periodic, radial, threads, block_bytes
        As :func:`s2_volume` takes them.

    Returns
    -------
    dict of str to (n,) int64
        Pairs at lags 0, 1, 2 ... voxels along x, y, z; on ``r``, where it was asked for, in shells of all
        directions.
    """
    max_lag = min(volume.shape) // 2 if max_lag is None else max_lag
    nz, ny, _ = volume.shape
    z0, z1 = share(nz, part, parts)
    rows = slice(*share(ny, part, parts))
    with scipy.fft.set_workers(threads):
        along_z = _counts_along(np.asarray(volume[:, rows]), 0, max_lag, periodic)
        end = z1 + (max_lag // 2 if radial else 0)
        planes = np.asarray(volume[z0:end])
        if periodic and end > nz:
            planes = np.concatenate([planes, volume[: end - nz]])
        own = planes[: z1 - z0]
        along_x, along_y = (_counts_along(own, axis, max_lag, periodic) for axis in (2, 1))
        counts = {"x": along_x, "y": along_y, "z": along_z}
        if radial:
            counts["r"] = _shell_counts(planes, len(own), max_lag // 2, periodic, block_bytes)
    return counts


def s2_of_counts(
    counts: Sequence[Mapping[str, np.ndarray]],
    shape: tuple[int, int, int],
    voxel_size_um: float,
    *,
    periodic: bool = False,
) -> pd.DataFrame:
    """S2 of a volume from the pairs counted in its slabs.

    Parameters
    ----------
    counts : sequence of mapping
        Of every slab, as :func:`pair_counts` gives them.
    shape : (nz, ny, nx)
        Of the whole volume.
    voxel_size_um : float
    periodic : bool
        As they were counted.

    Returns
    -------
    DataFrame
        As :func:`s2_volume`; any number of slabs gives the same bits.
    """
    curves = []
    for name in (name for name in "xyzr" if name in counts[0]):
        found = sum(slab[name] for slab in counts)
        last = len(found) - 1
        if name == "r":
            lag, pairs = _shells(shape, last, periodic)
        else:
            lag, pairs = np.arange(last + 1.0), _fits_along(shape, AXES.index(name), last, periodic)
        curves.append(pd.DataFrame({"axis": name, "lag_um": lag * voxel_size_um, "s2": found / pairs}))
    return pd.concat(curves, ignore_index=True)


def along_axes(table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the curves along x, y and z.

    Parameters
    ----------
    table : DataFrame
        As :func:`s2_volume` gives it.

    Returns
    -------
    lag_um, s2 : (n,) float
    """
    mean = table[table["axis"].isin(AXES)].groupby("lag_um")["s2"].mean()
    return mean.index.to_numpy(), mean.to_numpy()


def surface_from_s2(lag_um: np.ndarray, s2: np.ndarray) -> float:
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


def _counts_along(indicator: np.ndarray, axis: int, max_lag: int, periodic: bool) -> np.ndarray:
    """Pairs of the phase at lags 0 ... max_lag along an axis."""
    n = indicator.shape[axis]
    if not 0 <= max_lag < n:
        raise ValueError(f"largest lag {max_lag} does not fit in {n} pixels")
    lines = np.atleast_2d(np.moveaxis(indicator, axis, -1))
    size = n if periodic else scipy.fft.next_fast_len(n + max_lag, real=True)
    power = np.zeros(size // 2 + 1)
    # Planes by planes, so that no transform of the whole volume is ever held.
    step = max(1, LINES_AT_ONCE // prod(lines.shape[1:-1]))
    for i in range(0, len(lines), step):
        spectrum = scipy.fft.rfft((lines[i : i + step] != 0).astype(float), size, axis=-1).reshape(
            -1, len(power)
        )
        power += np.einsum("ij,ij->j", spectrum.real, spectrum.real)
        power += np.einsum("ij,ij->j", spectrum.imag, spectrum.imag)
    return np.rint(scipy.fft.irfft(power, size)[: max_lag + 1]).astype(np.int64)


def _fits_along(shape: Sequence[int], axis: int, max_lag: int, periodic: bool) -> np.ndarray:
    """Pairs that fit at lags 0 ... max_lag along an axis."""
    n = shape[axis]
    fits = np.full(max_lag + 1, float(n)) if periodic else n - np.arange(max_lag + 1.0)
    return fits * (prod(shape) // n)


def _shells(shape: Sequence[int], reach: int, periodic: bool) -> tuple[np.ndarray, np.ndarray]:
    """Of the lags in shells |r| = 0, 1, ... reach (each one voxel thick): mean length, pairs that fit."""
    offsets = np.arange(-reach, reach + 1)
    fits = [np.full(len(offsets), n) if periodic else n - np.abs(offsets) for n in shape]
    plane_fits = np.outer(fits[1], fits[2]).astype(float)
    pairs, distance = np.zeros((2, reach + 1))
    for dz in range(reach + 1):
        twice = 2.0 if dz else 1.0  # the lag -r has the pairs of r
        shell, r = _shells_at(dz, reach)
        inside = shell <= reach
        fit = (twice * fits[0][reach + dz] * plane_fits).ravel()
        for total, weight in ((pairs, fit), (distance, fit * r)):
            total += np.bincount(shell[inside], weight[inside], reach + 1)
    return distance / pairs, pairs


def _shells_at(dz: int, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Shell and length of the lags (dz, -reach ... reach, -reach ... reach), raveled."""
    square = np.arange(-reach, reach + 1) ** 2
    r = np.sqrt(dz**2 + square[:, None] + square[None, :]).ravel()
    return np.rint(r).astype(int), r


def _shell_counts(planes: np.ndarray, own: int, reach: int, periodic: bool, block_bytes: int) -> np.ndarray:
    """Pairs in shells |r| = 0, 1, ... reach whose lower point lies in the first ``own`` planes."""
    found = np.zeros(reach + 1, np.int64)
    if own == 0:
        return found
    offsets = np.arange(-reach, reach + 1)
    # as many lags along z at a time as their spectrum has room for
    step = max(1, block_bytes // (16 * len(offsets) * (planes.shape[2] + reach)))
    for first in range(0, reach + 1, step):
        lags = range(first, min(first + step, reach + 1))
        spectrum, size = _lag_spectrum(planes, own, lags, reach, periodic, block_bytes)
        for dz, lines in zip(lags, spectrum, strict=True):
            counts = np.rint(scipy.fft.irfft(lines, size, axis=-1)[:, offsets]).ravel()
            shell, _ = _shells_at(dz, reach)
            inside = shell <= reach
            twice = 2.0 if dz else 1.0  # the lag -r has the pairs of r
            found += np.bincount(shell[inside], twice * counts[inside], reach + 1).astype(np.int64)
    return found


def _lag_spectrum(
    planes: np.ndarray, own: int, lags: range, reach: int, periodic: bool, block_bytes: int
) -> tuple[np.ndarray, int]:
    """Pairs by lag along z (``lags``) and y (-reach ... reach), transformed along x, and the padded x.

    The lower point of a pair lies in the first ``own`` planes. The frequencies along x have nothing to do
    with each other: a block of them at a time is transformed along y and z, multiplied, and only the lags
    wanted are kept on the way back. What the padding of y and z takes is never there for all of the volume.
    """
    planes = planes[: own + lags[-1]]
    nz, ny, nx = planes.shape
    size_y, size_x = (n if periodic else scipy.fft.next_fast_len(n + reach, real=True) for n in (ny, nx))
    size_z = scipy.fft.next_fast_len(own + len(lags) - 1, real=True)
    kept = np.arange(-reach, reach + 1)
    frequencies = size_x // 2 + 1
    spectrum = np.empty((len(lags), len(kept), frequencies), complex)
    # of a frequency: the planes padded in y, twice where that is being done
    width = max(1, min(frequencies, block_bytes // (16 * 2 * nz * size_y)))
    at_once = max(1, LINES_AT_ONCE // ny)
    rows = max(1, block_bytes // (16 * 8 * size_z * width))
    for k in range(0, frequencies, width):
        block = slice(k, min(k + width, frequencies))
        along_x = np.empty((nz, ny, block.stop - k), complex)
        for z in range(0, nz, at_once):
            lines = (planes[z : z + at_once] != 0).astype(float)
            along_x[z : z + at_once] = scipy.fft.rfft(lines, size_x, axis=-1)[..., block]
        along_y = scipy.fft.fft(along_x, size_y, axis=1)
        del along_x
        by_lag = np.empty((len(lags), size_y, block.stop - k), complex)
        for y in range(0, size_y, rows):
            upper = scipy.fft.fft(along_y[lags[0] :, y : y + rows], size_z, axis=0)
            same = lags[0] == 0 and own == nz  # of a whole volume
            lower = upper if same else scipy.fft.fft(along_y[:own, y : y + rows], size_z, axis=0)
            for above, below in zip(upper, lower, strict=True):
                above *= below.conj()
            by_lag[:, y : y + rows] = scipy.fft.ifft(upper, axis=0, overwrite_x=True)[: len(lags)]
        del along_y
        spectrum[..., block] = scipy.fft.ifft(by_lag, axis=1, overwrite_x=True)[:, kept]
    return spectrum, size_x
