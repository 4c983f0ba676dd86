"""The surface of a solid, in space and on its sections."""

import numpy as np
import pytest

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
    area = 4 * np.pi * 25**2 / (60**3 * 2)
    assert surface.specific_surface(~solid, 2.0) == pytest.approx(area, rel=0.02)
    assert surface.solid_surface(solid, 2.0).per_um == pytest.approx(3 / 50, rel=0.02)


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
