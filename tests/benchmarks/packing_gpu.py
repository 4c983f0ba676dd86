"""What PhysX on a graphics card makes of a bed, and how long it takes: nothing in the project depends on it.

    python tests/benchmarks/packing_gpu.py scenes FOLDER [--numbers 1000 10000] [--dt 0.01] [--iterations 20]
    python tests/benchmarks/ovphysx_drop.py FOLDER/1000.gpu.usda FOLDER/1000.gpu.npz --device gpu
    python tests/benchmarks/packing_gpu.py judge FOLDER [--numbers 1000] [--out packing_gpu.csv]

Scenes are those of packing_speed.py's plain loop: all grains at once in layers, the numbers of the default
parameters, no body sleeps. sapien's library for graphics cards is no part of its package; ovphysx (pip
install ovphysx==0.4.13, NVIDIA's licence) is PhysX with it, and takes its scenes as USD. A card keeps contact
points from step to step in any case, as ``contact_manifold: persistent`` does here, and takes shapes of at
most 64 vertices. The second line may run on another machine, which needs ovphysx, PyTorch, that script and
the scenes.

Runs are judged by this project's engine, which takes over the bodies where they were left, and held against
the same layers in this engine (``--numbers``). Columns: n_grains, run, steps, wall_s, ms_per_step (of the
last hundred steps), still (share, by the paper's criterion), speed (median at the end), porosity (of the
lower two thirds, off the walls), overlap (largest, over the mean radius), creep (mean way in 300 steps of
this project's engine, mean radii), and ms_per_step_here (of this project's engine with those bodies at rest,
CPU time on one core of this machine).
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import pandas as pd
import trimesh
from engines import angular_grains
from packing_speed import HULL_VERTICES, layers, width

from grainfall import io
from grainfall.grains import Library
from grainfall.packing import Parameters
from grainfall.packing.engine import Solid, start
from grainfall.packing.physx import PARTING
from grainfall.packing.shapes import collision_shapes
from grainfall.volume import voxelise

KINDS, MOST = 40, 20_000
KEPT = {"gpu": ("1", "GPU", "PCM"), "persistent": ("0", "SAP", "PCM"), "full": ("0", "SAP", "SAT")}
"""On a graphics card, and on a processor with contact points kept from step to step or all found anew."""


def shapes() -> dict:
    """The collision shapes of packing_speed.py's grains; equal-volume radius 1."""
    library = angular_grains(KINDS, np.random.default_rng(0))
    return collision_shapes(library, range(KINDS), Parameters(hull_vertices=HULL_VERTICES))


def usd(side: float, grains: list[dict], p: Parameters) -> str:
    """The scene: floor and walls, grains by reference to their shapes."""
    text = [
        "#usda 1.0",
        '(\ndefaultPrim = "World"\nmetersPerUnit = 1\nupAxis = "Z"\n)',
        'class Scope "Shapes" {',
    ]
    for k, shape in shapes().items():
        hull = trimesh.convex.convex_hull(shape.parts[0])
        text.append(
            f'def Mesh "s{k}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysxRigidBodyAPI", '
            '"PhysicsCollisionAPI", "PhysxCollisionAPI", "PhysicsMeshCollisionAPI", '
            '"PhysxConvexHullCollisionAPI", "PhysicsMassAPI", "MaterialBindingAPI"]) {\n'
            f"int[] faceVertexCounts = {[3] * len(hull.faces)}\n"
            f"int[] faceVertexIndices = {hull.faces.ravel().tolist()}\n"
            f"point3f[] points = [{', '.join(f'({x:.7g}, {y:.7g}, {z:.7g})' for x, y, z in hull.vertices)}]\n"
            'uniform token subdivisionScheme = "none"\n'
            'uniform token physics:approximation = "convexHull"\n'
            "int physxConvexHullCollision:hullVertexLimit = 64\n"
            f"float physics:density = {p.density}\n"
            f"float physxCollision:contactOffset = {p.contact_offset}\n"
            "float physxCollision:restOffset = 0\n"
            f"float physxRigidBody:linearDamping = {p.linear_damping}\n"
            f"float physxRigidBody:angularDamping = {p.angular_damping}\n"
            f"float physxRigidBody:maxDepenetrationVelocity = {PARTING:.4f}\n"
            "float physxRigidBody:sleepThreshold = 0\n"
            "float physxRigidBody:stabilizationThreshold = 0\n"
            f"int physxRigidBody:solverPositionIterationCount = {p.solver_iterations}\n"
            "int physxRigidBody:solverVelocityIterationCount = 1\n"
            "rel material:binding:physics = </World/Stone>\n}"
        )
    text.append("}")
    text.append(
        'def Xform "World" {\n'
        'def PhysicsScene "scene" (prepend apiSchemas = ["PhysxSceneAPI", "MaterialBindingAPI"]) {\n'
        "vector3f physics:gravityDirection = (0, 0, -1)\n"
        f"float physics:gravityMagnitude = {p.gravity}\n"
        f"float physxScene:bounceThreshold = {p.bounce_speed}\n"
        "bool physxScene:enableGPUDynamics = DYNAMICS\n"
        'uniform token physxScene:broadphaseType = "BROADPHASE"\n'
        'uniform token physxScene:solverType = "TGS"\n'
        'uniform token physxScene:collisionSystem = "POINTS"\n'
        "bool physxScene:enableEnhancedDeterminism = 1\n"
        "bool physxScene:enableExternalForcesEveryIteration = 1\n"  # without, overlaps are six times as deep
        "bool physxScene:enableSceneQuerySupport = 0\n"
        f"uint physxScene:timeStepsPerSecond = {round(1 / p.dt)}\n"
        f"uint physxScene:gpuMaxRigidContactCount = {1 << 23}\n"
        f"uint physxScene:gpuMaxRigidPatchCount = {1 << 21}\n"
        f"uint physxScene:gpuFoundLostPairsCapacity = {1 << 22}\n"
        f"uint physxScene:gpuCollisionStackSize = {1 << 29}\n"
        f"uint physxScene:gpuHeapCapacity = {1 << 28}\n"
        "rel material:binding:physics = </World/Stone>\n}\n"
        'def Material "Stone" (prepend apiSchemas = ["PhysicsMaterialAPI"]) {\n'
        f"float physics:staticFriction = {p.friction_static}\n"
        f"float physics:dynamicFriction = {p.friction_dynamic}\n"
        f"float physics:restitution = {p.restitution}\n}}"
    )
    middle, high = side / 2, side * 20
    for name, (x, y, z), axis in (
        ("wall_floor", (middle, middle, -5), "z"),
        ("wall_left", (-5, middle, high / 2 - 10), "x"),
        ("wall_right", (side + 5, middle, high / 2 - 10), "x"),
        ("wall_front", (middle, -5, high / 2 - 10), "y"),
        ("wall_back", (middle, side + 5, high / 2 - 10), "y"),
    ):
        size = {"x": (10, side + 20, high), "y": (side + 20, 10, high), "z": (side + 20, side + 20, 10)}[axis]
        text.append(
            f'def Cube "{name}" (prepend apiSchemas = ["PhysicsCollisionAPI", "PhysxCollisionAPI", '
            '"MaterialBindingAPI"]) {\n'
            "double size = 1\n"
            f"float physxCollision:contactOffset = {p.contact_offset}\n"
            "float physxCollision:restOffset = 0\n"
            "rel material:binding:physics = </World/Stone>\n"
            f"double3 xformOp:translate = ({x}, {y}, {z})\nfloat3 xformOp:scale = {size}\n"
            'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]\n}'
        )
    for i, grain in enumerate(grains):
        x, y, z = grain["place"]
        w, qx, qy, qz = grain["quaternion"]
        text.append(
            f'def "b{i}" (prepend references = </Shapes/s{grain["shape"]}>) {{\n'
            f"double3 xformOp:translate = ({x:.7g}, {y:.7g}, {z:.7g})\n"
            f"quatf xformOp:orient = ({w:.7g}, {qx:.7g}, {qy:.7g}, {qz:.7g})\n"
            'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]\n}'
        )
    text.append("}")
    return "\n".join(text) + "\n"


def write_scenes(folder: Path, numbers: list[int], parameters: Parameters) -> None:
    """``N.KIND.usda`` of every kind, and ``N.json`` of what lies in them."""
    folder.mkdir(parents=True, exist_ok=True)
    for n in numbers:
        grains = [
            {"place": place, "quaternion": list(map(float, quaternion)), "shape": shape}
            for place, quaternion, shape in layers(n, KINDS, np.random.default_rng(1))
        ]
        side = 2 * width(n)
        io.write_json(folder / f"{n}.json", {"side": side, "shapes": [g["shape"] for g in grains]})
        text = usd(side, grains, parameters)
        for kind, (gpu, phase, points) in KEPT.items():
            scene = text.replace("DYNAMICS", gpu).replace("BROADPHASE", phase).replace("POINTS", points)
            (folder / f"{n}.{kind}.usda").write_text(scene)


def porosity(pose: np.ndarray, kinds: list[int], side: float, voxel: float = 1 / 8) -> float:
    """Off walls and floor by two diameters, up to two thirds of the bed's height."""
    hulls = [trimesh.convex.convex_hull(shape.parts[0]) for shape in shapes().values()]
    table = pd.DataFrame({"shape": range(KINDS), "phase": 1, "r2d_um": 1.0})
    library = Library([h.vertices for h in hulls], [h.faces.astype(np.int32) for h in hulls], table)
    bodies = pd.DataFrame(pose, columns=["x", "y", "z", "qx", "qy", "qz", "qw"])
    bodies = bodies.assign(id=range(len(pose)), kind="grain", phase=1, shape=kinds, scale=1.0)
    wide, high = side - 8, 2 / 3 * np.quantile(pose[:, 2], 0.99) - 4
    phase, _ = voxelise(bodies, library, tuple(int(x / voxel) for x in (high, wide, wide)), voxel, (4, 4, 4))
    return float((phase == 0).mean())


PARAMETERS = Parameters(hull_vertices=HULL_VERTICES)


def body(shape) -> Solid:
    """A grain as this project's engine takes it."""
    mass = PARAMETERS.density * 4 / 3 * np.pi
    return Solid(shape.parts, shape.bound, mass, PARAMETERS.density * shape.inertia)


def drift(engine) -> tuple[float, float]:
    """Mean way of the bodies in 300 steps, and CPU time of one of these, ms."""
    before, cpu = engine.state().position, time.process_time()
    engine.step(300)
    cpu = time.process_time() - cpu
    return float(np.linalg.norm(engine.state().position - before, axis=1).mean()), 1e3 * cpu / 300


def judged(run: Path, folder: Path) -> dict:
    """A row of the table."""
    n = run.name.split(".")[0]
    scene = json.loads((folder / f"{n}.json").read_text())
    known = shapes()
    solids = [known[k] for k in scene["shapes"]]
    with np.load(run) as found:
        pose, velocity = found["pose"].astype(float), found["velocity"].astype(float)
        wall, speed, still = found["wall_s"], float(found["speed"][-1]), float(found["still"])
    row = {
        "n_grains": len(pose),
        "run": run.stem,
        "steps": 100 * len(wall),
        "wall_s": float(wall.sum()),
        "ms_per_step": 1e3 * float(wall[-1]) / 100,
        "still": still,
        "speed": speed,
        "porosity": porosity(pose, scene["shapes"], scene["side"]),
    }
    if len(pose) > MOST:
        return row
    engine = start(PARAMETERS, scene["side"], scene["side"])
    try:
        for shape, at, v in zip(solids, pose, velocity, strict=True):
            engine.add(body(shape), at[:3], at[[6, 3, 4, 5]], v[:3], v[3:])
        engine.step(1)
        overlap = max(0.0, -float(engine.contacts().gap.min()))
        creep, ms = drift(engine)
    finally:
        engine.close()
    return row | {"overlap": overlap, "creep": creep, "ms_per_step_here": ms}


def dropped_here(n: int, steps: int = 1500) -> dict:
    """The row of the same layers in this project's engine."""
    known, side = shapes(), 2 * width(n)
    engine = start(PARAMETERS, side, side)
    kinds = []
    try:
        for place, quaternion, kind in layers(n, KINDS, np.random.default_rng(1)):
            kinds.append(kind)
            engine.add(body(known[kind]), place, quaternion)
        engine.step(steps)
        state, gap = engine.state(), engine.contacts().gap
        creep, ms = drift(engine)
    finally:
        engine.close()
    return {
        "n_grains": n,
        "run": f"{n}.here",
        "steps": steps,
        "speed": float(np.median(np.linalg.norm(state.velocity, axis=1))),
        "porosity": porosity(np.hstack([state.position, np.roll(state.quaternion, -1, axis=1)]), kinds, side),
        "overlap": max(0.0, -float(gap.min())),
        "creep": creep,
        "ms_per_step_here": ms,
    }


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("what", choices=("scenes", "judge"))
    options.add_argument("folder", type=Path)
    options.add_argument("--numbers", type=int, nargs="*", default=[1000], help="grains of each scene")
    options.add_argument("--dt", type=float, default=Parameters.dt)
    options.add_argument("--iterations", type=int, default=Parameters.solver_iterations)
    options.add_argument("--out", type=Path, default=Path("results/benchmarks/packing_gpu.csv"))
    given = options.parse_args()
    if given.what == "scenes":
        parameters = Parameters(dt=given.dt, solver_iterations=given.iterations)
        write_scenes(given.folder, given.numbers, parameters)
        return
    rows = [judged(run, given.folder) for run in sorted(given.folder.glob("*.npz"))]
    rows += [dropped_here(n) for n in given.numbers]
    io.write_table(given.out, pd.DataFrame(rows))
    print(pd.DataFrame(rows).to_string())


if __name__ == "__main__":
    main()
