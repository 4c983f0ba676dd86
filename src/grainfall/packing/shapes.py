"""From library meshes to the convex solids that the engines move."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from grainfall.grains.decomposition import union_volume
from grainfall.packing.parameters import Parameters

if TYPE_CHECKING:
    from grainfall.grains import Library

SPHERE = -1
"""Shape id of a sphere, which is in no library."""

SPHERE_DEVIATION = 0.003
"""Distance of a mesh from its equal-volume sphere, in radii, up to which it collides as that sphere.

That of a sphere's own mesh of 642 vertices, so exact spheres only. Grains within 0.01 of one take a third of
the time as spheres, but pack to a porosity lower by 0.016 +- 0.027 than as hulls of 64 vertices (three paired
beds of 690): no bias is shown, nor its absence.
"""


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
    hull_excess : float
        Volume of the mesh's convex hull over the mesh's own, minus 1: what a convex shape cannot resolve.
    excess : float
        The same of the shape that collides: of the union of its pieces.
    deviation : float
        Largest distance between the support functions of the collision shape and of the mesh's hull.
    kind : {"sphere", "hull", "parts"}
    reason : str
        Why that kind, see :func:`choose_kind`.
    """

    parts: tuple[np.ndarray, ...]
    bound: float
    inertia: np.ndarray
    frame: Rotation
    hull_excess: float
    excess: float
    deviation: float
    kind: str
    reason: str


def unit_sphere() -> CollisionShape:
    """The sphere of radius 1 (shape id -1)."""
    inertia = np.full(3, 0.4 * 4 * np.pi / 3)
    return CollisionShape((), 1.0, inertia, Rotation.identity(), 0.0, 0.0, 0.0, "sphere", "a sphere")


def choose_kind(
    hull_excess: float,
    hull_deviation: float,
    sphere_deviation: float,
    decomposition: str,
    tolerance: float,
    wanted: str = "auto",
) -> tuple[str, str]:
    """Whether a grain collides as a sphere, as one hull or as convex parts.

    A sphere is taken where it is the truer shape as well as the cheaper one: within
    :data:`SPHERE_DEVIATION` of the mesh, and nearer to it than the simplified hull, whose facets lock.

    Parameters
    ----------
    hull_excess : float
        V_hull / V - 1 of the mesh.
    hull_deviation, sphere_deviation : float
        Largest distance of the simplified hull from the hull and of the mesh from the equal-volume sphere,
        in radii of that sphere.
    decomposition : {"auto", "on", "off"}
    tolerance : float
        Excess above which ``auto`` decomposes.
    wanted : {"auto", "sphere"}
        ``sphere`` takes one whatever the grain looks like.

    Returns
    -------
    kind : {"sphere", "hull", "parts"}
    reason : str
    """
    if wanted == "sphere":
        return "sphere", f"spheres are asked for; within {sphere_deviation:.4f} radii of one"
    if sphere_deviation <= min(SPHERE_DEVIATION, hull_deviation):
        return "sphere", f"within {sphere_deviation:.4f} radii of a sphere, its hull {hull_deviation:.4f}"
    if decomposition == "on":
        return "parts", "decomposition is on"
    if decomposition == "off":
        return "hull", "decomposition is off"
    if hull_excess > tolerance:
        return "parts", f"hull excess {hull_excess:.4f} above {tolerance:g}"
    return "hull", f"hull excess {hull_excess:.4f} within {tolerance:g}"


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
        chosen.append(far)
        try:
            part.add_points(candidates[far : far + 1])
        except QhullError:  # a point nearly on an edge may not be added to a hull, but can be part of one
            part.close()
            part = ConvexHull(candidates[chosen], incremental=True)
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


def collision_shape(
    vertices: np.ndarray,
    faces: np.ndarray,
    parameters: Parameters | None = None,
    pieces: tuple[np.ndarray, ...] = (),
) -> CollisionShape:
    """The collision shape, exact moments and principal frame of a library mesh.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int
    pieces : tuple of (k, 3) ndarray, optional
        Its convex pieces in the same frame; without them it collides as a sphere or a hull.
    parameters : Parameters, optional
        ``hull_vertices``, ``decomposition`` and ``hull_excess`` count. A part has a quarter of the vertices
        of a lone hull, which bounds a grain at four times as many.
    """
    parameters = parameters or Parameters()
    volume, centre, inertia = mesh_moments(vertices, faces)
    moments, axes = np.linalg.eigh(inertia)
    axes = axes * np.where(
        axes[np.abs(axes).argmax(axis=0), range(3)] < 0, -1.0, 1.0
    )  # one sign on any machine
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    local = (np.asarray(vertices, float) - centre) @ axes
    radius = float(np.cbrt(3 * volume / (4 * np.pi)))
    parts: tuple[np.ndarray, ...] = (reduce_hull(local, parameters.hull_vertices),)
    hull_excess = excess = float(ConvexHull(local).volume / volume - 1)
    surface = np.vstack([local, local[faces].mean(axis=1)])
    sphere_deviation = float(np.abs(np.linalg.norm(surface, axis=1) / radius - 1).max())
    kind, reason = choose_kind(
        hull_excess,
        _deviation(parts, local) / radius,
        sphere_deviation,
        parameters.decomposition,
        parameters.hull_excess,
        parameters.collision_shape,
    )
    if kind == "sphere":
        parts, excess = (), 0.0
    elif kind == "parts" and pieces:
        most = max(8, parameters.hull_vertices // 4)
        parts = tuple(reduce_hull((piece - centre) @ axes, most) for piece in pieces)
        excess = union_volume(parts) / volume - 1
    elif kind == "parts":
        kind, reason = "hull", f"{reason}, but the library has it in one piece"
    return CollisionShape(
        parts=parts,
        bound=max((float(np.linalg.norm(part, axis=1).max()) for part in parts), default=radius),
        inertia=moments,
        frame=Rotation.from_matrix(axes),
        hull_excess=hull_excess,
        excess=excess,
        deviation=_deviation(parts, local) if parts else sphere_deviation * radius,
        kind=kind,
        reason=reason,
    )


def collision_shapes(
    library: Library, ids: Iterable[int], parameters: Parameters
) -> dict[int, CollisionShape]:
    """Collision shapes of the library entries ``ids`` (-1: sphere)."""
    return {int(i): unit_sphere() if i == SPHERE else _shape(library, i, parameters) for i in ids}


_KNOWN: dict[tuple, CollisionShape] = {}


def _shape(library: Library, i: int, p: Parameters) -> CollisionShape:
    """As :func:`collision_shape`, found once a process: every pass of a packing asks for the same ones."""
    mesh = library.vertices[i], library.faces[i], library.pieces[i]
    digest = hashlib.blake2b(digest_size=16)
    for part in (mesh[0], mesh[1], *mesh[2]):
        digest.update(np.ascontiguousarray(part).tobytes())
    key = digest.digest(), p.hull_vertices, p.decomposition, p.hull_excess, p.collision_shape
    if key not in _KNOWN:
        _KNOWN[key] = collision_shape(mesh[0], mesh[1], p, mesh[2])
    return _KNOWN[key]


def _deviation(parts: tuple[np.ndarray, ...], points: np.ndarray) -> float:
    """Largest distance between the support functions of ``parts`` and of ``points``."""
    normals = _directions(400)
    found = (normals @ np.vstack(parts).T).max(axis=1) - (normals @ points.T).max(axis=1)
    return float(np.abs(found).max())


def _directions(n: int) -> np.ndarray:
    """``n`` unit vectors spread evenly (Fibonacci spiral)."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (1 + 5**0.5) * np.arange(n)
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
