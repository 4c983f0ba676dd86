"""Scenes that are hard on a packing, in both engines, against the verdicts written down before they ran.

    python tests/benchmarks/hard_cases.py [--size full] [--only NAME ...] [--engine physx] [--jobs 2]

Hours at full size: a table that is there already is gone on with (remove it to begin anew), and what
``--only`` names is run anew. Rows are in the order of the scenes, whatever finishes first.

Columns: scene, engine (- where none takes part), expected, verdict (works, refused, fails), overlap (largest,
collision shapes, radii of the smaller grain), escaped (bodies), asleep (fraction), steps, wall_s (beside the
other jobs).
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
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
    options.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="runs at a time")
    given = options.parse_args()
    suffix = "" if given.size == "full" else "_reduced"
    given.out = given.out or Path(f"results/benchmarks/hard_cases{suffix}.csv")
    runs = [(s, engine) for s in hard_scenes.scenes(given.size) for engine in hard_scenes.engines(s)]
    order = {(scene["scene"], engine): n for n, (scene, engine) in enumerate(runs)}
    rows = {}
    if given.out.exists():
        known = io.read_table(given.out)
        rows = {(row["scene"], row["engine"]): row for row in known.to_dict("records")}

    def wanted(scene: str, engine: str) -> bool:
        if given.engine not in (None, engine):
            return False
        return scene in given.only if given.only else (scene, engine) not in rows

    with ProcessPoolExecutor(given.jobs) as pool:
        begun = [pool.submit(hard_scenes.run, s, engine) for s, engine in runs if wanted(s["scene"], engine)]
        for run in as_completed(begun):
            row = run.result()
            print(
                f"{row['scene']:32} {row['engine']:6} {row['expected']:8} {row['verdict']:8} "
                f"{_text(row['overlap'], '.4f')} {_text(row['escaped'], 'd')} {_text(row['asleep'], '.3f')} "
                f"{row['steps']:6d} {row['wall_s']:7.1f} s  {row['why']}",
                flush=True,
            )
            rows[row["scene"], row["engine"]] = row
            listed = sorted(rows, key=lambda of: order.get(of, len(order)))
            io.write_table(given.out, pd.DataFrame([rows[of] for of in listed], columns=hard_scenes.COLUMNS))
    unexpected = sum(row["verdict"] != row["expected"] for row in rows.values())
    print(f"{len(rows)} runs, {unexpected} not as expected")
    sys.exit(unexpected > 0)


def _text(value: float | None, form: str) -> str:
    return " " * 6 if value is None else f"{value:6{form}}"


if __name__ == "__main__":
    main()
