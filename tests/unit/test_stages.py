"""Scene, what the first packing lacks, and the second packing's decisions, without any engine."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from grainfall import packing, stereology
from grainfall.errors import InputError
from grainfall.grains import VOID, Library
from grainfall.morphology import Intergranular
from grainfall.packing.densify import SLICK
from grainfall.packing.voids import smallest_void
from grainfall.surface import SolidSurface

SCENE = {
    "edge_grains": 8.0,
    "edge_um": None,
    "voxel_size_um": None,
    "voxels_per_grain": None,
    "porosity": None,
    "margin_grains": 2.0,
    "sizes_from": "f3d",
}


def equal(radius, width=0.02):
    """Nearly equal radii."""
    edges = np.array([radius * (1 - width), radius * (1 + width)])
    density = np.array([1 / np.ptp(edges)])
    return stereology.SizeDistribution(edges, density, density, density, density, "given", float("nan"))


SIZES = {(1, "grain"): equal(20.0), (2, "grain"): equal(10.0), (0, "pore"): equal(6.0)}
SECTION = {
    "phases": ["pore", "quartz", "feldspar"],
    "fractions": [0.8, 0.2],
    "porosity": 0.4,
    "pixel_size_um": 2.0,
}


def scene(**over):
    sample = over.pop("porosity_of_sample", None)
    return packing.plan_scene(SIZES, SECTION, **{**SCENE, **over}, porosity_of_sample=sample)


def test_mean_grain_and_region():
    """0.8 : 0.2 by volume and 8 : 1 in grain volume make 1 : 2 by number: mean diameter 80 / 3."""
    plan = scene()
    assert plan["probabilities"] == pytest.approx([1 / 3, 2 / 3], rel=1e-3)
    assert plan["mean_diameter_um"] == pytest.approx(80 / 3, rel=1e-3)
    assert plan["edge_um"] == pytest.approx(8 * 80 / 3, abs=2.0)
    assert plan["voxel_size_um"] == 2.0
    assert np.prod(plan["shape_zyx"]) == round(plan["edge_um"] / 2.0) ** 3
    assert plan["margin_um"] == pytest.approx(2 * 80 / 3, rel=1e-3)


@pytest.mark.parametrize(("voxel", "resolution"), [(0.5, 2.0), (2.0, 2.0), (4.0, 4.0)])
def test_surfaces_are_compared_on_the_coarser_of_pixel_and_voxel(voxel, resolution):
    assert scene(voxel_size_um=voxel, edge_um=110.0)["resolution_um"] == resolution


def test_voxels_per_grain():
    plan = scene(voxels_per_grain=20)
    assert plan["mean_diameter_um"] / plan["voxel_size_um"] == pytest.approx(20)


@pytest.mark.parametrize(
    ("over", "target", "source"),
    [
        ({}, 0.4, "section"),
        ({"porosity_of_sample": 0.3}, 0.3, "sheet"),
        ({"porosity_of_sample": 0.3, "porosity": 0.2}, 0.2, "config"),
    ],
)
def test_target_porosity_and_where_it_comes_from(over, target, source):
    plan = scene(**over)
    assert plan["porosity_target"] == target
    assert source in plan["porosity_source"]


@pytest.mark.parametrize(
    ("over", "words"),
    [
        ({"edge_um": 30.0}, "edge_um"),
        ({"voxel_size_um": 1e-3}, "voxel_size_um"),
        ({"voxel_size_um": 20.0}, "1.3 voxels across the mean grain of 26.67 um; at most 6.667"),
        ({"voxels_per_grain": 2}, "2 voxels across"),
    ],
)
def test_infeasible_regions_are_refused(over, words):
    with pytest.raises(InputError, match=words):
        scene(**over)


def test_phase_mixing_only_with_more_than_one_mineral():
    mixed = scene()
    assert mixed["phase_mixing"]["on"]
    assert not mixed["phase_mixing"]["forced"]
    alone = scene(phase_mixing="off")
    assert alone["probabilities"] == [1.0, 0.0]  # quartz, four fifths of the solid
    assert "although 2 minerals" in alone["phase_mixing"]["reason"]
    assert {k: alone[k] for k in ("edge_um", "shape_zyx")} == {k: mixed[k] for k in ("edge_um", "shape_zyx")}
    one = {**SECTION, "phases": ["pore", "quartz"], "fractions": [1.0]}
    plans = [
        packing.plan_scene(SIZES, one, **{**SCENE, "edge_um": 200.0}, phase_mixing=s) for s in ("auto", "on")
    ]
    assert not any(p.pop("phase_mixing")["on"] for p in plans)
    assert plans[0] == plans[1]


# ---- large pores


def circles(radii, slices=None):
    table = pd.DataFrame({"r_um": radii, "weight": 1.0})
    return table if slices is None else table.assign(slice=np.arange(len(radii)) % slices)


def tail_of(section, first, seed=0):
    return packing.pore_tail(circles(section), circles(first, 10), 0.3, 0.35, np.random.default_rng(seed))


def test_pores_of_one_population_have_no_tail():
    """At 99 % confidence one pair in a hundred may be told apart by chance; of 100, hardly five."""
    rng = np.random.default_rng(1)
    draw = lambda n: rng.lognormal(1.5, 0.4, n)  # noqa: E731
    assert sum(tail_of(draw(300), draw(600), k).exceeds for k in range(100)) < 5


def test_vugs_are_a_tail_of_their_volume():
    """Vugs of a sixth of the pore area: all of them, and nothing else, lies beyond the packing's tail."""
    rng = np.random.default_rng(2)
    small, first = rng.uniform(3, 8, 1000), rng.uniform(3, 8, 1000)
    vugs = np.full(12, (small**2).sum() ** 0.5 / 60**0.5)
    found = tail_of(np.concatenate([small, vugs]), first)
    assert found.exceeds
    assert found.first_um == pytest.approx(8, abs=0.2)
    assert found.target_um == vugs[0]
    # of the section's pores 1/6 are vugs and some 5 % of the rest lie beyond the quantile, as in the packing
    assert found.share == pytest.approx(0.3 * (1 / 6 + 5 / 6 * 0.05) - 0.35 * 0.05, abs=0.005)


def test_without_circles_there_is_no_tail():
    rng = np.random.default_rng(3)
    none = packing.pore_tail(circles([]), circles([5.0, 6.0], 2), 0.3, 0.3, rng)
    assert not none.exceeds
    assert "no pore circles" in none.words


# ---- what the first packing lacks


NO_TAIL = packing.PoreTail(8.0, 8.0, -1.0, 0.0)
VUGS = packing.PoreTail(20.0, 8.0, 5.0, 0.08)


APART = packing.Overgrowth(SolidSurface(0.12, 0.001), SolidSurface(0.12, 0.001), 0.0)
TOGETHER = packing.Overgrowth(SolidSurface(0.11, 0.001), SolidSurface(0.12, 0.001), 0.08)
"""Grains as they are poured, and with rims in 0.08 of their pores: 0.0348 of a region of porosity 0.4."""


def deficit(first, tail=NO_TAIL, overgrowth=APART, **over):
    given = {"switch": "auto", "limit": 0.01} | over
    return packing.plan_deficit(scene(), equal(12.0), equal(6.0), tail, overgrowth, first, 1e4, **given)


@pytest.mark.parametrize(
    ("first", "over", "on", "words"),
    [
        (0.35, {}, True, "exceeds the first packing's 0.3500"),
        (0.395, {}, False, "within 0.01 of the target porosity 0.4000"),
        (0.395, {"switch": "on"}, True, "forced on in the config, although"),
        (0.45, {}, False, "target porosity 0.4000 is below the first packing's 0.4500"),
        (0.45, {"switch": "on"}, False, "with nothing to do"),
        (0.35, {"switch": "off"}, False, "switched off in the config, although the target porosity"),
        (0.45, {"tail": VUGS}, True, "large-pore radius of 20 µm"),
        (0.395, {"tail": VUGS}, True, "exceeds the first packing's 8 µm beyond sampling"),
        (0.45, {"tail": VUGS, "switch": "off"}, False, "switched off in the config, although"),
    ],
)
def test_spheres_where_porosity_or_large_pores_exceed_the_first_packing(first, over, on, words):
    sizes, plan = deficit(first, **over)
    found = plan["virtual_spheres"]
    assert found["on"] is on
    assert words in found["reason"]
    assert (found["p_sp"] > 0) is on
    if on:
        share = plan["tail"]["share"] if found["for_tail"] else 0.0
        wanted = share + (1 - share) * first if found["for_tail"] else 0.4
        k = (1 - wanted) / (wanted - first) * sizes.mean_volume / 1e4
        assert found["p_sp"] == pytest.approx(1 / (1 + k))


@pytest.mark.parametrize("share", [0.02, 0.3])
def test_where_the_porosity_calls_for_spheres_it_sets_their_share(share):
    """However large the tail: a bed that has to become looser is not to be packed denser."""
    vugs = packing.PoreTail(20.0, 8.0, 5.0, share)
    assert deficit(0.30, tail=vugs)[1]["virtual_spheres"]["on"]
    without, found = (deficit(0.30, tail=tail)[1]["virtual_spheres"] for tail in (NO_TAIL, vugs))
    assert not found["for_tail"]
    assert found["p_sp"] == without["p_sp"]


def test_spheres_for_vugs_are_no_smaller_than_vugs():
    sizes, _ = deficit(0.45, tail=packing.PoreTail(20.0, 12.05, 5.0, 0.08))
    assert sizes.quantile(np.array([0.0]))[0] >= 12.05


@pytest.mark.parametrize(
    ("between", "radius", "alone"),
    [
        (0.30, 10.0, True),
        (0.36, 10.0, True),
        (0.37, 10.0, False),  # spheres have to loosen the grains, too
        (0.30, 17.0, False),  # no pore is short that would be a void
    ],
)
def test_where_grains_alone_are_loose_enough_spheres_hold_voids_only(between, radius, alone):
    pores = stereology.SizeDistribution(
        *(np.array(part, float) for part in ([4, 8, 16], *[[0.1, 0.075]] * 4)), "given", float("nan")
    )
    found = Intergranular(radius, 0.1, between, 0.003)
    sizes, plan = packing.plan_deficit(
        scene(), pores, equal(3.0), VUGS, APART, 0.35, 1e3, between=found, switch="auto", limit=0.01
    )
    assert plan["virtual_spheres"]["on"]
    assert sizes.quantile(np.array([0.0]))[0] == pytest.approx(radius if alone else 4.0)
    assert ("hold voids open only" in plan["virtual_spheres"]["reason"]) is alone
    without, _ = packing.plan_deficit(
        scene(), pores, equal(3.0), NO_TAIL, APART, 0.35, 1e3, between=found, switch="auto", limit=0.01
    )
    assert without.quantile(np.array([0.0]))[0] == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("first", "over", "on", "words"),
    [
        (0.35, {"tail": VUGS, "voids": 40}, True, "40 shapes of the section's voids were made"),
        (0.35, {"tail": VUGS, "voids": 0}, False, "no shapes of the section's"),
        (0.35, {"voids": 40}, False, "virtual spheres hold"),
        (0.35, {"voids": 40, "void_shapes": "on"}, True, "forced on in the config, although"),
        (0.35, {"voids": 0, "void_shapes": "on"}, False, "with nothing to do"),
        (0.395, {"voids": 40, "void_shapes": "on"}, False, "no virtual spheres hold"),
        (
            0.35,
            {"tail": VUGS, "voids": 40, "void_shapes": "off"},
            False,
            "switched off in the config, although virtual spheres hold",
        ),
    ],
)
def test_shapes_of_voids_where_spheres_hold_large_pores_open(first, over, on, words):
    found = deficit(first, **over)[1]["void_shapes"]
    assert found["on"] is on
    assert words in found["reason"]


def test_sizes_survive_their_table():
    sizes, _ = deficit(0.35)
    again = packing.VirtualSizes.from_table(sizes.to_table())
    q = np.linspace(0, 1, 9)
    np.testing.assert_array_equal(again.quantile(q), sizes.quantile(q))
    assert again.called_for


@pytest.mark.parametrize(
    ("first", "over", "on", "porosity", "words"),
    [
        # voids of a share v in a bed as the first one, whose pores rims fill: 0.4 = v + (1 - v) 0.35 0.92
        (0.35, {}, True, 1 - 0.65 * 0.6 / (1 - 0.35 * 0.92), "exceed the section's 0.11 beyond"),
        (0.395, {}, True, 1 - 0.605 * 0.6 / (1 - 0.395 * 0.92), "exceed"),
        (0.405, {}, True, 1 - 0.595 * 0.6 / (1 - 0.405 * 0.92), "exceed"),
        (0.35, {"cement": "off"}, False, 0.4, "switched off in the config, although"),
        (0.35, {"overgrowth": APART}, False, 0.4, "do not exceed"),
        (0.35, {"overgrowth": APART, "cement": "on"}, False, 0.4, "with nothing to do"),
        # dense rock: rims in place of denser beds, and no spheres to open the bed for more
        (0.415, {}, True, 0.415, "would fill 0.0150 of the region"),
        (0.45, {}, True, 0.4 / 0.92, "exceed"),
    ],
)
def test_grains_grown_together_are_packed_looser(first, over, on, porosity, words):
    _, plan = deficit(first, **{"overgrowth": TOGETHER, **over})
    rims = plan["overgrowth"]
    assert rims["on"] is on
    assert rims["porosity"] == pytest.approx(porosity)
    assert words in rims["reason"]
    spheres = plan["virtual_spheres"]
    assert spheres["on"] == (first == 0.35 or (on and first < 0.41))
    if spheres["on"]:
        assert (spheres["p_sp"] > deficit(first)[1]["virtual_spheres"]["p_sp"]) == on
    bed = Bed(first)
    report = bed.second(plan)[1]
    assert report["reached"]
    assert abs(report["porosity"] - porosity) <= 0.01


@given(st.floats(0.02, 0.95), st.floats(0.05, 0.7), st.floats(0, 0.95))
def test_a_bed_before_its_rims_has_room_for_them(target, first, filled):
    """However grown together the grains and however large the voids (a vuggy rock of fused grains once asked
    for a bed of more pores than there is volume)."""
    rims = packing.Overgrowth(SolidSurface(0.05, 0.001), SolidSurface(0.2, 0.001), filled)
    before = rims.porosity_before(target, first)
    assert target <= before + 1e-12
    assert before < 1
    assert rims.porosity_before(target + 1e-6, first) == pytest.approx(before, abs=3e-5)
    if before > first:  # the pores between grains are the first packing's
        voids = (before - first) / (1 - first)
        assert voids + (1 - voids) * first * (1 - filled) == pytest.approx(target)
    elif before < first:
        assert before * (1 - filled) == pytest.approx(target)


def test_surfaces_that_chance_may_tell_apart_call_for_nothing():
    near = packing.Overgrowth(SolidSurface(0.118, 0.001), SolidSurface(0.12, 0.001), 0.02)
    assert not near.exceeds
    assert deficit(0.35, overgrowth=near)[1]["overgrowth"]["porosity"] == 0.4
    forced = deficit(0.35, overgrowth=near, cement="on")[1]["overgrowth"]
    assert forced["on"]
    assert "forced on in the config, although" in forced["reason"]


# ---- the second packing, in a bed that is a formula


class Bed:
    """Porosity that falls with the logarithms of friction and of taps, and rises with spheres.

    What was made of a bed is remembered; its bodies carry it. To pour takes 2 s, to come to rest 1 s, which
    moves the porosity by ``sag``, a tap takes 0.1 s.
    """

    def __init__(self, first, slick=0.07, tap=0.01, c=0.5, sag=0.001):
        self.first, self.slick, self.tap, self.c, self.sag = first, slick, tap, c, sag
        self.calls, self.poured, self.rests = [], [], []

    def pour(self, p_sphere, lubrication):
        self.poured.append((p_sphere, lubrication))
        return self.bodies(p_sphere, lubrication, None), {"wall_s": 2.0, "p_sp": p_sphere}

    def rested(self, packing, lubrication, taps):
        bodies, report = packing
        assert self.calls[bodies["call"].iloc[0]] == (report["p_sp"], lubrication, None)
        self.rests.append((report["p_sp"], lubrication, taps))
        return self.bodies(report["p_sp"], lubrication, taps), {**report, "wall_s": 3.0 + 0.1 * taps}

    def bodies(self, p_sphere, lubrication, taps):
        self.calls.append((p_sphere, lubrication, taps))
        bodies = pd.DataFrame({"kind": ["grain"] * 9 + ["virtual"] * round(9 * p_sphere)})
        return bodies.assign(call=len(self.calls) - 1)

    def of(self, bodies):
        return self.calls[bodies["call"].iloc[0]]

    def loose(self, lubrication):
        return self.slick * np.log10(lubrication)

    def porosity(self, bodies):
        """Of grains alone; beside grains and spheres, who fill as much together as grains alone do."""
        p, lubrication, taps = self.of(bodies)
        p = p if (bodies["kind"] == "grain").all() else 0.0
        matrix = self.first + self.loose(lubrication) - self.tap * np.log2(1 + (taps or 0))
        matrix -= 0 if taps is None else self.sag
        return 1 - (1 - matrix) / (1 + self.c * p / (1 - p))

    def second(self, plan, **over):
        return packing.pack_again(plan, self.pour, self.rested, self.porosity, FIRST, **{"passes": 6, **over})


FIRST = pd.DataFrame({"kind": ["grain"] * 3}), {"poured": 3, "p_sp": 0.0, "wall_s": 3.0}


@pytest.mark.parametrize(
    ("first", "spheres", "densification"),
    [(0.40, "on", "on"), (0.405, "on", "auto"), (0.395, "auto", "on"), (0.40, "auto", "auto")],
)
def test_forced_on_without_a_deficit_is_a_no_op(first, spheres, densification):
    """Bodies are the first packing's own, and no packing is made for it."""
    bed = Bed(first)
    bodies, report = bed.second(deficit(first, switch=spheres)[1], densification=densification)
    assert bodies is FIRST[0]
    assert bed.calls == report["passes"] == []
    assert report["reached"]
    assert not report["densification"]["on"]


def test_spheres_repeat_until_the_porosity_fits():
    bed = Bed(0.35, c=0.2)
    bodies, report = bed.second(deficit(0.35)[1])
    assert report["reached"]
    assert abs(bed.porosity(bodies[bodies["kind"] == "grain"]) - 0.4) <= 0.01
    assert [(p["p_sphere"], p["lubrication"]) for p in report["passes"]] == bed.poured
    assert all(lubrication == 1.0 for _, lubrication in bed.poured)


def test_only_a_pour_that_meets_the_target_is_brought_to_rest():
    bed = Bed(0.35, c=0.2)
    bodies, report = bed.second(deficit(0.35)[1])
    assert len(report["passes"]) > 1
    assert [one["at_rest"] for one in report["passes"]] == [False] * (len(report["passes"]) - 1) + [True]
    assert bed.rests == [bed.of(bodies)]
    assert [one["wall_s"] for one in report["passes"]][-2:] == [2.0, 3.0]
    # one that misses once it rests is a miss, and the feedback goes on
    bed = Bed(0.35, c=0.2, sag=0.014)
    bodies, report = bed.second(deficit(0.35)[1])
    assert report["reached"]
    assert len(bed.rests) > 1
    # and where all miss, the best of them is brought to rest all the same
    bed = Bed(0.35, c=0.2, sag=0.014)
    bodies, report = bed.second(deficit(0.35)[1], passes=1)
    assert not report["reached"]
    assert bed.rests == [bed.of(bodies)]
    assert report["porosity"] == bed.porosity(bodies[bodies["kind"] == "grain"])
    assert report["reason"].endswith(f", at rest {report['porosity']:.4f}")


def test_a_packing_kept_that_is_not_the_nearest_is_told():
    """Cement fills a bed that is too loose, so a denser one that is nearer is no better."""

    class Slips(Bed):
        def porosity(self, grains):
            _, lubrication, taps = self.of(grains)
            return 0.385 if lubrication < 1 or taps else 0.42

    first = Slips(0.42)
    bodies, report = first.second(deficit(0.42)[1], passes=2)
    assert bodies is FIRST[0]
    assert not report["reached"]
    assert report["reason"].endswith("; kept one of 0.4200, since cement fills a bed that is too loose")


def test_the_spheres_of_the_tail_count_as_one_of_the_passes():
    class Dense(Bed):
        def porosity(self, grains):
            return 0.3

    for passes in (1, 3):
        bed = Dense(0.395)
        report = bed.second(deficit(0.395, tail=VUGS)[1], passes=passes, densification="off")[1]
        assert len(report["passes"]) == len(bed.poured) == passes


def test_of_passes_that_miss_the_nearest_is_kept():
    """Too loose by spheres is no better than too dense: cement does not fill their pores."""

    class Scattered(Bed):
        def porosity(self, grains):
            return [0.43, 0.385, 0.42][len(self.poured) - 1] - 0.001 * (self.of(grains)[2] is not None)

    bed = Scattered(0.35)
    bodies, report = bed.second(deficit(0.35)[1], passes=2)
    assert bed.of(bodies)[:2] == bed.poured[1]
    assert report["reason"] == "target 0.400 not met in 2 passes, nearest 0.385, at rest 0.3840"
    assert report["porosity"] == 0.384
    _, loose = Scattered(0.35).second(deficit(0.35)[1], passes=1)
    assert not loose["densification"]["called_for"]
    words = "below the 0.4300 of the packing with its virtual spheres, which they opened, not its grains"
    assert words in loose["densification"]["reason"]


@pytest.mark.parametrize("first", [0.42, 0.44, 0.455])
def test_lubrication_meets_a_target_below_the_first_packing(first):
    bed = Bed(first)
    _, report = bed.second(deficit(first)[1])
    assert report["reached"]
    assert report["densification"]["on"]
    assert "below the" in report["densification"]["reason"]
    assert bed.poured[0] == (0.0, SLICK)
    assert all(SLICK <= lubrication <= 1 for _, lubrication in bed.poured)
    assert all(taps == 0 for *_, taps in bed.rests)
    # the logarithm of friction is interpolated: the next pass is what is aimed at
    assert len(report["passes"]) == 2
    assert bed.porosity(bed.bodies(*bed.poured[1], None)) == pytest.approx(0.40 + 0.01 / 4)


def test_tapping_where_lubrication_is_not_enough():
    bed = Bed(0.51)
    _, report = bed.second(deficit(0.51)[1])
    assert report["reached"]
    assert bed.poured == [(0.0, SLICK)]  # and tapped from there
    assert all(lubrication == SLICK and taps > 0 for _, lubrication, taps in bed.rests)
    assert [one["wall_s"] for one in report["passes"]] == [
        pytest.approx(2.0 if taps is None else 1.0 + 0.1 * taps) for *_, taps in bed.calls
    ]


@pytest.mark.parametrize("tap", [1e-4, 1e-3, 3.5e-3, 5e-3])
@pytest.mark.parametrize("passes", [6, 20])
def test_a_bed_that_stays_too_loose_is_said_and_is_the_densest(tap, passes):
    """Taps are given up that would not do even if each doubling gained as much; cement does the rest."""
    bed = Bed(0.51, tap=tap)
    bodies, report = bed.second(deficit(0.51)[1], passes=passes)
    assert not report["reached"]
    assert len(bed.calls) == 2
    assert bed.of(bodies) == (0.0, SLICK, 8)
    came_to = bed.porosity(bodies[bodies["kind"] == "grain"])
    assert f"lubrication and tapping came to {came_to:.4f}" in report["reason"]


def test_taps_that_gain_enough_are_doubled_up_to_the_most():
    """Where as many as are allowed just do, the target is met."""
    bed = Bed(0.51, tap=7e-3)
    _, report = bed.second(deficit(0.51)[1], passes=20)
    assert report["reached"]
    assert [taps for *_, taps in bed.rests] == [8, 16, 32]


def test_switched_off_densification_visibly_misses():
    bed = Bed(0.45)
    bodies, report = bed.second(deficit(0.45)[1], densification="off")
    assert bodies is FIRST[0]
    assert not report["reached"]
    assert report["reason"].startswith("switched off in the config, although the target porosity 0.4000")
    assert report["densification"]["called_for"]


def test_switched_off_spheres_visibly_miss():
    _, report = Bed(0.35).second(deficit(0.35, switch="off")[1])
    assert not report["reached"]
    assert report["porosity"] == 0.35


def test_vugs_in_a_dense_rock_get_spheres_and_lubrication():
    """Spheres keep the share that the vugs want; the grains about them are packed denser."""
    plan = deficit(0.42, tail=VUGS)[1]
    bed = Bed(0.42, slick=0.15)
    bodies, report = bed.second(plan)
    assert report["reached"]
    assert {p for p, _ in bed.poured} == {plan["virtual_spheres"]["p_sp"]}
    assert bed.poured[0][1] == 1.0
    assert (bodies["kind"] == "virtual").any()
    assert report["densification"]["on"]


def test_vugs_that_leave_the_porosity_short_are_corrected_by_feedback():
    """Where spheres open the bed less than their formula says, more of them are poured."""
    bed = Bed(0.391, c=0.02)
    plan = deficit(0.395, tail=packing.PoreTail(20.0, 8.0, 5.0, 0.02))[1]
    plan["porosity_first"] = 0.38
    bed.first = 0.38
    _, report = bed.second(plan)
    assert report["passes"][-1]["p_sphere"] > plan["virtual_spheres"]["p_sp"]
    assert report["reached"]


# ---- voids


def cubed(scale):
    """Mean volume of bodies that are all in the shapes of voids, half a grain's where they are not scaled."""
    return 0.5e4 * scale**3


@pytest.mark.parametrize("width", [0.9, 1.0, 1.12, None])
def test_bodies_of_voids_are_scaled_by_the_width_found_and_hold_as_much_open(width):
    """In a bed whose solid is what its bodies' volume leaves, the next guess meets the target at once."""
    bed, plan = Bed(0.35, c=0.5), deficit(0.35)[1]
    found = packing.size_voids(plan, lambda p: bed.pour(p, 1.0), lambda bodies: width, cubed, bed.porosity)
    assert bed.poured == [(plan["virtual_spheres"]["p_sp"], 1.0)]
    assert found["width"] == width
    assert found["scale"] == pytest.approx(1 / (width or 1.0))
    assert found["wall_s"] == 2.0
    scaled = Bed(0.35, c=0.5 * found["scale"] ** 3)
    bodies, _ = scaled.pour(found["p_sp"], 1.0)
    assert scaled.porosity(bodies[bodies["kind"] == "grain"]) == pytest.approx(0.4, abs=1e-9)


@pytest.mark.parametrize("filled", [0.0, 0.3, 0.399, 0.4, 1.0])
def test_bodies_of_voids_leave_a_probability_whatever_they_fill(filled):
    """The looser they lie together, the fewer bodies; too loose for any, and they keep their share."""
    bed, plan = Bed(0.35), deficit(0.35)[1]
    p_sp = [
        packing.size_voids(
            plan, lambda p: bed.pour(p, 1.0), lambda bodies: 1.1, cubed, lambda bodies, to=to: to
        )["p_sp"]
        for to in (0.29, filled)
    ]
    assert 0 < p_sp[1] < 1
    odds = [p / (1 - p) for p in (plan["virtual_spheres"]["p_sp"], p_sp[1])]
    if 0 < filled < 0.4:
        assert p_sp[1] < p_sp[0]
    else:
        assert odds[1] == pytest.approx(1.1**3 * odds[0])


def test_how_many_bodies_the_region_happens_to_have_does_not_tell_how_many_to_pour():
    class Lucky(Bed):
        def porosity(self, bodies):
            return super().porosity(bodies) + 0.02 * (bodies["kind"] == "grain").all()

    p_sp = [
        packing.size_voids(
            deficit(0.35)[1], lambda p, bed=bed: bed.pour(p, 1.0), lambda bodies: 1.1, cubed, bed.porosity
        )["p_sp"]
        for bed in (Bed(0.35), Lucky(0.35))
    ]
    assert p_sp[0] == p_sp[1]


def test_spheres_too_small_for_the_shape_of_a_void_keep_their_size_and_number():
    """Half the volume in spheres that stay as they are: the rest alone has to be made up for in number."""
    voids = Library(*[[np.zeros((1, 3))] * 2] * 2, pd.DataFrame({"phase": [VOID, 1], "r2d_um": [8.0, 2.0]}))
    numbers = np.array([10.0**3, 0.0, 6.0**3]) / (10.0**3 + 6.0**3)
    densities = numbers / 0.02
    edges = np.array([5.99, 6.01, 9.99, 10.01])
    spheres = packing.VirtualSizes(edges, densities, densities, densities, densities, True, "")
    volume = packing.mean_void_volume(spheres, voids, 1.0)
    assert volume == pytest.approx(spheres.mean_volume, rel=1e-2)
    assert packing.mean_void_volume(spheres, voids, 0.8) == pytest.approx(volume * (1 + 0.8**3) / 2, rel=1e-2)


def test_voids_of_the_tail_keep_their_share():
    plan = deficit(0.42, tail=VUGS)[1]
    bed, p = Bed(0.42), plan["virtual_spheres"]["p_sp"]
    found = packing.size_voids(plan, lambda p: bed.pour(p, 1.0), lambda bodies: 1.1, cubed, bed.porosity)
    odds = found["p_sp"] / (1 - found["p_sp"]) * found["scale"] ** 3
    assert odds == pytest.approx(p / (1 - p))


# ---- where the region lies


def test_the_nearest_place_is_the_one_of_least_miss_and_then_of_the_least_way():
    porosity = np.full((5, 5, 5), 0.5)
    porosity[2, 2, 2] = 0.45
    assert packing.nearest_place(porosity, 0.4, 2.0) == packing.Place((0.0, 0.0, 0.0), 0.45, 0.45)
    porosity[4, 2, 1] = porosity[0, 0, 0] = porosity[2, 3, 2] = 0.41
    assert packing.nearest_place(porosity, 0.4, 2.0) == packing.Place((0.0, 2.0, 0.0), 0.41, 0.45)
    porosity[4, 2, 1] = 0.395
    assert packing.nearest_place(porosity, 0.4, 2.0).moved_um == (-2.0, 0.0, 4.0)


@given(st.integers(0, 3), st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_no_place_is_nearer_than_the_nearest(reach, aim, seed):
    porosity = np.random.default_rng(seed).random((2 * reach + 1,) * 3).round(1)
    found = packing.nearest_place(porosity, aim, 1.0)
    assert abs(found.porosity - aim) == np.abs(porosity - aim).min()
    x, y, z = (int(along) + reach for along in found.moved_um)
    assert porosity[z, y, x] == found.porosity


def test_a_region_goes_no_farther_than_half_a_grain_and_not_near_the_walls():
    plan = {"mean_diameter_um": 10.0, "voxel_size_um": 2.0}
    reach = [packing.reach_voxels({**plan, "margin_um": margin}) for margin in (5.0, 15.0, 18.0, 19.0, 60.0)]
    assert reach == [0, 0, 1, 2, 2]


def test_moved_bodies_are_counted_from_the_moved_corner_and_come_back():
    bodies = pd.DataFrame({"id": [0, 1], "x": [1.0, 2.0], "y": [3.0, 4.0], "z": [5.0, 6.0], "scale": 1.0})
    moved = packing.move(bodies, (1.0, 0.0, -2.0))
    assert moved[["x", "y", "z"]].to_numpy().tolist() == [[0.0, 3.0, 7.0], [1.0, 4.0, 8.0]]
    pd.testing.assert_frame_equal(packing.move(moved, (-1.0, 0.0, 2.0)), bodies)
    scene = {"margin_um": 25.0, "edge_um": 100.0}
    assert packing.as_placed(scene, {"moved_um": [1.0, 0.0, -2.0]}) == {"margin_um": 23.0, "edge_um": 100.0}


class Uneven(Bed):
    """A bed whose porosity differs from place to place by up to 0.015."""

    def bodies(self, *made_with):
        return super().bodies(*made_with).assign(x=5.0, y=5.0, z=5.0)

    def place_of(self, grains, aim):
        middle = self.porosity(grains)
        return packing.Place((0.0, 2.0, -4.0), middle + np.clip(aim - middle, -0.015, 0.015), middle)

    def second(self, plan, **over):
        return super().second(plan, place_of=self.place_of, **over)


def test_a_region_is_moved_where_it_misses_in_the_middle_and_not_there():
    plain, uneven = Bed(0.35), Uneven(0.35)
    plan = deficit(0.35)[1]
    plan["virtual_spheres"]["p_sp"] = 0.1  # 0.384 porous
    passes = [len(bed.second(plan)[1]["passes"]) for bed in (plain, uneven)]
    assert passes[0] > passes[1] == 1
    bodies, report = uneven.second(plan)
    placed = report["placement"]
    assert placed["on"]
    assert placed["called_for"]
    assert not placed["forced"]
    assert placed["moved_um"] == report["passes"][-1]["moved_um"] == [0.0, 2.0, -4.0]
    assert bodies[["x", "y", "z"]].iloc[0].tolist() == [5.0, 3.0, 9.0]
    assert report["reached"]
    assert report["porosity"] == pytest.approx(0.4, abs=0.0025)
    assert "misses 0.4000 to within 0.01; moved by (0, 2, -4) µm" in placed["reason"]
    # and at rest it is looked for once more: what is brought to rest is the bed, wherever the region lies
    assert uneven.rests[-1][2] == 0


def test_a_region_stays_where_nothing_near_it_helps_or_the_middle_meets():
    far = Uneven(0.35, c=0.2)
    bodies, report = far.second(deficit(0.35)[1], passes=1)
    assert not report["reached"]
    assert not report["placement"]["on"]
    assert report["placement"]["moved_um"] == [0.0, 0.0, 0.0]
    assert bodies["x"].iloc[0] == 5.0
    met = Uneven(0.35, c=0.5)
    plan = deficit(0.35)[1]
    plan["virtual_spheres"]["p_sp"] = 0.14  # 0.397 porous
    bodies, report = met.second(plan)
    assert report["passes"][0]["moved_um"] == [0.0, 0.0, 0.0]
    assert "meets 0.4000" in report["placement"]["reason"]
    pd.testing.assert_frame_equal(bodies.drop(columns="call"), met.bodies(0.14, 1.0, 0).drop(columns="call"))


def test_placement_forced_off_visibly_misses_and_forced_on_comes_nearer():
    plan = deficit(0.35)[1]
    _, off = Uneven(0.35, c=0.28).second(plan, placement="off", passes=1)
    assert not off["reached"]
    assert "switched off in the config, although in the middle" in off["placement"]["reason"]
    plan["virtual_spheres"]["p_sp"] = 0.14
    _, on = Uneven(0.35, c=0.5).second(plan, placement="on")
    assert on["placement"]["on"]
    assert on["placement"]["forced"]
    assert on["porosity"] == pytest.approx(0.4025)


# ---- between voids


SPHERES = deficit(0.35)[0].mean_volume / 1e4
"""Mean volume of those spheres over that of a grain."""


class Loosened(Bed):
    """Virtual spheres loosen the grains about them, friction keeps them so.

    Grains and spheres fill as much together as grains alone do at that friction.
    """

    def __init__(self, first, slick=0.08, c=SPHERES):
        super().__init__(first, slick, c=c)

    def porosity(self, bodies):
        p, lubrication, _ = self.of(bodies)
        p = p if (bodies["kind"] == "grain").all() else 0.0
        return 1 - (1 - self.first - self.loose(lubrication)) / (1 + self.c * p / (1 - p))

    def between(self, grains):
        return self.first + 0.03 + self.loose(self.of(grains)[1])

    def second(self, plan, **over):
        given = {"between_of": self.between, "passes": 6} | over
        return packing.pack_again(plan, self.pour, self.rested, self.porosity, FIRST, **given)


def vuggy(between, error=0.003, **over):
    """A section with voids that is so porous between them; the bed has 0.35, and 0.38 with its spheres."""
    return deficit(0.35, tail=VUGS, between=Intergranular(20.0, 0.1, between, error), **over)[1]


@pytest.mark.parametrize("voids", [True, False])
@pytest.mark.parametrize("between", [0.35, 0.36])
def test_grains_between_voids_are_lubricated_until_they_lie_as_the_sections(between, voids):
    bed, plan, given = Loosened(0.35), vuggy(between), {}
    if voids:
        given = {"voids": {"between": 0.38, "filled": 0.35, "volume_um3": 1e4 * SPHERES}}
    bodies, report = bed.second(plan, **given)
    assert report["reached"]
    found, dense = report["between"], report["densification"]
    assert dense["on"]
    assert not dense["forced"]
    assert "is 0.380 porous, which exceeds the section's" in dense["reason"]
    assert found["came_to"] == pytest.approx(between)
    assert found["lubrication"] == pytest.approx(10 ** ((between - 0.38) / bed.slick))
    # one pour with the least friction, and one by the same friction as the first where none is known
    assert bed.poured[0 if voids else 1][1] == SLICK
    assert found["wall_s"] == (2.0 if voids else 4.0)
    assert {lubrication for _, lubrication in bed.poured[1 if voids else 2 :]} == {found["lubrication"]}
    # what is filled tells how many spheres the target takes at that friction: the next guess meets it at once
    assert len(report["passes"]) == 1
    assert bed.porosity(bodies[bodies["kind"] == "grain"]) == pytest.approx(0.4, abs=1e-9)
    assert bed.rests == [(found["p_sp"], found["lubrication"], 0)]


@pytest.mark.parametrize("more", [-0.006, 0.0, 0.012])
def test_friction_between_voids_is_corrected_where_the_bodies_loosen_more_than_the_first_ones(more):
    """Bodies poured smaller are more, and loosen another matrix than those that they were sized by."""

    class Finer(Loosened):
        def between(self, grains):
            return super().between(grains) + more

    bed, plan = Finer(0.35), vuggy(0.355)
    rough = {"between": 0.38, "filled": 0.35, "volume_um3": 1e4 * SPHERES}
    _, report = bed.second(plan, voids=rough)
    found = report["between"]
    assert abs(found["came_to"] - 0.355) <= plan["between"]["error"]
    assert (len(found["tries"]) == 1) == (more == 0)
    assert len(found["tries"]) <= packing.voids.FRICTIONS
    assert report["reached"]
    # the last bed tried is the first pass: nothing is poured twice, and all time is told once
    assert len(bed.poured) == 1 + len(found["tries"]) + len(report["passes"]) - 1
    told = found["wall_s"] + sum(one["wall_s"] for one in report["passes"])
    assert told == 2 * len(bed.poured) + len(bed.rests)


def test_where_beds_scatter_the_best_friction_found_has_to_do():
    class Scattered(Loosened):
        def between(self, grains):
            off = {0: -0.03, 1: 0.02, 2: -0.006}.get(len(self.poured) - 1, -0.02)
            return 0.355 + off

    bed, plan = Scattered(0.35), vuggy(0.355)
    _, report = bed.second(plan, voids={"between": 0.38, "filled": 0.35, "volume_um3": 1e4 * SPHERES})
    found = report["between"]
    assert [one["between"] for one in found["tries"]] == pytest.approx([0.375, 0.349, 0.335])
    assert found["lubrication"] == found["tries"][1]["lubrication"]
    assert bed.poured[4] == bed.poured[2]
    told = found["wall_s"] + sum(one["wall_s"] for one in report["passes"])
    assert told == 2 * len(bed.poured) + len(bed.rests)


def test_grains_that_lie_as_the_sections_are_left_as_they_are():
    """Within what the section's sampling explains nothing is poured twice, nor lubricated."""
    for between in (0.375, 0.38, 0.5):
        bed = Loosened(0.35)
        _, report = bed.second(vuggy(between))
        assert not report["densification"]["called_for"]
        assert "does not exceed the section's" in report["densification"]["reason"]
        assert report["between"] is None
        assert {lubrication for _, lubrication in bed.poured} == {1.0}
        assert sum(one["wall_s"] for one in report["passes"]) == 2 * len(bed.poured) + len(bed.rests)


def test_denser_between_voids_switched_off_visibly_misses_and_forced_without_need_does_nothing():
    bed = Loosened(0.35)
    bodies, report = bed.second(vuggy(0.35), densification="off")
    assert report["densification"]["called_for"]
    assert not report["densification"]["on"]
    assert bed.between(bodies[bodies["kind"] == "grain"]) == pytest.approx(0.38)
    _, report = Loosened(0.35).second(vuggy(0.39), densification="on")
    assert report["between"] is None
    assert "with nothing to do" in report["densification"]["reason"]


@given(st.floats(0.05, 0.9), st.floats(-0.2, 0.3), st.floats(0.001, 2.0))
def test_friction_between_voids_stays_within_its_bounds(between, slick, c):
    """However dense the section, and whatever friction does to a bed."""
    bed = Loosened(0.35, slick=slick, c=c)
    _, report = bed.second(vuggy(between), passes=3)
    for p, lubrication in bed.poured:
        assert 0 < p < 1
        assert SLICK <= lubrication <= 1
    if report["between"] is not None and slick <= 0:
        assert report["between"]["lubrication"] == SLICK


def test_beds_without_a_grain_between_voids_leave_a_probability():
    """All pore between the voids, or all pore: no division by what is left of the solid."""
    for opened, between in ((1.0, 1.0), (0.5, 1.0), (1.0, 0.4)):
        plan = vuggy(0.35)
        rough = {"filled": 0.35, "between": 0.38, "volume_um3": 1e4 * SPHERES}
        found = packing.match_between(
            plan, rough, Loosened(0.35).pour, lambda bodies, to=opened: to, lambda grains, to=between: to
        )
        assert 0 < found["p_sp"] < 1
        assert SLICK <= found["lubrication"] <= 1


def test_a_region_that_is_all_void_calls_for_nothing():
    _, report = Loosened(0.35).second(vuggy(0.3), between_of=lambda grains: None)
    assert not report["densification"]["on"]
    assert "nothing of the region lies between voids" in report["densification"]["reason"]


@pytest.mark.parametrize(
    ("first", "over"),
    [(0.35, {"tail": NO_TAIL}), (0.395, {"tail": VUGS}), (0.35, {"tail": VUGS, "switch": "off"})],
)
def test_only_spheres_in_voids_that_the_section_has_are_held_against_it(first, over):
    """Not where the porosity is none of the section's, nor where the share of the tail is kept."""
    assert deficit(first, between=Intergranular(20.0, 0.1, 0.3, 0.003), **over)[1]["between"] is None


def test_rims_fill_pores_between_the_voids():
    """phi = v + (1 - v) phi_between, before them and after, with the same voids."""
    plan = vuggy(0.33, overgrowth=TOGETHER)
    voids = 1 - (1 - 0.4) / (1 - 0.33)
    before = plan["overgrowth"]["porosity"]
    assert voids + (1 - voids) * plan["between"]["wanted"] == pytest.approx(before)


# ---- refinement


def coarse_and_fine(overlap):
    tried = []

    def pack_with(parameters):
        tried.append(parameters)
        return pd.DataFrame(), {"max_overlap": overlap * parameters.dt / 0.01, "wall_s": 1.0 + len(tried)}

    return tried, pack_with


@pytest.mark.parametrize(
    ("overlap", "switch", "on"),
    [
        (0.03, "auto", True),
        (0.01, "auto", False),
        (0.01, "on", True),
        (0.03, "off", False),
    ],
)
def test_refinement_where_grains_overlap(overlap, switch, on):
    tried, pack_with = coarse_and_fine(overlap)
    said = []
    _, report = packing.pack_first(pack_with, packing.Parameters(), switch, said.append)
    found = report["refinement"]
    assert found["on"] is on
    assert found["forced"] is (switch != "auto")
    assert len(tried) == 1 + on
    assert [line.split(":")[0] for line in said] == ["poured again with half the time step"] * on
    assert f"of the collision shapes, {overlap:.4f} of the smaller radius" in found["reason"]
    if on:
        assert tried[1].dt == tried[0].dt / 2
        assert tried[1].solver_iterations == 2 * tried[0].solver_iterations
        assert found["cost_s"] == 3.0
        assert report["wall_s"] == 2.0 + 3.0


# ---- the plan


@pytest.mark.parametrize(
    ("switch", "called_for", "possible", "on", "words"),
    [
        ("auto", True, True, True, "why"),
        ("auto", False, True, False, "why"),
        ("on", True, True, True, "why"),
        ("on", False, True, True, "forced on in the config, although why"),
        ("on", False, False, False, "forced on in the config, with nothing to do: why"),
        ("off", True, True, False, "switched off in the config, although why"),
        ("off", False, True, False, "switched off in the config, why"),
    ],
)
def test_decisions(switch, called_for, possible, on, words):
    found = packing.decide(switch, called_for, "why", possible)
    assert found == {
        "on": on,
        "forced": switch != "auto",
        "called_for": called_for,
        "reason": words,
    }


def effects(plan, second, refinement, *, first_s, largest):
    """The plan of a twin without rims, of these two packings."""
    first = {"poured": 9, "engine": "PhysX", "steps": 7, "wall_s": first_s, "refinement": refinement}
    first |= {"n_hulls": 8, "n_decomposed": 1, "n_spheres": 0, "collision_excess": 0.02, "hull_excess": 0.03}
    first |= {"parameters": {"decomposition": "auto", "heavy": 5.0}, "largest": 4.5}
    second = {**second, "largest": largest, "voids": None}
    scaling = {"applied": True, "forced": False, "reason": "positions scaled", "wall_s": 4.0, "passes": 4}
    cement = {**packing.decide("off", False, "no need"), "wall_s": 0.0}
    cement["compaction"] = {**packing.decide("auto", False, "there are no rims"), "wall_s": 0.0}
    shapes = {"on": False, "forced": False, "reason": "a distance map parts the grains"}
    return packing.effects_plan(shapes, scene(), first, plan, second, scaling, cement)


def test_plan_gives_reason_and_cost_or_saving_of_every_effect():
    bed, plan = Bed(0.47), deficit(0.47)[1]
    refinement = {**packing.decide("auto", False, "no overlap"), "cost_s": None}
    found = effects(plan, bed.second(plan)[1], refinement, first_s=3.0, largest=6.5)
    assert all(effect["reason"] for effect in found.values())
    optional = (
        "decomposition refinement weight_limit phase_mixing virtual_spheres densification placement "
        "position_scaling"
    )
    assert {*optional.split(), "own_shapes", "compaction", "cement"} <= set(found)
    for name, effect in found.items():
        told = {key for key in ("cost_s", "saved_s") if effect[key] is not None}
        # what is no step of its own has no time that could be told apart
        within = name in {
            "own_shapes",
            "decomposition",
            "weight_limit",
            "phase_mixing",
            "placement",
            "void_shapes",
        }
        assert told == (set() if within else {"cost_s" if effect["on"] else "saved_s"}), name
    assert found["gravity_packing"]["cost_s"] == 3.0
    assert found["refinement"]["saved_s"] == 6.0
    assert found["virtual_spheres"]["saved_s"] == 3.0
    assert found["densification"]["cost_s"] == 2.0 * len(bed.poured) + len(bed.rests)
    assert found["position_scaling"]["cost_s"] == 4.0
    assert found["weight_limit"]["on"]
    assert "6.50 mean grain radii; from 5 on" in found["weight_limit"]["reason"]
    assert found["cement"] == {
        "on": False,
        "forced": True,
        "reason": "switched off in the config, no need",
        "cost_s": None,
        "saved_s": 2.0,
    }


def test_the_smallest_void_of_a_library_is_the_least():
    table = pd.DataFrame({"phase": [VOID, VOID, 1], "r2d_um": [8.0, 12.0, 2.0]})
    assert smallest_void(Library(*[[np.zeros((1, 3))] * 3] * 2, table)) == 8.0


def test_a_section_of_cut_circles_alone_has_no_tail():
    cut, whole = circles([5.0, 40.0]).assign(weight=0.0), circles([5.0] * 50, 10)
    found = packing.pore_tail(cut, whole, 0.3, 0.3, np.random.default_rng(0))
    assert (found.target_um, found.exceeds) == (None, False)


def test_both_surfaces_are_uncertain():
    """Two hundredths apart, of standard errors of one hundredth each: 1.4 of what both leave open."""
    near = packing.Overgrowth(SolidSurface(0.10, 0.01), SolidSurface(0.12, 0.01), 0.02)
    assert not near.exceeds
    assert not packing.Overgrowth(SolidSurface(0.10, 0.001), SolidSurface(0.12, 0.02), 0.02).exceeds


def test_what_moved_is_told_by_its_own_radius():
    before = pd.DataFrame({"x": [0.0, 0.0], "y": 0.0, "z": 0.0, "scale": [1.0, 100.0]})
    after = before.assign(x=[0.2, 0.2])
    assert packing.moved_share(before, after) == 0.5


def test_refinement_is_no_part_of_what_a_packing_takes():
    """A plan tells the first pour and the finer one apart, and spheres from lubrication."""
    plan = deficit(0.42, tail=VUGS)[1]
    _, second = Bed(0.42, slick=0.15).second(plan)
    refinement = {**packing.decide("auto", True, "overlap"), "cost_s": 6.0}
    found = effects(plan, second, refinement, first_s=9.0, largest=1.0)
    assert found["gravity_packing"]["cost_s"] == 3.0
    told = found["virtual_spheres"]["cost_s"] + found["densification"]["cost_s"]
    assert told == pytest.approx(sum(one["wall_s"] for one in second["passes"]))


def test_volumes_are_those_of_the_sizes_that_are_poured():
    """Circles half as wide as the grains: an eighth of the volume, eight times as many."""
    edges, small, large = np.array([9.8, 10.2, 19.6, 20.4]), np.array([2.5, 0, 0]), np.array([0, 0, 1.25])
    sizes = stereology.SizeDistribution(edges, small, large, large, large, "given", float("nan"))
    one = {**SECTION, "phases": ["pore", "quartz"], "fractions": [1.0]}
    true, seen = (
        packing.plan_scene({(1, "grain"): sizes}, one, **{**SCENE, "sizes_from": f}) for f in ("f3d", "f2d")
    )
    assert true["mean_volumes_um3"] == pytest.approx([8 * v for v in seen["mean_volumes_um3"]])
    assert true["edge_um"] == seen["edge_um"]
    assert packing.poured_grains(seen) == pytest.approx(8 * packing.poured_grains(true))
    side = true["edge_um"] + 2 * true["margin_um"]
    assert packing.poured_grains(true, 0.5) == pytest.approx(0.5 * side**3 / true["mean_volumes_um3"][0])


def test_spheres_lie_between_a_throat_and_a_quarter_of_the_region():
    """Pores of all sizes: what slips between grains holds nothing, what is wider would be the region."""
    edge, radius = scene()["edge_um"], (3 * 1e4 / (4 * np.pi)) ** (1 / 3)
    pores = stereology.SizeDistribution(
        np.array([0, edge]), *[np.array([1 / edge])] * 4, "given", float("nan")
    )
    found, _ = packing.plan_deficit(
        scene(), pores, None, NO_TAIL, APART, 0.35, 1e4, switch="auto", limit=0.01
    )
    assert found.quantile(np.array([0.0, 1.0])) == pytest.approx([(2 / 3**0.5 - 1) * radius, edge / 4])


def test_the_share_of_a_tail_is_of_the_rock_on_either_side():
    """Beyond a radius of 5 lie 4000 of 6250 of the section's pore area, and 100 of 2350 of the packing's."""
    section, first = circles([5.0] * 90 + [20.0] * 10), circles([5.0] * 90 + [10.0], 7)
    found = packing.pore_tail(section, first, 0.3, 0.6, np.random.default_rng(0))
    assert found.first_um == 5.0
    assert found.share == pytest.approx(0.3 * 4000 / 6250 - 0.6 * 100 / 2350)
