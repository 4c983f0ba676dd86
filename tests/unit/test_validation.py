"""The validation table and its words follow from the twins' figures, and from nothing else."""

import math
import re

import numpy as np
import pandas as pd
import pytest
import yaml
from matplotlib.figure import Figure
from scipy import ndimage

from grainfall import io, network, surface
from grainfall.report import paper_figures, save_figure
from grainfall.report.claims import NOT_RUN, NOT_SHOWN, OPEN, SHOWN, claims, row_of
from grainfall.report.ensembles import t_interval
from grainfall.report.figures import note_figure
from grainfall.report.paper_figures import FIGURES, Cases
from grainfall.report.texts import cases_in_words
from grainfall.report.validation import (
    COLUMNS,
    PAPER,
    REFERENCE_ENVELOPE,
    _alike,
    _circle_tail,
    _flow,
    _flow_figures,
    _grain_figures,
    _nearer,
    _of_envelope,
    _of_references,
    _of_section,
    _of_sweep,
    _of_twin,
    _paired,
    _pore_figures,
    _resettled_figures,
    aggregate,
    berea_slices,
    describe,
    section_surface_ratio,
    slice_porosities,
    slice_surfaces,
)
from grainfall.report.validation_page import build_validation


def figures(values, case="stereology", variant="full", quantity="k_ratio", truth=1.0):
    """Long figures of the given samples: {sample: [value of each realization]}."""
    rows = [
        (case, sample, variant, n, quantity, value, truth)
        for sample, own in values.items()
        for n, value in enumerate(own)
    ]
    return pd.DataFrame(
        rows, columns=["case", "sample", "variant", "realization", "quantity", "value", "truth"]
    )


def test_interval_is_over_sections_where_there_are_several():
    """Many twins of two sections are two independent things, not many."""
    own = {"a": [1.0, 1.02, 0.98], "b": [1.1, 1.08, 1.12]}
    row = aggregate(figures(own)).iloc[0]
    _, mean, lower, upper = t_interval(np.array([1.0, 1.1]))
    assert (row["mean"], row["lower"], row["upper"]) == pytest.approx((mean, lower, upper))
    assert (row["n"], row["sections"]) == (6, 2)


def test_a_single_section_has_the_interval_of_its_twins_and_a_single_twin_none():
    row = aggregate(figures({"a": [1.0, 1.2, 1.1]})).iloc[0]
    assert row["lower"] < 1.1 < row["upper"]
    assert aggregate(figures({"a": [1.0]})).iloc[0][["lower", "upper"]].isna().all()


def test_sections_of_one_volume_share_its_truth():
    row = aggregate(figures({"x": [1502.0], "y": [1502.0]}, "berea", "truth", "k_md")).iloc[0]
    assert (row["mean"], row["n"], row["sections"]) == (1502, 1, 1)
    assert math.isnan(row["lower"])


def test_truths_that_share_a_value_are_still_of_their_own():
    """Radii of networks are roots of whole numbers of voxels: two rocks often have the same."""
    k = figures({"a": [500.0], "b": [510.0], "c": [505.0]}, "xct", "truth", "k_md")
    tail = figures({"a": [12.8], "b": [13.3], "c": [12.8]}, "xct", "truth", "pore_r95_um")
    table = aggregate(pd.concat([k, tail], ignore_index=True)).set_index("quantity")
    assert table["sections"].to_list() == [3, 3]
    assert table.loc["pore_r95_um", "mean"] == pytest.approx((2 * 12.8 + 13.3) / 3)


def test_what_cannot_be_negative_has_no_negative_bounds():
    share = figures({"a": [0.0], "b": [0.01], "c": [0.0]}, quantity="cement_share")
    assert aggregate(share).iloc[0]["lower"] == 0
    assert aggregate(share.assign(quantity="w1_f3d_nearer")).iloc[0]["lower"] < 0
    p = aggregate(figures({"a": [0.2, 0.2], "b": [0.9, 0.9]}, quantity="s2_envelope_p")).iloc[0]
    assert (p["lower"], p["upper"]) == (0.2, 0.9)


def test_what_was_not_measured_counts_for_nothing():
    row = aggregate(figures({"a": [1.0, math.nan, 1.2]})).iloc[0]
    assert (row["mean"], row["n"]) == (pytest.approx(1.1), 2)


def test_a_miss_is_the_largest_one():
    row = aggregate(figures({"a": [1e-5, 4e-4], "b": [2e-5]}, quantity="porosity_miss", truth=0.0)).iloc[0]
    assert row["mean"] == 4e-4


def test_paper_numbers_stand_beside_their_own_quantity():
    table = aggregate(pd.concat([figures({"a": [900.0]}, quantity="k_md"), figures({"a": [0.9]})]))
    assert table.set_index("quantity")["paper"].to_dict() == pytest.approx(
        {"k_md": 1272, "k_ratio": 1272 / 1080}
    )
    assert set(COLUMNS) <= set(table.columns)
    for _, _, quantity in PAPER:
        assert describe(quantity).label


def flow_table(path, k_md, factor):
    """A flow table of one method, and what the table of the cases makes of it."""
    table = {"method": "network", "axis": list("xyz"), "k_md": k_md, "formation_factor": factor, "wall_s": 1}
    io.write_table(path, pd.DataFrame(table))
    return _flow(path)["network"]


def test_flow_beside_the_truth(tmp_path):
    own = flow_table(tmp_path / "twin.csv", [100.0, 140.0, 60.0], [10.0, 12.0, 17.0])
    truth = flow_table(tmp_path / "truth.csv", [100.0, 100.0, 100.0], [10.0, 10.0, 10.0])
    found = _flow_figures(own, truth)
    assert found["k_md"] == (100, 100)
    assert found["k_z_md"] == (60, 100)
    assert found["k_ratio"] == (1, 1)
    assert found["k_z_over_xy"] == (0.5, 1)
    assert found["f_ratio"] == (1.3, 1)
    assert all(describe(quantity).label for quantity in found)
    # nothing flows along z: K is 0 there, and a formation factor there is none
    blocked = flow_table(tmp_path / "blocked.csv", [100.0, 140.0, 0.0], [10.0, 12.0, math.nan])
    found = _flow_figures(blocked, truth)
    assert found["k_ratio"] == (0.8, 1)
    assert found["k_z_over_xy"] == (0, 1)
    assert math.isnan(found["f_ratio"][0])
    # nor is there a ratio to what was not measured
    assert _flow_figures(own, {})["f_ratio"][0] is None


def test_sizes_twice_as_large_are_so_by_any_measure():
    rng = np.random.default_rng(1)
    pores = {
        "pore_radius_um": rng.lognormal(2, 0.4, 500),
        "pore_volume_um3": rng.random(500),
        "throat_radius_um": rng.lognormal(1, 0.4, 900),
    }
    twice = {name: values if "volume" in name else 2 * values for name, values in pores.items()}
    found = _pore_figures(twice, pores)
    ratios = [value for quantity, (value, _) in found.items() if quantity.endswith("_ratio")]
    assert ratios == pytest.approx([2] * 5)
    # specks, like phantom pores in grains, are most of the pores and next to nothing of their volume
    specks = pores | {
        "pore_radius_um": np.append(pores["pore_radius_um"], np.full(900, 0.5)),
        "pore_volume_um3": np.append(pores["pore_volume_um3"], np.full(900, 1e-9)),
    }
    found = _pore_figures(specks, pores)
    assert found["pore_median_ratio"][0] < 0.2
    assert found["pore_r50_ratio"][0] == 1
    grains = pd.DataFrame({"phase": rng.integers(1, 3, 400), "r_um": rng.lognormal(3, 0.3, 400)})
    found = _grain_figures(grains.assign(scale=2 * grains["r_um"]), grains, 1.0, 1.0)
    assert (found["r_mean_ratio"][0], found["rs_ratio"][0]) == pytest.approx((2, 2))
    # a few large grains have much of the volume and little of the number
    few = grains.assign(scale=np.where(grains.index < 8, 3, 1) * grains["r_um"])
    found = _grain_figures(few, grains, 1.0, 1.0)
    assert found["rs_ratio"][0] > found["r_mean_ratio"][0] > 1


def verdict(values, **over):
    return next(c for c in claims(aggregate(figures(values))) if c.claim.startswith("With the inversion"))


@pytest.mark.parametrize(
    ("values", "status"),
    [
        ({"a": [1.01], "b": [1.02], "c": [1.0]}, SHOWN),
        ({"a": [1.5], "b": [1.52], "c": [1.48]}, NOT_SHOWN),
        ({"a": [0.8], "b": [1.3], "c": [1.1]}, OPEN),  # the mean is inside, the interval is not
        ({"a": [1.01]}, OPEN),  # a single twin shows nothing
    ],
)
def test_a_claim_holds_only_where_the_whole_interval_does(values, status):
    assert verdict(values).status == status


def test_what_was_not_begun_is_not_run_and_comes_after_what_was():
    assert {c.status for c in claims(aggregate(figures({})))} == {NOT_RUN}
    found = claims(aggregate(figures({"x": [1.02]}, "berea")))
    assert {c.status for c in found if c.case == "berea"} == {OPEN}  # begun, and too few twins
    assert [c.status == NOT_RUN for c in found] == sorted(c.status == NOT_RUN for c in found)


def test_nearer_is_said_of_paired_differences():
    """Each section's twins against its own tomogram, or against its own twins of the same numbers."""

    def twins(full, other, variant="tomogram", realizations=(-1,)):
        rows = [("full", n, {"k_ratio": (value, 1.0)}) for n, value in enumerate(full)]
        return rows + [(variant, n, {"k_ratio": (v, 1.0)}) for n, v in zip(realizations, other, strict=True)]

    def difference(*arguments):
        return [(row[2], row[4], pytest.approx(row[5])) for row in _nearer("xct", "a", twins(*arguments))]

    # 0.9 and 1.1 are right together, but a tomogram is one, and so is a twin
    assert difference([0.9, 1.1], [1.13]) == [("tomogram", "k_ratio_nearer", 0.03)]
    # realization 1 has no partner
    assert difference([0.9, 2.0], [0.8], "touching", (0,)) == [("touching", "k_ratio_nearer", 0.1)]
    assert difference([0.9], [], "touching", ()) == []
    assert difference([None], [1.1]) == []


@pytest.mark.parametrize(
    ("by", "status"),
    [
        ({"a": [0.03], "b": [0.035], "c": [0.032]}, SHOWN),
        ({"a": [-0.03], "b": [-0.035], "c": [-0.032]}, NOT_SHOWN),
        ({"a": [0.03], "b": [-0.02], "c": [0.01]}, OPEN),
        ({"a": [0.03]}, OPEN),  # a single section shows nothing
    ],
)
def test_twin_and_tomogram_are_told_apart_by_the_whole_interval(by, status):
    table = aggregate(figures(by, "xct", "tomogram", "k_ratio_nearer", 0.0))
    assert next(c for c in claims(table) if c.claim.startswith("By K")).status == status


@pytest.mark.parametrize(
    ("by", "status"),
    [
        ({"a": [0.52], "b": [0.54], "c": [0.53]}, SHOWN),
        ({"a": [1.22], "b": [1.24], "c": [1.23]}, NOT_SHOWN),
        ({"a": [0.8], "b": [1.2], "c": [0.7]}, OPEN),
        ({"a": [0.5]}, OPEN),
    ],
)
def test_a_tomograms_pores_are_small_where_all_sections_say_so(by, status):
    table = aggregate(figures(by, "xct", "tomogram", "pore_median_ratio", 1.0))
    assert next(c for c in claims(table) if "small radii" in c.claim).status == status


def test_claims_say_how_far_cubes_of_the_truth_are_from_each_other():
    def said(table, case, of):
        return next(c.ours for c in claims(table) if c.case == case and of in c.claim)

    for case, of in (("xct", "pore sizes"), ("virtual_spheres", "tail")):
        twins = figures({"a": [0.09], "b": [0.08]}, case, "full", "w1_pores", 0.0)
        cubes = figures({"a": [0.061], "b": [0.063]}, case, "truth", "w1_pores", 0.0)
        words = "one cube of the truth to its others"
        assert words not in said(aggregate(twins), case, of)
        assert f"{words} 0.062" in said(aggregate(pd.concat([twins, cubes])), case, of)


@pytest.mark.parametrize(
    ("half", "status"), [(0.01, SHOWN), (0.05, OPEN), (0.2, NOT_SHOWN), (2.0, NOT_SHOWN)]
)
def test_one_slice_of_berea_is_judged_by_one_more_not_by_their_mean(half, status):
    own = figures({"x": [1.02 - half], "y": [1.02], "z": [1.02 + half]}, "berea")
    assert next(c for c in claims(aggregate(own)) if c.case == "berea").status == status


@pytest.mark.parametrize(("values", "status"), [([1.02], OPEN), ([1.3, 1.3, 1.3], NOT_SHOWN)])
def test_one_slice_of_berea_and_slices_that_agree(values, status):
    own = figures({f"slice_{n}": [value] for n, value in enumerate(values)}, "berea")
    found = next(c for c in claims(aggregate(own)) if c.case == "berea")
    assert found.status == status
    assert ("one more slice" in found.ours) == (len(values) > 1)


def test_many_slices_that_all_miss_do_not_make_one_that_holds():
    """Their mean is 1 to 3 %, and each is off by a quarter."""
    own = figures({f"slice_{n}": [0.75 + n % 2 / 2] for n in range(50)}, "berea")
    found = next(c for c in claims(aggregate(own)) if c.case == "berea")
    assert found.status == NOT_SHOWN
    assert "one more slice of this volume would have 0.48" in found.ours


def test_twins_of_a_single_section_show_nothing_of_others():
    own = figures({"a": [0.98, 0.99, 1.0, 1.01, 1.02]}, "stereology")
    assert next(c for c in claims(aggregate(own)) if c.case == "stereology").status == OPEN


def test_shares_end_at_1_and_p_is_a_median():
    told = figures({s: [v] for s, v in zip("abc", (1.0, 0.96, 0.4), strict=True)}, "xct")
    (row,) = aggregate(told.assign(quantity="s2_windows_rejected")).itertuples()
    assert row.upper == 1
    (row,) = aggregate(told.assign(quantity="s2_envelope_p")).itertuples()
    assert (row.mean, row.lower, row.upper) == (0.96, 0.4, 1.0)


@pytest.mark.parametrize(("spread", "status"), [(0.05, SHOWN), (0.5, NOT_SHOWN)])
def test_what_one_slice_says_is_judged_by_all_slices(spread, status):
    row = {"mean": 1.0, "lower": 1 - spread, "upper": 1 + spread, "n": 9, "sections": 9, "truth": 1.0}
    rows = [
        {"case": "berea", "variant": "section", "quantity": q, **row}
        for q in ("k_any_slice", "k_any_slice_surface")
    ]
    assert next(c for c in claims(pd.DataFrame(rows)) if "single slice" in c.claim).status == status


@pytest.mark.parametrize(
    ("by", "status"),
    [
        ({"a": [0.01], "b": [0.0], "c": [-0.01]}, SHOWN),
        ({"a": [0.2], "b": [0.21], "c": [0.19]}, NOT_SHOWN),
        ({"a": [0.1], "b": [0.0], "c": [0.05]}, OPEN),
        ({"a": [0.01]}, OPEN),  # a single section shows nothing
    ],
)
def test_sections_are_told_from_twins_by_more_than_from_their_truth(by, status):
    told = figures(
        {s: [0.1 + d for d in own] for s, own in by.items()}, "xct", "full", "s2_windows_rejected", 0.1
    )
    more = figures(by, "xct", "full", "s2_windows_excess", 0.0)
    p = figures({s: [0.5] for s in by}, "xct", "full", "s2_envelope_p", 0.5)
    (claim,) = (c for c in claims(aggregate(pd.concat([told, more, p]))) if "slices of its twins" in c.claim)
    assert claim.status == status
    assert "from slices of the truth 0.1" in claim.ours
    assert not any("slices of its twins" in c.claim for c in claims(aggregate(pd.concat([told, p]))))
    # of a tomogram the paper claims the reverse
    scan = pd.concat([told, more, p]).assign(variant="tomogram")
    (claim,) = (c for c in claims(aggregate(scan)) if "slices of its tomogram" in c.claim)
    assert claim.status == {SHOWN: NOT_SHOWN, NOT_SHOWN: SHOWN, OPEN: OPEN}[status]


@pytest.mark.parametrize(("by", "status"), [(-0.001, SHOWN), (-0.05, NOT_SHOWN), (-0.01, OPEN)])
def test_a_skeleton_that_falls_is_not_stable(by, status):
    own = {s: [by + 1e-3 * d] for s, d in zip("abc", (-1, 0, 1), strict=True)}
    table = aggregate(figures(own, "virtual_spheres", "full", "resettled_porosity", 0.0))
    (claim,) = (c for c in claims(table) if "stable" in c.claim)
    assert claim.status == status
    assert not any("stable" in c.claim for c in claims(table.assign(quantity="k_ratio")))


@pytest.mark.parametrize(("by", "status"), [(0.02, SHOWN), (-0.02, NOT_SHOWN), (0.0, OPEN)])
@pytest.mark.parametrize(
    ("case", "without"), [("stereology", "no_inversion"), ("virtual_spheres", "grains_only")]
)
def test_a_step_that_brings_s2_nearer_is_said_to(case, without, by, status):
    gaps = {"full": 0.05, without: 0.05 + by}
    own = [
        figures({s: [gap + 0.001 * i] for i, s in enumerate("abc")}, case, variant, "s2_gap", 0.0)
        for variant, gap in gaps.items()
    ]
    nearer = {s: [by + 1e-3 * d] for s, d in zip("abc", (-1, 0, 1), strict=True)}
    own.append(figures(nearer, case, without, "s2_gap_nearer", 0.0))
    (claim,) = (c for c in claims(aggregate(pd.concat(own))) if "S₂ nearer" in c.claim and c.case == case)
    assert claim.status == status
    assert f"without: {gaps[without] + 0.001:.2g}" in claim.ours


def test_the_truths_own_slices_are_what_there_is_to_be_reached(tmp_path):
    def write(name, p, rejected, n_windows=9, edge=400.0):
        test = {"p": p, "windows_rejected": rejected, "alpha": 0.05, "n_windows": n_windows}
        io.write_json(tmp_path / name, {**test, "window_um": [edge, edge]})

    twins, own = tmp_path / "full/s2_envelope.json", tmp_path / REFERENCE_ENVELOPE
    assert _of_envelope(twins, own) == {}
    write("full/s2_envelope.json", 0.03, 0.2)
    assert _of_envelope(twins, own) == {
        "s2_envelope_p": (0.03, None),
        "s2_windows_rejected": (0.2, 0.05),
    }
    write(REFERENCE_ENVELOPE, 0.04, 0.1)
    found = _of_envelope(twins, own)
    assert found["s2_envelope_p"] == (0.03, 0.04)
    assert found["s2_windows_rejected"] == (0.2, 0.1)
    assert found["s2_windows_excess"] == (pytest.approx(0.1), 0.0)
    assert _of_envelope(own) == {"s2_envelope_p": (0.04, None), "s2_windows_rejected": (0.1, 0.05)}
    write("full/s2_envelope.json", 0.03, 0.0, n_windows=1)
    assert _of_envelope(twins, own) == {"s2_envelope_p": (0.03, 0.04)}
    write(REFERENCE_ENVELOPE, 0.04, 0.1, edge=800.0)  # windows of another size scatter otherwise
    assert _of_envelope(twins, own) == {"s2_envelope_p": (0.03, None)}


def test_cubes_of_a_rock_say_what_chance_leaves_of_a_distance():
    lags = np.array([0.0, 1.0, 2.0])

    def cube(radius, porosity):
        sizes = {"pore_radius_um": [radius], "pore_volume_um3": [radius**3], "throat_radius_um": [1.0]}
        return (lags, (1 - porosity) * 0.5**lags), {key: np.array(values) for key, values in sizes.items()}

    def alike(*cubes):
        return _alike(*(list(of) for of in zip(*cubes, strict=True)))

    assert alike(cube(2.0, 0.3)) == {}
    assert alike(cube(2.0, 0.3), cube(2.0, 0.3)) == {"s2_gap": (0.0, 0.0), "w1_pores": (0.0, 0.0)}
    found = alike(cube(1.0, 0.3), cube(1.0, 0.3), cube(2.0, 0.36))
    # two are held against pores of 1 and 2 um, 1 and 8 um3 of them, the third against pores of 1 um
    assert found["w1_pores"][0] == pytest.approx((2 * (8 / 9) / (17 / 9) + 1) / 3)
    assert found["s2_gap"][0] == pytest.approx((2 * 0.03 + 0.06) / 3)
    none = {key: np.array([]) for key in ("pore_radius_um", "pore_volume_um3", "throat_radius_um")}
    solid = ((lags, np.ones(3)), none)
    assert "w1_pores" not in alike(solid, solid)


def test_slices_of_a_volume():
    phase = np.ones((4, 5, 6), np.uint8)
    phase[0, 1:] = 0
    each = slice_porosities(phase)
    assert len(each) == 15
    assert each[:4].tolist() == [0.8, 0, 0, 0]
    assert each[4:9].tolist() == [0, 0.25, 0.25, 0.25, 0.25]
    assert each[9:] == pytest.approx(0.2)
    assert {r["quantity"] for r in berea_slices(phase)} == {
        "porosity_any_slice",
        "k_any_slice",
        "surface_any_slice",
        "k_any_slice_surface",
    }


def test_surfaces_of_slices():
    # plates of 2 voxels, 2 apart: planes along them are of one phase, the others show two faces in 4 voxels
    phase = np.zeros((16, 8, 8), np.uint8)
    phase[(np.arange(16) + 1) % 4 < 2] = 1
    along, *across = np.split(slice_surfaces(phase), [16, 24])
    assert set(along) == {0.0, np.inf}
    for planes in across:
        # crossings 8 at 15 steps, of 16 x 8 voxels, 2 / 2 of them, half of the voxels solid
        assert planes == pytest.approx(16 / 15 * 8 * 8 / (16 * 8) / 0.5)


def test_a_sections_surface_is_held_against_the_truths_own(tmp_path):
    rng = np.random.default_rng(3)
    rock = (smooth_field(rng, (80, 80, 80)) > 0.2).astype(np.uint8)
    plane, voxel = rock[40], 2.0
    io.write_json(tmp_path / "scene.json", {"resolution_um": voxel})
    io.write_json(tmp_path / "section_surface.json", {"per_um": surface.solid_surface(plane, voxel).per_um})
    pairs = [np.mean(np.take(rock, range(79), a) & np.take(rock, range(1, 80), a)) for a in range(3)]
    truth = {"s2": (np.array([0.0, voxel]), np.array([rock.mean(), np.mean(pairs)]))}
    found = section_surface_ratio(tmp_path, truth)
    expected = surface.solid_surface(plane, voxel).per_um / surface.solid_surface(rock, voxel).per_um
    assert found == pytest.approx(expected, rel=0.005)
    truth["s2"] = (np.array([0.0, 1.0]), truth["s2"][1])
    assert section_surface_ratio(tmp_path, truth) is None  # of another spacing
    assert section_surface_ratio(tmp_path, {}) is None


def smooth_field(rng, shape):
    """A smooth random field of unit variance."""
    field = ndimage.gaussian_filter(rng.standard_normal(shape), 3, mode="wrap")
    return field / field.std()


def test_every_case_and_figure_has_its_words(root):
    words = cases_in_words()
    schema = yaml.safe_load((root / "workflow/schemas/config.schema.yaml").read_text())
    assert set(words) == {c for c in schema["properties"]["case"]["enum"] if c}
    shown = [name for said in words.values() for name in said["figures"]]
    assert sorted([*shown, "permeability"]) == sorted(FIGURES)
    for name in FIGURES:
        assert f'"{name}"' in (root / "workflow/rules/validation.smk").read_text()


def test_rows_are_found_by_their_keys():
    table = aggregate(figures({"a": [1.0]}))
    assert row_of(table, "stereology", "full", "k_ratio")["mean"] == 1.0
    assert row_of(table, "stereology", "full", "k_md") is None
    assert math.isnan(row_of(table, "stereology", "full", "k_ratio")["lower"])


def test_the_size_bias_is_judged_by_intervals():
    def judged(own):
        table = aggregate(figures(own, "cv_sweep", "no_inversion", "k_ratio@cv0.1"))
        return next(c for c in claims(table) if c.case == "cv_sweep")

    assert judged({"a": [0.8], "b": [0.81], "c": [0.79]}).status == NOT_SHOWN
    assert judged({"a": [0.5], "b": [0.51], "c": [0.49]}).status == SHOWN
    assert judged({"a": [0.8]}).status == OPEN
    assert "CV 0.1: 0.8" in judged({"a": [0.8]}).ours
    assert judged({"a": [0.8], "b": [0.81]}).ours.endswith("n = 2 of each")


@pytest.mark.parametrize(("by", "status"), [(0.05, SHOWN), (-0.05, NOT_SHOWN), (0.0, OPEN)])
def test_closed_contacts_are_judged_against_points(by, status):
    def rows(variant, quantity, value):
        twins = 2 if variant == "full" else 1
        own = {s: [value + d] * twins for s, d in zip("abc", (-0.01, 0, 0.01), strict=True)}
        return figures(own, "virtual_spheres", variant, quantity)

    every = [
        rows("full", "k_ratio", 0.95),
        rows("full", "surface_ratio", 1.01),
        rows("touching", "surface_ratio_nearer", 0.09),
        rows("touching", "k_ratio_nearer", by),
    ]
    (claim,) = (c for c in claims(aggregate(pd.concat(every))) if c.claim.startswith("Rims"))
    assert claim.status == status
    assert "surface 1.01" in claim.ours
    # how many they are is said once for figures that follow each other
    assert re.findall("n = .*?sections", claim.ours) == ["n = 6 from 3 sections", "n = 3 from 3 sections"]
    assert not any(c.claim.startswith("Rims") for c in claims(aggregate(pd.concat(every[:3]))))


def test_the_page_shows_the_benchmarks_whose_tables_are_there(tmp_path):
    rows = [
        {"scene": "all_at_<b>", "engine": "bullet", "verdict": "works", "overlap": 0.0123},
        {"scene": "pixel", "engine": "-", "verdict": "refused"},
    ]
    io.write_table(tmp_path / "benchmarks/hard_cases.csv", pd.DataFrame(rows))
    spheres = {"case": "spheres", "solid_fraction": 0.6372, "lower": 0.631, "upper": 0.6438, "z": 6.0}
    io.write_table(tmp_path / "benchmarks/packing_physics.csv", pd.DataFrame([spheres]))
    build_validation(tmp_path, aggregate(figures({})), tmp_path / "page.html", {})
    page = (tmp_path / "page.html").read_text()
    assert "<td>all at &lt;b&gt;</td>" in page
    assert "<td>0.0123</td>" in page
    assert "<td>0.637 (0.631 to 0.644)</td>" in page.replace("\u00a0", " ")
    assert "<td>6</td>" in page
    assert "nan" not in page.lower()
    assert 'id="packing_speed"' not in page


@pytest.mark.parametrize(
    ("k", "tail", "statuses"), [(0.07, 0.15, [SHOWN, SHOWN]), (-0.07, 0.0, [NOT_SHOWN, OPEN])]
)
def test_shapes_of_voids_are_judged_where_they_were_tried(k, tail, statuses):
    def over_truths(value, *where):
        return figures({s: [value + d] for s, d in zip("abc", (-0.01, 0, 0.01), strict=True)}, *where)

    case = "virtual_spheres_deep"
    rows = [
        over_truths(1e-5, case, "full", "porosity_miss"),
        over_truths(0.87, case, "full", "k_ratio"),
        over_truths(1.3, case, "full", "pore_r95_ratio"),
    ]
    left_round = [
        over_truths(0.8, case, "round", "k_ratio"),
        over_truths(1.45, case, "round", "pore_r95_ratio"),
        over_truths(k, case, "round", "k_ratio_nearer"),
        over_truths(tail, case, "round", "pore_r95_ratio_nearer"),
    ]
    found = [c for c in claims(aggregate(pd.concat(rows + left_round))) if "shapes" in c.claim]
    assert [c.status for c in found] == statuses
    assert "round 0.8" in found[0].ours
    assert not any("shapes" in c.claim for c in claims(aggregate(pd.concat(rows))))


def test_a_note_in_place_of_a_figure_is_said_and_not_shown(tmp_path):
    save_figure(note_figure("nothing here"), tmp_path / "sample2.svg")
    table = aggregate(figures({"a": [1.0]}, case="virtual_spheres"))
    build_validation(tmp_path, table, tmp_path / "page.html", {"sample2": tmp_path / "sample2.svg"})
    page = (tmp_path / "page.html").read_text()
    assert "Figure “sample2” is not drawn" in page
    assert "<code>make case-virtual_spheres</code> makes what is missing" in page
    assert '<td><a href="#virtual_spheres">Case\u00a02</a></td>' in page
    assert "<td>Case\u00a03a</td>" in page
    assert "<img" not in page


def test_phantom_pores_are_those_behind_which_all_is_solid():
    rng = np.random.default_rng(5)
    rock, solid = rng.random((9, 8, 13)) > 0.15, rng.random((4, 4, 6)) > 0.5
    shown = [paper_figures._phantom(rock, solid, plane, 2) for plane in range(4)]
    for z, y, x in np.ndindex(solid.shape):
        behind = rock[2 * z : 2 * z + 2, 2 * y : 2 * y + 2, 2 * x : 2 * x + 2]
        assert shown[z][y, x] == (behind.all() and not solid[z, y, x])


def test_a_figure_asks_for_the_volumes_that_it_shows(tmp_path):
    twin = tmp_path / "rock/full/0"
    cases = Cases(tmp_path, {"berea": ["rock"]})
    for name in ("metrics.csv", "twin.zarr.zip", "first/volume.zarr.zip", "second/volume.zarr.zip"):
        assert cases.twin("berea", packings=True) is None
        (twin / name).parent.mkdir(parents=True, exist_ok=True)
        (twin / name).touch()
        assert (cases.twin("berea") is None) == (name == "metrics.csv")
    assert cases.twin("berea", packings=True) is not None


def test_between_curves_of_pore_volume_lies_their_wasserstein_distance():
    axes = Figure().subplots()
    one = {"pore_radius_um": np.array([50.0, 10.0, 32.0]), "pore_volume_um3": np.array([0.1, 1.0, 1.0])}
    other = {"pore_radius_um": np.array([12.0, 30.0]), "pore_volume_um3": np.array([3.0, 1.0])}
    paper_figures._pore_sizes(
        axes, [([one], "black", "-", "a"), ([other], "black", "-", "b"), ([], "", "", "")]
    )
    (radii, below), (_, beside) = (line.get_data() for line in axes.lines)
    assert below[0] == 0
    assert below[-1] == beside[-1] == 1
    distance = network.pore_size_distance(one, other)
    assert np.trapezoid(np.abs(below - beside), radii) == pytest.approx(distance, rel=0.02)


@pytest.mark.parametrize(("values", "status"), [([1.12, 1.14, 1.16], OPEN), ([1.13, 1.14, 1.15], NOT_SHOWN)])
def test_a_mean_outside_is_open_where_its_interval_reaches_in(values, status):
    assert verdict({s: [v] for s, v in zip("abc", values, strict=True)}).status == status


@pytest.mark.parametrize(("miss", "status"), [(2e-4, SHOWN), (3e-4, NOT_SHOWN)])
def test_one_twin_that_misses_its_porosity_is_enough(miss, status):
    table = aggregate(figures({"a": [0.0], "b": [miss]}, "virtual_spheres", "full", "porosity_miss", 0.0))
    assert next(c for c in claims(table) if "bring the porosity" in c.claim).status == status


@pytest.mark.parametrize(
    ("case", "variant", "quantity", "claim", "aim", "tolerance"),
    [
        ("stereology", "no_inversion", "k_of_full", "halves K", 559 / 1272, 0.15),
        ("virtual_spheres", "full", "k_ratio", "bring K to", 1.0, 0.08),
        ("virtual_spheres", "full", "pore_r95_ratio", "keep the tail", 1.0, 0.1),
    ],
)
def test_a_claim_holds_to_its_tolerance(case, variant, quantity, claim, aim, tolerance):
    for share, status in ((0.9, SHOWN), (-0.9, SHOWN), (1.1, NOT_SHOWN), (-1.1, NOT_SHOWN)):
        own = {s: [aim + share * tolerance + d] for s, d in zip("abc", (-1e-3, 0, 1e-3), strict=True)}
        table = aggregate(figures(own, case, variant, quantity, aim))
        if case == "virtual_spheres":  # all claims of the case go by this row
            table = pd.concat([table, aggregate(figures({"a": [0.0]}, case, "full", "porosity_miss", 0.0))])
        assert next(c for c in claims(table) if c.case == case and claim in c.claim).status == status


def test_grains_alone_are_named_as_such():
    own = [
        figures({"a": [v], "b": [v]}, "virtual_spheres", of, "k_ratio")
        for of, v in (("full", 0.9), ("grains_only", 0.3))
    ]
    own.append(figures({"a": [0.0]}, "virtual_spheres", "full", "porosity_miss", 0.0))
    said = next(c.ours for c in claims(aggregate(pd.concat(own))) if "bring K to" in c.claim)
    assert re.search("truth's 0.9 .*; grains alone 0.3 ", said)


def test_other_variants_are_held_against_the_full_method_realization_by_realization():
    twins = [
        (variant, n, {"k_md": (k, None)})
        for variant, n, k in (
            ("full", 0, 100.0),
            ("full", 1, 200.0),
            ("bare", 0, 50.0),
            ("bare", 1, 50.0),
            ("bare", 2, 50.0),
        )
    ]
    assert [(row[2], row[3], row[5]) for row in _paired("a", "s", twins)] == [
        ("bare", 0, 0.5),
        ("bare", 1, 0.25),
    ]


def test_grains_are_measured_against_the_truths_by_mineral():
    true = pd.DataFrame({"phase": [1] * 3 + [2], "r_um": [10.0, 10.0, 10.0, 40.0]})
    own = pd.DataFrame({"phase": [1, 2], "scale": [20.0, 40.0]})
    found = _grain_figures(own, true, 8.0, 2.0)
    # three grains of four are twice as large as they should be, which is off by their size
    assert found["r_mean_ratio"][0] == pytest.approx(0.75 * 2 + 0.25)
    assert found["w1_f3d"][0] == pytest.approx(0.75)
    assert found["k_over_r2"] == pytest.approx((8 / 30**2, 2 / 17.5**2))
    assert found["k_over_r2_ratio"][0] == pytest.approx(4 * (17.5 / 30) ** 2)


def test_of_pore_volume_95_percent_lie_below_the_tail(tmp_path):
    n = np.arange(1.0, 101.0)
    sizes = {"pore_radius_um": n, "pore_volume_um3": np.ones(100), "throat_radius_um": n}
    assert _pore_figures(sizes, None)["pore_r95_um"][0] == pytest.approx(95, abs=1)
    # circles of equal areas in all, so many that each radius has a hundredth; one is cut
    io.write_table(tmp_path / "p.csv", pd.DataFrame({"r_um": [*n, 900], "weight": [*1 / n**2, 0]}))
    assert _circle_tail(tmp_path / "p.csv") == pytest.approx(95, abs=1)


def test_what_one_slice_would_do_to_k():
    """By Kozeny and Carman, of every slice over that of the volume."""

    def carman(porosity):
        return porosity**3 / (1 - porosity) ** 2

    phase = (np.random.default_rng(0).random((30, 12, 8)) > 0.3).astype(np.uint8)
    rows = {r["quantity"]: r for r in berea_slices(phase)}
    expected = carman(slice_porosities(phase)) / carman((phase == 0).mean())
    assert rows["k_any_slice"]["mean"] == pytest.approx(expected.mean())
    assert expected.mean() > 1.01  # it is convex


def test_more_surface_in_a_slice_is_less_k():
    """Kozeny and Carman: K goes with the square of what the slice shows too little."""
    rng = np.random.default_rng(2)
    phase = (smooth_field(rng, (40, 40, 40)) > 0).astype(np.uint8)
    rows = {r["quantity"]: r for r in berea_slices(phase)}
    shown, k = rows["surface_any_slice"], rows["k_any_slice_surface"]
    assert (k["lower"], k["upper"]) == pytest.approx((shown["upper"] ** -2, shown["lower"] ** -2), rel=0.05)


def test_an_interval_of_slices_leaves_out_a_twentieth():
    phase = np.ones((400, 2, 2), np.uint8)
    phase[:5, 0] = 0  # of 404 planes five are half empty
    row = next(r for r in berea_slices(phase) if r["quantity"] == "porosity_any_slice")
    assert row["upper"] < 0.25


def test_a_bed_that_sinks_has_a_negative_change(tmp_path):
    assert _resettled_figures(tmp_path / "none.json") == {}
    change = {"porosity_before": 0.4, "porosity_after": 0.37, "s2_change": 0.02, "moved_share": 0.5}
    io.write_json(tmp_path / "r.json", change)
    assert _resettled_figures(tmp_path / "r.json")["resettled_porosity"] == (pytest.approx(-0.03), 0.0)


def test_the_mineral_with_the_fewest_whole_grains_is_told(tmp_path):
    io.write_json(tmp_path / "section.json", {"porosity": 0.3})
    io.write_table(
        tmp_path / "grains2d.csv",
        pd.DataFrame({"phase": [1, 1, 1, 2, 2, 2, 2], "weight": [1, 1, 1, 1, 1, 0, 0]}),
    )
    assert _of_section(tmp_path, 0.4, None)["grains_section"] == (2, None)


def packs_of_a_sweep(folder, truths, packs):
    """A study of size bias at CV 0.3: K of cubes, then (variant, mean and Sauter radius, K) of packs."""
    columns = ["variant", "r_um", "r_sauter_um", "k_md"]
    cubes = [("truth", 10.0, 12.0, k) for k in truths]
    of_truth = pd.DataFrame(cubes, columns=columns).assign(sections=100, realization=range(len(cubes)))
    io.write_table(folder / "cv_sweep/0.3/7/truth.csv", of_truth)
    io.write_table(folder / "cv_sweep/0.3/7/sizes.csv", pd.DataFrame({"phase": [1]}))
    for n, rows in enumerate(packs):
        of_packs = pd.DataFrame(rows, columns=columns).assign(realization=n)
        io.write_table(folder / f"cv_sweep/0.3/7/{n}.csv", of_packs)


def test_a_sweep_of_scaled_packings_takes_size_out(tmp_path):
    """The same bed 1.5 times as large: K goes with the square of the radius."""
    packs_of_a_sweep(tmp_path, [100.0], [[("full", 10.0, 12.0, 100.0), ("no_inversion", 15.0, 18.0, 225.0)]])
    rows = _of_sweep(tmp_path)
    assert {row[0:2] for row in rows} == {("cv_sweep", "truth_7")}
    assert all(row[4].endswith("@cv0.3") for row in rows)
    found = {(r[2], r[4].partition("@")[0]): r[5] for r in rows}
    assert {q: v for (variant, q), v in found.items() if variant == "no_inversion"} == pytest.approx(
        {"r_mean_ratio": 1.5, "k_ratio": 2.25, "k_of_full": 2.25, "k_over_r2_ratio": 1, "k_over_rs2_ratio": 1}
    )
    assert ("full", "k_of_full") not in found


def test_packs_of_a_sweep_are_held_against_the_mean_of_cubes_and_pack_by_pack(tmp_path):
    packs = [
        [("full", 10.0, 12.0, 100.0), ("no_inversion", 10.0, 12.0, 50.0)],
        [("full", 10.0, 12.0, 40.0), ("no_inversion", 10.0, 12.0, 60.0)],
    ]
    packs_of_a_sweep(tmp_path, [80.0, 120.0], packs)
    found = {(r[2], r[3], r[4].partition("@")[0]): r[5] for r in _of_sweep(tmp_path)}
    assert [found["full", n, "k_ratio"] for n in (0, 1)] == pytest.approx([1.0, 0.4])
    assert [found["no_inversion", n, "k_of_full"] for n in (0, 1)] == pytest.approx([0.5, 1.5])


def test_a_truth_of_a_sweep_without_packs_or_without_flow_says_nothing(tmp_path):
    assert _of_sweep(tmp_path) == []
    packs_of_a_sweep(tmp_path, [100.0], [])
    assert _of_sweep(tmp_path) == []
    packs_of_a_sweep(tmp_path, [0.0], [[("full", 10.0, 12.0, 100.0)]])
    assert {row[4] for row in _of_sweep(tmp_path)} == {"r_mean_ratio@cv0.3"}


def small_network_at(stem):
    pore = np.random.default_rng(1).random((14, 14, 14)) < 0.5
    network.save(network.extract(pore, 1.0), f"{stem}_pores.csv", f"{stem}_throats.csv")


def rock_of(folder, k, s2, room=1.0, scale=10.0, source="areal", target=0.4):
    """A twin of grains so large in a folder; what it is held against lies where the test puts it."""
    twin = folder / "full/0"
    flow_table(twin / "flow.csv", [k] * 3, [10.0] * 3)
    small_network_at(twin / "network")
    io.write_table(twin / "s2_volume.csv", s2)
    for path in (twin / "pores2d.csv", twin.parent / "section_pores2d.csv"):
        io.write_table(path, pd.DataFrame({"r_um": [1.0], "weight": [1.0]}))
    n = 1000 * 10**3 / scale**3  # of a region as large as the truth's box
    measured = {
        "porosity": target,
        "porosity_first": 0.35,
        "n_grains": n,
        "k_ref_x_md": 1.0,
        "specific_surface_per_um": 0.2,
    }
    io.write_table(
        twin / "metrics.csv", pd.DataFrame({"metric": list(measured), "value": list(measured.values())})
    )
    edge = (1000 * 4 / 3 * np.pi * 10**3 / 0.6) ** (1 / 3)
    scene = {
        "porosity_target": target,
        "porosity_source": source,
        "shape_zyx": [50] * 3,
        "voxel_size_um": edge / 50,
        "resolution_um": 1.0,
    }
    io.write_json(twin.parent / "scene.json", scene)
    io.write_json(twin.parent / "section_surface.json", {"per_um": 0.3})
    io.write_json(twin / "cement.json", {"room": room, "compaction": {"factor": 1.0}})
    bodies = pd.DataFrame({"kind": "grain", "phase": 1, "scale": [scale * room] * 9})
    io.write_table(twin / "bodies.csv", bodies)
    return twin


def test_a_twin_of_larger_grains_is_as_good_once_size_is_taken_out(tmp_path):
    """Twice as large, with rims for which the bed was shrunk: K four times the truth's, an eighth as many."""
    lags = np.arange(4.0)
    s2 = pd.concat([pd.DataFrame({"axis": a, "lag_um": lags, "s2": 0.6 - 0.05 * lags}) for a in "xyz"])
    truth = {
        "k": {
            "network": {
                "k_md": 25.0,
                "k_x_md": 25.0,
                "k_y_md": 25.0,
                "k_z_md": 25.0,
                "formation_factor": 10.0,
            }
        },
        "s2": (lags, 0.6 - 0.1 * lags),
        "porosity": 0.4,
        "grains": pd.DataFrame({"phase": 1, "r_um": np.full(1000, 10.0)}),
    }
    found = _of_twin(rock_of(tmp_path, 100.0, s2, room=0.8, scale=20.0), truth)
    found = {quantity: value for quantity, (value, _) in found.items()}
    assert found["k_ratio"] == pytest.approx(4)
    assert found["r_mean_ratio"] == pytest.approx(2)
    assert found["n_ratio"] == pytest.approx(1 / 8, rel=1e-3)
    assert (found["k_at_equal_n"], found["k_over_r2_ratio"]) == pytest.approx((1, 1))
    # the truth's surface by volume 4 * 0.1 / 0.6, by its slope 4 * 0.1
    assert found["k_at_equal_surface"] == pytest.approx(4 * (0.3 / (0.4 / 0.6)) ** 2)
    assert found["surface_ratio"] == pytest.approx(0.2 / 0.4)


@pytest.mark.parametrize(("source", "aim"), [("areal porosity of the section", 0.45), ("config", 0.4)])
def test_a_target_of_the_section_is_judged_by_the_truth(tmp_path, source, aim):
    lags = np.arange(3.0)
    s2 = pd.concat([pd.DataFrame({"axis": a, "lag_um": lags, "s2": 0.6 - 0.05 * lags}) for a in "xyz"])
    assert _of_twin(rock_of(tmp_path, 1.0, s2, source=source), {"porosity": 0.45})["porosity"] == (0.4, aim)


def test_cubes_of_a_rock_are_its_mean(tmp_path):
    """Of S2 at no lag one less is the porosity; K and pores are those of all cubes."""
    for name, phi, k in (("a", 0.3, 100.0), ("b", 0.4, 200.0)):
        flow_table(tmp_path / name / "reference_flow.csv", [k] * 3, [10.0] * 3)
        small_network_at(tmp_path / name / "reference_network")
        s2 = [pd.DataFrame({"axis": a, "lag_um": [0.0, 1.0, 2.0], "s2": 1 - phi}) for a in "xyz"]
        io.write_table(tmp_path / name / "reference_s2.csv", pd.concat(s2))
    found = _of_references([tmp_path / "a", tmp_path / "b", tmp_path / "unfinished"])
    assert found["porosity"] == pytest.approx(0.35)
    assert found["k"]["network"]["k_md"] == 150
    assert found["alike"]["s2_gap"][0] == pytest.approx(0.1)
