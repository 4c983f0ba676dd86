"""The section against slices of its twins, on equal terms: one pixel size, one window.

S2 curves are exchangeable only where they were measured alike. So section and slices are sampled at the
coarser of the two pixel sizes (the nearest pixel's value at each new centre: a voxel is such a point sample
of the solid too, so the phase fraction keeps its mean and the image stays binary, which interpolated grey
values would not), and curves come from windows of one shape that fits in both. Where the section is larger
it is cut into disjoint windows, where the twin is larger a window is placed at random in each slice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from grainfall.correlation.envelope import fraction_inside, global_envelope
from grainfall.correlation.s2 import plane, s2_image
from grainfall.random import slices
from grainfall.section.resample import resample, resampled_edge


@dataclass(frozen=True)
class Window:
    """Pixels (y, x) of a window and the size of its pixels."""

    shape: tuple[int, int]
    pixel_size_um: float

    @property
    def max_lag(self) -> int:
        """Largest lag in pixels: half the shorter edge."""
        return min(self.shape) // 2

    @property
    def lag_um(self) -> np.ndarray:
        """Lags of the window's curves."""
        return np.arange(self.max_lag + 1) * self.pixel_size_um


def common_window(
    section_shape: tuple[int, int],
    pixel_size_um: float,
    volume_shape: tuple[int, int, int],
    voxel_size_um: float,
) -> Window:
    """The largest window, at the coarser pixel size, that the section and the volume's shortest edge hold.

    Parameters
    ----------
    section_shape : (y, x)
    pixel_size_um : float
        Of the section.
    volume_shape : (z, y, x)
    voxel_size_um : float
        Of the volume.

    Returns
    -------
    Window
    """
    size = max(pixel_size_um, voxel_size_um)
    edge = resampled_edge(min(volume_shape), voxel_size_um, size)
    return Window(tuple(min(resampled_edge(n, pixel_size_um, size), edge) for n in section_shape), size)


def section_windows(image: np.ndarray, shape: tuple[int, int]) -> list[np.ndarray]:
    """Disjoint windows of an image, as many as fit, the grid centred; the middle one first.

    Parameters
    ----------
    image : (y, x) array
    shape : (y, x)
        Of a window.

    Returns
    -------
    list of ``shape`` arrays
    """
    counts = [n // w for n, w in zip(image.shape, shape, strict=True)]
    first = [(n - c * w) // 2 for n, c, w in zip(image.shape, counts, shape, strict=True)]
    grid = list(np.ndindex(*counts))
    middle = (counts[0] // 2, counts[1] // 2)
    grid.sort(key=lambda c: (c != middle, c))
    return [
        image[
            first[0] + i * shape[0] : first[0] + (i + 1) * shape[0],
            first[1] + j * shape[1] : first[1] + (j + 1) * shape[1],
        ]
        for i, j in grid
    ]


def section_curves(solid: np.ndarray, pixel_size_um: float, window: Window) -> np.ndarray:
    """S2 of the section's disjoint windows, the middle one first.

    Parameters
    ----------
    solid : (y, x) array
        Non-zero where the section is solid.
    pixel_size_um : float
    window : Window

    Returns
    -------
    (n, max_lag + 1) float
    """
    image = resample(np.asarray(solid) != 0, pixel_size_um, window.pixel_size_um)
    return np.array([s2_image(w, window.max_lag) for w in section_windows(image, window.shape)])


def slice_curves(
    volume: np.ndarray, voxel_size_um: float, window: Window, n: int, rng: np.random.Generator
) -> np.ndarray:
    """S2 of a window placed at random in each of ``n`` random slices.

    Parameters
    ----------
    volume : (nz, ny, nx) array
        Non-zero where the twin is solid.
    voxel_size_um : float
    window : Window
    n : int
        Slices, spread over the three axes.
    rng : numpy.random.Generator

    Returns
    -------
    (n, max_lag + 1) float
    """
    curves = []
    for axis, index in slices(rng, volume.shape, n):
        image = resample(plane(volume, axis, index) != 0, voxel_size_um, window.pixel_size_um)
        y, x = (int(rng.integers(m - w + 1)) for m, w in zip(image.shape, window.shape, strict=True))
        curves.append(s2_image(image[y : y + window.shape[0], x : x + window.shape[1]], window.max_lag))
    return np.array(curves)


def compare_section(
    solid: np.ndarray,
    pixel_size_um: float,
    volumes: Sequence[np.ndarray],
    voxel_size_um: float,
    n_slices: int,
    rng: np.random.Generator,
    alpha: float = 0.05,
) -> tuple[pd.DataFrame, dict]:
    """Test the section's S2 against slices of several realizations.

    Parameters
    ----------
    solid : (y, x) array
        Non-zero where the section is solid.
    pixel_size_um : float
    volumes : sequence of (nz, ny, nx) arrays
        Twins, one per realization, non-zero where solid; gone through twice, one after the other.
    voxel_size_um : float
        Of every twin.
    n_slices : int
        Slices in all, shared out evenly (rounded up).
    rng : numpy.random.Generator
    alpha : float
        Level of the envelope.

    Returns
    -------
    table : DataFrame
        lag_um, observed (the middle window), lower, upper, mean (of the slices), section (mean of its
        windows).
    summary : dict
        p of the middle window; inside (fraction of its lags in the cloud of all slices); alpha, n_slices,
        n_volumes; window_um (y, x), pixel_size_um; n_windows of the section and windows_rejected, the
        fraction of them with p <= alpha, about alpha where section and twins are alike.

    Notes
    -----
    The observed curve is that of the section's middle window, chosen before looking. A mean over the
    section's windows would scatter less than single slices do and is not exchangeable with them. Slices of
    one realization are not independent of each other either: more realizations, not more slices, widen the
    cloud to its true width.
    """
    shape = tuple(min(edges) for edges in zip(*(v.shape for v in volumes), strict=True))
    window = common_window(solid.shape, pixel_size_um, shape, voxel_size_um)
    each = -(-n_slices // len(volumes))
    curves = np.concatenate([slice_curves(v, voxel_size_um, window, each, rng) for v in volumes])
    observed = section_curves(solid, pixel_size_um, window)
    test = global_envelope(observed[0], curves, alpha)
    rejected = [global_envelope(curve, curves, alpha)["p"] <= alpha for curve in observed]
    table = pd.DataFrame(
        {
            "lag_um": window.lag_um,
            "observed": observed[0],
            **{k: test[k] for k in ("lower", "upper", "mean")},
            "section": observed.mean(axis=0),
        }
    )
    return table, {
        "p": test["p"],
        "inside": fraction_inside(observed[0], curves),
        "alpha": float(alpha),
        "n_slices": len(curves),
        "n_volumes": len(volumes),
        "window_um": [n * window.pixel_size_um for n in window.shape],
        "pixel_size_um": window.pixel_size_um,
        "n_windows": len(observed),
        "windows_rejected": float(np.mean(rejected)),
    }
