"""The surface of a solid, in space and on its sections."""

from dataclasses import astuple

import numpy as np
import pytest
import tifffile
from scipy import ndimage, stats

from grainfall import surface


def ball(edge, radius):
    z, y, x = np.indices((edge,) * 3) - (edge - 1) / 2
    return x**2 + y**2 + z**2 < radius**2


def boolean_rock(rng, shape, radius, number):
    """Discs or balls at random places, overlapping: a medium of known surface."""
    at = rng.random((number, len(shape))) * shape
    solid = np.zeros(shape, bool)
    grid = np.indices(shape) + 0.5
    for place in at:
        d = grid - place.reshape(-1, *[1] * len(shape))
        size = np.reshape(shape, (-1, *[1] * len(shape)))
        d -= size * np.round(d / size)
        solid |= (d**2).sum(axis=0) < radius**2
    return solid


def test_a_ball_in_space():
    solid = ball(60, 25)
    # 59 steps stand for 60 voxels, though no edge cuts this ball
    area = 60 / 59 * 4 * np.pi * 25**2 / (60**3 * 2)
    assert surface.specific_surface(~solid, 2.0) == pytest.approx(area, rel=0.01)
    assert surface.solid_surface(solid, 2.0).per_um == pytest.approx(60 / 59 * 3 / 50, rel=0.01)


@pytest.mark.parametrize("shape", [(2, 3), (5, 8), (4, 3, 7)])
def test_surface_does_not_hang_on_the_size_of_the_image(shape):
    """Along a chequer board every step crosses the surface, however few there are."""
    pore = np.indices(shape).sum(axis=0) % 2 == 0
    assert surface.specific_surface(pore, 0.5) == pytest.approx(2 / 0.5)
    solid = 1.0 - pore.mean()
    assert surface.solid_surface(~pore, 0.5).per_um == pytest.approx(2 / 0.5 / solid)


def test_a_disc_is_the_section_of_a_rod():
    z, x = np.indices((80, 80)) - 39.5
    disc = x**2 + z**2 < 30**2
    # a rod along a random direction would show 2 / r; across it, 4 / pi of that is seen
    assert surface.solid_surface(disc, 1.0).per_um == pytest.approx(4 / np.pi * 2 / 30, rel=0.02)


def test_a_section_shows_the_surface_of_space():
    """Sections of one medium: their mean is the volume's, their scatter what the error says."""
    rng = np.random.default_rng(0)
    radius, number, edge = 6, 130, 96
    solid = boolean_rock(rng, (edge,) * 3, radius, number)
    share = 1 - np.exp(-number * 4 / 3 * np.pi * radius**3 / edge**3)
    true = (1 - share) * number * 4 * np.pi * radius**2 / edge**3 / share  # of a Boolean model
    space = surface.solid_surface(solid, 1.0)
    assert abs(space.per_um - true) < 4 * space.error
    sections = [surface.solid_surface(solid[k], 1.0) for k in range(0, edge, 12)]
    found = np.array([s.per_um for s in sections])
    errors = np.array([s.error for s in sections])
    assert abs(found.mean() - space.per_um) < 3 * errors.mean() / np.sqrt(len(found))
    assert 0.5 < found.std(ddof=1) / errors.mean() < 1.7
    assert space.error < errors.min()


def test_without_solid_there_is_no_surface_to_hold_against():
    assert surface.solid_surface(np.zeros((4, 4)), 1.0).per_um == np.inf
    assert surface.solid_surface(np.ones((4, 4)), 1.0) == surface.SolidSurface(0.0, 0.0)


def test_the_core_of_a_volume_is_its_middle():
    volume_ = np.arange(600 * 2 * 300).reshape(600, 2, 300)
    np.testing.assert_array_equal(surface.core(volume_), volume_[172:428, :, 22:278])
    np.testing.assert_array_equal(surface.core(volume_[:9]), volume_[:9, :, 22:278])


def test_sections_scatter_as_one_of_them_says():
    """Of many sections of one medium: ln of phi^3 / S_V^2 scatters by what the tiles of each let expect."""
    rng = np.random.default_rng(4)
    found, said = [], []
    for _ in range(60):
        solid = ndimage.gaussian_filter(rng.standard_normal((160, 160)), 4, mode="wrap") > -0.05
        pore, per_bulk = 1 - solid.mean(), surface.specific_surface(~solid, 1.0)
        found.append((pore, 3 * np.log(pore) - 2 * np.log(per_bulk), 2 * np.log(solid.mean() / per_bulk)))
        said.append(astuple(surface.sampling_errors(solid)))
    # 60 sections give a scatter to 9 %, 16 tiles each an error to 18 %
    assert np.std(found, axis=0, ddof=1) / np.mean(said, axis=0) == pytest.approx(1, abs=0.3)


def test_what_a_section_leaves_open_in_limits():
    rng = np.random.default_rng(0)
    tile = rng.random((40, 40)) > 0.4
    tile[0], tile[:, 0] = tile[-1], tile[:, -1]  # no crossing where tiles meet
    same = surface.sampling_errors(np.tile(tile, (4, 4)))
    assert astuple(same) == pytest.approx((0, 0, 0), abs=1e-12)  # sixteen times the same says all there is
    wide = rng.random((800, 400)) > 0.4
    small, large = (surface.sampling_errors(s) for s in (wide[:200, :100], wide))
    assert 2.5 < small.k / large.k < 6  # a sixteenth of the area: four times the error, to what 16 tiles say
    for lacking in (np.ones((9, 9)), np.zeros((9, 9))):
        assert np.isnan(astuple(surface.sampling_errors(lacking))).all()


def test_slices_of_berea_scatter_as_one_of_them_says(shared_data):
    pore = tifffile.imread(shared_data / "berea" / "berea_400_pore1.tif") == 1
    found, said = [], []
    for axis in range(3):
        for plane in np.moveaxis(~pore, axis, 0)[::8]:
            share, per_bulk = 1 - plane.mean(), surface.specific_surface(~plane, 1.0)
            found.append(
                (share, 3 * np.log(share) - 2 * np.log(per_bulk), 2 * np.log(plane.mean() / per_bulk))
            )
            said.append(astuple(surface.sampling_errors(plane)))
    assert np.std(found, axis=0, ddof=1) / np.mean(said, axis=0) == pytest.approx(1, abs=0.25)


def ellipses(rng, edge, number, degrees):
    """Ellipses of 2.5 to 1 along a direction, counter-clockwise from x as an image is seen, or along any."""
    y, x = np.indices((edge, edge))
    solid = np.zeros((edge, edge), bool)
    for _ in range(number):
        turned = np.radians(rng.random() * 180 if degrees is None else degrees)
        dx, dy = x - rng.random() * edge, rng.random() * edge - y
        along, aside = dx * np.cos(turned) + dy * np.sin(turned), dy * np.cos(turned) - dx * np.sin(turned)
        solid |= (along / 25) ** 2 + (aside / 10) ** 2 < 1
    return solid


@pytest.mark.parametrize("degrees", [0, 20, 45, 100, 135])
def test_grains_that_lie_along_a_direction_are_found_to(degrees):
    # lines across an ellipse meet it a / b times as often as lines along it, and cross diagonals between
    found = surface.alignment(ellipses(np.random.default_rng(1), 400, 110, degrees))
    assert found.ratio == pytest.approx(2.5, rel=0.12)
    assert (found.along_deg - degrees + 90) % 180 - 90 == pytest.approx(0, abs=3)
    assert surface.lies_aligned(found).startswith("The section lies aligned")


def test_grains_of_no_direction_are_not():
    rng = np.random.default_rng(2)
    found = [surface.alignment(ellipses(rng, 300, 70, None)) for _ in range(100)]
    assert np.mean([f.p < 0.05 for f in found]) < 0.12
    assert sum(surface.lies_aligned(f) is not None for f in found) <= 1


@pytest.mark.parametrize(
    "lacking", [np.zeros((90, 90)), np.ones((90, 90)), np.eye(3), np.eye(90)[:, :2], np.eye(90)[:1]]
)
def test_where_nothing_can_be_seen_of_a_direction_nothing_is_said(lacking):
    found = surface.alignment(lacking)
    assert np.isnan([found.ratio, found.along_deg, found.p]).all()
    assert surface.lies_aligned(found) is None


def test_the_error_of_a_ratio_is_that_of_the_mean_of_equal_tiles():
    part = np.array([1.0, 2.0, 4.0, 7.0])
    ratio, error = surface.ratio_of_sums(part, np.full(4, 2.0))
    assert (ratio, error) == pytest.approx((1.75, part.std(ddof=1) / np.sqrt(4) / 2))


def test_alignment_is_hotellings_test_over_tiles():
    """Tiles of one figure, upright or turned over: their harmonics differ in sign alone, which scales out."""
    figure = np.zeros((16, 16), bool)
    figure[3:5, 2:14] = figure[np.arange(6, 14), np.arange(3, 11)] = True
    signs = np.array([(1, 1)] * 9 + [(-1, 1)] * 3 + [(1, -1)] * 3 + [(-1, -1)])
    section = np.zeros((65, 65), bool)
    for n, (along, diagonal) in enumerate(signs):
        tile = (figure if along > 0 else figure.T)[:, ::diagonal]
        section[16 * (n // 4) :, 16 * (n % 4) :][:16, :16] = tile
    mean, scatter = signs.mean(axis=0), np.cov(signs.T) / 16
    squared = mean @ np.linalg.solve(scatter, mean)
    assert surface.alignment(section).p == pytest.approx(stats.f.sf(squared * 14 / 30, 2, 14))


@pytest.mark.parametrize(("ratio", "p", "said"), [(1.3, 1e-4, True), (1.1, 1e-4, False), (1.3, 0.01, False)])
def test_aligned_is_what_is_both_strong_and_no_chance(ratio, p, said):
    assert (surface.lies_aligned(surface.Alignment(ratio, 30.0, p)) is not None) == said


def test_what_is_left_open_is_two_standard_errors():
    words = surface.left_open(np.log(2) / 2, 0.01)
    assert "by a factor of 2 either way" in words
    assert "porosity by 0.02" in words
