"""Sections and volumes at another pixel size."""

import numpy as np
import pytest

from grainfall import io
from grainfall.section import resample


@pytest.mark.parametrize(("size", "target"), [(2.0, 3.0), (1.0, 1.0), (5.0, 3.0), (0.7, 1.4)])
def test_an_open_volume_gives_what_the_array_gives(tmp_path, size, target):
    volume = np.random.default_rng(0).integers(0, 9, (13, 8, 10)).astype(np.uint8)
    expected = resample(volume, size, target)
    io.write_volume(tmp_path / "v.zarr.zip", {"phase": volume}, size)
    with io.open_volume(tmp_path / "v.zarr.zip", "phase") as (array, _):
        seen = resample(array, size, target)
        assert tuple(seen.shape) == expected.shape
        np.testing.assert_array_equal(seen[...] if size == target else seen[()], expected)
        for index in ((3,), (slice(None), 2), (slice(None), slice(None), 1), np.s_[1:3, :4, 2:]):
            np.testing.assert_array_equal(seen[index], expected[index])


@pytest.mark.parametrize("size", [1.2, 0.7, 5.345, 1.0])
@pytest.mark.parametrize("ratio", [2, 4])
def test_an_even_ratio_steps_evenly_whatever_the_unit(size, ratio):
    taken = resample(np.arange(2000), size, ratio * size)
    assert (np.diff(taken) == ratio).all()


@pytest.mark.parametrize(("size", "target", "taken"), [(1.0, 3.0, [1, 4, 7, 10]), (2.0, 1.0, [0, 0, 1, 1])])
def test_what_lies_at_a_pixels_centre_is_taken(size, target, taken):
    assert resample(np.arange(12), size, target)[:4].tolist() == taken


def test_an_edge_of_whole_pixels_loses_none_to_rounding():
    assert resample(np.arange(90), 0.7, 0.9).shape == (70,)
    assert [resample(np.arange(n), 0.6, 0.2).size for n in range(1, 60)] == [3 * n for n in range(1, 60)]
