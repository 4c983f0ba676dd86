"""A non-convex grain as a few convex pieces, by CoACD."""

from __future__ import annotations

import numpy as np
import scipy  # its parts load when they are first used

MOST_PIECES = 16
"""Bullet takes no more shapes in a compound."""

CONCAVITY = 0.1
"""CoACD's threshold: largest concavity left in a piece, in units of a mesh scaled to the cube (-1, 1).

Grains of a thin section with a mean hull excess of 0.159 (those above 0.1) keep 0.066 in 4.6 pieces.
"""

SEARCH = {"mcts_iterations": 20, "mcts_nodes": 20, "mcts_max_depth": 2, "resolution": 500}
"""A coarser search for cuts than CoACD's own. Halved once more, to 10 iterations and nodes, grains of a thin
section kept the same excess within 0.003 in 3.8 pieces for 3.3 and took 8 % less time, but an L of three
cubes was cut beside its corner."""


def decompose(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, ...]:
    """Convex pieces whose union covers a closed mesh.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int

    Returns
    -------
    tuple of (k, 3) ndarray
        Vertices of the pieces, at most :data:`MOST_PIECES`; none where the mesh is not a closed surface that
        can be cut. The same mesh gives the same bytes.

    Notes
    -----
    Wei, Liu, Ling & Su (2022), ACM Trans. Graph. 41, 42: cuts by planes, found by a tree search that
    minimises the Hausdorff distance of the pieces from their hulls.
    """
    import coacd
    import trimesh

    points = np.ascontiguousarray(vertices, np.float64)
    triangles = np.ascontiguousarray(faces, np.int32)
    mesh = trimesh.Trimesh(points, triangles, process=False)
    # CoACD cuts what it takes for a solid: an open or inside-out surface is none
    if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0):
        return ()
    coacd.set_log_level("off")
    try:
        found = coacd.run_coacd(
            coacd.Mesh(points, triangles),
            threshold=CONCAVITY,
            max_convex_hull=MOST_PIECES,
            preprocess_mode="off",
            seed=0,
            **SEARCH,
        )
    except RuntimeError:
        return ()
    pieces = tuple(np.asarray(piece[0], float) for piece in found)
    return pieces if len(pieces) <= MOST_PIECES and all(_solid(piece) for piece in pieces) else ()


def _solid(points: np.ndarray) -> bool:
    try:
        return scipy.spatial.ConvexHull(points).volume > 0
    except (scipy.spatial.QhullError, ValueError):
        return False


def union_volume(pieces: tuple[np.ndarray, ...], n: int = 64) -> float:
    """Volume of the union of convex pieces, from the lengths inside it of ``n`` by ``n`` vertical lines.

    Parameters
    ----------
    pieces : tuple of (k, 3) ndarray
    n : int
        The error of the volume of a ball is near 1e-3 of it with 64 lines a side.
    """
    low = np.min([piece.min(axis=0) for piece in pieces], axis=0)
    high = np.max([piece.max(axis=0) for piece in pieces], axis=0)
    cell = (high[:2] - low[:2]) / n
    axes = [start + (np.arange(n) + 0.5) * step for start, step in zip(low, cell, strict=False)]
    lines = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    intervals = np.array([_crossings(piece, lines) for piece in pieces])  # (pieces, lines, 2)
    order = intervals[..., 0].argsort(axis=0)
    starts, ends = np.take_along_axis(intervals, order[..., None], axis=0).transpose(2, 0, 1)
    reached = np.maximum.accumulate(np.vstack([np.full((1, len(lines)), low[2]), ends]), axis=0)
    return float(np.maximum(ends - np.maximum(starts, reached[:-1]), 0).sum() * cell.prod())


def _crossings(piece: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Lowest and highest z (m, 2) of a convex piece on vertical lines at (x, y); alike where they miss it."""
    planes = scipy.spatial.ConvexHull(piece).equations
    outside = lines @ planes[:, :2].T + planes[:, 3]
    up, down = planes[:, 2] > 1e-12, planes[:, 2] < -1e-12
    top = (-outside[:, up] / planes[up, 2]).min(axis=1)
    bottom = (-outside[:, down] / planes[down, 2]).max(axis=1)
    beside = (outside[:, ~up & ~down] > 0).any(axis=1)
    return np.column_stack([bottom, np.where(beside, bottom, np.maximum(top, bottom))])
