"""Overgrowth rims against spheres whose grown volume is known."""

import itertools
import sys
import tracemalloc
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from grainfall import volume
from grainfall.surface import solid_surface

LIBRARY = SimpleNamespace(vertices=[], faces=[])
CEMENT = 3
rims = sys.modules["grainfall.volume.cement"]  # its name in the package is that of its function


def lattice(spacing=32.0, radius=10.0, n=2, around=1):
    """Spheres on a simple cubic lattice, the cells around the region of n cells included; unit voxels."""
    cells = np.arange(-around, n + around) + 0.5
    xyz = np.stack(np.meshgrid(cells, cells, cells), axis=-1).reshape(-1, 3) * spacing
    bodies = pd.DataFrame(xyz, columns=["x", "y", "z"])
    bodies = bodies.assign(id=range(len(xyz)), kind="grain", phase=1 + np.arange(len(xyz)) % 2, shape=-1)
    return bodies.assign(scale=radius, qw=1.0, qx=0.0, qy=0.0, qz=0.0), (int(n * spacing),) * 3


def distance_to_surface(bodies, shape, radius=10.0):
    """Distance of every voxel centre from the nearest sphere's surface."""
    centre = np.stack(np.indices(shape)[::-1], axis=-1) + 0.5
    nearest = np.full(shape, np.inf)
    for xyz in bodies[["x", "y", "z"]].to_numpy():
        nearest = np.minimum(nearest, np.linalg.norm(centre - xyz, axis=-1) - radius)
    return nearest


@pytest.mark.parametrize("thickness", [0.5, 1.7, 4.0, 5.9])
def test_rims_are_the_grown_spheres(thickness):
    """The target is the exact porosity of spheres grown by ``thickness``, and such spheres it becomes.

    The grid knows the surface to within a voxel: half a diagonal inside, half a diagonal outside.
    """
    bodies, shape = lattice()
    target = 1 - 4 / 3 * np.pi * (10 + thickness) ** 3 / 32**3
    phase, _, report = volume.cement(bodies, LIBRARY, shape, 1.0, target, CEMENT)
    assert abs(np.count_nonzero(phase == 0) - target * phase.size) <= 1
    depth = distance_to_surface(bodies, shape)
    assert depth[phase == CEMENT].max() < thickness + 3**0.5 / 2
    assert depth[phase == 0].min() > thickness - 3**0.5 / 2
    assert report["rim_um"] == pytest.approx(thickness, abs=3**0.5 / 2)


@pytest.mark.parametrize("target", [0.5, 0.196, 0.086, 0.0])
def test_any_target_is_met_to_the_voxel(target):
    bodies, shape = lattice(spacing=22.0)
    phase, _, report = volume.cement(bodies, LIBRARY, shape, 1.0, target, CEMENT)
    assert abs(np.count_nonzero(phase == 0) - target * phase.size) <= 0.5
    assert report["after"] == pytest.approx(target, abs=0.5 / phase.size)
    assert report["share"] == pytest.approx(report["before"] - report["after"], abs=1e-12)


def test_grains_stay_and_rims_belong_to_the_grain_they_grew_on():
    bodies, shape = lattice()
    before, owner_before = volume.voxelise(bodies, LIBRARY, shape, 1.0)
    phase, owner, _ = volume.cement(bodies, LIBRARY, shape, 1.0, 0.5, CEMENT)
    solid = before > 0
    np.testing.assert_array_equal(phase[solid], before[solid])
    np.testing.assert_array_equal(owner[solid], owner_before[solid])
    assert set(np.unique(phase[~solid])) == {0, CEMENT}
    np.testing.assert_array_equal(owner > 0, phase > 0)
    centres = bodies.set_index("id")[["z", "y", "x"]]
    rim = np.argwhere(phase == CEMENT)
    off = np.linalg.norm(rim + 0.5 - centres.loc[owner[phase == CEMENT] - 1].to_numpy(), axis=1)
    assert off.max() < 10 + (1 - 0.5) * 32  # nobody's rim reaches over its neighbour's


def test_more_cement_only_adds():
    bodies, shape = lattice()
    filled = [volume.cement(bodies, LIBRARY, shape, 1.0, t, CEMENT)[0] > 0 for t in (0.7, 0.62, 0.6, 0.3)]
    for less, more in itertools.pairwise(filled):
        assert (more | ~less).all()


def test_rims_grow_in_from_grains_outside_the_region():
    """Of two spheres one lies beyond the region's face, no voxel of it inside: its rim comes in."""
    bodies, _ = lattice(n=1, around=0)
    beyond = bodies.assign(id=1, z=-9.6)
    bodies = pd.concat([bodies.assign(z=24.0), beyond], ignore_index=True)
    shape = (32, 32, 32)
    plain, owner = volume.voxelise(bodies, LIBRARY, shape, 1.0)
    assert not (owner == 2).any()
    phase, owner, report = volume.cement(bodies, LIBRARY, shape, 1.0, (plain == 0).mean() - 0.05, CEMENT)
    assert (owner == 2).any()
    rim = (owner == 2) & (phase == CEMENT)
    assert distance_to_surface(beyond, shape)[rim].max() == pytest.approx(report["rim_um"], abs=1.0)


def test_rims_take_less_memory_than_the_voxels_twice():
    """Of a region of 1000^3 that is 10 GB; a sort of one shell, a tenth of it, would take as much again."""
    side = np.abs(np.arange(480) % 12 - 5.5)
    z, y, x = np.meshgrid(side, side[:60], side[:60], indexing="ij", sparse=True)
    phase = (z**2 + y**2 + x**2 < 5.5**2).astype(np.uint8)
    body = phase.astype(np.int32)
    volume.grow_rims(phase[:24].copy(), body[:24].copy(), 0.5, CEMENT)  # what is compiled and loaded once
    tracemalloc.start()
    try:
        cemented, _, _ = volume.grow_rims(phase, body, (phase == 0).mean() - 0.05, CEMENT)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (cemented == CEMENT).mean() == pytest.approx(0.05, abs=1e-5)
    assert peak < 2 * (phase.nbytes + body.nbytes)


@pytest.mark.parametrize("scatter", [rims.SCATTER, np.zeros(3, np.uint64)], ids=["apart", "all alike"])
@given(seed=st.integers(0, 10**6), share=st.floats(0, 1), margin=st.integers(0, 2))
@settings(max_examples=15, deadline=None)
def test_rims_fill_what_comes_first_in_one_long_list(scatter, seed, share, margin):
    """By distance, then solid near by, then the recurrence, then place: sorted as a whole, voxel by voxel."""
    rng = np.random.default_rng(seed)
    phase = (ndimage.gaussian_filter(rng.random((12, 11, 14)), 1.5) > 0.5).astype(np.uint8)
    within = tuple(slice(margin, n - margin) for n in phase.shape)
    pores = np.argwhere(phase[within] == 0)
    target = share * len(pores) / phase[within].size
    distance = ndimage.distance_transform_edt(phase == 0)[within]
    near = np.pad(phase > 0, 2, mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(near, (5, 5, 5)).sum(axis=(3, 4, 5))[within]
    even = (pores.astype(np.uint64) * scatter).sum(axis=1) % np.uint64(2**32)
    at = tuple(pores.T)
    order = np.lexsort((even, -near[at].astype(int), np.rint(distance[at] ** 2)))
    number = len(pores) - round(target * phase[within].size) if phase.any() else 0
    expected = phase[within].copy()
    expected[tuple(pores[order[:number]].T)] = CEMENT
    with mock.patch.object(rims, "SCATTER", scatter):
        cemented, _, _ = volume.grow_rims(phase, phase.astype(np.int32), target, CEMENT, margin)
    np.testing.assert_array_equal(cemented, expected)


def test_the_last_shell_is_spread_evenly():
    """Half a shell on a flat wall: every quarter of the wall gets its share."""
    phase = np.zeros((6, 64, 64), np.uint8)
    phase[0] = 1
    cemented, _, rim = volume.grow_rims(phase, phase.astype(np.int32), 1 - (1.5 * 64**2) / phase.size, CEMENT)
    assert rim == 0.5
    quarters = (cemented[1] == CEMENT).reshape(2, 32, 2, 32).sum(axis=(1, 3))
    np.testing.assert_allclose(quarters, 512, atol=16)


@pytest.mark.parametrize("target", [0.95, 0.9])
def test_nothing_is_done_where_the_pores_are_few_enough(target):
    bodies, shape = lattice()
    phase, owner, report = volume.cement(bodies, LIBRARY, shape, 1.0, target, CEMENT)
    plain = volume.voxelise(bodies, LIBRARY, shape, 1.0)
    assert report["rim_um"] == report["share"] == 0
    np.testing.assert_array_equal(phase, plain[0])
    np.testing.assert_array_equal(owner, plain[1])


def test_without_grains_there_is_nothing_to_grow_on():
    phase, _, report = volume.cement(lattice()[0].iloc[:0], LIBRARY, (8, 8, 8), 1.0, 0.5, CEMENT)
    assert not phase.any()
    assert report["rim_um"] == 0


def test_slabs_do_not_show():
    """The nearest grain is the same whether the volume is one slab or many."""
    from grainfall.volume.cement import _nearest

    body = np.zeros((40, 12, 12), np.int32)
    body[5, 6, 6], body[20, 2, 2], body[33, 9, 9] = 1, 2, 3
    slabs = [_nearest(body, 40, z, min(z + 7, 40)) for z in range(0, 40, 7)]
    np.testing.assert_array_equal(np.concatenate(slabs), _nearest(body, 40, 0, 40))


# ---- from the packing to the twin

SCENE = {
    "shape_zyx": [64, 64, 64],
    "voxel_size_um": 1.0,
    "resolution_um": 1.0,
    "margin_um": 0.0,  # the lattice ends with the region: no room is made
    "mean_diameter_um": 20.0,
    "phases": ["pore", "quartz", "feldspar"],
}
NEEDED = {"called_for": True, "on": True, "too_loose": True}


def finished(target, densification=NEEDED, overgrowth=None, **switches):
    scene = {**SCENE, "porosity_target": target}
    overgrowth = {"on": False, "called_for": False, "porosity": target} | (overgrowth or {})
    overgrowth = {"section_per_um": 0.0} | overgrowth  # nothing to press for
    switches = dict.fromkeys(("position_scaling", "cement", "compaction"), "auto") | switches
    bodies, slabs, *reports = volume.finish(lattice()[0], LIBRARY, scene, overgrowth, densification, switches)
    _, phase, body = (
        np.concatenate(parts) if i else parts for i, parts in enumerate(zip(*slabs, strict=True))
    )
    return bodies, phase, body, *reports


PLAIN = 1 - 4 / 3 * np.pi * 10**3 / 32**3
"""Porosity of the lattice, but for the voxels."""


@pytest.mark.parametrize(
    ("target", "given", "on", "words"),
    [
        (0.6, {}, True, "densification leaves a porosity of 0.87"),
        (
            0.6,
            {"densification": NEEDED | {"on": False}},
            True,
            "the packing leaves a porosity",
        ),
        (
            0.6,
            {"densification": NEEDED | {"too_loose": False}},
            False,
            "the virtual spheres, not",
        ),
        (0.6, {"cement": "off"}, False, "switched off in the config, although"),
        (0.868, {"position_scaling": "off"}, False, "within 0.01"),
        (0.868, {"position_scaling": "off", "cement": "on"}, True, "forced on in the config, although"),
        (0.9, {"cement": "on"}, False, "with nothing to do"),
    ],
)
def test_cement_where_densification_fell_short(target, given, on, words):
    _, phase, _, scaling, rims = finished(target, **given)
    assert rims["on"] is on
    assert words in rims["reason"]
    assert scaling["before"]["porosity"] == pytest.approx(PLAIN, abs=0.002)
    assert (phase == CEMENT).any() == on
    if on:
        assert abs(np.count_nonzero(phase == 0) - target * phase.size) <= 1
    else:
        assert abs((phase == 0).mean() - target) > 0.001  # what is called for and off is missed


def test_forced_cement_without_a_deficit_changes_nothing():
    auto, forced = (finished(0.875, cement=switch) for switch in ("auto", "on"))
    pd.testing.assert_frame_equal(auto[0], forced[0])
    np.testing.assert_array_equal(auto[1], forced[1])
    np.testing.assert_array_equal(auto[2], forced[2])
    assert not forced[4]["on"]


def test_grains_grown_together_are_cemented_though_the_packing_met_its_aim():
    """Scaling aims at the porosity before the rims, and rims fill what lies between it and the target."""
    grown = {"on": True, "called_for": True, "reason": "grown together", "porosity": PLAIN}
    poured_right = {"called_for": False, "on": False, "too_loose": False}
    _, phase, _, scaling, rims = finished(0.868, poured_right, grown)
    assert scaling["target"] == PLAIN
    assert rims["on"]
    assert rims["reason"].startswith("grown together: rims of")
    assert abs(np.count_nonzero(phase == 0) - 0.868 * phase.size) <= 1
    assert rims["share"] == pytest.approx(scaling["after"]["porosity"] - 0.868, abs=1e-5)
    assert not finished(0.868, poured_right, grown, cement="off")[4]["on"]


@pytest.mark.parametrize("rim", [2, 3, 4])
def test_fill_is_found_by_the_surface_that_spheres_lose_where_they_meet(rim):
    """Spheres on a cubic lattice that touch in points, grown by rims: flat where they meet."""
    touching, grown = 16, 16 + rim
    cap = grown - touching
    solid = 4 / 3 * np.pi * grown**3 - 6 * np.pi * cap**2 * (3 * grown - cap) / 3
    surface = 4 * np.pi * grown**2 - 6 * 2 * np.pi * grown * cap
    before = 4 / 3 * np.pi * touching**3
    growth, filled = (solid / before) ** (1 / 3), (solid - before) / ((2 * touching) ** 3 - before)
    found = volume.fill_to_surface(lattice_of("simple", 64), 1 / 2, growth * surface / solid * 2)
    assert found == pytest.approx(filled, rel=0.1)


def test_only_a_rock_denser_than_its_grains_pour_to_is_pressed():
    """Whether the bed came to what was wanted before the rims is chance, and does not matter."""
    rougher = {"section_per_um": np.inf}
    grown = {"on": True, "called_for": True, "reason": "grown together", "porosity": PLAIN, **rougher}
    poured = {"called_for": False, "on": False, "too_loose": False}
    assert not finished(0.75, poured, overgrowth=grown)[4]["compaction"]["on"]
    assert finished(0.75, overgrowth=grown)[4]["compaction"]["on"]
    _, phase, *_, rims = finished(0.75, overgrowth={**grown, "porosity": 0.8})
    assert rims["compaction"]["on"]
    assert abs(np.count_nonzero(phase == 0) - 0.75 * phase.size) <= 1
    kept = finished(0.75, overgrowth={**grown, "porosity": 0.8}, compaction="off")[4]
    assert not kept["compaction"]["on"]
    assert kept["share"] > rims["share"]


def lattice_of(kind, edge):
    """Touching spheres on a cubic lattice, two cells along each edge."""
    at, radius = {
        "simple": ([(0, 0, 0)], 1 / 2),
        "body-centred": ([(0, 0, 0), (0.5, 0.5, 0.5)], np.sqrt(3) / 4),
        "face-centred": ([(0, 0, 0), (0.5, 0.5, 0), (0.5, 0, 0.5), (0, 0.5, 0.5)], np.sqrt(2) / 4),
    }[kind]
    where = 2 * (np.indices((edge,) * 3) + 0.5) / edge
    near = [np.abs((where.T - np.array(p) + 0.5) % 1 - 0.5) for p in at]
    return (np.min([(d**2).sum(axis=-1) for d in near], axis=0) < radius**2).astype(np.uint8)


@pytest.mark.parametrize("left", [0.8, 0.7, 0.6])
def test_beds_lose_the_same_surface_with_the_same_share_of_their_pores(left):
    """So the loose first packing says what rims in a denser one will do."""
    beds = [lattice_of("simple", 96), lattice_of("body-centred", 112), lattice_of("face-centred", 136)]
    assert np.ptp([(bed == 0).mean() for bed in beds]) > 0.2
    filled = np.array(
        [volume.fill_to_surface(bed, 1.0, left * solid_surface(bed, 1.0).per_um) for bed in beds]
    )
    rims = filled * [(bed == 0).mean() / (bed > 0).mean() for bed in beds]  # by the solid
    assert np.ptp(filled) < 0.25 * filled.mean()
    assert np.ptp(rims) > 0.8 * rims.mean()


def test_grains_with_no_more_surface_than_wanted_do_not_grow():
    bed = volume.voxelise(lattice()[0], LIBRARY, (64, 64, 64), 1.0)[0]
    assert volume.fill_to_surface(bed, 1.0, 0.31) == 0.0
    assert volume.fill_to_surface(np.zeros_like(bed), 1.0, 0.1) == 0.0
    assert volume.fill_to_surface(np.ones_like(bed), 1.0, -0.1) == 0.0


@given(seed=st.integers(0, 10**6), solid=st.floats(0, 1), per_um=st.floats(0, 10))
@settings(max_examples=60, deadline=None)
def test_some_fill_is_found_in_any_volume(seed, solid, per_um):
    bed = (np.random.default_rng(seed).random((3, 4, 5)) < solid).astype(np.uint8)
    assert 0.0 <= volume.fill_to_surface(bed, 1.0, per_um) <= 0.95


def test_a_section_shows_rims_as_the_grains_mineral():
    bodies, phase, body, *_ = finished(0.6)
    seen = volume.as_minerals(phase, body, bodies)
    np.testing.assert_array_equal(seen > 0, phase > 0)
    np.testing.assert_array_equal(seen[phase < CEMENT], phase[phase < CEMENT])
    mineral = bodies.set_index("id")["phase"]
    rim = phase == CEMENT
    np.testing.assert_array_equal(seen[rim], mineral.loc[body[rim] - 1])


def test_room_is_made_so_that_cemented_grains_have_the_sizes_of_the_section():
    """A lattice of balls far beyond the region: shrunk and cemented, a ball with its rim is as it was."""
    at = 32 * (np.arange(-2, 4) + 0.5)
    x, y, z = (c.ravel() for c in np.meshgrid(at, at, at, indexing="ij"))
    first, _ = lattice()
    bodies = pd.concat([first.iloc[[0]]] * x.size, ignore_index=True).assign(
        id=np.arange(x.size), x=x, y=y, z=z
    )
    scene = {**SCENE, "margin_um": 64.0, "porosity_target": 0.6}
    shrunk, factor = volume.make_room(bodies, scene, PLAIN)
    assert factor == pytest.approx(((1 - PLAIN) / 0.4) ** (1 / 3))
    # grains in a volume: as many as the solid holds grains of the size before
    spacing = np.sort(np.unique(shrunk["x"].round(6)))
    assert np.diff(spacing) == pytest.approx(32 * factor)
    assert 0.4 * (32 * factor) ** 3 == pytest.approx(4 / 3 * np.pi * 10**3)
    assert shrunk["scale"].to_numpy() == pytest.approx(factor * bodies["scale"].to_numpy())
    # a bed that hardly reaches beyond the region keeps covering it
    _, factor = volume.make_room(bodies, {**scene, "margin_um": 12.0}, PLAIN)
    assert factor == pytest.approx((32 + 10) / (32 + 12))
    assert volume.make_room(bodies, {**scene, "margin_um": 0.0}, PLAIN)[1] == 1.0


def test_rims_do_not_depend_on_the_unit_of_length():
    """A voxel of half a micrometre: rims half as thick, in the same voxels; from grains outside, too."""
    bodies, shape = lattice()
    beyond = bodies.assign(z=bodies["z"] + 21.0)
    half = beyond.assign(**{c: beyond[c] / 2 for c in ("x", "y", "z", "scale")})
    one, other = (volume.cement(b, LIBRARY, shape, h, 0.6, CEMENT) for b, h in ((beyond, 1.0), (half, 0.5)))
    np.testing.assert_array_equal(one[0], other[0])
    np.testing.assert_array_equal(one[1], other[1])
    assert other[2]["rim_um"] == pytest.approx(one[2]["rim_um"] / 2)


def test_room_is_made_about_the_middle_of_any_region():
    """A region of 16 x 32 x 64 um in voxels of half a micrometre: what lies in its middle stays there."""
    bodies, _ = lattice()
    scene = {
        **SCENE,
        "shape_zyx": [128, 64, 32],
        "voxel_size_um": 0.5,
        "margin_um": 64.0,
        "porosity_target": 0.6,
    }
    middle = bodies.iloc[[0]].assign(x=8.0, y=16.0, z=32.0)
    shrunk, factor = volume.make_room(middle, scene, PLAIN)
    assert factor < 0.9
    assert shrunk[["x", "y", "z"]].to_numpy().tolist() == [[8.0, 16.0, 32.0]]
    # and the bed keeps covering it along its shortest edge
    _, factor = volume.make_room(middle, {**scene, "margin_um": 12.0}, PLAIN)
    assert factor == pytest.approx((32 + 10) / (32 + 12))


def test_scaling_mends_no_more_than_its_limit():
    """The lattice is 0.012 above what is aimed at: rims, not positions."""
    scaling = finished(PLAIN - 0.013)[3]
    assert not scaling["applied"]
    assert "not reachable" in scaling["reason"]


@pytest.mark.parametrize("less", [0.01, 0.02, 0.03])
def test_what_lies_farther_out_changes_no_rim(less):
    """Spheres that the region's face cuts, rims of a voxel: the same with as much around as one likes."""
    bodies, shape = lattice(spacing=22.0)
    bodies = bodies.assign(z=bodies["z"] + 9.0)
    around = volume.voxelise(bodies, LIBRARY, tuple(n + 16 for n in shape), 1.0, (-8.0,) * 3)
    target = volume.porosity(around[0][8:-8, 8:-8, 8:-8]) - less
    phase, _, report = volume.cement(bodies, LIBRARY, shape, 1.0, target, CEMENT)
    expected, _, rim = volume.grow_rims(*around, target, CEMENT, 8)
    np.testing.assert_array_equal(phase, expected)
    assert report["rim_um"] == rim
