"""Scenes that are hard on a packing, in both engines, against the verdicts written down before they ran.

    python tests/benchmarks/hard_cases.py [--size full] [--only NAME ...] [--engine physx] [--out FILE]

Columns: scene, engine (- where none takes part), expected, verdict (works, refused, fails), overlap (largest,
collision shapes, radii of the smaller grain), escaped (bodies), asleep (fraction), steps, wall_s.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import pandas as pd

from grainfall import io

sys.path.append(str(Path(__file__).resolve().parents[1] / "physics"))
import hard_scenes


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--size", choices=("full", "reduced"), default="full")
    options.add_argument("--only", nargs="+", help="names of scenes")
    options.add_argument("--engine", choices=hard_scenes.ENGINES)
    options.add_argument("--out", type=Path, default=Path("results/benchmarks/hard_cases.csv"))
    given = options.parse_args()
    rows = []
    for scene in hard_scenes.scenes(given.size):
        for engine in hard_scenes.engines(scene):
            if (given.only and scene["scene"] not in given.only) or given.engine not in (None, engine):
                continue
            row = hard_scenes.run(scene, engine)
            rows.append(row)
            print(
                f"{row['scene']:32} {engine:6} {row['expected']:8} {row['verdict']:8} "
                f"{_text(row['overlap'], '.4f')} {_text(row['escaped'], 'd')} {_text(row['asleep'], '.3f')} "
                f"{row['steps']:6d} {row['wall_s']:7.1f} s  {row['why']}",
                flush=True,
            )
    table = pd.DataFrame(rows)
    io.write_table(given.out, table[hard_scenes.COLUMNS])
    unexpected = int((table["verdict"] != table["expected"]).sum())
    print(f"{len(table)} runs, {unexpected} not as expected")
    sys.exit(unexpected > 0)


def _text(value: float | None, form: str) -> str:
    return " " * 6 if value is None else f"{value:6{form}}"


if __name__ == "__main__":
    main()
