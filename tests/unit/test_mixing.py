"""Mixing probabilities, quotas, and the sizes and number of virtual spheres."""

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from grainfall.errors import InputError
from grainfall.packing import (
    Mixture,
    draw_population,
    draw_zones,
    match_porosity,
    phase_probabilities,
    sphere_probability,
    virtual_sizes,
)
from grainfall.packing.mixing import phase_probabilities_linear
from grainfall.packing.virtual import THROAT, next_odds


@dataclass
class Uniform:
    """Radii spread evenly over an interval; apparent radii are half as large."""

    low: float
    high: float

    def quantile(self, q, which="f3d"):
        return (self.low + np.asarray(q) * (self.high - self.low)) * (0.5 if which == "f2d" else 1.0)


@dataclass
class Bins:
    edges_um: np.ndarray
    f3d: np.ndarray


@dataclass
class Library:
    table: pd.DataFrame = field(
        default_factory=lambda: pd.DataFrame(
            {
                "shape": np.arange(40),
                "phase": np.repeat([1, 2], 20),
                "r2d_um": np.tile(np.linspace(5, 50, 20), 2),
            }
        )
    )


share = st.floats(0.01, 1.0)
volume = st.floats(0.1, 1000.0)


@given(st.lists(st.tuples(share, volume), min_size=1, max_size=5))
def test_probabilities_give_the_fractions_back(rows):
    phi, v = np.array(rows).T
    phi = phi / phi.sum()
    p = phase_probabilities(phi, v)
    assert p.sum() == pytest.approx(1)
    np.testing.assert_allclose(p * v / (p @ v), phi, rtol=1e-9)


@given(st.lists(st.tuples(share, volume), min_size=2, max_size=5))
def test_corrected_linear_system_agrees_with_the_closed_form(rows):
    phi, v = np.array(rows).T
    np.testing.assert_allclose(phase_probabilities_linear(phi, v), phase_probabilities(phi, v), atol=1e-8)


def test_printed_linear_system_gives_nonsense():
    np.testing.assert_allclose(phase_probabilities_linear([0.5, 0.5], [1, 1], as_printed=True), [1, 0])
    np.testing.assert_allclose(phase_probabilities_linear([0.5, 0.5], [1, 1]), [0.5, 0.5])


def test_an_absent_phase_is_never_drawn():
    np.testing.assert_allclose(phase_probabilities([0.0, 1.0], [2.0, 3.0]), [0, 1])


@pytest.mark.parametrize(
    ("phi", "v"), [([], []), ([1], [1, 2]), ([0, 0], [1, 1]), ([1], [0]), ([-1, 2], [1, 1])]
)
def test_wrong_fractions_are_refused(phi, v):
    with pytest.raises(InputError):
        phase_probabilities(phi, v)


def mixture(**changes):
    sizes = {1: Uniform(10, 30), 2: Uniform(30, 50)}
    return Mixture(**{"sizes": sizes, "fractions": {1: 0.3, 2: 0.7}, **changes})


def test_population_holds_its_volume_and_its_fractions():
    drawn = draw_population(mixture(), Library(), 2e8, np.random.default_rng(0))
    v = 4 / 3 * np.pi * drawn["scale"] ** 3
    assert v.sum() == pytest.approx(2e8, rel=0.01)
    assert v[drawn["phase"] == 1].sum() / v.sum() == pytest.approx(0.3, abs=0.005)


def test_every_stretch_of_the_supply_holds_the_mix():
    drawn = draw_population(mixture(), Library(), 4e8, np.random.default_rng(0))
    p = mixture().probabilities
    for start in range(0, len(drawn) - 100, 37):
        stretch = drawn.iloc[start : start + 100]
        assert abs((stretch["phase"] == 1).sum() - 100 * p[0]) <= 2
        fine = np.sort(stretch["scale"][stretch["phase"] == 1])
        # Kolmogorov distance to the uniform distribution: independent draws of this number have about
        # 0.86/sqrt(n)
        distance = np.abs((fine - 10) / 20 - (np.arange(len(fine)) + 0.5) / len(fine)).max()
        assert distance < 0.6 / np.sqrt(len(fine))


def test_shapes_come_from_their_phase_and_size_class():
    library = Library()
    drawn = draw_population(mixture(), library, 4e8, np.random.default_rng(0))
    rows = library.table.set_index("shape").loc[drawn["shape"]]
    assert (rows["phase"].to_numpy() == drawn["phase"].to_numpy()).all()
    assert (np.abs(rows["r2d_um"].to_numpy() - drawn["scale"].to_numpy()) < 6).all()  # classes 2.4 um apart
    assert drawn["shape"].nunique() > 20


def test_virtual_spheres_come_in_their_share():
    spheres = Uniform(5, 15)
    drawn = draw_population(mixture(spheres=spheres, p_sphere=0.4), Library(), 4e8, np.random.default_rng(0))
    virtual = drawn["kind"] == "virtual"
    assert virtual.mean() == pytest.approx(0.4, abs=4 * np.sqrt(0.24 / len(drawn)))
    assert (drawn["shape"][virtual] == -1).all()
    assert (drawn["phase"][virtual] == 0).all()
    assert drawn["scale"][virtual].between(5, 15).all()


def test_virtual_spheres_come_at_random():
    """Stretches of the supply hold them as throws of a coin do: by quota all would hold as many."""
    spheres, p = Uniform(5, 15), 0.1
    drawn = draw_population(mixture(spheres=spheres, p_sphere=p), Library(), 4e9, np.random.default_rng(0))
    virtual = (drawn["kind"] == "virtual").to_numpy()
    held = virtual[: len(virtual) // 50 * 50].reshape(-1, 50).sum(axis=1)
    dispersion = ((held - 50 * p) ** 2).mean() / (50 * p * (1 - p))
    assert dispersion == pytest.approx(1, abs=4 * np.sqrt(2 / len(held)))
    radii = drawn["scale"][virtual].to_numpy()
    assert abs(np.corrcoef(radii[1:], radii[:-1])[0, 1]) < 4 / np.sqrt(len(radii))
    assert radii.mean() == pytest.approx(10, abs=4 * 10 / np.sqrt(12 * len(radii)))


def test_more_virtual_spheres_are_the_same_ones_and_others():
    """Packings of one seed that differ in the share alone are compared with each other."""
    few, many = (
        draw_population(mixture(spheres=Uniform(5, 15), p_sphere=p), Library(), 4e8, np.random.default_rng(0))
        for p in (0.05, 0.1)
    )
    n = min(len(few), len(many))
    of_few, of_many = (drawn["kind"][:n] == "virtual" for drawn in (few, many))
    assert (of_few <= of_many).all()
    assert of_many.sum() > 1.5 * of_few.sum()
    assert (few["scale"][:n][of_few] == many["scale"][:n][of_few]).all()


def test_large_virtual_spheres_take_the_shapes_of_voids_and_keep_their_volumes():
    library, mix = Library(), mixture(spheres=Uniform(5, 15), p_sphere=0.4)
    voids = pd.DataFrame({"shape": 1000 + np.arange(9), "phase": 0, "r2d_um": 10.0 + np.arange(9)})
    library.table = pd.concat([library.table, voids], ignore_index=True)
    plain, shaped = (
        draw_population(replace(mix, void_from_um=least), library, 4e8, np.random.default_rng(0))
        for least in (np.inf, 10.0)
    )
    held = shaped["shape"] >= 1000
    assert (held == ((plain["kind"] == "virtual") & (plain["scale"] >= 10))).all()
    assert shaped["shape"][held].nunique() > 3
    pd.testing.assert_frame_equal(plain.drop(columns="shape"), shaped.drop(columns="shape"))
    assert (plain["shape"][~held] == shaped["shape"][~held]).all()
    assert plain["shape"].max() < 1000


def test_bodies_in_the_shapes_of_voids_are_poured_smaller_and_their_volume_counts():
    library, mix = Library(), mixture(spheres=Uniform(5, 15), p_sphere=0.4, void_from_um=10.0)
    voids = pd.DataFrame({"shape": 1000 + np.arange(9), "phase": 0, "r2d_um": 10.0 + np.arange(9)})
    library.table = pd.concat([library.table, voids], ignore_index=True)
    small = replace(mix, void_scale=0.8)
    drawn = draw_population(small, library, 4e8, np.random.default_rng(0))
    held, virtual = drawn["shape"] >= 1000, drawn["kind"] == "virtual"
    assert drawn["scale"][held].between(8, 12).all()
    assert drawn["scale"][virtual & ~held].between(5, 10).all()
    radii = np.linspace(5, 15, 100001)
    volumes = 4 / 3 * np.pi * np.where(radii < 10, radii, 0.8 * radii) ** 3
    assert small.mean_sphere_volume == pytest.approx(volumes.mean(), rel=1e-3)
    # whether one is a void goes by the size of the void, not by that of the body
    assert held[virtual].mean() == pytest.approx(0.5, abs=0.01)
    assert 4 / 3 * np.pi * (drawn["scale"] ** 3).sum() == pytest.approx(4e8, rel=0.03)


def test_no_inversion_uses_apparent_sizes():
    drawn = draw_population(mixture(which="f2d"), Library(), 1e8, np.random.default_rng(0))
    assert drawn["scale"].max() <= 25


def test_population_depends_on_the_generator_only():
    one, two, other = (
        draw_population(mixture(), Library(), 1e8, np.random.default_rng(s)) for s in (1, 1, 2)
    )
    assert one.equals(two)
    assert not one.equals(other)


def test_a_phase_without_shapes_is_an_error():
    wrong = mixture(sizes={3: Uniform(1, 2)}, fractions={3: 1.0})
    with pytest.raises(InputError, match="phase 3"):
        draw_population(wrong, Library(), 1e4, np.random.default_rng(0))


@given(st.floats(0.05, 0.5), st.floats(0.01, 0.4), volume, volume)
def test_sphere_probability_fills_the_missing_volume(first, more, v_sphere, v_grain):
    """Of the solid 1 - phi_1, spheres take phi_t - phi_1 and grains 1 - phi_t."""
    target = first + more
    p = sphere_probability(target, first, v_sphere, v_grain)
    assert (1 - p) * v_grain * (target - first) == pytest.approx(p * v_sphere * (1 - target), rel=1e-9)


def test_no_spheres_where_the_packing_is_porous_enough():
    assert sphere_probability(0.3, 0.3, 1, 1) == 0
    assert sphere_probability(0.3, 0.4, 1, 1) == 0


def test_difference_on_common_bins():
    """Target 1 on (0, 1); first 2 on (0, 0.5), in bins of another width: what is missing is (0.5, 1)."""
    target = Bins(np.linspace(0, 1, 4), np.ones(3))
    first = Bins(np.linspace(0, 0.5, 3), np.full(2, 2.0))
    found = virtual_sizes(target, first)
    assert found.called_for
    width = np.diff(found.edges_um)
    assert (found.target * width).sum() == pytest.approx(1)
    assert (found.first * width).sum() == pytest.approx(1)
    assert (found.used * width).sum() == pytest.approx(1)
    assert found.quantile(np.array([0.0, 0.5, 1.0])) == pytest.approx([0.5, 0.75, 1.0])
    assert found.mean_volume == pytest.approx(4 / 3 * np.pi * (1 - 0.5**4) / 4 / 0.5)
    assert list(found.to_table()) == ["r_lo_um", "r_hi_um", "target", "first", "difference", "used"]


def test_quantiles_skip_empty_bins():
    target = Bins(np.array([0.0, 1, 2, 3]), np.array([0.5, 0.0, 0.5]))
    found = virtual_sizes(target, None)
    assert found.quantile(np.array([0.25, 0.49, 0.51, 0.75])) == pytest.approx([0.5, 0.98, 2.02, 2.5])


def test_spheres_too_wide_for_the_region_are_left_out_and_said():
    target = Bins(np.array([0.0, 10.0, 20.0]), np.array([0.05, 0.05]))
    found = virtual_sizes(target, None, largest_um=15.0)
    assert found.called_for
    assert found.quantile(np.array([1.0]))[0] == pytest.approx(15)
    assert "15" in found.reason
    assert not virtual_sizes(target, Bins(target.edges_um, np.array([0.1, 0])), largest_um=10.0).called_for


def test_spheres_that_slip_between_grains_are_left_out_and_said():
    target = Bins(np.array([0.0, 10.0, 20.0]), np.array([0.09, 0.01]))
    found = virtual_sizes(target, None, smallest_um=10.0)
    assert found.quantile(np.array([0.0]))[0] == pytest.approx(10)
    assert "90 %" in found.reason


def test_the_throat_between_three_spheres():
    """Centres of three touching unit spheres stand 2 / sqrt(3) from the middle of their triangle."""
    corners = 2 / 3**0.5 * np.exp(2j * np.pi * np.arange(3) / 3)
    assert abs(corners[0] - corners[1]) == pytest.approx(2)
    assert pytest.approx(abs(corners[0])) == 1 + THROAT


def test_not_called_for():
    same = Bins(np.array([0.0, 1.0, 2.0]), np.array([0.5, 0.5]))
    for found in (virtual_sizes(same, same), virtual_sizes(None, same)):
        assert not found.called_for
        assert found.reason
        assert not found.used.any()
        assert found.mean_volume == 0


class Rock:
    """Porosity left when spheres of volume ratio c are removed; the total solid moves with their share."""

    def __init__(self, first, c, drift):
        self.first, self.c, self.drift, self.found = first, c, drift, []

    def __call__(self, p):
        x = self.c * p / (1 - p)
        solid = (1 - self.first) + self.drift * x / (1 + x)
        self.found.append(1 - solid / (1 + x))
        return self.found[-1]


def nothing_to_pack(p):
    pytest.fail("nothing to pack")


@given(
    st.floats(0.35, 0.45),
    st.floats(0.02, 0.3),
    st.floats(0.02, 20.0),
    st.floats(-0.15, 0.15),
    st.floats(0.2, 3.0),
)
def test_feedback_reaches_the_target(first, more, c, drift, misfit):
    target = first + more
    rock = Rock(first, c, drift)
    p0 = sphere_probability(target, first, misfit * c, 1.0)
    assert match_porosity(rock, target, p0, first, max_passes=6) == ""
    assert abs(rock.found[-1] - target) <= 0.01
    assert len(rock.found) <= 6


def test_one_pass_suffices_where_the_formula_holds():
    rock = Rock(0.4, 0.5, 0.0)
    assert match_porosity(rock, 0.5, sphere_probability(0.5, 0.4, 0.5, 1.0), 0.4) == ""
    assert rock.found == [pytest.approx(0.5)]


def test_a_target_below_the_first_packing_is_said():
    missed = match_porosity(nothing_to_pack, 0.309, 0.0, 0.374)
    assert missed == "target not reachable by this plan, nearest 0.374"
    assert match_porosity(nothing_to_pack, 0.37, 0.0, 0.374) == ""


def test_a_target_out_of_reach_is_said_with_the_nearest_pass():
    found = []

    def stiff(p):
        found.append(0.4 + 0.05 * p)
        return found[-1]

    missed = match_porosity(stiff, 0.6, 0.5, 0.4)
    assert missed == f"target 0.600 not met in {len(found)} passes, nearest {max(found):.3f}"


def test_a_pass_without_a_grain_in_the_region_is_a_pass():
    tried = []

    def emptied(p):
        tried.append(p)
        return 1.0 if p > 0.5 else 0.9

    assert "not met" in match_porosity(emptied, 0.98, 0.9, 0.42)
    assert tried[0] == 0.9
    assert len(tried) > 1


@pytest.mark.parametrize("share", [0.2, 0.5, 1.0])
def test_each_zone_keeps_its_own_quota(share):
    """Over the region and around it every prefix of the supply holds the right mix of phases."""
    mixture = Mixture({1: Uniform(15.0, 25.0), 2: Uniform(8.0, 12.0)}, {1: 0.6, 2: 0.4})
    supply = draw_zones(mixture, Library(), 2e7, share, np.random.default_rng(1))
    assert supply.over_roi.mean() == pytest.approx(share, abs=0.01)
    for _, zone in supply.groupby("over_roi"):
        counts = np.cumsum(zone.phase.to_numpy() == 1)
        wanted = mixture.probabilities[0] * np.arange(1, len(zone) + 1)
        assert np.abs(counts - wanted).max() <= 1


@pytest.mark.parametrize("which", ["f3d", "f2d"])
def test_dust_is_not_poured(which):
    """Bins that begin at 0 let radii be nearly nothing; the smallest grain sets everybody's time step."""
    small = Mixture({1: Uniform(0.0, 20.0)}, {1: 1.0}, which)
    radii = small._radii(small.sizes[1], np.linspace(0, 1, 2001))
    median = 10.0 * (0.5 if which == "f2d" else 1.0)
    assert radii.min() == pytest.approx(0.02 * median)
    assert np.median(radii) == pytest.approx(median)


def test_scattered_passes_are_not_extrapolated_far():
    """Two passes all but alike say nothing of odds a thousand times theirs."""
    assert next_odds([(0.0, 1.5), (0.1, 1.5 + 1e-6)], 2.0) <= 4 * 0.1
