"""Grains pressed into each other where rims would round what the section shows angular."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import trimesh

from grainfall import volume
from grainfall.section import resample
from grainfall.surface import solid_surface

CUBE = trimesh.creation.box(extents=[1, 1, 1])
CUBES = SimpleNamespace(vertices=[CUBE.vertices.view(np.ndarray)], faces=[CUBE.faces.astype(np.int32)])
TRUE = 1.3
"""Growth of the cubes of the rock."""


def cubes(edge, shape=0):
    """Cubes (or spheres) turned at random, on a lattice of 30 voxels that reaches beyond the region."""
    xyz = np.stack(np.meshgrid(*[30 * (np.arange(-1, 5) + 0.5)] * 3), axis=-1).reshape(-1, 3)
    q = np.random.default_rng(0).normal(size=(len(xyz), 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    bodies = pd.DataFrame({"id": range(len(xyz)), "kind": "grain", "phase": 1, "shape": shape})
    return bodies.assign(scale=edge, **dict(zip("xyz", xyz.T, strict=True))).assign(
        **dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True))
    )


def rock(bodies):
    """Surface of the bodies grown in their own shapes, and the scene that has their porosity."""
    phase, _ = volume.voxelise(bodies.assign(scale=TRUE * bodies["scale"]), CUBES, (120,) * 3, 1.0)
    scene = {"shape_zyx": [120] * 3, "voxel_size_um": 1.0, "resolution_um": 1.0}
    scene["porosity_target"] = volume.porosity(phase) - 0.0005
    return solid_surface(phase, 1.0).per_um, scene


@pytest.fixture(scope="module")
def angular():
    bodies = cubes(12.0)
    return bodies, *rock(bodies)


def compacted(angular, **given):
    bodies, section, scene = angular
    return volume.compact(bodies, CUBES, scene, section, **{"dense": True} | given)


def test_angular_grains_are_pressed_to_the_sections_surface(angular):
    said = []
    bodies, report = compacted(angular, progress=said.append)
    assert len(said) >= 5
    assert f"the section has {angular[1]:.4g}" in said[0]
    assert report["on"]
    assert report["factor"] == pytest.approx(TRUE, abs=0.005)
    assert report["porosity"] > angular[2]["porosity_target"]
    assert "less than the section's" in report["reason"]
    assert "pressed to 76.9 % of" in report["reason"]  # 1 / 1.3
    np.testing.assert_allclose(bodies["scale"], report["factor"] * angular[0]["scale"])
    pd.testing.assert_frame_equal(bodies.drop(columns="scale"), angular[0].drop(columns="scale"))


def test_half_way_between_pressing_and_rims(angular):
    bodies, section, scene = angular
    rims = solid_surface(
        volume.with_rims(
            volume.voxelise(bodies, CUBES, scene["shape_zyx"], 1.0)[0], scene["porosity_target"]
        ),
        1.0,
    )
    wanted = (section + rims.per_um) / 2
    moved, report = volume.compact(bodies, CUBES, scene, wanted, dense=True)
    assert 1.0 < report["factor"] < TRUE
    phase, _ = volume.voxelise(moved, CUBES, scene["shape_zyx"], 1.0)
    twin = volume.with_rims(phase, scene["porosity_target"])
    assert abs((~twin).mean() - scene["porosity_target"]) < 1e-6
    assert solid_surface(twin, 1.0).per_um == pytest.approx(wanted, rel=0.01)


def test_a_section_of_coarser_pixels_is_held_against_as_coarse_a_twin(angular):
    bodies, section, scene = angular
    phase, _ = volume.voxelise(bodies.assign(scale=TRUE * bodies["scale"]), CUBES, (120,) * 3, 1.0)
    coarse = solid_surface(resample(phase, 1.0, 3.0), 3.0).per_um
    assert coarse < 0.97 * section  # edges and corners are lost
    _, report = volume.compact(bodies, CUBES, scene | {"resolution_um": 3.0}, coarse, dense=True)
    assert report["factor"] == pytest.approx(TRUE, abs=0.02)
    _, fooled = volume.compact(bodies, CUBES, scene, coarse, dense=True)
    assert fooled["factor"] < TRUE - 0.1


def test_less_than_the_least_pressing_is_none_and_is_said(angular):
    bodies, section, scene = angular
    open_ = volume.porosity(volume.voxelise(bodies, CUBES, scene["shape_zyx"], 1.0)[0])
    narrow = scene | {"porosity_target": open_ - 1e-4}
    moved, report = volume.compact(bodies, CUBES, narrow, 2 * section, dense=True)
    assert moved is bodies
    assert (report["on"], report["factor"], report["porosity"]) == (True, 1.0, open_)
    assert report["reason"].endswith("the least that they can be pressed by (0.2 % of distances) is too much")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"switch": "off"}, "switched off in the config, although the rock is denser"),
        ({"dense": False}, "no denser than its grains pour to"),
    ],
)
def test_where_it_is_not_to_act_the_bed_stays(angular, given, words):
    bodies, report = compacted(angular, **given)
    assert bodies is angular[0]
    assert not report["on"]
    assert report["factor"] == 1.0
    assert words in report["reason"]


@pytest.mark.parametrize("switch", ["auto", "on"])
def test_round_grains_leave_nothing_to_press(switch):
    """A sphere with a rim is a larger sphere: both ways leave the same surface, on voxels within 5 %."""
    spheres = cubes(9.0, shape=-1)
    section, scene = rock(spheres)
    bodies, report = volume.compact(spheres, CUBES, scene, 0.95 * section, dense=True, switch=switch)
    assert bodies is spheres
    assert not report["on"]


def test_the_porosity_told_is_that_of_the_pressed_bed(angular):
    bodies, report = compacted(angular)
    phase, _ = volume.voxelise(bodies, CUBES, angular[2]["shape_zyx"], 1.0)
    assert report["porosity"] == volume.porosity(phase)
