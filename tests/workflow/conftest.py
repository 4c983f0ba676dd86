"""Real snakemake runs on a tiny scene: small enough for a test, with every stage in it."""

import fcntl
import os
import shutil
from pathlib import Path

import forks
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]

TINY = yaml.safe_load((ROOT / "docs/tiny.yaml").read_text()) | {"reference_cubes": 2}
"""The study of the tutorial; cases judge its truth by two cubes."""


def snakemake(folder, *arguments, config="config.yaml", snakefile=ROOT / "Snakefile", cores=2):
    """Run snakemake in ``folder`` as a user would; the finished run with its output in ``stdout``."""
    command = ["--snakefile", snakefile, "--cores", cores, "--configfile", config, *arguments]
    environment = {**os.environ, "COLUMNS": "200"}
    return forks.snakemake(*map(str, command), folder=folder, environment=environment, timeout=900)


def planned(folder, *arguments, **options):
    """Rules that a dry run would run, with their numbers of jobs."""
    done = snakemake(folder, "--dry-run", "--quiet", "host", *arguments, **options)
    assert done.returncode == 0, done.stdout[-3000:]
    if "Nothing to be done" in done.stdout:
        return {}
    table = done.stdout.split("Job stats:")[1].split("total")[0]
    rows = [line.split() for line in table.splitlines()]
    return {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}


def write_config(folder, config, name="config.yaml"):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(yaml.safe_dump(config, sort_keys=False))
    return folder


@pytest.fixture(scope="session")
def finished(tmp_path_factory, request):
    """The folder of a finished tiny run on two cores; of several workers one runs it and each has a copy."""
    mine = tmp_path_factory.mktemp("tiny") / "run"
    ours = tmp_path_factory.getbasetemp()
    ours = ours.parent if hasattr(request.config, "workerinput") else ours
    with (ours / "finished.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (ours / "finished").exists():
            folder = write_config(ours / f"finishing-{os.getpid()}", TINY)
            done = snakemake(folder)
            assert done.returncode == 0, done.stdout[-6000:]
            folder.rename(ours / "finished")
    return shutil.copytree(ours / "finished", mine)
