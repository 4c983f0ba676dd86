"""The sweep of what accuracy costs, tiny: its rules run, go on, and end in one table and one page."""

import os
import shutil

import pandas as pd
import pytest

from conftest import TINY, planned, snakemake, write_config
from grainfall.accuracy import COLUMNS
from grainfall.io import read_json

pytestmark = pytest.mark.xdist_group("sweep")

SWEEP = {
    "packing": {"base": ["full"]},
    "against": "full",
    "presets": ["full"],
    "known": {"slices": [3, 12], "sections": [50]},
    "repeats": 1,
}


@pytest.fixture(scope="module")
def swept(finished, tmp_path_factory):
    """The finished tiny twins as a sweep of one setting."""
    folder = tmp_path_factory.mktemp("accuracy")
    shutil.copytree(finished, folder, dirs_exist_ok=True)
    write_config(folder, {**TINY, "accuracy_sweep": SWEEP})
    for target in ("accuracy_sweep", "accuracy"):
        done = snakemake(folder, "--", target)
        assert done.returncode == 0, done.stdout[-6000:]
    return folder


def test_the_table_has_what_was_tried(swept):
    table = pd.read_csv(swept / "results/accuracy/accuracy.csv")
    assert tuple(table.columns) == COLUMNS
    rows = table.set_index(["scene", "metric"])
    twins = [read_json(swept / f"results/tiny/full/{n}/observed.json") for n in (0, 1)]
    truth = read_json(swept / "results/tiny/observed.json")
    off = [abs(twin["k_md"] / truth["k_md"] - 1) for twin in twins]
    assert rows.loc[("twin", "k"), "n"] == 1  # two twins of one truth
    assert rows.loc[("twin", "k"), "error"] == pytest.approx(sum(off) / 2, rel=1e-3)
    repeats = pd.read_csv(swept / "results/accuracy/repeats.csv").query("scene == 'twin' and metric == 'k'")
    assert repeats["repeat"].tolist() == ["tiny/0", "tiny/1"]
    assert repeats["difference"].abs().tolist() == pytest.approx(off, rel=1e-3)
    itself = rows.loc[[("packing", "k")]]
    assert itself["error"].isna().all()
    assert (itself["cpu_s"] > 0).all()
    assert list(table[table["scene"] == "slices"]["setting"]) == ["3", "12"]


def test_page_and_presets_come_with_it(swept):
    for name in ("accuracy.svg", "accuracy.png"):
        assert (swept / "results/accuracy" / name).stat().st_size > 10_000
    presets = pd.read_csv(swept / "results/accuracy/presets.csv")
    assert set(presets["preset"]) == {"full"}


def test_a_truth_that_is_observed_anew_makes_a_new_table(swept):
    assert "accuracy_table" not in planned(swept, "--", "accuracy")
    observed = next((swept / "results").glob("*/observed.json"))
    was = observed.stat()
    os.utime(observed, ns=(was.st_atime_ns, was.st_mtime_ns + 1))
    assert planned(swept, "--", "accuracy")["accuracy_table"] == 1
    os.utime(observed, ns=(was.st_atime_ns, was.st_mtime_ns))


def test_what_is_measured_is_not_measured_again(swept):
    assert planned(swept, "--", "accuracy_sweep") == {}
    more = {**TINY, "accuracy_sweep": {**SWEEP, "known": {"slices": [3, 12], "sections": [50]}, "repeats": 2}}
    write_config(swept, more, "more.yaml")
    jobs = planned(swept, "--", "accuracy_sweep", config="more.yaml")
    assert {rule: n for rule, n in jobs.items() if rule != "accuracy_sweep"} == {"try_known": 2}


def test_knobs_are_tried_on_the_first_truths_and_presets_on_all(swept):
    truths = {**TINY["samples"], "other": TINY["samples"]["tiny"]}
    for twins, more in ((1, 0), (TINY["realizations"] + 1, 1)):
        write_config(
            swept, {**TINY, "samples": truths, "accuracy_sweep": {**SWEEP, "twins": twins}}, "truths.yaml"
        )
        jobs = planned(swept, "--", "accuracy_sweep", config="truths.yaml")
        # of the new truth all twins, of the finished one what was not asked for before
        assert jobs["observe_twin"] == TINY["realizations"] + 2 * more
        assert jobs["observe_reference"] == 1
        assert "observe_first" not in jobs


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"metric": "kk", "tolerance": 0.1}, "unknown metric"),
        ({"metric": "k", "tolerance": 1e-9}, "at least"),
    ],
)
def test_what_no_preset_holds_is_said_before_any_job(tmp_path, asked, words):
    own = {key: value for key, value in TINY.items() if key != "preset"}
    done = snakemake(write_config(tmp_path, {**own, "accuracy": asked}))
    assert done.returncode != 0
    assert words in done.stdout
    assert "Traceback" not in done.stdout
    assert not (tmp_path / "results").exists()
