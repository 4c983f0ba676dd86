"""The same grains poured by each engine, paired by seed: time, porosity, overlap.

    python tests/benchmarks/engines.py [--edge 3.5] [--seeds 3] [--out results/benchmarks/engines.csv]

Columns: engine, parameters, inertia, contact_manifold, sleep_speed, seed, n_bodies, wall_s, cpu_s, steps,
ms_per_step, mean_active, porosity, max_overlap, mean_overlap, asleep, escaped. Overlaps: collision shapes,
smaller radii.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd
import trimesh

from grainfall import io
from grainfall.grains import Library
from grainfall.packing import Mixture, Parameters, container, deposit, draw_population
from grainfall.volume import voxelise

RADIUS = 50.0


class Lognormal:
    """Radii about 50 um, coefficient of variation 0.25."""

    def quantile(self, q: np.ndarray, which: str = "f3d") -> np.ndarray:
        from scipy.stats import lognorm

        return lognorm.ppf(np.clip(q, 0.01, 0.99), 0.25, scale=RADIUS)


def angular_grains(n: int, rng: np.random.Generator, planes: int = 4, subdivisions: int = 3) -> Library:
    """Ellipsoids cut by random planes, equal-volume radius 1, centre of mass at the origin."""
    vertices, faces, radii = [], [], []
    for _ in range(n):
        ball = trimesh.creation.icosphere(subdivisions)
        v = np.array(ball.vertices) * rng.uniform(0.75, 1.25, 3)
        for _ in range(planes):
            d = rng.standard_normal(3)
            d /= np.linalg.norm(d)
            v -= np.maximum(v @ d - rng.uniform(0.6, 0.9) * (v @ d).max(), 0)[:, None] * d
        mesh = trimesh.Trimesh(v, ball.faces, process=False)
        vertices.append((v - mesh.center_mass) / (mesh.volume / (4 * np.pi / 3)) ** (1 / 3))
        faces.append(np.array(ball.faces, np.int32))
        radii.append(RADIUS)
    return Library(vertices, faces, pd.DataFrame({"shape": np.arange(n), "phase": 1, "r2d_um": radii}))


def measure(library: Library, edge: float, seed: int, name: str, **changes: object) -> dict:
    """One packing and its figures."""
    mixture = Mixture({1: Lognormal()}, {1: 1.0})
    box = container(edge * 2 * RADIUS, mixture.mean_grain_diameter)
    population = draw_population(mixture, library, box.solid_um3(), np.random.default_rng(seed))
    parameters = Parameters.named(name, **changes)
    started = time.process_time()
    bodies = deposit(population, library, box, parameters, np.random.default_rng(seed))
    cpu = time.process_time() - started
    report = bodies.attrs["report"]
    voxel = RADIUS / 8
    shape = (round(edge * 2 * RADIUS / voxel),) * 3
    phase, _ = voxelise(bodies, library, shape, voxel)
    return {
        "engine": parameters.engine,
        "parameters": name,
        "inertia": parameters.inertia,
        "contact_manifold": parameters.contact_manifold if parameters.engine == "physx" else "",
        "sleep_speed": parameters.sleep_speed,
        "seed": seed,
        "n_bodies": len(bodies),
        "wall_s": report["wall_s"],
        "cpu_s": cpu,
        "steps": report["steps"],
        "ms_per_step": 1e3 * cpu / report["steps"],
        "mean_active": report["mean_active"],
        "porosity": float((phase == 0).mean()),
        "max_overlap": report["max_overlap"],
        "mean_overlap": report["mean_overlap"],
        "asleep": report["asleep"] / report["poured"],
        "escaped": report["escaped"],
    }


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--edge", type=float, default=3.5, help="edge of the region, mean diameters")
    options.add_argument("--seeds", type=int, default=3)
    options.add_argument("--out", type=Path, default=Path("results/benchmarks/engines.csv"))
    given = options.parse_args()
    library = angular_grains(60, np.random.default_rng(0))
    rows = []
    for seed in range(given.seeds):
        for name, changes in (
            ("default", {"engine": "physx"}),
            ("default", {"engine": "physx", "inertia": "paper"}),
            ("default", {"engine": "physx", "contact_manifold": "persistent"}),
            ("default", {"engine": "physx", "sleep_speed": 0.01, "sleep_steps": 300}),
            ("default", {"engine": "bullet"}),
            ("paper", {"engine": "physx"}),
        ):
            rows.append(measure(library, given.edge, seed, name, **changes))
            print(rows[-1], flush=True)
    table = pd.DataFrame(rows)
    io.write_table(given.out, table)
    print(
        table.groupby(["engine", "parameters", "inertia", "contact_manifold", "sleep_speed"])
        .mean(numeric_only=True)
        .T.to_string()
    )


if __name__ == "__main__":
    main()
