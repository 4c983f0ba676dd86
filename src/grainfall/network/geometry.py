"""Sizes, areas, lengths and shapes of pores and throats, measured on the voxels of a partition.

All in voxels here; coordinates are (x, y, z). What is measured how:

- Radii are distances to the centres of the nearest solid voxels: without bias for the middle of the sizes
  between one voxel and the next, and never off by more than half a voxel across a slit.
- The pore's wall is the sum of its voxel faces, each weighted by the cosine between the face's normal and the
  surface's (Flin et al. 2005), which is Sobel's gradient of the image at the face.
- A throat's cross-section is the length of its vector area, the sum of the faces' normals: exact for a plane
  however ragged its voxels, and the area seen along the throat for a curved interface.
- A throat's perimeter is the length of the rim where its interface meets the solid, the sum of the rim's
  edges projected onto the tangent that is at right angles to the throat and to the wall's normal: exact for a
  smooth rim however ragged its voxels. It is no less than that of the circle of the same area.
- Shape factors are G = A / P^2 for throats and G = V L / A_s^2 for pores, with A_s the wall and L twice the
  distance from the centre to the farthest voxel (Oren & Bakke 2003), and no more than a circle's, 1 / (4 pi).
"""

from __future__ import annotations

import numpy as np
import skimage  # its parts load when they are first used
from numba import njit

from grainfall.network.partition import Partition, surroundings
from grainfall.network.topology import Interfaces

CIRCLE = 1 / (4 * np.pi)
"""Shape factor of a circle, the largest there is."""

SAME = 1e-9
"""Squared distances from a mean that differ by less differ by rounding; then the surroundings decide."""


def measure_pores(parts: Partition) -> dict[str, np.ndarray]:
    """Properties of the pores of a partition, in voxels.

    Returns
    -------
    dict of str to (n,) ndarray
        OpenPNM's names without ``pore.``; ``coords`` (n, 3) is the voxel of the largest sphere, where several
        hold it the one nearest to their mean.
    """
    peak = parts.squared_distance.reshape(-1)[parts.peaks].astype(float)
    volume, wall, mean = _bulk(parts.labels, parts.squared_distance, peak)
    centre = _nearest_peaks(parts.labels, parts.squared_distance, peak, mean)
    reach = 2 * np.sqrt(_farthest(parts.labels, centre)) + 1
    radius = np.sqrt(peak)
    shape = np.full(len(peak), CIRCLE)
    np.divide(volume * reach, wall**2, out=shape, where=wall > 0)
    return {
        "coords": centre[:, ::-1] + 0.5,
        "volume": volume,
        "surface_area": wall,
        "inscribed_diameter": 2 * radius,
        "extended_diameter": 2 * radius,
        "equivalent_diameter": np.cbrt(6 * volume / np.pi),
        "shape_factor": np.minimum(shape, CIRCLE),
    }


def measure_throats(parts: Partition, found: Interfaces) -> dict[str, np.ndarray]:
    """Properties of the throats of a partition, in voxels.

    Returns
    -------
    dict of str to (m,) ndarray
        OpenPNM's names without ``throat.``; ``coords`` (m, 3) is the middle of the face of the largest
        sphere, where several hold it of the one nearest to their mean.
    """
    faces = (found.voxels, found.axes, found.throats)
    vector, count, radius, place = _faces(parts.labels, parts.squared_distance, *faces, found.saddles)
    area = np.linalg.norm(vector, axis=1)
    # the interface around an enclosed pore has no vector area: take the mean shadow of a convex body, a
    # quarter of its surface, which is 2/3 of its voxel faces
    closed = area == 0
    perimeter = _rims(parts.labels, *faces, vector / np.where(closed, 1, area)[:, None])
    area[closed] = count[closed] / 6
    return {"coords": place[:, ::-1]} | _sections(radius, area, perimeter)


def measure_openings(parts: Partition) -> list[dict[str, np.ndarray]]:
    """Where pores open onto the six faces of the image, in the order xmin, xmax, ymin, ymax, zmin, zmax.

    Returns
    -------
    list of dict
        Per face of the image, as :func:`measure_throats`, one entry per connected patch of a pore on the
        face, and ``pore`` (k,) int, from 0.
    """
    found = []
    for axis in (2, 1, 0):
        for side in (0, 1):
            pores = parts.labels.take(-side, axis)
            squared = parts.squared_distance.take(-side, axis)
            patches = skimage.measure.label(pores, background=0, connectivity=1)
            n = int(patches.max())
            pore, area, rim, peak, mean = _patches(parts.labels, axis, side, patches, squared, n)
            spot = _nearest_in_patches(patches, squared, peak, mean)
            place = np.insert(spot + 0.5, axis, 0.0 if side == 0 else parts.labels.shape[axis], axis=1)
            found.append({"pore": pore - 1, "coords": place[:, ::-1]} | _sections(np.sqrt(peak), area, rim))
    return found


def _sections(radius: np.ndarray, area: np.ndarray, perimeter: np.ndarray) -> dict[str, np.ndarray]:
    perimeter = np.maximum(perimeter, 2 * np.sqrt(np.pi * area))
    return {
        "inscribed_diameter": 2 * radius,
        "cross_sectional_area": area,
        "perimeter": perimeter,
        "equivalent_diameter": 2 * np.sqrt(area / np.pi),
        "shape_factor": area / perimeter**2,
    }


@njit(cache=True)
def _normal(labels, z, y, x, axis, side):
    """Unit normal of the wall, into the solid, at a face of a pore voxel beyond which there is solid.

    Sobel's gradients at the pore voxel and at the solid one added: derivative (-1, -1, 1, 1) and smoothing
    (1, 3, 3, 1) across the face, (-1, 0, 1) and (1, 2, 1) along it. The image goes on beyond its faces.
    """
    nz, ny, nx = labels.shape
    across, one, other = 0.0, 0.0, 0.0
    for i in range(-1, 3):
        smooth = 3.0 if 0 <= i < 2 else 1.0
        slope = 1.0 if i > 0 else -1.0
        for j in range(-1, 2):
            for k in range(-1, 2):
                if axis == 0:
                    a, b, c = z + side * i, y + j, x + k
                elif axis == 1:
                    a, b, c = z + j, y + side * i, x + k
                else:
                    a, b, c = z + j, y + k, x + side * i
                a, b, c = min(max(a, 0), nz - 1), min(max(b, 0), ny - 1), min(max(c, 0), nx - 1)
                if labels[a, b, c] == 0:
                    across += slope * (2 - abs(j)) * (2 - abs(k))
                    one += smooth * j * (2 - abs(k))
                    other += smooth * (2 - abs(j)) * k
    if across <= 0:  # a wall so thin that there is no telling how it lies
        across, one, other = 1.0, 0.0, 0.0
    length = np.sqrt(across**2 + one**2 + other**2)
    across, one, other = side * across / length, one / length, other / length
    if axis == 0:
        return across, one, other
    if axis == 1:
        return one, across, other
    return one, other, across


@njit(cache=True)
def _wall(labels, z, y, x):
    """Area of the wall in a pore voxel."""
    area = 0.0
    for axis in range(3):
        for side in (-1, 1):
            a, b, c = z, y, x
            if axis == 0:
                a += side
            elif axis == 1:
                b += side
            else:
                c += side
            if not (0 <= a < labels.shape[0] and 0 <= b < labels.shape[1] and 0 <= c < labels.shape[2]):
                continue
            if labels[a, b, c] == 0:
                area += abs(_normal(labels, z, y, x, axis, side)[axis])
    return area


@njit(cache=True)
def _bulk(labels, squared, peak):
    """Volume, wall area and mean place of the highest voxels of every pore."""
    nz, ny, nx = labels.shape
    volume, wall = np.zeros(peak.size), np.zeros(peak.size)
    mean, highest = np.zeros((peak.size, 3)), np.zeros(peak.size)
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                p = labels[z, y, x] - 1
                if p < 0:
                    continue
                volume[p] += 1
                if squared[z, y, x] == peak[p]:
                    highest[p] += 1
                    mean[p, 0] += z
                    mean[p, 1] += y
                    mean[p, 2] += x
                if squared[z, y, x] > 1:
                    continue
                wall[p] += _wall(labels, z, y, x)
    for p in range(peak.size):
        mean[p] /= highest[p]
    return volume, wall, mean


@njit(cache=True)
def _nearest_peaks(labels, squared, peak, mean):
    """Of the highest voxels of every pore the one nearest to their mean."""
    flat, shape = squared.reshape(-1), labels.shape
    centre = np.zeros((peak.size, 3), np.int64)
    least, around = np.full(peak.size, np.inf), np.zeros(peak.size, np.int64)
    for z in range(shape[0]):
        for y in range(shape[1]):
            for x in range(shape[2]):
                p = labels[z, y, x] - 1
                if p < 0 or squared[z, y, x] != peak[p]:
                    continue
                away = (z - mean[p, 0]) ** 2 + (y - mean[p, 1]) ** 2 + (x - mean[p, 2]) ** 2
                if away > least[p] + SAME:
                    continue
                higher = surroundings(flat, shape, (z * shape[1] + y) * shape[2] + x)
                if away < least[p] - SAME or higher > around[p]:
                    least[p], around[p] = away, higher
                    centre[p, 0], centre[p, 1], centre[p, 2] = z, y, x
    return centre


@njit(cache=True)
def _farthest(labels, centre):
    """Squared distance from the centre of every pore to its farthest voxel."""
    reach = np.zeros(centre.shape[0])
    for z in range(labels.shape[0]):
        for y in range(labels.shape[1]):
            for x in range(labels.shape[2]):
                p = labels[z, y, x] - 1
                if p >= 0:
                    away = (z - centre[p, 0]) ** 2 + (y - centre[p, 1]) ** 2 + (x - centre[p, 2]) ** 2
                    reach[p] = max(reach[p], away)
    return reach


@njit(cache=True)
def _faces(labels, squared, voxels, axes, throats, saddles):
    """Vector area, number of faces, radius and place of the widest face of every throat."""
    flat, distance = labels.reshape(-1), squared.reshape(-1)
    _, ny, nx = labels.shape
    steps = np.array([ny * nx, nx, 1])
    m = saddles.size
    vector, count = np.zeros((m, 3)), np.zeros(m)
    mean, highest = np.zeros((m, 3)), np.zeros(m)
    place, least, around = np.zeros((m, 3)), np.full(m, np.inf), np.zeros(m, np.int64)
    peak = np.empty(m)
    for t in range(m):
        v, axis = voxels[saddles[t]], axes[saddles[t]]
        peak[t] = min(distance[v], distance[v + steps[axis]])
    for f in range(voxels.size):
        v, axis, t = voxels[f], axes[f], throats[f]
        w = v + steps[axis]
        vector[t, axis] += _side(flat[v], flat[w])
        count[t] += 1
        if min(distance[v], distance[w]) == peak[t]:
            highest[t] += 1
            at = _middle(v, axis, ny, nx)
            for k in range(3):
                mean[t, k] += at[k]
    for t in range(m):
        mean[t] /= highest[t]
    for f in range(voxels.size):
        v, axis, t = voxels[f], axes[f], throats[f]
        if min(distance[v], distance[v + steps[axis]]) == peak[t]:
            at = _middle(v, axis, ny, nx)
            away = (at[0] - mean[t, 0]) ** 2 + (at[1] - mean[t, 1]) ** 2 + (at[2] - mean[t, 2]) ** 2
            if away > least[t] + SAME:
                continue
            higher = surroundings(distance, labels.shape, v)
            higher += surroundings(distance, labels.shape, v + steps[axis])
            if away < least[t] - SAME or higher > around[t]:
                least[t], around[t] = away, higher
                place[t, 0], place[t, 1], place[t, 2] = at
    return vector, count, np.sqrt(peak), place


@njit(cache=True)
def _side(here, there):
    """Sense of a face from the lower pore to the higher; a cut through a ring has no sides."""
    return 1 if here <= there else -1


@njit(cache=True)
def _middle(v, axis, ny, nx):
    """Middle of the face between a voxel and the next along an axis."""
    z = v // (ny * nx)
    y = v // nx - z * ny
    x = v - (z * ny + y) * nx
    return z + (1.0 if axis == 0 else 0.5), y + (1.0 if axis == 1 else 0.5), x + (1.0 if axis == 2 else 0.5)


@njit(cache=True)
def _rims(labels, voxels, axes, throats, normals):
    """Length of the rim of every throat on the wall: the integral of its tangent along the rim's edges."""
    flat = labels.reshape(-1)
    size = np.array(labels.shape)
    _, ny, nx = labels.shape
    steps = np.array([ny * nx, nx, 1])
    rim = np.zeros(normals.shape[0])
    at = np.empty(3, np.int64)
    for f in range(voxels.size):
        v, axis, t = voxels[f], axes[f], throats[f]
        w = v + steps[axis]
        sense = _side(flat[v], flat[w])
        n = normals[t]
        at[0] = v // steps[0]
        at[1] = (v - at[0] * steps[0]) // nx
        at[2] = v - at[0] * steps[0] - at[1] * nx
        for along in range(3):
            if along == axis:
                continue
            for side in (-1, 1):
                if not 0 <= at[along] + side < size[along]:
                    continue
                step = side * steps[along]
                a, b, c = 0.0, 0.0, 0.0
                for other in range(2):
                    if flat[(w if other else v) + step] == 0:
                        at[axis] += other
                        da, db, dc = _normal(labels, at[0], at[1], at[2], along, side)
                        at[axis] -= other
                        a, b, c = a + da, b + db, c + dc
                if a == b == c == 0:
                    continue
                # tangent n x m; the edge is the boundary of the face: its normal x the way out of it
                p, q, r = n[1] * c - n[2] * b, n[2] * a - n[0] * c, n[0] * b - n[1] * a
                length = np.sqrt(p * p + q * q + r * r)
                third = 3 - axis - along
                turn = 1 if (axis + 1) % 3 == along else -1
                if length > 0:
                    tangent = p if third == 0 else q if third == 1 else r
                    rim[t] += sense * side * turn * tangent / length
    return np.abs(rim)


@njit(cache=True)
def _patches(labels, axis, side, patches, squared, n):
    """Pore, area, rim, highest squared distance and its mean place for every patch on a face."""
    ny, nx = patches.shape
    layer = side * (labels.shape[axis] - 1)
    pore, area, rim = np.zeros(n, np.int64), np.zeros(n), np.zeros(n)
    peak, mean, highest = np.zeros(n), np.zeros((n, 2)), np.zeros(n)
    one, other = 1 if axis == 0 else 0, 1 if axis == 2 else 2
    for y in range(ny):
        for x in range(nx):
            p = patches[y, x] - 1
            if p < 0:
                continue
            if axis == 0:
                a, b, c = layer, y, x
            elif axis == 1:
                a, b, c = y, layer, x
            else:
                a, b, c = y, x, layer
            pore[p] = labels[a, b, c]
            area[p] += 1
            for way in range(4):
                dy, dx = (way - 1 if way % 2 == 0 else 0), (way - 2 if way % 2 else 0)
                if not (0 <= y + dy < ny and 0 <= x + dx < nx) or patches[y + dy, x + dx] > 0:
                    continue
                along = one if dx == 0 else other
                m = _normal(labels, a, b, c, along, dy + dx)
                rim[p] += abs(m[along]) / np.sqrt(m[one] ** 2 + m[other] ** 2)
            if squared[y, x] > peak[p]:
                peak[p], highest[p], mean[p] = squared[y, x], 0, 0
            if squared[y, x] == peak[p]:
                highest[p] += 1
                mean[p, 0] += y
                mean[p, 1] += x
    for p in range(n):
        mean[p] /= highest[p]
    return pore, area, rim, peak, mean


@njit(cache=True)
def _nearest_in_patches(patches, squared, peak, mean):
    """Of the highest pixels of every patch the one nearest to their mean."""
    spot, least = np.zeros((peak.size, 2)), np.full(peak.size, np.inf)
    for y in range(patches.shape[0]):
        for x in range(patches.shape[1]):
            p = patches[y, x] - 1
            if p < 0 or squared[y, x] != peak[p]:
                continue
            away = (y - mean[p, 0]) ** 2 + (x - mean[p, 1]) ** 2
            if away < least[p]:
                least[p] = away
                spot[p, 0], spot[p, 1] = y, x
    return spot
