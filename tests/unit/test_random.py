"""Random numbers depend on seed, sample, realization and chapter, each of them, and on nothing else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from grainfall import random

ORIGIN = (1, "demo", 0, "packing/first")


def test_same_origin_same_numbers():
    a, b = (random.generator(*ORIGIN).random(8) for _ in range(2))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("k", range(4))
def test_each_part_of_the_origin_matters(k):
    other = list(ORIGIN)
    other[k] = (2, "demo2", 1, "packing/second")[k]
    assert (random.generator(*ORIGIN).random(8) != random.generator(*other).random(8)).all()


@given(st.tuples(*[st.integers(3, 9)] * 3), st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_slices_are_different_inside_and_balanced(shape, n, seed):
    drawn = random.slices(np.random.default_rng(seed), shape, n)
    assert len(drawn) == len(set(drawn))
    assert all(0 <= index < shape[axis] for axis, index in drawn)
    if n <= 3 * min(shape) - 2:
        assert len(drawn) == n
        assert np.ptp(np.bincount([axis for axis, _ in drawn], minlength=3)) <= 1


def test_slices_favour_no_axis_no_plane_and_no_order():
    rng = np.random.default_rng(0)
    drawn = [random.slices(rng, (10, 10, 10), 4) for _ in range(3000)]
    planes = np.bincount([10 * axis + index for one in drawn for axis, index in one], minlength=30)
    assert planes == pytest.approx(np.full(30, 400), abs=100)
    first = np.bincount([one[0][0] for one in drawn], minlength=3)
    assert first == pytest.approx(np.full(3, 1000), abs=130)


def test_parts_of_an_origin_do_not_run_into_each_other():
    """Neither (1, "1a", 12, "c") and (11, "a", 12, "c") nor a number and the chapter after it."""
    for one, other in (((1, "1a", 12, "c"), (11, "a", 12, "c")), ((1, "a", 1, "2c"), (1, "a", 12, "c"))):
        assert random.generator(*one).random() != random.generator(*other).random()
