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

from grainfall.network.partition import Partition, grown, surroundings
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
    labels, squared = parts.labels, parts.squared_distance
    peak = squared.reshape(-1)[parts.peaks].astype(float)
    volume, *highest = find_peaks(labels, squared, 0, len(labels), peak)
    centre = centres(*highest, labels.shape, len(peak))
    none = np.zeros(len(peak), bool)
    wall, reach, _, _ = measure_walls(labels, squared, 0, len(labels), centre, none)
    return pores_of(volume, wall, reach, peak, centre)


def pores_of(
    volume: np.ndarray, wall: np.ndarray, reach: np.ndarray, peak: np.ndarray, centre: np.ndarray
) -> dict[str, np.ndarray]:
    """Properties of pores, as :func:`measure_pores`, of what has been measured on their voxels.

    Parameters
    ----------
    volume, wall : (n,) array of float
        Number of voxels, area of the wall.
    reach, peak : (n,) array of float
        Squared distances from the centre to the farthest voxel, and to the nearest solid one.
    centre : (n, 3) array of int
        Voxel (z, y, x).
    """
    across = 2 * np.sqrt(reach) + 1
    radius = np.sqrt(peak)
    shape = np.full(len(peak), CIRCLE)
    np.divide(volume * across, wall**2, out=shape, where=wall > 0)
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
    labels, squared = parts.labels, parts.squared_distance
    faces, m = 3 * found.voxels + found.axes, len(found.saddles)
    peak = face_heights(squared, faces[found.saddles]).astype(float)
    vector, count, widest, around = sum_faces(labels, squared, faces, found.throats, peak)
    place = middles(found.throats[widest], faces[widest], around, labels.shape, m)
    area, normals = cross_sections(vector, count)
    rim, _, _ = measure_rims(labels, faces, found.throats, normals, np.zeros(m, bool))
    return throats_of(np.sqrt(peak), area, rim, place)


def throats_of(
    radius: np.ndarray, area: np.ndarray, rim: np.ndarray, place: np.ndarray
) -> dict[str, np.ndarray]:
    """Properties of throats, as :func:`measure_throats`, of what has been measured on their faces.

    Parameters
    ----------
    radius, area, rim : (m,) array of float
        Rim as :func:`measure_rims` sums it.
    place : (m, 3) array of float
        (z, y, x) from the volume's corner.
    """
    return {"coords": place[:, ::-1]} | _sections(radius, area, np.abs(rim))


def cross_sections(vector: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Areas and normals of throats from their vector areas (m, 3) and numbers of faces."""
    area = np.linalg.norm(vector, axis=1)
    # the interface around an enclosed pore has no vector area: take the mean shadow of a convex body, a
    # quarter of its surface, which is 2/3 of its voxel faces
    closed = area == 0
    normals = vector / np.where(closed, 1, area)[:, None]
    area[closed] = count[closed] / 6
    return area, normals


def face_heights(squared: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Squared distance (k,) of the lower voxel at faces, 3 * voxel + axis."""
    _, ny, nx = squared.shape
    before, flat = faces // 3, squared.reshape(-1)
    return np.minimum(flat[before], flat[before + np.array([ny * nx, nx, 1])[faces % 3]])


def centres(
    owner: np.ndarray, voxels: np.ndarray, around: np.ndarray, shape: tuple[int, int, int], n: int
) -> np.ndarray:
    """Voxels (n, 3), as (z, y, x), of the pores: of the highest ones, by place, the nearest to their mean.

    Parameters
    ----------
    owner, voxels, around : (k,) array of int
        Pore, from 0, flat index and :func:`surroundings` of each of the highest voxels.
    shape : tuple of int
        Of the volume.
    n : int
        Number of pores.
    """
    places = np.stack(np.unravel_index(voxels, shape), axis=1)
    return places[_nearest_to_mean(owner, places.astype(float), around, n)]


def middles(
    owner: np.ndarray, faces: np.ndarray, around: np.ndarray, shape: tuple[int, int, int], m: int
) -> np.ndarray:
    """Middles (m, 3), as (z, y, x), of the throats: of the widest faces, by place, the nearest to their mean.

    Parameters
    ----------
    owner, faces, around : (k,) array of int
        Throat, from 0, place as 3 * voxel + axis and sum of the :func:`surroundings` of each of the widest.
    shape : tuple of int
        Of the volume.
    m : int
        Number of throats.
    """
    places = np.stack(np.unravel_index(faces // 3, shape), axis=1) + 0.5
    places[np.arange(len(faces)), faces % 3] += 0.5
    return places[_nearest_to_mean(owner, places, around, m)]


def measure_openings(parts: Partition) -> list[dict[str, np.ndarray]]:
    """Where pores open onto the six faces of the image, in the order xmin, xmax, ymin, ymax, zmin, zmax.

    Returns
    -------
    list of dict
        Per face of the image, as :func:`measure_throats`, one entry per connected patch of a pore on the
        face, and ``pore`` (k,) int, from 0.
    """
    rinds = {face: rind(face, parts.labels, parts.squared_distance) for face in FACES_OUT}
    return [measure_opening(*face, *rinds[face], parts.labels.shape) for face in FACES_OUT]


FACES_OUT = tuple((axis, side) for axis in (2, 1, 0) for side in (0, 1))
"""Faces of the image, in their order: axis of the normal, 0 at its lower end and 1 at its upper."""


def rind(face: tuple[int, int], labels: np.ndarray, squared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is measured of openings onto a face: labels of its two outermost layers, distances of the last."""
    axis, side = face
    layers = np.arange(labels.shape[axis])
    outer = layers[-2:] if side else layers[:2]
    return np.ascontiguousarray(labels.take(outer, axis)), squared.take(-side, axis)


def measure_opening(
    axis: int, side: int, labels: np.ndarray, squared: np.ndarray, shape: tuple[int, int, int]
) -> dict[str, np.ndarray]:
    """Openings onto one face of a volume of this shape, from its :func:`rind`."""
    patches = skimage.measure.label(labels.take(-side, axis), background=0, connectivity=1)
    n = int(patches.max())
    pore, area, rim, peak, mean = _patches(labels, axis, side, patches, squared, n)
    spot = _nearest_in_patches(patches, squared, peak, mean)
    place = np.insert(spot + 0.5, axis, 0.0 if side == 0 else shape[axis], axis=1)
    return {"pore": pore - 1, "coords": place[:, ::-1]} | _sections(np.sqrt(peak), area, rim)


def _sections(radius: np.ndarray, area: np.ndarray, perimeter: np.ndarray) -> dict[str, np.ndarray]:
    perimeter = np.maximum(perimeter, 2 * np.sqrt(np.pi * area))
    return {
        "inscribed_diameter": 2 * radius,
        "cross_sectional_area": area,
        "perimeter": perimeter,
        "equivalent_diameter": 2 * np.sqrt(area / np.pi),
        "shape_factor": area / perimeter**2,
    }


@njit(cache=True, nogil=True)
def _normal(labels, z, y, x, axis, side):
    """Unit normal of the wall, into the solid, at a face of a pore voxel beyond which there is solid.

    Sobel's gradients at the pore voxel and at the solid one added: derivative (-1, -1, 1, 1) and smoothing
    (1, 3, 3, 1) across the face, (-1, 0, 1) and (1, 2, 1) along it. The image goes on beyond its faces.
    """
    nz, ny, nx = labels.shape
    across, one, other = 0, 0, 0
    if 2 <= z < nz - 2 and 2 <= y < ny - 2 and 2 <= x < nx - 2:
        flat = labels.reshape(-1)
        over = side * (ny * nx if axis == 0 else nx if axis == 1 else 1)
        along, beside = nx if axis == 0 else ny * nx, nx if axis == 2 else 1
        v = (z * ny + y) * nx + x
        for i in range(-1, 3):
            smooth, slope = 3 if 0 <= i < 2 else 1, 1 if i > 0 else -1
            for j in range(-1, 2):  # unsigned: numba need not ask whether it counts from the end
                row = v + i * over + j * along
                low = np.int64(flat[np.uint64(row - beside)] == 0)
                high = np.int64(flat[np.uint64(row + beside)] == 0)
                three = low + 2 * np.int64(flat[np.uint64(row)] == 0) + high
                across += slope * (2 - abs(j)) * three
                one += smooth * j * three
                other += smooth * (2 - abs(j)) * (high - low)
    else:
        for i in range(-1, 3):
            smooth, slope = 3 if 0 <= i < 2 else 1, 1 if i > 0 else -1
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
        across, one, other = 1, 0, 0
    length = np.sqrt(across**2 + one**2 + other**2)
    p, q, r = side * across / length, one / length, other / length
    if axis == 0:
        return p, q, r
    if axis == 1:
        return q, p, r
    return q, r, p


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def find_peaks(labels, squared, start, stop, peak):
    """Number of voxels of every pore in some planes, and its highest there.

    Parameters
    ----------
    labels, squared : (nz, ny, nx) array of int
        Pores, from 1, and squared distances, in those planes and two on either side, or as many as there are.
    start, stop : int
        The planes are those from ``start`` on, before ``stop``.
    peak : (n,) array of float
        Squared distance of the highest voxels of each pore.

    Returns
    -------
    volume : (n,) ndarray of float
    owner : (k,) ndarray of int32
        Pore of each of the highest, from 0.
    voxels, around : (k,) ndarray of int64
        Their flat indices and surroundings.
    """
    _, ny, nx = labels.shape
    flat = squared.reshape(-1)
    volume = np.zeros(peak.size)
    owner, voxels, around = np.zeros(1024, np.int32), np.zeros(1024, np.int64), np.zeros(1024, np.int64)
    count, v = 0, start * ny * nx - 1
    for z in range(start, stop):
        for y in range(ny):
            for x in range(nx):
                v += 1
                p = labels[z, y, x] - 1
                if p < 0:
                    continue
                volume[p] += 1
                if flat[v] == peak[p]:
                    if count == owner.size:
                        owner, voxels, around = grown(owner), grown(voxels), grown(around)
                    owner[count], voxels[count], around[count] = p, v, surroundings(flat, labels.shape, v)
                    count += 1
    return volume, owner[:count], voxels[:count], around[:count]


@njit(cache=True, nogil=True)
def _nearest_to_mean(owner, places, around, n):
    """Of each owner's places the one nearest to their mean; of equals the one with most around it."""
    mean, count = np.zeros((n, 3)), np.zeros(n)
    for i in range(owner.size):
        p = owner[i]
        count[p] += 1
        for k in range(3):
            mean[p, k] += places[i, k]
    for p in range(n):
        mean[p] /= count[p]
    nearest = np.zeros(n, np.int64)
    least, most = np.full(n, np.inf), np.zeros(n, np.int64)
    for i in range(owner.size):
        p, at = owner[i], places[i]
        away = (at[0] - mean[p, 0]) ** 2 + (at[1] - mean[p, 1]) ** 2 + (at[2] - mean[p, 2]) ** 2
        if away > least[p] + SAME:
            continue
        if away < least[p] - SAME or around[i] > most[p]:
            least[p], most[p], nearest[p] = away, around[i], i
    return nearest


@njit(cache=True, nogil=True)
def measure_walls(labels, squared, start, stop, centre, later):
    """Area of the wall of every pore in some planes, and how far it reaches from its centre.

    Parameters
    ----------
    labels, squared : (nz, ny, nx) array of int
        As for :func:`find_peaks`; beyond the planes it matters only where labels are 0.
    start, stop : int
        As there.
    centre : (n, 3) array of int
        Centre of each pore (z, y, x), by the indices of these arrays.
    later : (n,) array of bool
        Which have had voxels in earlier planes: the terms of their sums are handed back as they are, to be
        added to those one by one, so that sums do not depend on where the planes are cut.

    Returns
    -------
    wall, reach : (n,) ndarray of float
        Area, 0 of what is later; square of the distance to the farthest voxel.
    owner : (k,) ndarray of int32
    terms : (k,) ndarray of float
        Of the areas that are later, and their pores.
    """
    wall, reach = np.zeros(later.size), np.zeros(later.size)
    owner, terms, count = np.zeros(1024, np.int32), np.zeros(1024), 0
    for z in range(start, stop):
        for y in range(labels.shape[1]):
            for x in range(labels.shape[2]):
                p = labels[z, y, x] - 1
                if p < 0:
                    continue
                away = (z - centre[p, 0]) ** 2 + (y - centre[p, 1]) ** 2 + (x - centre[p, 2]) ** 2
                reach[p] = max(reach[p], away)
                if squared[z, y, x] > 1:
                    continue
                area = _wall(labels, z, y, x)
                if not later[p]:
                    wall[p] += area
                    continue
                if count == owner.size:
                    owner, terms = grown(owner), grown(terms)
                owner[count], terms[count] = p, area
                count += 1
    return wall, reach, owner[:count], terms[:count]


@njit(cache=True, nogil=True)
def sum_faces(labels, squared, faces, owner, peak):
    """Vector area, number of faces, and the widest faces, of throats or their parts.

    Parameters
    ----------
    labels, squared : (nz, ny, nx) array of int
        Pores and squared distances.
    faces : (f,) array of int64
        3 * voxel + axis.
    owner : (f,) array of int32
        Throat of each, from 0.
    peak : (m,) array of float
        Squared distance of the lower voxel at the widest faces of each throat.

    Returns
    -------
    vector : (m, 3) ndarray of float
        Along (z, y, x), from the lower pore to the higher.
    count : (m,) ndarray of float
    widest : (k,) ndarray of int64
        Places in ``faces``.
    around : (k,) ndarray of int64
        Sums of the surroundings of their two voxels.
    """
    flat, distance = labels.reshape(-1), squared.reshape(-1)
    _, ny, nx = labels.shape
    steps = np.array([ny * nx, nx, 1])
    vector, count = np.zeros((peak.size, 3)), np.zeros(peak.size)
    widest, around, found = np.zeros(1024, np.int64), np.zeros(1024, np.int64), 0
    for f in range(faces.size):
        v, axis, t = faces[f] // 3, faces[f] % 3, owner[f]
        w = v + steps[axis]
        vector[t, axis] += _side(flat[v], flat[w])
        count[t] += 1
        if min(distance[v], distance[w]) == peak[t]:
            if found == widest.size:
                widest, around = grown(widest), grown(around)
            both = surroundings(distance, labels.shape, v) + surroundings(distance, labels.shape, w)
            widest[found], around[found] = f, both
            found += 1
    return vector, count, widest[:found], around[:found]


@njit(cache=True, nogil=True)
def _side(here, there):
    """Sense of a face from the lower pore to the higher; a cut through a ring has no sides."""
    return 1 if here <= there else -1


@njit(cache=True, nogil=True)
def measure_rims(labels, faces, owner, normals, later):
    """Length of the rim of every throat on the wall: the integral of its tangent along the rim's edges.

    Parameters
    ----------
    labels : (nz, ny, nx) array of int
        Pores, on both sides of the faces and two planes further, or as many as there are; there it matters
        only where they are 0.
    faces : (f,) array of int64
        3 * voxel + axis.
    owner : (f,) array of int32
        Throat of each, from 0.
    normals : (m, 3) array of float
        Of the throats, along (z, y, x).
    later : (m,) array of bool
        As for :func:`measure_walls`.

    Returns
    -------
    rim : (m,) ndarray of float
        Of either sign, 0 of what is later.
    owner : (k,) ndarray of int32
    terms : (k,) ndarray of float
        Of the rims that are later, and their throats.
    """
    flat = labels.reshape(-1)
    size = np.array(labels.shape)
    _, ny, nx = labels.shape
    steps = np.array([ny * nx, nx, 1])
    rim = np.zeros(normals.shape[0])
    owners, terms, count = np.zeros(1024, np.int32), np.zeros(1024), 0
    at = np.empty(3, np.int64)
    for f in range(faces.size):
        v, axis, t = faces[f] // 3, faces[f] % 3, owner[f]
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
                    term = sense * side * turn * tangent / length
                    if not later[t]:
                        rim[t] += term
                        continue
                    if count == owners.size:
                        owners, terms = grown(owners), grown(terms)
                    owners[count], terms[count] = t, term
                    count += 1
    return rim, owners[:count], terms[:count]


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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
