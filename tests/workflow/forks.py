"""``python -m snakemake`` without the wait: it takes longer to import than to plan a tiny study.

A server imports it once and forks for each run.
"""

import multiprocessing
import os
import runpy
import sys
import tempfile
from types import SimpleNamespace

SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(["snakemake.cli", "snakemake.report", "boto3", "grainfall.cli.needs"])


def _run(arguments, folder, environment, said):
    """The run itself, in the process that was forked for it."""
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    os.dup2(os.open(said, os.O_WRONLY), 1)
    os.dup2(1, 2)
    sys.argv[1:] = arguments
    runpy.run_module("snakemake", run_name="__main__", alter_sys=True)


def snakemake(*arguments, folder, environment, timeout):
    """The finished run: its ``returncode``, and in ``stdout`` what it said on both streams.

    Raises
    ------
    TimeoutError
        It went on for longer than that many seconds; it is ended.
    """
    with tempfile.NamedTemporaryFile() as said:
        run = SERVER.Process(target=_run, args=(arguments, folder, environment, said.name))
        run.start()
        run.join(timeout)
        if run.exitcode is None:
            run.terminate()
            raise TimeoutError(f"no end within {timeout} s: {said.read().decode()[-3000:]}")
        return SimpleNamespace(returncode=run.exitcode, stdout=said.read().decode())
