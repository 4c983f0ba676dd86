"""The workflow as a part of another one: its rules under other names, its config from that one's."""

import re
import shutil

import pandas as pd
import pytest
import yaml

from conftest import ROOT, TINY, snakemake, write_config
from grainfall import cli

OTHER = re.search(r"^```py\n(.*?)^```", (ROOT / "docs/tutorial.md").read_text(), re.MULTILINE | re.DOTALL)[1]
"""The Snakefile of the tutorial, which has the tiny study as its module."""


def another(folder, more=""):
    """A workflow of somebody else's in that folder."""
    write_config(folder, {"rock": TINY, "depth_m": 1200})
    text = OTHER.replace("/path/to/grainfall/Snakefile", str(ROOT / "Snakefile"))
    (folder / "Snakefile").write_text(text.replace('config["rock"]\n', f'config["rock"]\n{more}'))
    return folder


@pytest.fixture
def other(finished, tmp_path):
    return another(shutil.copytree(finished, tmp_path / "run"))


def run(folder, *arguments):
    return snakemake(folder, *arguments, snakefile="Snakefile")


def test_rules_of_another_workflow_use_what_is_finished(other):
    done = run(other)
    assert done.returncode == 0, done.stdout[-3000:]
    assert "1 of 1 steps" in done.stdout
    assert len(pd.read_csv(other / "widest.csv")) == 10


def test_all_of_it_runs_under_the_names_it_was_given(tmp_path):
    folder = another(tmp_path)
    done = run(folder, "--", "results/tiny/grains2d.csv")
    assert done.returncode == 0, done.stdout[-3000:]
    assert set(re.findall(r"Rule: (\w+)", done.stdout)) == {"rock_synthesise", "rock_morphology"}
    assert (folder / "results/tiny/grains2d.csv").exists()


def test_what_it_rests_on_is_recorded_as_it_was_handed_over(other, monkeypatch, capsys):
    done = run(other, "--", "rock_all")
    assert done.returncode == 0, done.stdout[-3000:]
    monkeypatch.chdir(other)
    assert cli.run(["verify"]) == 0, capsys.readouterr().out


def asked(said):
    """Rule to the resources of its jobs, of a dry run."""
    found = re.findall(r"rule (?:rock_)?(\w+):\n(?:    .*\n)*?    resources: (.*)", said)
    assert found
    return {(rule, re.sub(r"tmpdir=\S+", "", resources)) for rule, resources in found}


def test_jobs_ask_for_what_they_do_alone(other):
    write_config(other, TINY, "rock.yaml")
    alone = snakemake(other, "--dry-run", "--forceall", "--", "all", config="rock.yaml")
    assert asked(run(other, "--dry-run", "--forceall", "--", "rock_all").stdout) == asked(alone.stdout)


def test_what_the_other_workflow_has_stays_its_own(tmp_path):
    """Its default target, and how many parts its own jobs have."""
    folder = another(tmp_path)
    own = """
scattergather:
    slices=3,

rule mine:
    output:
        gather.slices("part_{scatteritem}"),
    shell:
        "touch {output}"

"""
    text = (folder / "Snakefile").read_text().replace("    default_target: True\n", "")
    (folder / "Snakefile").write_text(own + text)
    done = run(folder)
    assert done.returncode == 0, done.stdout[-3000:]
    assert {path.name for path in folder.glob("part_*")} == {f"part_{n}-of-3" for n in (1, 2, 3)}
    assert not (folder / "results/tiny").exists()


def test_a_rule_is_changed_under_a_name_that_tells_which_it_is(tmp_path):
    folder = another(tmp_path)
    more = "\nuse rule synthesise from grainfall as {} with:\n    priority: 5\n"
    text = (folder / "Snakefile").read_text()
    (folder / "Snakefile").write_text(text + more.format("rock_*"))
    done = run(folder, "--dry-run")
    assert done.returncode == 0, done.stdout[-3000:]
    assert "priority: 5" in done.stdout
    (folder / "Snakefile").write_text(text + more.format("rock_synthesise"))
    done = run(folder, "--dry-run")
    assert done.returncode != 0
    assert "rock_synthesise does not tell which of grainfall's rules it is" in done.stdout


@pytest.mark.parametrize("more", ['    prefix: "rocks"\n', '    replace_prefix: {"results/": "rocks/"}\n'])
def test_results_elsewhere_are_refused(tmp_path, more):
    done = run(another(tmp_path, more), "--dry-run")
    assert done.returncode != 0
    assert "a prefix would move what grainfall writes from where it reads it" in done.stdout


def test_config_of_the_module_is_checked(tmp_path):
    folder = another(tmp_path)
    (folder / "config.yaml").write_text(yaml.safe_dump({"rock": {**TINY, "presett": "draft"}}))
    done = run(folder, "--dry-run")
    assert done.returncode != 0
    assert "presett" in done.stdout
    assert "Traceback" not in done.stdout


def test_a_module_without_a_config_says_so(tmp_path):
    folder = another(tmp_path)
    text = (folder / "Snakefile").read_text()
    (folder / "Snakefile").write_text(re.sub(r"    config:\n        config\[.*\]\n", "", text))
    done = run(folder, "--dry-run")
    assert done.returncode != 0
    assert "hand it over, config: config[...]" in done.stdout
