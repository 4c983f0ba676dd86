"""The synthetic rock is what it says it is."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from skimage.measure import regionprops

from grainfall.errors import InputError
from grainfall.section import Mineral, synthesise
from grainfall.section.synthetic import _gap, _radii, _relax

MINERALS = [Mineral("quartz", 0.7, 10.0, 0.2), Mineral("feldspar", 0.3, 7.0, 0.2)]


@pytest.fixture(scope="module")
def truth():
    return synthesise(np.random.default_rng(5), (96, 96, 96), 1.0, MINERALS, solid_fraction=0.55)


def test_solid_fraction_and_shares(truth):
    """Shapes keep the volume of their spheres; what they lose is where they clip each other."""
    solid = (truth.phase > 0).mean()
    assert 0.55 * 0.93 < solid < 0.56
    share = (truth.phase == 1).sum() / (truth.phase > 0).sum()
    assert share == pytest.approx(0.7, abs=0.03)


def test_true_sizes(truth):
    sizes = truth.sizes()
    assert (4 / 3 * np.pi * (sizes.r_um**3)).sum() == pytest.approx((truth.phase > 0).sum())
    for number, mineral in enumerate(MINERALS, start=1):
        r = sizes.r_um[sizes.phase == number]
        assert r.mean() == pytest.approx(mineral.radius_um, rel=4 * mineral.cv / np.sqrt(len(r)) + 0.03)


def test_relaxed_spheres_do_not_overlap():
    rng = np.random.default_rng(2)
    box, r = np.array([60.0, 50.0, 40.0]), rng.uniform(2, 4, 450)
    x = _relax(rng.random((450, 3)) * box, r, box)
    pairs = np.array([(i, j) for i in range(450) for j in range(i)])
    smaller = np.minimum(r[pairs[:, 0]], r[pairs[:, 1]])
    assert (_gap(x, r, box, pairs) / smaller).min() > -0.0101
    assert ((x >= 0) & (x < box)).all()


def test_dissolution_removes_that_share_and_moves_nothing(truth):
    less = synthesise(
        np.random.default_rng(5), (96, 96, 96), 1.0, MINERALS, solid_fraction=0.55, dissolved=0.2
    )
    assert len(less.sizes()) / len(truth.sizes()) == pytest.approx(0.8, abs=0.08)
    assert (truth.phase[less.phase > 0] == less.phase[less.phase > 0]).mean() > 0.97


def test_same_seed_same_rock(truth):
    again = synthesise(np.random.default_rng(5), (96, 96, 96), 1.0, MINERALS, solid_fraction=0.55)
    np.testing.assert_array_equal(again.grain, truth.grain)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"solid_fraction": 0.7}, "solid_fraction"),
        ({"dissolved": 1.0}, "dissolved"),
        ({"minerals": []}, "minerals"),
        ({"packed_porosity": 1.2}, "packed_porosity"),
        ({"packed_porosity": 0.4, "porosity": 0.3}, "dissolution opens pores only"),
        ({"porosity": 0.5, "dissolved": 0.1}, "dissolved"),
        ({"shape": (16, 16, 16)}, "largest grains wide"),
        # a vug in mm would be drawn for ever
        ({"porosity": 0.6, "vug_radius_um": 1e-3}, "vug_radius_um.*once in"),
    ],
)
def test_refuses_what_cannot_be_made(change, words):
    given = {"shape": (96, 96, 96), "voxel_size_um": 1.0, "minerals": MINERALS} | change
    with pytest.raises(InputError, match=words):
        synthesise(np.random.default_rng(0), **given)


SHAPE = (96, 96, 96)


@pytest.fixture(scope="module")
def grown():
    return synthesise(np.random.default_rng(5), SHAPE, 1.0, MINERALS, packed_porosity=0.227)


def test_growth_meets_the_porosity_to_a_voxel(grown):
    assert np.count_nonzero(grown.phase == 0) == round(0.227 * grown.phase.size)


def test_grown_grains_have_the_sizes_asked_for(grown):
    sizes = grown.sizes()
    for number, mineral in enumerate(MINERALS, start=1):
        r = sizes.r_um[sizes.phase == number]
        assert r.mean() == pytest.approx(mineral.radius_um, rel=4 * mineral.cv / np.sqrt(len(r)) + 0.03)
        assert r.std() / r.mean() == pytest.approx(mineral.cv, rel=0.35)
    share = (grown.phase == 1).sum() / (grown.phase > 0).sum()
    assert share == pytest.approx(0.7, abs=0.03)


@pytest.mark.parametrize("vug", [0.0, 18.0])
def test_dissolution_meets_the_porosity_to_a_voxel(vug):
    rock = {"packed_porosity": 0.36, "porosity": 0.4304, "vug_radius_um": vug}
    packed = synthesise(np.random.default_rng(5), SHAPE, 1.0, MINERALS, packed_porosity=0.36)
    truth = synthesise(np.random.default_rng(5), SHAPE, 1.0, MINERALS, **rock)
    assert np.count_nonzero(truth.phase == 0) == round(0.4304 * truth.phase.size)
    left = truth.grain > 0
    assert (truth.grain[left] == packed.grain[left]).all()
    # whole grains go, all but the last one
    went = np.unique(packed.grain[(packed.grain > 0) & ~left])
    assert sum((truth.grain == g).any() for g in went) <= 1


def test_vugs_are_larger_pores_than_single_grains_leave():
    """At one porosity, a point of the pore space is farther from the nearest grain."""
    distance = []
    for vug in (0.0, 25.0):
        rock = {"packed_porosity": 0.36, "porosity": 0.45, "vug_radius_um": vug}
        truth = synthesise(np.random.default_rng(5), SHAPE, 1.0, MINERALS, **rock)
        distance.append(distance_transform_edt(truth.phase == 0)[truth.phase == 0].mean())
    assert distance[1] > 1.15 * distance[0]


def test_spheres_are_spheres():
    """Exponent 2 without elongation: sections are discs, 3 d of area pi r^2 about their box's middle."""
    balls = [Mineral("glass", 1.0, 9.0, 0.0, 0.0)]
    truth = synthesise(np.random.default_rng(1), SHAPE, 1.0, balls, exponent=2, solid_fraction=0.3)
    assert truth.sizes().r_um.to_numpy() == pytest.approx(9.0, rel=0.02)
    _, grain = truth.section(0.25)
    inside = [r for r in regionprops(grain) if min(r.bbox[:2]) > 0 and max(r.bbox[2:]) < 4 * 96]
    assert len(inside) > 10
    for disc in inside:
        if disc.area > 1000:
            assert disc.area == pytest.approx(
                np.pi / 4 * disc.axis_major_length * disc.axis_minor_length, rel=0.02
            )
            assert disc.axis_minor_length == pytest.approx(disc.axis_major_length, rel=0.06)


def test_section_is_a_plane_of_the_truth(grown):
    phase, grain = grown.section()
    assert (phase == grown.phase[48]).all()
    assert (grain == grown.grain[48]).all()
    fine, _ = grown.section(0.25)
    assert fine.shape == (384, 384)
    assert (fine == 0).mean() == pytest.approx((phase == 0).mean(), abs=0.01)
    with pytest.raises(InputError, match="does not divide"):
        grown.section(0.7)


def test_same_numbers_same_truth(grown):
    again = synthesise(np.random.default_rng(5), SHAPE, 1.0, MINERALS, packed_porosity=0.227)
    assert (again.grain == grown.grain).all()
    other = synthesise(np.random.default_rng(6), SHAPE, 1.0, MINERALS, packed_porosity=0.227)
    assert (other.grain != grown.grain).any()


def test_the_cube_stands_for_the_whole(grown):
    cubes = [abs((grown.cubes(e)[0] == 0).mean() - 0.227) for e in (32, 64)]
    assert max(cubes) < 0.02
    assert grown.cubes(96)[0].shape == SHAPE


def test_cubes_of_a_truth_share_no_voxel_and_the_nearest_comes_first(grown):
    cubes = grown.cubes(32, 5)
    assert cubes[0].tobytes() == grown.cubes(32)[0].tobytes()
    misses = [abs((cube == 0).mean() - 0.227) for cube in cubes]
    assert misses == sorted(misses)
    base = grown.phase.__array_interface__["data"][0]
    voxels = np.zeros(SHAPE, int)
    for cube in cubes:
        start = np.unravel_index(cube.__array_interface__["data"][0] - base, SHAPE)
        voxels[tuple(slice(s, s + 32) for s in start)] += 1
    assert voxels.max() == 1
    with pytest.raises(InputError, match=r"only 1 cubes of 64 voxels, .* not 2"):
        grown.cubes(64, 2)


def test_radii_have_the_mean_and_spread_asked_for():
    """Of many grains: a lognormal's mean is not its median."""
    found = _radii(np.random.default_rng(0), Mineral("quartz", 1.0, 10.0, 0.5), 2e8)
    assert found.mean() == pytest.approx(10.0, rel=0.02)
    assert found.std() / found.mean() == pytest.approx(0.5, rel=0.04)


def test_spheres_pushed_apart_keep_their_common_centre_of_mass():
    x, r, box = np.array([[20.0, 20, 20], [21, 20.5, 20]]), np.array([1.0, 3.0]), np.full(3, 40.0)
    apart = _relax(x.copy(), r, box)
    assert np.linalg.norm(apart[1] - apart[0]) > 3.98
    assert np.average(apart, axis=0, weights=r**3) == pytest.approx(np.average(x, axis=0, weights=r**3))


@pytest.mark.parametrize("packed", [None, 0.963])
@pytest.mark.parametrize(("exponent", "elongation"), [(2, 0.3), (3, 0.3), (3, 0.0)])
def test_a_grain_reaches_as_far_as_its_formula_says(exponent, elongation, packed):
    """Support of |F d|_p <= s along an axis: s times the q-norm of that row of the inverse, 1/p + 1/q = 1."""
    block, q = [Mineral("quartz", 1.0, 20.0, 0.0, elongation)], exponent / (exponent - 1)
    for seed in range(4):
        truth = synthesise(
            np.random.default_rng(seed), (96,) * 3, 1.0, block,
            exponent=exponent, solid_fraction=0.02, packed_porosity=packed,
        )  # fmt: skip
        bodies, at = truth.bodies, np.argwhere(truth.grain > 0)[:, ::-1] + 0.5
        assert len(truth.sizes()) == 1
        reach = (np.abs(np.linalg.inv(bodies.frame[0])) ** q).sum(axis=1) ** (1 / q)
        found = np.abs((at - bodies.centre[0] + 48) % 96 - 48).max(axis=0)
        assert found == pytest.approx(reach * bodies.level[0] ** (1 / exponent), abs=1)


@pytest.mark.parametrize("exponent", [2, 3])
def test_a_grain_has_the_volume_of_its_sphere_however_long_it_is(exponent):
    given = {"exponent": exponent, "solid_fraction": 0.02}
    truth = synthesise(
        np.random.default_rng(3), (96,) * 3, 1.0, [Mineral("quartz", 1.0, 10.0, 0.0, 0.3)], **given
    )
    assert truth.sizes().r_um.to_numpy() == pytest.approx(10.0, rel=0.005)
