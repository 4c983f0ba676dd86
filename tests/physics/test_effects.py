"""Optional effects in real packings of a small bed: what they change, and what they cost."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import trimesh
from scipy import ndimage

from grainfall import contacts, correlation, packing, volume
from grainfall.errors import InputError

pytestmark = pytest.mark.xdist_group("effects")

SCENE = {
    "phases": ["pore", "quartz"],
    "fractions": [1.0],
    "sizes_from": "f3d",
    "edge_um": 60.0,
    "margin_um": 10.0,
    "shape_zyx": [60, 60, 60],
    "voxel_size_um": 1.0,
    "resolution_um": 1.0,
}
WIDE = {**SCENE, "edge_um": 90.0, "shape_zyx": [90, 90, 90]}
"""Beds of SCENE scatter by 0.015 in porosity, more than feedback has to meet."""

SIZES = {(1, "grain"): SimpleNamespace(quantile=lambda q, which="f3d": 8.0 + 4.0 * np.asarray(q))}


@pytest.fixture(scope="module")
def library():
    """One ellipsoid, equal-volume radius 1."""
    ball = trimesh.creation.icosphere(2)
    table = pd.DataFrame({"shape": [0], "phase": [1], "r2d_um": [10.0]})
    return SimpleNamespace(
        vertices=[ball.vertices * [1.2, 1.0, 1 / 1.2]], faces=[ball.faces], pieces=[()], table=table
    )


@pytest.fixture(scope="module")
def pack(library):
    def pack_with(parameters, seed=0, rest=True, scene=SCENE):
        return packing.pack(scene, SIZES, library, parameters, np.random.default_rng(seed), rest=rest)

    return pack_with


def test_a_bed_that_does_not_cover_the_region_is_no_packing(pack):
    with pytest.raises(InputError, match=r"the bed ends .* um high in a region of .* still moving"):
        pack(packing.Parameters(max_idle_steps=10), rest=False)


@pytest.fixture(scope="module")
def rested(library):
    def let_rest(poured, lubrication, taps, scene=SCENE):
        return packing.let_rest(poured, scene, library, packing.Parameters().lubricated(lubrication), taps)

    return let_rest


@pytest.fixture(scope="module")
def porosity(library):
    def porosity_of(bodies, scene=SCENE):
        return volume.porosity(volume.voxelise(bodies, library, scene["shape_zyx"], 1.0)[0])

    return porosity_of


@pytest.fixture(scope="module")
def plain(pack):
    """The first packings of three realizations, by a coarse solver."""
    return [pack(packing.Parameters(), seed) for seed in range(3)]


def test_refinement_changes_nothing_but_the_cost(pack, plain, porosity, library):
    """Half the step and twice the iterations: no metric leaves the spread of realizations; more work is done.

    Work is counted in solver iterations: the seconds of a shared machine are no test.
    """
    fine = [
        packing.pack_first(lambda p, seed=seed: pack(p, seed), packing.Parameters(), "on")
        for seed in range(3)
    ]

    def contacts_of(bodies, report):
        parameters = packing.Parameters()
        found = contacts.find_contacts(bodies, library, None, 1.0, 0.01, parameters)
        return contacts.coordination(found, bodies, (SCENE["edge_um"],) * 3).iloc[0]["coordination"]

    def s2_of(bodies, report):
        solid = volume.voxelise(bodies, library, SCENE["shape_zyx"], 1.0)[0] > 0
        return np.interp(8.0, *correlation.along_axes(correlation.s2_volume(solid, 1.0)))

    for measure in (lambda b, r: porosity(b), lambda b, r: r["poured"], contacts_of, s2_of):
        coarse, finer = (np.array([measure(*one) for one in ensemble]) for ensemble in (plain, fine))
        # the difference of two means of n, at three standard errors of the pooled spread
        error = np.sqrt((coarse.var(ddof=1) + finer.var(ddof=1)) / len(fine))
        assert abs(finer.mean() - coarse.mean()) <= 3 * error
    for (_, coarse), (_, finer) in zip(plain, fine, strict=True):
        assert finer["refinement"]["forced"]
        assert finer["refinement"]["cost_s"] > 0
        work = [r["steps"] * r["parameters"]["solver_iterations"] for r in (coarse, finer)]
        assert work[1] > 2 * work[0]


def deficit(first, target):
    return {
        "porosity_first": first,
        "porosity_target": target,
        "overgrowth": {"on": False, "porosity": target},
        "virtual_spheres": {"on": False, "for_tail": False, "p_sp": 0.0},
        "between": None,
    }


def test_lubrication_reaches_a_denser_target_and_misses_it_when_off(pack, rested, porosity):
    porosity = partial(porosity, scene=WIDE)
    plain = pack(packing.Parameters(), scene=WIDE)
    first = porosity(plain[0])
    plan = deficit(first, first - 0.03)

    def again(switch):
        return packing.pack_again(
            plan,
            lambda p, lubrication: pack(packing.Parameters().lubricated(lubrication), rest=False, scene=WIDE),
            partial(rested, scene=WIDE),
            porosity,
            plain,
            densification=switch,
            passes=5,
        )

    bodies, report = again("auto")
    assert report["reached"]
    assert abs(porosity(bodies) - plan["porosity_target"]) <= 0.01
    assert bodies["asleep"].mean() > 0.95
    bodies, report = again("off")
    assert not report["reached"]
    pd.testing.assert_frame_equal(bodies, plain[0])


def test_vugs_in_a_dense_rock_need_spheres_and_a_denser_skeleton(pack, rested, porosity, library):
    """A target no looser than the first packing, with pores that it has not: either effect alone misses."""
    porosity = partial(porosity, scene=WIDE)
    plain = pack(packing.Parameters(), scene=WIDE)
    first, none = porosity(plain[0]), np.zeros(1)
    vugs = packing.VirtualSizes(np.array([17.0, 19.0]), none, none, none, np.array([0.5]), True, "")
    plan = deficit(first, first)
    plan["virtual_spheres"] = {"on": True, "for_tail": True, "p_sp": 0.02}

    def pour_with(p_sphere, lubrication):
        return packing.pack(
            WIDE, SIZES, library, packing.Parameters().lubricated(lubrication),
            np.random.default_rng(0), spheres=vugs, p_sphere=p_sphere, rest=False,
        )  # fmt: skip

    def again(switch):
        return packing.pack_again(
            plan, pour_with, partial(rested, scene=WIDE), porosity, plain, densification=switch, passes=6
        )

    def widest(bodies):
        grains = bodies[bodies["kind"] == "grain"]
        pore = volume.voxelise(grains, library, WIDE["shape_zyx"], 1.0)[0] == 0
        return ndimage.distance_transform_edt(pore).max()

    both, report = again("auto")
    assert report["reached"]
    assert report["densification"]["on"]
    assert abs(porosity(both[both["kind"] == "grain"]) - first) <= 0.01
    assert widest(both) > 14 > widest(plain[0]) + 2
    _, report = again("off")
    assert not report["reached"]
    assert report["porosity"] > first + 0.01


def test_taps_pack_denser_than_lubrication_alone(pack, rested, porosity):
    poured = pack(packing.Parameters().lubricated(0.2), rest=False)
    assert porosity(rested(poured, 0.2, 4)[0]) < porosity(rested(poured, 0.2, 0)[0])


def test_a_packing_comes_to_rest_when_it_is_asked_to(pack, rested):
    """Poured and brought to rest later it is the same as in one go, but for a rattler's way."""
    at_once, whole = pack(packing.Parameters())
    poured, report = pack(packing.Parameters(), rest=False)
    assert report["rest"] == {}
    assert not len(report["forces"])
    later, parts = rested((poured, report), 1.0, 0)
    assert parts.keys() == whole.keys()
    assert parts["rest"].keys() == whole["rest"].keys()
    assert parts["rest"]["at_rest"]
    way = np.linalg.norm(later[["x", "y", "z"]] - at_once[["x", "y", "z"]], axis=1)
    assert np.quantile(way, 0.9) < 0.01 * at_once["scale"].mean()
    assert way.max() < at_once["scale"].mean()
