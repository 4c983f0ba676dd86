"""Sizes, shapes and weights of grains and pores against analytic shapes."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt, gaussian_filter

from grainfall.errors import InputError
from grainfall.morphology import (
    grain_masks,
    inscribed_circles,
    intergranular,
    measure_grains,
    solid_radius,
    split_grains,
    split_pores,
)


def ellipse(shape, centre, axes, angle):
    """Ellipse with its first axis at `angle` from x towards y, by pixel centres."""
    y, x = np.indices(shape) + 0.5
    u = (x - centre[1]) * np.cos(angle) + (y - centre[0]) * np.sin(angle)
    v = -(x - centre[1]) * np.sin(angle) + (y - centre[0]) * np.cos(angle)
    return ((u / axes[0]) ** 2 + (v / axes[1]) ** 2 < 1).astype(np.uint8)


@settings(max_examples=25, deadline=None)
@given(st.floats(30, 60), st.floats(0, 1), st.floats(0, 1), st.floats(0.1, 20))
def test_discs_have_their_radius(radius, dy, dx, pixel):
    """To 1 %, however unluckily they lie on the grid; a circle's digitisation alone takes up to 0.26 px."""
    edge = int(2 * radius) + 8
    disc = ellipse((edge, edge), (edge / 2 + dy, edge / 2 + dx), (radius, radius), 0)
    grain = measure_grains(split_grains(disc), disc, pixel).iloc[0]
    assert grain.r_um == pytest.approx(radius * pixel, rel=0.01)
    assert grain.y_um == pytest.approx((edge / 2 + dy) * pixel, abs=0.2 * pixel)
    assert grain.x_um == pytest.approx((edge / 2 + dx) * pixel, abs=0.2 * pixel)
    assert grain.aspect_ratio == pytest.approx(1, abs=0.03)
    assert grain.circularity == pytest.approx(1, abs=0.06)
    assert not grain.border
    circle = inscribed_circles(split_pores(1 - disc), pixel).iloc[0]
    assert circle.r_um == pytest.approx(radius * pixel, rel=0.01)
    assert circle.y_um == pytest.approx((edge / 2 + dy) * pixel, abs=0.3 * pixel)
    assert circle.x_um == pytest.approx((edge / 2 + dx) * pixel, abs=0.3 * pixel)


@pytest.mark.parametrize("radius", [8, 13, 30])
def test_small_discs_have_their_radius_on_average(radius):
    """A grid of pixels knows one small disc to a few per cent only; their mean is true to 1 %.

    The mean of circles is true to 0.15 pixel, which is more than 1 % for the smallest.
    """
    rng = np.random.default_rng(radius)
    grain, circle = [], []
    for _ in range(40):
        true = radius + rng.uniform(-0.5, 0.5)
        disc = ellipse((2 * radius + 8,) * 2, radius + 4 + rng.uniform(0, 1, 2), (true, true), 0)
        grain.append(measure_grains(split_grains(disc), disc, 1.0).r_um[0] / true)
        circle.append(inscribed_circles(split_pores(1 - disc), 1.0).r_um[0] / true)
    assert np.mean(grain) == pytest.approx(1, abs=0.01)
    assert np.mean(circle) == pytest.approx(1, abs=max(0.01, 0.15 / radius))


@pytest.mark.parametrize("angle", [-1.2, -0.4, 0.0, 0.7, np.pi / 2])
def test_an_ellipse_has_its_axes_and_direction(angle):
    image = ellipse((140, 140), (70.2, 69.7), (60, 30), angle)
    grain = measure_grains(image.astype(int), image, 2.0).iloc[0]
    assert grain.aspect_ratio == pytest.approx(2, rel=0.01)
    turn = (grain.orientation_rad - angle + np.pi / 2) % np.pi - np.pi / 2
    assert turn == pytest.approx(0, abs=0.01)
    assert -np.pi / 2 < grain.orientation_rad <= np.pi / 2
    extent = 2 * np.hypot(60 * np.cos(angle), 30 * np.sin(angle))
    assert grain.width_um == pytest.approx(2 * extent, abs=4)


@pytest.mark.parametrize("walls", [2, 3])
@pytest.mark.parametrize("radius", [5, 9, 17])
def test_circles_between_flat_walls_are_unbiased_to_a_fifth_of_a_pixel(walls, radius):
    """Channels and triangles at random angles: the true radius, on average, though only pixels are seen."""
    rng = np.random.default_rng(walls)
    error = []
    for _ in range(40):
        true, turn = radius + rng.uniform(-0.5, 0.5), rng.uniform(0, np.pi)
        y, x = np.indices((5 * radius, 5 * radius)) - 2.5 * radius + rng.uniform(0, 1, (2, 1, 1))
        inside = np.hypot(y, x) < 2.4 * radius
        for k in range(walls):
            normal = turn + k * 2 * np.pi / walls
            inside &= x * np.cos(normal) + y * np.sin(normal) < true
        error.append(inscribed_circles(inside.astype(np.int32), 1.0).r_um[0] - true)
    assert np.mean(error) == pytest.approx(0, abs=0.2)
    assert np.max(np.abs(error)) < 0.7


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_circles_hold_no_solid_and_fill_their_pores(seed):
    """No solid pixel centre inside; and at most the half gap, under one pixel, is left."""
    noise = np.random.default_rng(seed).normal(size=(50, 50))
    phase = (gaussian_filter(noise, 3, mode="wrap") > 0).astype(np.uint8)
    labels = split_pores(phase, min_radius_px=0)
    solid = np.argwhere(labels == 0) + 0.5
    distance = distance_transform_edt(labels > 0)
    for circle in inscribed_circles(labels, 1.0).itertuples():
        clear = np.sqrt(((solid - [circle.y_um, circle.x_um]) ** 2).sum(1)).min()
        assert clear - 0.8 < circle.r_um <= clear
        assert clear >= distance[labels == circle.pore].max() - 1e-9


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_circles_of_a_turned_image_are_the_same_circles(seed):
    """Of a pore with several equally deep pixels, as a channel has, it does not matter which comes first."""
    noise = np.random.default_rng(seed).normal(size=(240, 180))
    labels = split_pores((gaussian_filter(noise, 3, mode="wrap") > 0).astype(np.uint8))
    as_is = inscribed_circles(labels, 1.0)
    for turned in (labels[::-1], labels[:, ::-1], labels.T):
        again = inscribed_circles(turned, 1.0)
        assert again.pore.tolist() == as_is.pore.tolist()
        # Two circles of one size may leave unequal gaps to the walls.
        assert (np.abs(again.r_um - as_is.r_um) > 0.1).mean() < 0.1
        assert again.r_um.mean() == pytest.approx(as_is.r_um.mean(), rel=0.005)


def test_border_grains_weigh_nothing_and_give_no_mask():
    labels = np.zeros((60, 50), np.int32)
    labels[0:9, 5:15], labels[20:30, 0:8], labels[50:60, 20:30], labels[20:30, 45:50] = 1, 2, 3, 4
    labels[12:18, 12:24], labels[35:48, 30:34] = 5, 6
    table = measure_grains(labels, (labels > 0).astype(np.uint8), 3.0)
    assert table.border.tolist() == [True] * 4 + [False] * 2
    assert (table.weight[:4] == 0).all()
    free = np.array([(49 - 12) * (59 - 6), (49 - 4) * (59 - 13)])
    assert np.allclose(table.weight[4:], 50 * 60 / free)
    masks = grain_masks(labels, table)
    assert [m.shape for m in masks] == [(8, 14), (15, 6)]
    assert [m.sum() * 9 for m in masks] == table.area_um2[4:].tolist()
    assert not any(m[0].any() or m[-1].any() or m[:, 0].any() or m[:, -1].any() for m in masks)


def test_grey_and_phase_go_with_the_grain():
    labels = np.zeros((20, 30), np.int32)
    labels[3:9, 3:12], labels[3:9, 12:20] = 4, 2
    phase = np.where(labels == 4, 2, np.where(labels == 2, 1, 0)).astype(np.uint8)
    grey = np.where(labels == 4, 90, 30).astype(np.uint8)
    table = measure_grains(labels, phase, 1.0, grey).set_index("grain")
    assert table.phase.to_dict() == {2: 1, 4: 2}
    assert table.mean_grey.to_dict() == {2: 30, 4: 90}


def test_nothing_to_measure():
    empty = np.zeros((8, 8), np.int32)
    assert measure_grains(empty, empty.astype(np.uint8), 1.0).empty
    assert inscribed_circles(empty, 1.0).empty
    assert grain_masks(empty, measure_grains(empty, empty.astype(np.uint8), 1.0)) == []
    whole = inscribed_circles(empty + 1, 1.0)
    assert whole.border.all()
    assert (whole.weight == 0).all()


@pytest.mark.parametrize("pixel", [0, -1, np.nan])
def test_a_pixel_needs_a_size(pixel):
    one = np.ones((3, 3), np.int32)
    with pytest.raises(InputError, match="pixel_size_um"):
        measure_grains(one, one.astype(np.uint8), pixel)
    with pytest.raises(InputError, match="pixel_size_um"):
        inscribed_circles(one, pixel)


def hard_discs(rng, cells, cell, radii):
    """One disc of either radius, at random, anywhere within every cell of a grid with a random origin."""
    y, x = np.indices((cells * cell, cells * cell)) + 0.5
    image = np.zeros(y.shape, np.uint8)
    for i in range(cells):
        for j in range(cells):
            r = radii[rng.integers(2)]
            cy, cx = (np.array([i, j]) * cell) + rng.uniform(r, cell - r, 2)
            part = np.s_[i * cell : (i + 1) * cell, j * cell : (j + 1) * cell]
            image[part] |= ((y[part] - cy) ** 2 + (x[part] - cx) ** 2 < r * r).astype(np.uint8)
    return image


def test_weighted_sizes_are_unbiased_where_the_naive_are_not():
    """Small and large discs are equally many; a small frame cuts the large ones more often.

    A disc of radius r is whole in a frame L with a probability in proportion to (L − 2r)², so the naive share
    of large discs tends to (L − 2R)² / ((L − 2R)² + (L − 2r)²), the weighted one to ½.
    """
    rng = np.random.default_rng(5)
    small, large, cell, frame = 4, 14, 32, 100
    tables = []
    for _ in range(150):
        image = hard_discs(rng, 5, cell, (small, large))
        y, x = rng.integers(0, cell, 2)
        window = image[y : y + frame, x : x + frame]
        tables.append(measure_grains(split_grains(window), window, 1.0))
    table = pd.concat(tables, keys=range(len(tables)), names=["frame", None]).reset_index("frame")
    table["large"] = table.r_um > (small + large) / 2
    table = table[~table.border]

    def share(column):
        """Weighted share of large discs, and its standard error over frames."""
        sums = pd.DataFrame({"of": table.large * column, "all": column}).groupby(table.frame).sum()
        value = sums["of"].sum() / sums["all"].sum()
        spread = (sums["of"] - value * sums["all"]).std() * np.sqrt(len(sums)) / sums["all"].sum()
        return value, spread

    naive, naive_error = share(1.0 + 0 * table.weight)
    weighted, weighted_error = share(table.weight)
    expected = (frame - 2 * large) ** 2 / ((frame - 2 * large) ** 2 + (frame - 2 * small) ** 2)
    assert naive == pytest.approx(expected, abs=3 * naive_error)
    assert weighted == pytest.approx(0.5, abs=3 * weighted_error)
    assert abs(naive - 0.5) > 5 * naive_error
    per_frame = table.weight.groupby(table.frame).sum()
    discs = (frame / cell) ** 2  # one in every cell
    assert per_frame.mean() == pytest.approx(discs, abs=3 * per_frame.std() / np.sqrt(len(per_frame)))


@pytest.mark.parametrize("side", [6, 40, 50])
def test_weights_make_up_for_what_a_frame_cuts(side):
    """A square that passes through a frame: its weights add up to all places that a point of it can take."""
    wide, high, step = 60, 80, 0.5
    found = 0.0
    for x in np.arange(step / 2 - side, wide + side, step):
        image = np.zeros((high, wide), np.int32)
        image[10 : 10 + side, np.abs(np.arange(wide) + 0.5 - x) < side / 2] = 1
        if image.any():
            table = measure_grains(image, image.astype(np.uint8), 1.0)
            found += table.weight[0] * (high - 1 - side) / high * step
    assert found == pytest.approx(wide, rel=0.01)


def test_pore_circles_of_small_windows_are_those_of_the_whole():
    """A Boolean model of discs: weighted circles in windows of 5 radii have the mean of the whole image.

    The circle is the counted object: were it the pore, which runs on and on, large circles would be lost.
    """
    rng = np.random.default_rng(2)
    size, window = 1500, 150
    phase = np.zeros((size, size), np.uint8)
    for _ in range(int(0.9 * size**2 / (np.pi * 20**2))):
        r = rng.uniform(10, 28)
        cy, cx = rng.uniform(0, size, 2)
        part = tuple(slice(max(int(c - r), 0), int(c + r) + 2) for c in (cy, cx))
        y, x = np.mgrid[part][:, : phase[part].shape[0], : phase[part].shape[1]] + 0.5
        phase[part] |= (y - cy) ** 2 + (x - cx) ** 2 < r * r
    whole = inscribed_circles(split_pores(phase), 1.0)
    tables = [
        inscribed_circles(split_pores(phase[i : i + window, j : j + window]), 1.0)
        for i in range(0, size, window)
        for j in range(0, size, window)
    ]
    parts = pd.concat(tables)
    parts = parts[~parts.border]
    expected = np.average(whole.r_um, weights=whole.weight)
    error = 3 * parts.r_um.std() / np.sqrt(len(parts))
    assert np.average(parts.r_um, weights=parts.weight) == pytest.approx(expected, abs=error)
    assert parts.r_um.mean() < expected - 2 * error


# ---- between voids


def punched(period, discs, radius, edge=400):
    """Stripes of pore, every ``period``-th row, in solid, with round voids in it."""
    pore = np.zeros((edge, edge), bool)
    pore[::period] = True
    y, x = np.indices(pore.shape)
    void = np.zeros_like(pore)
    for cy, cx in discs:
        void |= (y - cy) ** 2 + (x - cx) ** 2 <= radius**2
    return pore | void, void


@pytest.mark.parametrize("period", [4, 8])
def test_porosity_between_voids_does_not_see_them(period):
    """Between the voids it is 1 / period whatever they take, and the two make up the porosity."""
    discs = [(90.0, 120.0), (150.0, 300.0), (290.0, 200.0)]
    image, void = punched(period, discs, 40.0)
    bare, _ = punched(period, [], 40.0)
    found, plain = (intergranular([one], 0.5, 10.0) for one in (image, bare))
    inside = np.s_[40:-40, 40:-40]
    assert plain.voids == 0
    assert plain.porosity == pytest.approx(bare[inside].mean())
    assert found.voids == pytest.approx(void[inside].mean(), abs=0.003)
    assert found.porosity == pytest.approx(1 / period, abs=0.005)
    assert image[inside].mean() == pytest.approx(found.voids + (1 - found.voids) * found.porosity)
    assert found.radius_um == 10.0


def test_several_images_make_one_mean_and_a_small_one_tells_nothing():
    images = [punched(period, [], 1.0)[0] for period in (4, 8)]
    assert intergranular(images, 1.0, 10.0).porosity == pytest.approx(3 / 16, abs=0.005)
    assert intergranular([images[0][:45]], 1.0, 10.0) is None
    assert intergranular([np.ones((99, 99), bool)], 1.0, 10.0) is None
    assert intergranular(images, 1.0, 2.9) is None
    assert intergranular(images, 1.0, 0.0) is None


def test_error_between_voids_is_that_of_repeated_sections():
    """Cells of a random pattern are independent: their scatter tells that of whole images."""
    rng = np.random.default_rng(5)
    found = [
        intergranular([gaussian_filter(rng.random((200, 200)), 1.0) > 0.54], 1.0, 8.0) for _ in range(40)
    ]
    scatter = np.std([one.porosity for one in found], ddof=1)
    assert np.mean([one.error for one in found]) == pytest.approx(scatter, rel=0.35)


def test_the_mean_point_of_the_solid_lies_in_a_large_grain():
    grains = pd.DataFrame({"r_um": [1.0, 3.0], "weight": [9.0, 1.0]})
    assert solid_radius(grains) == pytest.approx(2.0)
    assert solid_radius(grains.assign(weight=0.0)) == 0


@pytest.mark.parametrize(("high", "wide"), [(1, 20), (20, 1), (2, 9), (7, 7)])
def test_a_rectangle_has_the_ratio_of_its_edges_and_fills_its_hull(high, wide):
    labels = np.zeros((30, 30), np.int32)
    labels[4 : 4 + high, 3 : 3 + wide] = 1
    grain = measure_grains(labels, labels.astype(np.uint8), 2.0).iloc[0]
    assert grain.aspect_ratio == pytest.approx(max(high, wide) / min(high, wide))
    assert grain.solidity == pytest.approx(1)


def test_solidity_is_the_share_of_the_hull():
    labels = np.zeros((50, 50), np.int32)
    labels[5:45, 5:45] = 1
    labels[5:25, 5:25] = 0  # an L of three squares: its hull has half a square more
    grain = measure_grains(labels, labels.astype(np.uint8), 1.0).iloc[0]
    assert grain.solidity == pytest.approx(3 / 3.5, rel=0.02)


@pytest.mark.parametrize("turns", range(4))
def test_a_circle_that_an_edge_cuts_counts_nothing(turns):
    """Of an image that is no square, whichever edge it is; the whole one stands for more than itself."""
    y, x = np.indices((40, 90)) + 0.5
    whole, cut = (y - 20) ** 2 + (x - 70) ** 2 < 64, (y - 20) ** 2 + x**2 < 64
    labels = np.rot90(whole + 2 * cut, turns)
    table = inscribed_circles(labels, 2.0).set_index("pore")
    assert table.border.to_dict() == {1: False, 2: True}
    width = table.width_um[1] / 2
    assert table.weight.to_dict() == pytest.approx({1: 40 * 90 / (40 - width) / (90 - width), 2: 0})
    assert table.area_um2.to_dict() == {1: 4 * whole.sum(), 2: 4 * cut.sum()}
