"""Where a result comes from: what each job read and wrote, with what; and whether all that is still so.

Every job leaves a record beside its log (:func:`write_record`): SHA-256 of what it read and wrote, its
parameters, the versions it ran with. A job that reads what an earlier one wrote compares it with that
record first (:func:`check_files`). ``provenance.json`` of a twin and of a run collect the records;
:func:`verify` goes through them and says what has changed since.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

from grainfall import __version__, config, io
from grainfall.errors import InputError

# fmt: off
PACKAGES = (
    "numpy", "scipy", "numba", "pandas", "pillow", "scikit-image", "tifffile", "zarr", "trimesh", "edt",
    "jsonschema", "pyyaml", "lazy-loader", "sapien", "pybullet", "porespy", "openpnm", "python-fcl", "coacd",
    "pyevtk", "pyvista",
)
# fmt: on
"""What results are computed with: the core of pyproject.toml and its extras packing and analysis."""

NAME = "provenance.json"

LEVELS = 5
"""Folders between a file of the results and the results folder, both counted, at most."""


def checksum(path: str | Path) -> str:
    """SHA-256 of a file; of a folder, over the names and the SHA-256 of all the files in it.

    Raises
    ------
    InputError
        When it is not there, may not be read, or is neither (a pipe, a device).
    """
    path = Path(path)
    try:
        if path.is_dir():
            files = sorted(file for file in path.rglob("*") if file.is_file() and not _aside(file))
            listed = "".join(f"{checksum(file)}  {file.relative_to(path).as_posix()}\n" for file in files)
            return hashlib.sha256(listed.encode(errors="surrogateescape")).hexdigest()
        if path.exists() and not path.is_file():
            raise InputError(path, "neither a file nor a folder", "give the path of a file")
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as fault:
        raise InputError(path, fault.strerror or "cannot be read", "give a readable file") from None


def _aside(file: Path) -> bool:
    """Snakemake's own mark in a folder that a job wrote; it holds no data."""
    return file.name == ".snakemake_timestamp"


@cache
def versions() -> dict[str, str]:
    """Python, grainfall and each installed one of :data:`PACKAGES`."""
    found = {"python": platform.python_version(), "grainfall": __version__}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def source_checksum() -> str:
    """SHA-256 over the package's own source, which tells edits apart that share a version."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


# --- records of jobs --------------------------------------------------------------------------------


def write_record(
    path: str | Path, rule: str, inputs: Iterable[str], outputs: Iterable[str], parameters: Mapping
) -> None:
    """Write what a job read and wrote; paths are kept relative to the record, so that folders can move.

    Parameters
    ----------
    path : str or Path
        The record, in the folder ``logs`` of the sample, variant or twin.
    rule : str
        Name of the job's rule.
    inputs, outputs : iterable of str
        Files and folders; the outputs must be there.
    parameters : mapping
        What else decided the result.
    """
    sums = {}
    for what, given in (("inputs", inputs), ("outputs", outputs)):
        files = sorted(set(given))
        sums[what] = dict(zip(_relative(files, Path(path).parent), map(checksum, files), strict=True))
    plain = json.loads(json.dumps(dict(parameters), default=str))
    io.write_json(path, {"rule": rule, **sums, "parameters": plain, "versions": versions()})


def _record(path: Path) -> dict | None:
    """The record in a file, or None where it holds none: other programs, too, have folders called logs."""
    try:
        found = io.read_json(path)
    except InputError:
        return None
    return found if isinstance(found, dict) and {"rule", "inputs", "outputs"} <= set(found) else None


def records(folder: str | Path) -> dict[Path, dict]:
    """The records of the jobs of one folder of results whose outputs are still there, by name."""
    found = {path: _record(path) for path in sorted((Path(folder) / "logs").glob("*.json"))}
    return {
        path: record
        for path, record in found.items()
        if record and any((path.parent / name).exists() for name in record["outputs"])
    }


def behind(targets: Iterable[str | Path], folders: Iterable[str | Path]) -> dict[Path, dict]:
    """The records, of those in these folders of results, of the jobs that led to the targets."""
    found = [pair for folder in folders for pair in records(folder).items()]
    writer = {
        os.path.abspath(path.parent / name): (path, record)
        for path, record in found
        for name in record["outputs"]
    }
    led, left = {}, [os.path.abspath(target) for target in targets]
    while left:
        path, record = writer.get(left.pop(), (None, None))
        if path is not None and path not in led:
            led[path] = record
            left += [os.path.abspath(path.parent / name) for name in record["inputs"]]
    return dict(sorted(led.items()))


def check_files(paths: Iterable[str | Path]) -> None:
    """Compare files with the records of the jobs that wrote them, where there are any.

    Raises
    ------
    InputError
        When one is another than the job wrote.
    """
    written: dict[Path, dict[str, tuple[str, str]]] = {}  # of each folder, read once
    for path in paths:
        target = os.path.abspath(path)
        for folder in Path(target).parents[:LEVELS]:
            if folder not in written:
                written[folder] = {
                    os.path.abspath(file.parent / name): (record["rule"], expected)
                    for file, record in reversed(records(folder).items())  # the first by name counts
                    for name, expected in record["outputs"].items()
                }
            if target in written[folder]:
                rule, expected = written[folder][target]
                if checksum(target) != expected:
                    raise InputError(
                        path,
                        f"is not what {rule} wrote: damaged or altered since (SHA-256)",
                        "delete it, and its copy in the cache if there is one, so that it is made again",
                    )
                break


# --- provenance of a twin and of a run --------------------------------------------------------------


def of_twin(
    folder: str | Path, targets: Iterable[str], settings: Mapping, sample: Mapping, seed: int
) -> dict:
    """Everything one twin rests on.

    Parameters
    ----------
    folder : path
        ``results/{sample}/{variant}/{realization}``.
    targets : iterable of str
        What was measured of the twin last.
    settings : mapping
        The config as the twin's variant sees it.
    sample : mapping
        The sample's row of the sheet.
    seed : int

    Returns
    -------
    dict
        grainfall_version, sample, variant, realization, seed, config, row, and the records of all jobs that
        led to the targets, by their path from the folder.
    """
    folder = Path(folder)
    levels = (folder.parents[1], folder.parent, folder)
    jobs = behind(targets, levels)
    return {
        "grainfall_version": __version__,
        **dict(zip(("sample", "variant", "realization"), (level.name for level in levels), strict=True)),
        "seed": seed,
        "config": dict(settings),
        "row": dict(sample),
        "jobs": dict(zip(_relative(jobs, folder), jobs.values(), strict=True)),
    }


def of_run(
    results: str | Path,
    targets: Iterable[str],
    house: str | Path,
    *,
    files: Iterable[str],
    overrides: Mapping,
    config: Mapping,
    samples: Mapping[str, Mapping],
) -> dict:
    """Everything a run rests on.

    Parameters
    ----------
    results : path
        The results folder.
    targets : iterable of str
        Summary and report.
    house : path
        Root of the checkout, which has the lock.
    files : iterable of str
        The config files, the later over the earlier.
    overrides : mapping
        Values given on the command line, over them.
    config, samples : mapping
        The config with every key and the rows of the samples, as the run used them.

    Returns
    -------
    dict
        seed, config, samples, SHA-256 of the user's files, versions, SHA-256 of lock and source, and the
        records of the jobs over all samples.
    """
    jobs = behind(targets, [results])
    given = [row[key] for row in samples.values() for key in ("image", "grey", "reference") if row.get(key)]
    return {
        "grainfall_version": __version__,
        "seed": config["seed"],
        "config": {"files": _relative(files, "."), "overrides": dict(overrides), "resolved": dict(config)},
        "samples": dict(samples),
        "inputs": {path: checksum(path) for path in dict.fromkeys(given)},
        "versions": versions(),
        "machine": f"{platform.system()} {platform.machine()}",
        "lock": checksum(Path(house) / "requirements.lock"),
        "source": source_checksum(),
        "jobs": dict(zip(_relative(jobs, results), jobs.values(), strict=True)),
    }


def _relative(paths: Iterable[str | Path], folder: str | Path) -> list[str]:
    return [Path(os.path.relpath(path, folder)).as_posix() for path in paths]


def _resolved(house: str | Path, files: Iterable[str], overrides: Mapping) -> tuple[dict, dict]:
    """Config with every key, and the rows of the samples, as the workflow sees them."""
    house, given = Path(house), {}
    schema, sample_schema = (
        config.load_yaml(house / f"workflow/schemas/{name}.schema.yaml") for name in ("config", "samples")
    )
    for file in files:
        given = config.merge(given, config.load_yaml(file))
    whole = config.resolve(
        config.merge(given, dict(overrides)), schema, config.load_yaml(house / "config/presets.yaml")
    )
    samples = config.samples_of(whole, schema, sample_schema)
    return json.loads(json.dumps([whole, samples]))


# --- what changed -----------------------------------------------------------------------------------


def verify(results: str | Path, house: str | Path) -> tuple[list[str], int]:
    """What is no longer as the results' provenance says.

    Parameters
    ----------
    results : path
        The results folder; paths of the user's files are taken from the working directory.
    house : path
        Root of the checkout.

    Returns
    -------
    changes : list of str
        A line each, in plain words: input, config, version, output. Empty where all is as it was.
    compared : int
        Files whose SHA-256 was computed.

    Raises
    ------
    InputError
        When there is no provenance, or it cannot be read.
    """
    results = Path(results)
    run = io.read_json(results / NAME)
    changes = [*_changed_inputs(run), *_changed_config(run, house), *_changed_versions(run, house)]
    collected = [(results, run)]
    for path in sorted(results.glob(f"*/*/*/{NAME}")):
        collected.append((path.parent, io.read_json(path)))
    jobs = {
        Path(os.path.normpath(folder / name)): record
        for folder, document in collected
        for name, record in document["jobs"].items()
    }
    changed, compared = _changed_outputs(jobs, Path(os.path.normpath(results)))
    return [*changes, *changed], compared + len(run["inputs"])


def _changed_inputs(run: Mapping) -> Iterator[str]:
    for path, expected in run["inputs"].items():
        if not Path(path).exists():
            yield f"input: {path} is gone"
        elif checksum(path) != expected:
            yield f"input: {path} is not the file that was used"


def _changed_config(run: Mapping, house: str | Path) -> Iterator[str]:
    try:
        resolved, samples = _resolved(house, run["config"]["files"], run["config"]["overrides"])
    except InputError as fault:
        yield f"config: cannot be read as it was: {fault}"
        return
    before, after = ({**whole, "samples": None} for whole in (run["config"]["resolved"], resolved))
    yield from _differences(before, after, "config: ")
    yield from _differences(run["samples"], samples, "config: sample ")


def _differences(before: object, after: object, where: str) -> Iterator[str]:
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted({*before, *after}):
            name = f"{where}{key}"
            if key not in after:
                yield f"{name} was {before[key]!r}, is no longer given"
            elif key not in before:
                yield f"{name} was not given, is {after[key]!r}"
            else:
                deeper = isinstance(before[key], dict) and isinstance(after[key], dict)
                yield from _differences(before[key], after[key], f"{name}." if deeper else name)
    elif before != after:
        yield f"{where} was {before!r}, is {after!r}"


def _changed_versions(run: Mapping, house: str | Path) -> Iterator[str]:
    yield from _differences(run["versions"], versions(), "version: ")
    if run["lock"] != checksum(Path(house) / "requirements.lock"):
        yield "version: requirements.lock is another one"
    if run["source"] != source_checksum():
        yield "version: the source of grainfall is another one (what that touches: snakemake --dry-run)"


def _changed_outputs(jobs: Mapping[Path, Mapping], results: Path) -> tuple[list[str], int]:
    """Outputs gone or altered; results that came from another file, or other versions, than the rest."""
    changes, compared = [], 0
    made: dict[Path, str] = {}
    for path, record in jobs.items():
        for name, expected in record["outputs"].items():
            file = Path(os.path.normpath(path.parent / name))
            made[file] = expected
            compared += 1
            if not file.exists():
                changes.append(f"output: {file} is gone (rule {record['rule']})")
            elif checksum(file) != expected:
                changes.append(f"output: {file} is not what rule {record['rule']} wrote")
    for path, record in jobs.items():
        for name, used in record["inputs"].items():
            file = Path(os.path.normpath(path.parent / name))
            if file not in made and results in file.parents and file.exists():  # some are temporary
                made[file] = checksum(file)
                compared += 1
            if made.get(file, used) != used:
                outputs = ", ".join(Path(output).name for output in record["outputs"])
                changes.append(f"output: {outputs} of {path.parent.parent} came from another {file}")
    now = versions()
    for older in {
        json.dumps(record["versions"], sort_keys=True): record for record in jobs.values()
    }.values():
        rules = sorted({r["rule"] for r in jobs.values() if r["versions"] == older["versions"]})
        for line in _differences(older["versions"], now, "version: "):
            changes.append(f"{line} (jobs {', '.join(rules)})")
    return changes, compared
