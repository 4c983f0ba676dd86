"""Minerals by rule: the first match decides, every grain has one mineral, pixels and table agree."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from grainfall.errors import InputError
from grainfall.morphology.classify import classify_grains

PHASES = ("pore", "quartz", "feldspar", "mica")
LABELS = np.array([[0, 1, 1, 0, 2, 2], [3, 3, 0, 4, 4, 0]])
TABLE = pd.DataFrame(
    {
        "grain": [1, 2, 3, 4],
        "phase": [1, 1, 1, 1],
        "mean_grey": [100.0, 130.0, 130.0, 90.0],
        "aspect_ratio": [1.0, 1.0, 4.0, np.nan],
        "r_um": [5.0, 10.0, 20.0, 40.0],
    }
)
GREY = {"phase": "feldspar", "feature": "mean_grey", "above": 120}
LONG = {"phase": "mica", "feature": "aspect_ratio", "above": 3}


SOLID = (LABELS > 0).astype(np.uint8)


def classify(rules, table=TABLE, phases=PHASES, phase=SOLID):
    return classify_grains(table, LABELS, phase, rules, phases)


def test_the_first_rule_that_matches_decides():
    table, phase = classify([LONG, GREY])
    assert table["phase"].tolist() == [1, 2, 3, 1]
    np.testing.assert_array_equal(phase, [[0, 1, 1, 0, 2, 2], [3, 3, 0, 1, 1, 0]])
    assert phase.dtype == np.uint8
    assert TABLE["phase"].tolist() == [1, 1, 1, 1]
    with pytest.raises(InputError, match="no grain is mica"):
        classify([GREY, LONG])


def test_bounds_are_strict_and_may_be_two():
    between = {"phase": "feldspar", "feature": "r_um", "above": 5, "below": 40}
    assert classify([between], phases=PHASES[:3])[0]["phase"].tolist() == [1, 2, 2, 1]


def test_pixels_of_no_grain_keep_their_phase():
    with_speck = SOLID.copy()
    with_speck[0, 3] = 1
    _, phase = classify([GREY], phases=PHASES[:3], phase=with_speck)
    assert phase[0, 3] == 1
    assert phase[0, 0] == 0


@given(st.lists(st.floats(0, 50), min_size=2, max_size=2, unique=True).map(sorted))
def test_pixels_agree_with_the_table_and_porosity_stays(bounds):
    rule = {"phase": "feldspar", "feature": "r_um", "above": bounds[0], "below": bounds[1]}
    inside = [bounds[0] < r < bounds[1] for r in TABLE["r_um"]]
    if all(inside) or not any(inside):
        with pytest.raises(InputError, match="no grain is"):
            classify([rule], phases=PHASES[:3])
        return
    table, phase = classify([rule], phases=PHASES[:3])
    assert table["phase"].tolist() == [2 if i else 1 for i in inside]
    np.testing.assert_array_equal(phase, np.r_[0, table["phase"]][LABELS])


@pytest.mark.parametrize(
    ("rule", "match"),
    [
        ({**GREY, "feature": "mean_gray"}, "'mean_gray' is unknown; 'mean_grey'"),
        ({**GREY, "phase": "felspar"}, "'felspar' is unknown; 'feldspar'"),
        ({**GREY, "phase": "pore"}, "phase 'pore' is unknown"),
        ({**GREY, "abov": 3}, "key 'abov' is unknown; 'above'"),
        ({"feature": "r_um", "above": 3}, "no phase"),
        ({"phase": "mica", "above": 3}, "no feature"),
        ({"phase": "mica", "feature": "r_um"}, "neither above nor below"),
        ({**GREY, "above": "much"}, "'much' is no number"),
        ({**GREY, "above": float("nan")}, "no number"),
        ({**GREY, "above": 9, "below": 9}, "nothing is above 9 and below 9"),
        ("feldspar", "no rule"),
    ],
)
def test_a_rule_that_cannot_be_meant(rule, match):
    with pytest.raises(InputError, match=match):
        classify([rule])


def test_mean_grey_needs_a_grey_image():
    with pytest.raises(InputError, match="needs a grey image"):
        classify([GREY], table=TABLE.drop(columns="mean_grey"))
