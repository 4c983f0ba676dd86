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

ROWS = 512
"""Voxels whose products are summed in single precision."""


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
        inverse = splu(
            matrix[free][:, free].tocsc(),
            "MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
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
    place = np.stack(np.unravel_index(voxels, labels.shape), axis=1).astype(np.int32)
    near = _stencil(labels.shape, voxels, ports.voxel, ports.way)
    at_ports = lanes, ports.modes
    conducting = near, *_bonds(near, np.ones_like(lower)), np.full(len(mobile), 2, np.float32)
    voltage = _potentials(place, *conducting, *at_ports, len(back))
    electrical = _powers(*conducting, *at_ports, voltage)
    flowing = near, *_bonds(near, lower), 2 * mobile
    pressure = _potentials(place, *flowing, *at_ports, len(back))
    hydraulic = _powers(*flowing, *at_ports, pressure)
    dissipated = _dissipated(labels, voxels, near, *flowing[2:], *at_ports, pressure)
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


def _potentials(place, near, link, bond, port, lanes, modes, k):
    """Potentials (batches, n + 1, width) of which the first k lanes are at unit value of each unknown.

    From coarse to fine: blocks of 2 x 2 x 2 take one value, and what is found for them is a first guess.
    """
    own, source = _sources(near, port, lanes, modes, k)
    levels = [(link, bond, own)]
    groups = []
    while len(own) > COARSEST:
        group, place, *level = _coarsen(place, *levels[-1])
        groups.append(group)
        levels.append(level)
        own = level[-1]
        if len(own) == len(group):
            break
    factors = [_factors(*level) for level in levels]
    for batch in range(len(source)):
        sources = [source[batch]]
        for group, level in zip(groups, levels[1:], strict=True):
            sources.append(_gathered(sources[-1], group, len(level[0])))
        x = np.zeros_like(sources[-1])
        for step in range(len(levels) - 1, -1, -1):
            rest = sources[step].copy()
            x = _gradients(*levels[step][:2], *factors[step], rest, x, CLOSE_LOCALLY * (COARSE if step else 1))
            if step:
                x = x[np.append(groups[step - 1], len(x) - 1)]
        source[batch] = x
    return source


COARSEST = 100
COARSE = 0.1


@njit(cache=True)
def _gathered(source, group, count):
    found = np.zeros((count + 1, source.shape[1]), np.float32)
    for i in range(len(group)):
        for m in range(source.shape[1]):
            found[group[i], m] += source[i, m]
    return found


@njit(cache=True)
def _coarsen(place, link, bond, own):
    """Blocks of 2 x 2 x 2: that of each voxel, and their places, links, bonds and conductances to ports."""
    n = len(place)
    low, high = place[0] // 2, place[0] // 2
    for i in range(n):
        for c in range(3):
            low[c] = min(low[c], place[i, c] // 2)
            high[c] = max(high[c], place[i, c] // 2)
    number = np.full((high[0] - low[0] + 1, high[1] - low[1] + 1, high[2] - low[2] + 1), -1, np.int32)
    for i in range(n):
        number[place[i, 0] // 2 - low[0], place[i, 1] // 2 - low[1], place[i, 2] // 2 - low[2]] = 0
    count = 0
    flat = number.reshape(-1)
    for i in range(len(flat)):
        if flat[i] == 0:
            flat[i] = count
            count += 1
    group = np.empty(n, np.int32)
    where = np.empty((count, 3), np.int32)
    links, bonds = np.full((count, 6), count, np.int32), np.zeros((count, 6), np.float32)
    owns = np.zeros(count, np.float32)
    for i in range(n):
        group[i] = number[place[i, 0] // 2 - low[0], place[i, 1] // 2 - low[1], place[i, 2] // 2 - low[2]]
        where[group[i]] = place[i] // 2
        owns[group[i]] += own[i]
    for i in range(n):
        for s in range(6):
            j = link[i, s]
            if j < n and group[j] != group[i]:
                links[group[i], s] = group[j]
                bonds[group[i], s] += bond[i, s]
    return group, where, links, bonds, owns


@njit(cache=True)
def _sources(near, port, lanes, modes, k):
    n = len(near)
    batches = (k + AT_ONCE - 1) // AT_ONCE
    width = (k + batches - 1) // batches
    width = min(AT_ONCE, (width + 3) // 4 * 4)
    source = np.zeros((batches, n + 1, width), np.float32)
    own = np.zeros(n, np.float32)
    for i in range(n):
        for s in range(6):
            if near[i, s] < WALL:
                f = -2 - near[i, s]
                own[i] += port[f]
                for m in range(4):
                    if lanes[f, m] >= 0:
                        source[lanes[f, m] // width, i, lanes[f, m] % width] += port[f] * modes[f, m]
    return own, source


@njit(cache=True)
def _factors(link, bond, own):
    n = len(link)
    diagonal, pivot = np.empty(n, np.float32), np.ones(n + 1, np.float32)
    for i in range(n):
        # incomplete factors (D + L) D^-1 (D + L^T) that keep the diagonal
        diagonal[i] = own[i] + bond[i].sum()
        pivot[i] = diagonal[i]
        for s in range(0, 6, 2):
            pivot[i] -= bond[i, s] ** 2 / pivot[link[i, s]]
    return diagonal, pivot


@njit(cache=True)
def _gradients(link, bond, diagonal, pivot, source, x, close):
    """Preconditioned conjugate gradients for sources (n + 1, lanes) from a first guess ``x``, in Eisenstat's
    form (1981): to solve with the two factors is all that an iteration does. Both are overwritten."""
    n, lanes = len(link), source.shape[1]
    direction = np.zeros_like(source)
    ahead, behind = np.zeros_like(source), np.zeros_like(source)
    rho, power = np.zeros(lanes, np.float32), np.empty(lanes, np.float32)
    slope, step = np.zeros(lanes, np.float32), np.empty(lanes, np.float32)
    _forward(link, bond, pivot, source, behind)
    target = np.zeros(lanes, np.float32)
    for i in range(n):
        for m in range(lanes):
            target[m] += pivot[i] * behind[i, m] * behind[i, m]
    target *= np.float32(close**2)
    residual = source
    for i in range(n):
        for m in range(lanes):
            residual[i, m] -= diagonal[i] * x[i, m]
        for s in range(6):
            j, w = link[i, s], bond[i, s]
            for m in range(lanes):
                residual[i, m] += w * x[j, m]
    _forward(link, bond, pivot, residual, residual)
    for i in range(n):
        for m in range(lanes):
            rho[m] += pivot[i] * residual[i, m] * residual[i, m]
    for _ in range(MOST_STEPS):
        if (rho <= target).all():
            break
        for i in range(n - 1, -1, -1):
            a, b, c = link[i, 1], link[i, 3], link[i, 5]
            u, v, w = bond[i, 1], bond[i, 3], bond[i, 5]
            p = pivot[i]
            d = 1 / p
            for m in range(lanes):
                direction[i, m] = p * residual[i, m] + slope[m] * direction[i, m]
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
            p = pivot[i]
            for m in range(lanes):
                x[i, m] += step[m] * ahead[i, m]
                residual[i, m] -= step[m] * (ahead[i, m] + behind[i, m])
            for m in range(lanes):
                rho[m] += p * residual[i, m] * residual[i, m]
        slope *= rho
    return x


@njit(cache=True)
def _forward(link, bond, pivot, source, found):
    """Solution with the lower factor."""
    for i in range(len(link)):
        a, b, c = link[i, 0], link[i, 2], link[i, 4]
        u, v, w = bond[i, 0], bond[i, 2], bond[i, 4]
        d = 1 / pivot[i]
        for m in range(source.shape[1]):
            found[i, m] = d * (source[i, m] + u * found[a, m] + v * found[b, m] + w * found[c, m])


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
                    for batch in range(lanes[f, m] // width, batches):
                        for b in range(width):
                            row[batch * width + b] -= pull * potentials[batch, i, b]
                    for other in range(4):
                        if lanes[f, other] >= 0:
                            row[lanes[f, other]] += pull * modes[f, other]
    return _symmetric(total, lanes)


@njit(cache=True)
def _symmetric(total, lanes):
    """The upper half of a matrix, twice, without the lanes that fill up the batches."""
    k = lanes.max() + 1
    found = np.empty((k, k))
    for a in range(k):
        for b in range(a, k):
            found[a, b] = found[b, a] = total[a, b]
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


@njit(cache=True, fastmath={"reassoc", "contract"})
def _products(potentials, other, batch, sign, total):
    """Add to the columns of a batch the inner products of its lanes and earlier ones with its (n, width).

    Four lanes by four, lane after lane, so that the sums stay in registers.
    """
    _, n, width = potentials.shape
    mine, theirs = np.empty((width, ROWS), np.float32), np.empty((width, ROWS), np.float32)
    for first in range(0, n, ROWS):
        rows = min(ROWS, n - first)
        for i in range(rows):
            for b in range(width):
                theirs[b, i] = other[first + i, b]
        for left in range(batch + 1):
            for i in range(rows):
                for a in range(width):
                    mine[a, i] = potentials[left, first + i, a]
            for a in range(0, width, 4):
                for b in range(0, width, 4):
                    a0, a1, a2, a3 = mine[a], mine[a + 1], mine[a + 2], mine[a + 3]
                    b0, b1, b2, b3 = theirs[b], theirs[b + 1], theirs[b + 2], theirs[b + 3]
                    p = q = r = s = t = u = v = w = np.float32(0)
                    e = f = g = h = j = k = l = m = np.float32(0)
                    for i in range(rows):
                        p += a0[i] * b0[i]
                        q += a0[i] * b1[i]
                        r += a0[i] * b2[i]
                        s += a0[i] * b3[i]
                        t += a1[i] * b0[i]
                        u += a1[i] * b1[i]
                        v += a1[i] * b2[i]
                        w += a1[i] * b3[i]
                        e += a2[i] * b0[i]
                        f += a2[i] * b1[i]
                        g += a2[i] * b2[i]
                        h += a2[i] * b3[i]
                        j += a3[i] * b0[i]
                        k += a3[i] * b1[i]
                        l += a3[i] * b2[i]
                        m += a3[i] * b3[i]
                    y, x = left * width + a, batch * width + b
                    for o, value in enumerate((p, q, r, s, t, u, v, w, e, f, g, h, j, k, l, m)):
                        total[y + o // 4, x + o % 4] += sign * value


def _dissipated(
    labels: np.ndarray,
    voxels: np.ndarray,
    near: np.ndarray,
    bond: np.ndarray,
    port: np.ndarray,
    lanes: np.ndarray,
    modes: np.ndarray,
    potentials: np.ndarray,
) -> np.ndarray:
    """What the velocities of the potentials dissipate within a pore (k, k): their differences squared.

    A face at an edge of the voxel has half of the friction with its neighbour across that edge, or with the
    wall there, half a voxel off. Across interfaces nothing: the velocity is taken to go on as it is.
    """
    face, across = _faces(near, bond, port)
    friction = _friction(labels, voxels, near, face, len(across))
    total = np.zeros((potentials.shape[0] * potentials.shape[2],) * 2)
    for batch in range(len(potentials)):
        pull = _pull(near, face, across, *friction, lanes, modes, potentials[batch], batch, total)
        _products(potentials, pull, batch, 1.0, total)
    return _symmetric(total, lanes)


@njit(cache=True)
def _faces(near, bond, port):
    """Number (n, 6) of the open face on each side of each voxel, interfaces first, and conductance of each
    face; for none their number."""
    n = len(near)
    count = len(port)
    for i in range(n):
        for s in range(1, 6, 2):
            count += near[i, s] >= 0
    face, across = np.full((n, 6), count, np.int32), np.empty(count, np.float32)
    across[: len(port)] = port
    count = len(port)
    for i in range(n):
        for s in range(6):
            if near[i, s] < WALL:
                face[i, s] = -2 - near[i, s]
            elif near[i, s] >= 0 and s % 2:
                face[i, s] = face[near[i, s], s - 1] = count
                across[count] = bond[i, s]
                count += 1
    return face, across


@njit(cache=True)
def _friction(labels, voxels, near, face, count):
    """Friction of each face with itself, and with those beside it: their numbers (count, 6) and shares."""
    own, share = np.zeros(count, np.float32), np.zeros((count, 6), np.float32)
    beside = np.full((count, 6), count, np.int32)
    for i in range(len(near)):
        for f in range(6):
            me = face[i, f]
            if me == count:
                continue
            other = f + 1 - 2 * (f % 2)
            own[me] += 1
            beside[me, other], share[me, other] = face[i, other], 1
            for s in range(6):
                if s // 2 == f // 2:
                    continue
                j = near[i, s]
                if j >= 0 and near[j, f] != WALL:
                    own[me] += 0.5
                    beside[me, s] = face[j, f]
                    share[me, s] += 0.5
                elif j >= WALL or _closed_beyond(labels, voxels[i], s, f):
                    own[me] += 1
    return own, beside, share


@njit(cache=True)
def _pull(near, face, across, own, beside, share, lanes, modes, x, batch, total):
    """Power of friction at unit potentials, those of a batch driving the flow: (n + 1, width), and at the
    interfaces added to the batch's columns of the total."""
    n, count, width = len(near), len(across), x.shape[1]
    velocity, force = np.zeros((count + 1, width), np.float32), np.zeros((count + 1, width), np.float32)
    sense = np.zeros(len(lanes), np.float32)
    for i in range(n):
        for s in range(6):
            f, j = face[i, s], near[i, s]
            if j >= 0 and s % 2:
                w = across[f]
                for m in range(width):
                    velocity[f, m] = w * (x[i, m] - x[j, m])
            elif j < WALL:
                sense[f] = (2 * (s % 2) - 1) * across[f]
                for m in range(width):
                    velocity[f, m] = sense[f] * x[i, m]
                for m in range(4):
                    if lanes[f, m] >= 0 and lanes[f, m] // width == batch:
                        velocity[f, lanes[f, m] % width] -= sense[f] * modes[f, m]
    for f in range(count):
        a, b, c, d, e, g = beside[f]
        p, q, r, t, u, v = share[f]
        w = own[f]
        for m in range(width):
            force[f, m] = (
                w * velocity[f, m]
                - p * velocity[a, m]
                - q * velocity[b, m]
                - r * velocity[c, m]
                - t * velocity[d, m]
                - u * velocity[e, m]
                - v * velocity[g, m]
            )
        w = across[f]
        for m in range(width):
            force[f, m] *= w
    pull = np.zeros((n + 1, width), np.float32)
    for i in range(n):
        a, b, c, d, e, g = face[i]
        for m in range(width):
            pull[i, m] = force[b, m] - force[a, m] + force[d, m] - force[c, m] + force[g, m] - force[e, m]
    for f in range(len(lanes)):
        for m in range(4):
            if lanes[f, m] >= 0 and lanes[f, m] // width <= batch:
                row = total[lanes[f, m]]
                unit = np.sign(sense[f]) * modes[f, m]
                for b in range(width):
                    row[batch * width + b] -= unit * force[f, b]
    return pull


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
