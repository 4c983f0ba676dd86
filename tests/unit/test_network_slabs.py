"""Pore networks slab by slab: whatever the slabs, what comes of the whole volume."""

from itertools import pairwise

import edt
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from grainfall.network import distance


def medium(seed: int, shape: tuple[int, int, int], porosity: float, blur: float) -> np.ndarray:
    """Pore space of blurred noise: the highest values."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(shape), blur, mode="wrap")
    return noise > np.quantile(noise, 1 - porosity)


def distances_by_slabs(pore: np.ndarray, cuts: list[int]) -> list[np.ndarray]:
    ends = [distance.solid_columns(pore[lo:hi], lo) for lo, hi in pairwise(cuts)]
    return [
        distance.squared_distances(
            pore[cuts[i] : cuts[i + 1]],
            cuts[i],
            *distance.nearest_columns(ends[:i][::-1], ends[i + 1 :]),
        )
        for i in range(len(ends))
    ]


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10**6),
    st.tuples(st.integers(1, 14), st.integers(1, 9), st.integers(1, 9)),
    st.floats(0.02, 0.999),
    st.floats(0, 2),
    st.sets(st.integers(1, 13)),
)
def test_distances_of_slabs_are_those_of_the_volume(seed, shape, porosity, blur, cuts):
    pore = medium(seed, shape, porosity, blur)
    pore.flat[seed % pore.size] = False  # columns without solid are many where this is all there is
    cuts = [0, *sorted(c for c in cuts if c < shape[0]), shape[0]]
    found = np.concatenate(distances_by_slabs(pore, cuts))
    assert np.array_equal(found, edt.edtsq(pore, black_border=False))


def test_distances_are_kept_in_two_bytes_where_they_fit():
    pore = np.ones((300, 2, 2), bool)
    pore[0, 0, 0] = False
    found = distances_by_slabs(pore, [0, 100, 300])
    assert [part.dtype for part in found] == [np.uint16, np.uint32]
    assert np.array_equal(np.concatenate(found), edt.edtsq(pore, black_border=False))
    assert found[1].max() == 299**2 + 2


def test_distances_to_no_solid_are_none():
    for part in distances_by_slabs(np.ones((5, 3, 3), bool), [0, 1, 5]):
        assert not part.any()
