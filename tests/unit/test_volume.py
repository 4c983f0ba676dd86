"""Voxelisation, porosity correction, topology, contacts and exports against analytic truths."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from skimage import measure

from grainfall import io, packing, stereology, volume
from grainfall.errors import InputError
from grainfall.grains import VOID
from grainfall.volume import coarsen, measures, read_pore_space


def library_of(*meshes, normalise=True):
    """Meshes as a library holds them: centre of mass at 0, equal-volume radius 1 (or left as they are)."""
    vertices = []
    for mesh in meshes:
        radius = (mesh.volume / (4 / 3 * np.pi)) ** (1 / 3)
        vertices.append((mesh.vertices - mesh.center_mass) / radius if normalise else np.array(mesh.vertices))
    return SimpleNamespace(vertices=vertices, faces=[np.array(m.faces) for m in meshes])


def half_boxes():
    """Two unit cubes that share the face x = 0."""
    boxes = [trimesh.creation.box((1, 1, 1)).apply_translation((shift, 0, 0)) for shift in (-0.5, 0.5)]
    return library_of(*boxes, trimesh.creation.box((2, 1, 1)), normalise=False)


def bodies_of(rows):
    """Bodies table from (shape, scale, (x, y, z)[, quaternion wxyz[, phase, kind]])."""
    table = []
    for i, (shape, scale, xyz, *rest) in enumerate(rows):
        q = rest[0] if rest else (1.0, 0.0, 0.0, 0.0)
        phase, kind = rest[1:] if len(rest) > 1 else (1, "grain")
        table.append((i, kind, phase, shape, scale, *xyz, *q, True))
    columns = ["id", "kind", "phase", "shape", "scale", "x", "y", "z", "qw", "qx", "qy", "qz", "asleep"]
    return pd.DataFrame(table, columns=columns)


def quaternions(n, rng):
    return Rotation.random(n, rng=rng).as_quat()[:, [3, 0, 1, 2]]


def lumpy(rng):
    """A star-shaped, non-convex closed mesh."""
    mesh = trimesh.creation.icosphere(2)
    axes = rng.normal(size=(3, 3))
    mesh.vertices *= (1 + 0.3 * np.sin(3 * mesh.vertices @ axes.T).mean(axis=1))[:, None]
    return mesh


def random_pack(rng, n=40, edge=30.0):
    """Overlapping meshes and spheres, grains and virtual, some beyond the region."""
    library = library_of(lumpy(rng), trimesh.creation.box((1.0, 1.5, 2.0)))
    xyz = rng.uniform(-3, edge + 3, (n, 3))
    q = quaternions(n, rng)
    kinds = ["virtual" if i % 4 == 0 else "grain" for i in range(n)]
    shapes, phases, scales = rng.integers(-1, 2, n), rng.integers(1, 3, n), rng.uniform(2, 5, n)
    rows = zip(shapes, scales, xyz, q, phases, kinds, strict=True)
    return bodies_of(rows), library


def inside(vertices, faces, points):
    """Whether points lie in a closed mesh: winding number from solid angles (van Oosterom-Strackee)."""
    a, b, c = (vertices[faces[:, i]][None] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    det = (a * np.cross(b, c)).sum(-1)
    dot = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.arctan2(det, dot).sum(axis=1) / (2 * np.pi) > 0.5


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.icosphere(3),
        trimesh.creation.box((1.0, 2.0, 3.0)),
        trimesh.creation.icosphere(3).apply_transform(np.diag([1.0, 2.0, 0.5, 1.0])),
    ],
    ids=["sphere", "box", "ellipsoid"],
)
def test_volume_of_rotated_solids_converges(mesh):
    rng = np.random.default_rng(1)
    library = library_of(mesh)
    errors = []
    for n in (16, 64):
        rows = [(0, 0.25, rng.uniform(0.48, 0.52, 3), q) for q in quaternions(6, rng)]
        counts = [
            np.count_nonzero(volume.voxelise(bodies_of([row]), library, (n, n, n), 1 / n)[0]) for row in rows
        ]
        errors.append(np.abs(np.array(counts) / n**3 / (4 / 3 * np.pi * 0.25**3) - 1).mean())
    assert errors[1] < 0.005
    assert errors[1] < errors[0]


def test_mesh_matches_winding_number():
    rng = np.random.default_rng(2)
    library = library_of(lumpy(rng))
    bodies = bodies_of([(0, 4.3, rng.uniform(5, 7, 3), quaternions(1, rng)[0])])
    phase, _ = volume.voxelise(bodies, library, (13, 12, 11), 1.0)
    z, y, x = np.indices(phase.shape) + 0.5
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    turn = Rotation.from_quat(bodies[["qx", "qy", "qz", "qw"]].to_numpy()[0])
    placed = bodies[["x", "y", "z"]].to_numpy() + 4.3 * turn.apply(library.vertices[0])
    expected = inside(placed, library.faces[0], points).reshape(phase.shape)
    assert expected.sum() > 200
    np.testing.assert_array_equal(phase > 0, expected)


def test_sphere_is_analytic():
    bodies = bodies_of([(-1, 3.7, (5.2, 4.9, 6.1))])
    phase, _ = volume.voxelise(bodies, library_of(), (12, 10, 11), 1.0)
    z, y, x = np.indices(phase.shape) + 0.5
    np.testing.assert_array_equal(phase > 0, (x - 5.2) ** 2 + (y - 4.9) ** 2 + (z - 6.1) ** 2 < 3.7**2)


def test_abutting_boxes_tile_where_faces_run_through_voxel_centres():
    """Eight cubes around a point, all faces through voxel centres: every voxel belongs to exactly one."""
    library = library_of(trimesh.creation.box((4, 4, 4)), normalise=False)
    total = np.zeros((12, 12, 12), int)
    for corner in np.ndindex(2, 2, 2):
        centre = 3.5 + 4.0 * np.array(corner)
        phase, _ = volume.voxelise(bodies_of([(0, 1.0, centre)]), library, total.shape, 1.0)
        assert np.count_nonzero(phase) == 64
        total += phase
    assert total.max() == 1


def test_rotated_halves_tile():
    """A box and its two halves at any orientation: the halves' voxels are the whole's, each once."""
    rng = np.random.default_rng(3)
    library = half_boxes()
    for q in quaternions(5, rng):
        xyz = rng.uniform(9, 11, 3)
        left, right, whole = (
            volume.voxelise(bodies_of([(s, 8.0, xyz, q)]), library, (20, 20, 20), 1.0)[0].astype(int)
            for s in range(3)
        )
        np.testing.assert_array_equal(left + right, whole)
        assert min(left.sum(), right.sum()) > 400


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_independent_of_slabs_and_row_order(seed, slab):
    bodies, library = random_pack(np.random.default_rng(seed))
    shape = (30, 28, 26)
    phase, body = volume.voxelise(bodies, library, shape, 1.0)
    again = volume.voxelise(bodies.sample(frac=1, random_state=seed), library, shape, 1.0)
    np.testing.assert_array_equal(again[0], phase)
    np.testing.assert_array_equal(again[1], body)
    slabs = list(volume.voxelise_slabs(bodies, library, shape, 1.0, slab=slab))
    assert [s[0] for s in slabs] == list(range(0, 30, slab))
    np.testing.assert_array_equal(np.concatenate([s[1] for s in slabs]), phase)
    np.testing.assert_array_equal(np.concatenate([s[2] for s in slabs]), body)
    some = list(volume.voxelise_slabs(bodies, library, shape, 1.0, slab=slab, planes=(7, 19)))
    assert [s[0] for s in some] == list(range(7, 19, slab))
    np.testing.assert_array_equal(np.concatenate([s[2] for s in some]), body[7:19])
    assert not list(volume.voxelise_slabs(bodies, library, shape, 1.0, planes=(30, 30)))


def test_translation_by_whole_voxels_commutes():
    bodies, library = random_pack(np.random.default_rng(4))
    # Positions in multiples of 1/64: a move by whole voxels is then exact in floating point.
    bodies[["x", "y", "z"]] = np.round(bodies[["x", "y", "z"]] * 64) / 64
    shape, h = (30, 30, 30), 0.5
    body = volume.voxelise(bodies, library, shape, h)[1]
    moved = volume.voxelise(bodies.assign(x=bodies.x + 1.5, z=bodies.z - 2.5), library, shape, h)[1]
    np.testing.assert_array_equal(moved[:-5, :, 3:], body[5:, :, :-3])
    shifted = volume.voxelise(bodies, library, shape, h, origin_um=(-1.5, 0.0, 2.5))[1]
    np.testing.assert_array_equal(shifted, moved)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.tuples(*[st.integers(4, 12)] * 3), st.integers(0, 3))
def test_porosity_about_is_that_of_moved_regions(seed, shape, reach):
    rng = np.random.default_rng(seed)
    bodies, library = random_pack(rng, n=12, edge=12.0)
    found = volume.porosity_about(bodies, library, shape, 1.0, reach)
    assert found.shape == (2 * reach + 1,) * 3
    for at in [(reach,) * 3, (0, 2 * reach, reach), tuple(rng.integers(0, 2 * reach + 1, 3))]:
        moved = tuple(float(n - reach) for n in at[::-1])
        expected = volume.packed_porosity(packing.move(bodies, moved), library, shape, 1.0)
        assert found[at] == pytest.approx(expected, abs=1e-12)


def test_precedence():
    """Grains before virtual spheres, the lower id first; labels are as the contract says."""
    rows = [
        (-1, 4.0, (5, 5, 5), (1, 0, 0, 0), 1, "virtual"),
        (-1, 4.0, (7, 5, 5), (1, 0, 0, 0), 2, "grain"),
        (-1, 4.0, (9, 5, 5), (1, 0, 0, 0), 3, "grain"),
    ]
    bodies = bodies_of(rows)
    alone = [volume.voxelise(bodies.iloc[[i]], library_of(), (10, 10, 14), 1.0)[0] > 0 for i in range(3)]
    phase, body = volume.voxelise(bodies, library_of(), (10, 10, 14), 1.0)
    np.testing.assert_array_equal(phase == 2, alone[1])
    np.testing.assert_array_equal(phase == 3, alone[2] & ~alone[1])
    np.testing.assert_array_equal(phase == 255, alone[0] & ~alone[1] & ~alone[2])
    np.testing.assert_array_equal(body, np.array([0, 2, 3, 1])[np.searchsorted([0, 2, 3, 255], phase)])


def test_open_mesh_and_bad_tables_are_refused():
    library = library_of(trimesh.creation.icosphere(1))
    bodies = bodies_of([(0, 3.0, (4.9, 5.1, 5.2))])
    library.faces[0] = library.faces[0][1:]
    with pytest.raises(ValueError, match="not closed"):
        volume.voxelise(bodies, library, (40, 40, 40), 0.25)
    with pytest.raises(ValueError, match="not finite"):
        volume.voxelise(bodies.assign(x=np.nan), library, (4, 4, 4), 1.0)
    with pytest.raises(ValueError, match="repeated"):
        volume.voxelise(pd.concat([bodies, bodies]), library, (4, 4, 4), 1.0)
    with pytest.raises(ValueError, match="unknown kind"):
        volume.voxelise(bodies.assign(kind="pebble"), library, (4, 4, 4), 1.0)


def test_bodies_beyond_the_region_leave_it_empty():
    library = library_of(trimesh.creation.box((1, 1, 1)))
    offsets = np.vstack([np.eye(3), -np.eye(3)])
    far = [(s, 3.0, 5.0 + d * o) for s in (0, -1) for o in offsets for d in (7.7, 8.1, 30.0)]
    # A cube of equal-volume radius 3 reaches 2.42 along its axes but 4.2 along its diagonal.
    assert volume.porosity(volume.voxelise(bodies_of(far[:18]), library, (10, 10, 10), 1.0)[0]) == 1.0
    spheres = bodies_of([row for row in far if row[0] == -1 and np.abs(row[2] - 5).max() > 8])
    assert volume.porosity(volume.voxelise(spheres, library, (10, 10, 10), 1.0)[0]) == 1.0


def test_euler_number_of_known_shapes():
    ball = np.zeros((9, 9, 9), bool)
    ball[2:7, 2:7, 2:7] = True
    assert volume.euler_number(ball) == 1
    shell = ball.copy()
    shell[4, 4, 4] = False
    assert volume.euler_number(shell) == 2
    ring = ball.copy()
    ring[:, 4, 4] = False
    assert volume.euler_number(ring) == 0
    assert volume.euler_number(~ball) == 2
    assert volume.euler_number(np.eye(2, dtype=bool)[None]) == 2


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.95))
def test_euler_number_matches_skimage(seed, fraction):
    pore = np.random.default_rng(seed).random((7, 8, 9)) < fraction
    assert volume.euler_number(pore) == measure.euler_number(pore, connectivity=1)


def test_contact_of_rotated_blocks_has_true_area_normal_and_position():
    """Two blocks that share a face: area, normal and centre of the contact at any orientation."""
    rng = np.random.default_rng(5)
    library = half_boxes()
    n, h, edge = 90, 0.5, 18.0
    for q in [np.array([1.0, 0, 0, 0]), *quaternions(6, rng)]:
        xyz = 22 + rng.uniform(-0.3, 0.3, 3)
        _, body = volume.voxelise(bodies_of([(s, edge, xyz, q) for s in (0, 1)]), library, (n, n, n), h)
        pairs = volume.adjacent_pairs(body, h)
        assert pairs[["body_a", "body_b"]].to_numpy().tolist() == [[1, 2]]
        row = pairs.iloc[0]
        # Pairs of voxels across the rim are lost: at most half a voxel all around.
        assert (edge - h) ** 2 < row.area_um2 < 1.01 * edge**2
        normal = Rotation.from_quat(np.roll(q, -1)).apply([1.0, 0, 0])
        assert np.dot(row[["nx", "ny", "nz"]].to_numpy(float), normal) > 0.9995
        np.testing.assert_allclose(row[["x", "y", "z"]].to_numpy(float), xyz, atol=h)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_slabs_are_described_as_the_whole(seed, slab):
    body = np.random.default_rng(seed).integers(0, 5, (7, 5, 6)).astype(np.int32)
    whole = volume.adjacent_pairs(body, 2.0)
    found = volume.describe((body[z : z + slab] for z in range(0, 7, slab)), 2.0)
    assert found == {
        "porosity": volume.porosity(body),
        "euler": volume.euler_number(body == 0),
        "contacts": len(whole),
        "contact_area_um2": whole["area_um2"].sum(),
    }


def test_pairs_are_the_same_in_slabs(monkeypatch):
    body = np.random.default_rng(9).integers(0, 4, (9, 6, 5)).astype(np.int32)
    whole = volume.adjacent_pairs(body, 0.5)
    monkeypatch.setattr(measures, "SLAB", 2)
    pd.testing.assert_frame_equal(volume.adjacent_pairs(body, 0.5), whole, check_exact=True)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_adjacent_pairs_match_a_direct_count(seed):
    body = np.random.default_rng(seed).integers(0, 5, (4, 5, 6)).astype(np.int32)
    expected = {}
    for axis in range(3):
        a = np.moveaxis(body, axis, 0)[:-1].ravel()
        b = np.moveaxis(body, axis, 0)[1:].ravel()
        for pair in zip(a, b, strict=True):
            if 0 not in pair and pair[0] != pair[1]:
                counts = expected.setdefault((min(pair), max(pair)), [0, 0, 0])
                counts[2 - axis] += 1
    pairs = volume.adjacent_pairs(body, 2.0)
    found = {(r.body_a, r.body_b): [r.faces_x, r.faces_y, r.faces_z] for r in pairs.itertuples()}
    assert found == expected
    assert list(found) == sorted(found)


def settled(rng):
    """Touching spheres and boxes on a jittered lattice that reaches beyond the region."""
    library = library_of(trimesh.creation.box((1.0, 1.1, 0.9)))
    grid = np.stack(np.meshgrid(*[np.arange(-1, 8)] * 3, indexing="ij"), -1).reshape(-1, 3) * 6.0
    xyz = grid + rng.uniform(-0.4, 0.4, grid.shape)
    q = quaternions(len(xyz), rng)
    return bodies_of([(i % 2 - 1, 3.0 + 0.2 * (i % 3), xyz[i], q[i]) for i in range(len(xyz))]), library


@pytest.mark.parametrize("change", [-0.008, 0.009])
def test_correction_reaches_the_target_and_keeps_the_grains(change):
    bodies, library = settled(np.random.default_rng(6))
    shape, h = (50, 48, 46), 0.8
    start = volume.porosity(volume.voxelise(bodies, library, shape, h)[0])
    virtual = bodies.iloc[:3].assign(id=[9001, 9002, 9003], kind="virtual")
    moved, report = volume.correct_porosity(pd.concat([bodies, virtual]), library, shape, h, start + change)
    assert report["applied"]
    assert report["passes"] <= 6
    reached = volume.porosity(volume.voxelise(moved, library, shape, h)[0])
    assert abs(reached - start - change) <= 0.0005
    assert report["before"]["porosity"] == start
    assert report["after"]["porosity"] == reached
    assert (report["scale_factor"] > 1) == (change > 0)
    still = [c for c in bodies if c not in "xyz"]
    pd.testing.assert_frame_equal(moved[still], bodies[still])
    centre = np.array([46, 48, 50]) * h / 2
    np.testing.assert_allclose(
        moved[["x", "y", "z"]].to_numpy() - centre,
        report["scale_factor"] * (bodies[["x", "y", "z"]].to_numpy() - centre),
        atol=1e-9,
    )
    # Contraction presses grains together, expansion parts them.
    assert (report["after"]["shared_share"] > report["before"]["shared_share"]) == (change < 0)
    assert (report["after"]["contact_area_um2"] > report["before"]["contact_area_um2"]) == (change < 0)


@pytest.mark.parametrize("apart", [0.0, 0.5, 1.0, 1.9, 2.1])
def test_what_two_spheres_share_is_their_lens(apart):
    """pi (4 + d) (2 - d)^2 / 12 of unit spheres whose centres are d apart; a third, far away, shares none."""
    rows = [(-1, 12.0, (x, 16.3, 15.8)) for x in (14.0, 14.0 + 12.0 * apart)] + [(-1, 6.0, (66.0, 16, 16))]
    slabs = list(volume.claimed_slabs(bodies_of(rows), library_of(), (32, 32, 74), 1.0))
    found = sum(shared for _, shared in slabs) / sum(np.count_nonzero(body) for body, _ in slabs)
    lens = np.pi * (4 + apart) * max(0.0, 2 - apart) ** 2 / 12
    whole = 2 * 4 / 3 * np.pi - lens + 4 / 3 * np.pi / 8
    assert found == pytest.approx(lens / whole, abs=2e-3)
    assert (found > 0) == (lens > 0)


def test_correction_refuses_a_large_step():
    bodies, library = settled(np.random.default_rng(7))
    moved, report = volume.correct_porosity(bodies, library, (30, 30, 30), 1.0, 0.9)
    assert not report["applied"]
    assert report["reason"].startswith("target not reachable by position scaling: |dphi| = 0.")
    assert report["scale_factor"] == 1.0
    assert report["after"] == report["before"]
    pd.testing.assert_frame_equal(moved, bodies)
    start = report["before"]["porosity"] + 0.005
    off = volume.correct_porosity(bodies, library, (30, 30, 30), 1.0, start, switch="off")[1]
    assert not off["applied"]
    assert off["reason"] == "switched off in the config, 0.0050 from the target"


def test_correction_says_when_nothing_can_move_in():
    bodies = bodies_of([(-1, 6.0, 6.0 + 12.0 * np.array(c)) for c in np.ndindex(2, 2, 2)])
    start = volume.porosity(volume.voxelise(bodies, library_of(), (24, 24, 24), 1.0)[0])
    moved, report = volume.correct_porosity(bodies, library_of(), (24, 24, 24), 1.0, start - 0.009)
    # Overlaps only: contracting spheres that fill the region leaves a rim and raises the porosity.
    assert not report["applied"]
    assert "grains around the region" in report["reason"]
    assert report["passes"] <= 6
    pd.testing.assert_frame_equal(moved, bodies)


def test_porosity_and_contacts_of_a_lattice():
    """Simple cubic lattice of touching spheres: porosity 1 - pi/6, three contacts a sphere inside."""
    n, a = 3, 16
    xyz = [a * (np.array(c) + 0.5) for c in np.ndindex(n, n, n)]
    phase, body = volume.voxelise(bodies_of([(-1, a / 2, c) for c in xyz]), library_of(), (n * a,) * 3, 1.0)
    assert volume.porosity(phase) == pytest.approx(1 - np.pi / 6, abs=0.01)
    assert len(volume.adjacent_pairs(body, 1.0)) == 3 * n * n * (n - 1)


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, np.float32])
def test_exports_read_back_and_repeat(tmp_path, dtype):
    array = np.random.default_rng(8).integers(0, 200, (4, 5, 6)).astype(dtype)
    volume.export_metaimage(tmp_path / "a.mhd", array, 2.5)
    header = dict(line.split(" = ") for line in (tmp_path / "a.mhd").read_text().splitlines())
    assert header["DimSize"] == "6 5 4"
    assert header["ElementSpacing"] == "2.5 2.5 2.5"
    kind = {"MET_UCHAR": np.uint8, "MET_INT": np.int32, "MET_FLOAT": np.float32}[header["ElementType"]]
    read = np.fromfile(tmp_path / header["ElementDataFile"], kind).reshape(4, 5, 6)
    np.testing.assert_array_equal(read, array)
    with pytest.raises(ValueError, match="MetaImage cannot hold"):
        volume.export_metaimage(tmp_path / "c.mhd", array.astype(complex), 2.5)
    for name in "bc":
        volume.export_vti(tmp_path / f"{name}.vti", {"phase": array, "solid": array > 9}, 2.5)
    assert (tmp_path / "b.vti").read_bytes() == (tmp_path / "c.vti").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mhd", "a.raw", "b.vti", "c.vti"]


def test_vti_opens_in_vtk(tmp_path):
    vtk = pytest.importorskip("vtkmodules.vtkIOXML")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    array = np.random.default_rng(9).integers(0, 200, (4, 5, 6)).astype(np.uint8)
    volume.export_vti(tmp_path / "a.vti", {"phase": array}, 2.5)
    reader = vtk.vtkXMLImageDataReader()
    reader.SetFileName(str(tmp_path / "a.vti"))
    reader.Update()
    image = reader.GetOutput()
    assert image.GetSpacing() == (2.5, 2.5, 2.5)
    read = vtk_to_numpy(image.GetCellData().GetArray("phase")).reshape(4, 5, 6)
    np.testing.assert_array_equal(read, array)


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_coarsening_keeps_what_is_coarse(factor):
    rng = np.random.default_rng(factor)
    coarse = rng.random((5, 6, 7)) < 0.4
    fine = coarse.repeat(factor, 0).repeat(factor, 1).repeat(factor, 2)
    seen, voxel = coarsen(fine, 2.0, factor)
    assert (seen == coarse).all()
    assert voxel == 2 * factor
    left_over = np.pad(fine, [(0, factor - 1)] * 3)
    assert (coarsen(left_over, 2.0, factor)[0] == coarse).all()


@pytest.mark.parametrize("factor", [2, 3])
def test_coarsening_takes_no_side(factor):
    """Of even odds nothing comes but even odds; and no axis is preferred."""
    pore = np.random.default_rng(1).random((60, 66, 72)) < 0.5
    coarse, _ = coarsen(pore, 1.0, factor)
    assert coarse.mean() == pytest.approx(0.5, abs=4 * 0.5 / coarse.size**0.5)
    turned, _ = coarsen(pore.transpose(2, 0, 1), 1.0, factor)
    assert (turned == coarse.transpose(2, 0, 1)).all()


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_pore_space_read_in_part_is_that_of_the_whole(factor, tmp_path):
    phase = np.random.default_rng(2).integers(0, 3, (140, 12, 7), np.uint8)
    with io.create_volume(tmp_path / "v.zarr.zip", phase.shape, {"phase": "uint8"}, 1.0, {}) as file:
        file["phase"][:] = phase
    with io.open_volume(tmp_path / "v.zarr.zip") as (stored, _):
        found, voxel = read_pore_space(stored, 1.5, factor)
    expected, as_long = coarsen(phase == 0, 1.5, factor)
    assert np.array_equal(found, expected)
    assert voxel == as_long


def test_more_blocks_than_voxels_is_one_line():
    with pytest.raises(InputError, match="4 is more than a volume of 3 x 9 x 9 has"):
        coarsen(np.ones((3, 9, 9), bool), 1.0, 4)


def test_a_failed_image_leaves_nothing_behind(tmp_path, monkeypatch):
    import pyevtk.hl

    def full(name, **_):
        Path(f"{name}.vti").write_bytes(b"half")
        raise OSError("no space left")

    monkeypatch.setattr(pyevtk.hl, "imageToVTK", full)
    with pytest.raises(OSError, match="no space"):
        volume.export_vti(tmp_path / "a.vti", {"phase": np.zeros((2, 2, 2), np.uint8)}, 1.0)
    assert not list(tmp_path.iterdir())


# ---- voids


def cavity(half, radius):
    """Six slabs about a cubic cavity of a region 60 wide, and a ball in its middle."""
    ball = trimesh.creation.icosphere(4)
    slabs, where = [], []
    for axis in range(3):
        sides = np.full(3, 60.0)
        sides[axis] = 30.0 - half
        for sign in (-1, 1):
            slabs.append(trimesh.creation.box(sides))
            at = np.full(3, 30.0)
            at[axis] += sign * (half + sides[axis] / 2)
            where.append(at)
    library = SimpleNamespace(
        vertices=[np.array(m.vertices) for m in (ball, *slabs)],
        faces=[np.array(m.faces) for m in (ball, *slabs)],
    )
    rows = [(i + 1, 1.0, at) for i, at in enumerate(where)]
    ball_row = (0, radius, (30.0, 30.0, 30.0), (1.0, 0.0, 0.0, 0.0), 0, "virtual")
    return bodies_of([ball_row, *rows]), library


@pytest.mark.parametrize(("half", "radius"), [(12.0, 10.0), (15.0, 10.0), (20.0, 18.0)])
def test_void_width_of_a_cubic_cavity(half, radius):
    """Planes that meet the ball see the circle of the square; of a ball of radius w they show as much.

    On planes nearer than 1, circles of a ball of radius w add up to w^2 arcsin(1 / w) + sqrt(w^2 - 1).
    """
    bodies, library = cavity(half, radius)
    found = volume.void_width(bodies, library, (120, 120, 120), 0.5)
    shown = found**2 * np.arcsin(1 / found) + np.sqrt(found**2 - 1)
    assert shown == pytest.approx(2 * half / radius, rel=0.03)


def in_its_own_cavity(mesh, times):
    """A body of the mesh, of volume 4 pi / 3 times 10^3, in a block with a cavity so many times as large."""
    block = trimesh.creation.box((10.0, 10.0, 10.0))
    hollow = np.vstack([block.vertices, times * mesh.vertices])
    faces = np.vstack([block.faces, len(block.vertices) + mesh.faces[:, ::-1]])
    library = SimpleNamespace(vertices=[mesh.vertices, hollow], faces=[mesh.faces, faces])
    at, unturned = (30.4, 29.7, 30.1), (1.0, 0.0, 0.0, 0.0)
    return bodies_of([(0, 10.0, at, unturned, 0, "virtual"), (1, 10.0, at)]), library


def spheroid(c):
    mesh = trimesh.creation.icosphere(4)
    mesh.vertices *= np.array([1, 1, c]) * c ** (-1 / 3)
    return mesh


@pytest.mark.parametrize("voxel", [0.25, 1.0, 2.0])
def test_void_width_of_a_round_cavity_is_one(voxel):
    """A ball in a cavity as large as it, wherever it lies on the voxels and however large they are."""
    bodies, library = in_its_own_cavity(spheroid(1.0), 1.0)
    found = volume.void_width(bodies, library, (round(60 / voxel),) * 3, voxel)
    assert found == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("c", [1.0, 0.5])
@pytest.mark.parametrize("times", [1.0, 1.2, 1.5])
def test_a_void_twice_as_large_is_twice_as_wide(c, times):
    """Bodies poured 1 / width times as large leave voids of width 1 only so.

    Planes across the axis of a spheroid (1, 1, c) show circles of its discs, pi / 2 times the square of its
    radius times c in all; the others ellipses of minor half-axis c sqrt(1 - h^2), as much.
    """
    bodies, library = in_its_own_cavity(spheroid(c), times)
    found = volume.void_width(bodies, library, (60, 60, 60), 1.0)
    assert found == pytest.approx(times * np.sqrt(c * c ** (-2 / 3)), rel=0.015)


def test_void_width_is_told_by_whole_voids_alone():
    bodies, library = cavity(12.0, 10.0)
    alone = volume.void_width(bodies, library, (120, 120, 120), 0.5)
    cut = bodies.iloc[[0]].assign(id=99, x=5.0)
    assert volume.void_width(pd.concat([bodies, cut]), library, (120, 120, 120), 0.5) == alone
    assert volume.void_width(bodies.assign(x=bodies["x"] - 25), library, (120, 120, 120), 0.5) is None
    assert volume.void_width(bodies.iloc[1:], library, (120, 120, 120), 0.5) is None
    round_ = bodies.assign(shape=bodies["shape"].where(bodies["kind"] == "grain", -1))
    assert volume.void_width(round_, library, (120, 120, 120), 0.5) is None


def test_void_width_without_a_grain_is_finite():
    bodies, library = cavity(12.0, 10.0)
    assert np.isfinite(volume.void_width(bodies.iloc[:1], library, (120, 120, 120), 0.5))


PORES = {"pore_persistence": 0.1, "min_radius_px": 2.0}


def voids_of(mesh, number):
    library = library_of(*[mesh] * number)
    library.table = pd.DataFrame({"shape": range(number), "phase": VOID})
    return library


def circles_of_spheroids(c, n, rng):
    """Circles that random planes show of spheroids (1, 1, c), c <= 1, of volume 4 pi / 3, by formula.

    A plane across the direction of cosine t to the axis meets it up to h = sqrt(a^2 (1 - t^2) + (a c)^2 t^2)
    from its centre, there in an ellipse of minor half-axis a^2 c / h, and in proportion to h; the minor axis
    shrinks as sqrt(1 - (d / h)^2) with the distance d. They are over the radius of the ball whose discs
    add up to as much: pi / 2 times its square.
    """
    a = c ** (-1 / 3)
    t = rng.random(n)
    h = a * np.sqrt(1 - t**2 + (c * t) ** 2)
    d = rng.random(n) * h.max()
    circle = a * a * c / h * np.sqrt(np.maximum(0, 1 - (d / h) ** 2))
    return circle[d < h] / np.sqrt(2 * h.max() * circle.mean() / (np.pi / 2))


@pytest.mark.parametrize("c", [1.0, 0.5])
def test_circles_of_voids_are_those_that_planes_cut(c):
    """Voids of one uneven shape are unfolded to the sizes they have; as spheres they come out too small."""
    rng = np.random.default_rng(12)
    mesh = trimesh.creation.icosphere(3)
    mesh.vertices *= (1, 1, c)
    own = stereology.particle_of(volume.void_circles(voids_of(mesh, 12), **PORES))
    circles = circles_of_spheroids(c, 200_000, rng)
    for share in (0.1, 0.5, 0.9):
        assert own.exceeded(share) == pytest.approx(np.quantile(circles, 1 - share), abs=0.02)
    if c == 1:
        return
    truth = 20 * np.exp(0.25 * rng.standard_normal(100_000))
    seen = rng.choice(truth, 2000, p=truth / truth.sum()) * rng.choice(circles, 2000)
    seen, middle = seen[seen > 2], np.median(truth)  # smaller ones are specks
    assert stereology.unfold(seen, particle=own).quantile(0.5) == pytest.approx(middle, rel=0.03)
    assert stereology.unfold(seen).quantile(0.5) < 0.95 * middle


def test_without_shapes_of_voids_pores_are_unfolded_as_spheres():
    library = voids_of(trimesh.creation.icosphere(2), 1)
    none_is_shown = volume.void_circles(library, **PORES | {"min_radius_px": 30})
    library.table["phase"] = 1
    for radii in (none_is_shown, volume.void_circles(library, **PORES)):
        assert stereology.particle_of(radii) is stereology.SPHERE


def test_a_bed_between_its_voids_is_the_bed_without_them():
    """Cubes at random: a block of them taken out changes the porosity, not that between voids."""
    at = np.random.default_rng(3).uniform(-20, 120, (24_000, 3))
    library, scale = library_of(trimesh.creation.box(extents=(1, 1, 1))), 2.0
    rows = [(0, scale, tuple(p)) for p in at]
    scene = {"shape_zyx": (100, 100, 100), "voxel_size_um": 1.0, "resolution_um": 1.0}
    whole = bodies_of(rows)
    hole = (np.abs(whole[["x", "y", "z"]] - 50) < 22).all(axis=1)
    plain, holed = (volume.bed_between_voids(bodies, library, scene, 8.0) for bodies in (whole, whole[~hole]))
    assert plain.voids < 0.02
    assert holed.voids > 0.05
    assert plain.porosity == pytest.approx(np.exp(-24_000 / 140**3 * 4 / 3 * np.pi * scale**3), abs=0.02)
    assert holed.porosity == pytest.approx(plain.porosity, abs=0.02)
    loose = volume.bed_between_voids(whole[~hole].assign(scale=0.9 * scale), library, scene, 8.0)
    assert loose.porosity > holed.porosity + 0.03
    # virtual bodies hold nothing there, and a region of air has no between
    virtual = whole.assign(kind="virtual").assign(id=whole["id"] + len(whole))
    same = volume.bed_between_voids(pd.concat([whole[~hole], virtual]), library, scene, 8.0)
    assert same == holed
    assert volume.bed_between_voids(whole.iloc[:0], library, scene, 8.0) is None


def test_the_first_voxel_of_an_image_has_its_centre_half_a_voxel_in(tmp_path):
    volume.export_metaimage(tmp_path / "a.mhd", np.zeros((2, 3, 4), np.uint8), 2.5)
    header = dict(line.split(" = ") for line in (tmp_path / "a.mhd").read_text().splitlines())
    assert header["Offset"] == "1.25 1.25 1.25"


def test_shared_is_counted_of_the_solid():
    """Two unit spheres on one place and one elsewhere: half of the solid is claimed twice."""
    rows = [(-1, 4.0, at) for at in ((8, 8, 8), (8, 8, 8), (24, 8, 8))]
    _, report = volume.correct_porosity(bodies_of(rows), library_of(), (16, 16, 32), 1.0, 0.9, switch="off")
    assert report["before"]["shared_share"] == pytest.approx(0.5)


def test_voids_lie_in_the_region_by_its_own_edges():
    """A ball of radius 10 about (45, 30, 30) um."""
    bodies, library = cavity(12.0, 10.0)
    bodies["x"] += 15.0
    assert volume.void_width(bodies, library, (120, 120, 100), 0.5) is None
    assert volume.void_width(bodies, library, (100, 100, 120), 0.5) is not None


def test_a_bed_between_voids_does_not_depend_on_the_voxel():
    at = np.random.default_rng(3).uniform(-20, 60, (6000, 3))
    library = library_of(trimesh.creation.box(extents=(1, 1, 1)))
    bodies = bodies_of([(0, 2.0, tuple(p)) for p in at])
    one, half = (
        volume.bed_between_voids(
            bodies, library, {"shape_zyx": (n,) * 3, "voxel_size_um": 40 / n, "resolution_um": 1.0}, 8.0
        )
        for n in (40, 80)
    )
    assert half.voids == pytest.approx(one.voids, abs=0.02)
    assert half.porosity == pytest.approx(one.porosity, abs=0.02)


def test_porosity_of_moved_regions_goes_by_the_voxel():
    bodies, library = random_pack(np.random.default_rng(3), n=12, edge=12.0)
    found = volume.porosity_about(bodies, library, (10, 11, 12), 0.5, 1)
    expected = volume.packed_porosity(packing.move(bodies, (0.5, 0.0, -0.5)), library, (10, 11, 12), 0.5)
    assert found[0, 1, 2] == pytest.approx(expected, abs=1e-12)


def test_ties_do_not_care_where_a_volume_is_cut():
    """21 planes of six voxels fit into what is read at a time: an odd number."""
    phase = np.zeros((252, 12, 12), np.uint8)
    phase[:, :, ::2] = 1  # half of every block
    assert np.array_equal(read_pore_space(phase, 1.0, 6)[0], coarsen(phase == 0, 1.0, 6)[0])
