"""What the simulated tomogram does to a rock, artefact by artefact; what is read of a published volume."""

import hashlib
import zipfile

import numpy as np
import pytest
import tifffile

from grainfall.errors import InputError
from grainfall.section import plane_of, read_known_volume, simulate_tomogram

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


def test_a_point_is_spread_by_as_many_voxels_as_asked():
    rock = np.zeros((41, 41, 41), bool)
    rock[20, 20, 20] = True
    grey = scan(rock, blur_voxels=2.0).grey
    along = (np.arange(41) - 20.0) ** 2
    for axis in range(3):
        profile = grey.sum(axis=tuple(a for a in range(3) if a != axis))
        assert np.sqrt(profile @ along / profile.sum()) == pytest.approx(2.0, rel=0.02)


def test_phantoms_are_counted_in_the_rock_not_in_what_was_crushed(balls):
    found = scan(balls, rim_um=40, crush_um=4, noise=0.4)
    assert found.phantom == pytest.approx((balls & ~found.solid).sum() / balls.sum())


def test_the_lining_is_as_thick_as_asked_at_the_outside():
    wall = np.zeros((16, 64, 64), bool)
    wall[:, :, :2] = True
    found = scan(wall, rim_um=1e9, crush_um=8)  # so deep a rim is crushed alike throughout
    assert (found.solid.sum(axis=2) == 2 + 4).all()


def test_a_plane_is_cut_along_the_axis_it_is_named_by():
    volume = np.random.default_rng(0).integers(0, 2, (4, 5, 6)).astype(np.uint8)
    for where, image in (("z1", volume[1]), ("y4", volume[:, 4]), ("x5", volume[..., 5])):
        section = plane_of(volume, 3.0, where)
        np.testing.assert_array_equal(section.phase, image)
        assert (section.pixel_size_um, section.notes) == (3.0, {"slice": where})
    for beyond in ("z4", "y5", "x6"):
        with pytest.raises(InputError, match=f"slice {beyond}"):
            plane_of(volume, 3.0, beyond)


def test_a_published_zip_holds_one_volume(tmp_path):
    volume = np.random.default_rng(0).integers(0, 2, (9, 8, 7)).astype(np.uint8)
    np.save(tmp_path / "rock.npy", volume)
    for names in (["a.npy"], ["a.npy", "b.npy"]):
        path = tmp_path / f"{len(names)}.zip"
        with zipfile.ZipFile(path, "w") as archive:
            for name in names:
                archive.write(tmp_path / "rock.npy", name)
        known_files = {hashlib.sha256(path.read_bytes()).hexdigest(): 0}
        if len(names) == 1:
            np.testing.assert_array_equal(read_known_volume(path, 3.0, known_files)[0], volume)
        else:
            with pytest.raises(InputError, match="holds 2 files"):
                read_known_volume(path, 3.0, known_files)


def test_noise_is_correlated_between_neighbours():
    """White noise smoothed by a Gaussian of width s: exp(-d^2 / 4 s^2) at a distance d, but for voxels."""
    halves = np.arange(64)[:, None, None] < np.full((64, 64, 64), 32)
    noise = scan(halves, noise=0.3).grey - halves
    for axis in range(3):
        one, other = np.take(noise, range(63), axis), np.take(noise, range(1, 64), axis)
        assert np.corrcoef(one.ravel(), other.ravel())[0, 1] == pytest.approx(np.exp(-1), abs=0.15)
