"""The command line: thin over the library and over Snakemake, which is called as a program of its own.

``main`` turns every mistake into one line. Commands load what they need when they run: ``--help`` is quick.
"""

from __future__ import annotations

import os
import signal
import sys

from grainfall.errors import InputError

TRACE = "GRAINFALL_TRACE"
"""Environment variable that lets an unexpected error show where it came from."""


def main(arguments: list[str] | None = None) -> None:
    """Run a command and leave the process: 0 done, 1 a mistake or a missing piece, 2 a wrong command line."""
    # Thousands of tiny products, as in the inversion, take many times as long on several threads; as in jobs.
    for pool in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{pool}_NUM_THREADS", "1")
    # Asked to end, we end as by Ctrl-C: what we have started is told to end too.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: list[str]) -> int:
    """Run a command; the exit status. What went wrong is one line on standard error."""
    try:
        import typer

        from grainfall.cli.app import app
    except ModuleNotFoundError as fault:
        return _say(f"the package {fault.name} is missing; install grainfall with its extra 'cli'", 1)
    try:
        return app(arguments, prog_name="grainfall", standalone_mode=False) or 0
    except InputError as fault:
        return _say(str(fault), 1)
    except typer.Exit as end:
        return end.exit_code
    except typer.TyperException as fault:
        return _say(f"{fault.format_message()} (grainfall --help)", fault.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        return _say("stopped; the same command goes on where it was", 130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except PermissionError as fault:
        return _say(
            f"{fault.filename}: may not be read or written; give yourself the right, or another place", 1
        )
    except Exception as fault:
        if os.environ.get(TRACE):
            raise
        return _say(f"{type(fault).__name__}: {fault} ({TRACE}=1 shows where)", 1)


def _say(line: str, status: int) -> int:
    print("grainfall: " + " ".join(line.split()), file=sys.stderr)
    return status
