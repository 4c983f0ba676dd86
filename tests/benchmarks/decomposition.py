"""The bias of convex hulls, and what convex parts mend of it: the same grains poured as either.

    python tests/benchmarks/decomposition.py [--section IMAGE.npz] [--edge 3] [--seeds 3]
        [--out results/benchmarks/decomposition.csv]

Shape sets: L and star (axis crosses of six arms) of cubes, and the grains of a section (an instance image)
where one is named. Porosity is that of the true meshes, on voxels. Printed besides: the difference in
porosity of parts and hulls, paired by seed, with its 95 % interval. Columns: shape_set, decomposition, seed,
n_bodies, porosity, hull_excess, collision_excess (means over the grains), decomposed (share of the grains),
pieces (mean over those), max_overlap (hulls, or parts of decomposed grains; smaller radii), engine_overlap
(collision shapes), asleep, steps, wall_s.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import trimesh
from engines import RADIUS, Lognormal
from scipy.stats import t as student

from grainfall import contacts, io, morphology
from grainfall.grains import Library, build_library, cut
from grainfall.packing import Mixture, Parameters, container, deposit, draw_population
from grainfall.packing.shapes import collision_shapes
from grainfall.section import read_section
from grainfall.volume import voxelise

L_CELLS = ((0, 0, 0), (1, 0, 0), (0, 1, 0))
STAR_CELLS = ((0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


def of_cubes(cells: tuple) -> Library:
    """A library of one grain made of unit cubes."""
    filled = set(cells)
    corners, faces = {}, []
    for cell in cells:
        for axis in range(3):
            for side in (0, 1):
                step = np.eye(3, dtype=int)[axis] * (2 * side - 1)
                if tuple(step + cell) in filled:
                    continue
                square = np.zeros((4, 3), int)
                square[:, axis] = side
                square[:, (axis + 1) % 3] = (0, 1, 1, 0)
                square[:, (axis + 2) % 3] = (0, 0, 1, 1)
                loop = [corners.setdefault(tuple(c), len(corners)) for c in (square + cell).tolist()]
                loop = loop if side else loop[::-1]
                faces += [loop[:3], [loop[0], *loop[2:]]]
    mesh = trimesh.Trimesh(np.array(list(corners), float), faces, process=False)
    v = (mesh.vertices - mesh.center_mass) / (mesh.volume / (4 * np.pi / 3)) ** (1 / 3)
    faces = np.array(faces, np.int32)
    table = pd.DataFrame({"shape": [0], "phase": 1, "r2d_um": RADIUS})
    return Library([v], [faces], table, pieces=[cut(v, faces)[0]])


def measure(name: str, library: Library, decomposition: str, edge: float, seed: int) -> dict:
    """One packing and its figures."""
    mixture = Mixture({1: Lognormal()}, {1: 1.0})
    box = container(edge * 2 * RADIUS, mixture.mean_grain_diameter)
    population = draw_population(mixture, library, box.solid_um3(), np.random.default_rng(seed))
    parameters = Parameters.named("default", decomposition=decomposition)
    bodies = deposit(population, library, box, parameters, np.random.default_rng(seed))
    report = bodies.attrs["report"]
    voxel = RADIUS / 10
    shape = (round(edge * 2 * RADIUS / voxel),) * 3
    phase, _ = voxelise(bodies, library, shape, voxel)
    pieces = {
        s: len(c.parts) for s, c in collision_shapes(library, bodies["shape"].unique(), parameters).items()
    }
    counts = bodies["shape"].map(pieces)
    return {
        "shape_set": name,
        "decomposition": decomposition,
        "seed": seed,
        "n_bodies": len(bodies),
        "porosity": float((phase == 0).mean()),
        "hull_excess": report["hull_excess"],
        "collision_excess": report["collision_excess"],
        "decomposed": report["n_decomposed"] / report["poured_grains"],
        "pieces": counts[counts > 1].mean(),
        "max_overlap": contacts.max_overlap(bodies, library, (edge * 2 * RADIUS,) * 3, parameters),
        "engine_overlap": report["max_overlap"],
        "asleep": report["asleep"] / report["poured"],
        "steps": report["steps"],
        "wall_s": report["wall_s"],
    }


def section_grains(image: Path, n: int) -> Library:
    """Grains of an instance image."""
    section = read_section(image, "instances", 1.0)
    found = morphology.analyse(section.phase, 1.0, instances=section.instances, phases=section.phases)
    return build_library(found.grain_labels, found.grains, n, np.random.default_rng(0))


def difference(table: pd.DataFrame, of: str, against: str = "off") -> pd.DataFrame:
    """Porosity with ``of`` minus that with ``against``, by shape set: mean, 95 % half-width."""
    porosity = table.pivot_table(index=["shape_set", "seed"], columns="decomposition", values="porosity")
    paired = (porosity[of] - porosity[against]).groupby("shape_set", sort=False).agg(["mean", "sem", "size"])
    return paired.assign(half_width=paired["sem"] * student.ppf(0.975, paired["size"] - 1))


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--section", type=Path, help="instance image of a section")
    options.add_argument("--shapes", type=int, default=60, help="grains drawn from the section")
    options.add_argument("--edge", type=float, default=3.0, help="edge of the region, mean diameters")
    options.add_argument("--seeds", type=int, default=3)
    options.add_argument("--out", type=Path, default=Path("results/benchmarks/decomposition.csv"))
    given = options.parse_args()
    sets = {"L": of_cubes(L_CELLS), "star": of_cubes(STAR_CELLS)}
    if given.section:
        sets["section"] = section_grains(given.section, given.shapes)
    rows = []
    for name, library in sets.items():
        for decomposition in ("off", "auto", "on"):
            for seed in range(given.seeds):
                rows.append(measure(name, library, decomposition, given.edge, seed))
                print(rows[-1], flush=True)
    table = pd.DataFrame(rows)
    io.write_table(given.out, table)
    print(table.groupby(["shape_set", "decomposition"], sort=False).mean(numeric_only=True).T.to_string())
    for decomposition in ("auto", "on"):
        print(f"\nporosity, {decomposition} minus off")
        print(difference(table, decomposition).to_string())


if __name__ == "__main__":
    main()
