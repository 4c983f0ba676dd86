"""Contacts between packed grains: exact gaps of their convex hulls, contact areas of the voxel volume.

Virtual spheres are left out everywhere: they are no part of the rock.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import scipy  # its optimisers load when they are first used
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from grainfall.packing.parameters import Parameters
from grainfall.packing.shapes import collision_shapes
from grainfall.volume import adjacent_pairs

if TYPE_CHECKING:
    from grainfall.grains import Library

TOLERANCE = 1e-3
"""Largest gap of a contact over the mean grain diameter.

Rigid-body engines hold resting grains within some 1e-4 of a diameter of touching, on either side: a tolerance
ten times that loses no contact of theirs and adds few neighbours that merely come near.
"""

RATTLER_CONTACTS = 3
"""Contacts below which a grain is a rattler: three hold a grain up against gravity.

Four, as for frictionless packings without gravity, will not do: grains of the free surface rest on three
others, and once they are taken away so do the next, until nothing is left of the bed.
"""

TOUCHING = 1e-7
"""Gap, in mean grain radii, below which the closest points are too near each other to show a direction."""

CERTAIN = 1e-6
"""Difference, in mean grain radii, of a gap from the separation along its normal above which it is wrong."""


def find_contacts(
    bodies: pd.DataFrame,
    library: Library,
    body_volume: np.ndarray | None,
    voxel_size_um: float,
    tolerance: float = TOLERANCE,
    parameters: Parameters | None = None,
    packed: pd.DataFrame | None = None,
    forces: pd.DataFrame | None = None,
) -> pd.DataFrame:
    """Pairs of grains in contact, wherever they lie.

    Parameters
    ----------
    bodies : DataFrame
        Columns of ``bodies.csv`` (lengths in um).
    library : Library
        Shapes; a pair is judged by their convex hulls.
    body_volume : (nz, ny, nx) array of int or None
        Body id + 1 of every voxel of the region of interest, 0 in pores.
    voxel_size_um : float
        Edge of a voxel.
    tolerance : float
        Largest gap of a contact over the mean grain diameter (of equal-volume spheres).
    parameters : Parameters, optional
        Judge by the shapes that the engine collided, not by the hulls of the meshes. A simplified hull
        differs from the mesh's by some percent of a radius, many times the tolerance: grains at rest on each
        other show a gap, or a deep overlap, between their meshes.
    packed : DataFrame, optional
        The bodies as they came to rest, before positions were scaled to the target porosity or room was made
        for rims. The first moves neighbours apart (or into each other) by up to half a percent of their
        distance, again more than the tolerance: contacts and gaps are then those of the packing, in its own
        um, located in the twin.
    forces : DataFrame, optional
        Normal forces in the packing as it came to rest, virtual spheres included: a < b (ids), force_n.

    Returns
    -------
    DataFrame
        A row a pair, by ids: grain_a < grain_b, phase_a, phase_b; x, y, z (um, midway between the closest
        points); nx, ny, nz (unit normal from a to b); area_um2 (of the voxel faces that the two share within
        the volume, so too little where a face of the volume cuts the contact; empty where none of it is
        inside); force_n (normal force, 0 where the two touch and carry nothing; empty without ``forces``);
        gap_um (negative: depth of penetration).
    """
    grains = bodies[bodies["kind"] == "grain"]
    rest = grains if packed is None else packed[packed["id"].isin(grains["id"])]
    limit = tolerance * 2 * rest["scale"].mean() if len(rest) else 0.0
    shapes = library if parameters is None else collided(library, grains["shape"], parameters)
    pairs = closest_points(rest, shapes, limit)
    pairs = pairs[pairs["gap_um"] <= limit].reset_index(drop=True)
    phase = grains.set_index("id")["phase"]
    table = pd.DataFrame({"grain_a": pairs["a"], "grain_b": pairs["b"]})
    table["phase_a"], table["phase_b"] = (phase.loc[table[g]].to_numpy() for g in ("grain_a", "grain_b"))
    table[["x", "y", "z"]] = _carried(pairs, rest.set_index("id"), grains.set_index("id"))
    table[["nx", "ny", "nz"]] = pairs[["nx", "ny", "nz"]]
    table["area_um2"] = np.nan
    if body_volume is not None:
        shared = adjacent_pairs(body_volume, voxel_size_um)
        area = shared.set_index([shared["body_a"] - 1, shared["body_b"] - 1])["area_um2"]
        found = area.reindex(pd.MultiIndex.from_frame(table[["grain_a", "grain_b"]])).to_numpy()
        size = voxel_size_um * np.array(body_volume.shape[::-1], float)
        inside = _inside(table, size)
        table["area_um2"] = np.where(np.isnan(found) & inside, 0.0, found)
    table["force_n"] = np.nan
    if forces is not None:
        known = forces.set_index(["a", "b"])["force_n"]
        found = known.reindex(pd.MultiIndex.from_frame(table[["grain_a", "grain_b"]]))
        table["force_n"] = found.fillna(0.0).to_numpy()
    table["gap_um"] = pairs["gap_um"]
    return table.sort_values(["grain_a", "grain_b"], ignore_index=True)


def _carried(pairs: pd.DataFrame, rest: pd.DataFrame, grains: pd.DataFrame) -> np.ndarray:
    """Points between pairs of grains at rest, where they are when the grains have moved: as far on the way
    from centre to centre as before."""
    names = ["x", "y", "z"]
    points = pairs[names].to_numpy(float)
    (a, b), (a_now, b_now) = (
        [table.loc[pairs[end], names].to_numpy(float) for end in ("a", "b")] for table in (rest, grains)
    )
    way = b - a
    share = ((points - a) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), np.finfo(float).tiny)
    share = np.clip(share, 0, 1)[:, None]
    return points + (1 - share) * (a_now - a) + share * (b_now - b)


def _inside(table: pd.DataFrame, size_um: np.ndarray) -> np.ndarray:
    """Rows whose x, y, z lie in the box [0, size_um)."""
    points = table[["x", "y", "z"]].to_numpy()
    return ((points >= 0) & (points < size_um)).all(axis=1)


@dataclass(frozen=True)
class Hulls:
    """Vertices of the convex parts of shapes, by shape id, in the library's frame; no part: a unit sphere."""

    parts: dict[int, tuple[np.ndarray, ...]]


def collided(library: Library, shapes: Iterable[int], parameters: Parameters) -> Hulls:
    """What the engine collided in place of the meshes: spheres, simplified hulls, convex parts."""
    used = sorted({int(s) for s in shapes if s >= 0})
    return Hulls(
        {
            s: tuple(shape.frame.apply(part) for part in shape.parts)
            for s, shape in collision_shapes(library, used, parameters).items()
        }
    )


def _parts(library: Library | Hulls, shape: int) -> tuple[np.ndarray, ...]:
    """Convex parts of a shape: those of :class:`Hulls`, or the mesh as one; none: a sphere."""
    if shape < 0:
        return ()
    return library.parts[shape] if isinstance(library, Hulls) else (library.vertices[shape],)


def closest_points(bodies: pd.DataFrame, library: Library | Hulls, reach_um: float) -> pd.DataFrame:
    """Signed distances of all pairs whose bounding spheres come within ``reach_um``.

    GJK distance and EPA penetration depth by FCL, in mean radii and with the first body at the origin, each
    checked along its normal and computed anew where FCL fails (see :func:`exact_distance`). A sphere is a
    point with a margin, which makes its distances as exact as a hull's. Of bodies of several convex parts the
    least of the signed distances of two parts counts: the distance where the bodies are apart, the depth of
    the deepest pair of parts where they are not (no shorter way out, over all parts at once, is looked for).

    Parameters
    ----------
    bodies : DataFrame
        Columns of ``bodies.csv``.
    library : Library or Hulls
        Shapes, of a Library their convex hulls; id -1 is a sphere.
    reach_um : float
        Largest gap of the bounding spheres.

    Returns
    -------
    DataFrame
        Columns a < b (ids), gap_um (negative: the smallest translation that separates the two), x, y, z
        (midway between the closest points), nx, ny, nz (unit normal from a to b), sorted by a, b.
    """
    columns = ["a", "b", "gap_um", "x", "y", "z", "nx", "ny", "nz"]
    bodies = bodies.sort_values("id")
    ids, shape = bodies["id"].to_numpy(), bodies["shape"].to_numpy()
    position, scale = bodies[["x", "y", "z"]].to_numpy(float), bodies["scale"].to_numpy(float)
    i, j = _candidates(position, bounding_radii(bodies, library), reach_um)
    rows = np.empty((len(i), 7))
    if len(i):
        import fcl

        unit = scale.mean()
        hulls = {s: [_hull(part) for part in _parts(library, s)] for s in np.unique(shape)}
        rotation = Rotation.from_quat(bodies[["qw", "qx", "qy", "qz"]].to_numpy(float), scalar_first=True)
        turns = rotation.as_matrix()
        cores = [_cores(fcl, hulls[s], r / unit) for s, r in zip(shape, scale, strict=True)]
        margin = np.array([0.0 if hulls[s] else r / unit for s, r in zip(shape, scale, strict=True)])
    for row, (a, b) in enumerate(zip(i, j, strict=True)):
        offset = (position[b] - position[a]) / unit
        gap, middle, normal = _nearest(fcl, cores[a], turns[a], cores[b], turns[b], offset)
        middle = middle + (margin[a] - margin[b]) * normal / 2
        rows[row] = (gap - margin[a] - margin[b]) * unit, *(position[a] + middle * unit), *normal
    table = pd.DataFrame(rows, columns=columns[2:])
    table.insert(0, "a", ids[i])
    table.insert(1, "b", ids[j])
    return table


def bounding_radii(bodies: pd.DataFrame, library: Library | Hulls) -> np.ndarray:
    """Radius (n,) um about its centre that holds each body."""
    shapes = bodies["shape"].to_numpy()
    extent = {
        s: max((np.linalg.norm(part, axis=1).max() for part in _parts(library, s)), default=1.0)
        for s in np.unique(shapes)
    }
    return bodies["scale"].to_numpy(float) * np.array([extent[s] for s in shapes])


def _candidates(position: np.ndarray, radius: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows i < j, sorted, of the pairs whose bounding spheres come within ``reach``."""
    if len(position) < 2:
        return np.empty(0, int), np.empty(0, int)
    pairs = cKDTree(position).query_pairs(2 * radius.max() + reach, output_type="ndarray")
    i, j = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].T
    near = np.linalg.norm(position[j] - position[i], axis=1) <= radius[i] + radius[j] + reach
    return i[near], j[near]


def _hull(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) and outward triangles (m, 3) of the convex hull."""
    vertices = np.asarray(vertices, float)
    hull = ConvexHull(vertices)
    number = np.full(len(vertices), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    first, second, third = vertices[hull.simplices].transpose(1, 0, 2)
    inward = (np.cross(second - first, third - first) * hull.equations[:, :3]).sum(axis=1) < 0
    faces = number[hull.simplices]
    faces[inward] = faces[inward, ::-1]
    return vertices[hull.vertices], faces


@dataclass(frozen=True)
class _Core:
    """A convex part as FCL has it, its vertices and its bounding sphere in the body's frame."""

    geometry: object
    points: np.ndarray
    centre: np.ndarray
    radius: float


def _cores(fcl: object, hulls: list[tuple[np.ndarray, np.ndarray]], scale: float) -> list[_Core]:
    """Parts of a body, or the point inside a sphere (FCL has no points: a sphere of no size that matters)."""
    if not hulls:
        return [_Core(fcl.Sphere(1e-12), np.zeros((1, 3)), np.zeros(3), 0.0)]
    found = []
    for vertices, faces in hulls:
        counted = np.column_stack([np.full(len(faces), 3), faces]).ravel()
        points = vertices * scale
        centre = points.mean(axis=0)
        radius = np.linalg.norm(points - centre, axis=1).max()
        found.append(_Core(fcl.Convex(points, len(faces), counted), points, centre, radius))
    return found


def _nearest(
    fcl: object,
    first: list[_Core],
    turn: np.ndarray,
    second: list[_Core],
    turn_b: np.ndarray,
    offset: np.ndarray,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Least signed distance of the parts of two bodies, the point midway and the unit normal.

    Neither distance nor (negative) depth of two parts is below that of their bounding spheres, so pairs are
    taken from the nearest spheres on, until no other can beat the least so far.
    """
    if len(first) == len(second) == 1:
        pairs = [(-np.inf, first[0], second[0])]
    else:
        pairs = [
            (np.linalg.norm(turn_b @ q.centre + offset - turn @ p.centre) - p.radius - q.radius, p, q)
            for p in first
            for q in second
        ]
        pairs.sort(key=lambda pair: pair[0])
    best = (np.inf, None, None)
    for bound, p, q in pairs:
        if bound >= best[0]:
            break
        found = _distance(fcl, p, turn, q, turn_b, offset)
        if found[0] < best[0]:
            best, nearest = found, (p, q)
    gap, on_a, on_b = apart, from_a, from_b = best
    if abs(gap) < TOUCHING:
        # the closest points coincide: the direction is that of the gap a little apart
        apart, from_a, from_b = _distance(fcl, nearest[0], turn, nearest[1], turn_b, offset * (1 + 1e-4))
    normal = (from_b - from_a) * np.sign(apart)
    normal /= np.linalg.norm(normal)
    return gap, (on_a + on_b) / 2, normal


def _distance(
    fcl: object, first: _Core, turn: np.ndarray, second: _Core, turn_b: np.ndarray, offset: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Signed distance and the closest (deepest) points on the two."""
    request = fcl.DistanceRequest(enable_nearest_points=True, enable_signed_distance=True)
    result = fcl.DistanceResult()
    gap = fcl.distance(
        fcl.CollisionObject(first.geometry, fcl.Transform(turn, np.zeros(3))),
        fcl.CollisionObject(second.geometry, fcl.Transform(turn_b, offset)),
        request,
        result,
    )
    on_a, on_b = (np.array(p) for p in result.nearest_points)
    a, b = first.points @ turn.T, second.points @ turn_b.T + offset
    return (gap, on_a, on_b) if _certain(a, b, gap, on_a, on_b) else exact_distance(a, b)


def _certain(a: np.ndarray, b: np.ndarray, gap: float, on_a: np.ndarray, on_b: np.ndarray) -> bool:
    """Whether a signed distance agrees with the separation of the two along its own normal.

    The separation min n.b - max n.a along any unit normal n is a lower bound of the distance, and minus it an
    upper bound of the depth: where a positive gap equals it, the gap is proven. FCL's GJK seldom fails (by
    more than 1e-5 in none of 60,000 random pairs of hulls and boxes), but then by a third of the gap.
    """
    length = np.linalg.norm(on_b - on_a)
    if length < TOUCHING:  # no normal to judge by: only a gap of nothing can be right
        return abs(gap) < CERTAIN
    normal = (on_b - on_a) / (length * np.sign(gap))
    return abs((b @ normal).min() - (a @ normal).max() - gap) < CERTAIN


def exact_distance(a: np.ndarray, b: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Signed distance of the hulls of two sets of points, slower and surer than GJK and EPA.

    The hull of a growing set of points of the Minkowski difference b - a takes in the farthest point along
    the normal of its point nearest to the origin (of its facet nearest to the origin, once that is inside)
    until there is none farther: the distance (depth) is then exact.

    Parameters
    ----------
    a, b : (n, 3), (m, 3) float

    Returns
    -------
    gap : float
        Negative: the smallest translation that separates the two.
    on_a, on_b : (3,) ndarray
        Closest (deepest) points.
    """
    pairs: list[tuple[int, int]] = []  # (point of a, point of b)
    normal = np.array([1.0, 0.0, 0.0])
    for _ in range(3):  # a line, a plane, a solid
        pairs += [_farthest(a, b, normal), _farthest(a, b, -normal)]
        i, j = np.array(pairs).T
        normal = np.linalg.svd((b[j] - a[i]) - (b[j] - a[i]).mean(axis=0))[2][-1]
    while True:
        i, j = np.array(pairs).T
        weights = _nearest_weights(b[j] - a[i])
        on_a, on_b = weights @ a[i], weights @ b[j]
        gap = np.linalg.norm(on_b - on_a)
        if gap < TOUCHING:
            break
        pair = _farthest(a, b, (on_a - on_b) / gap)
        if pair in pairs or (b[pair[1]] - a[pair[0]]) @ (on_b - on_a) / gap > gap - CERTAIN / 10:
            return float(gap), on_a, on_b
        pairs.append(pair)
    while True:
        i, j = np.array(pairs).T
        difference = b[j] - a[i]
        hull = ConvexHull(difference)
        facet = hull.equations[:, 3].argmax()
        normal, depth = hull.equations[facet, :3], -hull.equations[facet, 3]
        pair = _farthest(a, b, normal)
        if pair in pairs or (b[pair[1]] - a[pair[0]]) @ normal < depth + CERTAIN / 10:
            corners = difference @ normal > depth - CERTAIN / 10  # of all the triangles that are one face
            weights = _nearest_weights(difference[corners])
            return -float(depth), weights @ a[i[corners]], weights @ b[j[corners]]
        pairs.append(pair)


def _farthest(a: np.ndarray, b: np.ndarray, direction: np.ndarray) -> tuple[int, int]:
    """The points of a and b whose difference b - a is farthest along a direction."""
    return int((a @ direction).argmin()), int((b @ direction).argmax())


def _nearest_weights(points: np.ndarray) -> np.ndarray:
    """Weights (n,), none negative, of sum 1, of the point of the hull of ``points`` nearest to the origin.

    Non-negative least squares of (points, 1) w = (0, 1) has that solution up to its scale.
    """
    weights, _ = scipy.optimize.nnls(
        np.vstack([points.T, np.ones(len(points))]), np.array([0.0, 0.0, 0.0, 1.0])
    )
    return weights / weights.sum()


def coordination(
    contacts: pd.DataFrame,
    bodies: pd.DataFrame,
    size_um: tuple[float, float, float] | None = None,
    minimum: int = RATTLER_CONTACTS,
) -> pd.DataFrame:
    """Mean coordination without rattlers, and their fraction, of grains centred in the region of interest.

    A rattler has fewer than ``minimum`` contacts with grains that are no rattlers themselves (found by
    removing grains until none is left to remove). Grains outside the region take part as neighbours and are
    judged alike; only those inside are counted.

    Parameters
    ----------
    contacts : DataFrame
        See :func:`find_contacts`; of all the grains, not only those inside.
    bodies : DataFrame
        Columns of ``bodies.csv``.
    size_um : (float, float, float), optional
        Size of the region of interest along x, y, z; everywhere if omitted.
    minimum : int
        Contacts that make a grain part of the skeleton.

    Returns
    -------
    DataFrame
        Columns phase (0 stands for all grains, then every phase), n_grains, coordination (mean number of
        contacts with skeleton grains over the skeleton grains; empty where there is none), rattlers (fraction
        of the grains; empty without grains).
    """
    grains = bodies[bodies["kind"] == "grain"].sort_values("id")
    row = pd.Series(np.arange(len(grains)), index=grains["id"])
    a, b = (row.loc[contacts[g]].to_numpy(int) for g in ("grain_a", "grain_b"))
    skeleton = np.ones(len(grains), bool)
    while True:
        live = skeleton[a] & skeleton[b]
        degree = np.bincount(np.concatenate([a[live], b[live]]), minlength=len(grains))
        keep = skeleton & (degree >= minimum)
        if np.array_equal(keep, skeleton):
            break
        skeleton = keep
    inside = np.ones(len(grains), bool) if size_um is None else _inside(grains, np.asarray(size_um, float))
    phase = grains["phase"].to_numpy()
    rows = []
    for which in (0, *np.unique(phase)):
        counted = inside & (phase == which) if which else inside
        n, bearing = np.count_nonzero(counted), counted & skeleton
        mean = degree[bearing].mean() if bearing.any() else np.nan
        rows.append((int(which), n, mean, 1 - np.count_nonzero(bearing) / n if n else np.nan))
    return pd.DataFrame(rows, columns=["phase", "n_grains", "coordination", "rattlers"])


def lost_support(
    forces: pd.DataFrame, packed: pd.DataFrame, size_um: tuple[float, float, float] | None = None
) -> dict:
    """How many grains leaned on virtual spheres and cannot stand without them.

    A grain is carried by bodies that press on it; :data:`RATTLER_CONTACTS` of them hold it up. A grain that
    had so many and has fewer once the spheres are gone has lost its support (what it leans on may itself
    fall: :func:`grainfall.packing.settle` shows what becomes of that).

    Parameters
    ----------
    forces : DataFrame
        a, b (ids), force_n of the packing as it came to rest, spheres included.
    packed : DataFrame
        Its bodies (columns of bodies.csv).
    size_um : (float, float, float), optional
        Size of the region of interest along x, y, z: grains centred in it are counted.

    Returns
    -------
    dict
        on_spheres: share of grains that touch a sphere with force; lost_support: share of grains that lost
        theirs. None without grains.
    """
    grains = packed[packed["kind"] == "grain"]
    if size_um is not None:
        grains = grains[_inside(grains, np.asarray(size_um, float))]
    if grains.empty:
        return {"on_spheres": None, "lost_support": None}
    pressing = forces[forces["force_n"] > 0]
    pairs = np.vstack([pressing[["a", "b"]].to_numpy(int), pressing[["b", "a"]].to_numpy(int)])
    virtual = np.isin(pairs[:, 1], packed.loc[packed["kind"] == "virtual", "id"])
    n = int(packed["id"].max()) + 1
    every, spheres = (np.bincount(pairs[which, 0], minlength=n) for which in (slice(None), virtual))
    every, spheres = every[grains["id"]], spheres[grains["id"]]
    lost = (every >= RATTLER_CONTACTS) & (every - spheres < RATTLER_CONTACTS)
    return {"on_spheres": float((spheres > 0).mean()), "lost_support": float(lost.mean())}


def max_overlap(
    bodies: pd.DataFrame,
    library: Library,
    size_um: tuple[float, float, float] | None = None,
    parameters: Parameters | None = None,
) -> float:
    """Deepest penetration of two grains over the smaller one's radius, 0 where none overlap.

    Parameters
    ----------
    bodies : DataFrame
        Columns of ``bodies.csv``; radius is that of the equal-volume sphere.
    library : Library
        Shapes; the convex hulls of their meshes are compared, an upper bound where they are not convex. The
        simplified hulls of the engine overlap far less; their difference from the mesh is counted here.
    size_um : (float, float, float), optional
        Size of the region of interest along x, y, z: only grains whose bounding spheres meet it are compared.
    parameters : Parameters, optional
        Of grains that the engine collided as several parts, compare those parts in place of the hull.
    """
    grains = bodies[bodies["kind"] == "grain"]
    if parameters is not None:
        parts = collided(library, grains["shape"], parameters).parts
        library = Hulls({s: p if len(p) > 1 else (library.vertices[s],) for s, p in parts.items()})
    if size_um is not None:
        points = grains[["x", "y", "z"]].to_numpy(float)
        outside = points - np.clip(points, 0, np.asarray(size_um, float))
        grains = grains[np.linalg.norm(outside, axis=1) <= bounding_radii(grains, library)]
    pairs = closest_points(grains, library, 0.0)
    scale = grains.set_index("id")["scale"]
    smaller = np.minimum(scale.loc[pairs["a"]].to_numpy(), scale.loc[pairs["b"]].to_numpy())
    return float(np.max(-pairs["gap_um"].to_numpy() / smaller, initial=0.0))
