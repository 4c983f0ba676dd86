"""What a job asks for is what such jobs have used, and a margin."""

import math
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from grainfall import io
from grainfall.cli import needs
from grainfall.packing.scene import POURED


def runs(memory, seconds, sizes=(0.1, 1.0, 10.0)):
    return pd.DataFrame(
        [
            {"rule": "flow", "Mvoxel": n, "kgrain": np.nan, "peak_rss_mb": memory(n), "cpu_s": seconds(n)}
            for n in sizes
        ]
    )


def test_a_start_and_a_share_are_carried_to_any_size():
    table = needs.hungriest(runs(lambda n: 100 + 20 * n, lambda n: 1000 + 600 * n), {"flow": "Mvoxel"})
    for size in (0.1, 5.0, 10.0, 100.0):
        need = needs.Needs(table).job("flow", {"Mvoxel": size, "kgrain": 1.0})
        assert need.mem_mb == pytest.approx((100 + 20 * size) / needs.FULL, abs=2)
        assert need.runtime_min == pytest.approx(needs.SLOWER * (1000 + 600 * size) / 60, abs=2)


def test_one_hungry_job_does_not_end_the_growth():
    used = {1.0: 10.0, 3.0: 1415.0, 20.0: 1100.0}
    table = needs.hungriest(runs(lambda n: 100, used.get, sizes=tuple(used)), {"flow": "Mvoxel"})
    asked = [needs.Needs(table).job("flow", {"Mvoxel": size}).runtime_min for size in (20.0, 200.0)]
    assert asked[1] > 5 * asked[0]


@pytest.mark.parametrize("power", [0.5, 1.5])
def test_every_measured_job_has_what_it_used_and_a_margin(power):
    jobs = runs(lambda n: 50 + 10 * n**power, lambda n: 3 * n)
    asking = needs.Needs(needs.hungriest(jobs, {"flow": "Mvoxel"}))
    asked = [asking.job("flow", {"Mvoxel": size}).mem_mb for size in jobs["Mvoxel"]]
    assert jobs["peak_rss_mb"].to_numpy() / asked == pytest.approx(needs.FULL, abs=0.02)
    assert asking.job("flow", {"Mvoxel": 1e-6}).runtime_min == needs.SHORTEST_MIN


@pytest.mark.parametrize(("size", "threads"), [(0.01, 1), (4, 1), (6, 2), (20, 5), (1e4, needs.MOST_THREADS)])
def test_long_jobs_are_given_threads(size, threads):
    asking = needs.Needs(needs.hungriest(runs(lambda n: n, lambda n: 30 * n), {"flow": "Mvoxel"}))
    assert asking.job("flow", {"Mvoxel": size}).threads == threads


def test_of_jobs_of_a_size_the_hungriest_counts():
    jobs = pd.concat(
        [runs(lambda n: 300 * n, lambda n: 2 * n), runs(lambda n: 500 * n, lambda n: n), runs(abs, abs)]
    )
    row = needs.hungriest(jobs, {"flow": "Mvoxel"}).set_index("size").loc[10.0]
    assert row["mb"] == 5000
    assert row["s"] == 20.0


def test_a_larger_job_never_gets_less():
    jobs = runs(lambda n: 900 - 80 * n, lambda n: 50.0 if n == 1 else 1.0)
    asking = needs.Needs(needs.hungriest(jobs, {"flow": "Mvoxel"}))
    asked = [asking.job("flow", {"Mvoxel": size}) for size in (0.01, 0.1, 0.5, 1.0, 7.0, 10.0, 100.0)]
    assert [need.mem_mb for need in asked] == [math.ceil(892 / needs.FULL)] * 7
    assert all(a.runtime_min <= b.runtime_min for a, b in pairwise(asked))


def test_of_one_size_the_share_of_each_voxel_is_known():
    asking = needs.Needs(needs.hungriest(runs(lambda n: 100.0, lambda n: n, (2.0,)), {"flow": "Mvoxel"}))
    assert asking.job("flow", {"Mvoxel": 6.0}).mem_mb == math.ceil(300 / needs.FULL)
    assert asking.job("flow", {"Mvoxel": 0.1}).mem_mb == math.ceil(100 / needs.FULL)


def test_what_is_not_known_is_not_guessed():
    jobs = runs(lambda n: 100 + n, lambda n: n)
    asking = needs.Needs(needs.hungriest(jobs, {"flow": "Mvoxel", "scene": "Mvoxel"}))
    assert asking.job("scene", {"Mvoxel": 1.0}) is None  # of no job
    assert asking.job("flow", {}) is None


def test_sizes_come_from_what_is_written(tmp_path):
    assert needs.size_of("twin", tmp_path, "full") == {}
    assert needs.size_of("reference_flow", tmp_path) == {}
    scene = {
        "shape_zyx": [100, 100, 200],
        "edge_um": 80.0,
        "margin_um": 10.0,
        "probabilities": [0.5, 0.5],
        "mean_volumes_um3": [100.0, 300.0],
    }
    (tmp_path / "full").mkdir()
    io.write_json(tmp_path / "full/scene.json", scene)
    grains = POURED * 100**3 / 200 / 1000
    assert needs.size_of("twin", tmp_path, "full") == {"Mvoxel": 2.0, "kgrain": pytest.approx(grains)}
    assert needs.size_of("flow", tmp_path, "full", coarsen=2)["Mvoxel"] == 0.25
    assert needs.size_of("twin", tmp_path, "full", coarsen=2)["Mvoxel"] == 2.0
    phase = np.zeros((4, 5, 6), np.uint8)
    with io.create_volume(
        tmp_path / "reference.zarr.zip", phase.shape, {"phase": "uint8"}, 1.0, {}
    ) as volume:
        volume["phase"][:] = phase
    assert needs.size_of("reference_flow", tmp_path) == {"Mvoxel": 120e-6}
    assert needs.size_of("morphology", tmp_path) == {}


def test_the_table_that_comes_with_it_grows_with_size():
    asking = needs.Needs.measured()
    per = asking.table.groupby("rule")["per"].first()
    assert len(per) > 20
    for rule, unit in per.items():
        small, large = (asking.job(rule, {unit: size}) for size in (0.01, 1000.0))
        assert 0 < small.mem_mb <= large.mem_mb < math.inf, rule
        assert small.runtime_min <= large.runtime_min, rule


@pytest.mark.parametrize("content", ["", "{}", "[1]", '{"edge_um": "wide"}'])
def test_what_is_damaged_has_no_size(tmp_path, content):
    """The job that needs it says what is wrong with it."""
    for path in ("section.zarr.zip", "full/scene.json"):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(content)
    assert needs.size_of("morphology", tmp_path) == {}
    assert needs.size_of("twin", tmp_path, "full") == {}


@pytest.mark.parametrize(("overgrowth", "densification", "rims"), [(1, 0, True), (0, 1, True), (0, 0, False)])
def test_whether_a_twin_gets_rims_comes_from_its_packings(tmp_path, overgrowth, densification, rims):
    assert not needs.cemented(tmp_path)  # nothing is known yet
    io.write_json(tmp_path / "deficit.json", {"overgrowth": {"on": bool(overgrowth)}})
    assert not needs.cemented(tmp_path)
    (tmp_path / "second").mkdir()
    io.write_json(tmp_path / "second/packing.json", {"densification": {"too_loose": bool(densification)}})
    assert needs.cemented(tmp_path) == rims
