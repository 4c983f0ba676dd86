"""What a job costs beside its work: planning, scheduling, and the start of its script, in CPU seconds.

    python tests/benchmarks/job_overhead.py [--planned 1000] [--run 100] [--only slurm] [--work FOLDER]

The sweep of config/cases/sweep.yaml with as many rows as asked for. Whatever is once for all (the start of
Snakemake, what all rows share) is taken out by a run with fewer rows. CPU seconds are those of Snakemake and
of all it started, so other work on the machine matters little.

Columns: what, jobs, cpu_s, cpu_s_a_job. `plan`: a dry run of whole twins, one a row. `run`: the cheapest jobs
(rule scene, which lays out a region), from planning to the last written file; as the job's own work takes a
few milliseconds, this is the overhead. `slurm, alone` and `slurm, in a group`: the same jobs as
workflow/profiles/slurm submits them, one alone and as many as travel together, from start to end of the
script that Slurm would run; its commands are stood in for (SLURM). `slurm, bare Snakemake`: one alone of a
Snakefile with nothing but a rule that touches a file: what of `slurm, alone` is Snakemake's own.
`start of NAME`: imports of a rule's script alone.
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
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pandas as pd
import yaml

from grainfall import config, io

HOUSE = Path(__file__).resolve().parents[2]
FEW = 5
"""Rows of the runs that are taken off."""

SBATCH = """\
import os, resource, subprocess, sys
from pathlib import Path
log = Path(__file__).with_name("spent")
number = len(log.read_text().splitlines()) + 1 if log.exists() else 1
job = next(word.partition("=")[2] for word in sys.argv if word.startswith("--wrap="))
own = {**os.environ, "SLURM_JOB_ID": str(number)}
done = subprocess.run(job, shell=True, env=own, stdin=subprocess.DEVNULL, stdout=sys.stderr)
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
state = "FAILED" if done.returncode else "COMPLETED"
with log.open("a") as file:
    print(number, state, usage.ru_utime + usage.ru_stime, sep="|", file=file)
print(number)
"""
SLURM = {
    "sbatch": "#!{python}\n" + SBATCH,
    "srun": '#!/bin/sh\nwhile case "$1" in -*) ;; *) false ;; esac; do shift; done; exec "$@"\n',
    "squeue": '#!/bin/sh\ncut -d "|" -f 1,2 "$(dirname "$0")/spent"\n',
    "scontrol": "#!/bin/sh\necho MinJobAge = 300 sec\n",
    "sinfo": "#!/bin/sh\necho 'all*'\n",
    "sacct": "#!/bin/sh\nexit 1\n",
}
"""Stands in for Slurm: a job runs when it is submitted, and what it spent is written down."""

BARE = """\
rule scene:
    output: "results/tiny/{variant}/scene.json"
    shell: "touch {output}"


if workflow.remote_exec:
    workflow.localrules("scene")
"""


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
    for left in (folder / "results").glob("*/v[0-9]*"):
        shutil.rmtree(left)
    targets = [f"results/tiny/v{n:05d}/scene.json" for n in range(rows)]
    return rows, snakemake(folder, "--quiet", "all", "--", *targets)[0]


def on_slurm(folder: Path, rows: int, snakefile: Path = HOUSE / "Snakefile") -> tuple[int, float]:
    """Jobs and CPU seconds of a run of the rule scene alone, all rows in one job of Slurm."""
    write_sweep(folder, rows)
    for left in (folder / "results").glob("*/v[0-9]*"):
        shutil.rmtree(left)
    commands = folder / "commands"
    shutil.rmtree(commands, ignore_errors=True)
    commands.mkdir()
    for name, text in SLURM.items():
        (commands / name).write_text(text.replace("{python}", sys.executable))
        (commands / name).chmod(0o755)
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(snakefile), "--quiet", "all"]
    command += ["--profile", str(HOUSE / "workflow/profiles/slurm"), "--configfile", "config.yaml"]
    command += ["--slurm-status-command", "squeue", "--slurm-init-seconds-before-status-checks", "2"]
    command += ["--slurm-no-account", "--retries", "0", "--latency-wait", "5"]
    command += ["--group-components", f"scene={rows}", "--"]
    targets = [f"results/tiny/v{n:05d}/scene.json" for n in range(rows)]
    cpu_s([*command, *targets], folder, PATH=f"{commands}{os.pathsep}{os.environ['PATH']}")
    (job,) = (commands / "spent").read_text().splitlines()
    return rows, float(job.rpartition("|")[2])


def start(script: Path, folder: Path) -> float:
    """CPU seconds of a script's imports."""
    body = ast.parse(script.read_text()).body
    lines = [ast.unparse(node) for node in body if isinstance(node, ast.Import | ast.ImportFrom)]
    path = os.pathsep.join(str(HOUSE / part) for part in ("src", "scripts"))
    return cpu_s([sys.executable, "-c", "\n".join(lines)], folder, PYTHONPATH=path)[0]


def median(what: str, measured: Callable[[], tuple[int, float]], repeats: int = 5) -> dict:
    """A row of the table: the median of some repeats."""
    jobs, spent = sorted(measured() for _ in range(repeats))[repeats // 2]
    return {"what": what, "jobs": jobs, "cpu_s": spent, "cpu_s_a_job": spent / jobs}


def measure(folder: Path, planned: int, ran: int, only: str = "") -> pd.DataFrame:
    """All rows of the table, or those whose name begins with ``only``."""
    study = config.load_yaml(HOUSE / "config/cases/sweep.yaml")
    (folder / "config.yaml").write_text(yaml.safe_dump({**study, "sweep": "sweep.tsv"}))
    found = []
    run(folder, 1)  # what all rows share is made once, and numba compiles
    for what, of, most in (("plan", plan, planned), ("run", run, ran)):
        if not what.startswith(only):
            continue
        (few, base), (many, whole) = of(folder, FEW), of(folder, most)
        jobs, spent = many - few, whole - base
        found.append({"what": what, "jobs": jobs, "cpu_s": spent, "cpu_s_a_job": spent / jobs})
    if "slurm".startswith(only):
        bare = folder / "bare"
        bare.mkdir(exist_ok=True)
        (bare / "Snakefile").write_text(BARE)
        shutil.copy(folder / "config.yaml", bare)
        together = config.load_yaml(HOUSE / "workflow/profiles/slurm/config.yaml")["group-components"][
            "scene"
        ]
        found.append(median("slurm, alone", partial(on_slurm, folder, 1)))
        found.append(median("slurm, in a group", partial(on_slurm, folder, together), repeats=1))
        found.append(median("slurm, bare Snakemake", partial(on_slurm, bare, 1, bare / "Snakefile")))
    for script in sorted((HOUSE / "scripts").glob("[!_]*.py")):
        if f"start of {script.stem}".startswith(only):
            spent = start(script, folder)
            found.append({"what": f"start of {script.stem}", "jobs": 1, "cpu_s": spent, "cpu_s_a_job": spent})
    return pd.DataFrame(found).round({"cpu_s": 2, "cpu_s_a_job": 4})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--planned", type=int, default=1000, help="rows planned, a whole twin each")
    parser.add_argument("--run", type=int, default=100, help="rows of which the cheapest job is run")
    parser.add_argument("--only", default="", help="rows of the table that begin so: plan, run, slurm, start")
    parser.add_argument("--work", type=Path, help="folder of the runs; a temporary one if omitted")
    parser.add_argument("--out", type=Path, default=HOUSE / "results/benchmarks/job_overhead.csv")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.work or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        table = measure(folder, options.planned, options.run, options.only)
    io.write_table(options.out, table)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
