"""From a pixel mask to one closed contour, and the two single-valued readings of that contour.

A contour is an (n, 2) float array of points (u, v), counter-clockwise, not repeated at the end, in units of
the radius of the circle of equal area, about the mask's centre. u runs along columns and v against rows.
"""

from __future__ import annotations

import numpy as np
import scipy
import skimage  # parts of both load when they are first used

MIN_PIXELS = 16
"""Smallest usable mask: below it, the pixels rather than the grain make the shape."""

MIN_WIDTH = 3
"""Smallest side of a usable mask's bounding box in pixels: thinner ones are lines."""

SMOOTHING_PX = 1.0
"""Gaussian width along the outline, in pixels: below one pixel a mask shows the steps of the grid, which as
facets and ledges of a 3D grain would roughen every section of it."""

_SCAN = 360  # rays per turn for judging a contour; one a degree, about a pixel on a mask of 115 px


class Unusable(ValueError):
    """A mask from which no grain can be made, with the reason."""


def mask_contour(mask: np.ndarray) -> np.ndarray:
    """The sub-pixel contour of a mask, holes filled, largest piece only.

    The half-level line between pixel centres, smoothed along its length by :data:`SMOOTHING_PX`, then scaled
    to the area of the mask: smoothing shrinks an outline, and the half-level line alone encloses half a pixel
    less than the mask, whatever its shape.

    Parameters
    ----------
    mask : (h, w) bool ndarray

    Returns
    -------
    (n, 2) float ndarray
        Contour in pixels about the area centroid, enclosing as many square pixels as the filled mask has.

    Raises
    ------
    Unusable
        Where the mask is empty, a speck or a line.
    """
    mask = np.pad(np.asarray(mask, dtype=bool), 1)
    pieces, count = scipy.ndimage.label(mask)
    if count == 0:
        raise Unusable("empty mask")
    if count > 1:
        mask = pieces == 1 + np.argmax(np.bincount(pieces.ravel())[1:])
    mask = scipy.ndimage.binary_fill_holes(mask)
    pixels = int(mask.sum())
    if pixels < MIN_PIXELS:
        raise Unusable(f"only {pixels} pixels, fewer than {MIN_PIXELS}")
    width = min(np.ptp(np.flatnonzero(mask.any(axis=a))) + 1 for a in (0, 1))
    if width < MIN_WIDTH:
        raise Unusable(f"only {width} pixels wide, fewer than {MIN_WIDTH}")
    (line,) = skimage.measure.find_contours(mask, 0.5)
    contour = line[:-1, ::-1] * (1.0, -1.0)  # rows run down, v runs up
    if polygon_moments(contour)[0] < 0:
        contour = contour[::-1]
    contour = _smoothed(contour)
    area, centroid, _ = polygon_moments(contour)
    return (contour - centroid) * np.sqrt(pixels / area)


def _smoothed(contour: np.ndarray) -> np.ndarray:
    """The outline at four points a pixel, filtered along its length."""
    closed = np.vstack([contour, contour[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    n = max(16, int(4 * along[-1]))
    even = np.arange(n) * along[-1] / n
    points = np.column_stack([np.interp(even, along, closed[:, k]) for k in (0, 1)])
    return scipy.ndimage.gaussian_filter1d(points, SMOOTHING_PX * n / along[-1], axis=0, mode="wrap")


def polygon_moments(polygon: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Signed area, centroid and central second moments of a polygon, exact.

    Parameters
    ----------
    polygon : (n, 2) float ndarray

    Returns
    -------
    area : float
        Positive where the polygon runs counter-clockwise.
    centroid : (2,) float ndarray
    covariance : (2, 2) float ndarray
        Second moments about the centroid over the area.
    """
    origin = polygon.mean(axis=0)
    a = polygon - origin
    b = np.roll(a, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area = cross.sum() / 2
    centroid = ((a + b) * cross[:, None]).sum(axis=0) / (6 * area)
    c = a + b
    second = (a.T * cross) @ a + (b.T * cross) @ b + (c.T * cross) @ c
    return area, centroid + origin, second / (24 * area) - np.outer(centroid, centroid)


def ray_radii(contour: np.ndarray, angles: np.ndarray) -> np.ndarray:
    r"""Area-true radius in each direction: :math:`\rho(\theta)^2 = 2\int 1_\text{mask}\, r\, dr`.

    It is the distance to the contour where the ray crosses it once. Where a ray leaves and enters again, the
    radius is that of the same area, which keeps the area of the whole and stays continuous in the angle as
    a fold comes into sight (the first or the last crossing would jump).

    Parameters
    ----------
    contour : (n, 2) float ndarray
        Around the origin.
    angles : (k,) float ndarray
        Directions in radians, from u towards v.

    Returns
    -------
    (k,) float ndarray
    """
    ray, radius, sign = _crossings(contour, angles)
    squares = np.bincount(ray, weights=sign * radius**2, minlength=len(angles))
    return np.sqrt(np.maximum(squares, 0.0))


def level_widths(contour: np.ndarray, levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Length of the mask to the right (u > 0) and to the left (u < 0) of the v axis at each height v.

    Parameters
    ----------
    contour : (n, 2) float ndarray
    levels : (k,) float ndarray
        Heights v.

    Returns
    -------
    right, left : (k,) float ndarray
        Each is the distance from the axis to the contour where the half-contour is single-valued in v.
    """
    # counter-clockwise: the right-hand outline runs upward
    level, u, up = _level_crossings(contour, levels)
    right = np.bincount(level, weights=up * np.maximum(u, 0), minlength=len(levels))
    left = np.bincount(level, weights=up * np.minimum(u, 0), minlength=len(levels))
    return np.maximum(right, 0.0), np.maximum(left, 0.0)


def star_overlap(contour: np.ndarray) -> float:
    """Intersection over union of the contour with its area-true star-shaped reading about the origin.

    1 where every ray from the origin crosses the contour once; 0 where the origin lies outside.
    """
    angles = np.linspace(0.0, 2 * np.pi, _SCAN, endpoint=False)
    ray, radius, sign = _crossings(contour, angles)
    squares = np.bincount(ray, weights=sign * radius**2, minlength=_SCAN)
    if squares.min() <= 0:
        return 0.0
    # the part of the mask within the reading's radius, ray by ray
    inner = np.minimum(radius**2, squares[ray])
    shared = np.bincount(ray, weights=sign * inner, minlength=_SCAN).sum()
    return float(shared / (2 * squares.sum() - shared))


def best_centre(contour: np.ndarray) -> tuple[np.ndarray, float]:
    """The contour about the centre from which most of it is seen, and its star overlap there.

    The centroid, or, where the mask is not star-shaped about it, the centre of the largest inscribed circle
    if that sees more (it always lies well inside, as a crescent's centroid does not).

    Parameters
    ----------
    contour : (n, 2) float ndarray
        About the centroid.

    Returns
    -------
    contour : (n, 2) float ndarray
    overlap : float
    """
    overlap = star_overlap(contour)
    if overlap > 0.995:
        return contour, overlap
    low = contour.min(axis=0)
    step = np.ptp(contour, axis=0).max() / 256
    grid = _raster(contour, low - step, step, np.ceil(np.ptp(contour, axis=0) / step).astype(int) + 3)
    distance = scipy.ndimage.distance_transform_edt(grid)
    row, column = np.unravel_index(np.argmax(distance), grid.shape)
    moved = contour - (low - step + step * (np.array([column, row]) + 0.5))
    other = star_overlap(moved)
    return (moved, other) if other > overlap else (contour, overlap)


def polygon_iou(a: np.ndarray, b: np.ndarray, resolution: int = 400) -> float:
    """Intersection over union of two polygons on a raster of ``resolution`` cells across their box."""
    points = np.vstack([a, b])
    low = points.min(axis=0)
    step = np.ptp(points, axis=0).max() / resolution
    shape = np.ceil(np.ptp(points, axis=0) / step).astype(int) + 1
    first, second = (_raster(p, low, step, shape) for p in (a, b))
    return float((first & second).sum() / (first | second).sum())


def _raster(polygon: np.ndarray, origin: np.ndarray, step: float, shape_uv: np.ndarray) -> np.ndarray:
    """Cells (v, u) whose centres lie inside a counter-clockwise polygon."""
    columns, rows = shape_uv
    uv = (polygon - origin) / step - 0.5  # cell centres at integers
    level, u, up = _level_crossings(uv, np.arange(rows))
    column = np.clip(np.ceil(u).astype(int), 0, columns)
    # the winding number of a cell counts the outlines crossed on the way to it from the left
    count = np.bincount(level * (columns + 1) + column, weights=-up, minlength=rows * (columns + 1))
    return count.reshape(rows, columns + 1).cumsum(axis=1)[:, :-1] > 0.5


def _level_crossings(contour: np.ndarray, levels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the contour crosses heights v: level, u, and +1 where it runs upward, −1 downward."""
    a, b = contour, np.roll(contour, -1, axis=0)
    edge, level = np.nonzero((a[:, 1, None] < levels) != (b[:, 1, None] < levels))
    a, b = a[edge], b[edge]
    u = a[:, 0] + (levels[level] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return level, u, np.where(b[:, 1] > a[:, 1], 1.0, -1.0)


def _crossings(contour: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where rays from the origin cross the contour: ray, radius, and +1 outward or −1 inward."""
    a, b = contour, np.roll(contour, -1, axis=0)
    direction = np.stack([np.cos(angles), np.sin(angles)])
    side_a = np.outer(a[:, 1], direction[0]) - np.outer(a[:, 0], direction[1])
    side_b = np.roll(side_a, -1, axis=0)
    edge, ray = np.nonzero((side_a < 0) != (side_b < 0))
    step = side_b[edge, ray] - side_a[edge, ray]
    radius = (a[edge, 0] * b[edge, 1] - a[edge, 1] * b[edge, 0]) / step
    ahead = radius > 0
    return ray[ahead], radius[ahead], np.sign(step[ahead])
