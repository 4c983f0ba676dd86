"""PhysX 5 on the CPU, through sapien."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import trimesh

from grainfall.io import Scratch
from grainfall.packing._sapien import load
from grainfall.packing.engine import WALL, Contacts, Solid, State
from grainfall.packing.parameters import GRAVITY, Parameters

sapien = load()
physx = sapien.physx

WALLS = (  # a plane keeps bodies on the side its +x axis points to; rotations of that axis, (w, x, y, z)
    ((0, 0, 0), (np.sqrt(0.5), 0, -np.sqrt(0.5), 0)),  # floor, normal +z
    ((0, 0, 0), (1, 0, 0, 0)),  # x = 0, normal +x
    ((1, 0, 0), (0, 0, 0, 1)),  # x = lx, normal -x
    ((0, 0, 0), (np.sqrt(0.5), 0, 0, np.sqrt(0.5))),  # y = 0, normal +y
    ((0, 1, 0), (np.sqrt(0.5), 0, 0, -np.sqrt(0.5))),  # y = ly, normal -y
)


PARTING = GRAVITY**0.5
"""Speed, engine units / s, at which the solver takes bodies apart that lie in each other: that of a grain
that fell half its radius.

Now and then the narrow phase loses sight of two hulls of many facets for some steps and finds them again deep
in each other. Taken apart within one step they flew off with the energy of a hundred such falls, and shook
the whole bed. Much below this bound (at 0.3) some pairs were left 0.2 of a radius deep in each other.
"""


class PhysX:
    """:class:`grainfall.packing.engine.Engine` on PhysX: TGS solver, enhanced determinism.

    A fixed body leaves the dynamics and returns as a static one of the same shape and pose, so that a step
    costs what the moving bodies cost, and a little: sapien goes through all its bodies. They stay bodies of
    their own, as PhysX merges the contacts of a pair of bodies, and a bed on one static body of many shapes
    creeps. The scene runs on the calling thread only.
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
        self._meshes = _Meshes()
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
        scale = np.full(3, solid.scale, np.float32)
        for points in solid.parts:
            file = self._meshes.file(points)
            body.attach(physx.PhysxCollisionShapeConvexMesh(file, scale, self._material))

    def add(self, solid, position, quaternion, velocity=(0, 0, 0), spin=(0, 0, 0), fixed=False) -> None:
        body = physx.PhysxRigidStaticComponent() if fixed else physx.PhysxRigidDynamicComponent()
        self._attach(body, solid)
        if not fixed:
            body.set_mass(solid.mass)
            body.set_cmass_local_pose(sapien.Pose())
            body.set_inertia(np.asarray(solid.inertia, np.float32))
            body.set_linear_damping(self._parameters.linear_damping + solid.drag)
            body.set_angular_damping(self._parameters.angular_damping)
            if not solid.turns:
                body.set_locked_motion_axes([False] * 3 + [True] * 3)
            body.set_max_depenetration_velocity(PARTING)
        self._enter(body, position, quaternion)
        if not fixed:
            body.set_linear_velocity(np.asarray(velocity, np.float32))
            body.set_angular_velocity(np.asarray(spin, np.float32))
        self._solids.append(solid)
        self._bodies.append(body)

    def step(self, n: int) -> None:
        for _ in range(n):
            self._system.step()

    def state(self) -> State:
        # sapien packs its moving bodies in the order in which they entered
        rows = np.frombuffer(self._system.pack(), np.float32).reshape(-1, 13).astype(float)
        return State(rows[:, 4:7], rows[:, 0:4], rows[:, 7:10], rows[:, 10:13])

    def damp(self, linear: float, angular: float) -> None:
        for body in self._system.rigid_dynamic_components:
            body.set_linear_damping(linear)
            body.set_angular_damping(angular)

    def fix(self, ids: Iterable[int]) -> None:
        for i in ids:
            body = self._bodies[i]
            pose = body.entity_pose
            self._scene.remove_entity(body.entity)
            static = physx.PhysxRigidStaticComponent()
            self._attach(static, self._solids[i])
            self._enter(static, pose.p, pose.q)
            self._bodies[i] = static

    def contacts(self) -> Contacts:
        number = {body: i for i, body in enumerate(self._bodies)}
        found = [contact for contact in self._system.get_contacts() if contact.points]
        points = [point for contact in found for point in contact.points]
        of = np.repeat(np.arange(len(found)), [len(contact.points) for contact in found])
        impulse, normal = (
            np.array([getattr(point, name) for point in points], float).reshape(-1, 3)
            for name in ("impulse", "normal")
        )
        table = np.zeros((len(found), 7))
        for row, contact in zip(table, found, strict=True):
            row[:2] = [number.get(body, WALL) for body in contact.bodies]
        table[:, 2] = np.inf
        np.minimum.at(table[:, 2], of, [point.separation for point in points])
        np.add.at(table[:, 3], of, (impulse * normal).sum(axis=1))
        np.add.at(table[:, 4:], of, impulse)
        table = table[np.lexsort(table.T[::-1])]  # PhysX gives them in an order of its own
        table[:, 3:] /= self._system.timestep
        return Contacts(table[:, :2].astype(int), table[:, 2], table[:, 3], table[:, 4:], False)

    def close(self) -> None:
        self._bodies.clear()
        self._scene = self._system = None
        self._meshes.close()


class _Meshes:
    """Convex meshes as files: PhysX then cooks each shape once, not once a body."""

    def __init__(self):
        self._folder = Scratch()
        self._known: dict[int, tuple[np.ndarray, str]] = {}

    def file(self, points: np.ndarray) -> str:
        """Path of the hull of these points; the same array gives the same path."""
        if id(points) not in self._known:
            path = self._folder.path / f"{len(self._known)}.stl"
            trimesh.convex.convex_hull(points).export(path)
            self._known[id(points)] = points, str(path)
        return self._known[id(points)][1]

    def close(self) -> None:
        self._folder.close()
