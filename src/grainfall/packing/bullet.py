"""Bullet, through pybullet."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable

import numpy as np
import pybullet as bullet
from scipy.spatial import ConvexHull

from grainfall.packing.engine import WALL, Contacts, Solid, State
from grainfall.packing.parameters import Parameters

WALLS = (
    ((0, 0, 0), (0, 0, 1)),
    ((0, 0, 0), (1, 0, 0)),
    ((1, 0, 0), (-1, 0, 0)),
    ((0, 0, 0), (0, 1, 0)),
    ((0, 1, 0), (0, -1, 0)),
)

PUSH = 40.0
"""Rate, 1/s, at which contacts take overlaps back. At Bullet's own, a fifth of them a step, poured cubes end
up to 0.05 R inside each other; much faster, bodies that start inside each other are thrown apart."""

MARGIN = 1e-3
"""Thickness, engine units, of the layer that Bullet puts around a hull. Left in, hulls of the demo's grains
rested 0.0017 mean radii apart, nearly the gap up to which two are in contact: one in twenty was lost."""


class Bullet:
    """:class:`grainfall.packing.engine.Engine` on Bullet's sequential impulses.

    Bullet surrounds a hull by a collision margin of :data:`MARGIN`, which is why lengths are scaled to grains
    of order 1; the hulls it is given are smaller by as much. Planes are half-spaces: a grain pushed through
    one is pushed back, so none can leave.
    """

    version = f"Bullet {bullet.getAPIVersion()} (pybullet)"

    def __init__(self, parameters: Parameters, lx: float, ly: float):
        p = self._parameters = parameters
        self._client = bullet.connect(bullet.DIRECT)
        bullet.setGravity(0, 0, -p.gravity, physicsClientId=self._client)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=p.dt,
            numSolverIterations=p.solver_iterations,
            numSubSteps=0,
            restitutionVelocityThreshold=p.bounce_speed,
            contactBreakingThreshold=p.contact_breaking,
            contactERP=min(1.0, PUSH * p.dt),
            deterministicOverlappingPairs=1,
            physicsClientId=self._client,
        )
        self._bodies: list[int] = []
        self._moving: list[int] = []
        self._shapes: list[int] = []
        for corner, normal in WALLS:
            shape = bullet.createCollisionShape(
                bullet.GEOM_PLANE, planeNormal=normal, physicsClientId=self._client
            )
            self._body(shape, 0.0, np.multiply(corner, (lx, ly, 0)), (1, 0, 0, 0))

    def _body(self, shape: int, mass: float, position, quaternion) -> int:
        w, x, y, z = (float(c) for c in quaternion)
        body = bullet.createMultiBody(
            mass,
            shape,
            basePosition=[float(c) for c in position],
            baseOrientation=[x, y, z, w],
            useMaximalCoordinates=1,
            physicsClientId=self._client,
        )
        bullet.changeDynamics(
            body,
            -1,
            lateralFriction=self._parameters.friction_dynamic
            ** 0.5,  # Bullet multiplies the two bodies' coefficients
            restitution=self._parameters.restitution**0.5,
            physicsClientId=self._client,
        )
        return body

    def add(self, solid, position, quaternion, velocity=(0, 0, 0), spin=(0, 0, 0), fixed=False) -> None:
        shape = self._shape(solid)
        body = self._body(shape, 0.0 if fixed else solid.mass, position, quaternion)
        self._bodies.append(body)
        self._shapes.append(shape)
        if fixed:
            return
        self._moving.append(len(self._bodies) - 1)
        bullet.changeDynamics(
            body,
            -1,
            mass=solid.mass,
            # Without it a contact of hulls forgets what it slid, and every bed creeps on. Between spheres,
            # whose contact rolls along, it would tie together what has moved on.
            frictionAnchor=int(bool(solid.parts)),
            # Bullet takes 0 for infinite
            localInertiaDiagonal=[float(c) if solid.turns else 0.0 for c in solid.inertia],
            linearDamping=_per_second(self._parameters.linear_damping + solid.drag),
            angularDamping=_per_second(self._parameters.angular_damping),
            activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=self._client,
        )
        bullet.resetBaseVelocity(
            body, [float(c) for c in velocity], [float(c) for c in spin], physicsClientId=self._client
        )

    def _shape(self, solid: Solid) -> int:
        if not solid.parts:
            return bullet.createCollisionShape(
                bullet.GEOM_SPHERE, radius=solid.radius, physicsClientId=self._client
            )
        parts = tuple(_without_margin(part * solid.scale) for part in solid.parts)
        if len(parts) > 1:
            return self._compound(parts)
        return bullet.createCollisionShape(
            bullet.GEOM_MESH, vertices=parts[0].tolist(), physicsClientId=self._client
        )

    def _compound(self, parts: tuple[np.ndarray, ...]) -> int:
        """One shape of several hulls: Bullet takes those from a file only, an object each."""
        lines, first = [], 1
        for number, part in enumerate(parts):
            faces = ConvexHull(part).simplices + first
            lines.append(f"o part{number}")
            lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in part.tolist()]
            lines += [f"f {a} {b} {c}" for a, b, c in faces.tolist()]
            first += len(part)
        with tempfile.NamedTemporaryFile("w", suffix=".obj") as file:
            file.write("\n".join(lines) + "\n")
            file.flush()
            return bullet.createCollisionShape(
                bullet.GEOM_MESH, fileName=file.name, physicsClientId=self._client
            )

    def step(self, n: int) -> None:
        for _ in range(n):
            bullet.stepSimulation(physicsClientId=self._client)

    def state(self) -> State:
        rows = []
        for i in self._moving:
            position, (x, y, z, w) = bullet.getBasePositionAndOrientation(self._bodies[i], self._client)
            velocity, spin = bullet.getBaseVelocity(self._bodies[i], self._client)
            rows.append((*position, w, x, y, z, *velocity, *spin))
        table = np.array(rows, float).reshape(-1, 13)
        return State(table[:, 0:3], table[:, 3:7], table[:, 7:10], table[:, 10:13])

    def damp(self, linear: float, angular: float) -> None:
        for i in self._moving:
            bullet.changeDynamics(
                self._bodies[i],
                -1,
                linearDamping=_per_second(linear),
                angularDamping=_per_second(angular),
                physicsClientId=self._client,
            )

    def fix(self, ids: Iterable[int]) -> None:
        for i in ids:
            position, (x, y, z, w) = bullet.getBasePositionAndOrientation(self._bodies[i], self._client)
            bullet.removeBody(self._bodies[i], self._client)
            self._bodies[i] = self._body(self._shapes[i], 0.0, position, (w, x, y, z))
        gone = set(ids)
        self._moving = [i for i in self._moving if i not in gone]

    def contacts(self) -> Contacts:
        number = {body: i for i, body in enumerate(self._bodies)}
        found: dict[tuple[int, int], np.ndarray] = {}
        for point in bullet.getContactPoints(physicsClientId=self._client):
            pair = number.get(point[1], WALL), number.get(point[2], WALL)
            row = found.setdefault(pair, np.array([np.inf, 0, 0, 0, 0]))
            row[0] = min(row[0], point[8])
            row[1] += point[9]
            # the normal points from the second body to the first
            row[2:] += point[9] * np.array(point[7])
            row[2:] += point[10] * np.array(point[11]) + point[12] * np.array(point[13])
        pairs = np.array(sorted(found), int).reshape(-1, 2)
        table = np.array([found[pair] for pair in sorted(found)], float).reshape(-1, 5)
        return Contacts(pairs, table[:, 0], table[:, 1], table[:, 2:], True)

    def close(self) -> None:
        bullet.disconnect(self._client)


def _per_second(rate: float) -> float:
    """Bullet's damping for a rate of decay: the share lost in a second, (1 - share)^t = exp(-rate t).

    A rate of 1/s or more, given as such, would be cut to 1 and stop every body in every step.
    """
    return float(-np.expm1(-rate))


def _without_margin(points: np.ndarray) -> np.ndarray:
    """A hull scaled about its vertices' mean until its surface lies deeper by the margin on average."""
    hull = ConvexHull(points)
    middle = points.mean(axis=0)
    return middle + (points - middle) * max(0.5, 1 - MARGIN * hull.area / (3 * hull.volume))
