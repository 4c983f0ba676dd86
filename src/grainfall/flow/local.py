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
out exactly however it is parted. Conduction of a current is the same with w = 1, and no correction. Lengths
are voxels, viscosity and conductivity 1.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numba import njit
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from grainfall.flow.elliptic import AXES, CLOSE, image_axis
from grainfall.flow.multigrid import Multigrid, dot, solve_symmetric
from grainfall.flow.staggered import friction
from grainfall.network import Interfaces, Partition

RESOLVED = 1.0
"""Standard deviation of an interface's faces along a direction, in voxels, from which on it has a slope."""

CLOSE_LOCALLY = 1e-3
"""Residual of the local solutions; errors of the conductances are near its square."""

MOST_STEPS = 1000
"""Of conjugate gradients within a pore; a few tens do."""

AT_ONCE = 16
"""Sources solved for together, lanes of the processor's vectors."""

ROWS = 4096
"""Rows gathered before their products are summed."""


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
    pore, voxel, way : (f,) int
        Pore from 0; flat index of its voxel; face of that voxel, 2 * axis + (1 for the upper one).
    unknowns : (f, 4) int
        Of the interface: its mean pressure, then slopes along its principal directions, -1 where it has none.
    modes : (f, 4) float
        Pressure at the face at unit value of each: 1, then coordinates in standard deviations.
    """

    pore: np.ndarray
    voxel: np.ndarray
    way: np.ndarray
    unknowns: np.ndarray
    modes: np.ndarray


def solve(parts: Partition, found: Interfaces) -> dict[str, Rates]:
    """Conductances of a volume between opposite faces, its other sides sealed.

    Parameters
    ----------
    parts : Partition
    found : Interfaces

    Returns
    -------
    dict
        :class:`Rates` along x, y and z.
    """
    throats, unknowns = throat_ports(parts, found)
    pores = Pores(parts)
    everywhere = np.arange(pores.count)
    sealed = pores.answers(throats, everywhere)
    rates = {}
    for axis in AXES:
        faces = face_ports(parts, image_axis(axis), unknowns)
        at_faces = np.unique(faces.pore)
        both = Ports(*(np.concatenate(pair) for pair in zip(throats, faces, strict=True)))
        inner = np.setdiff1d(everywhere, at_faces)
        answers = {b: sealed[b] for b in inner if b in sealed} | pores.answers(_by_pore(both), at_faces)
        hydraulic, imbalance = _between(answers, 0, unknowns)
        electrical, other = _between(answers, 1, unknowns)
        rates[axis] = Rates(hydraulic, electrical, max(imbalance, other))
    return rates


def throat_ports(parts: Partition, found: Interfaces) -> tuple[Ports, int]:
    """Both sides of every throat's faces, and the number of unknowns."""
    real = found.conns[found.throats, 0] != found.conns[found.throats, 1]  # a ring is not cut
    voxel, axis, throat = found.voxels[real], found.axes[real].astype(np.int64), found.throats[real]
    shape = parts.labels.shape
    flat = parts.labels.reshape(-1)
    beyond = voxel + np.array([shape[1] * shape[2], shape[2], 1])[axis]
    place = np.stack(np.unravel_index(voxel, shape), axis=1).astype(float)
    place[np.arange(len(axis)), axis] += 0.5
    modes = np.zeros((len(voxel), 4))
    modes[:, 0] = 1
    count = np.zeros(len(found.conns), np.int64)
    starts = np.searchsorted(throat, np.arange(len(found.conns) + 1))  # faces come throat by throat
    for t in np.flatnonzero(np.diff(starts)):
        mine = slice(starts[t], starts[t + 1])
        away = place[mine] - place[mine].mean(axis=0)
        variance, directions = np.linalg.eigh(away.T @ away / len(away))
        wide = np.flatnonzero(variance > RESOLVED**2)[::-1]
        count[t] = 1 + len(wide)
        modes[mine, 1 : count[t]] = away @ directions[:, wide] / np.sqrt(variance[wide])
    first = np.concatenate([[0], np.cumsum(count)])
    number = np.arange(4)
    unknowns = np.where(number < count[throat, None], first[throat, None] + number, -1)
    ports = Ports(
        np.concatenate([flat[voxel], flat[beyond]]) - 1,
        np.concatenate([voxel, beyond]),
        np.concatenate([2 * axis + 1, 2 * axis]),
        np.tile(unknowns, (2, 1)),
        np.tile(modes, (2, 1)),
    )
    return _by_pore(ports), int(first[-1])


def face_ports(parts: Partition, axis: int, unknown: int) -> Ports:
    """Where pores open onto the two faces of the image across ``axis``, unknowns ``unknown`` and the next."""
    index = np.arange(parts.labels.size).reshape(parts.labels.shape)
    ends = []
    for side in (0, 1):
        voxel = index.take(-side, axis)[parts.labels.take(-side, axis) > 0]
        pore = parts.labels.reshape(-1)[voxel] - 1
        way = np.full(len(voxel), 2 * axis + side)
        unknowns = np.tile([unknown + side, -1, -1, -1], (len(voxel), 1))
        modes = np.tile([1.0, 0.0, 0.0, 0.0], (len(voxel), 1))
        ends.append(Ports(pore, voxel, way, unknowns, modes))
    return Ports(*(np.concatenate(pair) for pair in zip(*ends, strict=True)))


def _by_pore(ports: Ports) -> Ports:
    order = np.argsort(ports.pore, kind="stable")
    return Ports(*(values[order] for values in ports))


Answer: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Unknowns (k,) of a pore, hydraulic and electrical conductances (k, k) between them."""


class Pores:
    """The voxels of every pore and the mobilities of their faces."""

    def __init__(self, parts: Partition):
        self.labels = parts.labels
        self.count = len(parts.peaks)
        flat = parts.labels.reshape(-1)
        voxels = np.flatnonzero(flat)
        self.voxels = voxels[np.argsort(flat[voxels], kind="stable")]
        self.starts = np.searchsorted(flat[self.voxels], np.arange(1, self.count + 2))
        self.mobility = mobility(parts.labels > 0)
        self.place = np.empty(flat.size, np.int32)

    def answers(
        self, ports: Ports, which: np.ndarray
    ) -> dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Conductances of each of the pores ``which`` that has two unknowns; others let nothing through."""
        found = {}
        starts = np.searchsorted(ports.pore, np.arange(self.count + 1))
        for b in which:
            mine = slice(starts[b], starts[b + 1])
            unknowns = np.unique(ports.unknowns[mine])
            unknowns = unknowns[unknowns >= 0]
            if len(unknowns) < 2:
                continue
            local = np.where(ports.unknowns[mine] < 0, -1, np.searchsorted(unknowns, ports.unknowns[mine]))
            means = np.unique(local[:, 0])
            voxels = self.voxels[self.starts[b] : self.starts[b + 1]]
            sides = ports.voxel[mine], ports.way[mine]
            near, mobile = _stencil(self.labels, b + 1, voxels, *sides, self.place, self.mobility)
            pressed = local, ports.modes[mine]
            conducting = np.where(near == WALL, 0.0, np.where(near < WALL, 2.0, 1.0))
            voltage = _potentials(near, conducting, *pressed, means, len(unknowns))
            electrical, _ = _powers(near, conducting, *pressed, voltage)
            pressure = _potentials(near, mobile, *pressed, means, len(unknowns))
            darcy, velocity = _powers(near, mobile, *pressed, pressure)
            dissipated = _dissipated(voxels, near, velocity, self.mobility)
            found[int(b)] = unknowns, _corrected(darcy, dissipated, means), electrical
        return found


def mobility(pore: np.ndarray) -> np.ndarray:
    """Velocity (3, nz + 1, ny + 1, nx + 1) on the faces under a uniform unit force along each face's normal.

    Component c, at a voxel's index, is that of the voxel's lower face along axis c; 0 on closed faces. Walls
    hold it back, and the volume's sides across which it is; those along which it is let it pass.
    """
    dense = np.zeros((3, *np.add(pore.shape, 1)), np.float32)
    for component in range(3):
        face, volume, matrix = friction(pore, component)
        dense[tuple(face.T)] = solve_symmetric(matrix, volume, Multigrid(matrix, face), CLOSE)
    return dense


def _corrected(darcy: np.ndarray, dissipated: np.ndarray, means: np.ndarray) -> np.ndarray:
    """G D^+ G: conductance by what the velocities dissipate. Equal pressures, of which nothing comes, are
    taken out by grounding an interface and put back by the sum of rates."""
    k = len(darcy)
    kept = np.arange(k) != means[-1]
    g, d = darcy[np.ix_(kept, kept)], dissipated[np.ix_(kept, kept)]
    grounded = np.eye(k)[kept]
    grounded[np.isin(np.flatnonzero(kept), means), means[-1]] = -1
    return grounded.T @ (g @ np.linalg.solve(d, g)) @ grounded


def _between(answers: dict, kind: int, inlet: int) -> tuple[float, float]:
    """Conductance between unknowns ``inlet`` and the next, and the relative imbalance of the rates there."""
    rows, columns, values = [], [], []
    for unknowns, *conductance in answers.values():
        rows.append(np.repeat(unknowns, len(unknowns)))
        columns.append(np.tile(unknowns, len(unknowns)))
        values.append(conductance[kind].ravel())
    if not rows:
        return 0.0, 0.0
    place = np.concatenate(rows), np.concatenate(columns)
    matrix = csr_array(coo_array((np.concatenate(values), place), shape=(inlet + 2, inlet + 2)))
    _, cluster = connected_components(matrix, directed=False)
    if cluster[inlet] != cluster[inlet + 1]:
        return 0.0, 0.0
    free = np.flatnonzero(cluster == cluster[inlet])
    free = free[free < inlet]
    pressure = np.zeros(inlet + 2)
    pressure[inlet] = 1.0
    if len(free):
        inverse = splu(matrix[free][:, free].tocsc())
        for _ in range(2):  # the second refines the first
            pressure[free] -= inverse.solve((matrix @ pressure)[free])
    rate = matrix @ pressure
    power = dot(pressure, rate)
    return power, abs(rate[inlet] + rate[inlet + 1]) / power


WALL = -1
"""Beyond a closed face; numbers below are faces of interfaces, -2 - f."""


@njit(cache=True)
def _stencil(labels, pore, voxels, port_voxel, port_way, place, mobility):
    """What lies beyond the six faces of each of the pore's voxels, and conductances of the faces: halfway to
    the next voxel's centre at interfaces."""
    flat = labels.reshape(-1)
    _, ny, nx = labels.shape
    steps = (ny * nx, nx, 1)
    n = len(voxels)
    near = np.full((n, 6), WALL, np.int32)
    weight = np.zeros((n, 6))
    for i in range(n):
        place[voxels[i]] = i
    for i in range(n):
        v = voxels[i]
        z = v // (ny * nx)
        y = v // nx - z * ny
        x = v - (z * ny + y) * nx
        at = (z, y, x)
        for c in range(3):
            if at[c] + 1 < labels.shape[c] and flat[v + steps[c]] == pore:
                j = place[v + steps[c]]
                w = mobility[c, z + (c == 0), y + (c == 1), x + (c == 2)]
                near[i, 2 * c + 1], near[j, 2 * c] = j, i
                weight[i, 2 * c + 1] = weight[j, 2 * c] = w
    for f in range(len(port_voxel)):
        v = port_voxel[f]
        z = v // (ny * nx)
        y = v // nx - z * ny
        x = v - (z * ny + y) * nx
        c, s = port_way[f] // 2, port_way[f] % 2
        near[place[v], port_way[f]] = -2 - f
        w = mobility[c, z + s * (c == 0), y + s * (c == 1), x + s * (c == 2)]
        weight[place[v], port_way[f]] = 2 * w
    return near, weight


@njit(cache=True)
def _potentials(near, weight, unknowns, modes, means, k):
    """Potentials (n, k) at unit value of each unknown."""
    n = len(near)
    # voxel n, of no weight, stands for walls and interfaces
    link = np.where(near < 0, n, near)
    bond = np.where(near < 0, 0, weight).astype(np.float32)
    diagonal = weight.sum(axis=1).astype(np.float32)
    # incomplete factors (D + L) D^-1 (D + L^T) that keep the diagonal
    pivot = np.ones(n + 1, np.float32)
    for i in range(n):
        pivot[i] = diagonal[i]
        for s in range(0, 6, 2):
            pivot[i] -= bond[i, s] ** 2 / pivot[link[i, s]]
    found = np.empty((n, k))
    for first in range(0, k, AT_ONCE):
        source = np.zeros((n + 1, AT_ONCE), np.float32)
        for i in range(n):
            for s in range(6):
                if near[i, s] < WALL:
                    f = -2 - near[i, s]
                    for m in range(4):
                        if first <= unknowns[f, m] < first + AT_ONCE:
                            source[i, unknowns[f, m] - first] += weight[i, s] * modes[f, m]
        last = min(first + AT_ONCE, k)
        found[:, first:last] = _gradients(link, bond, diagonal, pivot, source)[:n, : last - first]
    # equal pressures everywhere are no approximate matter: then what flows in flows out
    found[:, means[-1]] = 1
    for mean in means[:-1]:
        found[:, means[-1]] -= found[:, mean]
    return found


@njit(cache=True)
def _gradients(link, bond, diagonal, pivot, source):
    """Preconditioned conjugate gradients for sources (n + 1, lanes), in Eisenstat's form (1981): to
    solve with the two factors is all that an iteration does. ``source`` is overwritten."""
    n, lanes = len(link), source.shape[1]
    x, direction = np.zeros_like(source), np.zeros_like(source)
    ahead, behind = np.zeros_like(source), np.zeros_like(source)
    rho, power = np.zeros(lanes, np.float32), np.empty(lanes, np.float32)
    slope, step = np.empty(lanes, np.float32), np.empty(lanes, np.float32)
    residual = source
    for i in range(n):
        a, b, c = link[i, 0], link[i, 2], link[i, 4]
        u, v, w = bond[i, 0], bond[i, 2], bond[i, 4]
        d = 1 / pivot[i]
        for m in range(lanes):
            residual[i, m] = d * (
                residual[i, m] + u * residual[a, m] + v * residual[b, m] + w * residual[c, m]
            )
        for m in range(lanes):
            direction[i, m] = pivot[i] * residual[i, m]
            rho[m] += direction[i, m] * residual[i, m]
    target = np.float32(CLOSE_LOCALLY**2) * rho
    for _ in range(MOST_STEPS):
        if (rho <= target).all():
            break
        for i in range(n - 1, -1, -1):
            a, b, c = link[i, 1], link[i, 3], link[i, 5]
            u, v, w = bond[i, 1], bond[i, 3], bond[i, 5]
            d = 1 / pivot[i]
            for m in range(lanes):
                ahead[i, m] = d * (direction[i, m] + u * ahead[a, m] + v * ahead[b, m] + w * ahead[c, m])
        power[:] = 0
        for i in range(n):
            a, b, c = link[i, 0], link[i, 2], link[i, 4]
            u, v, w = bond[i, 0], bond[i, 2], bond[i, 4]
            rest = 2 * pivot[i] - diagonal[i]
            d = 1 / pivot[i]
            for m in range(lanes):
                behind[i, m] = d * (
                    direction[i, m]
                    - rest * ahead[i, m]
                    + u * behind[a, m]
                    + v * behind[b, m]
                    + w * behind[c, m]
                )
            for m in range(lanes):
                power[m] += direction[i, m] * (ahead[i, m] + behind[i, m])
        for m in range(lanes):
            step[m] = rho[m] / power[m] if power[m] > 0 else 0.0
            slope[m] = 1 / rho[m] if rho[m] > 0 else 0.0
        rho[:] = 0
        for i in range(n):
            d = pivot[i]
            for m in range(lanes):
                x[i, m] += step[m] * ahead[i, m]
                residual[i, m] -= step[m] * (ahead[i, m] + behind[i, m])
            for m in range(lanes):
                rho[m] += d * residual[i, m] * residual[i, m]
        slope *= rho
        for i in range(n):
            d = pivot[i]
            for m in range(lanes):
                direction[i, m] = d * residual[i, m] + slope[m] * direction[i, m]
    return x


@njit(cache=True)
def _powers(near, weight, unknowns, modes, potential):
    """Powers (k, k) of the potentials and their velocities (n, 6, k) along the axes."""
    n, k = potential.shape
    total = np.zeros((k, k))
    velocity = np.zeros((n, 6, k))
    rows = np.empty((ROWS, k))
    top = 0
    for i in range(n):
        if top + 6 > ROWS:
            total += rows[:top].T @ rows[:top]
            top = 0
        for s in range(6):
            j = near[i, s]
            if j == WALL or (j >= 0 and s % 2 == 0):
                continue
            root = np.sqrt(weight[i, s])
            for m in range(k):
                rows[top, m] = root * (potential[i, m] - (potential[j, m] if j >= 0 else 0.0))
            if j < WALL:
                f = -2 - j
                for m in range(4):
                    if unknowns[f, m] >= 0:
                        rows[top, unknowns[f, m]] -= root * modes[f, m]
            sign = 1.0 if s % 2 else -1.0
            for m in range(k):
                velocity[i, s, m] = sign * root * rows[top, m]
                if j >= 0:
                    velocity[j, s - 1, m] = velocity[i, s, m]
            top += 1
    total += rows[:top].T @ rows[:top]
    return total, velocity


@njit(cache=True)
def _dissipated(voxels, near, velocity, mobility):
    """What the velocities dissipate within a pore (k, k): their differences squared, voxel by voxel.

    A face at an edge of the voxel has half of the friction with its neighbour across that edge, or with the
    wall there, half a voxel off. Across interfaces nothing: the velocity is taken to go on as it is.
    """
    n, _, k = velocity.shape
    total = np.zeros((k, k))
    rows = np.empty((ROWS, k))
    half = np.sqrt(0.5)
    top = 0
    for i in range(n):
        if top + 27 > ROWS:
            total += rows[:top].T @ rows[:top]
            top = 0
        for c in range(3):
            for m in range(k):
                rows[top, m] = velocity[i, 2 * c + 1, m] - velocity[i, 2 * c, m]
            top += 1
        for s in range(6):
            j = near[i, s]
            for f in range(6):
                if f // 2 == s // 2 or near[i, f] == WALL:
                    continue
                if j >= 0 and near[j, f] != WALL:
                    if s % 2:
                        for m in range(k):
                            rows[top, m] = half * (velocity[i, f, m] - velocity[j, f, m])
                        top += 1
                elif j >= WALL or _closed_beyond(voxels[i], s, f, mobility):
                    for m in range(k):
                        rows[top, m] = velocity[i, f, m]
                    top += 1
    total += rows[:top].T @ rows[:top]
    return total


@njit(cache=True)
def _closed_beyond(v, s, f, mobility):
    """Whether face f of the voxel beyond face s is closed, be it beyond the volume."""
    _, nz, ny, nx = mobility.shape
    nz, ny, nx = nz - 1, ny - 1, nx - 1
    z = v // (ny * nx)
    y = v // nx - z * ny
    x = v - (z * ny + y) * nx
    step = 2 * (s % 2) - 1
    a, c = s // 2, f // 2
    z, y, x = z + step * (a == 0), y + step * (a == 1), x + step * (a == 2)
    if z < 0 or y < 0 or x < 0 or z == nz or y == ny or x == nx:
        return True
    t = f % 2
    return mobility[c, z + t * (c == 0), y + t * (c == 1), x + t * (c == 2)] == 0
