"""Scenes that are hard on a packing, in both engines, against the verdicts written down before they ran.

    python tests/benchmarks/hard_cases.py [--size full] [--only NAME ...] [--engine physx] [--out FILE]

Hours at full size: a table that is there already is gone on with (remove it to begin anew), and what
``--only`` names is run anew.

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
    options.add_argument(
        "--out", type=Path, help="results/benchmarks/hard_cases.csv or hard_cases_reduced.csv"
    )
    given = options.parse_args()
    suffix = "" if given.size == "full" else "_reduced"
    given.out = given.out or Path(f"results/benchmarks/hard_cases{suffix}.csv")
    table = io.read_table(given.out) if given.out.exists() else pd.DataFrame(columns=hard_scenes.COLUMNS)
    for scene in hard_scenes.scenes(given.size):
        for engine in hard_scenes.engines(scene):
            known = (table["scene"] == scene["scene"]) & (table["engine"] == engine)
            left_out = given.only and scene["scene"] not in given.only
            if left_out or given.engine not in (None, engine) or (known.any() and not given.only):
                continue
            row = hard_scenes.run(scene, engine)
            print(
                f"{row['scene']:32} {engine:6} {row['expected']:8} {row['verdict']:8} "
                f"{_text(row['overlap'], '.4f')} {_text(row['escaped'], 'd')} {_text(row['asleep'], '.3f')} "
                f"{row['steps']:6d} {row['wall_s']:7.1f} s  {row['why']}",
                flush=True,
            )
            rows = [*table[~known].to_dict("records"), row]
            table = pd.DataFrame(rows, columns=hard_scenes.COLUMNS)
            io.write_table(given.out, table)
    unexpected = int((table["verdict"] != table["expected"]).sum())
    print(f"{len(table)} runs, {unexpected} not as expected")
    sys.exit(unexpected > 0)


def _text(value: float | None, form: str) -> str:
    return " " * 6 if value is None else f"{value:6{form}}"


if __name__ == "__main__":
    main()
