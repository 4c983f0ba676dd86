"""Wicksell's equation: analytic truths of the kernel, invariants of the estimate, degenerate input."""

import itertools

import numpy as np
import pandas as pd
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from grainfall.errors import InputError
from grainfall.grains import random_profiles, sphere
from grainfall.morphology.split import smallest_radius
from grainfall.stereology import (
    METHODS,
    SPHERE,
    SizeDistribution,
    draw_radii,
    from_table,
    midpoint_kernel,
    own_shapes,
    section_kernel,
    to_table,
    unfold,
    unfold_table,
)
from grainfall.stereology.distribution import rebinned


def sections(radii, rng):
    """Cut spheres at a uniform distance from their centres."""
    return radii * np.sqrt(1.0 - rng.random(len(radii)) ** 2)


def lognormal_sections(n, rng, sigma=0.25, median=50.0):
    # A lognormal that is weighted by its size is the lognormal shifted by sigma^2.
    return sections(median * np.exp(sigma**2 + sigma * rng.standard_normal(n)), rng)


def flat(edges, masses):
    edges, masses = np.asarray(edges, float), np.asarray(masses, float)
    density = masses / (masses.sum() * np.diff(edges))
    return SizeDistribution(edges, density, density, density, density, "test", np.nan)


def test_kernel_equals_quadrature():
    section_edges, edges = np.array([0.0, 0.3, 0.9, 1.1, 2.0]), np.array([0.2, 0.9, 1.0, 1.9])
    kernel = section_kernel(section_edges, edges)
    for j, (a, b) in enumerate(itertools.pairwise(edges)):
        for i, (lo, hi) in enumerate(itertools.pairwise(section_edges)):

            def in_bin(radius, lo=lo, hi=hi):
                root = [np.sqrt(max(radius**2 - x**2, 0.0)) for x in (lo, hi)]
                return root[0] - root[1]

            knots = [x for x in (lo, hi) if a < x < b]
            number = quad(in_bin, a, b, points=knots or None, epsabs=1e-13, limit=200)[0]
            assert kernel[i, j] == pytest.approx(number / ((b**2 - a**2) / 2), abs=1e-9)


def test_kernel_is_a_probability_and_cuts_no_larger_section():
    edges = np.geomspace(1e-4, 1e3, 60)
    kernel = section_kernel(np.concatenate([[0.0], edges]), edges)
    np.testing.assert_allclose(kernel.sum(axis=0), 1.0, rtol=1e-12)
    assert np.all(kernel >= 0)
    assert not np.tril(kernel[1:], -1).any()


def test_kernel_of_equal_spheres_has_the_known_moments():
    """E[r] = (pi/4) E[R^2] / E[R] and E[r^2] = (2/3) E[R^3] / E[R], here for a narrow bin at R = 1."""
    fine = np.linspace(0.0, 1.0005, 20001)
    share = section_kernel(fine, np.array([0.9995, 1.0005]))[:, 0]
    middle = 0.5 * (fine[1:] + fine[:-1])
    assert share @ middle == pytest.approx(np.pi / 4, abs=1e-5)
    assert share @ middle**2 == pytest.approx(2 / 3, abs=1e-5)


def test_paper_kernel_has_no_nan_and_is_wicksells_equation():
    edges = np.linspace(0.0, 2.0, 401)
    kernel = midpoint_kernel(edges)
    assert np.all(np.isfinite(kernel))
    assert not np.tril(kernel, -1).any()
    # A flat number density on (0, 2), E[R] = 1: f2D(r) = r arccosh(2 / r) / 2.
    middle = 0.5 * (edges[1:] + edges[:-1])
    np.testing.assert_allclose(kernel.sum(axis=1) / 4, middle * np.arccosh(2.0 / middle) / 2, rtol=1e-9)


def of_unit_radius(vertices, faces):
    mesh = trimesh.Trimesh(vertices, faces)
    return mesh.vertices * np.cbrt(4 * np.pi / 3 / mesh.volume), mesh.faces


def ellipsoid(*axes):
    vertices, faces = sphere(4)
    return of_unit_radius(vertices * np.array(axes), faces)


def profiles_of_ellipsoids(radii, axes, rng):
    """By formula: a plane at t times its reach h from the centre cuts pi abc (1 - t^2) / h."""
    axes = np.array(axes) / np.cbrt(np.prod(axes))
    kept = np.empty(0)
    while len(kept) < len(radii):
        normals = rng.standard_normal((8 * len(radii), 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        reach = np.linalg.norm(normals * axes, axis=1)
        kept = np.append(kept, reach[rng.random(len(reach)) * axes.max() < reach])
    return radii * np.sqrt((1 - rng.random(len(radii)) ** 2) / kept[: len(radii)])


def test_cuts_through_a_sphere_are_wicksells():
    cuts = random_profiles([sphere(4)] * 100)
    assert cuts.mean == pytest.approx(np.pi / 4, rel=1e-3)
    for share in (0.1, 0.5, 0.9):
        assert cuts.exceeded(share) == pytest.approx(SPHERE.exceeded(share), rel=0.01)
    edges = np.linspace(0.0, 2.0, 41)
    np.testing.assert_allclose(section_kernel(edges, edges, cuts), section_kernel(edges, edges), atol=0.01)


@pytest.mark.parametrize("edges", [(1, 1, 1), (1, 2, 3), (1, 6, 6), (1, 1, 8)])
def test_mean_profile_is_the_volume_over_the_mean_width(edges):
    """E[A] = V / b for any convex body; a box is (a + b + c) / 2 wide on average."""
    box = trimesh.creation.box(edges)
    box = of_unit_radius(box.vertices, box.faces)
    width = sum(edges) / 2 * np.cbrt(4 * np.pi / 3 / np.prod(edges))
    cuts = random_profiles([box] * 60)
    assert np.pi * cuts.weights @ cuts.radii**2 == pytest.approx(4 * np.pi / 3 / width, rel=2e-3)
    assert cuts.weights.sum() == pytest.approx(1)


def test_profiles_of_one_plane_count_apart_and_holes_do_not():
    vertices, faces = sphere()
    small = vertices * np.cbrt(0.5)
    apart = np.concatenate([np.subtract(small, [5, 0, 0]), np.add(small, [5, 0, 0])])
    cuts = random_profiles([(apart, np.concatenate([faces, faces + len(small)]))] * 40, planes=64)
    assert cuts.radii[-1] <= np.cbrt(0.5) * 1.01
    assert cuts.mean == pytest.approx(np.cbrt(0.5) * np.pi / 4, rel=0.01)
    hollow = (
        np.concatenate([vertices, 0.9 * vertices]),
        np.concatenate([faces, faces[:, ::-1] + len(vertices)]),
    )
    assert random_profiles([hollow] * 40, planes=64).mean == pytest.approx(np.pi / 4, rel=0.01)


@pytest.mark.parametrize(
    ("method", "particles", "outlined", "on", "words"),
    [
        ("adaptive", "auto", True, True, "own shapes: the section came with its grains outlined"),
        ("adaptive", "auto", False, False, "of spheres: a distance map parts the grains"),
        ("adaptive", "grains", False, True, "own shapes: the config says so, where a distance map"),
        ("adaptive", "spheres", True, False, "of spheres: the config says so, where the section came"),
        ("tikhonov", "grains", True, False, "of spheres: the rule tikhonov knows no other shape"),
        ("none", "auto", True, False, "not unfolded: the rule none takes profiles for grains"),
    ],
)
def test_grains_are_unfolded_by_their_own_shapes_where_those_are_known(
    method, particles, outlined, on, words
):
    found = own_shapes(method, particles, outlined)
    assert (found["on"], found["forced"]) == (on, particles != "auto")
    assert words in found["reason"]


@pytest.mark.parametrize("axes", [(1, 1, 0.4), (2, 1, 1)])
def test_grains_are_unfolded_by_their_own_shape(axes):
    rng = np.random.default_rng(10)
    truth = 20 * np.exp(0.25 * rng.standard_normal(100_000))
    cut = rng.choice(truth, 4000, p=truth / truth.sum())
    seen = profiles_of_ellipsoids(cut, axes, rng)
    own, as_spheres = unfold(seen, particle=random_profiles([ellipsoid(*axes)] * 40)), unfold(seen)
    assert own.mean() == pytest.approx(truth.mean(), rel=0.015)
    assert own.quantile(0.9) == pytest.approx(np.quantile(truth, 0.9), rel=0.015)
    assert as_spheres.mean() < 0.965 * truth.mean()


def test_a_shape_is_cut_alike_however_it_is_turned():
    vertices, faces = ellipsoid(1, 2, 4)
    turned = [(turn.apply(vertices), faces) for turn in Rotation.random(40, random_state=3)]
    one, other = random_profiles([(vertices, faces)] * 40), random_profiles(turned)
    for share in (0.1, 0.5, 0.9):
        assert one.exceeded(share) == pytest.approx(other.exceeded(share), rel=0.01)


@pytest.mark.parametrize("method", METHODS)
def test_densities_integrate_to_one(method):
    found = unfold(lognormal_sections(150, np.random.default_rng(0)), method=method)
    for which in ("f2d", "f3d"):
        assert found.masses(which).sum() == pytest.approx(1.0)
    assert np.all(found.f3d >= 0)


def test_equal_spheres_are_found():
    found = unfold(sections(np.full(1000, 30.0), np.random.default_rng(1)))
    # The sections' own mean is 21 % too small.
    assert found.mean("f2d") == pytest.approx(30 * np.pi / 4, rel=0.03)
    assert found.mean() == pytest.approx(30.0, rel=0.1)
    assert found.quantile(0.5) == pytest.approx(30.0, rel=0.02)


def test_section_moments_follow_from_the_estimate():
    """The estimate explains the data: E[r] = (pi/4) E[R^2] / E[R]."""
    found = unfold(lognormal_sections(3000, np.random.default_rng(2), sigma=0.4))
    assert found.mean("f2d") == pytest.approx(np.pi / 4 * found.moment(2) / found.mean(), rel=0.02)


def test_correction_reverses_for_wide_distributions():
    """E[r]/E[R] = (pi/4)(1 + CV^2): sections look smaller below CV 0.52 and larger above."""
    rng = np.random.default_rng(3)
    narrow = unfold(lognormal_sections(600, rng, sigma=0.2))
    wide = unfold(lognormal_sections(600, rng, sigma=0.8))
    assert narrow.mean("f2d") < narrow.mean()
    assert wide.mean("f2d") > wide.mean()


def test_scale_does_not_matter():
    radii = lognormal_sections(100, np.random.default_rng(4))
    small, large = unfold(radii), unfold(1000.0 * radii)
    np.testing.assert_allclose(large.edges_um, 1000 * small.edges_um, rtol=1e-9)
    np.testing.assert_allclose(large.cdf(large.edges_um), small.cdf(small.edges_um), atol=1e-6)


def test_weights_act_like_copies():
    radii = lognormal_sections(60, np.random.default_rng(5))
    weights = np.where(np.arange(60) % 3 == 0, 2.0, 1.0)
    weighted = unfold(radii, weights, method="paper")
    copied = unfold(np.repeat(radii, weights.astype(int)), method="paper")
    np.testing.assert_allclose(weighted.f2d, copied.f2d, rtol=1e-12)
    np.testing.assert_allclose(weighted.f3d, copied.f3d, atol=1e-9 * copied.f3d.max())


def test_weights_undo_a_biased_look():
    """Sections missed in proportion to their size and weighted by the inverse tell what all of them tell."""
    rng = np.random.default_rng(11)
    radii = lognormal_sections(3000, rng)
    seen = np.clip(1.0 - radii / 150.0, 0.2, 1.0)
    kept = rng.random(3000) < seen
    weighted = unfold(radii[kept], 1.0 / seen[kept])
    assert weighted.mean() == pytest.approx(unfold(radii).mean(), rel=0.02)
    assert unfold(radii[kept]).mean() < 0.97 * weighted.mean()


def test_sections_of_no_weight_are_left_out():
    radii = lognormal_sections(50, np.random.default_rng(6))
    cut = unfold(np.append(radii, 1e4), np.append(np.ones(50), 0.0))
    np.testing.assert_array_equal(cut.f3d, unfold(radii).f3d)


def test_pixels_are_not_taken_for_particles():
    """Areas in whole pixels put radii on a lattice; the sizes behind it are those behind the exact radii."""
    radii = lognormal_sections(5000, np.random.default_rng(10), median=5.0)
    radii = radii[np.pi * radii**2 > 0.5]
    pixels = np.sqrt(np.round(np.pi * radii**2) / np.pi)
    exact, measured = unfold(radii), unfold(pixels)
    at = np.linspace(0.0, 15.0, 400)
    assert np.max(np.abs(exact.cdf(at) - measured.cdf(at))) < 0.03


@pytest.mark.parametrize(("mean", "cv"), [(4.0, 0.3), (6.0, 0.5)])
def test_specks_left_out_are_not_taken_for_absent(mean, cv):
    """Without the sections below two pixels the sizes are still those that made the others."""
    sigma = np.sqrt(np.log1p(cv**2))
    smallest = smallest_radius(2.0)
    errors = []
    for seed in range(4):
        drawn = lognormal_sections(1500, np.random.default_rng(seed), sigma, mean / np.exp(sigma**2 / 2))
        pixels = np.sqrt(np.round(np.pi * drawn**2) / np.pi)
        kept = pixels[pixels > smallest]
        heeded, taken_for_absent = unfold(kept, smallest_um=smallest), unfold(kept)
        errors.append([heeded.mean() / mean - 1, taken_for_absent.mean() / mean - 1])
    heeded, taken_for_absent = np.mean(errors, axis=0)
    assert abs(heeded) < 0.02
    assert taken_for_absent > 0.07
    with pytest.raises(InputError, match="from 0 to the smallest radius"):
        unfold(kept, smallest_um=2 * kept.min())


@pytest.mark.parametrize("number", [1, 30])
def test_grains_hardly_larger_than_the_limit_have_a_size(number):
    smallest = smallest_radius(2.0)
    assert 1.9 < unfold(np.full(number, 2.05), smallest_um=smallest).mean() < 3.4


def test_a_few_sections_near_the_limit_are_not_taken_for_a_crowd():
    """Of grains hardly larger than the limit most cuts are unseen: their number would be a guess."""
    smallest = smallest_radius(2.0)
    small = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        large = sections(rng.normal(16, 4, 150).clip(8), rng)
        kept = np.append(large[large > smallest], [2.2, 2.2, 2.2, 2.26, 2.45])
        small.append(unfold(kept, smallest_um=smallest).cdf(2 * smallest))
    assert np.mean(small) < 0.12  # 0.22 where components may have their mean at the limit


def test_no_inversion_keeps_the_sections():
    found = unfold(lognormal_sections(50, np.random.default_rng(7)), method="none")
    np.testing.assert_array_equal(found.f3d, found.f2d)


def test_band_repeats_with_its_seed_and_has_width():
    radii = lognormal_sections(100, np.random.default_rng(8))
    edges = np.linspace(0.0, 1.01 * radii.max(), 11)
    first, again = (
        unfold(radii, edges_um=edges, bootstrap=20, rng=np.random.default_rng(0)) for _ in range(2)
    )
    np.testing.assert_array_equal(first.lower, again.lower)
    np.testing.assert_array_equal(first.upper, again.upper)
    peak = np.argmax(first.f3d)
    assert first.lower[peak] < first.f3d[peak] < first.upper[peak]
    without = unfold(radii, edges_um=edges)
    assert np.isnan([without.lower, without.upper]).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("radii", [[7.0], [7.0, 7.0, 7.0], [1e-3, 1.0, 1e4]])
def test_degenerate_sections(method, radii):
    found = unfold(radii, method=method, bootstrap=5, rng=np.random.default_rng(0))
    assert np.all(np.isfinite(found.f3d))
    assert found.masses().sum() == pytest.approx(1.0)
    assert found.edges_um[-1] >= max(radii)
    assert np.all(np.isfinite(draw_radii(found, 10, np.random.default_rng(0))))


def test_one_section_is_read_as_its_particle():
    assert unfold([7.0]).mean() == pytest.approx(7.0, rel=0.02)


@pytest.mark.parametrize(
    ("radii", "arguments"),
    [
        ([], {}),
        ([1.0, 2.0], {"weights": [0.0, 0.0]}),
        ([1.0, -2.0], {}),
        ([1.0, np.nan], {}),
        ([1.0, 2.0], {"weights": [1.0]}),
        ([1.0, 2.0], {"weights": [1.0, -1.0]}),
        ([1.0, 2.0], {"method": "saltykov"}),
        ([1.0, 2.0], {"edges_um": [0.0, 1.5]}),
        ([1.0, 2.0], {"edges_um": [3.0, 0.0]}),
    ],
)
def test_a_users_mistake_is_refused(radii, arguments):
    with pytest.raises(InputError):
        unfold(radii, **arguments)


@settings(max_examples=40, deadline=None)
@given(
    masses=st.lists(st.floats(0.0, 1.0), min_size=2, max_size=8).filter(lambda m: sum(m) > 0.1),
    cuts=st.lists(st.floats(0.0, 20.0), max_size=6),
)
def test_rebinning_keeps_numbers_and_finer_bins_keep_everything(masses, cuts):
    dist = flat(np.arange(len(masses) + 1.0), masses)

    def onto(edges):
        masses = rebinned(dist.edges_um, dist.f3d, edges) * np.diff(edges)
        assert masses.sum() == pytest.approx(1.0)
        return flat(edges, masses)

    ends = [0.0, 21.0]
    coarse = onto(np.unique(cuts + ends))
    np.testing.assert_allclose(coarse.cdf(coarse.edges_um), dist.cdf(coarse.edges_um), atol=1e-12)
    fine = onto(np.unique(np.concatenate([dist.edges_um, cuts, ends])))
    assert fine.mean() == pytest.approx(dist.mean())
    assert fine.mean_volume() == pytest.approx(dist.mean_volume())


@settings(max_examples=40, deadline=None)
@given(
    masses=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8).filter(lambda m: sum(m) > 0.1),
    n=st.integers(1, 300),
)
def test_stratified_radii_follow_the_distribution(masses, n):
    dist = flat(np.arange(len(masses) + 1.0) + 1.0, masses)
    radii = draw_radii(dist, n, np.random.default_rng(n))
    empirical = np.searchsorted(np.sort(radii), dist.edges_um, side="right") / n
    assert np.max(np.abs(empirical - dist.cdf(dist.edges_um))) <= 1 / n + 1e-9
    np.testing.assert_array_equal(radii, draw_radii(dist, n, np.random.default_rng(n)))


def test_moments_of_a_flat_density():
    dist = flat([0.0, 2.0], [1.0])
    assert dist.mean() == pytest.approx(1.0)
    assert dist.mean_volume() == pytest.approx(4 / 3 * np.pi * 2.0)
    assert dist.quantile(0.25) == pytest.approx(0.5)
    assert dist.cdf(1.5) == pytest.approx(0.75)


def test_quantiles_skip_empty_bins():
    dist = flat([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 0.0, 1.0])
    assert dist.quantile(0.0) == pytest.approx(1.0)
    assert dist.quantile(0.5) == pytest.approx(2.0)
    assert dist.quantile(1.0) == pytest.approx(4.0)


def test_table_round_trip():
    rng = np.random.default_rng(9)
    dists = {
        (1, "grain"): unfold(lognormal_sections(40, rng), method="none", bootstrap=5, rng=rng),
        (0, "pore"): flat([0.0, 1.0, 3.0], [1.0, 2.0]),
    }
    table = to_table(dists)
    assert list(table.columns) == ["phase", "kind", "r_lo_um", "r_hi_um", "f2d", "f3d", "lower", "upper"]
    back = from_table(table)
    assert list(back) == list(dists)
    for key, dist in dists.items():
        for name in ("edges_um", "f2d", "f3d", "lower", "upper"):
            np.testing.assert_array_equal(getattr(back[key], name), getattr(dist, name))
    assert from_table(to_table({})) == {}
    assert isinstance(to_table({}), pd.DataFrame)


@pytest.mark.parametrize("method", METHODS)
def test_on_any_bins_that_hold_the_sections_all_particles_are_there(method):
    """The sieve reaches beyond the largest section; its particles there are not lost."""
    radii = np.random.default_rng(0).gamma(9, 2, 300)
    edges = np.linspace(0, radii.max(), 25)
    found = unfold(radii, method=method, edges_um=edges, bootstrap=3, rng=np.random.default_rng(1))
    assert found.f3d @ np.diff(edges) == pytest.approx(1)


def test_radii_come_in_random_order_and_at_random_within_their_strata():
    radii = draw_radii(flat([0.0, 1.0], [1.0]), 1000, np.random.default_rng(0))
    assert abs(np.corrcoef(radii, np.arange(1000))[0, 1]) < 0.12
    assert (np.sort(radii) * 1000 % 1).std() == pytest.approx(1 / np.sqrt(12), rel=0.1)


def test_figures_are_of_the_density_asked_for():
    nan = np.full(2, np.nan)
    dist = SizeDistribution(np.arange(3.0), np.array([1.0, 0]), np.array([0, 1.0]), nan, nan, "test", np.nan)
    for which, start in (("f2d", 0.0), ("f3d", 1.0)):
        assert dist.mean(which) == pytest.approx(start + 0.5)
        assert dist.mean_volume(which) == pytest.approx(np.pi / 3 * ((start + 1) ** 4 - start**4))
        assert dist.cdf(start + 0.25, which) == pytest.approx(0.25)
        assert dist.quantile(0.25, which) == pytest.approx(start + 0.25)


def test_the_band_of_weighted_shares_is_that_of_their_ratio():
    """A share s of weights 5 and 1: its standard error is s (1 - s) / sqrt(p (1 - p) n), p by number."""
    radii, n = np.arange(1.0, 301), 300
    weights = np.where(radii > 150, 5.0, 1.0)
    rng = np.random.default_rng(0)
    found = unfold(radii, weights, method="none", edges_um=[0.0, 150.5, 301], bootstrap=2000, rng=rng)
    share, width = found.masses()[1], (found.upper - found.lower)[1] * 150.5
    assert share == pytest.approx(5 / 6)
    assert width == pytest.approx(2 * 1.96 * share * (1 - share) / np.sqrt(n / 4), rel=0.1)


def test_sections_that_weigh_next_to_nothing_add_no_detail():
    radii = lognormal_sections(60, np.random.default_rng(5))
    more = unfold(np.append(radii, np.repeat(radii, 50)), np.append(np.ones(60), np.full(3000, 1e-9)))
    np.testing.assert_allclose(more.edges_um, unfold(radii).edges_um)


@pytest.mark.parametrize("method", ["tikhonov", "paper"])
def test_older_rules_find_the_mean_of_wide_distributions_too(method):
    sigma = 0.5
    found = unfold(lognormal_sections(4000, np.random.default_rng(3), sigma), method=method)
    assert found.mean() == pytest.approx(50 * np.exp(sigma**2 / 2), rel=0.08)


def test_a_table_is_unfolded_by_its_weights():
    radii = lognormal_sections(60, np.random.default_rng(5))
    weight = np.arange(60) % 4.0
    table = pd.DataFrame({"r_um": radii, "weight": weight})
    found, expected = unfold_table(table, method="none"), unfold(radii, weight, method="none")
    np.testing.assert_array_equal(found.f3d, expected.f3d)
    assert unfold_table(table.assign(weight=0.0)) is None


def test_the_penalty_of_few_sections_is_not_the_least_there_is():
    """What is judged by its own data, or not at all, is never smoothed."""
    radii = lognormal_sections(100, np.random.default_rng(1), 0.4)
    assert unfold(radii, method="tikhonov").regularisation > 2e-8
    found = unfold(radii, method="paper")
    assert found.regularisation > 2e-8 * np.linalg.norm(midpoint_kernel(found.edges_um), 2) ** 2
