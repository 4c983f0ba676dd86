"""An ensemble through a real Slurm, its daemons started here on loopback: the same bytes as on one machine.

Skipped where Slurm and munge are not installed, or may not be started.
"""

import os
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import psutil
import pytest
from outputs import outputs

from conftest import ROOT

pytestmark = pytest.mark.xdist_group("slurm")

DAEMONS = ("munged", "slurmctld", "slurmd")
CONFIG = """
ClusterName=loopback
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
AuthInfo=socket={folder}/munge.socket
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SlurmdParameters=config_overrides
SchedulerParameters=sched_min_interval=200000,batch_sched_delay=1
ReturnToService=2
NodeName={host} NodeAddr=127.0.0.1 CPUs=2 RealMemory=64000
PartitionName=all Nodes={host} Default=YES
"""


def free_ports(n):
    """Ports of this machine that nobody listens on."""
    with ExitStack() as stack:
        taken = [stack.enter_context(socket.socket()) for _ in range(n)]
        for one in taken:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in taken]


@contextmanager
def daemon(*command, folder, environment):
    """A daemon in the foreground for as long as the block lasts, what it says in a log."""
    with (folder / f"{command[0]}.log").open("w") as log:
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=log, cwd=folder)
        try:
            yield process
        finally:
            process.terminate()
            process.wait(timeout=30)


def end_strays(environment):
    """End what cancelled jobs have left: Slurm loses sight of a process whose parent is gone."""
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.environ().get("SLURM_CONF") == environment["SLURM_CONF"]:
                process.kill()


@pytest.fixture(scope="module")
def slurm():
    """Environment of the commands of a Slurm of one node with two cores, without accounting."""
    missing = [name for name in DAEMONS if not shutil.which(name)]
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed (Debian: slurm-wlm, munge)")
    if os.geteuid() != 0:
        pytest.skip("Slurm's daemons start as root only")
    # munge's socket does not bear pytest's long paths
    with tempfile.TemporaryDirectory(prefix="slurm-") as temporary, ExitStack() as stack:
        folder = Path(temporary)
        for part in ("state", "spool", "bin"):
            (folder / part).mkdir()
        # a job's own steps are started without the variables of Slurm, where to find it among them
        step = folder / "bin/srun"
        step.write_text(f'#!/bin/sh\nSLURM_CONF={folder}/slurm.conf exec {shutil.which("srun")} "$@"\n')
        step.chmod(0o755)
        environment = {
            **os.environ,
            "SLURM_CONF": f"{folder}/slurm.conf",
            "PATH": f"{folder}/bin:{os.environ['PATH']}",
        }
        key = folder / "munge.key"
        key.write_bytes(secrets.token_bytes(128))
        key.chmod(0o400)
        host = socket.gethostname().split(".")[0]
        text = CONFIG.format(host=host, folder=folder, ports=free_ports(2))
        (folder / "slurm.conf").write_text(text)
        own = {"folder": folder, "environment": environment}
        stack.callback(end_strays, environment)
        files = {"key-file": "key", "socket": "socket", "pid-file": "pid", "seed-file": "seed"}
        named = [f"--{option}={folder}/munge.{end}" for option, end in files.items()]
        stack.enter_context(daemon("munged", "--foreground", "--force", *named, **own))
        stack.enter_context(daemon("slurmctld", "-D", **own))
        stack.enter_context(daemon("slurmd", "-D", "-N", host, **own))
        for _ in range(100):
            state = subprocess.run(
                ["sinfo", "-h", "-o", "%T"], env=environment, capture_output=True, text=True
            )
            if state.stdout.strip() == "idle":
                break
            time.sleep(0.2)
        else:
            logs = "".join(log.read_text()[-2000:] for log in folder.glob("*.log"))
            pytest.fail(f"Slurm does not start: {state.stdout} {state.stderr} {logs}")
        yield environment


def start(folder, environment, *targets):
    """The workflow through Slurm, by the profile that comes with it."""
    command = [sys.executable, "-m", "snakemake", "--snakefile", ROOT / "Snakefile"]
    command += ["--profile", ROOT / "workflow/profiles/slurm_sweep", "--configfile", "config.yaml"]
    # no accounting here, and no network file system to wait for
    command += ["--slurm-status-command", "squeue", "--slurm-no-account", "--latency-wait", "5"]
    command += ["--slurm-init-seconds-before-status-checks", "2", "--retries", "0"]
    with (folder / "said.log").open("w") as said:
        return subprocess.Popen(
            [*map(str, command), "--", *targets],
            cwd=folder,
            env=environment,
            stdout=said,
            stderr=subprocess.STDOUT,
        )


def test_cancelled_jobs_are_submitted_again_to_the_same_bytes(finished, tmp_path, slurm):
    """Two twins, a job each; all of it that takes longer than Slurm's own seconds is in `finished`."""
    folder = shutil.copytree(finished, tmp_path / "cluster")
    twins = [folder / f"results/tiny/full/{realization}" for realization in (0, 1)]
    for twin in twins:
        shutil.rmtree(twin)
    targets = [str((twin / "deficit.json").relative_to(folder)) for twin in twins]
    process = start(folder, slurm, *targets)
    while not any((twin / "logs/first_packing.log").exists() for twin in twins) and process.poll() is None:
        time.sleep(0.1)
    subprocess.run(["scancel", "--me"], env=slurm, check=True)
    assert process.wait(timeout=120) != 0
    assert not any((twin / "deficit.json").exists() for twin in twins)
    assert start(folder, slurm, *targets).wait(timeout=300) == 0, (folder / "said.log").read_text()[-5000:]
    there, here = outputs(folder), outputs(finished)
    made = [name for name in there if "tiny/full/0/" in name or "tiny/full/1/" in name]
    assert len(made) == 2 * 7
    assert [name for name in there if there[name] != here[name]] == []
