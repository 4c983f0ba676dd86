"""Splitting: what topology and geometry say must come out."""

import runpy

import edt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage
from skimage.io import imread
from skimage.morphology import disk, local_maxima, reconstruction

from grainfall.errors import InputError
from grainfall.morphology import coverage, split_grains, split_pores
from grainfall.morphology.split import smallest_radius

PHASES = arrays(np.uint8, st.tuples(st.integers(1, 24), st.integers(1, 24)), elements=st.integers(0, 2))


def discs(shape, centres, radii):
    """Union of discs, by pixel centres."""
    y, x = np.indices(shape) + 0.5
    image = np.zeros(shape, np.uint8)
    for (cy, cx), r in zip(centres, radii, strict=True):
        image[(y - cy) ** 2 + (x - cx) ** 2 < r * r] = 1
    return image


@pytest.mark.parametrize("radius", [20, 60])
@pytest.mark.parametrize("neck", [0.5, 0.8, 0.98])
@pytest.mark.parametrize("persistence", [0.1, 0.3])
def test_two_equal_discs_are_split_where_their_neck_is_narrow_enough(radius, neck, persistence):
    """Half the common chord of two discs at distance c is √(R² − c²/4): a saddle of known height."""
    half = radius * np.sqrt(1 - neck**2)
    centre = radius + 3.3
    image = discs(
        (int(2 * centre), int(2 * (centre + half))),
        [(centre, centre), (centre, centre + 2 * half)],
        [radius] * 2,
    )
    expected = 2 if 1 - neck > persistence else 1
    assert split_grains(image, persistence=persistence).max() == expected


def test_the_cut_lies_at_the_neck():
    """Two unequal discs: the basins meet on the common chord."""
    image = discs((100, 150), [(50, 45), (50, 105)], [38, 30])
    labels = split_grains(image)
    chord = 45 + (60**2 + 38**2 - 30**2) / (2 * 60)
    assert labels.max() == 2
    for label, side in (
        (labels[50, 45], slice(0, int(chord) - 2)),
        (labels[50, 105], slice(int(chord) + 3, 150)),
    ):
        assert set(np.unique(labels[:, side][image[:, side] > 0])) == {label}


@settings(max_examples=60, deadline=None)
@given(PHASES.map(lambda a: (a > 0).astype(np.uint8)))
def test_as_many_grains_as_h_maxima(image):
    """With no relative threshold the split counts the h-maxima of the distance map, h one pixel."""
    distance = edt.edt(image, black_border=False).astype(np.float64)
    if not np.isfinite(distance).all():
        return
    # Persistence of exactly one pixel is kept; a little less is asked for so that rounding cannot decide.
    # (scikit-image's h_maxima marks every peak of one h-maximum: its definition is spelt out instead.)
    capped = reconstruction(distance - (1 - 1e-3), distance, footprint=disk(1))
    count = ndimage.label(local_maxima(capped, connectivity=1) & (distance > 0))[1]
    assert split_grains(image, persistence=0, min_radius_px=0).max() == count


@settings(max_examples=60, deadline=None)
@given(PHASES, st.floats(0, 0.9))
def test_a_grain_is_one_connected_piece_of_one_mineral(phase, persistence):
    labels = split_grains(phase, persistence=persistence, min_radius_px=0)
    assert np.array_equal(labels > 0, phase > 0)
    first = [np.flatnonzero(labels == k)[0] for k in range(1, labels.max() + 1)]
    assert first == sorted(first)
    for k in range(1, labels.max() + 1):
        assert ndimage.label(labels == k)[1] == 1
        assert len(np.unique(phase[labels == k])) == 1


@settings(max_examples=30, deadline=None)
@given(PHASES, st.floats(0, 0.5), st.floats(0, 0.45))
def test_a_higher_threshold_only_joins(phase, persistence, more):
    """Basins at a higher threshold are unions of those at a lower one."""
    fine = split_grains(phase, persistence=persistence, min_radius_px=0)
    coarse = split_grains(phase, persistence=persistence + more, min_radius_px=0)
    for k in range(1, fine.max() + 1):
        assert len(np.unique(coarse[fine == k])) == 1


def test_specks_get_no_label_and_are_counted():
    phase = discs((40, 60), [(20, 20), (20, 50)], [12, 1.4])
    labels = split_grains(phase, min_radius_px=2)
    assert labels.max() == 1
    report = coverage(labels, phase > 0)
    speck = np.count_nonzero(phase[:, 40:])
    assert report == {"objects": 1, "speck_fraction": speck / np.count_nonzero(phase)}
    assert split_grains(phase, min_radius_px=0).max() == 2


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.01])
def test_pinholes_do_not_break_grains(noise):
    """Wrong pixels are specks: as many grains as without them, each with its area."""
    rng = np.random.default_rng(8)
    centres = [(40, 40), (40, 108), (110, 75)]
    phase = discs((150, 150), centres, [35, 35, 36])
    noisy = np.where(rng.random(phase.shape) < noise, rng.integers(0, 3, phase.shape), phase).astype(np.uint8)
    labels = split_grains(noisy)
    assert labels.max() == 3
    for (y, x), r in zip(centres, [35, 35, 36], strict=True):
        grain = labels == np.bincount(labels[y - 5 : y + 5, x - 5 : x + 5].ravel())[1:].argmax() + 1
        assert grain.sum() == pytest.approx(np.pi * r * r, rel=0.02 + noise)
        assert set(np.unique(noisy[grain])) == {1}


def test_a_speck_in_a_pore_is_an_obstacle():
    """Grains forget it; pores do not."""
    phase = np.ones((60, 60), np.uint8)
    phase[10:50, 10:50] = 0
    phase[29:31, 29:31] = 1
    assert (split_pores(phase) > 0).sum() == 40 * 40 - 4
    assert not split_grains(phase)[29:31, 29:31].any()


def test_outlines_are_taken_as_they_are():
    """Two pieces, or two minerals, under one outline are different grains; solid outside outlines is none."""
    instances = np.zeros((20, 40), np.int32)
    instances[2:18, 2:10] = instances[2:18, 10:18] = 7
    instances[2:8, 20:28] = instances[12:18, 20:28] = 9
    instances[2:18, 30:34], instances[2:18, 34:38] = 3, 4
    phase = (instances > 0).astype(np.uint8)
    phase[2:18, 10:18] = 2
    phase[0, :] = 1
    labels = split_grains(phase, instances)
    assert labels.max() == 6
    assert not labels[0].any()
    assert labels[5, 5] != labels[5, 12]
    assert labels[5, 22] != labels[15, 22]
    assert labels[5, 31] != labels[5, 36]


def test_pores_are_split_as_grains_are():
    solid = 1 - discs((90, 160), [(45, 45), (45, 110)], [35, 35])
    assert split_pores(solid).max() == 2
    assert np.array_equal(split_pores(solid) > 0, solid == 0)


@pytest.mark.parametrize("value", [0, 1])
def test_an_image_of_one_phase(value):
    phase = np.full((9, 7), value, np.uint8)
    assert split_grains(phase).max() == value
    assert split_pores(phase).max() == 1 - value


@pytest.mark.parametrize("wrong", [-0.1, 1.0, np.nan])
def test_a_threshold_out_of_range_is_the_users_mistake(wrong):
    with pytest.raises(InputError, match="persistence"):
        split_grains(np.ones((5, 5), np.uint8), persistence=wrong)


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="instances"):
        split_grains(np.ones((5, 5), np.uint8), np.ones((5, 6), int))
    with pytest.raises(InputError, match="phase"):
        split_grains(np.ones((5, 5)))


def test_real_grains_are_found(shared_data, root):
    """A thin section known as grain or not, against its hand outlines: the aim is an F1 of 0.85."""
    score = runpy.run_path(str(root / "tests" / "benchmarks" / "segmentation.py"))["score"]
    folder = shared_data / "thin_section"
    solid = imread(folder / "miocene_20_2_mask.png") > 0
    truth = np.load(folder / "miocene_20_2_instances.npz")["labels"]
    assert score(truth, split_grains(solid.astype(np.uint8)))["f1"] >= 0.85


def test_the_limit_lies_between_the_largest_speck_and_the_smallest_grain():
    """A circle of radius 2 has 12.6 pixels: 13 make a grain, 12 none."""
    assert np.pi * smallest_radius(2.0) ** 2 == pytest.approx(12.5)
    phase = np.zeros((9, 30), np.uint8)
    phase[2:5, 2:6] = phase[2:5, 12:16] = phase[5, 12] = 1
    labels = split_grains(phase, persistence=0.9)
    assert labels.max() == 1
    assert labels[3, 13] == 1


def test_a_hole_larger_than_a_pixels_radius_stays_a_hole():
    """Three pixels are wrong ones; four may be the gap between grains, and shape the distances around it."""
    phase = np.zeros((50, 50), np.uint8)
    phase[5:45, 5:45] = 1
    small, large = phase.copy(), phase.copy()
    small[24, 24:27], large[24:26, 24:26] = 0, 0
    assert split_grains(small).max() == 1
    assert split_grains(large).max() > 1
