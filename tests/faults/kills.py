"""Kill -9 at random moments, then a plain rerun: nothing may be lost, left over or different.

``python tests/faults/kills.py --out results/benchmarks/faults.csv`` kills the whole process group in two of
three runs of a small scene and a single worker in the third, and writes a row a kill; it goes on where it was
stopped.
"""

import argparse
import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import yaml
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/workflow"))

from outputs import outputs

SCENE = {
    "seed": 5,
    "preset": "draft",
    "samples": {"s": {"kind": "binary", "image": "section.png", "pixel_size_um": 2.0}},
    "realizations": 1,
    "stereology": {"bootstrap": 5},
    "grains": {"shapes_per_phase": 6},
    # to cut shapes of voids would take four fifths of a run: most kills would meet nothing else
    "effects": {"void_shapes": "off"},
    "scene": {"edge_um": 59.0, "margin_grains": 0.5, "porosity": 0.44},
    # a checkpoint every few steps: a killed packing goes on in the middle
    "packing": {"overrides": {"checkpoint_steps": 100}},
    "correlation": {"slices": 4, "envelope_slices": 19, "chunks": 1},
    "contacts": {"resettled": 0},
    "flow": {"methods": ["estimate"]},
}
LEGS = "results/s/full/0/first/bodies.csv", "results/s/full/0/twin.zarr.zip", "results/summary.csv"
"""Targets that one folder is brought to, one after the other."""


def section():
    """Discs of two sizes, most of them touching, as a binary image."""
    rng, edge = np.random.default_rng(3), 160
    image, y = np.zeros((edge, edge), np.uint8), np.arange(edge)
    for centre in rng.uniform(0, edge, (260, 2)):
        radius = rng.choice([4.0, 5.5])
        disc = (y[:, None] - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2
        grown = (y[:, None] - centre[0]) ** 2 + (y - centre[1]) ** 2 < (radius + 1) ** 2
        if not image[grown].any():
            image[disc] = 255
    return image


def prepare(folder, config=SCENE):
    """A user's folder: config and image."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    Image.fromarray(section()).save(folder / "section.png")
    return folder


def start(folder, target=LEGS[-1], *arguments, cores=2):
    """Snakemake as a user starts it, in a process group of its own, its words in ``said.log``."""
    command = [
        sys.executable,
        "-m",
        "snakemake",
        "--snakefile",
        str(ROOT / "Snakefile"),
        "--cores",
        str(cores),
    ]
    with (folder / "said.log").open("w") as said:
        return subprocess.Popen(
            [*command, "--configfile", "config.yaml", *arguments, "--", target],
            cwd=folder,
            stdout=said,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def run(folder, target=LEGS[-1], *arguments, cores=2):
    """Run to the end; exit status and what was said."""
    status = start(folder, target, *arguments, cores=cores).wait(timeout=600)
    return status, (folder / "said.log").read_text()


def children(pid):
    """Ids of the processes that a process started and that still run."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return [child.pid for child in psutil.Process(pid).children()]
    return []


def kill(process, whom):
    """Kill -9 the whole process ``group``, the ``main`` process or one ``worker``.

    The workers that outlive it; None where there was nothing left to kill.
    """
    workers = children(process.pid)
    if process.poll() is not None or (whom == "worker" and not workers):
        return None
    if whom == "group":
        os.killpg(process.pid, signal.SIGKILL)
    else:
        os.kill(workers[0] if whom == "worker" else process.pid, signal.SIGKILL)
    process.wait(timeout=600)
    deadline = time.monotonic() + 10
    while whom != "worker" and any(alive(pid) for pid in workers) and time.monotonic() < deadline:
        time.sleep(0.05)
    return [pid for pid in workers if alive(pid)]


def alive(pid):
    """Whether a process runs, and is not merely waiting to be buried."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def litter(folder):
    """What a clean folder does not have: temporary files, checkpoints, locks, backups."""
    results, inside = folder / "results", folder / ".snakemake"
    hidden = [path for path in results.rglob("*") if "/." in f"/{path.relative_to(results).as_posix()}"]
    parts = [path for path in hidden if path.name != ".snakemake_timestamp"]
    kept = [path for name in ("locks", "backup", "incomplete") for path in (inside / name).rglob("*")]
    return sorted(str(path.relative_to(folder)) for path in [*parts, *kept] if not path.is_dir())


def study(numbers, seed, work, say=print):
    """A row for each of these kills: what was killed, when, and what a plain rerun made of it.

    Runs take turns: one from nothing to the first packing, one that goes on to the twin, one to the summary.
    """
    clean, whole_s, wanted = prepare(work / "clean"), [], []
    for leg, target in enumerate(LEGS):
        shutil.copytree(clean, work / f"before{leg}", symlinks=True)
        began = time.monotonic()
        status, said = run(clean, target)
        if status:
            raise SystemExit(said[-3000:])
        whole_s.append(time.monotonic() - began)
        wanted.append(outputs(clean))
    say("undisturbed: " + ", ".join(f"{s:.1f} s" for s in whole_s))
    for number in numbers:
        whom, outlived = "worker" if number % 3 == 2 else "group", None
        leg = number // 3 % len(LEGS)
        while outlived is None:
            folder = shutil.copytree(work / f"before{leg}", work / f"{number}", symlinks=True)
            moment = random.Random(seed + number).uniform(0, whole_s[leg])
            began, process = time.monotonic(), start(folder, LEGS[leg])
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=moment)
            while whom == "worker" and process.poll() is None and not children(process.pid):
                time.sleep(0.01)
            outlived = kill(process, whom)
            process.wait(timeout=600)
            if outlived is None:  # it had ended: runs are shorter by now (the first one compiles)
                whole_s[leg] = time.monotonic() - began
                shutil.rmtree(folder)
        done = sum(1 for path in (folder / "results").rglob("*") if path.is_file())
        left = len(litter(folder))
        began = time.monotonic()
        status, said = run(folder, LEGS[leg])
        found = outputs(folder) if status == 0 else {}
        names = wanted[leg].keys() | found.keys()
        different = [name for name in names if wanted[leg].get(name) != found.get(name)]
        row = {
            "kill": number,
            "target": LEGS[leg],
            "run_s": round(whole_s[leg], 1),
            "killed": whom,
            "outlived": len(outlived),
            "at_s": round(moment, 2),
            "files_then": done,
            "litter_then": left,
            "rerun_status": status,
            "rerun_s": round(time.monotonic() - began, 1),
            "different": len(different),
            "litter_after": len(litter(folder)),
        }
        say(", ".join(f"{key} {value}" for key, value in row.items()))
        if not faulty(row):
            shutil.rmtree(folder)
        yield row


def faulty(row):
    """Whether a kill left anything that a plain rerun did not mend."""
    return any(row[name] for name in ("outlived", "rerun_status", "different", "litter_after"))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    rows = pd.read_csv(given.out).to_dict("records") if given.out.exists() else []
    with tempfile.TemporaryDirectory(prefix="grainfall-kills-") as work:
        for row in study(range(len(rows), given.kills), given.seed, Path(work)):
            rows.append(row)
            pd.DataFrame(rows).to_csv(given.out, index=False)
        bad = [row for row in rows if faulty(row)]
    print(f"{len(rows)} kills, {len(bad)} not mended by a plain rerun")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
