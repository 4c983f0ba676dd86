"""What the simulated tomogram does to a rock, artefact by artefact; what is read of a published volume."""

import hashlib

import numpy as np
import pytest
import tifffile

from grainfall.errors import InputError
from grainfall.section import read_known_volume, simulate_tomogram

CLEAN = {"binning": 1, "blur_voxels": 0.0, "noise": 0.0, "cupping": 0.0}


@pytest.fixture(scope="module")
def balls():
    """Spheres of radius 6 on a lattice of 16, in 64 cubed."""
    at = (np.arange(64) + 0.5) % 16 - 8
    return at[:, None, None] ** 2 + at[:, None] ** 2 + at**2 < 36


def scan(rock, **over):
    return simulate_tomogram(rock, 2.0, np.random.default_rng(3), **{**CLEAN, **over})


def test_without_artefacts_it_is_the_rock(balls):
    found = scan(balls)
    assert (found.solid == balls).all()
    assert found.phantom == 0
    assert found.voxel_size_um == 2.0


def test_partial_volume_keeps_the_mean(balls):
    found = scan(balls, binning=2)
    assert found.grey.shape == (32, 32, 32)
    assert found.voxel_size_um == 4.0
    assert found.grey.mean() == pytest.approx(balls.mean(), abs=1e-6)


def test_noise_makes_phantom_pores_and_has_the_size_asked_for():
    halves = np.arange(64)[:, None, None] < np.full((64, 64, 64), 32)
    found = scan(halves, noise=0.3)
    assert (found.grey - halves).std() == pytest.approx(0.3, rel=0.01)
    # a half between the classes lies 0.5 / 0.3 standard deviations off: 4.8 % of a normal distribution
    assert found.phantom == pytest.approx(0.048, abs=0.005)
    assert scan(halves, noise=0.1).phantom < 1e-3


def test_beam_hardening_darkens_the_axis():
    found = scan(np.pad(np.ones((16, 60, 60), bool), ((0, 0), (2, 2), (2, 2))), cupping=0.2)
    assert found.grey[8, 31, 31] == pytest.approx(0.8, abs=0.01)
    assert found.grey[8, 4, 4] > 0.93


def test_the_rim_is_crushed_and_the_middle_is_not(balls):
    found = scan(balls, rim_um=40, crush_um=4)
    added = found.solid & ~balls
    assert not (balls & ~found.solid).any()
    y, x = np.indices((64, 64)) - 31.5
    outside = np.hypot(y, x) * 2 > np.hypot(31.5, 31.5) * 2 - 40
    assert added[:, outside].any()
    assert not added[:, ~outside].any()


def test_same_numbers_same_scan(balls):
    assert (scan(balls, noise=0.2).grey == scan(balls, noise=0.2).grey).all()


def test_too_coarse_is_refused(balls):
    with pytest.raises(InputError, match="at least 8"):
        scan(balls, binning=16)
    with pytest.raises(InputError, match="at least 8"):
        scan(balls, binning=0)


def test_a_published_volume_is_known_by_its_checksum(tmp_path):
    volume = np.random.default_rng(0).integers(0, 2, (9, 8, 7)).astype(np.uint8)
    path = tmp_path / "rock.tif"
    tifffile.imwrite(path, volume)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    found, voxel = read_known_volume(path, 3.0, {digest: 1})
    assert voxel == 3.0
    assert (found == (volume != 1)).all()
    with pytest.raises(InputError, match="SHA-256"):
        read_known_volume(path, 3.0, {"0" * 64: 1})
    with pytest.raises(InputError, match=r"nowhere\.tif"):
        read_known_volume(tmp_path / "nowhere.tif", 3.0, {digest: 1})
