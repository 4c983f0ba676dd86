"""The synthetic rock is what it says it is."""

import numpy as np
import pytest

from grainfall.errors import InputError
from grainfall.section import Mineral, synthesise
from grainfall.section.synthetic import _gap, _relax

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
        ({"shape": (16, 16, 16)}, "largest grains wide"),
    ],
)
def test_refuses_what_cannot_be_made(change, words):
    given = {"shape": (96, 96, 96), "voxel_size_um": 1.0, "minerals": MINERALS} | change
    with pytest.raises(InputError, match=words):
        synthesise(np.random.default_rng(0), **given)
