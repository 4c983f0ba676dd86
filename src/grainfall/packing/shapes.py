"""From library meshes to the convex solids that the engines move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class CollisionShape:
    """A library shape as an engine sees it, at equal-volume radius 1 and unit density.

    Attributes
    ----------
    parts : tuple of (n, 3) ndarray
        Vertices of the convex pieces in the principal frame, centre of mass of the *mesh* at the origin; an
        empty tuple is a sphere.
    bound : float
        Radius of the bounding sphere about the centre of mass.
    inertia : (3,) ndarray
        Principal moments of the mesh, unit density.
    frame : scipy Rotation
        Principal frame -> library frame.
    excess : float
        Volume of the mesh's convex hull over the mesh's own, minus 1: what a convex shape cannot resolve.
    deviation : float
        Largest distance between the support functions of the collision shape and of the mesh's hull.
    """

    parts: tuple[np.ndarray, ...]
    bound: float
    inertia: np.ndarray
    frame: Rotation
    excess: float
    deviation: float


def unit_sphere() -> CollisionShape:
    """The sphere of radius 1 (shape id -1)."""
    inertia = np.full(3, 0.4 * 4 * np.pi / 3)
    return CollisionShape((), 1.0, inertia, Rotation.identity(), 0.0, 0.0)


def reduce_hull(points: np.ndarray, n: int) -> np.ndarray:
    """A polytope with at most ``n`` vertices, of the same volume and centroid as the hull of ``points``.

    Vertices are added one at a time, always the point farthest outside, as quickhull does. Such a polytope
    lies inside the hull (at 32 vertices a sphere loses a sixth of its volume, and grains packed with it would
    interpenetrate), so it is then scaled about its centroid to the hull's volume.

    Parameters
    ----------
    points : (m, 3) float
    n : int
        At least 4.

    Returns
    -------
    (k, 3) float, k <= n
    """
    hull = ConvexHull(points)
    candidates = points[hull.vertices]
    if len(candidates) <= n:
        return candidates
    chosen = _start(candidates)
    part = ConvexHull(candidates[chosen], incremental=True)
    while len(part.vertices) < n:
        outside = (candidates @ part.equations[:, :3].T + part.equations[:, 3]).max(axis=1)
        far = int(outside.argmax())
        if outside[far] <= 1e-9:
            break
        part.add_points(candidates[far : far + 1])
    vertices = part.points[part.vertices]
    part.close()
    target, centre = _volume_centroid(candidates)
    volume, inner = _volume_centroid(vertices)
    return centre + (vertices - inner) * (target / volume) ** (1 / 3)


def _start(points: np.ndarray) -> list[int]:
    """Four well-spread, affinely independent points: the first simplex."""
    first = int(points[:, 0].argmin())
    second = int(((points - points[first]) ** 2).sum(1).argmax())
    axis = points[second] - points[first]
    third = int((np.cross(points - points[first], axis) ** 2).sum(1).argmax())
    normal = np.cross(axis, points[third] - points[first])
    fourth = int(np.abs((points - points[first]) @ normal).argmax())
    return [first, second, third, fourth]


def _volume_centroid(points: np.ndarray) -> tuple[float, np.ndarray]:
    hull = ConvexHull(points)
    apex = points.mean(axis=0)
    corners = points[hull.simplices] - apex
    volumes = np.abs(np.linalg.det(corners)) / 6
    return hull.volume, apex + (volumes[:, None] * corners.sum(axis=1) / 4).sum(axis=0) / volumes.sum()


def mesh_moments(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume, centre of mass and inertia tensor about it, unit density, of a closed mesh."""
    from trimesh.triangles import mass_properties

    found = mass_properties(np.asarray(vertices, float)[faces], density=1.0)
    return found["volume"], np.asarray(found["center_mass"]), np.asarray(found["inertia"])


def collision_shape(vertices: np.ndarray, faces: np.ndarray, hull_vertices: int) -> CollisionShape:
    """The convex collision shape, exact moments and principal frame of a library mesh."""
    volume, centre, inertia = mesh_moments(vertices, faces)
    moments, axes = np.linalg.eigh(inertia)
    axes = axes * np.where(
        axes[np.abs(axes).argmax(axis=0), range(3)] < 0, -1.0, 1.0
    )  # one sign on any machine
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    local = (np.asarray(vertices, float) - centre) @ axes
    points = reduce_hull(local, hull_vertices)
    normals = _directions(400)
    deviation = np.abs((normals @ points.T).max(axis=1) - (normals @ local.T).max(axis=1)).max()
    return CollisionShape(
        parts=(points,),
        bound=float(np.linalg.norm(points, axis=1).max()),
        inertia=moments,
        frame=Rotation.from_matrix(axes),
        excess=float(ConvexHull(local).volume / volume - 1),
        deviation=float(deviation),
    )


def _directions(n: int) -> np.ndarray:
    """``n`` unit vectors spread evenly (Fibonacci spiral)."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (1 + 5**0.5) * np.arange(n)
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
