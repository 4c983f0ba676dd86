"""Network permeability and formation factor of the Berea cubes against published Stokes values.

    python tests/benchmarks/permeability.py [--cubes 27] [--out results/benchmarks/permeability.csv]

Needs the reference data beside the checkout. Columns: sample, cube, axis, method, k, k_ref (mD), ff, ff_ref,
wall_s.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import tifffile

from grainfall import flow, io
from grainfall.units import um2_to_millidarcy

DATA = Path(__file__).resolve().parents[2].parent / "shared/data/berea"
VOXEL_UM = 5.345
EDGE = 128


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--cubes", type=int, default=27)
    options.add_argument("--out", type=Path, default=Path("results/benchmarks/permeability.csv"))
    given = options.parse_args()
    pore = tifffile.imread(DATA / "berea_400_pore1.tif") == 1
    published = pd.read_csv(DATA / "subvolume_K_FF.csv")
    rows = []
    for cube, row in published.head(given.cubes).iterrows():
        i, j, k = (int(row[name]) for name in ("i0_axis0", "j0_axis1", "k0_axis2"))
        part = pore[i : i + EDGE, j : j + EDGE, k : k + EDGE]
        for found in flow.permeability(part, VOXEL_UM).itertuples():
            axis = found.axis.upper()
            k_ref = um2_to_millidarcy(row[f"K_{axis}_h2"] * VOXEL_UM**2)
            ours, theirs = (found.k_md, k_ref), (found.formation_factor, row[f"FF_{axis}"])
            rows.append(("berea", cube, found.axis, "snow2", *ours, *theirs, found.wall_s))
        print(rows[-3:], flush=True)
    columns = ["sample", "cube", "axis", "method", "k", "k_ref", "ff", "ff_ref", "wall_s"]
    table = pd.DataFrame(rows, columns=columns)
    io.write_table(given.out, table)
    for name in ("k", "ff"):
        ratio = table[name] / table[f"{name}_ref"]
        print(
            f"{name}: median ratio {ratio.median():.3f}, mean absolute error {(ratio - 1).abs().mean():.3f}, "
            f"std of log {np.log(ratio).std():.3f}"
        )


if __name__ == "__main__":
    main()
