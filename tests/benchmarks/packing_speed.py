"""How long convex grains take to settle, on one core.

    python tests/benchmarks/packing_speed.py [--numbers 1000 4000 10000] [--columns 1000 20000] [--out ...]

The process is pinned to one core. Engines of this project deposit the grains of 32 vertices to the paper's
sleep criterion (below 0.01 for 300 steps) in a box as wide as the bed is high, as the region of a twin asks
for, and then bring them all to rest together, which the criterion does not ask for. The plain loop is what
one writes without a package: all grains in layers in the same box, pybullet's defaults, steps until all have
been still for as long. YADE's polyhedra, where it is installed, start alike; they are given ten minutes.

Columns: engine, n_grains, hull_vertices, wall_s, cpu_s (wall time is another's on a shared machine),
pour_cpu_s (to the sleep criterion; what else cpu_s has is the final rest), body_steps (steps of every moving
body while pouring, which is what a machine does not change), settled (share of the grains, by the criterion),
steps, rest_steps (after pouring, all grains free), note. The exponents over numbers of body_steps, pour_cpu_s
and cpu_s are written in the note of an engine's last row.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from engines import angular_grains

from grainfall import io
from grainfall.grains import Library
from grainfall.packing import Parameters, container, deposit
from grainfall.packing.deposition import random_quaternion
from grainfall.packing.rest import settle
from grainfall.packing.shapes import collision_shapes

HULL_VERTICES = 32
RADIUS = 50.0
SLEEP_SPEED, SLEEP_STEPS = 0.01, 300
"""The paper's sleep criterion."""


def width(n: int) -> float:
    """Edge, mean diameters, of the cube that ``n`` grains fill."""
    return (n * np.pi / 6 / 0.6) ** (1 / 3)


def this_project(
    engine: str, n: int, library: Library, rng: np.random.Generator, floor: int | None = None
) -> dict:
    """A deposition of about ``n`` grains; how many it took is in the row.

    On the floor of the cube that ``floor`` grains fill it is a column, which is not brought to rest.
    """
    parameters = Parameters.named(
        engine=engine,
        hull_vertices=HULL_VERTICES,
        sleep_speed=SLEEP_SPEED,
        sleep_steps=SLEEP_STEPS,
    )
    margin, diameter = 1.0, 2 * RADIUS
    side = width(floor or n)
    roi = tuple((edge - 2 * margin) * diameter for edge in (side, side, width(n) ** 3 / side**2))
    supply = pd.DataFrame(
        {"kind": "grain", "phase": 1, "shape": rng.integers(0, len(library.vertices), n), "scale": RADIUS}
    )
    box = container(roi, diameter, margin)
    begin = time.process_time()
    bodies = deposit(supply, library, box, parameters, rng, rest=False)
    poured = time.process_time() - begin
    report = bodies.attrs["report"]
    row = {
        "n_grains": report["poured"],
        "pour_cpu_s": poured,
        "body_steps": round(report["mean_active"] * report["steps"]),
        "settled": report["asleep"] / report["poured"],
        "steps": report["steps"],
        "note": "",
    }
    if floor is None:
        _, rest = settle(bodies, library, box, parameters)
        row |= {"rest_steps": rest["steps"], "note": "" if rest["at_rest"] else "not at rest in the end"}
    return row


def layers(n: int, kinds: int, rng: np.random.Generator) -> Iterator[tuple[list, np.ndarray, int]]:
    """Place, quaternion and shape of grains in layers over the cross-section of a box."""
    across = int(2 * width(n) // 2.8)
    for k in range(n):
        place = [1.4 + 2.8 * (k % across), 1.4 + 2.8 * (k // across % across), 2 + 2.8 * (k // across**2)]
        yield place, random_quaternion(rng), int(rng.integers(kinds))


def plain_pybullet(n: int, library: Library, rng: np.random.Generator, most_steps: int = 6000) -> dict:
    """All grains at once, in layers over the same cross-section, pybullet's defaults but for friction."""
    import pybullet as bullet

    shapes = collision_shapes(library, range(len(library.vertices)), Parameters(hull_vertices=HULL_VERTICES))
    client = bullet.connect(bullet.DIRECT)
    bullet.setGravity(0, 0, -9.8, physicsClientId=client)
    side = 2 * width(n)
    for place, normal in (
        ((0, 0, 0), (0, 0, 1)),
        ((0, 0, 0), (1, 0, 0)),
        ((side, 0, 0), (-1, 0, 0)),
        ((0, 0, 0), (0, 1, 0)),
        ((0, side, 0), (0, -1, 0)),
    ):
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE, planeNormal=normal, physicsClientId=client)
        bullet.createMultiBody(0, plane, basePosition=place, physicsClientId=client)
    hulls = [
        bullet.createCollisionShape(
            bullet.GEOM_MESH, vertices=shapes[s].parts[0].tolist(), physicsClientId=client
        )
        for s in shapes
    ]
    for place, (w, x, y, z), shape in layers(n, len(hulls), rng):
        body = bullet.createMultiBody(
            2.6 * 4 / 3 * np.pi,
            hulls[shape],
            basePosition=place,
            baseOrientation=[x, y, z, w],
            physicsClientId=client,
        )
        bullet.changeDynamics(
            body,
            -1,
            lateralFriction=0.5,
            restitution=0.5,
            activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
    bodies = range(5, 5 + n)
    bullet.setTimeStep(0.01, physicsClientId=client)

    def places() -> np.ndarray:
        return np.array([bullet.getBasePositionAndOrientation(b, client)[0] for b in bodies])

    still, before, look, steps = np.zeros(n, int), places(), 10, 0
    while steps < most_steps and not (still >= SLEEP_STEPS).all():
        for _ in range(look):
            bullet.stepSimulation(physicsClientId=client)
        steps += look
        now = places()
        slow = np.linalg.norm(now - before, axis=1) < SLEEP_SPEED * look * 0.01
        # as in a deposition, a grain that has once been still so long counts as settled
        still = np.where(still >= SLEEP_STEPS, still, np.where(slow, still + look, 0))
        before = now
    out = ((before[:, :2] < 0) | (before[:, :2] > side)).any(axis=1) | (before[:, 2] < 0)
    bullet.disconnect(client)
    return {
        "n_grains": n,
        "settled": float(((still >= SLEEP_STEPS) & ~out).mean()),
        "steps": steps,
        "note": f"{int(out.sum())} left the box" if out.any() else "",
    }


def yade(n: int, library: Library, rng: np.random.Generator, limit_s: float = 600.0) -> dict:
    """The same layers as polyhedra in YADE, at most for so long."""
    shapes = collision_shapes(library, range(len(library.vertices)), Parameters(hull_vertices=HULL_VERTICES))
    places, quaternions, kinds = zip(*layers(n, len(shapes), rng), strict=True)
    job = {
        "side": 2 * width(n),
        "hulls": [shapes[s].parts[0].tolist() for s in shapes],
        "places": places,
        "quaternions": [q.tolist() for q in quaternions],
        "shapes": kinds,
        "sleep_speed": SLEEP_SPEED,
        "sleep_s": SLEEP_STEPS * Parameters().dt,
        "limit_s": limit_s,
    }
    with tempfile.TemporaryDirectory() as folder:
        files = {"GRAINS": f"{folder}/job.json", "SETTLED": f"{folder}/out.json"}
        Path(files["GRAINS"]).write_text(json.dumps(job))
        script = Path(__file__).with_name("yade_polyhedra.py")
        # it warns of every pair that touches
        subprocess.run(
            ["yade", "-n", "-x", "-j1", script], env=os.environ | files, check=True, capture_output=True
        )
        found = json.loads(Path(files["SETTLED"]).read_text())
    simulated_s, cpu_s = found.pop("simulated_s"), found["cpu_s"]
    note = f"{simulated_s:.1f} s simulated" + (", stopped at its limit" if cpu_s >= limit_s else "")
    return {"n_grains": n, "note": note} | found


def timed(engine: str, work, *arguments) -> dict:
    """A row: the work's own figures, wall and processor time."""
    wall, cpu = time.perf_counter(), time.process_time()
    row = work(*arguments)
    found = {
        "engine": engine,
        "n_grains": row["n_grains"],
        "hull_vertices": HULL_VERTICES,
        "wall_s": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
    } | row
    print(found, flush=True)
    return found


def exponent(rows: list[dict], column: str) -> float:
    """Slope of a column's logarithm over that of the number."""
    n, cost = ([row[name] for row in rows] for name in ("n_grains", column))
    return float(np.polyfit(np.log(n), np.log(cost), 1)[0])


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--numbers", type=int, nargs="*", default=[1000, 4000, 10000, 20000])
    options.add_argument(
        "--bullet", type=int, nargs="*", default=[1000], help="numbers for this project's Bullet"
    )
    options.add_argument(
        "--columns", type=int, nargs="*", default=[1000, 4000, 20000], help="numbers for PhysX's columns"
    )
    options.add_argument(
        "--plain", type=int, nargs="*", default=[200, 1000], help="numbers for the plain loop"
    )
    options.add_argument("--yade", type=int, default=20, help="number for YADE's polyhedra")
    options.add_argument("--out", type=Path, default=Path("results/benchmarks/packing_speed.csv"))
    given = options.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    library = angular_grains(40, np.random.default_rng(0))
    rows: list[dict] = []

    def keep(row: dict) -> None:
        rows.append(row)
        io.write_table(given.out, pd.DataFrame(rows))

    for n in given.plain:
        keep(timed("pybullet, plain loop", plain_pybullet, n, library, np.random.default_rng(1)))
    for name, engine, numbers, floor in (
        ("physx", "physx", given.numbers, None),
        ("physx, column", "physx", given.columns, min(given.columns, default=None)),
        ("bullet", "bullet", given.bullet, None),
    ):
        if numbers:
            this_project(engine, 100, library, np.random.default_rng(0))  # compiles and loads
        for n in numbers:
            row = timed(name, this_project, engine, n, library, np.random.default_rng(1), floor)
            mine = [r for r in rows if r["engine"] == name] + [row]
            if len(mine) > 1:
                steps, poured, cost = (exponent(mine, c) for c in ("body_steps", "pour_cpu_s", "cpu_s"))
                slope = f"steps of bodies grow as n^{steps:.2f}, pouring as n^{poured:.2f}"
                slope += "" if floor else f", with the final rest n^{cost:.2f}"
                row["note"] = "; ".join(filter(None, (row["note"], slope)))
            keep(row)
    if shutil.which("yade"):
        keep(timed("YADE polyhedra", yade, given.yade, library, np.random.default_rng(1)))
    else:
        note = "skipped: not installed (apt: yade)"
        keep({"engine": "YADE polyhedra", "hull_vertices": HULL_VERTICES, "note": note})
    print(pd.DataFrame(rows).to_string())


if __name__ == "__main__":
    main()
