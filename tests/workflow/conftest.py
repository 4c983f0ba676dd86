"""Real snakemake runs on a tiny scene: small enough for a test, with every stage in it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]

TINY = {
    "title": "Tiny",
    "seed": 3,
    "preset": "draft",
    "samples": {"tiny": {"kind": "synthetic", "pixel_size_um": 2.0}},
    "realizations": 2,
    "synthetic": {
        "shape": [48, 200, 200],
        "reference_edge": 40,
        "solid_fraction": 0.58,
        "dissolved": 0.05,
        "minerals": [
            {"name": "quartz", "fraction": 0.6, "radius_um": 13.0, "cv": 0.15},
            {"name": "feldspar", "fraction": 0.4, "radius_um": 11.0, "cv": 0.15},
        ],
    },
    "grains": {"shapes_per_phase": 20},
    "scene": {"edge_um": 80.0, "margin_grains": 1.5, "porosity": 0.44},
    "correlation": {"slices": 7, "envelope_slices": 39},
}


def snakemake(folder, *arguments, config="config.yaml", snakefile=ROOT / "Snakefile", cores=2):
    """Run snakemake in ``folder`` as a user would; the finished process with its output in ``stdout``."""
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(snakefile), "--cores", str(cores)]
    return subprocess.run(
        [*command, "--configfile", config, *map(str, arguments)],
        cwd=folder,
        env={**os.environ, "COLUMNS": "200"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=900,
    )


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
    (folder / name).write_text(yaml.safe_dump(config))
    return folder


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """The folder of a finished tiny run on two cores."""
    folder = write_config(tmp_path_factory.mktemp("tiny"), TINY)
    done = snakemake(folder)
    assert done.returncode == 0, done.stdout[-6000:]
    return folder
