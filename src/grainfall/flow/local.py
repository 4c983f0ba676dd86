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

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from grainfall.flow.elliptic import AXES, image_axis
from grainfall.flow.mobility import mobility
from grainfall.flow.multigrid import dot
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
    pores = Pores(parts.labels)
    sealed = pores.answers(throats, np.arange(pores.count))
    rates = {}
    for axis in AXES:
        faces = face_ports(parts, image_axis(axis), unknowns)
        at_faces = np.unique(faces.pore)
        both = _by_pore(Ports(*(np.concatenate(pair) for pair in zip(throats, faces, strict=True))))
        inner = ~np.isin(sealed.pore, at_faces)
        answers = [Answers(*(values[inner] for values in sealed)), pores.answers(both, at_faces)]
        hydraulic, imbalance = _between(answers, "hydraulic", unknowns)
        electrical, other = _between(answers, "electrical", unknowns)
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
    modes = np.zeros((len(voxel), 4), np.float32)
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
    unknowns = np.where(number < count[throat, None], first[throat, None] + number, -1).astype(np.int32)
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
        unknowns = np.tile(np.array([unknown + side, -1, -1, -1], np.int32), (len(voxel), 1))
        modes = np.tile(np.array([1, 0, 0, 0], np.float32), (len(voxel), 1))
        ends.append(Ports(pore, voxel, way, unknowns, modes))
    return Ports(*(np.concatenate(pair) for pair in zip(*ends, strict=True)))


def _by_pore(ports: Ports) -> Ports:
    order = np.argsort(ports.pore, kind="stable")
    return Ports(*(values[order] for values in ports))


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


class Pores:
    """The voxels of every pore and the mobilities of their faces."""

    def __init__(self, labels: np.ndarray):
        self.labels = labels
        self.mobility = mobility(labels > 0)
        pore = labels.reshape(-1)[self.mobility.voxels]
        self.count = int(pore.max(initial=0))
        self.order = np.argsort(pore, kind="stable").astype(self.mobility.voxels.dtype)
        self.starts = np.concatenate([[0], np.cumsum(np.bincount(pore, minlength=self.count + 1)[1:])])

    def answers(self, ports: Ports, which: np.ndarray) -> Answers:
        """Conductances of each of the pores ``which`` that has two unknowns; others let nothing through."""
        starts = np.searchsorted(ports.pore, np.arange(self.count + 1))
        first, unknowns = _unknowns(which, starts, ports.unknowns)
        entries = np.concatenate([[0], np.cumsum(np.diff(first) ** 2)])
        pore, row, column = _entries(which, first, unknowns, entries)
        hydraulic, electrical = np.empty(len(pore)), np.empty(len(pore))
        mobility = self.mobility
        at_ports = _at_ports(self.labels.shape, mobility.voxels, mobility.lower, *mobility.upper, *ports[1:3])
        for i, b in enumerate(which):
            if first[i + 1] == first[i]:
                continue
            mine = slice(starts[b], starts[b + 1])
            own = self.order[self.starts[b] : self.starts[b + 1]]
            matrices = _conductances(
                self.labels,
                mobility.voxels[own],
                mobility.lower[own],
                Ports(*(values[mine] for values in ports)),
                at_ports[mine],
                unknowns[first[i] : first[i + 1]],
            )
            here = slice(entries[i], entries[i + 1])
            hydraulic[here], electrical[here] = (m.ravel() for m in matrices)
        return Answers(pore, row, column, hydraulic, electrical)


@njit(cache=True)
def _unknowns(which, starts, of_ports):
    """Unknowns of each of the pores ``which``, none where there are less than two, and where they start."""
    first = np.zeros(len(which) + 1, np.int64)
    every = np.empty(of_ports.size, np.int32)
    top = 0
    for i in range(len(which)):
        mine = np.unique(of_ports[starts[which[i]] : starts[which[i] + 1]])
        mine = mine[mine >= 0]
        if len(mine) > 1:
            every[top : top + len(mine)] = mine
            top += len(mine)
        first[i + 1] = top
    return first, every[:top].copy()


@njit(cache=True)
def _entries(which, first, unknowns, entries):
    pore = np.empty(entries[-1], np.int32)
    row, column = np.empty_like(pore), np.empty_like(pore)
    for i in range(len(which)):
        top = entries[i]
        for a in unknowns[first[i] : first[i + 1]]:
            for b in unknowns[first[i] : first[i + 1]]:
                pore[top], row[top], column[top] = which[i], a, b
                top += 1
    return pore, row, column


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


def _between(answers: list[Answers], kind: str, inlet: int) -> tuple[float, float]:
    """Conductance between unknowns ``inlet`` and the next, and the relative imbalance of the rates there."""
    row, column, value = (np.concatenate([getattr(a, n) for a in answers]) for n in ("row", "column", kind))
    matrix = csr_array(coo_array((value, (row, column)), shape=(inlet + 2, inlet + 2)))
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


def _conductances(
    labels: np.ndarray,
    voxels: np.ndarray,
    lower: np.ndarray,
    ports: Ports,
    mobile: np.ndarray,
    unknowns: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Hydraulic and electrical conductances (k, k) between the unknowns of a pore."""
    # Equal pressures let nothing through: one interface is grounded and put back by the sum of rates.
    ground = np.searchsorted(unknowns, ports.unknowns[:, 0].max())
    lane = np.arange(len(unknowns)) - (np.arange(len(unknowns)) > ground)
    lane[ground] = -1
    lanes = np.where(ports.unknowns < 0, -1, lane[np.searchsorted(unknowns, ports.unknowns)]).astype(np.int32)
    back = np.delete(np.eye(len(unknowns)), ground, axis=0)
    back[np.unique(lanes[lanes[:, 0] >= 0, 0]), ground] = -1
    near = _stencil(labels.shape, voxels, ports.voxel, ports.way)
    at_ports = lanes, ports.modes
    conducting = near, *_bonds(near, np.ones_like(lower)), np.full(len(mobile), 2, np.float32)
    voltage = _potentials(*conducting, *at_ports, len(back), CLOSE_LOCALLY)
    electrical = _powers(*conducting, *at_ports, voltage)
    flowing = near, *_bonds(near, lower), 2 * mobile
    pressure = _potentials(*flowing, *at_ports, len(back), CLOSE_LOCALLY)
    hydraulic = _powers(*flowing, *at_ports, pressure)
    dissipated = _dissipated(labels, voxels, *flowing, *at_ports, pressure)
    hydraulic = hydraulic @ np.linalg.solve(dissipated, hydraulic)
    return back.T @ hydraulic @ back, back.T @ electrical @ back


@njit(cache=True)
def _bonds(near, lower):
    """Voxel beyond each face, n for none, and the conductances of the faces, 0 where there is none."""
    n = len(near)
    link, bond = np.full((n, 6), n, np.int32), np.zeros((n, 6), np.float32)
    for i in range(n):
        for s in range(6):
            j = near[i, s]
            if j >= 0:
                link[i, s] = j
                bond[i, s] = lower[j if s % 2 else i, s // 2]
    return link, bond


@njit(cache=True)
def _stencil(shape, voxels, port_voxel, port_way):
    """What lies beyond the six faces of each of the pore's voxels, whose flat indices rise."""
    nz, ny, nx = shape
    n = len(voxels)
    near = np.full((n, 6), WALL, np.int32)
    for c in range(3):
        step, size = (ny * nx, nz) if c == 0 else (nx, ny) if c == 1 else (1, nx)
        j = 0
        for i in range(n):
            if (voxels[i] // step) % size == size - 1:
                continue
            while j < n and voxels[j] < voxels[i] + step:
                j += 1
            if j < n and voxels[j] == voxels[i] + step:
                near[i, 2 * c + 1], near[j, 2 * c] = j, i
    for f in range(len(port_voxel)):
        near[np.searchsorted(voxels, port_voxel[f]), port_way[f]] = -2 - f
    return near


@njit(cache=True)
def _potentials(near, link, bond, port, lanes, modes, k, close):
    """Potentials (batches, n + 1, width) of which the first k lanes are at unit value of each unknown."""
    n = len(near)
    diagonal, pivot = np.empty(n, np.float32), np.ones(n + 1, np.float32)
    batches = (k + AT_ONCE - 1) // AT_ONCE
    width = (k + batches - 1) // batches
    width = min(AT_ONCE, (width + 3) // 4 * 4)
    source = np.zeros((batches, n + 1, width), np.float32)
    for i in range(n):
        diagonal[i] = bond[i].sum()
        for s in range(6):
            if near[i, s] < WALL:
                f = -2 - near[i, s]
                diagonal[i] += port[f]
                for m in range(4):
                    if lanes[f, m] >= 0:
                        source[lanes[f, m] // width, i, lanes[f, m] % width] += port[f] * modes[f, m]
        # incomplete factors (D + L) D^-1 (D + L^T) that keep the diagonal
        pivot[i] = diagonal[i]
        for s in range(0, 6, 2):
            pivot[i] -= bond[i, s] ** 2 / pivot[link[i, s]]
    for batch in range(batches):
        source[batch] = _gradients(link, bond, diagonal, pivot, source[batch], close)
    return source


@njit(cache=True)
def _gradients(link, bond, diagonal, pivot, source, close):
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
    target = np.float32(close**2) * rho
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
def _powers(near, link, bond, port, lanes, modes, potentials):
    """Powers (k, k) of the potentials."""
    batches, _, width = potentials.shape
    total = np.zeros((batches * width, batches * width))
    for batch in range(batches):
        # c - b x - x r with b x on the faces and the residual r: as good as the energy, at less work
        rest = _residual(near, link, bond, port, lanes, modes, potentials[batch], batch)
        _products(potentials, rest, batch, -1.0, total)
    n = len(near)
    for i in range(n):
        for s in range(6):
            if near[i, s] < WALL:
                f = -2 - near[i, s]
                for m in range(4):
                    if lanes[f, m] < 0:
                        continue
                    pull = np.float64(port[f] * modes[f, m])
                    row = total[lanes[f, m]]
                    for batch in range(batches):
                        for b in range(width):
                            row[batch * width + b] -= pull * potentials[batch, i, b]
                    for other in range(4):
                        if lanes[f, other] >= 0:
                            row[lanes[f, other]] += pull * modes[f, other]
    return _symmetric(total, lanes)


@njit(cache=True)
def _symmetric(total, lanes):
    k = lanes.max() + 1
    found = np.empty((k, k))
    for a in range(k):
        for b in range(k):
            found[a, b] = (total[a, b] + total[b, a]) / 2
    return found


@njit(cache=True)
def _residual(near, link, bond, port, lanes, modes, x, batch):
    """Of the potentials (n + 1, width) of a batch."""
    n, width = len(near), x.shape[1]
    rest = np.zeros((n + 1, width), np.float32)
    for i in range(n):
        own = np.float32(0)
        for s in range(6):
            j, w = link[i, s], bond[i, s]
            own += w
            for m in range(width):
                rest[i, m] += w * x[j, m]
            if near[i, s] < WALL:
                f = -2 - near[i, s]
                own += port[f]
                for m in range(4):
                    if lanes[f, m] >= 0 and lanes[f, m] // width == batch:
                        rest[i, lanes[f, m] % width] += port[f] * modes[f, m]
        for m in range(width):
            rest[i, m] -= own * x[i, m]
    return rest


@njit(cache=True)
def _products(potentials, other, batch, sign, total):
    """Add to the columns of a batch the inner products of all lanes with its (n, width)."""
    batches, n, width = potentials.shape
    part = np.empty((width, width), np.float32)
    for left in range(batches):
        x = potentials[left]
        for first in range(0, n, ROWS):
            part[:] = 0
            for i in range(first, min(first + ROWS, n)):
                for a in range(width):
                    own = x[i, a]
                    for b in range(width):
                        part[a, b] += own * other[i, b]
            for a in range(width):
                for b in range(width):
                    total[left * width + a, batch * width + b] += sign * part[a, b]


@njit(cache=True)
def _dissipated(labels, voxels, near, link, bond, port, lanes, modes, potentials):
    """What the velocities of the potentials dissipate within a pore (k, k): their differences squared.

    A face at an edge of the voxel has half of the friction with its neighbour across that edge, or with the
    wall there, half a voxel off. Across interfaces nothing: the velocity is taken to go on as it is.
    """
    n = len(near)
    batches, _, width = potentials.shape
    total = np.zeros((batches * width, batches * width))
    for batch in range(batches):
        force = _forces(labels, voxels, near, bond, port, lanes, modes, potentials[batch], batch)
        # what the forces do along a unit velocity is gathered at the potentials that drive it
        pull = np.zeros((n + 1, width), np.float32)
        for i in range(n):
            for s in range(6):
                j = near[i, s]
                sense = 2 * (s % 2) - 1
                if j >= 0:
                    w = sense * bond[i, s]
                    for m in range(width):
                        pull[i, m] += w * force[i, s, m]
                        pull[j, m] -= w * force[i, s, m]
                elif j < WALL:
                    f = -2 - j
                    w = sense * port[f]
                    for m in range(width):
                        pull[i, m] += w * force[i, s, m]
                    for own in range(4):
                        if lanes[f, own] >= 0:
                            row = total[lanes[f, own]]
                            for m in range(width):
                                row[batch * width + m] -= w * modes[f, own] * force[i, s, m]
        _products(potentials, pull, batch, 1.0, total)
    return _symmetric(total, lanes)


@njit(cache=True)
def _forces(labels, voxels, near, bond, port, lanes, modes, x, batch):
    """Friction (n, 6, width) of a voxel's part of its faces under the velocities of potentials (n, width)."""
    n, width = len(near), x.shape[1]
    velocity = np.zeros((n, 6, width), np.float32)
    for i in range(n):
        for s in range(6):
            j = near[i, s]
            sense = np.float32(2 * (s % 2) - 1)
            if j >= 0:
                w = sense * bond[i, s]
                for m in range(width):
                    velocity[i, s, m] = w * (x[i, m] - x[j, m])
            elif j < WALL:
                f = -2 - j
                w = sense * port[f]
                for m in range(width):
                    velocity[i, s, m] = w * x[i, m]
                for m in range(4):
                    if lanes[f, m] >= 0 and lanes[f, m] // width == batch:
                        velocity[i, s, lanes[f, m] % width] -= w * modes[f, m]
    force = np.zeros_like(velocity)
    half = np.float32(0.5)
    for i in range(n):
        for c in range(3):
            for m in range(width):
                rate = velocity[i, 2 * c + 1, m] - velocity[i, 2 * c, m]
                force[i, 2 * c + 1, m] += rate
                force[i, 2 * c, m] -= rate
        for s in range(6):
            j = near[i, s]
            for f in range(6):
                if f // 2 == s // 2 or near[i, f] == WALL:
                    continue
                if j >= 0 and near[j, f] != WALL:
                    if s % 2:
                        for m in range(width):
                            rate = half * (velocity[i, f, m] - velocity[j, f, m])
                            force[i, f, m] += rate
                            force[j, f, m] -= rate
                elif j >= WALL or _closed_beyond(labels, voxels[i], s, f):
                    for m in range(width):
                        force[i, f, m] += velocity[i, f, m]
    return force


@njit(cache=True)
def _closed_beyond(labels, v, s, f):
    """Whether face f of the voxel beyond face s is closed, be it beyond the volume."""
    nz, ny, nx = labels.shape
    z = v // (ny * nx)
    y = v // nx - z * ny
    x = v - (z * ny + y) * nx
    for way in (s, f):
        step = 2 * (way % 2) - 1
        z, y, x = z + step * (way // 2 == 0), y + step * (way // 2 == 1), x + step * (way // 2 == 2)
        if z < 0 or y < 0 or x < 0 or z == nz or y == ny or x == nx:
            return way == s
        if labels[z, y, x] == 0:
            return True
    return False
