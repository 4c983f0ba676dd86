"""The one protocol behind which rigid-body engines stand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from grainfall.packing.parameters import Parameters


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
    """

    parts: tuple[np.ndarray, ...]
    radius: float
    mass: float
    inertia: np.ndarray


class Engine(Protocol):
    """Rigid bodies in a box that is open at the top: floor z = 0, walls x = 0, x = lx, y = 0, y = ly.

    Bodies are numbered 0, 1, 2 … in the order in which they are added. Quaternions are (w, x, y, z).
    """

    version: str

    def add(self, solid: Solid, position: np.ndarray, quaternion: np.ndarray, velocity: np.ndarray) -> None:
        """Release a body."""

    def step(self, n: int) -> None:
        """Advance ``n`` time steps."""

    def positions(self, ids: np.ndarray) -> np.ndarray:
        """Positions (n, 3) of moving bodies."""

    def poses(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, 3) and quaternions (n, 4) of moving bodies."""

    def fix(self, ids: np.ndarray) -> None:
        """Fix moving bodies in place for good: they carry others and cost no more."""

    def contacts(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (n, 2) of moving bodies near each other at the last step's start and their gaps (n,).

        A negative gap is the depth of penetration of the collision shapes.
        """

    def close(self) -> None:
        """Free what the engine holds."""


def start(parameters: Parameters, lx: float, ly: float) -> Engine:
    """An empty box in the engine that the parameters name."""
    if parameters.engine == "bullet":
        from grainfall.packing.bullet import Bullet

        return Bullet(parameters, lx, ly)
    from grainfall.packing.physx import PhysX

    return PhysX(parameters, lx, ly)
