"""Whether this machine has what a study needs: each finding is measured, nothing is assumed."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import psutil

from grainfall.cli.costs import Costs
from grainfall.cli.study import house
from grainfall.errors import InputError

GROUPS = ("packing", "analysis", "report", "workflow", "cli")
"""Extras of pyproject.toml that studies use; the others are for those who work on the package."""
FALL_STEPS = 20


@dataclass(frozen=True)
class Finding:
    """One line of the examination.

    Attributes
    ----------
    what, found : str
    ok : bool or None
        None where nothing depends on it.
    """

    what: str
    found: str
    ok: bool | None


def examine(folder: str | Path = ".") -> Iterator[Finding]:
    """Look at the environment, the engines, the machine and the folder that results would go to."""
    yield Finding(
        "Python", f"{platform.python_version()} at {sys.executable}", sys.version_info[:2] == (3, 11)
    )
    yield _workflow()
    yield from _packages()
    for name in ("physx", "bullet"):
        yield _engine(name)
    cores = (
        len(psutil.Process().cpu_affinity()) if hasattr(psutil.Process, "cpu_affinity") else os.cpu_count()
    )
    yield Finding("cores", f"{cores} for this process, {psutil.cpu_count()} in the machine", None)
    yield _memory()
    free = shutil.disk_usage(folder).free / 2**30
    writable = os.access(folder, os.W_OK)
    yield Finding(
        "disk", f"{free:.1f} GB free, {'writable' if writable else 'not writable'}", writable and free > 1
    )
    yield _gpu()


def _workflow() -> Finding:
    try:
        return Finding("workflow", str(house()), True)
    except InputError as fault:
        return Finding("workflow", f"{fault.wrong}; {fault.right}", False)


def _packages() -> Iterator[Finding]:
    """Each group of packages: those that are missing, and those of another version than the lock's."""
    try:
        project = tomllib.loads((house() / "pyproject.toml").read_text())["project"]
        lock = dict(line.split("==") for line in (house() / "requirements.lock").read_text().split())
    except InputError:
        return
    groups = {"core": project["dependencies"]} | {g: project["optional-dependencies"][g] for g in GROUPS}
    for group, wanted in groups.items():
        names = [re.match(r"[A-Za-z0-9_.-]+", line).group() for line in wanted]
        found = {name: _version(name) for name in names}
        missing = [name for name, version in found.items() if version is None]
        other = [f"{n} {v} (lock: {lock[n]})" for n, v in found.items() if v and v != lock.get(n, v)]
        words = [f"missing: {', '.join(missing)}"] if missing else []
        words += [f"other versions: {', '.join(other)}"] if other else []
        yield Finding(f"packages: {group}", "; ".join(words) or f"all {len(names)} as locked", not missing)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def fall(name: str) -> str:
    """Let a sphere fall a little in an engine; the engine's version."""
    import numpy as np

    from grainfall.packing import Parameters
    from grainfall.packing.engine import Solid, start

    engine = start(Parameters.named(engine=name), 10.0, 10.0)
    engine.add(Solid((), 1.0, 1.0, np.full(3, 0.4)), np.full(3, 5.0), np.array([1.0, 0, 0, 0]))
    engine.step(FALL_STEPS)
    height, version = float(engine.state().position[0, 2]), engine.version
    engine.close()
    if not height < 5.0:
        raise InputError(version, "a sphere does not fall", "install the engine anew")
    return version


def _engine(name: str) -> Finding:
    """Engines are binary libraries: in a process of their own they can neither crash nor chat here."""
    code = f"from grainfall.cli.doctor import fall; print(fall({name!r}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    said = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    words = said[-1] if said else f"ended with status {done.returncode}"
    found = f"{words}: a sphere falls" if done.returncode == 0 else words
    return Finding(f"engine {name}", found, done.returncode == 0)


def memory_limit() -> int:
    """Bytes that this process may use: the machine's, or what its container is given of them."""
    limits = [psutil.virtual_memory().total]
    for file in ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"):
        text = Path(file).read_text().strip() if Path(file).is_file() else ""
        limits += [int(text)] if text.isdigit() else []
    return min(limits)


def _memory() -> Finding:
    total, free = memory_limit() / 2**30, psutil.virtual_memory().available / 2**30
    needed = Costs.measured().table["peak_rss_mb"].max() / 1024
    words = f"{total:.1f} GB, {free:.1f} GB of it free; the largest job measured took {needed:.1f} GB"
    return Finding("memory", words, total > needed)


def _gpu() -> Finding:
    """Graphics cards are named, not needed."""
    unused = "no step of a study uses one"
    try:
        asked = ["nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader"]
        done = subprocess.run(asked, capture_output=True, text=True, timeout=20)
    except (OSError, subprocess.TimeoutExpired):
        return Finding("GPU", f"none found; {unused}", None)
    names = "; ".join(done.stdout.split("\n")).strip("; ")
    return Finding("GPU", f"{names if done.returncode == 0 and names else 'none found'}; {unused}", None)
