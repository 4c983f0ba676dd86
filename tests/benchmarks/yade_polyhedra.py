"""Polyhedra falling into a box in YADE; started by packing_speed.py, in YADE's own interpreter.

    GRAINS=job.json SETTLED=out.json yade -n -x -j1 tests/benchmarks/yade_polyhedra.py

Contacts are YADE's volumetric ones, elastic, with its usual numerical damping: stiff enough that grains ten
deep overlap by a hundredth of a radius, which asks for steps ten times as small as a rigid-body engine's.
"""

import json
import os
import time
from math import atan
from pathlib import Path

from yade import (
    Bo1_Polyhedra_Aabb,
    Bo1_Wall_Aabb,
    ForceResetter,
    Ig2_Polyhedra_Polyhedra_PolyhedraGeom,
    Ig2_Wall_Polyhedra_PolyhedraGeom,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_PolyhedraMat_PolyhedraMat_PolyhedraPhys,
    Law2_PolyhedraGeom_PolyhedraPhys_Volumetric,
    NewtonIntegrator,
    O,
    PolyhedraMat,
    Quaternion,
    polyhedra_utils,
    utils,
)

STIFFNESS = 1e5
DAMPING = 0.3
STEP, LOOK = 1e-3, 0.1  # s

job = json.loads(Path(os.environ["GRAINS"]).read_text())
side, speed, long_enough = job["side"], job["sleep_speed"], job["sleep_s"]
material = PolyhedraMat(density=2.6, young=STIFFNESS, poisson=0.5, frictionAngle=atan(0.5))
for at, axis, sense in ((0, 2, 1), (0, 0, 1), (side, 0, -1), (0, 1, 1), (side, 1, -1)):
    O.bodies.append(utils.wall(at, axis=axis, sense=sense, material=material))
grains = []
for shape, place, (w, x, y, z) in zip(job["shapes"], job["places"], job["quaternions"], strict=True):
    body = polyhedra_utils.polyhedra(material, v=[tuple(p) for p in job["hulls"][shape]])
    body.state.pos, body.state.ori = place, Quaternion(w, x, y, z)
    grains.append(O.bodies[O.bodies.append(body)])
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Polyhedra_Aabb(), Bo1_Wall_Aabb()]),
    InteractionLoop(
        [Ig2_Wall_Polyhedra_PolyhedraGeom(), Ig2_Polyhedra_Polyhedra_PolyhedraGeom()],
        [Ip2_PolyhedraMat_PolyhedraMat_PolyhedraPhys()],
        [Law2_PolyhedraGeom_PolyhedraPhys_Volumetric()],
    ),
    NewtonIntegrator(damping=DAMPING, gravity=(0, 0, -9.8)),
]
O.dt = STEP
still, began = [0.0] * len(grains), time.process_time()
before = [body.state.pos for body in grains]
while time.process_time() - began < job["limit_s"] and min(still) < long_enough:
    O.run(round(LOOK / STEP), wait=True)
    now = [body.state.pos for body in grains]
    for k, (a, b) in enumerate(zip(before, now, strict=True)):
        if still[k] < long_enough:
            still[k] = still[k] + LOOK if (b - a).norm() < speed * LOOK else 0.0
    before = now
found = {
    "cpu_s": time.process_time() - began,
    "steps": O.iter,
    "settled": sum(s >= long_enough for s in still) / len(still),
    "simulated_s": O.time,
}
Path(os.environ["SETTLED"]).write_text(json.dumps(found))
