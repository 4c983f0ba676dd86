"""What taking grains for spheres does to their sizes in space -> results/benchmarks/grain_shapes.csv

Synthetic rocks of grains of four shapes; of each a section with its grains outlined, so that nothing but the
inversion errs. It is unfolded by what planes cut from spheres, and from the grains that three masks each make
of the same section. A row is a mean over rocks with its 95 % interval: moments over the truth's, and the
Wasserstein-1 distance of radii over their true mean.

Run it as ``python tests/benchmarks/grain_shapes.py [--rocks 6] [--out FILE]``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from grainfall import grains, morphology, stereology
from grainfall.io import write_table
from grainfall.random import generator
from grainfall.section import Mineral, synthesise

SHAPES = {
    "spheres": (2, 0.0),
    "blocks": (3, 0.15),
    "uneven blocks": (3, 0.35),
    "uneven ellipsoids": (2, 0.35),
}
"""Exponent of the superellipsoids, and spread of the logarithm of their half-axes."""
RADIUS, CV, PIXEL, VOXEL = 20.0, 0.25, 1.0, 2.0


def moments(radii: np.ndarray) -> dict[str, float]:
    mean, square, cube = (np.mean(radii**k) for k in (1, 2, 3))
    return {"mean": mean, "sauter": cube / square, "cv": np.sqrt(square / mean**2 - 1)}


def rock(name: str, number: int) -> list[dict]:
    """Errors in one rock of a shape, by either kernel."""
    exponent, elongation = SHAPES[name]
    mineral = Mineral("grain", 1.0, RADIUS, CV, elongation)
    truth = synthesise(
        generator(0, name, number, "benchmark/rock"), (120, 500, 500), VOXEL, [mineral], exponent=exponent
    )
    phase, outlines = truth.section(PIXEL)
    seen = morphology.analyse(phase, PIXEL, instances=outlines)
    library = grains.build_library(
        seen.grain_labels, seen.grains, 150, generator(0, name, number, "benchmark/grains"), pieces=False
    )
    radii = truth.sizes().r_um.to_numpy()
    true, rows = moments(radii), []
    for kernel, particle in (
        ("spheres", stereology.SPHERE),
        ("own shapes", grains.random_profiles(library.meshes(1))),
    ):
        sizes = stereology.unfold_table(seen.grains, smallest_um=seen.smallest_um, particle=particle)
        drawn = stereology.draw_radii(sizes, 20_000, generator(0, name, number, "benchmark/draw"))
        found = {key: value / true[key] for key, value in moments(drawn).items()}
        found["w1"] = stats.wasserstein_distance(drawn, radii) / radii.mean()
        rows += [{"shape": name, "kernel": kernel, "quantity": key, "value": v} for key, v in found.items()]
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description="Sizes of grains that are no spheres")
    parser.add_argument("--rocks", type=int, default=6)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks/grain_shapes.csv"))
    arguments = parser.parse_args()
    every = pd.DataFrame([row for name in SHAPES for n in range(arguments.rocks) for row in rock(name, n)])
    rows = []
    for key, group in every.groupby(["shape", "kernel", "quantity"], sort=False):
        value = group["value"]
        half = stats.t.ppf(0.975, len(value) - 1) * value.sem()
        rows.append((*key, value.mean(), value.mean() - half, value.mean() + half, len(value)))
    table = pd.DataFrame(rows, columns=["shape", "kernel", "quantity", "mean", "lower", "upper", "n"])
    write_table(arguments.out, table.round(4))
    print(table.pivot_table("mean", ["shape", "kernel"], "quantity", sort=False).round(3).to_string())


if __name__ == "__main__":
    main()
