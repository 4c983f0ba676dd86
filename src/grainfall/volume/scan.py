"""Exact voxelisation of closed meshes and spheres by scan conversion.

A voxel belongs to a body when its centre lies in the body's closed mesh. The mesh is cut by each plane of
voxel centres (z = k), each cut by each row (y = j), and along the row the crossings are toggled (even-odd
rule). Everything is half-open: an edge meets plane k when min z <= k < max z, a cut meets row j when min y
<= j < max y, and a crossing at x toggles voxels i >= x. Two faces that share an edge compute its cut from
the same two vertices in the same order, hence to the same bits: on a closed mesh every row has an even
number of crossings, no gap opens between faces, and bodies that share a face tile without a gap or a voxel
counted twice.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil, floor, prod, sqrt
from typing import Protocol

import numpy as np
import pandas as pd
import scipy  # its transforms load when they are first used
from numba import njit

SPHERE = -1
"""Shape id of a body that is a sphere of radius ``scale``, not a mesh of the library."""

VIRTUAL = 255
"""Phase label of virtual bodies."""


class Meshes(Protocol):
    """What voxelisation needs of a grain library: closed meshes of equal-volume radius 1."""

    vertices: Sequence[np.ndarray]
    faces: Sequence[np.ndarray]


def voxelise(
    bodies: pd.DataFrame,
    library: Meshes,
    shape: tuple[int, int, int],
    voxel_size_um: float,
    origin_um: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[np.ndarray, np.ndarray]:
    """Voxelise bodies: the phase and the body of every voxel.

    Parameters
    ----------
    bodies : DataFrame
        Columns id, kind (grain or virtual), phase, shape, scale, x, y, z, qw, qx, qy, qz; lengths in um. A
        vertex v of the library lies at position + R(q) (scale v); shape -1 is a sphere of radius scale.
    library : Library
        ``vertices[shape]`` (n, 3) in (x, y, z) order and ``faces[shape]`` (m, 3) of closed meshes.
    shape : (nz, ny, nx)
        Voxels of the region of interest.
    voxel_size_um : float
        Edge of a voxel.
    origin_um : (x, y, z)
        Corner of the region; voxel i has its centre at origin + (i + 0.5) voxel_size_um.

    Returns
    -------
    phase : (nz, ny, nx) uint8
        0 pore, the body's phase, or :data:`VIRTUAL` for virtual bodies.
    body : (nz, ny, nx) int32
        Body id + 1, 0 pore.

    Raises
    ------
    ValueError
        When a mesh is not closed, or the table holds an unknown kind, a repeated id or a figure that is not
        finite.

    Notes
    -----
    Where bodies overlap, grains win over virtual ones, and among equals the lower id wins.
    """
    shape = tuple(int(n) for n in shape)
    phase, body = np.empty(shape, np.uint8), np.empty(shape, np.int32)
    _Scene(bodies, library, voxel_size_um, origin_um).fill(0, phase, body)
    return phase, body


def voxelise_slabs(
    bodies: pd.DataFrame,
    library: Meshes,
    shape: tuple[int, int, int],
    voxel_size_um: float,
    origin_um: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    slab: int = 64,
    planes: tuple[int, int] | None = None,
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Voxelise slab by slab where the whole volume should not be held at once.

    Parameters are those of :func:`voxelise`, ``slab``: planes at a time, which changes memory and never the
    result, and ``planes``: start and stop of those wanted, all if omitted.

    Yields
    ------
    z : int
        First plane of the slab.
    phase, body : (<= slab, ny, nx) uint8 and int32
    """
    scene = _Scene(bodies, library, voxel_size_um, origin_um)
    start, stop = planes or (0, shape[0])
    for z in range(start, stop, slab):
        part = (min(slab, stop - z), *shape[1:])
        phase, body = np.empty(part, np.uint8), np.empty(part, np.int32)
        scene.fill(z, phase, body)
        yield z, phase, body


def packed_porosity(
    bodies: pd.DataFrame,
    library: Meshes,
    shape: tuple[int, int, int],
    voxel_size_um: float,
) -> float:
    """Porosity of bodies as voxels, which are never all held at once.

    Parameters are those of :func:`voxelise`. Virtual bodies count as solid.
    """
    slabs = voxelise_slabs(bodies, library, shape, voxel_size_um)
    solid = sum(int(np.count_nonzero(body)) for _, _, body in slabs)
    return 1.0 - solid / prod(int(n) for n in shape)


def claimed_slabs(
    bodies: pd.DataFrame,
    library: Meshes,
    shape: tuple[int, int, int],
    voxel_size_um: float,
) -> Iterator[tuple[np.ndarray, int]]:
    """Voxelise slab by slab, and count what several bodies claim: what a packing owes to overlaps.

    Parameters are those of :func:`voxelise`. A voxel is given to the lowest id that claims it; scanned with
    the ids in the opposite order, what only one body claims is given to the same one.

    Yields
    ------
    body : (<= slab, ny, nx) int32
    shared : int
        Voxels of the slab that two bodies or more claim.
    """
    ids = bodies["id"].to_numpy(np.int64)
    last = int(ids.max(initial=0))
    turned = voxelise_slabs(bodies.assign(id=last - ids), library, shape, voxel_size_um)
    slabs = voxelise_slabs(bodies, library, shape, voxel_size_um)
    for (_, _, body), (_, _, other) in zip(slabs, turned, strict=True):
        yield body, int(np.count_nonzero((body > 0) & (body != last + 2 - other)))


def porosity_about(
    bodies: pd.DataFrame,
    library: Meshes,
    shape: tuple[int, int, int],
    voxel_size_um: float,
    reach: int,
) -> np.ndarray:
    """Porosity of the region and of every region moved by up to ``reach`` voxels along each axis.

    Parameters are those of :func:`packed_porosity`. One plane of voxels is held at a time, as sums from its
    corner: four of them give the solid of a window, and sums along z the solid of a region.

    Returns
    -------
    (2 reach + 1,) * 3 array of float
        By z, y and x; the region itself is in the middle.
    """
    nz, ny, nx = (int(n) for n in shape)
    places = 2 * reach + 1
    wide = (nz + 2 * reach, ny + 2 * reach, nx + 2 * reach)
    solid = np.zeros((wide[0] + 1, places, places), np.int64)
    corner = (-reach * voxel_size_um,) * 3
    for z, _, body in voxelise_slabs(bodies, library, wide, voxel_size_um, corner):
        for k, plane in enumerate(body > 0, start=z + 1):
            sums = np.pad(plane.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
            rows = sums[ny:] - sums[:places]
            solid[k] = rows[:, nx:] - rows[:, :places]
    up_to = solid.cumsum(axis=0)
    return 1.0 - (up_to[nz:] - up_to[:places]) / (nz * ny * nx)


class _Scene:
    """Bodies in order of precedence, in voxel units where centre i lies at i."""

    def __init__(self, bodies, library, voxel_size_um, origin_um):
        unknown = set(bodies["kind"]) - {"grain", "virtual"}
        if unknown:
            raise ValueError(f"unknown kind of body: {sorted(map(str, unknown))}")
        if bodies["id"].duplicated().any():
            raise ValueError(f"body id {bodies['id'][bodies['id'].duplicated()].iloc[0]} is repeated")
        virtual = (bodies["kind"] == "virtual").to_numpy()
        bodies = bodies.iloc[np.lexsort((bodies["id"].to_numpy(), virtual))]
        virtual = (bodies["kind"] == "virtual").to_numpy()
        figures = bodies[["scale", "x", "y", "z", "qw", "qx", "qy", "qz"]].to_numpy(np.float64, copy=True)
        if not np.isfinite(figures).all():
            raise ValueError("scale, position or orientation of a body is not finite")
        self.shapes = bodies["shape"].to_numpy(np.int64)
        self.labels = bodies["id"].to_numpy(np.int64).astype(np.int32) + np.int32(1)
        self.phases = np.where(virtual, VIRTUAL, bodies["phase"].to_numpy()).astype(np.uint8)
        self.scale = figures[:, 0] / voxel_size_um
        self.centre = (figures[:, 1:4] - np.asarray(origin_um, float)) / voxel_size_um - 0.5
        turn = scipy.spatial.transform.Rotation.from_quat(figures[:, 4:], scalar_first=True)
        self.rotation = turn.as_matrix()
        used = np.unique(self.shapes[self.shapes != SPHERE])
        self.vertices = {s: np.ascontiguousarray(library.vertices[s], np.float64) for s in used}
        self.faces = {s: np.ascontiguousarray(library.faces[s], np.int64) for s in used}
        reach = {s: float(np.linalg.norm(v, axis=1).max()) for s, v in self.vertices.items()} | {SPHERE: 1.0}
        self.reach = self.scale * np.array([reach[s] for s in self.shapes])

    def fill(self, z0: int, phase: np.ndarray, body: np.ndarray) -> None:
        """Scan the planes from ``z0`` on into the two arrays."""
        phase[...] = 0
        body[...] = 0
        last = np.array([body.shape[2] - 1, body.shape[1] - 1, z0 + body.shape[0] - 1])
        first = np.array([0, 0, z0])
        reach = self.reach[:, None] + 1e-6
        near = ((self.centre + reach >= first) & (self.centre - reach <= last)).all(axis=1)
        for b in np.flatnonzero(near):
            shape = self.shapes[b]
            if shape == SPHERE:
                _scan_sphere(self.centre[b], self.scale[b], z0, self.labels[b], self.phases[b], phase, body)
                continue
            placed = _place(self.vertices[shape], self.rotation[b], self.scale[b], self.centre[b])
            if not _scan_mesh(placed, self.faces[shape], z0, self.labels[b], self.phases[b], phase, body):
                raise ValueError(f"mesh of shape {shape} is not closed")


@njit(cache=True, nogil=True)
def _place(vertices, rotation, scale, centre):
    # Written out rather than as a matrix product: BLAS may round differently with the number of rows.
    placed = np.empty_like(vertices)
    for i in range(vertices.shape[0]):
        for a in range(3):
            dot = (
                rotation[a, 0] * vertices[i, 0]
                + rotation[a, 1] * vertices[i, 1]
                + rotation[a, 2] * vertices[i, 2]
            )
            placed[i, a] = centre[a] + scale * dot
    return placed


@njit(cache=True, nogil=True)
def _scan_sphere(centre, radius, z0, label, phase_label, phase, body):
    nz, ny, nx = body.shape
    for k in range(max(z0, ceil(centre[2] - radius)), min(z0 + nz - 1, floor(centre[2] + radius)) + 1):
        rest = radius * radius - (k - centre[2]) ** 2
        if rest <= 0.0:
            continue
        reach = sqrt(rest)
        for j in range(max(0, ceil(centre[1] - reach)), min(ny - 1, floor(centre[1] + reach)) + 1):
            half = rest - (j - centre[1]) ** 2
            if half <= 0.0:
                continue
            half = sqrt(half)
            for i in range(max(0, ceil(centre[0] - half)), min(nx, ceil(centre[0] + half))):
                if body[k - z0, j, i] == 0:
                    body[k - z0, j, i] = label
                    phase[k - z0, j, i] = phase_label


@njit(cache=True, nogil=True)
def _cut(p, q, k):
    """x and y where the edge pq meets the plane z = k; the same bits whichever face asks."""
    if (q[2], q[1], q[0]) < (p[2], p[1], p[0]):
        p, q = q, p
    t = (k - p[2]) / (q[2] - p[2])
    return p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])


@njit(cache=True, nogil=True)
def _scan_mesh(vertices, faces, z0, label, phase_label, phase, body):
    """Scan one closed mesh into the planes from ``z0`` on; False if it is not closed."""
    nz, ny, nx = body.shape
    low, high = vertices[0].copy(), vertices[0].copy()
    for v in range(1, vertices.shape[0]):
        for a in range(3):
            low[a] = min(low[a], vertices[v, a])
            high[a] = max(high[a], vertices[v, a])
    i0, i1 = max(0, ceil(low[0])), min(nx, ceil(high[0]))
    j0, j1 = max(0, ceil(low[1])), min(ny, ceil(high[1]))
    k0, k1 = max(z0, ceil(low[2])), min(z0 + nz, ceil(high[2]))
    if i0 >= i1 or j0 >= j1 or k0 >= k1:
        return True
    # Crossings beyond the region are toggled at its borders: the last column only keeps the row's parity.
    toggled = np.zeros((k1 - k0, j1 - j0, i1 - i0 + 1), np.uint8)
    for f in range(faces.shape[0]):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        bottom, top = min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
        for k in range(max(k0, ceil(bottom)), min(k1, ceil(top))):
            above_a, above_b, above_c = a[2] > k, b[2] > k, c[2] > k
            # One vertex is alone on its side of the plane: the cut runs between its two edges.
            if above_b == above_c:
                x0, y0 = _cut(a, b, k)
                x1, y1 = _cut(a, c, k)
            elif above_a == above_c:
                x0, y0 = _cut(b, c, k)
                x1, y1 = _cut(b, a, k)
            else:
                x0, y0 = _cut(c, a, k)
                x1, y1 = _cut(c, b, k)
            if y1 < y0:
                x0, y0, x1, y1 = x1, y1, x0, y0
            for j in range(max(j0, ceil(y0)), min(j1, ceil(y1))):
                x = x0 + (j - y0) / (y1 - y0) * (x1 - x0)
                toggled[k - k0, j - j0, min(max(ceil(x), i0), i1) - i0] ^= 1
    closed = True
    for k in range(k1 - k0):
        for j in range(j1 - j0):
            inside = 0
            for i in range(i1 - i0):
                inside ^= toggled[k, j, i]
                if inside and body[k + k0 - z0, j + j0, i + i0] == 0:
                    body[k + k0 - z0, j + j0, i + i0] = label
                    phase[k + k0 - z0, j + j0, i + i0] = phase_label
            closed &= inside == toggled[k, j, i1 - i0]
    return closed
