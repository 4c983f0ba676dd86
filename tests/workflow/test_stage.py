"""What every script does around its work."""

import subprocess
import sys

import pytest

from conftest import ROOT

PACKING = """
import sys; sys.path.insert(0, sys.argv[1])
from pathlib import Path
import _stage
from snakemake.iocontainers import Namedlist

class Job:
    rule, wildcards, input, log = "first_packing", Namedlist(), Namedlist(), ["logs/packing.log"]
    output, params = Namedlist(fromdict={"bodies": "first/bodies.csv"}), Namedlist(fromdict={"science": "s"})

write = _stage.provenance.write_record
def recorded(*arguments):
    assert Path("first/.checkpoints").exists(), "gone before there is a record"
    write(*arguments)
_stage.provenance.write_record = recorded

with _stage.resumable_stage(Job) as (progress, checkpoints):
    checkpoints.mkdir(parents=True)
    (checkpoints / "1.npz").touch()
    if sys.argv[2] == "fails":
        raise ValueError("a bug")
    Path("first/bodies.csv").touch()
"""


@pytest.mark.parametrize("how", ["ends", "fails"])
def test_checkpoints_stay_until_the_record_is_written(tmp_path, how):
    command = [sys.executable, "-c", PACKING, ROOT / "scripts", how]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    left = [path.name for path in tmp_path.glob("first/.checkpoints/*/*")]
    if how == "ends":
        assert done.returncode == 0, done.stderr + (tmp_path / "logs/packing.log").read_text()
        assert (tmp_path / "logs/packing.json").exists()
        assert left == []
    else:
        assert done.returncode == 1
        assert "ValueError: a bug (trace in logs/packing.log)" in done.stderr
        assert not (tmp_path / "logs/packing.json").exists()
        assert left == ["1.npz"]
