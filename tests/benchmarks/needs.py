"""What jobs need of a machine: the table that the workflow asks by; what it asks for beside what was used.

    python tests/benchmarks/needs.py FOLDER... [--out src/grainfall/cli/needs.csv]
    python tests/benchmarks/needs.py FOLDER... --check

Each folder is that of a finished run (it has `results` in it), the more different in size, the better; jobs
of the same size count once, by the hungriest. Runs in which numba had to compile need more than others. With
--check no table is written: the memory of every rule's hungriest job at a size over what the committed table
asks for (`used`), and over what it would ask for had no job of that size been measured, where there were
smaller and larger ones (`unseen`); status 1 where `used` is below 0.5 or above 0.95.

Columns of the table: rule, per (Mvoxel or kgrain), size, mb, s: memory and CPU seconds of a job of that size.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from grainfall import io
from grainfall.cli import needs

HOUSE = Path(__file__).resolve().parents[2]
BOUNDS = (0.5, 0.95)
GRAINS = ("first_packing", "second_packing", "contacts", "resettling")
VOXELS = (
    *("packed_volume", "deficit", "twin", "measure_slices", "section_as_resolved", "s2_chunk", "s2_slices"),
    *("s2_volume", "s2_envelope", "network", "flow", "plan", "metrics", "figure", "scene"),
    *("synthesise", "morphology", "unfold_sizes", "grain_library"),
    *("reference_network", "reference_flow", "reference_s2"),
)
PER = dict.fromkeys(VOXELS, "Mvoxel") | dict.fromkeys(GRAINS, "kgrain")
"""Rules whose jobs differ in size, and what they grow with."""


def rule_of(stem: str) -> str:
    """The rule whose job left a benchmark file of this name."""
    for pattern, rule in (
        (r"(first|second)_volume", "packed_volume"),
        (r"s2_slices_\d+-of-\d+", "s2_chunk"),
        (r"figure_.*", "figure"),
    ):
        stem = rule if re.fullmatch(pattern, stem) else stem
    return stem


def coarsened(folder: Path) -> int:
    """Voxels along an axis that became one for the network of a twin or a reference, by the job's record."""
    for record in (folder / "logs/network.json", folder / "logs/reference_network.json"):
        if record.exists():
            return io.read_json(record)["parameters"]["settings"]["network"].get("coarsen", 1)
    return 1


def jobs_of(folder: Path) -> pd.DataFrame:
    """Every job of a finished run: run, rule, its size in each unit, peak_rss_mb, cpu_s, wall_s."""
    rows = []
    for file in sorted((folder / "results").glob("*/**/benchmarks/*.tsv")):
        place = file.relative_to(folder / "results").parts
        sample, rule = folder / "results" / place[0], rule_of(file.stem)
        if rule not in PER:
            continue
        if rule != "s2_slices" and any(file.parent.glob(f"{file.stem}_*-of-*.tsv")):
            continue  # slabs did the work
        measured = pd.read_csv(file, sep="\t", na_values=["-"]).iloc[0]
        variant = place[1] if len(place) > 3 else None
        if rule == "synthesise":
            size = needs.of_shape(
                io.read_json(sample / "logs/synthesise.json")["parameters"]["rock"]["shape"]
            )
        else:
            size = needs.size_of(rule, sample, variant, coarsened(file.parents[1]))
        used = {"peak_rss_mb": measured["max_rss"], "cpu_s": measured["cpu_time"], "wall_s": measured["s"]}
        rows.append({"run": str(folder), "rule": rule, **dict.fromkeys(needs.PER), **size, **used})
    return pd.DataFrame(rows).astype(dict.fromkeys(needs.PER, float))


def compare(jobs: pd.DataFrame, asking: needs.Needs) -> pd.DataFrame:
    """The hungriest job of each rule and size: what it used, what is asked for, and the share of it."""
    rows = []
    for rule, per in PER.items():
        for size, same in jobs[jobs["rule"] == rule].groupby(per):
            need = asking.job(rule, {per: size})
            peak = same["peak_rss_mb"].max()
            row = {"rule": rule, "per": per, "size": size, "peak_rss_mb": peak, "asked_mb": need.mem_mb}
            wall = {"wall_min": same["wall_s"].max() / 60, "asked_min": need.runtime_min}
            shares = {"used": peak / need.mem_mb, "unseen": peak / _unseen(asking, rule, per, size)}
            rows.append(row | shares | wall)
    return pd.DataFrame(rows)


def _unseen(asking: needs.Needs, rule: str, per: str, size: float) -> float:
    """MB asked for with the rows of this size taken out; NaN at the ends, and where there are none."""
    table = asking.table.reset_index()
    own = (table["rule"] == rule) & np.isclose(table["size"], size, rtol=1e-3)
    others = table.loc[~own & (table["rule"] == rule), "size"]
    if not own.any() or others.empty or not others.min() < size < others.max():
        return np.nan
    return needs.Needs(table[~own]).job(rule, {per: size}).mem_mb


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+", help="of finished runs")
    parser.add_argument("--check", action="store_true", help="compare with the committed table")
    parser.add_argument("--out", type=Path, default=HOUSE / "src/grainfall/cli/needs.csv")
    options = parser.parse_args()
    jobs = pd.concat(map(jobs_of, options.folders), ignore_index=True)
    if not options.check:
        io.write_table(options.out, needs.hungriest(jobs, PER))
        return 0
    found = compare(jobs, needs.Needs.measured())
    print(found.round(3).to_string(index=False))
    missed = found[~found["used"].between(*BOUNDS)]
    between = found["unseen"].dropna()
    print(
        f"{between.between(*BOUNDS).sum()} of {len(between)} sizes between others would hold unmeasured, too"
    )
    late = found[found["wall_min"] > found["asked_min"]]
    outside = f"{len(missed)} use another share of the memory than {BOUNDS}"
    print(f"{len(found)} rules and sizes: {outside}, {len(late)} took longer than asked for")
    return 1 if len(missed) or len(late) else 0


if __name__ == "__main__":
    sys.exit(main())
