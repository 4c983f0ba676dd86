"""The tutorial, typed as it stands: its study is that of these tests, so the run finds everything done."""

import os
import re
import shlex
import shutil
import subprocess
import sys

import pytest

from conftest import ROOT
from grainfall import io
from grainfall.export import FORMATS

pytestmark = pytest.mark.xdist_group("tutorial")

BLOCK = re.compile(r"^```(console|python)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def run(folder, *command):
    """A finished command and what it said."""
    done = subprocess.run(
        [sys.executable, *command],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT / "src"), "COLUMNS": "120"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
    )
    assert "Traceback" not in done.stdout
    return done


def grainfall(folder, *arguments):
    return run(folder, "-m", "grainfall.cli", *arguments)


@pytest.fixture(scope="module")
def typed(finished, tmp_path_factory):
    """What each block of the tutorial printed, by the block's text; and the folder it was typed in."""
    folder = tmp_path_factory.mktemp("tutorial")
    shutil.copytree(finished, folder / "tiny", ignore=shutil.ignore_patterns("export"))
    shutil.copy(ROOT / "docs/tiny.yaml", folder / "tiny/config.yaml")
    said, script = {}, ""
    for kind, text in BLOCK.findall((ROOT / "docs/tutorial.md").read_text()):
        if kind == "python":
            # later blocks go on with the names of earlier ones
            script += text
            done = run(folder, "-c", script)
            assert done.returncode == 0, done.stdout
            said[text] = done.stdout
            continue
        for line in text.splitlines():
            words = shlex.split(line.removeprefix("$ "))
            assert words[0] == "grainfall", line
            done = grainfall(folder, *words[1:])
            assert done.returncode == 0, f"{line}\n{done.stdout}"
            said[line.removeprefix("$ ")] = done.stdout
    return folder, said


def test_every_step_is_there_and_does_what_the_tutorial_says(typed):
    folder, said = typed
    assert {line.split()[1] for line in said if line.startswith("grainfall ")} == {
        "doctor", "new", "run", "status", "view", "export"
    }  # fmt: skip
    assert "Done: " in said["grainfall run tiny"]
    assert "Everything is done and up to date." in said["grainfall status tiny"]
    assert (folder / "tiny/results/report.html").as_posix() in said["grainfall view tiny --no-open"]
    export = {path.name for path in (folder / "tiny/results/tiny/full/0/export").iterdir()}
    assert export == {file for name in ("mhd", "statoil", "lammps") for file in FORMATS[name].files}
    dry = said["grainfall run rock --dry-run"]
    assert re.match(r"\d+ jobs to do: .*morphology.*report_page", dry.replace("\n", " "))
    assert not (folder / "rock/results").exists()


def test_new_finds_what_the_chapters_find(typed):
    """The workflow measured the same section: its figures are those that new has stated."""
    folder, said = typed
    words = next(" ".join(text.split()) for line, text in said.items() if line.startswith("grainfall new"))
    scene = io.read_json(folder / "tiny/results/tiny/full/scene.json")
    about = io.read_json(folder / "tiny/results/tiny/section.json")
    mean = float(re.search(r"([0-9.]+) um in space", words).group(1))
    assert mean == pytest.approx(scene["mean_diameter_um"] / 2, rel=0.005)
    assert f"{about['n_grains']} grains, {about['n_grains_uncut']} of them whole" in words
    assert f"Porosity {about['porosity']:.4f}" in words
    assert "quartz" in words
    assert "kind phases" in words


def test_a_run_is_followed_and_a_fault_is_one_line(typed, tmp_path):
    folder, _ = typed
    target = tmp_path / "rock"
    shutil.copytree(folder / "rock", target)
    (target / "section.png").write_bytes(b"\x89PNG\r\n\x1a\n and no more")
    done = grainfall(tmp_path, "run", "rock", "--cores", "1")
    assert done.returncode == 1
    last = done.stdout.splitlines()[-1]
    assert last.startswith(f"grainfall: {target}: ")
    assert "section.png" in last
