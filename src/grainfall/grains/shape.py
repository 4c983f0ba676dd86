"""One closed grain from three orthogonal masks, and the exact mass properties of a mesh.

The construction (Mollon & Zhao 2013; the paper's section on grain shapes):

1. The contours of the masks share a centre. A contour meets its two axes at four half-axes; each of the six
   half-axes of the grain, ±x, ±y, ±z, is seen by two masks. The agreed length of a half-axis k and one
   scale s_m for each mask are those of the least squares of ``log l_mk + log s_m − log L_k``: a mask's
   shape is changed as little as possible, and its scale is left free because central sections of one grain
   differ in size.
2. Every quadrant of a mask is stretched to the agreed half-axes, that is, with half-axes of 1 each mask goes
   through ±1. In these coordinates an ellipsoid is the unit sphere.
3. Four half-contours come from the two vertical masks; the horizontal mask is R(θ). At height z the
   horizontal section is ρ(θ, z) = R(θ) s(θ, z), with s the half-widths of the four half-contours at z,
   blended over θ by cos² and sin². A half-contour that is not single-valued in z (a tilted grain's) is read
   by its polar angle t instead: ρ = R(θ) q(θ, t) sin t, z = −q(θ, t) cos t, with the radius q blended over θ.
   Both pass through all three masks and both are single-valued maps of the sphere: the surface cannot
   cross itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import lazy_loader
import numpy as np

from grainfall.grains import contours as ct

trimesh = lazy_loader.load("trimesh")  # 0.3 s, for jobs that make or write meshes

_MASKS = ((0, 1), (0, 2), (1, 2))  # the axes (u, v) of the masks xy, xz, yz
_RESOLUTION = 48  # points around the equator
_WELL_REPRODUCED = 0.98  # overlap of a section with its mask
_WORTH_FINER = 0.002  # gain in overlap for which a mesh gets four times the vertices
_FINE = 8  # rays to each corner of a section when it is fitted to a contour
_FLOOR = 0.01  # least half-width of a section, relative to the half-axis: keeps a pinched mesh closed


@dataclass
class Grain:
    """A closed triangle mesh made from three masks.

    Attributes
    ----------
    vertices : (n, 3) float ndarray
        In (x, y, z) order about the common centre of the masks. The unit is the geometric mean of the masks'
        equal-area radii.
    faces : (m, 3) int32 ndarray
        Counter-clockwise seen from outside.
    stretch : float
        Largest factor (or its inverse) by which a half-axis of a mask was stretched, scale aside; 1 is none.
    iou : (3,) float ndarray
        Intersection over union of the mesh's central sections xy, xz, yz with the aligned masks.
    reading : str
        ``"height"`` or ``"angle"``: how the half-contours were read.
    aligned : list of (n, 2) float ndarray
        The three contours after alignment, in the mesh's coordinates.
    """

    vertices: np.ndarray
    faces: np.ndarray
    stretch: float = 1.0
    iou: np.ndarray = field(default_factory=lambda: np.ones(3))
    reading: str = "height"
    aligned: list[np.ndarray] = field(default_factory=list)


def grain_from_masks(
    horizontal: np.ndarray,
    vertical_xz: np.ndarray,
    vertical_yz: np.ndarray,
    *,
    resolution: int | None = None,
) -> Grain:
    """The closed 3D grain whose central sections are three given masks.

    Parameters
    ----------
    horizontal, vertical_xz, vertical_yz : (h, w) bool ndarray
        Masks of the planes xy, xz and yz: columns run along the first axis, rows against the second.
    resolution : int, optional
        Points around the equator n, a multiple of 4, at least 8; the mesh has n²/2 − n + 2 vertices. If
        omitted, 48 (1,106 vertices), or 96 where a mask is reproduced to less than 0.98 and that helps.

    Returns
    -------
    Grain

    Raises
    ------
    Unusable
        Where a mask is empty, a speck or a line (a ``ValueError`` with the reason).

    Notes
    -----
    Mollon & Zhao (2013), Granular Matter 15; exact for ellipsoids up to the resolution.
    """
    masks = (horizontal, vertical_xz, vertical_yz)
    return grain_from_contours([unit_contour(m) for m in masks], resolution=resolution)


def unit_contour(mask: np.ndarray) -> np.ndarray:
    """The contour of a mask about its best centre, in units of its equal-area radius."""
    contour, overlap = ct.best_centre(ct.mask_contour(mask))
    if overlap <= 0:
        raise ct.Unusable("no inner point")
    return contour / np.sqrt(ct.polygon_moments(contour)[0] / np.pi)


def grain_from_contours(contours: list[np.ndarray], *, resolution: int | None = None) -> Grain:
    """As :func:`grain_from_masks`, from three contours about the common centre.

    Parameters
    ----------
    contours : list of three (n, 2) float ndarray
        Of the planes xy, xz, yz, counter-clockwise around the origin, each in units of its equal-area radius.
    resolution : int, optional
        As there.
    """
    if resolution is None:
        grain = grain_from_contours(contours, resolution=_RESOLUTION)
        if grain.iou.min() < _WELL_REPRODUCED:
            finer = grain_from_contours(contours, resolution=2 * _RESOLUTION)
            if finer.iou.min() > grain.iou.min() + _WORTH_FINER:
                return finer
        return grain
    if resolution < 8 or resolution % 4:
        raise ValueError(f"resolution {resolution} must be a multiple of 4, at least 8")
    seen = np.array([half_axes_seen(c) for c in contours])
    half_axes, stretch = agreed_half_axes(seen)
    unit = [_quadrants(c, 1 / s[[0, 2]], 1 / s[[1, 3]]) for c, s in zip(contours, seen, strict=True)]
    aligned = [_quadrants(c, half_axes[u], half_axes[v]) for c, (u, v) in zip(unit, _MASKS, strict=True)]

    best: Grain | None = None
    for reading in ("height", "angle"):
        grid = _surface(unit, resolution, reading)
        for axis in range(3):
            grid[..., axis] *= np.where(grid[..., axis] > 0, half_axes[axis, 0], half_axes[axis, 1])
        iou = _section_ious(grid, aligned)
        # the height reading is the paper's: keep it unless the other is truly closer to the masks
        if best is None or iou[1:].sum() > best.iou[1:].sum() + 0.01:
            best = Grain(*_mesh(grid), stretch, iou, reading, aligned)
    return best


def half_axes_seen(contour: np.ndarray) -> np.ndarray:
    """Half-axes (4,) at which a contour meets +u, +v, −u and −v."""
    return ct.ray_radii(contour, np.arange(4) * (np.pi / 2))


def agreed_half_axes(seen: np.ndarray) -> tuple[np.ndarray, float]:
    """Half-axes of the grain nearest to those that its three masks show, the scale of each mask free.

    Parameters
    ----------
    seen : (3, 4) float ndarray
        From :func:`half_axes_seen`, of the masks xy, xz, yz.

    Returns
    -------
    half_axes : (3, 2) float ndarray
        Along +x, −x; +y, −y; +z, −z.
    stretch : float
        Largest factor (or its inverse) by which a half-axis of a mask has to change.
    """
    values = np.log(seen).ravel()
    solution = _LEAST_SQUARES @ values
    solution -= solution[6:].mean()  # the scale of the whole is free too: keep that of the masks
    residual = values - _HALF_AXES @ solution
    return np.exp(solution[:6]).reshape(3, 2), float(np.exp(np.abs(residual).max()))


def _half_axis_equations() -> np.ndarray:
    """Rows (12, 9): log half-axis of a mask = log half-axis of the grain − log scale of the mask."""
    rows = np.zeros((12, 9))
    for m, (u, v) in enumerate(_MASKS):
        for k, half_axis in enumerate((2 * u, 2 * v, 2 * u + 1, 2 * v + 1)):
            rows[4 * m + k, [half_axis, 6 + m]] = 1.0, -1.0
    return rows


_HALF_AXES = _half_axis_equations()
_LEAST_SQUARES = np.linalg.pinv(_HALF_AXES)


def _quadrants(contour: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The contour with each side stretched by its own factor: (plus, minus) along u and along v."""
    sides = (contour < 0).astype(int)
    return np.stack([contour[:, 0] * u[sides[:, 0]], contour[:, 1] * v[sides[:, 1]]], axis=1)


def _surface(unit: list[np.ndarray], n: int, reading: str) -> np.ndarray:
    """Points (rings + 2 poles, n, 3) in the coordinates where all half-axes are 1, from −z to +z."""
    theta = np.arange(n) * (2 * np.pi / n)
    t = np.arange(n // 2 + 1) * (2 * np.pi / n)
    around = _corner_radii(unit[0], n)
    halves = []  # half-contours along +x, +y, −x, −y as functions of t
    if reading == "height":
        for contour in unit[1:]:
            # a mask that is cut square at the pole ends there: look just inside
            widths = ct.level_widths(contour, np.clip(-np.cos(t), -1 + 1e-6, 1 - 1e-6))
            halves.append([w / max(w[n // 4], _FLOOR) for w in widths])
    else:
        for contour in unit[1:]:
            turn = np.roll(_corner_radii(contour, n), n // 4)  # from −z over +x round to −z
            halves.append([turn[: n // 2 + 1], np.append(turn[n // 2 :], turn[0])[::-1]])
    (px, mx), (py, my) = halves
    c, s = np.cos(theta), np.sin(theta)
    c[np.abs(c) < 1e-12] = s[np.abs(s) < 1e-12] = 0.0
    blend = np.where(c > 0, px[:, None], mx[:, None]) * c**2
    blend = blend + np.where(s > 0, py[:, None], my[:, None]) * s**2
    if reading == "height":
        width, z = np.maximum(blend, _FLOOR), np.broadcast_to(-np.cos(t)[:, None], blend.shape)
    else:
        width, z = blend * np.sin(t)[:, None], -blend * np.cos(t)[:, None]
    points = np.stack([around * width * c, around * width * s, z], axis=-1)
    points[0], points[-1] = (0.0, 0.0, -1.0), (0.0, 0.0, 1.0)
    points[n // 4, :, 2] = 0.0
    return points


def _corner_radii(unit: np.ndarray, n: int) -> np.ndarray:
    """Radii (n,) of the corners, at equal angles, of the polygon nearest to a contour through ±1 on the axes.

    Along an edge of a polygon 1/r is linear in the 1/r of its two corners, so the nearest polygon is a linear
    least squares; corners on the contour itself would cut every convex arc and halve the precision.
    """
    fine = np.arange(n * _FINE) * (2 * np.pi / (n * _FINE))
    radii = ct.ray_radii(unit, fine)
    fit, axes_part = _polygon_fit(n)
    inverse = 1 / np.maximum(radii, _FLOOR)
    inverse = np.clip(fit @ inverse - axes_part, inverse.min(), inverse.max())
    return 1 / np.insert(inverse, np.arange(4) * (n // 4 - 1), 1.0)


@cache
def _polygon_fit(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Least squares from 1/r on the fine rays to 1/r at the corners off the axes (those on them are 1).

    Returns the matrix (n − 4, n · _FINE) and what the corners on the axes already explain (n − 4,).
    """
    step, sub = 2 * np.pi / n, np.arange(_FINE) * (2 * np.pi / (n * _FINE))
    basis = np.zeros((n, _FINE, n))
    i = np.arange(n)
    basis[i, :, i] = np.sin(step - sub) / np.sin(step)
    basis[i, :, (i + 1) % n] = np.sin(sub) / np.sin(step)
    basis = basis.reshape(n * _FINE, n)
    on_axis = i % (n // 4) == 0
    free = np.linalg.pinv(basis[:, ~on_axis])
    return free, free @ basis[:, on_axis].sum(axis=1)


def _mesh(grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (pole, rings, pole) and outward triangles of a grid of rings."""
    rings, n = grid.shape[0] - 2, grid.shape[1]
    vertices = np.vstack([grid[0, :1], grid[1:-1].reshape(-1, 3), grid[-1, :1]])
    i = np.arange(n)
    j = (i + 1) % n
    faces = [np.stack([np.zeros(n, int), 1 + j, 1 + i], axis=1)]
    for k in range(rings - 1):
        low, high = 1 + k * n, 1 + (k + 1) * n
        faces += [np.stack([low + i, low + j, high + j], 1), np.stack([low + i, high + j, high + i], 1)]
    last = 1 + (rings - 1) * n
    faces.append(np.stack([last + i, last + j, np.full(n, len(vertices) - 1)], axis=1))
    return vertices, np.vstack(faces).astype(np.int32)


def _section_ious(grid: np.ndarray, aligned: list[np.ndarray]) -> np.ndarray:
    """Overlap of the central sections, whose corners are mesh vertices, with the aligned masks."""
    n = grid.shape[1]
    half = n // 4
    sections = [grid[half][:, [0, 1]]]
    for axis, plus, minus in ((0, 0, 2 * half), (1, half, 3 * half)):
        loop = np.vstack([grid[:, plus], grid[-2:0:-1, minus]])
        sections.append(loop[:, [axis, 2]])
    return np.array([ct.polygon_iou(s, a) for s, a in zip(sections, aligned, strict=True)])


def mass_properties(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume, centre of mass and inertia tensor of the solid inside a closed mesh, exact for the mesh.

    Parameters
    ----------
    vertices : (n, 3) float ndarray
        In (x, y, z) order.
    faces : (m, 3) int ndarray
        Outward.

    Returns
    -------
    volume : float
    centre : (3,) float ndarray
    inertia : (3, 3) float ndarray
        About the centre of mass, at unit density.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    near = vertices.mean(axis=0)  # integrate about a near point: far from the origin digits cancel
    solid = trimesh.triangles.mass_properties((vertices - near)[faces], density=1.0)
    return float(solid.volume), np.asarray(solid.center_mass) + near, np.asarray(solid.inertia)
