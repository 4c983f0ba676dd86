"""The study of size bias: its truths show as many grains as it asks for, its packs have the sizes told."""

from functools import partial

import numpy as np
import pytest

from grainfall import flow, random
from grainfall.size_bias import measured, pack, rock, section_side, seen
from grainfall.stereology import SizeDistribution


@pytest.mark.parametrize("cv", [0.1, 0.4, 0.7])
def test_a_section_of_that_edge_shows_the_grains_asked_for(cv):
    """Spheres thrown at random, cut by a plane; circles are counted that lie in the square as a whole."""
    rng = np.random.default_rng(0)
    radii = 5 * rng.gamma(1 / cv**2, cv**2, 100_000)
    wanted, porosity = 200, 0.4
    side = section_side(radii, porosity, wanted)
    reach = radii.max()
    density = (1 - porosity) / (4 / 3 * np.pi * (radii**3).mean())
    counts = []
    for _ in range(400):
        n = rng.poisson(density * (side + 2 * reach) ** 2 * 2 * reach)
        r = rng.choice(radii, n)
        x, y = rng.uniform(-reach, side + reach, (2, n))
        z = rng.uniform(-reach, reach, n)
        cut = np.sqrt(np.maximum(r**2 - z**2, 0))
        whole = (cut > 0) & (np.minimum(x, y) > cut) & (np.maximum(x, y) < side - cut)
        counts.append(whole.sum())
    assert np.mean(counts) == pytest.approx(wanted, rel=0.017)


def test_packs_without_the_inversion_have_the_sizes_of_the_sections():
    """Of narrow sizes sections are pi / 4 as large as spheres; unfolded, they are the truth's again."""

    stream = partial(random.generator, 1, "s", 0)
    truth = rock(0.1, stream, porosity=0.4, voxels_per_radius=5.0, edge=40, grains=80)
    r = truth.sizes().r_um.mean()
    assert r == pytest.approx(5.0, rel=0.05)
    sizes, sections = seen(truth)
    assert sections > 60
    packs = {which: pack(sizes, which, stream, porosity=0.4, edge=40) for which in ("f3d", "f2d")}
    assert packs["f3d"].sizes().r_um.mean() == pytest.approx(r, rel=0.08)
    assert packs["f2d"].sizes().r_um.mean() == pytest.approx(np.pi / 4 * r, rel=0.08)


def test_what_is_measured_of_a_pack():
    """Of all its periodic box, the porosity is met to a voxel; of two sizes r_32 lies above the mean."""
    edges = np.array([3.0, 3.01, 5.0, 5.01])
    f = np.array([50.0, 0, 50.0])
    sizes = SizeDistribution(edges, f, f, f, f, "table", np.nan)
    spheres = pack(sizes, "f3d", partial(random.generator, 1, "s", 0), porosity=0.4, edge=40)
    found = measured(spheres, spheres.phase)
    assert found["porosity"] == pytest.approx(0.4, abs=1 / 40**3)
    assert found["r_um"] == pytest.approx(4, rel=0.03)
    assert found["r_sauter_um"] == pytest.approx((27 + 125) / (9 + 25), rel=0.03)
    expected = flow.permeability(spheres.phase == 0, 1.0, "network").k_md
    assert found["k_md"] == pytest.approx(np.mean(expected))
