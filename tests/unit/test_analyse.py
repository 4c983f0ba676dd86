"""One analysis for a section and for slices of a volume."""

import numpy as np
import pytest

from grainfall import morphology
from grainfall.morphology.split import smallest_radius


@pytest.fixture(scope="module")
def balls():
    """Well separated balls of two minerals, and the number of each ball."""
    phase = np.zeros((60, 90, 90), np.uint8)
    body = np.zeros(phase.shape, np.int32)
    z, y, x = np.indices(phase.shape)
    for k, (cy, cx) in enumerate([(22, 22), (22, 66), (66, 22), (66, 66)]):
        inside = (z - 30) ** 2 + (y - cy) ** 2 + (x - cx) ** 2 < 14**2
        phase[inside], body[inside] = 1 + k % 2, k + 1
    return phase, body


def test_a_slice_is_measured_as_a_section(balls):
    phase, _ = balls
    section = morphology.analyse(np.ascontiguousarray(phase[30]), 2.0)
    grains, pores = morphology.measure_slices(phase, 2.0, [(0, 30)])
    assert len(section.grains) == 4
    assert (grains.r_um.to_numpy() == section.grains.r_um.to_numpy()).all()
    assert (pores.r_um.to_numpy() == section.pores.r_um.to_numpy()).all()
    assert grains.phase.value_counts().to_dict() == {1: 2, 2: 2}
    assert grains.r_um.to_numpy() == pytest.approx(28.0, rel=0.01)


def test_slices_are_told_apart(balls):
    phase, body = balls
    grains, _ = morphology.measure_slices(phase, 1.0, [(0, 30), (1, 22), (2, 66)], body=body)
    assert grains.groupby("slice").size().tolist() == [4, 2, 2]
    assert grains.groupby("slice").axis.first().tolist() == ["z", "y", "x"]
    assert grains.groupby("slice")["index"].first().tolist() == [30, 22, 66]


def test_outlines_keep_touching_grains_apart():
    """Two halves of one disc cannot be told apart by shape; with their bodies known they are two grains."""
    y, x = np.indices((50, 50))
    phase = ((y - 25) ** 2 + (x - 25) ** 2 < 18**2).astype(np.uint8)
    halves = np.where(x < 25, 1, 2) * phase
    assert len(morphology.analyse(phase, 1.0).grains) == 1
    assert len(morphology.analyse(phase, 1.0, instances=halves).grains) == 2


def test_summary_counts_every_pixel(balls):
    phase = np.ascontiguousarray(balls[0][30])
    summary = morphology.analyse(phase, 1.0).summary(["pore", "a", "b"])
    assert summary["porosity"] == pytest.approx((phase == 0).mean())
    minerals = [(phase == k).sum() / (phase > 0).sum() for k in (1, 2)]
    assert summary["fractions"] == pytest.approx(minerals)
    assert summary["n_grains"] == 4


def test_slices_are_measured_as_they_are_shown(balls):
    """What a section would show of a slice, by the slice's bodies; outlined or not."""
    phase, body = balls

    def swapped(plane, owner):
        assert plane.shape == owner.shape
        return np.where(owner > 0, 3 - plane, plane).astype(np.uint8)

    plain, _ = morphology.measure_slices(phase, 1.0, [(0, 30)])
    grains, _ = morphology.measure_slices(phase, 1.0, [(0, 30)], body=body, outlined=False, shown=swapped)
    assert (grains.phase == 3 - plain.phase).all()
    assert (grains.r_um == plain.r_um).all()


def test_grains_and_pores_are_split_by_thresholds_of_their_own():
    """Two discs whose neck is 0.8 of their radius: a persistence of 0.2."""
    y, x = np.indices((66, 114))
    pair = ((y - 33) ** 2 + np.minimum((x - 33) ** 2, (x - 81) ** 2) < 30**2).astype(np.uint8)
    for grain, pore in ((0.1, 0.5), (0.5, 0.1)):
        given = {"grain_persistence": grain, "pore_persistence": pore}
        assert len(morphology.analyse(pair, 1.0, **given).grains) == (2 if grain == 0.1 else 1)
        assert len(morphology.analyse(1 - pair, 1.0, **given).pores) == (2 if pore == 0.1 else 1)


def test_a_summary_tells_cut_grains_and_specks_and_is_in_micrometres():
    phase = np.zeros((40, 60), np.uint8)
    phase[10:20, 10:20] = phase[10:20, 50:60] = phase[30:33, 30] = 1  # whole, cut, a speck
    found = morphology.analyse(phase, 2.0)
    summary = found.summary(["pore", "grain"])
    assert (summary["n_grains"], summary["n_grains_uncut"]) == (2, 1)
    assert summary["smallest_grain_um"] == pytest.approx(2 * smallest_radius(2.0))
    assert summary["grain_speck_fraction"] == pytest.approx(3 / 203)
    assert summary["pore_speck_fraction"] == 0
    assert found.pores.area_um2.sum() == pytest.approx(4 * (phase == 0).sum())
