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
    pixel centres, within a pixel of the deepest one. Of several that are equally deep, as along a channel,
    the circle of middle size counts: the largest is where digitisation happens to leave most room. That
    bounds the true circle from above, for a wall lies somewhere between the outermost pixel centre of the
    pore and the innermost one of the solid: where the circle touches, half of this gap is taken off (half a
    pixel at a flat wall along the grid, next to nothing at a round one). On average the radius is then true
    to about 0.1 pixel for discs, channels and triangles alike.

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
    deepest = np.zeros(area.size, distance.dtype)
    np.maximum.at(deepest, labels.ravel(), distance.ravel())
    peaks = np.flatnonzero((labels > 0) & (distance == deepest[labels]))
    owner = labels.ravel()[peaks]
    peaks = peaks[np.argsort(owner, kind="stable")]
    start = np.append(0, np.cumsum(np.bincount(owner, minlength=area.size)[pores]))
    y, x, r = _circles(labels, distance, peaks, start).T
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
def _clearance(wall, count, y, x):
    """Distance from (y, x) to the nearest of the first `count` rows of `wall`."""
    nearest = np.inf
    for m in range(count):
        nearest = min(nearest, (wall[m, 0] - y) ** 2 + (wall[m, 1] - x) ** 2)
    return np.sqrt(nearest)


@njit(cache=True)
def _gap(labels, y, x, r, row, column):
    """What is left between the pore's pixel centres and the circle's rim, where it touches (row, column).

    The pore is looked at beside the point of contact as far as a flat wall leaves the circle by a quarter
    of a pixel: t²/2r = 1/4.
    """
    reach = max(1.0, np.sqrt(r / 2))
    box = int(reach) + 2
    along_y, along_x = (row - y) / r, (column - x) / r
    outermost = r - 1.0
    for i in range(max(row - box, 0), min(row + box + 1, labels.shape[0])):
        for j in range(max(column - box, 0), min(column + box + 1, labels.shape[1])):
            aside = (i - y) * along_x - (j - x) * along_y
            ahead = (i - y) * along_y + (j - x) * along_x
            distance = np.hypot(ahead, aside)
            if labels[i, j] > 0 and ahead > 0 and abs(aside) <= reach and distance <= r:
                outermost = max(outermost, distance)
    return r - outermost


_SINE, _COSINE = np.sin(np.arange(16) * np.pi / 8), np.cos(np.arange(16) * np.pi / 8)


@njit(cache=True)
def _circle(labels, row, column, depth, wall):
    """(y, x, r) of the circle about a pixel of that depth, its centre within a pixel; `wall` is scratch."""
    rows, columns = labels.shape
    # The solid pixels that can touch such a circle.
    reach = depth + 2
    span = int(reach) + 1
    n = 0
    for i in range(max(row - span, 0), min(row + span + 1, rows)):
        for j in range(max(column - span, 0), min(column + span + 1, columns)):
            if labels[i, j] == 0 and (i - row) ** 2 + (j - column) ** 2 <= reach**2:
                wall[n] = i, j
                n += 1
    if n == 0:
        return row + 0.5, column + 0.5, depth
    y, x, r = float(row), float(column), _clearance(wall, n, row, column)
    step = 0.5
    while step > 0.005:
        best, at = r, -1
        for a in range(len(_SINE)):
            v, u = y + step * _SINE[a], x + step * _COSINE[a]
            if abs(v - row) <= 0.7 and abs(u - column) <= 0.7:
                clear = _clearance(wall, n, v, u)
                if clear > best + 1e-9:
                    best, at = clear, a
        if at < 0:
            step /= 2
        else:
            y, x, r = y + step * _SINE[at], x + step * _COSINE[at], best
    contacts, gap = 0, 0.0
    for m in range(n):
        if np.hypot(wall[m, 0] - y, wall[m, 1] - x) <= r + 0.1:
            contacts += 1
            gap += _gap(labels, y, x, r, wall[m, 0], wall[m, 1])
    return y + 0.5, x + 0.5, r - gap / contacts / 2


@njit(cache=True)
def _circles(labels, distance, peaks, start):
    """(n, 3) y, x, r of each label's circle in pixels; pixel i has its centre at i + 0.5.

    `peaks` are the deepest pixels, as indices into the flat image, label by label from `start` on.
    """
    rows, columns = labels.shape
    circles = np.zeros((start.size - 1, 3))
    wall = np.empty((rows * columns, 2), np.int32)
    for k in range(start.size - 1):
        pixels = peaks[start[k] : start[k + 1]]
        deepest = distance[pixels[0] // columns, pixels[0] % columns]
        if deepest >= rows + columns:  # no solid at all
            pixels = pixels[:1]
        found = np.empty((pixels.size, 3))
        for i, pixel in enumerate(pixels):
            y, x, r = _circle(labels, pixel // columns, pixel % columns, deepest, wall)
            found[i, 0], found[i, 1], found[i, 2] = y, x, r
        circles[k] = found[np.argsort(found[:, 2], kind="mergesort")[(pixels.size - 1) // 2]]
    return circles
