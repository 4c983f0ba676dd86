"""Beds that rest, resume and resettle."""

import time

import numpy as np
import pandas as pd
import pytest

from grainfall.packing import Box, Parameters, deposit, rest, settle
from grainfall.packing.bed import Bed
from grainfall.packing.deposition import solid_fraction
from grainfall.packing.engine import Solid, start
from grainfall.packing.rest import _draw_apart, relax
from grainfall.packing.stages import let_rest

ENGINES = ["physx", "bullet"]
BOX = Box((300.0,) * 3, 50.0)


class NoShapes:
    """Spheres only."""

    vertices = ()
    faces = ()


def spheres(centres, radius=50.0) -> pd.DataFrame:
    centres = np.asarray(centres, float)
    turns = {"qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "asleep": True}
    table = pd.DataFrame({"id": np.arange(len(centres)), "kind": "grain", "phase": 1, "shape": -1})
    return table.assign(scale=radius, x=centres[:, 0], y=centres[:, 1], z=centres[:, 2], **turns)


def supply(n=200):
    radii = np.random.default_rng(2).uniform(40, 60, n)
    return pd.DataFrame({"kind": "grain", "phase": 1, "shape": -1, "scale": radii})


class Killed(Exception):
    """Stands for a kill."""


@pytest.mark.parametrize("engine", ENGINES)
def test_a_killed_packing_resumes_and_ends_with_the_same_bytes(engine, tmp_path):
    parameters = Parameters.named(engine=engine, checkpoint_steps=150, rest_windows=2)

    def pour(folder=None, dies_at=np.inf):
        last = []

        def progress(line):
            if "poured" in line:
                last.append(int(line.split()[-1]))
                if last[-1] >= dies_at:
                    raise Killed

        rng = np.random.default_rng(3)
        return deposit(supply(), NoShapes, BOX, parameters, rng, progress, folder), last

    undisturbed, steps = pour()
    for share in (0.3, 0.8):
        with pytest.raises(Killed):
            pour(tmp_path, dies_at=share * steps[-1])
    begin = time.perf_counter()
    resumed, seen = pour(tmp_path)
    assert resumed.attrs["report"]["wall_s"] > time.perf_counter() - begin  # what the killed ones took counts
    assert resumed.to_csv() == undisturbed.to_csv()
    assert resumed.attrs["forces"] == undisturbed.attrs["forces"]
    assert seen[0] > 0.8 * steps[-1] - 2 * 150
    # another packing does not take this one's checkpoint
    other = deposit(supply(150), NoShapes, BOX, parameters, np.random.default_rng(3), None, tmp_path)
    assert other.to_csv() != undisturbed.to_csv()


def test_a_bed_of_which_nothing_was_fixed_resumes_with_the_same_bytes(tmp_path):
    """It comes to rest in the finer steps of an engine of its own, not in the one that poured."""
    parameters = Parameters.named(engine="physx", sleep_steps=10**6, rest_windows=2)

    def pour(progress=None):
        return deposit(supply(40), NoShapes, BOX, parameters, np.random.default_rng(3), progress, tmp_path)

    def dies(line):
        if "coming to rest" in line:
            raise Killed

    undisturbed = deposit(supply(40), NoShapes, BOX, parameters, np.random.default_rng(3))
    with pytest.raises(Killed):
        pour(dies)
    assert pour().to_csv() == undisturbed.to_csv()


def test_bodies_drawn_apart_as_patience_ends_are_weighed_all_the_same(monkeypatch):
    bed = Bed.of(spheres([[60, 60, 0], [60, 60, 100]]), NoShapes, BOX, Parameters.named(rest_windows=1))

    def drawn(bed, parameters):
        bed.close()
        return np.ones(len(bed), bool)

    monkeypatch.setattr(rest, "PATIENCE", 1)
    monkeypatch.setattr(rest, "_draw_apart", drawn)
    assert len(relax(bed)["forces"]) == 1


@pytest.mark.parametrize("engine", ENGINES)
def test_forces_carry_the_weight(engine):
    """Two spheres on top of each other: the lower contact bears one weight, the floor two."""
    box = start(Parameters.named(engine=engine), 10, 10)
    weight = 9.8 * 5.0
    ball = Solid((), 1.0, 5.0, np.full(3, 2.0))
    for z in (1.0, 3.0):
        box.add(ball, np.array([5, 5, z]), np.array([1.0, 0, 0, 0]))
    box.step(200)
    found = box.contacts()
    force = {tuple(sorted(pair)): f for pair, f in zip(found.pairs.tolist(), found.force, strict=True)}
    assert force[0, 1] == pytest.approx(weight, rel=0.01)
    assert force[-1, 0] == pytest.approx(2 * weight, rel=0.01)
    box.close()


def test_force_in_newtons():
    """A column of two: the upper grain's weight, 2.6 g/cm3 under Earth's gravity."""
    bodies = spheres([[150, 150, 0], [150, 150, 100]])
    _, report = settle(bodies, NoShapes, BOX, Parameters.named(), windows=3)
    weight = 2600 * 4 / 3 * np.pi * 50e-6**3 * 9.8
    assert report["forces"]["force_n"].tolist() == [pytest.approx(weight, rel=0.01)]
    assert report["forces"][["a", "b"]].to_numpy().tolist() == [[0, 1]]


@pytest.mark.parametrize("engine", ENGINES)
def test_what_rests_stays_and_what_hangs_falls(engine):
    bodies = spheres([[0, 0, 0], [150, 150, 0], [150, 150, 300]])
    bodies["id"] = [7, 3, 12]
    moved, report = settle(bodies, NoShapes, BOX, Parameters.named(engine=engine), windows=10)
    assert moved["id"].tolist() == [7, 3, 12]
    way = np.linalg.norm((moved[["x", "y", "z"]] - bodies[["x", "y", "z"]]).to_numpy(), axis=1)
    assert way[0] < 0.1
    assert way[2] > 190
    assert report["moved_max"] == pytest.approx(way.max() / 50, rel=1e-6)
    assert report["escaped"] == 0


def test_taps_make_a_loose_bed_denser():
    loose = deposit(supply(), NoShapes, BOX, Parameters.named(), np.random.default_rng(1))
    still, tapped = (settle(loose, NoShapes, BOX, Parameters.named(), taps=n)[0]["z"] for n in (0, 20))
    assert abs(still.mean() - loose["z"].mean()) < 0.5
    assert tapped.mean() < still.mean() - 2.0


def test_energy_of_a_bed():
    bodies = spheres([[0, 0, 150]])
    bed = Bed.of(bodies, NoShapes, BOX, Parameters.named(density=1.0))
    mass = 4 / 3 * np.pi
    bed.velocity[0] = [3.0, 0, 0]
    bed.spin[0] = [0, 2.0, 0]
    assert bed.energy() == pytest.approx(mass * (9.8 * 4.0 + 4.5 + 0.4 * 4 / 2))
    # the paper's moments are (1, 1, 1) in the engine, so in its energy, too
    bed.parameters = Parameters.named(density=1.0, inertia="paper")
    assert bed.energy() == pytest.approx(mass * (9.8 * 4.0 + 4.5) + 4 / 2)


def test_a_report_of_a_bed_that_came_to_rest_is_of_that_bed():
    scene = {"edge_um": BOX.roi_um[0], "margin_um": BOX.margin_um}
    loose = deposit(supply(), NoShapes, BOX, Parameters.named(), np.random.default_rng(1), rest=False)
    report = loose.attrs["report"]
    bodies, rested = let_rest((loose, report), scene, NoShapes, Parameters.named(), taps=20)
    assert rested["solid_fraction"] == solid_fraction(bodies, BOX)
    assert rested["solid_fraction"] > report["solid_fraction"] == solid_fraction(loose, BOX)


@pytest.mark.parametrize("engine", ENGINES)
def test_bodies_pressed_into_each_other_part_gently(engine):
    """A tenth of a radius deep: apart again, and thrown no higher than half a radius."""
    bodies = spheres([[150, 150, 0], [150, 150, 95.5]])
    moved, report = settle(bodies, NoShapes, BOX, Parameters.named(engine=engine))
    assert report["max_overlap"] < 0.01
    assert moved["z"][1] == pytest.approx(100, abs=1)
    assert report["energy_rise"] < 0.5 / 4


def test_a_last_moving_grain_does_not_keep_the_others_awake():
    """One grain falls onto a bed: in most steps it and what it touches move, the rest waits."""
    bed = deposit(supply(), NoShapes, BOX, Parameters.named(), np.random.default_rng(1))
    late = spheres([[150, 150, bed["z"].max() + 150]]).assign(id=len(bed))
    moving = []
    together = Bed.of(pd.concat([bed, late], ignore_index=True), NoShapes, BOX, Parameters.named())
    start = together.start

    def counted(parameters=None):
        start(parameters)
        moving.append(int((~together.fixed).sum()))

    together.start = counted
    report = relax(together)
    assert report["at_rest"]
    assert moving[0] == len(together)
    assert 1 <= min(moving) < len(together) / 4


def test_a_check_need_not_wait_for_the_last_grain():
    """The same bed judged by its mean drift alone: at rest, and sooner."""
    bed = deposit(supply(), NoShapes, BOX, Parameters.named(), np.random.default_rng(1))
    late = spheres([[150, 150, bed["z"].max() + 150]]).assign(id=len(bed))
    both = pd.concat([bed, late], ignore_index=True)
    reports = [
        settle(both, NoShapes, BOX, Parameters.named(), rest=0.05, every=every)[1] for every in (True, False)
    ]
    assert all(report["at_rest"] and report["drift_mean"] < 0.05 for report in reports)
    assert reports[1]["steps"] < reports[0]["steps"]


def test_around_a_body():
    row = Bed.of(spheres([[0, 0, 0], [99, 0, 0], [201, 0, 0]]), NoShapes, BOX, Parameters.named())
    assert row.around(np.array([True, False, False])).tolist() == [True, True, False]
    assert row.around(np.array([False, False, True])).tolist() == [False, False, True]


def test_what_is_overlooked_is_drawn_apart_where_it_lies():
    """Two spheres a twentieth of a radius in each other come apart; a third, out of their reach, stays."""
    parameters = Parameters.named(engine="physx")
    bed = Bed.of(spheres([[60, 60, 0], [155, 60, 0], [240, 240, 0]]), NoShapes, BOX, parameters)
    before = bed.position.copy()
    drawn = _draw_apart(bed, parameters)
    assert drawn.tolist() == [True, True, False]
    assert bed.overlaps()[0] < 0.01
    assert (bed.position[2] == before[2]).all()
    assert not _draw_apart(bed, parameters).any()
