"""Touching grains, and the pores between them, parted by topological persistence of the distance map."""

from __future__ import annotations

import edt
import numpy as np
from numba import njit

from grainfall.errors import InputError

PERSISTENCE = 0.1
"""Default persistence of a grain or pore: share of the maximum's height above its saddle."""

MIN_RADIUS_PX = 2.0
"""Default resolution limit: objects of a smaller equivalent radius are specks, neither grain nor pore."""

DIGITISATION_PX = 1.0
"""Two distances measured to pixel centres differ by chance by up to one pixel: no maximum is finer."""


def split_grains(
    phase: np.ndarray,
    instances: np.ndarray | None = None,
    *,
    persistence: float = PERSISTENCE,
    min_radius_px: float = MIN_RADIUS_PX,
) -> np.ndarray:
    r"""Part the touching grains of every mineral.

    The distance map :math:`d` of a mineral (distance to the nearest pixel that is not of this mineral) has a
    maximum in every grain and a saddle in every neck. A maximum of height :math:`d_m` that is joined to a
    higher one through a saddle of height :math:`d_s` is a grain of its own if its persistence

    .. math:: d_m - d_s \ge \max(h\,d_m,\ 1\,\mathrm{px})

    and part of its neighbour across that saddle otherwise: an h-maxima transform whose height grows with the
    grain, so that the answer does not depend on the magnification. Grains are the basins of what remains.

    Parameters
    ----------
    phase : (y, x) ndarray of uint8
        0 pore, 1…M minerals. Grains of different minerals are never joined.
    instances : (y, x) ndarray of int, optional
        Outlined grains (0 none), where the input has them: they are taken as they are, and nothing is split.
        An outline that holds two minerals or two separate pieces counts as that many grains.
    persistence : float
        :math:`h` in [0, 1). 0 keeps every maximum that digitisation does not explain; towards 1 nothing is
        split.
    min_radius_px : float
        Specks of a smaller equivalent radius √(S/π), in pixels, get no label; pinholes (of pore or of another
        mineral, radius below 1 pixel as well) do not disturb the distance map of the grain around them. Their
        pixels stay what they are in `phase`, so area fractions are unharmed; :func:`coverage` says how many.

    Returns
    -------
    labels : (y, x) ndarray of int32
        0 where there is no grain, 1…n grains in order of their first pixel; each is one 4-connected piece
        (pinholes aside).

    Raises
    ------
    InputError
        When a parameter is out of its range or the arrays do not fit.
    """
    phase = _image(phase)
    if instances is None:
        # Holes below the uncertainty of distances only: larger ones may be the gap between three grains.
        pinhole = np.pi * min(min_radius_px, DIGITISATION_PX) ** 2
        healed = _heal(phase, _pieces(phase.astype(np.int32) + 1), pinhole)
        labels = _split(healed, persistence)
        return _resolved(np.where(healed == phase, labels, 0), min_radius_px)
    if np.shape(instances) != phase.shape:
        raise InputError("instances", f"shape {np.shape(instances)}", f"{phase.shape}, as the phase map")
    outlined = np.where(phase > 0, np.asarray(instances).astype(np.int64), 0)
    # One number for each (outline, mineral); pieces are told apart below.
    pairs = np.where(outlined > 0, outlined * (int(phase.max()) + 1) + phase, 0)
    return _resolved(_pieces(pairs), min_radius_px)


def split_pores(
    phase: np.ndarray, *, persistence: float = PERSISTENCE, min_radius_px: float = MIN_RADIUS_PX
) -> np.ndarray:
    """Part the pore space into pores, by the rule of :func:`split_grains`.

    Specks of solid count in full: what lies in a pore is an obstacle, however small.

    Parameters
    ----------
    phase : (y, x) ndarray of uint8
        0 pore, 1…M minerals.
    persistence, min_radius_px : float
        As for :func:`split_grains`.

    Returns
    -------
    labels : (y, x) ndarray of int32
        0 in the solid and in specks, 1…n pores.
    """
    return _resolved(_split((_image(phase) == 0).astype(np.uint8), persistence), min_radius_px)


def coverage(labels: np.ndarray, inside: np.ndarray) -> dict[str, float]:
    """How much of a phase the labels cover.

    Parameters
    ----------
    labels : (y, x) ndarray of int
        From :func:`split_grains` or :func:`split_pores`.
    inside : (y, x) ndarray of bool
        The pixels that were to be labelled: ``phase > 0`` or ``phase == 0``.

    Returns
    -------
    dict
        ``objects``: number of labels; ``speck_fraction``: share of the pixels inside that got none.
    """
    count = int(np.count_nonzero(inside))
    left = int(np.count_nonzero(inside & (labels == 0)))
    return {"objects": int(labels.max(initial=0)), "speck_fraction": left / count if count else 0.0}


def _image(phase: np.ndarray) -> np.ndarray:
    phase = np.asarray(phase)
    if phase.ndim != 2 or phase.dtype.kind not in "bui":
        raise InputError("phase", f"{phase.ndim}D array of {phase.dtype}", "a 2D array (y, x) of integers")
    return np.ascontiguousarray(phase, dtype=np.uint8)


def _split(phase: np.ndarray, persistence: float) -> np.ndarray:
    if not 0 <= persistence < 1:
        raise InputError("persistence", f"{persistence} is out of range", "0 ≤ persistence < 1")
    # A frame of pore stops the flood; the image's edge itself is no boundary of a grain (black_border=False).
    distance = np.pad(edt.edt(phase, black_border=False, parallel=1), 1)
    # Without any boundary the distance is infinite, or not defined: one object that fills the image.
    distance[~np.isfinite(distance)] = sum(phase.shape)
    framed = np.pad(phase, 1)
    distance[framed == 0] = 0
    flat = distance.ravel()
    inside = np.flatnonzero(flat)
    order = inside[np.argsort(-flat[inside], kind="stable")]
    labels = _flood(flat, framed.ravel(), order, distance.shape[1], persistence, DIGITISATION_PX)
    return labels.reshape(distance.shape)[1:-1, 1:-1]


@njit(cache=True)
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def _flood(distance, phase, order, width, persistence, floor):
    """Basins of the maxima of `distance` whose persistence is no less than its threshold.

    Pixels are taken in falling order of distance (one sweep of the superlevel sets). Each joins the basin of
    its highest neighbour, or opens a new one. Where two components of the superlevel set meet, the lower
    maximum dies (elder rule): `component` follows this merge tree. If it dies too young, its basin also joins
    the one across the saddle: `basin` follows these cancellations.
    """
    label = np.zeros(distance.size, np.int32)
    component = np.empty(order.size + 1, np.int32)
    basin = np.empty(order.size + 1, np.int32)
    top = np.empty(order.size + 1, np.float64)
    offsets = np.array([-width, -1, 1, width])
    count = 0
    for pixel in order:
        best = 0
        height = -1.0
        for step in offsets:
            near = pixel + step
            if label[near] > 0 and phase[near] == phase[pixel] and distance[near] > height:
                best, height = label[near], distance[near]
        if best == 0:
            count += 1
            label[pixel] = component[count] = basin[count] = count
            top[count] = distance[pixel]
            continue
        label[pixel] = best
        for step in offsets:
            near = pixel + step
            if label[near] == 0 or label[near] == best or phase[near] != phase[pixel]:
                continue
            elder, younger = _root(component, best), _root(component, label[near])
            if elder == younger:
                continue
            if top[younger] > top[elder]:
                elder, younger = younger, elder
            component[younger] = elder
            if top[younger] - distance[pixel] < max(persistence * top[younger], floor):
                basin[_root(basin, best)] = _root(basin, label[near])
    for pixel in order:
        label[pixel] = _root(basin, label[pixel])
    return label


def _pieces(values: np.ndarray) -> np.ndarray:
    """4-connected pieces of equal non-zero value."""
    from skimage.measure import label

    return label(values, background=0, connectivity=1)


@njit(cache=True)
def _heal(values, pieces, limit):
    """`values` with every piece of fewer pixels than `limit` replaced by what surrounds it."""
    healed = values.copy()
    rows, columns = values.shape
    area = np.zeros(pieces.max() + 1, np.int64)
    for i in range(rows):
        for j in range(columns):
            area[pieces[i, j]] += 1
    if area.max() < limit:
        return healed
    open_ = [(i, j) for i in range(rows) for j in range(columns) if area[pieces[i, j]] < limit]
    known = np.ones(values.shape, np.bool_)
    for i, j in open_:
        known[i, j] = False
    while len(open_) > 0:
        left = [(0, 0)][:0]
        for i, j in open_:
            for di, dj in ((-1, 0), (0, -1), (0, 1), (1, 0)):
                v, u = i + di, j + dj
                if 0 <= v < rows and 0 <= u < columns and known[v, u]:
                    healed[i, j] = healed[v, u]
                    known[i, j] = True
                    break
            else:
                left.append((i, j))
        open_ = left
    return healed


def smallest_radius(min_radius_px: float) -> float:
    """Equivalent radius, pixels, half-way in area between the largest speck and the smallest grain."""
    return float(np.sqrt(max(0.0, _least_area(min_radius_px) - 0.5) / np.pi))


def _least_area(min_radius_px: float) -> int:
    return int(np.ceil(np.pi * min_radius_px**2))


def _resolved(labels: np.ndarray, min_radius_px: float) -> np.ndarray:
    """Drop the specks and number the rest in order of their first pixel."""
    area = np.bincount(labels.ravel())
    keep = area >= _least_area(min_radius_px)
    keep[0] = False
    kept, first = np.unique(np.where(keep[labels], labels, 0).ravel(), return_index=True)
    first, kept = first[kept > 0], kept[kept > 0]
    number = np.zeros(area.size, np.int32)
    number[kept[np.argsort(first)]] = np.arange(1, kept.size + 1)
    return number[labels]
