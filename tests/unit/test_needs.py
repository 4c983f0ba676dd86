"""What a job asks for is what such jobs have used, and a margin."""

import math

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


def test_a_line_is_found_again():
    table = needs.fit(runs(lambda n: 100 + 20 * n, lambda n: 1000 + 600 * n), {"flow": "Mvoxel"})
    found = table[["start_mb", "mb", "start_s", "s"]].to_numpy()[0]
    assert found == pytest.approx([100, 20, 1000, 600], rel=1e-3)
    need = needs.Needs(table).job("flow", {"Mvoxel": 100.0, "kgrain": 1.0})
    assert need.mem_mb == pytest.approx(2100 / needs.FULL, abs=2)
    assert need.runtime_min == pytest.approx(needs.SLOWER * 61000 / 60, abs=2)


@pytest.mark.parametrize("power", [0.5, 1.5])
def test_no_measured_job_has_too_little(power):
    jobs = runs(lambda n: 50 + 10 * n**power, lambda n: 3 * n)
    asking = needs.Needs(needs.fit(jobs, {"flow": "Mvoxel"}))
    asked = [asking.job("flow", {"Mvoxel": size}).mem_mb for size in jobs["Mvoxel"]]
    shares = jobs["peak_rss_mb"] / asked
    assert max(shares) == pytest.approx(needs.FULL, abs=0.02)
    assert asking.job("flow", {"Mvoxel": 1e-6}).runtime_min == needs.SHORTEST_MIN


@pytest.mark.parametrize("power", [0.3, 2.0])
def test_no_other_line_asks_for_less_where_it_asks_for_most(power):
    jobs = runs(lambda n: 50 + 10 * n**power, lambda n: 0.0)
    row = needs.fit(jobs, {"flow": "Mvoxel"}).iloc[0]
    size, used = jobs["Mvoxel"].to_numpy(), jobs["peak_rss_mb"].to_numpy()

    def most(start, share):
        ratio = (start + share * size) / used
        return ratio.max() / ratio.min()  # raised to the hungriest job

    best = most(row["start_mb"], row["mb"])
    for start in np.linspace(0.2, 5, 40) * row["start_mb"]:
        for share in np.linspace(0.2, 5, 40) * row["mb"]:
            assert most(start, share) > best - 1e-3


def test_what_is_not_known_is_not_guessed():
    jobs = runs(lambda n: 100 + n, lambda n: n)
    asking = needs.Needs(needs.fit(jobs, {"flow": "Mvoxel", "scene": "Mvoxel"}))
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
    assert len(asking.table) > 20
    for rule, row in asking.table.iterrows():
        small, large = (asking.job(rule, {row["per"]: size}) for size in (0.01, 1000.0))
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
