"""The study of size bias: its truths show as many grains as it asks for."""

import numpy as np
import pytest

from grainfall import random
from grainfall.size_bias import packs, section_side


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

    def stream(chapter):
        return random.generator(1, "s", 0, chapter)

    found = packs(0.1, stream, porosity=0.4, voxels_per_radius=5.0, edge=40, grains=80)
    r = {row["variant"]: row["r_um"] for row in found}
    assert r["truth"] == pytest.approx(5.0, rel=0.05)
    assert r["full"] == pytest.approx(r["truth"], rel=0.08)
    assert r["no_inversion"] == pytest.approx(np.pi / 4 * r["truth"], rel=0.08)
