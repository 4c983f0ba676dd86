"""Bullet, through pybullet."""

from __future__ import annotations

import tempfile

import numpy as np
import pybullet as bullet
from scipy.spatial import ConvexHull

from grainfall.packing.engine import Solid
from grainfall.packing.parameters import Parameters

WALLS = (
    ((0, 0, 0), (0, 0, 1)),
    ((0, 0, 0), (1, 0, 0)),
    ((1, 0, 0), (-1, 0, 0)),
    ((0, 0, 0), (0, 1, 0)),
    ((0, 1, 0), (0, -1, 0)),
)


class Bullet:
    """:class:`grainfall.packing.engine.Engine` on Bullet's sequential impulses.

    Bullet surrounds a hull by a fixed collision margin (0.001 engine units here, so a thousandth of a mean
    grain radius), which is why lengths are scaled to grains of order 1. Planes are half-spaces: a grain
    pushed through one is pushed back, so none can leave.
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
            deterministicOverlappingPairs=1,
            physicsClientId=self._client,
        )
        self._bodies: list[int] = []
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

    def add(self, solid: Solid, position: np.ndarray, quaternion: np.ndarray, velocity: np.ndarray) -> None:
        if not solid.parts:
            shape = bullet.createCollisionShape(
                bullet.GEOM_SPHERE, radius=solid.radius, physicsClientId=self._client
            )
        elif len(solid.parts) == 1:
            shape = bullet.createCollisionShape(
                bullet.GEOM_MESH, vertices=solid.parts[0].tolist(), physicsClientId=self._client
            )
        else:
            shape = self._compound(solid.parts)
        body = self._body(shape, solid.mass, position, quaternion)
        bullet.changeDynamics(
            body,
            -1,
            mass=solid.mass,
            localInertiaDiagonal=[float(c) for c in solid.inertia],
            linearDamping=0.0,
            angularDamping=self._parameters.angular_damping,
            activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=self._client,
        )
        bullet.resetBaseVelocity(body, [float(c) for c in velocity], [0, 0, 0], physicsClientId=self._client)
        self._bodies.append(body)
        self._shapes.append(shape)

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

    def positions(self, ids: np.ndarray) -> np.ndarray:
        rows = [bullet.getBasePositionAndOrientation(self._bodies[i], self._client)[0] for i in ids]
        return np.array(rows, float).reshape(-1, 3)

    def poses(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        poses = [bullet.getBasePositionAndOrientation(self._bodies[i], self._client) for i in ids]
        return (
            np.array([q[0] for q in poses], float).reshape(-1, 3),
            np.array([q[1] for q in poses], float).reshape(-1, 4)[:, [3, 0, 1, 2]],
        )

    def fix(self, ids: np.ndarray) -> None:
        for i in ids:
            position, (x, y, z, w) = bullet.getBasePositionAndOrientation(self._bodies[i], self._client)
            bullet.removeBody(self._bodies[i], self._client)
            self._bodies[i] = self._body(self._shapes[i], 0.0, position, (w, x, y, z))

    def contacts(self) -> tuple[np.ndarray, np.ndarray]:
        number = {body: i for i, body in enumerate(self._bodies)}
        deepest: dict[tuple[int, int], float] = {}
        for point in bullet.getContactPoints(physicsClientId=self._client):
            a, b = number.get(point[1]), number.get(point[2])
            if a is not None and b is not None:
                deepest[a, b] = min(point[8], deepest.get((a, b), np.inf))
        return np.array(list(deepest), int).reshape(-1, 2), np.array(list(deepest.values()), float)

    def close(self) -> None:
        bullet.disconnect(self._client)
