"""The commands. Each is a few lines: it asks the library or Snakemake, and says what came of it."""

from __future__ import annotations

import contextlib
import os
import shlex
import tempfile
import textwrap
import webbrowser
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from grainfall.errors import InputError

app = typer.Typer(
    help="One section of a granular rock in, packed 3D digital twins out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
out = Console(highlight=False, soft_wrap=True, markup=False, emoji=False)  # a path may be named [y] or :x:


def say(text: str) -> None:
    """Print prose, broken between words; paths and commands are printed as they are, to be copied."""
    width = min(80, out.width)
    lines = textwrap.wrap(text, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
    out.print("\n".join(lines))


Folder = Annotated[Path, typer.Argument(metavar="STUDY", help="Folder of the study; this one if omitted.")]
STAGES = {
    "section": "{sample}/section.zarr.zip",
    "grains": "{sample}/grains3d/library.csv",
    "first": "{sample}/{variant}/{n}/first/bodies.csv",
    "second": "{sample}/{variant}/{n}/second/bodies.csv",
    "twin": "{sample}/{variant}/{n}/twin.zarr.zip",
    "metrics": "{sample}/{variant}/{n}/metrics.csv",
}
"""What status looks for, in the order in which it comes to be."""
FIGURES = {
    "porosity": "porosity",
    "target": "porosity_target",
    "K x (mD)": "k_x_md",
    "K y (mD)": "k_y_md",
    "K z (mD)": "k_z_md",
    "S2 p": "s2_envelope_p",
}
"""Columns of summary.csv that status shows."""


@app.command()
def new(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="Folder to make.")],
    image: Annotated[Path, typer.Option(help="The section: PNG, TIFF, NPY, NPZ or Zarr.")],
    pixel_size: Annotated[str, typer.Option(help="Edge of a pixel, such as 1.2um or 800nm.")],
    kind: Annotated[
        str | None, typer.Option(help="instances, phases, binary or grey; judged if omitted.")
    ] = None,
    phases: Annotated[
        str | None, typer.Option(help="Names with values, 'pore=0;quartz=1', or names alone.")
    ] = None,
    pore_value: Annotated[int | None, typer.Option(help="The value that is pore.")] = None,
    array: Annotated[
        str | None, typer.Option(help="Name of the array in an NPZ or Zarr with several.")
    ] = None,
    preset: Annotated[str | None, typer.Option(help="draft or standard; suggested if omitted.")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace config and image of a study; results stay.")
    ] = False,
) -> None:
    """Look at an image and write a study with a commented config."""
    from grainfall.cli import look

    look.check_free(study, image, force)
    out.print(f"Reading {image}; a large image takes a while.")
    found = look.look(
        image,
        look.length_um(pixel_size),
        kind=kind,
        phases=phases,
        pore_value=pore_value,
        array=array,
        preset=preset,
    )
    config = look.write_study(study, found, force=force)
    for line in look.described(found):
        say(line)
    out.print(f"Written: {config}. Next: {_run_of(study)}")


@app.command()
def run(
    study: Folder = Path("."),
    cores: Annotated[str, typer.Option(help="Number of cores, or all.")] = "all",
    dry_run: Annotated[bool, typer.Option("--dry-run", "-n", help="Say what would run.")] = False,
    unlock: Annotated[
        bool, typer.Option("--unlock", help="Remove the lock of a run that was killed.")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Show all that Snakemake says.")] = False,
    target: Annotated[
        list[str] | None,
        typer.Option(
            "--target", "-t", help="Only this file, such as results/rock/sizes.csv; may be repeated."
        ),
    ] = None,
) -> None:
    """Run a study, or resume where it stopped. What does not need a job that failed is run all the same."""
    from grainfall.cli import study as studies
    from grainfall.cli.doctor import memory_limit

    if cores != "all" and not (cores.isdigit() and int(cores) > 0):
        raise InputError("--cores", f"'{cores}' is no number of cores", "a positive number, or all")
    opened = studies.open_study(study)
    if not os.access(opened.folder, os.W_OK):
        raise InputError(opened.folder, "may not be written to", "a folder of your own; results go into it")
    target = [studies.in_study(opened, path) for path in target or ()]
    if dry_run:
        say(_jobs(studies.jobs_left(opened, target)))
        return
    # Jobs wait for one another where together they would need more than there is.
    at_once = ["--cores", cores, "--resources", f"mem_mb={round(0.9 * memory_limit() / 2**20)}"]
    jobs = ["--keep-going", *at_once, "--", *target]
    command = studies.snakemake(opened, *(["--unlock"] if unlock else jobs))
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=out,
        disable=not out.is_terminal or verbose or unlock,
    ) as bar:  # fmt: skip
        task = bar.add_task("starting", total=None)

        def each(line: str, known: studies.Followed) -> None:
            bar.update(
                task, completed=known.done, total=known.total or None, description=known.rule or "starting"
            )
            said = line.startswith("[") and "] " in line and not line.endswith("]")
            said |= line.startswith("grainfall: ")  # of a job that failed, while others go on
            step = not out.is_terminal and studies.STEPS.match(line)
            if verbose or said or step:
                out.print(line)

        status, known = studies.follow(command, each)
    if status:
        fault = known.fault or "Snakemake failed"
        raise InputError(
            opened.folder, fault, "the same command goes on; --verbose and .snakemake/log say more"
        )
    report = opened.results / "report.html"
    done = f"Done: {report}. Look at it: grainfall view {shlex.quote(str(study))}"
    if target:
        done = f"Done: {', '.join(target)}."
    out.print("Unlocked." if unlock else done)


@app.command()
def status(study: Folder = Path(".")) -> None:
    """Say how far a study is, and what its twins came to."""
    from grainfall import io
    from grainfall.cli import study as studies

    opened = studies.open_study(study, files=False)
    table = Table("twin", *STAGES, box=SIMPLE, title=str(opened.folder))
    for sample, variant, n in opened.twins:
        files = (
            opened.results / path.format(sample=sample, variant=variant, n=n) for path in STAGES.values()
        )
        table.add_row(f"{sample}/{variant}/{n}", *("done" if file.exists() else "-" for file in files))
    out.print(table)
    if (opened.results / "summary.csv").is_file():
        summary = io.read_table(opened.results / "summary.csv")
        figures = Table("twin", *FIGURES, box=SIMPLE, title="results/summary.csv")
        for row in summary.itertuples():
            cells = (getattr(row, name) for name in FIGURES.values())
            twin = f"{row.sample}/{row.variant}/{row.realization}"
            figures.add_row(twin, *(f"{cell:.4g}" if cell == cell else "" for cell in cells))
        out.print(figures)
    if opened.locked:
        say("A run is going on, or one was killed (then: grainfall run --unlock).")
    if not os.access(opened.folder, os.W_OK):
        say("The folder may not be written to, so what is left to do cannot be told.")
        return
    studies.open_study(study)  # what it names may be gone
    say(_jobs(studies.jobs_left(opened)))


def _run_of(study: Path) -> str:
    """The command that runs it."""
    return f"grainfall run {shlex.quote(str(study))}"


def _jobs(left: dict[str, int]) -> str:
    """What is left to do, in words."""
    if not left:
        return "Everything is done and up to date."
    listed = ", ".join(f"{name} {count}" if count > 1 else name for name, count in left.items())
    return f"{sum(left.values())} jobs to do: {listed}"


@app.command()
def view(
    study: Folder = Path("."),
    no_open: Annotated[
        bool, typer.Option("--no-open", help="Say where the report is, open nothing.")
    ] = False,
) -> None:
    """Open the report in the browser: verdicts, figures, tables, the twin in 3D, phases and network."""
    from grainfall.cli import study as studies

    opened = studies.open_study(study, files=False)
    report = opened.results / "report.html"
    if not report.is_file():
        raise InputError(report, "there is no report yet", f"{_run_of(study)} makes it")
    out.print(str(report))
    if not no_open and not webbrowser.open(report.as_uri()):
        raise InputError(report, "no browser could be opened", "open this file in one")


@app.command()
def export(
    study: Folder = Path("."),
    format: Annotated[
        list[str] | None, typer.Option("--format", "-f", help="One of those listed; may be repeated.")
    ] = None,
    twin: Annotated[
        str | None, typer.Option(help="SAMPLE/VARIANT/REALIZATION, or all; the first twin if omitted.")
    ] = None,
    to: Annotated[
        Path | None, typer.Option(help="Folder to write to; export/ beside the twin if omitted.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there.")] = False,
) -> None:
    """Write a twin, its grains and its pore network for other programs; no --format: list the formats."""
    from grainfall import config
    from grainfall.cli import study as studies
    from grainfall.export import FORMATS, Twin, export_twin

    opened = studies.open_study(study, files=False)
    if not format:
        table = Table("format", "files", "what", box=SIMPLE)
        for name, kind in FORMATS.items():
            table.add_row(name, ", ".join(kind.files), kind.about)
        out.print(table)
        return
    for name in format:
        if name not in FORMATS:
            raise InputError("--format", f"'{name}' is not known", f"one of: {', '.join(FORMATS)}")
    twins = ["/".join(map(str, t)) for t in opened.twins]
    if twin not in (None, "all", *twins):
        raise InputError("--twin", f"'{twin}' is not in the study", f"all, or one of: {', '.join(twins[:5])}")
    folders = {}
    for name in twins if twin == "all" else [twin or twins[0]]:
        source = opened.results / name
        folders[source] = (to / name if twin == "all" else to) if to else source / "export"
        if not (source / "bodies.csv").is_file():  # of the rule that makes a twin's volume, too
            raise InputError(source, "there is no twin yet", f"{_run_of(study)} makes it")
    files = {folder / file for name in format for file in FORMATS[name].files for folder in folders.values()}
    if (there := sorted(filter(Path.exists, files))) and not force:
        raise InputError(there[0], "is there already", "--to another folder, or --force to replace it")
    for source, folder in folders.items():
        coarsen = config.variant(opened.config, source.parent.name)["network"]["coarsen"]
        beside = next(path for path in (folder, *folder.absolute().parents) if path.is_dir())
        with tempfile.TemporaryDirectory(prefix=".export-", dir=beside) as part:
            written = export_twin(Twin(source, source.parents[1] / "grains3d", coarsen), part, format)
            folder.mkdir(parents=True, exist_ok=True)  # not before there is something to lie in it
            for file in written:
                file.replace(folder / file.name)
                out.print(str(folder / file.name))


@app.command()
def verify(study: Folder = Path(".")) -> None:
    """Say what has changed since a study was run (files, config, code, packages); status 1 if any has."""
    from grainfall import provenance
    from grainfall.cli import study as studies

    if not study.is_dir():
        raise InputError(study, "is no folder", "the folder in which results/ lies")
    with contextlib.chdir(study):  # which paths in the records start from
        changes, compared = provenance.verify("results", studies.house())
    for line in changes:
        out.print(line)
    count = f"{compared} files compared with {study / 'results' / provenance.NAME}"
    out.print(f"{count}: {len(changes)} differences" if changes else f"{count}: nothing has changed")
    if changes:
        raise typer.Exit(1)


@app.command()
def doctor(study: Folder = Path(".")) -> None:
    """Examine the environment, the engines, cores, memory and graphics cards."""
    from grainfall.cli.doctor import examine

    bad = []
    table = Table("what", "found", "", box=SIMPLE)
    for finding in examine(study):
        table.add_row(finding.what, finding.found, {True: "ok", False: "MISSING", None: ""}[finding.ok])
        bad += [finding.what] if finding.ok is False else []
    out.print(table)
    if bad:
        raise InputError("doctor", f"not as it should be: {', '.join(bad)}", "see above")
