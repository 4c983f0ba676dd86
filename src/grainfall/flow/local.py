r"""Conductances of pores from the flow through their voxels, each pore by itself.

Pores meet at the necks of the distance map, where the pressure hardly varies across the flow. So on every
throat's interface the pressure is taken as a plane, :math:`a + \mathbf{b} \cdot \mathbf{x}`: one unknown for
the throat and one for each direction in which its interface is wider than the voxels can hide. A pore answers
the pressures :math:`P` on its interfaces with flow rates :math:`G P`, where :math:`P^T G P` is the power of
the local solution of the elliptic model (:mod:`grainfall.flow.elliptic`), div(w grad p) = 0 within the pore.

What the velocities of these solutions do dissipate by friction, straining included, is :math:`P^T D P`,
more than the model pays for. Reckoned with it, the pore's conductance is :math:`G D^+ G`: the elliptic
model's lower bound pore by pore. Pressures held to planes err to the other side.

The pores meet at the throats' unknowns: a pore with z throats is not one resistance from its centre to each,
but a matrix of conductances between all of them, so that nothing is reckoned twice and a straight duct comes
out within a percent, the tolerance of the local solutions, however it is parted. A pore that winds far is
solved for more closely, and refused where single precision cannot. Conduction of a current is the same with
w = 1, and no correction. Lengths are voxels, viscosity and conductivity 1.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from grainfall.flow.elliptic import AXES, image_axis
from grainfall.flow.mobility import mobility
from grainfall.flow.multigrid import BLOCK, Multigrid, dot, solve_symmetric
from grainfall.flow.multiport import conductances
from grainfall.network import Interfaces

RESOLVED = 1.0
"""Standard deviation of an interface's faces along a direction, in voxels, from which on it has a slope."""

EXACT = 1e-10
"""Residual of the pressures between pores."""

MANY = 5000
"""Unknowns between pores from which on their matrix is not factorised."""


class Rates(NamedTuple):
    """Conductances of a volume along an axis.

    Attributes
    ----------
    hydraulic : float
        Flow rate at unit pressure drop and viscosity, voxels^3; 0 where no path leads from face to face.
    electrical : float
        Current at unit voltage and conductivity, voxels; likewise.
    imbalance : float
        Of the flow rates at the two faces, relative.
    """

    hydraulic: float
    electrical: float
    imbalance: float


class Ports(NamedTuple):
    """Faces through which pores exchange, sorted by pore.

    Attributes
    ----------
    pore, voxel, way, throat : (f,) int
        Pore from 0; flat index of its voxel; face of that voxel, 2 * axis + (1 for the upper one); throat.
    slopes : (f, 3) float32
        Pressure at the face at unit value of each of the throat's slopes: coordinates in standard deviations.
    """

    pore: np.ndarray
    voxel: np.ndarray
    way: np.ndarray
    throat: np.ndarray
    slopes: np.ndarray


class Throats(NamedTuple):
    """What the pressures on m throats and two faces of the volume are made of.

    Attributes
    ----------
    first : (m + 3,) int
        First unknown of each, its mean pressure, before those of its slopes; then their number.
    centre : (m, 3) float
        Middle of a throat's faces (z, y, x).
    """

    first: np.ndarray
    centre: np.ndarray


def solve(labels: np.ndarray, found: Interfaces, threads: int = 1) -> dict[str, Rates]:
    """Conductances of a volume between opposite faces, its other sides sealed.

    Parameters
    ----------
    labels : (nz, ny, nx) ndarray of int32
        Pore of each voxel from 1, 0 in the solid; see :func:`grainfall.network.partition`.
    found : Interfaces
    threads : int
        At work on pores; the result does not depend on it.

    Returns
    -------
    dict
        :class:`Rates` along x, y and z.
    """
    throats, ports = throat_ports(labels, found)
    pores = Pores(labels, throats)
    sealed = pores.answers(ports, np.arange(pores.count), threads)
    rates = {}
    for axis in AXES:
        faces = face_ports(labels, image_axis(axis), len(throats.centre))
        at_faces = np.unique(faces.pore)
        mine = np.isin(ports.pore, at_faces)
        both = _by_pore(*(np.concatenate([p[mine], f]) for p, f in zip(ports, faces, strict=True)))
        inner = ~np.isin(sealed.pore, at_faces)
        opened = pores.answers(both, at_faces, threads)
        answers = [Answers(*(values[inner] for values in sealed)), opened]
        hydraulic, imbalance = _between(answers, "hydraulic", throats, labels.shape)
        electrical, other = _between(answers, "electrical", throats, labels.shape)
        rates[axis] = Rates(hydraulic, electrical, max(imbalance, other))
    return rates


def throat_ports(labels: np.ndarray, found: Interfaces) -> tuple[Throats, Ports]:
    """Throats, and both sides of all their faces."""
    real = found.conns[found.throats, 0] != found.conns[found.throats, 1]  # a ring is not cut
    voxel, axis, throat = found.voxels[real], found.axes[real], found.throats[real]
    m = len(found.conns)
    slopes, centre = np.zeros((len(voxel), 3), np.float32), np.zeros((m, 3))
    count = np.zeros(m + 2, np.int64)
    count[m:] = 1
    starts = np.searchsorted(throat, np.arange(m + 1))  # faces come throat by throat
    for t in np.flatnonzero(np.diff(starts)):
        mine = slice(starts[t], starts[t + 1])
        place = np.stack(np.unravel_index(voxel[mine], labels.shape), axis=1).astype(float)
        place[np.arange(len(place)), axis[mine]] += 0.5
        centre[t] = place.mean(axis=0)
        away = place - centre[t]
        variance, directions = np.linalg.eigh(away.T @ away / len(away))
        wide = np.flatnonzero(variance > RESOLVED**2)[::-1]
        count[t] = 1 + len(wide)
        slopes[mine, : len(wide)] = away @ directions[:, wide] / np.sqrt(variance[wide])
    first = np.concatenate([[0], np.cumsum(count)])
    step = np.array([labels.shape[1] * labels.shape[2], labels.shape[2], 1], voxel.dtype)
    voxel = np.concatenate([voxel, voxel + step[axis]])
    ports = _by_pore(
        labels.reshape(-1)[voxel] - 1,
        voxel,
        np.concatenate([2 * axis + 1, 2 * axis]),
        np.tile(throat, 2),
        np.tile(slopes, (2, 1)),
    )
    return Throats(first, centre), ports


def face_ports(labels: np.ndarray, axis: int, throat: int) -> Ports:
    """Where pores open onto the two faces of the image across ``axis``, throats ``throat`` and the next."""
    ends = []
    for side in (0, 1):
        place = np.insert(
            np.argwhere(labels.take(-side, axis) > 0), axis, side * (labels.shape[axis] - 1), axis=1
        )
        voxel = np.ravel_multi_index(tuple(place.T), labels.shape)
        n = len(voxel)
        way, number = np.full(n, 2 * axis + side, np.int8), np.full(n, throat + side, np.int32)
        ends.append((labels.reshape(-1)[voxel] - 1, voxel, way, number, np.zeros((n, 3), np.float32)))
    return _by_pore(*(np.concatenate(pair) for pair in zip(*ends, strict=True)))


def _by_pore(*values: np.ndarray) -> Ports:
    order = np.argsort(values[0], kind="stable")
    return Ports(*(v[order] for v in values))


class Answers(NamedTuple):
    """What pores answer to the pressures on their interfaces, entry by entry of their matrices.

    Attributes
    ----------
    pore : (e,) int32
        From 0.
    row, column : (e,) int32
        Unknowns.
    hydraulic, electrical : (e,) float
        Conductances between them.
    """

    pore: np.ndarray
    row: np.ndarray
    column: np.ndarray
    hydraulic: np.ndarray
    electrical: np.ndarray


NO_ANSWERS = Answers(*(np.zeros(0, kind) for kind in (np.int32, np.int32, np.int32, float, float)))


class Pores:
    """The voxels of every pore and the mobilities of their faces."""

    def __init__(self, labels: np.ndarray, throats: Throats):
        self.labels, self.throats = labels, throats
        self.mobility = mobility(labels > 0)
        self.count = int(labels.max())
        self.order, self.starts = _by_label(labels.reshape(-1), self.mobility.voxels, self.count)

    def answers(self, ports: Ports, which: np.ndarray, threads: int) -> Answers:
        """Conductances of each of the pores ``which`` that has two unknowns; others let nothing through."""
        mobility = self.mobility
        at_ports = _at_ports(self.labels.shape, mobility.voxels, mobility.lower, *mobility.upper, *ports[1:3])

        def answer(b: int, start: int, stop: int) -> Answers:
            throats = np.unique(ports.throat[start:stop])
            unknowns = [np.arange(*self.throats.first[t : t + 2], dtype=np.int32) for t in throats]
            count = np.array(list(map(len, unknowns)), int)
            if count.sum() < 2:
                return NO_ANSWERS
            own = self.order[self.starts[b] : self.starts[b + 1]]
            matrices = conductances(
                self.labels,
                mobility.voxels[own],
                mobility.lower[own],
                tuple(values[start:stop] for values in ports[1:]),
                at_ports[start:stop],
                throats,
                count,
            )
            unknowns = np.concatenate(unknowns)
            k = len(unknowns)
            whose = np.full(k * k, b, np.int32), np.repeat(unknowns, k), np.tile(unknowns, k)
            return Answers(*whose, *(m.ravel() for m in matrices))

        with ThreadPoolExecutor(threads) as pool:
            found = pool.map(answer, which, *np.searchsorted(ports.pore, [which, which + 1]))
            return Answers(*map(np.concatenate, zip(NO_ANSWERS, *found, strict=True)))


@njit(cache=True)
def _by_label(labels, voxels, count):
    """Voxels, by their numbers, label by label, and where each label starts."""
    starts = np.zeros(count + 2, np.int64)
    for i in range(len(voxels)):
        starts[labels[voxels[i]] + 1] += 1
    starts = np.cumsum(starts)
    order, top = np.empty_like(voxels), starts.copy()
    for i in range(len(voxels)):
        label = labels[voxels[i]]
        order[top[label]] = i
        top[label] += 1
    return order, starts[1:]


@njit(cache=True)
def _at_ports(shape, voxels, lower, upper0, upper1, upper2, voxel, way):
    """Mobilities of the ports."""
    nz, ny, nx = shape
    found = np.empty(len(voxel), np.float32)
    for f in range(len(voxel)):
        v, c = np.int64(voxel[f]), way[f] // 2
        z = v // (ny * nx)
        y = v // nx - z * ny
        x = v - (z * ny + y) * nx
        if way[f] % 2:
            v += ny * nx if c == 0 else nx if c == 1 else 1
            z, y, x = z + (c == 0), y + (c == 1), x + (c == 2)
        if z == nz:
            found[f] = upper0[y, x]
        elif y == ny:
            found[f] = upper1[z, x]
        elif x == nx:
            found[f] = upper2[z, y]
        else:
            found[f] = lower[np.searchsorted(voxels, v), c]
    return found


def _between(
    answers: list[Answers], kind: str, throats: Throats, shape: tuple[int, int, int]
) -> tuple[float, float]:
    """Conductance between the last two unknowns, and the relative imbalance of the rates there."""
    n = throats.first[-1]
    row, column, value = (np.concatenate([getattr(a, of) for a in answers]) for of in ("row", "column", kind))
    matrix = csr_array(coo_array((value, (row, column)), shape=(n, n)))
    del row, column, value
    _, cluster = connected_components(matrix, directed=False)
    if cluster[n - 2] != cluster[n - 1]:
        return 0.0, 0.0
    free = np.flatnonzero(cluster[:-2] == cluster[n - 1])
    pressure = np.zeros(n)
    pressure[n - 2] = 1.0
    if len(free):
        solve_for = _inverse(matrix[free][:, free], throats, free, shape)
        for _ in range(2):  # the second refines the first
            pressure[free] -= solve_for((matrix @ pressure)[free])
    rate = matrix @ pressure
    power = dot(pressure, rate)
    return power, abs(rate[n - 2] + rate[n - 1]) / power


def _inverse(
    matrix: csr_array, throats: Throats, free: np.ndarray, shape: tuple[int, int, int]
) -> Callable[[np.ndarray], np.ndarray]:
    """Solver for a matrix between unknowns: factors, or conjugate gradients where these would fill."""
    if len(free) < MANY:
        symmetric = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        return splu(matrix.tocsc(), "MMD_AT_PLUS_A", **symmetric).solve
    throat = np.searchsorted(throats.first, free, "right") - 1
    apart = (np.prod(shape) / len(throats.centre)) ** (1 / 3)
    coords = np.column_stack([BLOCK * (free - throats.first[throat]), throats.centre[throat] // apart])
    cycle = Multigrid(matrix, coords.astype(np.int64))
    return lambda rhs: solve_symmetric(matrix, rhs, cycle, EXACT)
