"""Pore networks slab by slab: whatever the slabs, what comes of the whole volume."""

from itertools import pairwise

import edt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from test_network import shapes

from grainfall import network, volume
from grainfall.errors import InputError
from grainfall.network import distance, slabs


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


# ---- the network


def assert_equal(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    """To the last bit."""
    assert list(found) == list(expected)
    for name, values in expected.items():
        assert found[name].dtype == values.dtype, name
        assert np.array_equal(found[name], values), name


def by_planes(pore: np.ndarray, cuts: list[int]) -> list[slabs.Slab]:
    return [slabs.Slab(pore.shape, lo, hi) for lo, hi in pairwise([0, *cuts, len(pore)])]


def evenly(pore: np.ndarray, count: int) -> list[slabs.Slab]:
    """As many slabs of however few planes, and no more than planes."""
    count = min(count, len(pore))
    return by_planes(pore, [len(pore) * i // count for i in range(1, count)])


def steps(pore: np.ndarray, count: int) -> tuple[list[slabs.Slab], list, list, list]:
    """Slabs, what grows in each, what is joined, and what throats are made of."""
    parts = evenly(pore, count)
    squared = edt.edtsq(pore, black_border=False).astype(np.uint16)
    grown = [slabs.grow_basins(squared[slice(*part.window)], part) for part in parts]
    joined = slabs.join_slabs([graph for _, graph in grown])
    pieces = [slabs.find_throat_parts(grown[i][0], joined[i]) for i in range(len(parts))]
    return parts, grown, joined, pieces


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10**6),
    st.tuples(st.integers(1, 24), st.integers(1, 16), st.integers(1, 16)),
    st.floats(0.05, 0.97),
    st.sampled_from([0, 0.6, 1, 1.5, 2.5]),
    st.sets(st.integers(1, 23)),
    st.sampled_from([0, 0.1, 0.5, 0.9]),
)
def test_whatever_the_slabs_the_network_is_that_of_the_volume(seed, shape, porosity, blur, cuts, persistence):
    pore = medium(seed, shape, porosity, blur)
    whole = network.extract(pore, 2.0, persistence=persistence)
    parts = by_planes(pore, sorted(c for c in cuts if c < len(pore)))
    assert_equal(slabs.extract_slabs(pore, 2.0, parts, persistence=persistence), whole)


@pytest.mark.parametrize("porosity", [0.15, 0.35, 0.6, 0.9])
@pytest.mark.parametrize("count", [2, 7])
def test_networks_of_random_media(porosity, count):
    pore = medium(5, (61, 50, 47), porosity, 2.0)
    whole = network.extract(pore, 3.0)
    assert len(whole["throat.conns"]) > 100
    assert_equal(slabs.extract_slabs(pore, 3.0, slabs.cut(pore.shape, count)), whole)


@pytest.mark.parametrize("name", shapes())
@pytest.mark.parametrize("axis", [0, 1])
def test_networks_of_known_shapes(name, axis):
    pore = np.ascontiguousarray(np.swapaxes(shapes()[name][0], 0, axis))
    whole = network.extract(pore, 1.0)
    for count in (2, 5, len(pore)):
        found = slabs.extract_slabs(pore, 1.0, evenly(pore, count))
        assert_equal(found, whole)
    assert network.betti_numbers(found) == network.pore_betti_numbers(pore)[:2]


@pytest.mark.parametrize("along", [0, 1, 2])
def test_ways_that_cross_many_slabs(along):
    # a duct that widens steadily has one maximum at its end, and ways up as long as itself, through all slabs
    size = [9, 9, 9]
    size[along] = 60
    z, y, x = np.indices(size)
    place = (z, y, x)[along]
    across = [i for i in range(3) if i != along]
    away = np.maximum(*(abs((z, y, x)[i] - 4) for i in across))
    straight = away < 1 + place / 20
    snake = np.zeros((60, 9, 17), bool)  # up, over, and down again: ways that come back
    snake[:55, 2:7, 2:6] = snake[:58, 2:7, 10:15] = snake[50:58, 2:7, 2:15] = True
    for pore in (straight, snake, snake[::-1].copy()):
        whole = network.extract(pore, 1.0)
        for count in (2, 9, 60):
            assert_equal(slabs.extract_slabs(pore, 1.0, evenly(pore, count)), whole)


@pytest.mark.parametrize("fill", [False, True])
@pytest.mark.parametrize("shape", [(1, 1, 1), (6, 7, 8)])
def test_nothing_to_partition(fill, shape, tmp_path):
    pore = np.full(shape, fill)
    assert_equal(slabs.extract_slabs(pore, 1.0, slabs.cut(shape, 3)), network.extract(pore, 1.0))


def test_some_slabs_are_all_pore_or_all_solid():
    pore = medium(2, (40, 20, 20), 0.4, 1.5)
    pore[8:16], pore[24:32] = True, False
    assert_equal(slabs.extract_slabs(pore, 1.0, evenly(pore, 5)), network.extract(pore, 1.0))


def test_equal_networks_are_equal_files(tmp_path):
    pore = medium(3, (40, 30, 30), 0.4, 1.5)
    network.save(network.extract(pore, 2.5), tmp_path / "p1.csv", tmp_path / "t1.csv")
    network.save(
        slabs.extract_slabs(pore, 2.5, slabs.cut(pore.shape, 4)), tmp_path / "p4.csv", tmp_path / "t4.csv"
    )
    for kind in "pt":
        assert (tmp_path / f"{kind}4.csv").read_bytes() == (tmp_path / f"{kind}1.csv").read_bytes()


@pytest.mark.parametrize("count", [2, 5, 30])
def test_labels_and_trees_are_those_of_the_volume(count):
    pore = medium(4, (30, 24, 26), 0.5, 1.5)
    whole = network.partition(pore)
    parts, grown, joined, pieces = steps(pore, count)
    plane = parts[0].plane
    for part, (field, _), known, (found, graph) in zip(parts, grown, joined, pieces, strict=True):
        planes = slice(part.start, part.stop)
        numbers = np.concatenate([[0], graph["pores"]])
        assert np.array_equal(numbers[found["labels"][part.own]], whole.labels[planes])
        assert np.array_equal(field["tree"][part.own], whole.tree[planes])
        assert known["number"].max() <= whole.peaks.size
        assert (known["joined"] // 3 // plane >= part.start).all()


def test_a_slab_hands_on_less_than_its_voxels():
    pore = medium(6, (120, 40, 40), 0.35, 2.0)
    _, grown, _, pieces = steps(pore, 3)
    asked, known = slabs.glue_slabs([graph for _, graph in pieces])
    for given_on in (*(graph for _, graph in grown), *(graph for _, graph in pieces), *asked, known):
        for name, values in given_on.items():
            assert values.size < 4 * 40 * 40, (
                name
            )  # a slab has forty planes; rinds have one or two of the sides


def test_slabs_are_cut_evenly_and_empty_ones_come_last():
    assert [(s.start, s.stop) for s in slabs.cut((18, 3, 3), 4)] == [(0, 4), (4, 9), (9, 13), (13, 18)]
    assert [s.window for s in slabs.cut((18, 3, 3), 4)] == [(0, 8), (1, 13), (6, 17), (10, 18)]
    assert [len(s) for s in slabs.cut((11, 3, 3), 4)] == [5, 6, 0, 0]
    assert [len(s) for s in slabs.cut((1, 3, 3), 2)] == [1, 0]
    for nz in range(1, 40):
        parts = slabs.cut((nz, 1, 1), 7)
        for i, part in enumerate(parts):
            near = parts[max(i - 1, 0) : i + 2]  # neighbours are enough
            planes = slabs.window_of(part, ((s, np.arange(s.start, s.stop)) for s in near))
            assert planes.tolist() == list(range(*part.window))


def test_more_slabs_than_planes_allow():
    pore = medium(8, (10, 20, 20), 0.4, 1.5)
    assert_equal(slabs.extract_slabs(pore, 1.0, slabs.cut(pore.shape, 5)), network.extract(pore, 1.0))


@pytest.mark.parametrize("coarsen", [1, 2, 3])
def test_slabs_are_read_as_the_volume_is(coarsen):
    phase = (~medium(9, (43, 21, 25), 0.5, 1.0)).astype(np.uint8)
    pore, _ = volume.coarsen(phase == 0, 1.0, coarsen)
    for parts in (1, 3, 9):
        read = [slabs.read_slab(phase, part, parts, coarsen) for part in range(1, parts + 1)]
        assert np.array_equal(np.concatenate([planes for planes, _ in read]), pore)
        assert [slab for _, slab in read] == slabs.cut(pore.shape, parts)
    with pytest.raises(InputError, match="coarsen"):
        slabs.read_slab(phase, 9, 9, 22)
