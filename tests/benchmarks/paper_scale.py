"""Paper scale: a full run of growing regions, and how each rule's time and memory grow with them.

    python tests/benchmarks/paper_scale.py [--edges 125 250 488 1000] [--cores 2] [--work FOLDER] [--out CSV]

Every edge is a workflow run of its own, from the section to the report, with config/cases/paper_scale.yaml
and the region cut to so many voxels: the grains are as many voxels across at any edge. A killed run goes on;
times of resumed jobs are too short. Edges not asked for that lie finished in the folder are gathered too.

Columns of the table: rule, n (edge, voxels), wall_s, cpu_s, peak_rss_mb, from Snakemake's benchmark files;
``total`` is the sum of the jobs' times and the largest of their memories. Beside it ``*_growth.csv``: rule,
cpu_exponent and memory_exponent (of n, between the two largest edges), cpu_h and memory_gb at larger edges;
and ``*.svg``, the same drawn.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from grainfall import config, io
from grainfall.report import read_costs
from grainfall.report.figures import save_figure, styled

HOUSE = Path(__file__).resolve().parents[2]
STUDY = HOUSE / "config/cases/paper_scale.yaml"
LARGER = (2000, 4000)


def run(folder: Path, n: int, cores: int) -> None:
    """A full run of a region of n^3 voxels."""
    edge_um = n * config.load_yaml(STUDY)["scene"]["voxel_size_um"]
    own = folder / "config.yaml"
    io.write_text(own, yaml.safe_dump({"scene": {"edge_um": edge_um}}))
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(HOUSE / "Snakefile")]
    command += ["--directory", str(folder), "--configfile", str(STUDY), str(own)]
    subprocess.run([*command, "--cores", str(cores), "--rerun-incomplete", "--quiet", "host"], check=True)


def gather(folder: Path) -> pd.DataFrame:
    """What the jobs of every finished run in the folder took."""
    rows = []
    for page in folder.glob("*/results/report.html"):
        scene = next(page.parent.glob("*/*/scene.json"))
        costs = read_costs(sorted(page.parent.rglob("benchmarks/**/*.tsv")))
        costs["rule"] = costs["rule"].str.replace(r"^figure_.*", "figure", regex=True)
        costs = costs.groupby("rule", as_index=False).agg(
            wall_s=("wall_s", "sum"), cpu_s=("cpu_s", "sum"), peak_rss_mb=("peak_rss_mb", "max")
        )
        total = {
            "rule": "total",
            **costs[["wall_s", "cpu_s"]].sum(),
            "peak_rss_mb": costs["peak_rss_mb"].max(),
        }
        costs = pd.concat([costs, pd.DataFrame([total])], ignore_index=True)
        costs.insert(1, "n", io.read_json(scene)["shape_zyx"][0])
        rows.append(costs)
    table = pd.concat(rows, ignore_index=True)
    return table.sort_values(["rule", "n"], key=lambda c: c.replace("total", "~"), ignore_index=True)


def growth(table: pd.DataFrame) -> pd.DataFrame:
    """Exponents between the two largest edges, and what they say of larger ones."""
    small, large = sorted(set(table["n"]))[-2:]
    found = []
    for rule, rows in table[table["rule"] != "total"].groupby("rule"):
        rows = rows.set_index("n")
        if not {small, large} <= set(rows.index):
            continue
        row = {"rule": rule, "n_small": small, "n_large": large}
        for name, column, unit, per in (
            ("cpu", "cpu_s", "cpu_h", 3600),
            ("memory", "peak_rss_mb", "memory_gb", 1e3),
        ):
            ends = (small, rows.loc[small, column]), (large, rows.loc[large, column])
            row[f"{name}_exponent"] = np.log(ends[1][1] / ends[0][1]) / np.log(large / small)
            for n in LARGER:
                row[f"{unit}_{n}"] = carried_on(*ends, n) / per
        found.append(row)
    found = pd.DataFrame(found)
    total = {"rule": "total", "n_small": small, "n_large": large}
    total |= {c: found[c].sum() if c.startswith("cpu_h") else found[c].max() for c in found if c[-1] == "0"}
    return pd.concat([found, pd.DataFrame([total])], ignore_index=True)


def carried_on(one: tuple[float, float], other: tuple[float, float], n: float) -> float:
    """A figure measured at two edges, carried on to a third.

    Slower growth than that of the voxels is a start-up and a share for each of them, faster growth a power.
    """
    (m, y), (k, z) = one, other
    exponent = np.log(z / y) / np.log(k / m)
    if exponent > 3:
        return z * (n / k) ** exponent
    return z + max(0.0, z - y) / (k**3 - m**3) * (n**3 - k**3)


@styled
def draw(table: pd.DataFrame, shown: int = 9) -> Figure:
    """Time and memory against the edge, both logarithmic, of the rules that take most.

    The exponents are those between the two largest edges, as in the table.
    """
    figure = Figure(figsize=(7.5, 4.8))
    last = table[table["n"] == table["n"].max()]
    panels = zip(figure.subplots(1, 2), (("cpu_s", "CPU s"), ("peak_rss_mb", "MB")), strict=True)
    marks = "osD^v<>Ph"
    for axes, (column, label) in panels:
        most = last[last["rule"] != "total"].nlargest(shown, column)["rule"]
        for mark, rule in zip(marks, most, strict=False):
            rows = table[table["rule"] == rule]
            ends = rows.nlargest(2, "n")
            slope = np.divide(*(np.log(ends[c]).diff().iloc[-1] for c in (column, "n")))
            axes.loglog(rows["n"], rows[column], marker=mark, ms=4, label=f"{rule}, n^{slope:.1f}")
        axes.set(xlabel="edge n, voxels", ylabel=label)
        axes.set_xticks(sorted(table["n"].unique()), sorted(table["n"].unique()))
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5), numticks=10))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
        axes.legend(fontsize=7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.16))
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--edges", type=int, nargs="+", default=[125, 250, 488, 1000])
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--work", type=Path, default=HOUSE / "results/benchmarks/paper_scale")
    parser.add_argument("--out", type=Path, default=HOUSE / "results/benchmarks/paper_scale.csv")
    options = parser.parse_args()
    for n in options.edges:
        run(options.work / str(n), n, options.cores)
        table = gather(options.work)
        io.write_table(options.out, table.round({"wall_s": 2, "cpu_s": 2, "peak_rss_mb": 0}))
        save_figure(draw(table), options.out.with_suffix(".svg"))
        if len(set(table["n"])) > 1:
            io.write_table(options.out.with_name(f"{options.out.stem}_growth.csv"), growth(table).round(3))


if __name__ == "__main__":
    main()
