"""What every script does around its work: a log, a record of what went in and out, one line for a mistake."""

import os
import shutil
import sys

for pool in ("OMP", "NUMBA", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{pool}_NUM_THREADS", "1")

import time
import traceback
import zlib
from contextlib import contextmanager, suppress
from pathlib import Path

# Scripts find the science of their own checkout, installed or not.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))

from grainfall import provenance
from grainfall.errors import InputError
from grainfall.lifeline import end_with

# A job whose Snakemake was killed ends too: it must not write into the results of the next run.
end_with(int(os.environ.get("GRAINFALL_SNAKEMAKE", os.getppid())))


class Progress:
    """Call it with a line as often as you like: the log gets all, the terminal one in ten seconds."""

    def __init__(self, label: str, terminal, every_s: float = 10.0):
        self.label, self.terminal, self.every_s, self.last = label, terminal, every_s, time.monotonic()

    def __call__(self, line: str) -> None:
        print(line, flush=True)
        if time.monotonic() - self.last >= self.every_s:
            self.last = time.monotonic()
            self.say(line)

    def say(self, line: str) -> None:
        print(f"[{self.label}] {line}", file=self.terminal, flush=True)


def part(wildcards) -> tuple[int, int]:
    """Which part of how many a scattered job does, from 1; the only one where the rule is not scattered."""
    which, of = wildcards.get("scatteritem", "1-of-1").split("-of-")
    return int(which), int(of)


def results_folder(snakemake) -> str:
    """The folder of results, for what is made of all that is in it.

    Raises
    ------
    InputError
        When results are on storage elsewhere.
    """
    if not Path(snakemake.output[0]).is_relative_to("results"):
        raise InputError(
            snakemake.rule,
            "results are on storage elsewhere",
            "copy them to results/ here, and run without the storage provider",
        )
    return "results"


@contextmanager
def stage(snakemake):
    """Run a script's work with its output in the rule's log.

    A user's mistake ends in one line; anything else too, with the trace in the log. What the job reads is
    held against the records of the jobs that wrote it; its own record is written when all went well.
    """
    where = "/".join(str(v) for v in dict(snakemake.wildcards).values())
    terminal = os.fdopen(os.dup(2), "w")
    log = Path(str(snakemake.log[0]))
    log.parent.mkdir(parents=True, exist_ok=True)
    record = log.with_suffix(".json")
    with log.open("w") as sink:
        # Engines print from C: redirect the descriptors, not only Python's streams.
        sys.stdout.flush()
        sys.stderr.flush()
        os.dup2(sink.fileno(), 1)
        os.dup2(sink.fileno(), 2)
        progress = Progress(f"{snakemake.rule} {where}".strip(), terminal)
        try:
            provenance.check_files(snakemake.input)
            yield progress
            written = [path for path in snakemake.output if Path(path) != record]
            provenance.write_record(
                record, snakemake.rule, snakemake.input, written, dict(snakemake.params.items())
            )
        except InputError as fault:
            print(fault, flush=True)
            print(f"grainfall: {fault}", file=terminal, flush=True)
            sys.exit(1)
        except Exception as fault:
            with suppress(OSError):  # the log may be on the disk that is full
                traceback.print_exc()
            what = " ".join(f"{type(fault).__name__}: {fault}".split())
            progress.say(f"{what} (trace in {log})")
            sys.exit(1)
        finally:
            with suppress(OSError):
                sys.stdout.flush()
                sys.stderr.flush()


@contextmanager
def resumable_stage(snakemake):
    """A stage with a folder for what a killed job leaves to its next run; gone once the record is written.

    Its name holds the science and the versions: what other code began is not carried on.
    """
    folder = Path(snakemake.output.bodies).with_name(".checkpoints")
    versions = zlib.crc32(repr(sorted(provenance.versions().items())).encode())
    with stage(snakemake) as progress:
        yield progress, folder / f"{snakemake.params.science}-{versions:08x}"
    shutil.rmtree(folder, ignore_errors=True)
