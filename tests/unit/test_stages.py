"""Scene, plan of the virtual spheres, and the second packing's decisions, without any engine."""

import numpy as np
import pandas as pd
import pytest

from grainfall import packing, stereology
from grainfall.errors import InputError

SCENE = {
    "edge_grains": 8.0,
    "edge_um": None,
    "voxel_size_um": None,
    "voxels_per_grain": None,
    "porosity": None,
    "margin_grains": 2.0,
    "sizes_from": "f3d",
}


def equal(radius, width=0.02):
    """Nearly equal radii."""
    edges = np.array([radius * (1 - width), radius * (1 + width)])
    density = np.array([1 / np.ptp(edges)])
    return stereology.SizeDistribution(edges, density, density, density, density, "given", float("nan"))


SIZES = {(1, "grain"): equal(20.0), (2, "grain"): equal(10.0), (0, "pore"): equal(6.0)}
SECTION = {
    "phases": ["pore", "quartz", "feldspar"],
    "fractions": [0.8, 0.2],
    "porosity": 0.4,
    "pixel_size_um": 2.0,
}


def scene(**over):
    sample = over.pop("porosity_of_sample", None)
    return packing.plan_scene(SIZES, SECTION, **{**SCENE, **over}, porosity_of_sample=sample)


def test_mean_grain_and_region():
    """0.8 : 0.2 by volume and 8 : 1 in grain volume make 1 : 2 by number: mean diameter 80 / 3."""
    plan = scene()
    assert plan["probabilities"] == pytest.approx([1 / 3, 2 / 3], rel=1e-3)
    assert plan["mean_diameter_um"] == pytest.approx(80 / 3, rel=1e-3)
    assert plan["edge_um"] == pytest.approx(8 * 80 / 3, abs=2.0)
    assert plan["voxel_size_um"] == 2.0
    assert np.prod(plan["shape_zyx"]) == round(plan["edge_um"] / 2.0) ** 3
    assert plan["margin_um"] == pytest.approx(2 * 80 / 3, rel=1e-3)


def test_voxels_per_grain():
    plan = scene(voxels_per_grain=20)
    assert plan["mean_diameter_um"] / plan["voxel_size_um"] == pytest.approx(20)


@pytest.mark.parametrize(
    ("over", "target", "source"),
    [
        ({}, 0.4, "section"),
        ({"porosity_of_sample": 0.3}, 0.3, "sheet"),
        ({"porosity_of_sample": 0.3, "porosity": 0.2}, 0.2, "config"),
    ],
)
def test_target_porosity_and_where_it_comes_from(over, target, source):
    plan = scene(**over)
    assert plan["porosity_target"] == target
    assert source in plan["porosity_source"]


@pytest.mark.parametrize(
    ("over", "words"), [({"edge_um": 30.0}, "edge_um"), ({"voxel_size_um": 1e-3}, "voxel_size_um")]
)
def test_infeasible_regions_are_refused(over, words):
    with pytest.raises(InputError, match=words):
        scene(**over)


def spheres(first, **over):
    given = {"enabled": True, "limit": 0.01} | over
    return packing.plan_spheres(scene(), equal(12.0), equal(6.0), first, 1e4, **given)


@pytest.mark.parametrize(
    ("first", "over", "called_for", "words"),
    [
        (0.35, {}, True, "exceeds"),
        (0.395, {}, False, "scaling of positions"),
        (0.45, {}, False, "target 0.4000 not reachable by this plan, nearest 0.4500"),
        (0.35, {"enabled": False}, False, "switched off"),
    ],
)
def test_spheres_only_where_the_target_exceeds_the_first_packing(first, over, called_for, words):
    sizes, plan = spheres(first, **over)
    assert plan["called_for"] is called_for
    assert words in plan["reason"]
    assert (plan["p_sp"] > 0) is called_for
    if called_for:
        k = 0.6 / (0.4 - first) * sizes.mean_volume / 1e4
        assert plan["p_sp"] == pytest.approx(1 / (1 + k))


def test_sizes_survive_their_table():
    sizes, _ = spheres(0.35)
    again = packing.VirtualSizes.from_table(sizes.to_table())
    q = np.linspace(0, 1, 9)
    np.testing.assert_array_equal(again.quantile(q), sizes.quantile(q))
    assert again.called_for


def bodies(kind):
    return pd.DataFrame({"kind": kind})


def test_without_a_call_the_first_packing_is_the_second():
    _, plan = spheres(0.45)
    first = bodies(["grain"] * 3), {"poured": 3}

    def never(_):
        raise AssertionError("nothing is to be poured")

    table, report = packing.pack_again(plan, never, never, first, tolerance=0.01, passes=4)
    assert table is first[0]
    assert report["passes"] == []
    assert "not reachable" in report["reason"]


def test_second_packing_repeats_until_the_porosity_fits():
    """A model bed in which each percent of spheres leaves half a percent of porosity."""
    _, plan = spheres(0.35)
    tried = []

    def pack_with(p):
        tried.append(p)
        return bodies(["grain"] * 100 + ["virtual"] * round(1e4 * p)), {"p_sp": p}

    def porosity_of(grains):
        assert (grains.kind == "grain").all()
        return 0.35 + 0.5 * tried[-1]

    _, report = packing.pack_again(plan, pack_with, porosity_of, (None, {}), tolerance=0.01, passes=6)
    assert report["reached"]
    assert abs(0.35 + 0.5 * report["p_sp"] - 0.4) <= 0.01
    assert len(report["passes"]) == len(tried) <= 6


def test_plan_gives_a_reason_for_every_effect():
    shapes = {"hull_excess": 0.12, "collision_excess": 0.06, "n_spheres": 0, "n_hulls": 4, "n_decomposed": 5}
    first = {**shapes, "poured": 9, "engine": "PhysX", "steps": 7}
    _, virtual = spheres(0.45)
    correction = {"applied": False, "reason": "target not reachable"}
    plan = packing.effects_plan(scene(), first, virtual, first, correction, {"first_packing": 1.5})
    assert all(effect["reason"] for effect in plan.values())
    assert plan["gravity_packing"]["cost_s"] == 1.5
    assert not plan["virtual_spheres"]["on"]
    assert not plan["position_scaling"]["on"]
    assert plan["phase_mixing"]["on"]
