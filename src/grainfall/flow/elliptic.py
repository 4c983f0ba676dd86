"""Flow through voxels by scalar equations: a mobility from the geometry, a pressure, a bound on permeability.

Where the pressure falls uniformly, friction alone sets the velocity: the mobility w of a face is the velocity
there under a uniform unit force, -lap w = 1 with w = 0 on the walls, exact in straight ducts of any section.
The pressure follows from div(w grad p) = 0. Read as Darcy's law this model takes converging and turning flow
to cost no more than straight flow, and its rate Q is too high. Yet v = -w grad p conserves mass and vanishes
on the walls, so it is a motion that Stokes flow could take, and among those of equal rate Stokes flow
dissipates least (Helmholtz): with D[v] the power that v does dissipate, Q^2 / D[v] bounds the conductance
from below, straining included, nothing fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from grainfall.errors import InputError
from grainfall.flow.multigrid import Multigrid, dot, solve_symmetric
from grainfall.flow.staggered import ENDS, SIDES, Staggered, assemble

AXES = ("x", "y", "z")
"""Axis names in the order of the rows; x is along axis 2 of the image."""

EXACT = 1e-8
"""Residual at which a scalar solution counts as exact; errors of energies are its square."""

CLOSE = 1e-5
"""Residual that does for the mobility: of any the bound would be one."""


@dataclass(frozen=True)
class Flow:
    """Flow through a volume of voxels at unit pressure drop and viscosity, lengths in voxels.

    Attributes
    ----------
    k : float
        Permeability in voxels squared; 0 where no path leads from face to face.
    k_lower, k_upper : float
        Bounds on that of Stokes flow on this grid; the upper one infinite where it was not sought.
    pressure : (nz, ny, nx) float
        In the cells; empty (NaN) where nothing flows.
    flux : tuple of three arrays
        Flow rates through the faces across axes 0, 1, 2 of the image, positive towards higher indices; face i
        lies before voxel i, so the array is one longer along its own axis.
    iterations : int
        Of the pressure; 0 for the elliptic model.
    """

    k: float
    k_lower: float
    k_upper: float
    pressure: np.ndarray
    flux: tuple[np.ndarray, np.ndarray, np.ndarray]
    iterations: int


class Darcy:
    """Conduction through the faces: velocity = mobility x force, without divergence."""

    def __init__(self, grid: Staggered, mobility: np.ndarray):
        self.grid, self.mobility = grid, mobility
        self.divergence = grid.gradient.T
        self.matrix = csr_array(self.divergence @ (diags_array(mobility) @ grid.gradient))
        self.cycle = Multigrid(self.matrix, grid.cell)

    def pressure(self, source: np.ndarray, tolerance: float = EXACT) -> np.ndarray:
        """Pressure (m,) whose velocities carry off a source (m,)."""
        return solve_symmetric(self.matrix, source, self.cycle, tolerance)

    def driven(self) -> tuple[np.ndarray, np.ndarray]:
        """Pressure (m,) and velocity (n,) under the grid's drive."""
        grid = self.grid
        pressure = self.pressure(-(self.divergence @ (self.mobility * grid.drive)))
        return pressure, self.mobility * (grid.drive + grid.gradient @ pressure)


class Friction:
    """The viscous force of a grid and its inverse; mobilities are velocities under a uniform unit force."""

    def __init__(self, grid: Staggered):
        self.matrix = grid.friction
        self.cycle = Multigrid(grid.friction, grid.face)
        self.mobility = self.velocity(grid.volume, CLOSE) / grid.volume

    def velocity(
        self, force: np.ndarray, tolerance: float = EXACT, start: np.ndarray | None = None
    ) -> np.ndarray:
        """Velocity (n,) at which friction balances a force (n,)."""
        return solve_symmetric(self.matrix, force, self.cycle, tolerance, start)

    def dissipation(self, velocity: np.ndarray) -> float:
        return dot(velocity, self.matrix @ velocity)


def solve(pore: np.ndarray, axis: str = "x", *, ends: str = "pressure", sides: str = "sealed") -> Flow:
    """Elliptic model of the flow along an axis: two scalar equations, a lower bound on permeability.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool or float
        See :func:`grainfall.flow.staggered.assemble`.
    axis : {"x", "y", "z"}
    ends : {"pressure", "periodic"}
    sides : {"sealed", "slip", "periodic"}

    Returns
    -------
    Flow
        ``k`` is the lower bound. The pressure is the model's, so is the flux but for a factor: it carries k.

    Raises
    ------
    InputError
        For an image that is not a volume, an unknown axis or condition, or flow that no wall holds back.
    """
    grid = staggered(pore, axis, ends, sides)
    if grid is None:
        return closed(np.shape(pore))
    friction = Friction(grid)
    pressure, velocity = Darcy(grid, friction.mobility).driven()
    k, velocity = sustained(grid, friction, velocity)
    return unfold(grid, axis, k, k, np.inf, pressure, velocity, 0)


def formation_factor(
    pore: np.ndarray, axis: str = "x", *, ends: str = "pressure", sides: str = "sealed"
) -> float:
    """Formation factor along an axis: the pore space conducts, sides insulate; NaN where nothing does."""
    grid = staggered(pore, axis, ends, sides, friction=False)
    if grid is None:
        return np.nan
    _, current = Darcy(grid, 1 / grid.volume).driven()
    return 1 / (dot(grid.drive, current) * length_per_area(grid.shape))


def staggered(
    pore: np.ndarray, axis: str, ends: str, sides: str, *, friction: bool = True
) -> Staggered | None:
    """Grid of a volume turned so that the flow is along axis 0, after a look at what the user gave."""
    pore = np.asarray(pore)
    if pore.ndim != 3 or 0 in pore.shape:
        raise InputError("pore", f"an image of shape {pore.shape}", "give a volume (z, y, x)")
    if pore.dtype.kind not in "bf":
        raise InputError("pore", f"values of type {pore.dtype}", "bool, or distances to the wall as float")
    for name, value, known in (("axis", axis, AXES), ("ends", ends, ENDS), ("sides", sides, SIDES)):
        if value not in known:
            raise InputError(f"flow {name}", f"unknown {value!r}", f"choose one of {', '.join(known)}")
    turned = np.ascontiguousarray(np.moveaxis(pore, image_axis(axis), 0))
    grid = assemble(turned, ends, sides, friction=friction)
    if grid is not None and friction and not grid.held():
        raise InputError(
            "pore", "an open path without walls, along which nothing holds the flow back", "seal the sides"
        )
    return grid


def image_axis(axis: str) -> int:
    """Axis of a (z, y, x) array by its name."""
    return 2 - AXES.index(axis)


def length_per_area(shape: tuple[int, int, int]) -> float:
    """Of a volume along its axis 0, in 1/voxels."""
    return shape[0] / (shape[1] * shape[2])


def sustained(grid: Staggered, friction: Friction, velocity: np.ndarray) -> tuple[float, np.ndarray]:
    """Multiple of a velocity that conserves mass at which the drive pays for what it dissipates.

    Its permeability, returned first, is the lower bound on that of Stokes flow.
    """
    power = dot(grid.drive, velocity)
    scale = power / friction.dissipation(velocity)
    return scale * power * length_per_area(grid.shape), scale * velocity


def closed(shape: tuple[int, int, int]) -> Flow:
    """No flow at all."""
    flux = tuple(np.zeros(np.add(shape, np.eye(3, dtype=int)[a])) for a in range(3))
    return Flow(0.0, 0.0, 0.0, np.full(shape, np.nan), flux, 0)


def unfold(
    grid: Staggered,
    axis: str,
    k: float,
    lower: float,
    upper: float,
    pressure: np.ndarray,
    velocity: np.ndarray,
    iterations: int,
) -> Flow:
    """A solution on the grid as arrays of the image."""
    dense = np.full(grid.shape, np.nan)
    dense[tuple(grid.cell.T)] = pressure
    back = image_axis(axis)
    components = []
    for c in range(3):
        mine = grid.face[:, 0] == c
        values = np.zeros(np.add(grid.shape, np.eye(3, dtype=int)[c]))
        values[tuple(grid.face[mine, 1:].T)] = (grid.area * velocity)[mine]
        if grid.periodic[c]:
            values[(slice(None),) * c + (-1,)] = values.take(0, c)
        components.append(np.moveaxis(values, 0, back))
    components.insert(back, components.pop(0))
    return Flow(k, lower, upper, np.moveaxis(dense, 0, back), tuple(components), iterations)
