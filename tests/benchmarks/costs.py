"""What a twin costs, CPU time and memory of workflow runs of growing size: the table behind `grainfall new`.

    python tests/benchmarks/costs.py [--draft 4 8] [--standard 4 6] [--realizations 3] [--work FOLDER]
                                     [--out costs.csv]

One synthetic rock, each edge (mean grain diameters) with the packing settings of the draft and of the
standard preset. How often the second packing must be poured until its porosity fits, and how long beds take
to come to rest, differs from realization to realization. CPU seconds are summed over the benchmark files of
the jobs, so other work on the machine matters little. Jobs run one at a time. A killed run goes on, but
times of resumed jobs are too short.

Columns: preset, edge_grains, realization, grains (poured in the first packing), voxels, solid_fraction
(volume of the grains over that of the container), packing_cpu_s (both packings, all passes), other_cpu_s
(every other job of the twin), peak_rss_mb (of the largest job).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd
import yaml

from grainfall import config, io

HOUSE = Path(__file__).resolve().parents[2]
EDGES = {"draft": [4, 8], "standard": [4, 6]}
"""Of the committed table; larger ones are left to the fit."""
PACKINGS = ("first_packing", "second_packing")


def study(cases: list[tuple[str, int]], realizations: int) -> dict:
    """The config of the run: a variant for each preset and edge."""
    presets = config.load_yaml(HOUSE / "config/presets.yaml")
    variants = {}
    for preset, edge in cases:
        own = presets[preset] or {}
        scene = {**own.get("scene", {}), "edge_grains": edge, "voxels_per_grain": 16}
        variants[f"{preset}_{edge}"] = {"scene": scene, "packing": own.get("packing", {})}
    return {
        "samples": {"rock": {"kind": "synthetic", "pixel_size_um": 2.5}},
        "realizations": realizations,
        "variants": variants,
        "contacts": {"resettled": 0},
    }


def row(folder: Path, preset: str, edge: int, realization: int) -> dict:
    """What one twin cost."""
    twin = folder / f"results/rock/{preset}_{edge}/{realization}"
    scene = io.read_json(twin.parent / "scene.json")
    jobs = {f.stem: pd.read_csv(f, sep="\t").iloc[0] for f in sorted((twin / "benchmarks").glob("*.tsv"))}
    cpu = {name: float(job.cpu_time) for name, job in jobs.items()}
    bodies = io.read_table(twin / "first/bodies.csv")
    grains = int((bodies["kind"] == "grain").sum())
    side = scene["edge_um"] + 2 * scene["margin_um"]
    shares = pd.Series(scene["probabilities"])
    volume = float(shares @ pd.Series(scene["mean_volumes_um3"]))
    return {
        "preset": preset,
        "edge_grains": edge,
        "realization": realization,
        "grains": grains,
        "voxels": scene["shape_zyx"][0] ** 3,
        "solid_fraction": round(grains * volume / side**3, 4),
        "packing_cpu_s": round(sum(cpu[name] for name in PACKINGS), 1),
        "other_cpu_s": round(sum(cpu.values()) - sum(cpu[name] for name in PACKINGS), 1),
        "peak_rss_mb": round(max(float(job.max_rss) for job in jobs.values())),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    for preset, edges in EDGES.items():
        parser.add_argument(f"--{preset}", type=int, nargs="+", default=edges, help="edges, grain diameters")
    parser.add_argument("--realizations", type=int, default=3)
    parser.add_argument("--work", type=Path, help="folder of the run; a temporary one if omitted")
    parser.add_argument("--out", type=Path, default=HOUSE / "src/grainfall/cli/costs.csv")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.work or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        cases = [(preset, edge) for preset in EDGES for edge in getattr(options, preset)]
        (folder / "config.yaml").write_text(yaml.safe_dump(study(cases, options.realizations)))
        twins = [(*case, realization) for case in cases for realization in range(options.realizations)]
        wanted = [f"results/rock/{preset}_{edge}/{n}/metrics.csv" for preset, edge, n in twins]
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(HOUSE / "Snakefile")]
        command += ["--directory", str(folder), "--configfile", str(folder / "config.yaml")]
        subprocess.run([*command, "--cores", "1", "--rerun-incomplete", "--", *wanted], check=True)
        io.write_table(options.out, pd.DataFrame([row(folder, *twin) for twin in twins]))


if __name__ == "__main__":
    main()
