"""Stokes flow on the faces of voxels, between two bounds that close on it.

For any pressure p the velocity u in balance with it, friction u = drive + gradient p, gives the upper bound
u . friction u, least where u conserves mass (the dual of Helmholtz's principle). Conjugate gradients on the
pressure lower it step by step, preconditioned by what the pressure answers to: the elliptic model over long
distances, itself over short ones (Cahouet & Chabard 1988). What u lacks in mass the elliptic model carries
off, and the remainder is a trial field for the lower bound of :mod:`grainfall.flow.elliptic`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from grainfall.flow import elliptic
from grainfall.flow.elliptic import Darcy, Flow, Friction
from grainfall.flow.multigrid import dot

MOST_ITERATIONS = 200
"""Three do for Berea sandstone and sphere packs, to a bracket of 0.1 %."""


def solve(
    pore: np.ndarray,
    axis: str = "x",
    *,
    ends: str = "pressure",
    sides: str = "sealed",
    tolerance: float = 1e-3,
    progress: Callable[[str], None] | None = None,
) -> Flow:
    """Stokes flow along an axis, to a tolerance on permeability.

    Parameters
    ----------
    pore, axis, ends, sides
        See :func:`grainfall.flow.elliptic.solve`.
    tolerance : float
        Width of the bracket over its upper end at which the iteration ends.
    progress : callable, optional
        Told the bracket after each iteration, in a line.

    Returns
    -------
    Flow
        ``k`` is the lower bound, which comes closer by far than the upper one.

    Raises
    ------
    InputError
        See :func:`grainfall.flow.elliptic.solve`.
    RuntimeError
        Where the bounds do not close.
    """
    grid = elliptic.staggered(pore, axis, ends, sides)
    if grid is None:
        return elliptic.closed(np.shape(pore))
    friction = Friction(grid)
    darcy = Darcy(grid, friction.mobility)
    precise = tolerance * 1e-3
    scale = elliptic.length_per_area(grid.shape)

    pressure, velocity = darcy.driven()
    force = grid.drive + grid.gradient @ pressure
    velocity = friction.velocity(force, precise, start=velocity)
    loss = -(darcy.divergence @ velocity)
    direction, before = 0.0, np.inf
    for iteration in range(1, MOST_ITERATIONS + 1):
        carried = darcy.pressure(loss, precise)
        conserving = velocity + darcy.mobility * (grid.gradient @ carried)
        lower, conserving = elliptic.sustained(grid, friction, conserving)
        # of an inexact velocity, to second order in its error
        upper = (2 * dot(force, velocity) - friction.dissipation(velocity)) * scale
        if progress:
            progress(f"iteration {iteration}: K between {lower:.6g} and {upper:.6g} voxels^2")
        if upper - lower <= tolerance * upper:
            return elliptic.unfold(grid, axis, lower, lower, upper, pressure, conserving, iteration)
        z = carried + loss
        slope = dot(loss, z)
        direction = z + (slope / before) * direction
        before = slope
        push = grid.gradient @ direction
        response = friction.velocity(push, precise)
        divergence = darcy.divergence @ response
        step = slope / dot(direction, divergence)
        pressure = pressure + step * direction
        force = force + step * push
        velocity = velocity + step * response
        loss = loss - step * divergence
    raise RuntimeError(f"bounds {lower:.6g} and {upper:.6g} still apart after {MOST_ITERATIONS} iterations")
