"""Contacts: crystals, pairs with known gaps, exact penetration of convex hulls, a published sphere pack."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from grainfall import contacts
from grainfall.grains import Library
from grainfall.packing import Parameters

pytest.importorskip("fcl")

CUBE = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, -1).T


def library(*vertices: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(vertices=list(vertices))


def bodies(
    position, scale=1.0, shape=-1, quaternion=(1.0, 0.0, 0.0, 0.0), kind="grain", phase=1
) -> pd.DataFrame:
    """A bodies table; everything but the positions (n, 3) broadcasts."""
    position = np.asarray(position, float)
    n = len(position)
    turn = np.broadcast_to(quaternion, (n, 4))
    columns = {"id": np.arange(n), "kind": kind, "phase": phase, "shape": shape, "scale": scale}
    columns |= {a: position[:, i] for i, a in enumerate("xyz")}
    columns |= {f"q{a}": turn[:, i] for i, a in enumerate("wxyz")}
    return pd.DataFrame(columns | {"asleep": True})


def lattice(basis, cells: int, edge: float) -> np.ndarray:
    corners = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    return edge * (corners + np.asarray(basis)).reshape(-1, 3)


FCC = lattice([[0, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5], [0, 0.5, 0.5]], 4, 2 * np.sqrt(2))
SIMPLE_CUBIC = lattice([[0, 0, 0]], 6, 2.0)


@pytest.mark.parametrize(("centres", "number"), [(FCC, 12), (SIMPLE_CUBIC, 6)], ids=["fcc", "simple cubic"])
def test_crystals_have_their_coordination(centres, number):
    # a region in the middle, two diameters from the surface of the crystal
    table = bodies(centres - 3.9)
    size = tuple(np.ptp(centres, axis=0) - 2 * 3.9)
    touching = contacts.find_contacts(table, library(), None, 1.0)
    result = contacts.coordination(touching, table, size)
    everything = result.set_index("phase").loc[0]
    assert everything["n_grains"] > 0
    assert everything["coordination"] == number
    assert everything["rattlers"] == 0
    assert contacts.max_overlap(table, library()) == pytest.approx(0, abs=1e-9)
    assert touching["gap_um"].to_numpy() == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("gap", [0.3, 1e-6, -1e-6, -0.2])
def test_two_spheres(gap):
    direction = np.array([1.0, 2.0, -2.0]) / 3
    table = bodies([[5, 5, 5], np.array([5, 5, 5]) + (3 + gap) * direction], scale=[2.0, 1.0])
    pair = contacts.closest_points(table, library(), 1.0).loc[0]
    assert pair["gap_um"] == pytest.approx(gap, abs=1e-9)
    assert pair[["nx", "ny", "nz"]].to_numpy(float) == pytest.approx(direction)
    assert pair[["x", "y", "z"]].to_numpy(float) == pytest.approx(5 + (2 + gap / 2) * direction)
    assert contacts.max_overlap(table, library()) == pytest.approx(max(-gap, 0) / 1.0, abs=1e-9)


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_contact_goes_with_its_grains_however_unequal(factor):
    """Room for rims shrinks a bed about its middle: what touched touches in the shrunk place."""
    centres = np.array([[5, 5, 5], 5 + 4 * np.array([1.0, 2.0, -2.0]) / 3])
    table = bodies(centres, scale=[3.0, 1.0])
    moved = bodies(9 + factor * (centres - 9), scale=[3.0 * factor, factor])
    pair = contacts.find_contacts(moved, library(), None, 1.0, packed=table).loc[0]
    expected = 9 + factor * (5 + 3 * np.array([1.0, 2.0, -2.0]) / 3 - 9)
    assert pair[["x", "y", "z"]].to_numpy(float) == pytest.approx(expected)


@pytest.mark.parametrize("gap", [0.1, 0.0, -0.05])
def test_two_boxes_face_to_face(gap):
    table = bodies([[0, 0, 0], [0.4, 0.3, 4 + gap]], scale=2.0, shape=0)
    pair = contacts.closest_points(table, library(CUBE), 1.0).loc[0]
    assert pair["gap_um"] == pytest.approx(gap, abs=1e-9)
    assert pair[["nx", "ny", "nz"]].to_numpy(float) == pytest.approx([0, 0, 1], abs=1e-3)
    assert pair["z"] == pytest.approx(2 + gap / 2)


@pytest.mark.parametrize("gap", [0.2, -0.2])
def test_sphere_on_a_box(gap):
    table = bodies([[0, 0, 0], [0.3, 3 + gap, -0.2]], scale=[2.0, 1.0], shape=[0, -1])
    pair = contacts.closest_points(table, library(CUBE), 1.0).loc[0]
    assert pair["gap_um"] == pytest.approx(gap, abs=1e-9)
    assert pair[["x", "y", "z"]].to_numpy(float) == pytest.approx([0.3, 2 + gap / 2, -0.2])


def hull(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(rng.integers(6, 30), 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) * rng.uniform(0.6, 1.4, 3)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.floats(0.2, 1.2), st.integers(0, 10**6))
def test_penetration_is_the_depth_in_the_minkowski_difference(seed, distance, turn):
    """The depth of two convex bodies is that of the origin in their difference (Cameron & Culley 1986)."""
    shapes = [hull(seed), hull(seed + 1)]
    turns = Rotation.random(2, rng=np.random.default_rng(turn))
    centres = np.array([[0, 0, 0], [distance, 0, 0]])
    placed = [turns[i].apply(shapes[i]) + centres[i] for i in (0, 1)]
    facets = ConvexHull((placed[1][:, None] - placed[0][None]).reshape(-1, 3)).equations
    expected = facets[:, 3].max()
    pair = contacts.closest_points(
        bodies(centres, shape=[0, 1], quaternion=turns.as_quat(scalar_first=True)), library(*shapes), 1.0
    ).loc[0]
    if expected < 0:
        assert pair["gap_um"] == pytest.approx(expected, abs=1e-6)
        normal = pair[["nx", "ny", "nz"]].to_numpy(float)
        # shifted along the normal by the depth, the two only touch
        assert (placed[0] @ normal).max() - (placed[1] @ normal).min() == pytest.approx(-expected, abs=1e-6)
    else:
        assert pair["gap_um"] >= expected - 1e-6


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6))
@example(227603)  # FCL's GJK stops early: 0.67 in place of 0.50
def test_turning_everything_turns_the_contacts(seed):
    rng = np.random.default_rng(seed)
    shapes = library(hull(seed), CUBE)
    turns = Rotation.random(8, rng=rng)
    centres = rng.uniform(0, 3, (8, 3))
    shape, scale = rng.integers(-1, 2, 8), rng.uniform(0.5, 1.0, 8)
    whole, shift = Rotation.random(rng=rng), rng.normal(size=3)
    first = contacts.closest_points(
        bodies(centres, scale, shape, turns.as_quat(scalar_first=True)), shapes, 0.1
    )
    moved = bodies(whole.apply(centres) + shift, scale, shape, (whole * turns).as_quat(scalar_first=True))
    second = contacts.closest_points(moved, shapes, 0.1)
    gaps = [t.set_index(["a", "b"])["gap_um"] for t in (first, second)]
    assert gaps[1].reindex(gaps[0].index).to_numpy() == pytest.approx(gaps[0].to_numpy(), abs=1e-6)


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 10**6), st.floats(0.1, 3.0))
def test_exact_distances_are_proven_by_their_normals(seed, distance):
    """Apart, the gap is the separation along its normal; overlapping, the depth is that of a facet of the
    Minkowski difference. No other answer passes either."""
    rng = np.random.default_rng(seed)
    a, b = hull(seed), Rotation.random(rng=rng).apply(CUBE * rng.uniform(0.3, 1.0, 3))
    direction = rng.normal(size=3)
    b += distance * direction / np.linalg.norm(direction)
    gap, on_a, on_b = contacts.exact_distance(a, b)
    assert np.linalg.norm(on_b - on_a) == pytest.approx(abs(gap), abs=1e-6)
    inside = ConvexHull((b[:, None] - a[None]).reshape(-1, 3)).equations[:, 3].max()
    if inside < 0:
        assert gap == pytest.approx(inside, abs=1e-6)
    else:
        normal = (on_b - on_a) / gap
        assert (b @ normal).min() - (a @ normal).max() == pytest.approx(gap, abs=1e-6)
    for points, at in ((a, on_a), (b, on_b)):
        assert (ConvexHull(points).equations @ [*at, 1]).max() < 1e-6


def test_virtual_spheres_do_not_exist():
    table = bodies([[0, 0, 0], [1.5, 0, 0], [3.0, 0, 0]], kind=["grain", "virtual", "grain"])
    assert contacts.find_contacts(table, library(), None, 1.0).empty
    assert contacts.max_overlap(table, library()) == 0
    assert (
        contacts.coordination(contacts.find_contacts(table, library(), None, 1.0), table)["n_grains"][0] == 2
    )


def test_overlap_outside_the_region_does_not_count():
    table = bodies([[-10, 0, 0], [-8.5, 0, 0], [5, 5, 5], [6.9, 5, 5]])
    assert contacts.max_overlap(table, library()) == pytest.approx(0.5)
    assert contacts.max_overlap(table, library(), (10, 10, 10)) == pytest.approx(0.1)


def test_rattlers_are_taken_away_until_none_is_left():
    # a clique of four (everyone touches everyone), one grain on two of it, one grain on that one
    clique = [(i, j) for i in range(4) for j in range(i + 1, 4)]
    pairs = [*clique, (0, 4), (1, 4), (4, 5)]
    touching = pd.DataFrame(pairs, columns=["grain_a", "grain_b"])
    table = bodies(np.zeros((6, 3)), phase=[1, 1, 1, 2, 2, 2])
    result = contacts.coordination(touching, table).set_index("phase")
    # grain 4 has three contacts until grain 5 goes
    assert result["n_grains"].to_dict() == {0: 6, 1: 3, 2: 3}
    assert result["coordination"].tolist() == [3, 3, 3]
    assert result["rattlers"].tolist() == pytest.approx([2 / 6, 0, 2 / 3])


def test_contacts_of_the_hulls_that_were_collided():
    """Two round grains at rest on their simplified hulls: no contact of the meshes, one of the hulls."""
    few = Parameters(hull_vertices=24)
    mesh = trimesh.creation.icosphere(3)
    mesh.apply_transform(np.diag([1.0, 1.1, 0.9, 1.0]))
    mesh.apply_scale((4 * np.pi / 3 / mesh.volume) ** (1 / 3))
    round_grain = Library([np.array(mesh.vertices)], [np.array(mesh.faces)], pd.DataFrame({"shape": [0]}))
    hull = contacts.collided(round_grain, [0], few).parts[0][0]
    assert len(hull) == 24
    assert ConvexHull(hull).volume == pytest.approx(mesh.volume)
    table = bodies([[0, 0, 0], [np.ptp(hull[:, 0]), 0, 0]], shape=0)
    between = contacts.closest_points(table, contacts.Hulls({0: (hull,)}), 1.0).loc[0, "gap_um"]
    table.loc[1, "x"] -= between
    assert contacts.find_contacts(table, round_grain, None, 1.0, parameters=few)["gap_um"][
        0
    ] == pytest.approx(0, abs=1e-6)
    meshes = contacts.closest_points(table, round_grain, 1.0).loc[0, "gap_um"]
    assert abs(meshes) > 10 * contacts.TOLERANCE


def test_neighbours_outside_the_region_hold_a_grain_in_place():
    table = bodies(SIMPLE_CUBIC)
    touching = contacts.find_contacts(table, library(), None, 1.0)
    alone = contacts.coordination(touching, bodies(SIMPLE_CUBIC - 3.0), (2.0, 2.0, 2.0)).loc[0]
    assert (alone["n_grains"], alone["coordination"]) == (1, 6)


@pytest.mark.parametrize("n", [0, 1])
def test_no_pairs(n):
    table = bodies(np.zeros((n, 3)))
    touching = contacts.find_contacts(table, library(), None, 1.0)
    assert touching.empty
    assert contacts.max_overlap(table, library()) == 0
    result = contacts.coordination(touching, table).loc[0]
    assert result["n_grains"] == n
    assert np.isnan(result["coordination"])


def test_contacts_of_the_packing_survive_the_porosity_correction():
    table = bodies([[0, 0, 0], [4, 0, 0]], scale=2.0)
    spread = table.assign(x=table["x"] * 1.004 + 1.0)
    assert contacts.find_contacts(spread, library(), None, 1.0).empty
    pair = contacts.find_contacts(spread, library(), None, 1.0, packed=table).loc[0]
    assert pair["gap_um"] == pytest.approx(0, abs=1e-9)
    assert pair["x"] == pytest.approx(spread["x"].mean())


def test_contact_area_of_two_boxes():
    volume = np.zeros((10, 10, 12), np.int32)
    volume[2:8, 2:8, 1:6], volume[3:9, 2:8, 6:11] = 1, 2
    table = bodies([[7.0, 10, 10], [17.0, 10, 12]], scale=1.0, shape=[0, 0])
    box = CUBE * [5.0, 6.0, 6.0]
    pair = contacts.find_contacts(table, library(box), volume, 2.0).loc[0]
    assert pair["area_um2"] == pytest.approx(5 * 6 * 2.0**2)
    assert pair["gap_um"] == pytest.approx(0, abs=1e-9)
    assert np.isnan(pair["force_n"])


def test_area_outside_the_volume_is_unknown_and_inside_it_is_zero_where_no_faces_meet():
    table = bodies([[2, 2, 2], [4, 2, 2], [20, 2, 2], [22, 2, 2]])
    area = contacts.find_contacts(table, library(), np.zeros((6, 6, 6), np.int32), 1.0)["area_um2"]
    assert area[0] == 0
    assert np.isnan(area[1])


def test_published_pack_has_its_coordination_numbers(shared_data):
    """Andra et al. 2013: the pack's own contact numbers are pairs that overlap, tolerance 0."""
    x, y, z, number = np.loadtxt(shared_data / "spherepack" / "andra2013_621.txt").T
    box, radius = np.array([55.185506, 55.404375, 55.540488]), 3.5
    centres = np.stack([x, y, z], axis=1)
    table = bodies(centres, scale=radius)
    touching = contacts.find_contacts(table, library(), None, 1.0, tolerance=0.0)
    degree = np.bincount(touching[["grain_a", "grain_b"]].to_numpy().ravel(), minlength=len(table))
    inner = ((centres > 2 * radius) & (centres < box - 2 * radius)).all(axis=1)
    assert np.count_nonzero(inner) > 200
    assert np.array_equal(degree[inner], number[inner])
    assert 0 < contacts.max_overlap(table, library()) < 0.05


def test_forces_go_to_their_contacts():
    row = bodies([[0, 0, 0], [100, 0, 0], [200, 0, 0]], 50.0)
    forces = pd.DataFrame({"a": [0], "b": [1], "force_n": [2.5]})
    table = contacts.find_contacts(row, library(), None, 1.0, forces=forces)
    assert table["force_n"].tolist() == [2.5, 0.0]
    assert contacts.find_contacts(row, library(), None, 1.0)["force_n"].isna().all()


def test_a_grain_that_leans_on_a_sphere_loses_support_with_it():
    """Grain 0 leans on grains 1, 2 and sphere 3; grain 4 on grains 1, 2, 5 and the sphere."""
    kind = ["grain", "grain", "grain", "virtual", "grain", "grain"]
    packed = pd.DataFrame({"id": range(6), "kind": kind, "x": 1.0, "y": 1.0, "z": 1.0})
    pairs = [(0, 1), (0, 2), (0, 3), (1, 4), (2, 4), (3, 4), (4, 5)]
    forces = pd.DataFrame(pairs, columns=["a", "b"]).assign(force_n=1.0)
    found = contacts.lost_support(forces, packed)
    assert found == {"on_spheres": pytest.approx(2 / 5), "lost_support": pytest.approx(1 / 5)}
    unloaded = forces.assign(force_n=0.0)
    assert contacts.lost_support(unloaded, packed) == {"on_spheres": 0.0, "lost_support": 0.0}
    assert contacts.lost_support(forces, packed[packed["kind"] == "virtual"])["lost_support"] is None


@pytest.mark.parametrize(("gap", "found"), [(0.9e-3, 1), (1.1e-3, 0)])
def test_the_tolerance_is_of_the_mean_diameter(gap, found):
    """Of spheres 2 and 6 um across: of 4 um. A virtual sphere in the packing is no grain of that mean."""
    table = bodies(
        [[0, 0, 0], [4 + 4 * gap, 0, 0], [0, 300, 0]], [1.0, 3.0, 200.0], kind=["grain"] * 2 + ["virtual"]
    )
    grains = table[table["kind"] == "grain"]
    for packed in (None, table):
        assert len(contacts.find_contacts(grains, library(), None, 1.0, packed=packed)) == found


def test_a_contact_lies_in_the_region_by_the_regions_own_edges():
    table = bodies([[9, 2, 1], [11, 2, 1]])
    area = contacts.find_contacts(table, library(), np.zeros((2, 4, 12), np.int32), 1.0)["area_um2"]
    assert area.tolist() == [0]


def test_support_is_lost_by_grains_of_the_region_alone():
    packed = bodies(
        [[1, 1, 1], [1, 9, 1]] + [[5, 5, 5]] * 3, kind=["grain", "grain", "virtual", "virtual", "virtual"]
    )
    forces = pd.DataFrame({"a": [1, 1, 1], "b": [2, 3, 4], "force_n": 1.0})
    assert contacts.lost_support(forces, packed) == {"on_spheres": 0.5, "lost_support": 0.5}
    assert contacts.lost_support(forces, packed, (12, 6, 6)) == {"on_spheres": 0.0, "lost_support": 0.0}
    assert contacts.lost_support(forces, packed, (6, 12, 6)) == {"on_spheres": 0.5, "lost_support": 0.5}


def test_a_grain_that_reaches_into_the_region_overlaps_there():
    table = bodies([[-0.5, 5, 5], [1.3, 5, 5]])
    assert contacts.max_overlap(table, library(), (10, 10, 10)) == pytest.approx(0.2)


def test_minerals_are_counted_in_the_region_too():
    table = bodies(SIMPLE_CUBIC - 3.0, phase=2)
    touching = contacts.find_contacts(table, library(), None, 1.0)
    result = contacts.coordination(touching, table, (2.0, 2.0, 2.0)).set_index("phase")
    assert result["n_grains"].to_dict() == {0: 1, 2: 1}
