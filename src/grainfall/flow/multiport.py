r"""Conductances of a pore between its interfaces, from the flow through its voxels.

The power of the local solutions of div(w grad p) = 0, w the mobility, at unit values of what makes up the
pressures on the interfaces, and what their velocities dissipate; see :mod:`grainfall.flow.local`.

The potentials are found from coarse to fine: blocks of 2 x 2 x 2 voxels take one value, and so on, and what
is found for them is a first guess that only has to be smoothed. All in single precision, :data:`AT_ONCE`
sources at a time, and each pore by one thread: the same bytes on any number of them.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from grainfall.errors import InputError

CLOSE = 5e-3
"""Residual of the local solutions, begun from those of coarser grids, of which a third of it is asked."""

UNSURE = 0.1
"""Share of a power that the residual may make, which is off by its square at least."""

ROUNDING = 1e-6
"""What single precision leaves of a power, over what the interface by itself would let through."""

SINGLE = 2e-6
"""Residual that single precision cannot go below."""

COARSEST = 100
"""Unknowns below which no coarser solution is sought."""

MOST_STEPS = 10_000
"""Of conjugate gradients within a pore; a few tens do, but where it winds."""

AT_ONCE = 16
"""Sources solved for together, lanes of the processor's vectors."""

ROWS = 512
"""Voxels whose products are summed in single precision."""

WALL = -1
"""Beyond a closed face; numbers below are faces of interfaces, -2 - f."""


def conductances(
    labels: np.ndarray,
    voxels: np.ndarray,
    lower: np.ndarray,
    port: tuple[np.ndarray, ...],
    mobile: np.ndarray,
    throats: np.ndarray,
    count: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Hydraulic and electrical conductances of a pore between its k unknowns.

    Parameters
    ----------
    labels : (nz, ny, nx) ndarray of int32
        Pore of each voxel of the volume, 0 in the solid.
    voxels : (n,) int
        Flat indices of the pore's, rising.
    lower : (n, 3) float32
        Mobilities of their lower faces.
    port : tuple
        Voxel, way, throat and slopes of each of its faces; see :class:`grainfall.flow.local.Ports`.
    mobile : (f,) float32
        Their mobilities.
    throats, count : (t,) int
        Its throats and the unknowns of each, which add up to k.

    Returns
    -------
    hydraulic, electrical : (k, k) float
        Voxels^3 and voxels. Rows add up to 0 over the mean pressures.
    """
    # Equal pressures let nothing through: the last interface is grounded and put back by the sum of rates.
    means = np.cumsum(count) - count
    ground = means[-1]
    voxel, way, throat, slopes = port
    throat = np.searchsorted(throats, throat)
    number = np.arange(4)
    own = means[throat, None] + number
    there = (number < count[throat, None]) & (own != ground)
    lanes = np.where(there, own - (own > ground), -1).astype(np.int32)
    modes = np.column_stack([np.ones(len(lanes), np.float32), slopes])
    back = np.delete(np.eye(count.sum()), ground, axis=0)
    back[means[:-1], ground] = -1
    place = np.stack(np.unravel_index(voxels, labels.shape), axis=1).astype(np.int32)
    near = _stencil(labels.shape, voxels, voxel, way)
    at_ports = lanes, modes
    conducting = near, *_bonds(near, np.ones_like(lower)), np.full(len(mobile), 2, np.float32)
    # errors of the potentials enter a power squared, and what their velocities dissipate as they are
    _, electrical = _solved(place, *conducting, *at_ports, len(back), 2 * CLOSE)
    flowing = near, *_bonds(near, lower), 2 * mobile
    pressure, hydraulic = _solved(place, *flowing, *at_ports, len(back), CLOSE)
    dissipated = _dissipated(labels, voxels, near, *flowing[2:], *at_ports, pressure)
    hydraulic = hydraulic @ np.linalg.solve(dissipated, hydraulic)
    return back.T @ hydraulic @ back, back.T @ electrical @ back


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


def _solved(place, near, link, bond, port, lanes, modes, k, close):
    """Potentials as :func:`_potentials` gives them, and their powers (k, k).

    A residual says little of a long, winding pore, which lets through far less than its ends could, and whose
    windings a coarser grid has side by side. What it does to the power says it: the potentials' product with
    their residual, which is 0 for the solution. Where it is no small part of the power, closer and closer
    until that holds and the power stays.

    Raises
    ------
    InputError
        For a pore so long and winding (some thousand voxels) that rounding outweighs what it lets through.
    """
    rounded = ROUNDING * np.bincount(lanes[lanes >= 0], (port[:, None] * modes**2)[lanes >= 0], k)
    before = None
    while True:
        potentials = _potentials(place, near, link, bond, port, lanes, modes, k, close)
        power, rest = _powers(near, link, bond, port, lanes, modes, potentials)
        own = power.diagonal()
        sure = (np.abs(rest.diagonal()) <= UNSURE * own + rounded).all()
        if sure and (before is None or np.allclose(own, before, rtol=UNSURE**2, atol=0)):
            return potentials, power
        before, close = own, close / 10
        if close < SINGLE:
            raise InputError(
                "local flow",
                f"a pore of {len(near)} voxels winds too far to be solved for in single precision",
                "take elliptic or direct (flow.methods), or a smaller network.persistence",
            )


def _potentials(place, near, link, bond, port, lanes, modes, k, close):
    """Potentials (batches, n + 1, width) of which the first k lanes are at unit value of each unknown.

    From coarse to fine: blocks of 2 x 2 x 2 take one value, and what is found for them is a first guess.
    """
    own, source = _sources(near, port, lanes, modes, k)
    levels, groups = [(link, bond, own)], []
    while len(own) > COARSEST:
        group, side, place, *level = _coarsen(place, *levels[-1])
        own = level[-1]
        levels.append(level)
        groups.append((group, side))
    factors = [_factors(*level) for level in levels]
    for batch in range(len(source)):
        sources = [source[batch]]
        for (group, _), (coarse, *_) in zip(groups, levels[1:], strict=True):
            sources.append(_gathered(sources[-1], group, len(coarse)))
        x = np.zeros_like(sources[-1])
        for depth in range(len(groups), 0, -1):
            x = _gradients(*levels[depth][:2], *factors[depth], sources[depth], x, close / 3)
            x = _spread(x, *groups[depth - 1], levels[depth][0])
        source[batch] = _gradients(link, bond, *factors[0], sources[0], x, close)
    return source


@njit(cache=True, nogil=True)
def _gathered(source, group, count):
    found = np.zeros((count + 1, source.shape[1]), np.float32)
    for i in range(len(group)):
        for m in range(source.shape[1]):
            found[group[i], m] += source[i, m]
    return found


@njit(cache=True, nogil=True)
def _spread(x, group, side, link):
    """Values of blocks taken over by what they consist of, linearly between the blocks' centres."""
    n, width = len(group), x.shape[1]
    found = np.zeros((n + 1, width), np.float32)
    for i in range(n):
        own = group[i]
        beside = link[own]
        a, b, c = beside[side[i] & 1], beside[2 + (side[i] >> 1 & 1)], beside[4 + (side[i] >> 2)]
        none = len(link)
        a, b, c = own if a == none else a, own if b == none else b, own if c == none else c
        for m in range(width):
            found[i, m] = 0.25 * (x[own, m] + x[a, m] + x[b, m] + x[c, m])
    return found


@njit(cache=True, nogil=True)
def _coarsen(place, link, bond, own):
    """Blocks of 2 x 2 x 2: that of each voxel and, in three bits, the voxel's side of it; places of the
    blocks, their links, bonds and conductances to ports."""
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
    group, side = np.empty(n, np.int32), np.empty(n, np.int8)
    where = np.empty((count, 3), np.int32)
    links, bonds = np.full((count, 6), count, np.int32), np.zeros((count, 6), np.float32)
    owns = np.zeros(count, np.float32)
    for i in range(n):
        group[i] = number[place[i, 0] // 2 - low[0], place[i, 1] // 2 - low[1], place[i, 2] // 2 - low[2]]
        where[group[i]] = place[i] // 2
        side[i] = place[i, 0] % 2 + 2 * (place[i, 1] % 2) + 4 * (place[i, 2] % 2)
        owns[group[i]] += own[i]
    for i in range(n):
        for s in range(6):
            j = link[i, s]
            if j < n and group[j] != group[i]:
                links[group[i], s] = group[j]
                bonds[group[i], s] += bond[i, s]
    return group, side, where, links, bonds, owns


@njit(cache=True, nogil=True)
def _sources(near, port, lanes, modes, k):
    n = len(near)
    width = AT_ONCE if k > AT_ONCE // 2 else AT_ONCE // 2
    batches = (k + width - 1) // width
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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
            slope[m] = rho[m]
        rho[:] = 0
        for i in range(n):
            p = pivot[i]
            for m in range(lanes):
                x[i, m] += step[m] * ahead[i, m]
                residual[i, m] -= step[m] * (ahead[i, m] + behind[i, m])
            for m in range(lanes):
                rho[m] += p * residual[i, m] * residual[i, m]
        for m in range(lanes):
            # not by 1 / slope: of what was solved at once, so little is left that it overflows
            slope[m] = rho[m] / slope[m] if slope[m] > 0 else 0.0
    return x


@njit(cache=True, nogil=True)
def _forward(link, bond, pivot, source, found):
    """Solution with the lower factor."""
    for i in range(len(link)):
        a, b, c = link[i, 0], link[i, 2], link[i, 4]
        u, v, w = bond[i, 0], bond[i, 2], bond[i, 4]
        d = 1 / pivot[i]
        for m in range(source.shape[1]):
            found[i, m] = d * (source[i, m] + u * found[a, m] + v * found[b, m] + w * found[c, m])


@njit(cache=True, nogil=True)
def _powers(near, link, bond, port, lanes, modes, potentials):
    """Powers (k, k) of the potentials, and what their residuals make of them."""
    batches, _, width = potentials.shape
    total = np.zeros((batches * width, batches * width))
    for batch in range(batches):
        # c - b x - x r with b x on the faces and the residual r: as good as the energy, at less work
        rest = _residual(near, link, bond, port, lanes, modes, potentials[batch], batch)
        _products(potentials, rest, batch, -1.0, total)
    left = _symmetric(total, lanes)
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
    return _symmetric(total, lanes), left


@njit(cache=True, nogil=True)
def _symmetric(total, lanes):
    """The upper half of a matrix, twice, without the lanes that fill up the batches."""
    k = lanes.max() + 1
    found = np.empty((k, k))
    for a in range(k):
        for b in range(a, k):
            found[a, b] = found[b, a] = total[a, b]
    return found


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
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
                    s0 = s1 = s2 = s3 = t0 = t1 = t2 = t3 = np.float32(0)
                    u0 = u1 = u2 = u3 = v0 = v1 = v2 = v3 = np.float32(0)
                    for i in range(rows):
                        s0 += a0[i] * b0[i]
                        s1 += a0[i] * b1[i]
                        s2 += a0[i] * b2[i]
                        s3 += a0[i] * b3[i]
                        t0 += a1[i] * b0[i]
                        t1 += a1[i] * b1[i]
                        t2 += a1[i] * b2[i]
                        t3 += a1[i] * b3[i]
                        u0 += a2[i] * b0[i]
                        u1 += a2[i] * b1[i]
                        u2 += a2[i] * b2[i]
                        u3 += a2[i] * b3[i]
                        v0 += a3[i] * b0[i]
                        v1 += a3[i] * b1[i]
                        v2 += a3[i] * b2[i]
                        v3 += a3[i] * b3[i]
                    y, x = left * width + a, batch * width + b
                    sums = (s0, s1, s2, s3, t0, t1, t2, t3, u0, u1, u2, u3, v0, v1, v2, v3)
                    for place, value in enumerate(sums):
                        total[y + place // 4, x + place % 4] += sign * value


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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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
