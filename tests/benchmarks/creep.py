"""How much a bed of grains that should rest goes on settling, for each way of finding contacts.

    python tests/benchmarks/creep.py [--seeds 3] [--out results/benchmarks/creep.csv]

128 angular grains fall into a box and are left to themselves, none of them ever fixed in place. A bed at rest
keeps its height; one that shivers compacts without end. Columns: engine, contact_manifold, dt, seed,
height_3000, height_6000 (mean height of the centres after so many steps, mean grain radii), creep (share of
the height lost in between), drift (median way of a grain over 500 further steps, radii), cpu_s.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd
from engines import angular_grains

from grainfall import io
from grainfall.packing import Parameters
from grainfall.packing.deposition import random_quaternion
from grainfall.packing.engine import Solid, start
from grainfall.packing.shapes import collision_shapes

SIDE = 10.0
CASES = (
    {"engine": "physx", "contact_manifold": "full"},
    {"engine": "physx", "contact_manifold": "persistent"},
    {"engine": "physx", "contact_manifold": "full", "dt": 0.005},
    {"engine": "bullet"},
)


def measure(seed: int, **changes: object) -> dict:
    """One bed and its figures."""
    parameters = Parameters.named("default", **changes)
    rng = np.random.default_rng(seed)
    shapes = collision_shapes(angular_grains(40, rng), range(40), parameters)
    engine = start(parameters, SIDE, SIDE)
    started = time.process_time()
    places = [
        (1.25 + 2.5 * i, 1.25 + 2.5 * j, 2 + 2.6 * k) for k in range(8) for i in range(4) for j in range(4)
    ]
    for place in places:
        shape, r = shapes[int(rng.integers(40))], rng.uniform(0.8, 1.2)
        solid = Solid(tuple(part * r for part in shape.parts), shape.bound * r, r**3, shape.inertia * r**5)
        engine.add(solid, np.array(place), random_quaternion(rng), np.array([0.0, 0.0, -1.0]))
    heights = []
    for _ in range(12):
        engine.step(500)
        heights.append(engine.state().position[:, 2].mean())
    before = engine.state().position
    engine.step(500)
    drift = np.linalg.norm(engine.state().position - before, axis=1)
    engine.close()
    return {
        "engine": parameters.engine,
        "contact_manifold": parameters.contact_manifold if parameters.engine == "physx" else "",
        "dt": parameters.dt,
        "seed": seed,
        "height_3000": heights[5],
        "height_6000": heights[-1],
        "creep": 1 - heights[-1] / heights[5],
        "drift": np.median(drift),
        "cpu_s": time.process_time() - started,
    }


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seeds", type=int, default=3)
    options.add_argument("--out", type=Path, default=Path("results/benchmarks/creep.csv"))
    given = options.parse_args()
    rows = []
    for case in CASES:
        for seed in range(given.seeds):
            rows.append(measure(seed, **case))
            print(rows[-1], flush=True)
    io.write_table(given.out, pd.DataFrame(rows))


if __name__ == "__main__":
    main()
