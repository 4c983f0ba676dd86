"""The one protocol behind which rigid-body engines stand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from grainfall.packing.parameters import Parameters

WALL = -1
"""Body number of the floor and the walls in a contact."""


@dataclass(frozen=True)
class Solid:
    """One rigid body as an engine needs it, in engine units, in its own principal frame.

    Attributes
    ----------
    parts : tuple of (n, 3) ndarray
        Vertices of the convex pieces of the collision shape, centre of mass at the origin; none: a sphere.
    radius : float
        Radius of the sphere, or of the sphere about the origin that bounds the shape.
    mass : float
    inertia : (3,) ndarray
        Principal moments about the frame's axes.
    scale : float
        What the vertices are multiplied by: bodies of one shape share its vertices.
    drag : float
        Rate, 1/s, at which its speed decays beside the parameters' ``linear_damping``.
    turns : bool
        Whether it may turn; one that may not falls and is pushed aside all the same.
    """

    parts: tuple[np.ndarray, ...]
    radius: float
    mass: float
    inertia: np.ndarray
    scale: float = 1.0
    drag: float = 0.0
    turns: bool = True


@dataclass(frozen=True)
class State:
    """Positions (n, 3), quaternions (n, 4), velocities (n, 3) and angular velocities (n, 3)."""

    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray


@dataclass(frozen=True)
class Contacts:
    """Pairs of bodies near each other in the last step, engine units.

    Attributes
    ----------
    pairs : (n, 2) int
        Bodies; :data:`WALL` is floor or wall.
    gap : (n,) float
        Smallest separation of the collision shapes; negative: depth of penetration.
    force : (n,) float
        Normal force, mean over the last step.
    vector : (n, 3) float
        Force on the first body. With its friction where :attr:`friction_known`.
    friction_known : bool
        PhysX tells normal impulses only.
    """

    pairs: np.ndarray
    gap: np.ndarray
    force: np.ndarray
    vector: np.ndarray
    friction_known: bool


class Engine(Protocol):
    """Rigid bodies in a box that is open at the top: floor z = 0, walls x = 0, x = lx, y = 0, y = ly.

    Bodies are numbered 0, 1, 2 … in the order in which they are added. Quaternions are (w, x, y, z).
    """

    version: str

    def add(
        self,
        solid: Solid,
        position: np.ndarray,
        quaternion: np.ndarray,
        velocity: np.ndarray = (0.0, 0.0, 0.0),
        spin: np.ndarray = (0.0, 0.0, 0.0),
        fixed: bool = False,
    ) -> None:
        """Release a body, or put it there for good."""

    def step(self, n: int) -> None:
        """Advance ``n`` time steps."""

    def state(self) -> State:
        """Of the moving bodies, in ascending order of their numbers."""

    def damp(self, linear: float, angular: float) -> None:
        """Let speed and spin of all moving bodies decay at these rates alone, 1/s, from now on."""

    def fix(self, ids: np.ndarray) -> None:
        """Fix moving bodies in place for good: they carry others and cost no more."""

    def contacts(self) -> Contacts:
        """What touched in the last step."""

    def close(self) -> None:
        """Free what the engine holds."""


def start(parameters: Parameters, lx: float, ly: float) -> Engine:
    """An empty box in the engine that the parameters name."""
    if parameters.engine == "bullet":
        from grainfall.packing.bullet import Bullet

        return Bullet(parameters, lx, ly)
    from grainfall.packing.physx import PhysX

    return PhysX(parameters, lx, ly)
