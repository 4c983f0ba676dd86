"""Grains cut by random planes: the profiles by which a section is unfolded."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numba import njit

from grainfall.stereology import Profiles

_GOLDEN = (1 + 5**0.5) / 2


def random_profiles(
    meshes: Iterable[tuple[np.ndarray, np.ndarray]], directions: int = 32, planes: int = 8
) -> Profiles:
    """Cut shapes by planes of all directions and distances.

    A plane meets a shape in proportion to its width across the plane, so wide directions count for more. A
    shape that is not convex may show several profiles in a plane: each counts, as on a section.

    Parameters
    ----------
    meshes : iterable of ((n, 3) float ndarray, (m, 3) int ndarray)
        Vertices and faces of closed shapes, outward, each of volume 4 pi / 3. All count alike.
    directions, planes : int
        Directions (spread evenly over a hemisphere), and planes across each.

    Returns
    -------
    Profiles

    Notes
    -----
    Unfolding by profiles of the particles' own shape in place of a sphere's is Sahagian and Proussevitch's
    (1998, J. Volcanol. Geotherm. Res. 84, 173-196).
    """
    found = []
    for n, (vertices, faces) in enumerate(meshes):
        normals, shift = spread_planes(n, directions)
        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        found.append(_cuts(vertices, *_edges(faces), normals, shift, planes))
    areas, widths = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.argsort(areas, kind="stable")
    return Profiles(np.sqrt(areas[order] / np.pi), widths[order] / widths.sum())


def spread_planes(n: int, directions: int) -> tuple[np.ndarray, np.ndarray]:
    """Planes for the n-th shape, its own, so that what one set of them misses evens out.

    Parameters
    ----------
    n : int
        Number of the shape.
    directions : int

    Returns
    -------
    normals : (directions, 3) ndarray
        Spread evenly over a hemisphere.
    shift : (directions,) ndarray
        In [0, 1): where parallel planes lie, in steps from one to the next.
    """
    height = (np.arange(directions) + (0.5 + n * 3**0.5) % 1.0) / directions
    place = n * directions + np.arange(directions)
    flat, angle, shift = np.sqrt(1.0 - height**2), 2 * np.pi * _GOLDEN * place, (2**0.5 * place) % 1.0
    return np.column_stack([flat * np.cos(angle), flat * np.sin(angle), height]), shift


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Faces, the numbers of their edges (m, 3), and how many edges there are."""
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    unique, number = np.unique(ends, axis=0, return_inverse=True)
    return faces, np.ascontiguousarray(number.reshape(faces.shape)), len(unique)


@njit(cache=True)
def _cuts(vertices, faces, edges, n_edges, normals, shifts, planes):
    """Areas of profiles, and the chance of each, up to a common factor."""
    areas, chances = [], []
    height = np.empty(len(vertices))
    p, q = np.empty(3), np.empty(3)
    # Of the segment that comes in by an edge: the edge by which it goes out, and its part of twice the area.
    leaves_by, moment = np.full((planes, n_edges), -1), np.empty((planes, n_edges))
    for d in range(len(normals)):
        n = normals[d]
        for v in range(len(vertices)):
            height[v] = n[0] * vertices[v, 0] + n[1] * vertices[v, 1] + n[2] * vertices[v, 2]
        low, width = height.min(), height.max() - height.min()
        segments = []
        for f in range(len(faces)):
            lowest = min(height[faces[f, 0]], height[faces[f, 1]], height[faces[f, 2]])
            highest = max(height[faces[f, 0]], height[faces[f, 1]], height[faces[f, 2]])
            first = max(0, int(np.floor((lowest - low) / width * planes - shifts[d])))
            for j in range(first, planes):
                level = low + width * (j + shifts[d]) / planes
                if level < lowest:
                    continue
                if level >= highest:
                    break
                entry = -1
                for k in range(3):
                    s, t = faces[f, k], faces[f, (k + 1) % 3]
                    if (height[s] > level) == (height[t] > level):
                        continue
                    comes_in = height[t] > level
                    if s > t:  # the same end first, whichever face asks: segments meet exactly
                        s, t = t, s
                    w = (level - height[s]) / (height[t] - height[s])
                    point = p if comes_in else q
                    for i in range(3):
                        point[i] = vertices[s, i] + w * (vertices[t, i] - vertices[s, i])
                    if comes_in:
                        entry = edges[f, k]
                    else:
                        leaving = edges[f, k]
                leaves_by[j, entry] = leaving
                moment[j, entry] = (
                    n[0] * (q[1] * p[2] - q[2] * p[1])
                    + n[1] * (q[2] * p[0] - q[0] * p[2])
                    + n[2] * (q[0] * p[1] - q[1] * p[0])
                )
                segments.append((j, entry))
        for j, start in segments:
            area, here = 0.0, start
            while leaves_by[j, here] >= 0:
                area += moment[j, here]
                following = leaves_by[j, here]
                leaves_by[j, here] = -1
                here = following
            if area > 0:  # a hole runs the other way, and is no profile
                areas.append(0.5 * area)
                chances.append(width)
    return np.array(areas), np.array(chances)
