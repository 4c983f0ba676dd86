"""What a job costs beside its work: planning, scheduling, and the start of its script, in CPU seconds.

    python tests/benchmarks/job_overhead.py [--planned 1000] [--run 100] [--work FOLDER] [--out CSV]

The sweep of config/cases/sweep.yaml with as many rows as asked for. Whatever is once for all (the start of
Snakemake, what all rows share) is taken out by a run with fewer rows. CPU seconds are those of Snakemake and
of all it started, so other work on the machine matters little.

Columns: what, jobs, cpu_s, cpu_s_a_job. `plan`: a dry run of whole twins, one a row. `run`: the cheapest jobs
(rule scene, which lays out a region), from planning to the last written file; as the job's own work takes a
few milliseconds, this is the overhead. `start of NAME`: imports of a rule's script alone.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd
import yaml

from grainfall import config, io

HOUSE = Path(__file__).resolve().parents[2]
FEW = 5
"""Rows of the runs that are taken off."""


def cpu_s(command: list[str], folder: Path, **variables: str) -> tuple[float, str]:
    """CPU seconds of a command and of all that it started and waited for; what it said."""

    def spent() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    before = spent()
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", **variables},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise SystemExit((done.stdout + done.stderr)[-3000:])
    return spent() - before, done.stdout + done.stderr


def write_sweep(folder: Path, rows: int) -> None:
    """A table of so many rows, all of them different."""
    table = pd.DataFrame({"variant": [f"v{n:05d}" for n in range(rows)]})
    table["packing.overrides.friction_static"] = 0.1 + table.index / (2 * rows)
    table.to_csv(folder / "sweep.tsv", sep="\t", index=False)


def snakemake(folder: Path, *arguments: str) -> tuple[float, str]:
    """CPU seconds of a Snakemake run, and what it said."""
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(HOUSE / "Snakefile"), "--cores", "1"]
    return cpu_s([*command, "--configfile", "config.yaml", *arguments], folder)


def plan(folder: Path, rows: int) -> tuple[int, float]:
    """Jobs and CPU seconds of a dry run."""
    write_sweep(folder, rows)
    spent, said = snakemake(folder, "--dry-run", "--quiet", "rules", "reason", "--", "results/sweep.csv")
    return int(re.search(r"^total +(\d+)", said, re.MULTILINE).group(1)), spent


def run(folder: Path, rows: int) -> tuple[int, float]:
    """Jobs and CPU seconds of a run of the rule scene alone."""
    write_sweep(folder, rows)
    for left in (folder / "results").glob("*/v*"):
        shutil.rmtree(left)
    targets = [f"results/tiny/v{n:05d}/scene.json" for n in range(rows)]
    return rows, snakemake(folder, "--quiet", "all", "--", *targets)[0]


def start(script: Path, folder: Path) -> float:
    """CPU seconds of a script's imports."""
    body = ast.parse(script.read_text()).body
    lines = [ast.unparse(node) for node in body if isinstance(node, ast.Import | ast.ImportFrom)]
    path = os.pathsep.join(str(HOUSE / part) for part in ("src", "scripts"))
    return cpu_s([sys.executable, "-c", "\n".join(lines)], folder, PYTHONPATH=path)[0]


def measure(folder: Path, planned: int, ran: int) -> pd.DataFrame:
    """All rows of the table."""
    study = config.load_yaml(HOUSE / "config/cases/sweep.yaml")
    (folder / "config.yaml").write_text(yaml.safe_dump({**study, "sweep": "sweep.tsv"}))
    found = []
    run(folder, 1)  # what all rows share is made once, and numba compiles
    for what, of, most in (("plan", plan, planned), ("run", run, ran)):
        (few, base), (many, whole) = of(folder, FEW), of(folder, most)
        jobs, spent = many - few, whole - base
        found.append({"what": what, "jobs": jobs, "cpu_s": spent, "cpu_s_a_job": spent / jobs})
    for script in sorted((HOUSE / "scripts").glob("[!_]*.py")):
        spent = start(script, folder)
        found.append({"what": f"start of {script.stem}", "jobs": 1, "cpu_s": spent, "cpu_s_a_job": spent})
    return pd.DataFrame(found).round({"cpu_s": 2, "cpu_s_a_job": 4})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--planned", type=int, default=1000, help="rows planned, a whole twin each")
    parser.add_argument("--run", type=int, default=100, help="rows of which the cheapest job is run")
    parser.add_argument("--work", type=Path, help="folder of the runs; a temporary one if omitted")
    parser.add_argument("--out", type=Path, default=HOUSE / "results/benchmarks/job_overhead.csv")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.work or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        table = measure(folder, options.planned, options.run)
    io.write_table(options.out, table)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
