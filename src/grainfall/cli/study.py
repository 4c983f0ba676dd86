"""A study is a folder with a config; its results lie in it. The workflow itself lies in the checkout."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import grainfall
from grainfall import config as sheet
from grainfall.errors import InputError

CONFIGS = ("config.yaml", "config/config.yaml")
"""Where a study's config may lie in its folder: its own, or that of a checkout."""
STEPS = re.compile(r"^(\d+) of (\d+) steps")
RULE = re.compile(r"^(?:local)?rule (\w+):")
FAULT = re.compile(r"^\w+(?:Error|Exception)(?: in .*)?:$")
"""Snakemake's heading of a fault of its own; what it was is on the next line."""

DIED = re.compile(r"\.(\w+)\.py' died with <Signals\.(\w+):")
"""A job that nobody heard of again: rule and signal."""


def house() -> Path:
    """The checkout that holds the workflow: the one that this package was installed from, in editable mode.

    Raises
    ------
    InputError
        When the package lies elsewhere: the workflow's rules and schemas are not part of it.
    """
    folder = Path(grainfall.__file__).resolve().parents[2]
    if not (folder / "Snakefile").is_file():
        raise InputError(
            grainfall.__file__,
            "this copy of grainfall comes without its workflow",
            "clone the repository and install it from there: pip install -e .",
        )
    return folder


@dataclass(frozen=True)
class Study:
    """A folder, its config as a run uses it, and the config's samples.

    Attributes
    ----------
    folder : Path
        Absolute; paths in the config start here.
    file : Path
        The config.
    config : dict
        Every key present.
    samples : dict
        Sample name to its values.
    """

    folder: Path
    file: Path
    config: dict
    samples: dict[str, dict]

    @property
    def results(self) -> Path:
        """Where everything that was computed lies."""
        return self.folder / "results"

    @property
    def twins(self) -> list[tuple[str, str, int]]:
        """Sample, variant and realization of every twin."""
        numbers = range(self.config["realizations"])
        return [(s, v, n) for s in self.samples for v in self.config["variants"] for n in numbers]

    @property
    def locked(self) -> bool:
        """Whether a run is going on, or one was killed and has left its lock."""
        locks = self.folder / ".snakemake/locks"
        return locks.is_dir() and any(locks.iterdir())


def open_study(folder: str | Path, *, files: bool = True) -> Study:
    """Read the config of a study; whether the files that its samples name are there matters to runs only.

    Raises
    ------
    InputError
        When there is no config, or at the first fault in it: before any job runs.
    """
    folder = Path(folder).resolve()
    if folder.is_file() and folder.name in CONFIGS:
        folder = folder.parent  # its config was named
    configs = [folder / name for name in CONFIGS if (folder / name).is_file()]
    if not configs:
        raise InputError(folder, "holds no config.yaml", "grainfall new STUDY makes one")
    with contextlib.chdir(folder):
        config = resolved(sheet.load_yaml(configs[0]), configs[0].name)
        samples = sheet.samples_of(config, schema("config"), schema("samples"), files=files)
        return Study(folder, configs[0], config, samples)


def check_braces(folder: Path) -> None:
    """Refuse a folder that Snakemake would take for a pattern.

    Raises
    ------
    InputError
    """
    if {"{", "}"} & {*str(folder.resolve())}:
        raise InputError(folder, "has a brace in its path, which marks a wildcard", "rename the folder")


def in_study(study: Study, target: str) -> str:
    """A target as Snakemake knows it, from the study's folder: a shell completes paths from where one is."""
    path = Path(target)
    if len(path.parts) > 1 and path.parts[0] != "results" and path.resolve().is_relative_to(study.folder):
        return str(path.resolve().relative_to(study.folder))
    return str(path)


def schema(name: str) -> dict:
    """The schema ``config`` or ``samples``."""
    return sheet.load_yaml(house() / f"workflow/schemas/{name}.schema.yaml")


def resolved(config: dict, where: str) -> dict:
    """A config with every key present: defaults, under its preset, under its own values."""
    return sheet.resolve(config, schema("config"), sheet.load_yaml(house() / "config/presets.yaml"), where)


def snakemake(study: Study, *arguments: str) -> list[str]:
    """Command line that runs Snakemake on a study.

    Raises
    ------
    InputError
        When Snakemake is not installed, or cannot work in the folder.
    """
    check_braces(study.folder)
    if find_spec("snakemake") is None:
        raise InputError("snakemake", "is not installed", "install grainfall with its extra 'workflow'")
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(house() / "Snakefile")]
    command += ["--profile", str(house() / "workflow/profiles/local"), "--directory", str(study.folder)]
    return [*command, "--configfile", str(study.file), *arguments]


@dataclass
class Followed:
    """What a run has said so far.

    Attributes
    ----------
    done, total : int
        Steps.
    rule : str
        The one started last.
    fault : str
        First line that tells what went wrong.
    headed : bool
        Whether the last line was the heading of a fault.
    """

    done: int = 0
    total: int = 0
    rule: str = ""
    fault: str = ""
    headed: bool = False

    def read(self, line: str) -> None:
        """Take in one line of Snakemake's output."""
        if steps := STEPS.match(line):
            self.done, self.total = map(int, steps.groups())
        elif rule := RULE.match(line):
            self.rule = rule.group(1)
        elif line.startswith("total ") and not self.total:
            self.total = int(line.split()[1])
        elif not self.fault and (died := DIED.search(line)):
            rule, name = died.groups()
            why = ", as a machine short of memory does" if name == "SIGKILL" else ""
            self.fault = f"a job of rule {rule} was ended by {name}{why}"
        elif FAULT.match(line) and "LockException" not in line:
            self.headed = True
            return
        elif not self.fault and (self.headed or "(trace in " in line or line.startswith("grainfall: ")):
            self.fault = line.removeprefix("grainfall: ")
        elif not self.fault and "LockException" in line:
            self.fault = (
                "the study is locked: a run is going on, or one was killed (then: grainfall run --unlock)"
            )
        self.headed = False


def follow(command: Sequence[str], each: Callable[[str, Followed], None]) -> tuple[int, Followed]:
    """Run a command; ``each`` is given every line and what is known after it.

    Returns
    -------
    status : int
    followed : Followed
    """
    known = Followed()
    with _started(command) as process:
        for line in process.stdout:
            known.read(line.rstrip())
            each(line.rstrip(), known)
    return process.returncode, known


PATIENCE_S = 15.0
"""What an interrupted command is given to stop by itself."""


@contextlib.contextmanager
def _started(command: Sequence[str]) -> Iterator[subprocess.Popen]:
    """The running command; it ends with the block, and stops its jobs first when we are interrupted.

    Snakemake's handler of signals takes a lock that its main thread may hold, and then waits for ever. It is
    killed then, which ends its jobs, too, and loses nothing: the next run goes on as after any kill.
    """
    said = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    process = subprocess.Popen(command, env={**os.environ, "GRAINFALL_CLI": str(os.getpid())}, **said)
    try:
        yield process
    except BaseException:
        process.terminate()
        try:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE_S)
        finally:
            process.kill()
        raise
    finally:
        process.wait()


def jobs_left(study: Study, targets: Sequence[str] = ()) -> dict[str, int]:
    """Rules that a run would run now, with their numbers of jobs; empty when everything, or these, is done.

    Raises
    ------
    InputError
        When Snakemake cannot tell.
    """
    command = snakemake(study, "--dry-run", "--nolock", "--quiet", "host", "--", *targets)
    lines: list[str] = []
    status, known = follow(command, lambda line, _: lines.append(line))
    if status:
        fault = known.fault or next(filter(str.strip, reversed(lines)), "said nothing")
        raise InputError("snakemake", fault, "see grainfall run --verbose")
    table = "\n".join(lines).partition("Job stats:")[2].partition("\ntotal")[0]
    rows = [line.split() for line in table.splitlines()]
    return {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit() and row[0] != "all"}
