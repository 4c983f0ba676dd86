"""Maximal inscribed circles of pores."""

from __future__ import annotations

import edt
import numpy as np
import pandas as pd
from numba import njit

from grainfall.errors import InputError
from grainfall.morphology.measure import sampling_weights


def inscribed_circles(labels: np.ndarray, pixel_size_um: float) -> pd.DataFrame:
    """The largest circle in the pore space that has its centre in each pore.

    The circle is the largest that holds no pixel centre of the solid, its own centre free to lie between
    pixel centres. Its radius is that of a disc to within 1 % from a radius of 8 pixels on; between flat walls
    it lies 0 to 0.5 pixel above the true one, which is unknown to that extent.

    Parameters
    ----------
    labels : (y, x) ndarray of int
        Pores 1…n; 0 is solid.
    pixel_size_um : float
        Edge of a pixel, µm.

    Returns
    -------
    DataFrame
        One row a pore, in order of the labels: ``pore``, ``y_um``, ``x_um`` (centre), ``area_um2`` (of the
        pore), ``r_um`` (of the circle), ``width_um``, ``height_um`` (of the circle), ``border`` (the image's
        edge cuts the circle) and ``weight`` (:func:`~grainfall.morphology.sampling_weights` of the circle,
        which is the object that is counted: it is known whole even where its pore runs out of the image).

    Raises
    ------
    InputError
        When the pixel size is not positive.
    """
    if not pixel_size_um > 0:
        raise InputError(
            "pixel_size_um", f"{pixel_size_um} is not a length", "a positive number of micrometres"
        )
    labels = np.ascontiguousarray(labels, dtype=np.int32)
    rows, columns = labels.shape
    distance = edt.edt((labels > 0).astype(np.uint8), black_border=False, parallel=1)
    distance[~np.isfinite(distance)] = rows + columns  # no solid at all: the circle outgrows the image
    area = np.bincount(labels.ravel())
    pores = np.flatnonzero(area)
    pores = pores[pores > 0]
    circles = _circles(labels, distance, area.size)[pores]
    y, x, r = circles.T
    border = (y - r < 0) | (x - r < 0) | (y + r > rows) | (x + r > columns)
    return pd.DataFrame(
        {
            "pore": pores,
            "y_um": y * pixel_size_um,
            "x_um": x * pixel_size_um,
            "area_um2": area[pores] * pixel_size_um**2,
            "r_um": r * pixel_size_um,
            "width_um": 2 * r * pixel_size_um,
            "height_um": 2 * r * pixel_size_um,
            "border": border,
            "weight": sampling_weights(2 * r, 2 * r, border, (columns, rows)),
        }
    )


@njit(cache=True)
def _circles(labels, distance, count):
    """(count, 3) y, x, r of every label's circle in pixels; pixel i has its centre at i + 0.5."""
    rows, columns = labels.shape
    peak = np.zeros((count, 2), np.int64)
    height = np.zeros(count)
    for i in range(rows):
        for j in range(columns):
            if distance[i, j] > height[labels[i, j]]:
                height[labels[i, j]] = distance[i, j]
                peak[labels[i, j]] = i, j
    angle = np.arange(16) * np.pi / 8
    sine, cosine = np.sin(angle), np.cos(angle)
    circles = np.zeros((count, 3))
    wall = np.empty((rows * columns, 2), np.int32)
    for k in range(1, count):
        # The solid pixels that can touch a circle whose centre is within one pixel of the peak.
        reach = height[k] + 2
        span = int(reach) + 1
        n = 0
        for i in range(max(peak[k, 0] - span, 0), min(peak[k, 0] + span + 1, rows)):
            for j in range(max(peak[k, 1] - span, 0), min(peak[k, 1] + span + 1, columns)):
                if labels[i, j] == 0 and (i - peak[k, 0]) ** 2 + (j - peak[k, 1]) ** 2 <= reach**2:
                    wall[n] = i, j
                    n += 1
        y, x, r = float(peak[k, 0]), float(peak[k, 1]), height[k]
        step = 0.5
        while step > 0.005 and n > 0:
            best, at = r, -1
            for a in range(16):
                v, u = y + step * sine[a], x + step * cosine[a]
                if abs(v - peak[k, 0]) > 0.7 or abs(u - peak[k, 1]) > 0.7:
                    continue
                near = np.inf
                for m in range(n):
                    near = min(near, (wall[m, 0] - v) ** 2 + (wall[m, 1] - u) ** 2)
                if near > best**2 + 1e-9:
                    best, at = np.sqrt(near), a
            if at < 0:
                step /= 2
            else:
                y, x, r = y + step * sine[at], x + step * cosine[at], best
        circles[k] = y + 0.5, x + 0.5, r
    return circles
