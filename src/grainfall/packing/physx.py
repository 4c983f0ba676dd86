"""PhysX 5 on the CPU, through sapien."""

from __future__ import annotations

import numpy as np

from grainfall.packing._sapien import load
from grainfall.packing.engine import Solid
from grainfall.packing.parameters import Parameters

sapien = load()
physx = sapien.physx

WALLS = (  # a plane keeps bodies on the side its +x axis points to; rotations of that axis, (w, x, y, z)
    ((0, 0, 0), (np.sqrt(0.5), 0, -np.sqrt(0.5), 0)),  # floor, normal +z
    ((0, 0, 0), (1, 0, 0, 0)),  # x = 0, normal +x
    ((1, 0, 0), (0, 0, 0, 1)),  # x = lx, normal -x
    ((0, 0, 0), (np.sqrt(0.5), 0, 0, np.sqrt(0.5))),  # y = 0, normal +y
    ((0, 1, 0), (np.sqrt(0.5), 0, 0, -np.sqrt(0.5))),  # y = ly, normal -y
)


class PhysX:
    """:class:`grainfall.packing.engine.Engine` on PhysX: TGS solver, enhanced determinism.

    A fixed body leaves the dynamics and returns as a static one of the same shape and pose, so that a step
    costs what the moving bodies cost. The scene runs on the calling thread only.
    """

    version = f"PhysX 5 (sapien {sapien.__version__})"

    def __init__(self, parameters: Parameters, lx: float, ly: float):
        p = parameters
        physx.set_scene_config(
            gravity=np.array([0, 0, -p.gravity], np.float32),
            bounce_threshold=p.bounce_speed,
            enable_pcm=p.contact_manifold == "persistent",
            enable_tgs=True,
            enable_ccd=False,
            enable_enhanced_determinism=True,
            enable_friction_every_iteration=True,
            cpu_workers=0,
        )
        physx.set_shape_config(contact_offset=p.contact_offset, rest_offset=0.0)
        # sleeping is decided by the deposition, alike in every engine, so PhysX's own is switched off
        physx.set_body_config(
            solver_position_iterations=p.solver_iterations, solver_velocity_iterations=1, sleep_threshold=0.0
        )
        self._parameters = p
        self._system = physx.PhysxCpuSystem()
        self._system.timestep = p.dt
        self._material = physx.PhysxMaterial(p.friction_static, p.friction_dynamic, p.restitution)
        self._scene = sapien.Scene([self._system])
        self._solids: list[Solid] = []
        self._bodies: list = []
        for corner, quaternion in WALLS:
            plane = physx.PhysxRigidStaticComponent()
            plane.attach(physx.PhysxCollisionShapePlane(self._material))
            self._enter(plane, np.multiply(corner, (lx, ly, 0)), quaternion)

    def _enter(self, component, position, quaternion) -> None:
        entity = sapien.Entity()
        entity.add_component(component)
        entity.set_pose(sapien.Pose(np.asarray(position, np.float32), np.asarray(quaternion, np.float32)))
        self._scene.add_entity(entity)

    def _attach(self, body, solid: Solid) -> None:
        if not solid.parts:
            body.attach(physx.PhysxCollisionShapeSphere(solid.radius, self._material))
        for points in solid.parts:
            body.attach(
                physx.PhysxCollisionShapeConvexMesh(
                    np.asarray(points, np.float32), np.ones(3, np.float32), self._material
                )
            )

    def add(self, solid: Solid, position: np.ndarray, quaternion: np.ndarray, velocity: np.ndarray) -> None:
        body = physx.PhysxRigidDynamicComponent()
        self._attach(body, solid)
        body.set_mass(solid.mass)
        body.set_cmass_local_pose(sapien.Pose())
        body.set_inertia(np.asarray(solid.inertia, np.float32))
        body.set_linear_damping(0.0)
        body.set_angular_damping(self._parameters.angular_damping)
        self._enter(body, position, quaternion)
        body.set_linear_velocity(np.asarray(velocity, np.float32))
        self._solids.append(solid)
        self._bodies.append(body)

    def step(self, n: int) -> None:
        for _ in range(n):
            self._system.step()

    def positions(self, ids: np.ndarray) -> np.ndarray:
        return np.array([self._bodies[i].pose.p for i in ids], float).reshape(-1, 3)

    def poses(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        poses = [self._bodies[i].pose for i in ids]
        return (
            np.array([q.p for q in poses], float).reshape(-1, 3),
            np.array([q.q for q in poses], float).reshape(-1, 4),
        )

    def fix(self, ids: np.ndarray) -> None:
        for i in ids:
            body = self._bodies[i]
            pose = body.pose
            self._scene.remove_entity(body.entity)
            static = physx.PhysxRigidStaticComponent()
            self._attach(static, self._solids[i])
            self._enter(static, pose.p, pose.q)
            self._bodies[i] = None

    def contacts(self) -> tuple[np.ndarray, np.ndarray]:
        number = {body: i for i, body in enumerate(self._bodies) if body is not None}
        pairs, gaps = [], []
        for contact in self._system.get_contacts():
            pair = [number.get(body) for body in contact.bodies]
            if None not in pair and contact.points:
                pairs.append(pair)
                gaps.append(min(point.separation for point in contact.points))
        return np.array(pairs, int).reshape(-1, 2), np.array(gaps, float)

    def close(self) -> None:
        self._bodies.clear()
        self._scene = self._system = None
