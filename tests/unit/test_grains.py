"""Grains: contours, three masks to one closed mesh, mass properties, the library and its files."""

import numpy as np
import pandas as pd
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial.transform import Rotation
from scipy.stats import wasserstein_distance

from grainfall import grains, io
from grainfall.errors import InputError
from grainfall.grains import contours
from grainfall.grains.export import PHASE_COLOURS
from grainfall.grains.library import SMALLEST_EXCESS, _normalised
from grainfall.morphology import grain_masks, measure_grains

seeds = st.integers(0, 2**32 - 1)


def star(radius_of_angle, size=60):
    """Mask of the figure r(θ), in units of ``size`` pixels; v runs upward."""
    reach = 2 * size + 4
    v, u = np.mgrid[reach : -reach - 1 : -1, -reach : reach + 1].astype(float)
    return np.hypot(u, v) < size * radius_of_angle(np.arctan2(v, u))


def ellipse(a, b, size=60, turn=0.0):
    return star(lambda t: 1 / np.hypot(np.cos(t - turn) / a, np.sin(t - turn) / b), size)


def superellipse(a, b, power):
    return star(lambda t: (abs(np.cos(t) / a) ** power + abs(np.sin(t) / b) ** power) ** (-1 / power))


def wavy(amplitude, phase, waves=3):
    return star(lambda t: 1 + amplitude * np.cos(waves * t + phase))


def body(grain):
    return trimesh.Trimesh(grain.vertices, grain.faces, process=False)


def assert_closed(grain):
    mesh = body(grain)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2
    assert mesh.volume > 0


def assert_star_shaped(grain):
    """Every triangle faces away from the common centre, so no two of them can cross."""
    assert_closed(grain)
    assert np.linalg.det(grain.vertices[grain.faces]).min() > -1e-12


def cut(grain, normal_axis):
    """Central section of the mesh as trimesh cuts it: a counter-clockwise polygon."""
    normal = np.eye(3)[normal_axis]
    lines = trimesh.intersections.mesh_plane(body(grain), normal, normal * 1e-7)
    loops = trimesh.load_path(lines[..., [k for k in range(3) if k != normal_axis]]).discrete
    loop = max(loops, key=len)[:-1]
    return loop if contours.polygon_moments(loop)[0] > 0 else loop[::-1]


# ---- contours -----------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(seeds, st.floats(0.3, 0.7))
def test_contour_area_is_that_of_the_filled_mask(seed, share):
    mask = np.random.default_rng(seed).random((14, 17)) < share
    try:
        contour = contours.mask_contour(mask)
    except grains.Unusable:
        return
    pieces, _ = ndimage.label(np.pad(mask, 1))
    largest = ndimage.binary_fill_holes(pieces == 1 + np.argmax(np.bincount(pieces.ravel())[1:]))
    area, centroid, _ = contours.polygon_moments(contour)
    assert area == pytest.approx(largest.sum())
    assert centroid == pytest.approx([0, 0], abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(seeds, st.floats(0.0, 0.95))
def test_any_mask_gives_a_grain_or_a_reason(seed, share):
    rng = np.random.default_rng(seed)
    mask = rng.random(rng.integers(1, 12, size=2)) < share
    try:
        contour = grains.unit_contour(mask)
    except grains.Unusable:
        return
    assert_closed(grains.grain_from_contours([contour] * 3, resolution=16))


@pytest.mark.parametrize(
    "mask",
    [np.zeros((5, 5)), np.ones((1, 1)), np.ones((1, 3)), np.ones((1, 40)), np.ones((30, 2)), np.eye(30)],
)
def test_specks_and_lines_are_refused_with_a_reason(mask):
    with pytest.raises(grains.Unusable, match=r"empty|pixels"):
        grains.grain_from_masks(mask > 0, ellipse(1, 1), ellipse(1, 1))


def test_polygon_moments_of_a_rectangle():
    area, centroid, covariance = contours.polygon_moments(np.array([[1, 2], [5, 2], [5, 4], [1, 4.0]]))
    assert area == pytest.approx(8)
    assert centroid == pytest.approx([3, 3])
    assert covariance == pytest.approx(np.diag([16 / 12, 4 / 12]))


@settings(max_examples=30, deadline=None)
@given(st.floats(0, 2 * np.pi), st.floats(-0.09, 0.09), st.floats(-0.09, 0.09))
def test_ray_reading_keeps_the_area_of_a_folded_figure(turn, u, v):
    t = np.linspace(0.4, 2 * np.pi - 0.4, 200)
    arc = np.stack([np.cos(t), np.sin(t)], axis=1)
    horseshoe = np.vstack([arc, 0.4 * arc[::-1]]) + np.array([0.7 + u, v])  # the centre lies in its back
    c, s = np.cos(turn), np.sin(turn)
    figure = horseshoe @ np.array([[c, s], [-s, c]])
    angles = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    area = np.pi * (contours.ray_radii(figure, angles) ** 2).mean()
    assert area == pytest.approx(contours.polygon_moments(figure)[0], rel=3e-3)
    assert contours.star_overlap(figure) < 0.97


def test_level_widths_of_a_triangle():
    triangle = np.array([[-1.0, -1.0], [2.0, -1.0], [0.0, 1.0]])
    right, left = contours.level_widths(triangle, np.array([-0.5, 0.0, 0.5, 2.0]))
    assert right == pytest.approx([1.5, 1.0, 0.5, 0.0])
    assert left == pytest.approx([0.75, 0.5, 0.25, 0.0])


def test_polygon_iou_of_shifted_squares():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    assert contours.polygon_iou(square, square) == 1
    assert contours.polygon_iou(square, square + np.array([0.5, 0])) == pytest.approx(1 / 3, abs=0.005)


# ---- one grain ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("resolution", "precision"), [(8, 0.1), (16, 0.03), (48, 0.02)])
def test_ellipsoid_is_rebuilt(resolution, precision):
    axes = np.array([1.4, 1.0, 0.7])
    a, b, c = axes
    grain = grains.grain_from_masks(ellipse(a, b), ellipse(a, c), ellipse(b, c), resolution=resolution)
    assert_star_shaped(grain)
    assert len(grain.vertices) == resolution**2 // 2 - resolution + 2
    assert grain.stretch < 1.02
    unit = grain.vertices / axes
    radius = np.linalg.norm(unit, axis=1)  # on the surface everywhere, not only in the three sections
    assert radius / radius.mean() == pytest.approx(np.ones(len(radius)), abs=precision)


def test_masks_of_one_grain_need_no_stretch_whatever_their_scale():
    small, large = ellipse(1.4, 1.0, size=30), ellipse(1.4, 0.7, size=60)
    assert grains.grain_from_masks(small, large, ellipse(1.0, 0.7)).stretch < 1.02


def test_stretch_is_the_least_that_reconciles_the_masks():
    # aspects 1, 1 and 4: each of the three gives a factor 4^(1/3), half of it on either of its half-axes
    grain = grains.grain_from_masks(ellipse(1, 1), ellipse(1, 1), ellipse(2, 0.5))
    assert grain.stretch == pytest.approx(4 ** (1 / 6), rel=0.02)


FIGURES = {
    "ellipses": (ellipse(1.5, 1.0), ellipse(1.5, 0.8), ellipse(1.0, 0.8)),
    "superellipses": (superellipse(1.3, 1, 4), superellipse(1.3, 0.8, 3), superellipse(1, 0.8, 5)),
    "diamonds": (superellipse(1.2, 1, 1.2), superellipse(1, 1, 1.2), ellipse(1, 1)),
    "three lobes": (wavy(0.15, 0.3), wavy(0.15, 1.0), wavy(0.15, 2.0)),
    "five lobes": (wavy(0.1, 0.0, 5), ellipse(1.2, 0.9), wavy(0.1, 0.7, 5)),
    "box": (np.ones((60, 90), bool), np.ones((50, 90), bool), np.ones((50, 60), bool)),
    "tilted": (ellipse(1, 1), ellipse(1.5, 0.8, turn=0.6), ellipse(1.5, 0.8, turn=-0.5)),
}


@pytest.mark.parametrize("name", FIGURES)
def test_central_sections_are_the_aligned_masks(name):
    grain = grains.grain_from_masks(*FIGURES[name])
    assert_star_shaped(grain)
    assert grain.iou.min() >= 0.98
    for k, normal_axis in enumerate((2, 1, 0)):
        assert contours.polygon_iou(cut(grain, normal_axis), grain.aligned[k]) >= 0.98


def test_half_contours_that_turn_back_in_z_are_read_by_angle():
    assert grains.grain_from_masks(*FIGURES["ellipses"]).reading == "height"
    assert grains.grain_from_masks(*FIGURES["tilted"]).reading == "angle"


def test_waisted_mask_is_read_by_height():
    # u(v) is single-valued although the figure is not star-shaped about its centre
    v = np.linspace(1, -1, 241)[:, None]
    u = np.linspace(-1.2, 1.2, 289)
    waisted = np.pad(np.abs(u) < np.where(np.abs(v) < 0.4, 0.35, 1.0), 1)
    grain = grains.grain_from_masks(ellipse(1, 1), waisted, waisted)
    assert grain.reading == "height"
    assert_closed(grain)
    assert grain.iou[1:].min() >= 0.95  # the steps are as wide as a ring of the mesh


def test_every_horizontal_section_is_the_horizontal_mask_scaled():
    # with one half-contour on all four sides the scale depends on z alone
    grain = grains.grain_from_masks(wavy(0.2, 0.0, 4), ellipse(1, 0.8), ellipse(1, 0.8))
    rings = np.hypot(grain.vertices[1:-1, 0], grain.vertices[1:-1, 1]).reshape(23, 48)
    shape = rings / rings.mean(axis=1, keepdims=True)
    assert np.ptp(shape[11]) > 0.3
    assert shape == pytest.approx(np.broadcast_to(shape[11], shape.shape), abs=0.02)


def test_folded_horizontal_mask_reports_its_loss():
    v, u = np.mgrid[-64:65, -64:65]
    r, t = np.hypot(u, v), np.abs(np.arctan2(v, u))
    horseshoe = (r < 60) & ((r > 30) | (t > 2.4)) & (t > 0.5)
    grain = grains.grain_from_masks(horseshoe, ellipse(1, 1), ellipse(1, 1))
    assert_star_shaped(grain)
    assert grain.iou[0] < 0.95
    assert contours.polygon_iou(cut(grain, 2), grain.aligned[0]) == pytest.approx(grain.iou[0], abs=0.01)
    assert grain.iou[1:].min() >= 0.98


def test_holes_are_filled():
    disc = ellipse(1.2, 1.0)
    holed = disc.copy()
    holed[110:130, 100:120] = False
    assert disc[109:131, 99:121].all()
    grain, whole = (grains.grain_from_masks(m, ellipse(1, 1), ellipse(1, 1)) for m in (holed, disc))
    assert np.array_equal(grain.vertices, whole.vertices)


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(0.0, 0.5), st.sampled_from([8, 20, 48]))
def test_random_star_masks_give_sound_grains(seed, roughness, resolution):
    rng = np.random.default_rng(seed)

    def rough():
        k = np.arange(2, 7)[:, None, None]
        amplitude, phase = roughness * rng.random(k.shape) / k, 2 * np.pi * rng.random(k.shape)
        return star(lambda t: 1 + (amplitude * np.cos(k * t + phase)).sum(axis=0), 20)

    grain = grains.grain_from_masks(rough(), rough(), rough(), resolution=resolution)
    assert_closed(grain)
    if grain.reading == "angle":
        assert_star_shaped(grain)


def test_mesh_is_refined_only_where_that_helps():
    plain = grains.grain_from_masks(*FIGURES["ellipses"])
    toothed = wavy(0.12, 0.4, 13)
    fine = grains.grain_from_masks(toothed, toothed, toothed)
    coarse = grains.grain_from_masks(toothed, toothed, toothed, resolution=48)
    assert len(plain.vertices) == 1106
    assert coarse.iou.min() < 0.98 <= fine.iou.min()


@pytest.mark.parametrize("resolution", [0, 4, 10])
def test_bad_resolution(resolution):
    with pytest.raises(ValueError, match="multiple of 4"):
        grains.grain_from_masks(*FIGURES["ellipses"], resolution=resolution)


# ---- mass properties ----------------------------------------------------------------------------------


def test_mass_of_a_box_is_exact():
    box = trimesh.creation.box((2.0, 3.0, 5.0))
    volume, centre, inertia = grains.mass_properties(box.vertices + np.array([10, -20, 30]), box.faces)
    assert volume == pytest.approx(30)
    assert centre == pytest.approx([10, -20, 30])
    assert inertia == pytest.approx(30 / 12 * np.diag([9 + 25, 4 + 25, 4 + 9]))


@pytest.mark.parametrize("axes", [(1, 1, 1), (3, 2, 1)])
def test_mass_of_an_ellipsoid_converges(axes):
    a, b, c = axes
    errors = []
    for level in (2, 3, 4):
        ball = trimesh.creation.icosphere(subdivisions=level)
        volume, centre, inertia = grains.mass_properties(ball.vertices * axes, ball.faces)
        exact = 4 / 3 * np.pi * a * b * c
        tensor = exact / 5 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
        assert centre == pytest.approx([0, 0, 0], abs=1e-9)
        errors.append([1 - volume / exact, np.abs(1 - np.diag(inertia) / tensor).max()])
    errors = np.array(errors)
    assert errors[-1].max() < 0.006
    assert errors[:-1] / errors[1:] == pytest.approx(np.full((2, 2), 4), rel=0.1)  # second order


@settings(max_examples=40, deadline=None)
@given(seeds, st.floats(-1e4, 1e4), st.floats(0.01, 100))
def test_mass_moves_with_the_body(seed, far, scale):
    rng = np.random.default_rng(seed)
    hull = trimesh.convex.convex_hull(rng.normal(size=(20, 3)))
    turn, shift = Rotation.random(rng=rng).as_matrix(), far * scale * rng.normal(size=3)
    volume, centre, inertia = grains.mass_properties(hull.vertices, hull.faces)
    moved = grains.mass_properties(scale * hull.vertices @ turn.T + shift, hull.faces)
    assert moved[0] == pytest.approx(volume * scale**3)
    assert moved[1] == pytest.approx(scale * turn @ centre + shift, rel=1e-9, abs=1e-9 * scale)
    assert moved[2] == pytest.approx(scale**5 * turn @ inertia @ turn.T, rel=1e-6, abs=1e-6 * scale**5)


def test_sphere_has_unit_equal_volume_radius():
    volume, centre, inertia = grains.mass_properties(*grains.sphere())
    assert volume == pytest.approx(4 * np.pi / 3)
    assert centre == pytest.approx([0, 0, 0], abs=1e-9)
    assert np.diag(inertia) == pytest.approx(np.full(3, 8 * np.pi / 15), rel=0.01)


# ---- the library --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def section():
    """Ellipses of two minerals on a grid, one grain cut by the border (37), a speck (38) and a line (39)."""
    rng = np.random.default_rng(5)
    labels = np.zeros((400, 400), dtype=np.int32)
    y, x = np.mgrid[:400, :400]
    for n in range(36):
        v, u = y - 35 - 65 * (n // 6), x - 35 - 65 * (n % 6)
        (a, b), t = rng.uniform(12, 28, 2), rng.uniform(0, np.pi)
        along, across = u * np.cos(t) + v * np.sin(t), v * np.cos(t) - u * np.sin(t)
        labels[(along / a) ** 2 + (across / b) ** 2 < 1] = n + 1
    labels[180:220, 0:3] = 37
    labels[2, 2:5] = 38
    labels[396:398, 100:160] = 39
    return labels, measure_grains(labels, 1 + labels % 2, 1.0)


@pytest.fixture(scope="module")
def library(section):
    return grains.build_library(*section, 6, np.random.default_rng(1), resolution=24)


def test_library_shapes_are_normalised_and_described(library):
    assert list(library.table["shape"]) == list(range(12))
    assert list(library.table["phase"]) == [1] * 6 + [2] * 6
    for row, vertices, faces in zip(library.table.itertuples(), library.vertices, library.faces, strict=True):
        volume, centre, inertia = grains.mass_properties(vertices, faces)
        assert volume == pytest.approx(4 * np.pi / 3, rel=1e-5)
        assert centre == pytest.approx([0, 0, 0], abs=1e-6)
        assert row.inertia_xy == pytest.approx(inertia[0, 1])
        assert row.inertia_zz == pytest.approx(inertia[2, 2])
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        assert mesh.is_watertight
        assert row.hull_excess == pytest.approx(mesh.convex_hull.volume / mesh.volume - 1, abs=1e-6)
        assert row.hull_excess >= 0
        assert row.sphericity == pytest.approx(4 * np.pi / mesh.area, rel=1e-4)
        assert row.aspect_ratio >= 1


def test_masks_come_from_the_phase_uncut_and_usable(section, library):
    table = section[1].set_index("grain")
    for row in library.table.itertuples():
        ids = [row.mask_xy, row.mask_xz, row.mask_yz]
        assert (table["phase"][ids] == row.phase).all()
        assert not set(ids) & {37, 38, 39}
        assert row.r2d_um == table["r_um"][row.mask_xy]


def test_three_masks_are_of_one_size(section):
    labels, table = section
    table = table.assign(phase=1)  # 36 masks: three bins of twelve
    library = grains.build_library(labels, table, 10, np.random.default_rng(2), resolution=8)
    radius = table.set_index("grain")["r_um"]
    usable = np.sort(radius.drop([37, 38, 39]))
    for row in library.table.itertuples():
        bins = {
            int(np.searchsorted(usable, radius[m]) // 12) for m in (row.mask_xy, row.mask_xz, row.mask_yz)
        }
        assert len(bins) == 1


def test_skipped_masks_are_named(library):
    skipped = library.skipped.set_index("grain")["reason"]
    assert set(skipped.index) == {38, 39}  # 37 is cut by the border: no mask at all
    assert "pixels" in skipped[38]
    assert "wide" in skipped[39]


def test_library_is_reproducible_to_the_byte_and_survives_its_files(section, library, tmp_path):
    again = grains.build_library(*section, 6, np.random.default_rng(1), resolution=24)
    library.save(tmp_path / "a")
    again.save(tmp_path / "b")
    for name in ("shapes.npz", "library.csv", "skipped.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    arrays = io.read_arrays(tmp_path / "a/shapes.npz")
    io.write_arrays(tmp_path / "b/shapes.npz", {k: v for k, v in arrays.items() if k != "faces"})
    with pytest.raises(InputError, match="has no faces"):
        grains.Library.load(tmp_path / "b")
    loaded = grains.Library.load(tmp_path / "a")
    assert len(loaded) == len(library)
    pd.testing.assert_frame_equal(loaded.table, library.table)
    for k in range(len(library)):
        assert np.array_equal(loaded.vertices[k], library.vertices[k])
        assert np.array_equal(loaded.faces[k], library.faces[k])
        assert loaded.faces[k].dtype == np.int32
        assert len(loaded.pieces[k]) == len(library.pieces[k])
        for piece, original in zip(loaded.pieces[k], library.pieces[k], strict=True):
            assert np.array_equal(piece, original)


def test_pieces_survive_the_files(tmp_path):
    """Shapes with and without pieces side by side, and a library of none at all."""
    rng = np.random.default_rng(0)
    ball, faces = grains.sphere(1)
    piece = [rng.normal(size=(n, 3)).astype(np.float32).astype(float) for n in (5, 8, 6)]
    for cuts in ([(piece[0], piece[1]), (), (piece[2],)], [(), (), ()]):
        table = pd.DataFrame({"shape": range(3), "pieces": [len(c) for c in cuts]})
        grains.Library([ball] * 3, [faces] * 3, table, pieces=cuts).save(tmp_path)
        loaded = grains.Library.load(tmp_path).pieces
        assert [len(c) for c in loaded] == [len(c) for c in cuts]
        for found, saved in zip(loaded, cuts, strict=True):
            assert all(np.array_equal(f, s) for f, s in zip(found, saved, strict=True))


def test_library_shapes_have_pieces_where_their_hulls_are_too_large(library):
    assert library.table["pieces"].tolist() == [len(cut) for cut in library.pieces]
    cut = library.table[library.table["pieces"] > 0]
    assert (cut["parts_excess"] < cut["hull_excess"]).all()
    assert (cut["hull_excess"] >= SMALLEST_EXCESS).all()
    assert library.table["parts_excess"].isna().equals(library.table["pieces"] == 0)


def test_progress_names_every_shape(section):
    lines = []
    grains.build_library(*section, 2, np.random.default_rng(1), resolution=8, progress=lines.append)
    assert [line.split(":")[0] for line in lines] == [f"shape {k} of 4" for k in (1, 2, 3, 4)]


def test_phase_without_masks_is_an_input_error(section):
    labels, table = section
    table = table.assign(phase=table["phase"].where(table["grain"] != 38, 3))  # 3: the speck alone
    with pytest.raises(InputError, match="phase 3"):
        grains.build_library(labels, table, 1, np.random.default_rng(0))


def test_section_without_grains_is_an_input_error(section):
    with pytest.raises(InputError, match="no grain"):
        grains.build_library(section[0], section[1].iloc[:0], 1, np.random.default_rng(0))


def test_discs_make_spheres():
    y, x = np.mgrid[:300, :300]
    labels = np.zeros((300, 300), dtype=np.int32)
    for n in range(9):
        cy, cx, radius = 50 + 100 * (n // 3), 50 + 100 * (n % 3), 25 + 2 * n
        labels[(y - cy) ** 2 + (x - cx) ** 2 < radius**2] = n + 1
    table = measure_grains(labels, (labels > 0).astype(np.uint8), 1.0)
    found = grains.build_library(labels, table, 4, np.random.default_rng(0)).table
    assert (found["sphericity"] > 0.985).all()
    assert (found["hull_excess"] < 0.02).all()
    assert (found["aspect_ratio"] < 1.03).all()
    assert (found["stretch"] < 1.03).all()
    assert found["inertia_xx"].to_numpy() == pytest.approx(np.full(4, 8 * np.pi / 15), rel=0.03)


def voids_among_grains(void):
    """Solid with voids of one mask on a lattice, and grains of 8 pixels everywhere (in the table alone)."""
    cell = np.zeros((96, 96), bool)
    rows, columns = void.shape
    top, left = (96 - rows) // 2, (96 - columns) // 2
    cell[top : top + rows, left : left + columns] = void
    phase = np.uint8(~np.tile(cell, (4, 4)))
    phase[:, 47::96] = 0  # a channel narrower than any grain joins them
    return phase, pd.DataFrame({"r_um": [8.0], "weight": [1.0]})


def shapes_of_voids(phase, table, **over):
    given = {"number": 6, "pore_persistence": 0.1, "min_radius_px": 2.0} | over
    return grains.void_shapes(phase, table, 1.0, np.random.default_rng(0), **given)


def test_round_voids_give_spheres_and_lobed_ones_do_not():
    round_, lobed = (
        shapes_of_voids(*voids_among_grains(void))
        for void in (ellipse(1, 1, 20), star(lambda t: 1 + 0.3 * np.cos(3 * t), 18))
    )
    assert (round_.table["phase"] == grains.VOID).all()
    assert len(round_) == 6
    assert round_.table["r2d_um"].to_numpy() == pytest.approx(20, abs=0.6)
    assert round_.table["sphericity"].min() > 0.97
    assert lobed.table["sphericity"].max() < 0.97
    # sized by the circle that fits in, which is smaller than the circle of equal area
    assert lobed.table["r2d_um"].max() < 18


def test_a_section_without_voids_gives_no_shapes_of_them():
    phase, table = voids_among_grains(ellipse(1, 1, 20))
    assert shapes_of_voids(phase, table.assign(r_um=24.0)) is None  # none would hold a grain
    assert shapes_of_voids(phase, table.assign(r_um=2.0)) is None  # pixels too coarse to tell
    assert shapes_of_voids(phase, table.assign(weight=0.0)) is None  # every grain is cut
    assert shapes_of_voids(phase[:288, :288], table) is None  # nine voids are too few


def test_shapes_of_voids_come_after_those_of_the_grains(library, tmp_path):
    voids = shapes_of_voids(*voids_among_grains(ellipse(1, 1, 20)))
    both = library.with_shapes(voids)
    assert both.table["shape"].tolist() == list(range(len(library) + 6))
    both.save(tmp_path / "both")
    again = grains.Library.load(tmp_path / "both")
    for ours, theirs in ((library, 0), (voids, len(library))):
        for k in (0, len(ours) - 1):
            np.testing.assert_array_equal(again.mesh(theirs + k)[0], ours.mesh(k)[0])
            np.testing.assert_array_equal(again.mesh(theirs + k)[1], ours.mesh(k)[1])
            assert len(again.pieces[theirs + k]) == len(ours.pieces[k])


def test_sections_of_the_shapes_are_as_elongated_as_the_masks():
    # the masks: isotropic sections of ellipsoids 1 : 0.6 : 0.4, whose aspects are known without a mesh
    rng = np.random.default_rng(8)
    quadric = np.diag(np.array([1, 0.6, 0.4]) ** -2.0)
    reach = np.linalg.inv(quadric)
    labels, aspects = np.zeros((60 * 9, 60 * 9), dtype=np.int32), []
    y, x = np.mgrid[:60, :60] - 29.5
    while len(aspects) < 81:
        frame = Rotation.random(rng=rng).as_matrix()
        normal = frame[:, 2]
        if rng.random() > np.sqrt(normal @ reach @ normal):
            continue  # a plane meets a body as often as the body is wide across it
        form = frame[:, :2].T @ quadric @ frame[:, :2]
        aspects.append(np.sqrt(np.linalg.cond(form)))
        form *= 14**-2 / np.sqrt(np.linalg.det(form))
        n = len(aspects) - 1
        cell = labels[60 * (n // 9) :, 60 * (n % 9) :][:60, :60]
        cell[form[0, 0] * x**2 + 2 * form[0, 1] * x * y + form[1, 1] * y**2 < 1] = n + 1
    table = measure_grains(labels, (labels > 0).astype(np.uint8), 1.0)
    library = grains.build_library(labels, table, 40, rng, resolution=16)
    rebuilt = []
    while len(rebuilt) < 240:
        shape = rng.integers(len(library))
        vertices, faces = library.mesh(shape)
        frame = Rotation.random(rng=rng).as_matrix()
        across = vertices @ frame[:, 2]
        if rng.random() > np.ptp(across) / 5:
            continue
        level = rng.uniform(across.min(), across.max())
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        lines = trimesh.intersections.mesh_plane(mesh, frame[:, 2], level * frame[:, 2])
        if len(lines) >= 8:  # not a mere corner
            loop = max(trimesh.load_path(lines @ frame[:, :2]).discrete, key=len)
            rebuilt.append(np.sqrt(np.linalg.cond(contours.polygon_moments(loop[:-1])[2])))
    # spheres would be off by the mean excess over 1; masks that were not central sections round a little
    assert wasserstein_distance(rebuilt, aspects) < (np.mean(aspects) - 1) / 3
    assert np.mean(rebuilt) == pytest.approx(np.mean(aspects), rel=0.12)


def test_more_candidates_stretch_less(section):
    stretch = [
        grains.build_library(*section, 20, np.random.default_rng(4), candidates=n, resolution=8)
        .table["stretch"]
        .median()
        for n in (1, 4, 16)
    ]
    assert stretch[0] > stretch[1] > stretch[2]


def test_missing_or_broken_library_is_an_input_error(library, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        grains.Library.load(tmp_path)
    library.save(tmp_path)
    whole = (tmp_path / "shapes.npz").read_bytes()
    (tmp_path / "shapes.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="not a readable"):
        grains.Library.load(tmp_path)


def test_arrays_file_keeps_names_types_and_bytes(tmp_path):
    content = {"b": np.arange(5, dtype=np.int32), "a": np.eye(3)}
    io.write_arrays(tmp_path / "x.npz", content)
    io.write_arrays(tmp_path / "y.npz", dict(reversed(content.items())))
    assert (tmp_path / "x.npz").read_bytes() == (tmp_path / "y.npz").read_bytes()
    back = io.read_arrays(tmp_path / "x.npz")
    assert set(back) == {"a", "b"}
    assert back["b"].dtype == np.int32
    assert np.array_equal(back["a"], np.eye(3))


# ---- exports ------------------------------------------------------------------------------------------


@pytest.fixture
def bodies():
    rng = np.random.default_rng(3)
    table = pd.DataFrame({"kind": ["grain"] * 7 + ["virtual"], "phase": [1, 2] * 4})
    table["shape"] = [0, 6, 1, 7, 0, 6, 1, -1]
    table["scale"] = rng.uniform(10, 30, 8)
    table[["x", "y", "z"]] = rng.uniform(0, 300, (8, 3))
    table[["qw", "qx", "qy", "qz"]] = Rotation.random(8, rng=rng).as_quat(scalar_first=True)
    return table


@pytest.mark.parametrize("ending", ["glb", "stl"])
def test_exported_bodies_keep_place_volume_and_bytes(bodies, library, tmp_path, ending):
    files = [tmp_path / f"{name}.{ending}" for name in "ab"]
    for path in files:
        grains.export_bodies(bodies, library, path)
    assert files[0].read_bytes() == files[1].read_bytes()
    mesh = trimesh.load(files[0], force="scene").to_mesh()
    assert mesh.volume == pytest.approx((4 / 3 * np.pi * bodies["scale"] ** 3).sum(), rel=1e-4)
    points = []
    for b in bodies.itertuples():
        turn = Rotation.from_quat([b.qw, b.qx, b.qy, b.qz], scalar_first=True)
        points.append(turn.apply(b.scale * library.mesh(b.shape)[0]) + np.array([b.x, b.y, b.z]))
    points = np.vstack(points)
    if ending == "glb":  # glTF is y up
        points = points[:, [0, 2, 1]] * [1, 1, -1]
    assert mesh.bounds == pytest.approx(np.array([points.min(axis=0), points.max(axis=0)]), abs=1e-3)


def test_glb_colours_are_those_of_the_phases(bodies, library, tmp_path):
    grains.export_bodies(bodies, library, tmp_path / "a.glb", colours={2: (1, 2, 3)})
    scene = trimesh.load(tmp_path / "a.glb")
    found = {name: tuple(g.visual.material.baseColorFactor[:3]) for name, g in scene.geometry.items()}
    assert len(scene.geometry) == 5  # shapes 0, 1, 6, 7 and the sphere: each stored once
    assert len(scene.graph.nodes_geometry) == len(bodies)
    assert {c for n, c in found.items() if n.startswith("phase2")} == {(1, 2, 3)}
    assert (1, 2, 3) not in {c for n, c in found.items() if not n.startswith("phase2")}


def test_an_exported_body_has_its_volume(bodies, library, tmp_path):
    grains.export_bodies(bodies.iloc[[0]].assign(scale=25.0), library, tmp_path / "grain.stl")
    assert trimesh.load(tmp_path / "grain.stl").volume == pytest.approx(4 / 3 * np.pi * 25**3, rel=1e-4)


def test_lammps_data_hold_every_body_as_the_sphere_of_its_volume(bodies, tmp_path):
    """The columns of read_data for atom_style sphere: id type diameter density x y z, in SI units."""
    grains.export_lammps(bodies, tmp_path / "grains.data", density_kg_m3=2600.0)
    lines = (tmp_path / "grains.data").read_text().splitlines()
    start = lines.index("Atoms")
    header = [line for line in lines[1:start] if line]
    assert header[:2] == ["8 atoms", "3 atom types"]
    atoms = np.array([line.split() for line in lines[start + 2 :]], float)
    np.testing.assert_array_equal(atoms[:, 0], np.arange(1, 9))
    np.testing.assert_array_equal(atoms[:, 1], [1, 2, 1, 2, 1, 2, 1, 3])
    volume = (4 / 3 * np.pi * (bodies["scale"] * 1e-6) ** 3).sum()
    assert (np.pi / 6 * atoms[:, 2] ** 3 * atoms[:, 3]).sum() == pytest.approx(2600 * volume)
    np.testing.assert_allclose(atoms[:, 4:], bodies[["x", "y", "z"]] * 1e-6, rtol=1e-9)
    bounds = np.array([line.split()[:2] for line in header[2:]], float)
    assert [line.split()[2:] for line in header[2:]] == [["xlo", "xhi"], ["ylo", "yhi"], ["zlo", "zhi"]]
    assert (bounds[:, 0] <= (atoms[:, 4:] - atoms[:, [2]] / 2).min(axis=0) + 1e-13).all()
    assert (bounds[:, 1] >= (atoms[:, 4:] + atoms[:, [2]] / 2).max(axis=0) - 1e-13).all()


def test_export_refuses_what_it_cannot_write(bodies, library, tmp_path):
    with pytest.raises(InputError, match="glb"):
        grains.export_bodies(bodies, library, tmp_path / "a.obj")
    with pytest.raises(InputError, match="nothing"):
        grains.export_bodies(bodies.iloc[:0], library, tmp_path / "a.stl")
    with pytest.raises(InputError, match="nothing"):
        grains.export_lammps(bodies.iloc[:0], tmp_path / "a.data")


# ---- a real section -----------------------------------------------------------------------------------


def test_real_grains_are_reproduced(shared_data):
    labels = np.load(shared_data / "thin_section" / "miocene_20_2_instances.npz")["labels"]
    table = measure_grains(labels, (labels > 0).astype(np.uint8), 1.0)
    iou, seen = [], []
    for mask in grain_masks(labels, table)[:100]:
        contour = grains.unit_contour(mask)
        iou.append(grains.grain_from_contours([contour] * 3).iou.min())
        seen.append(contours.star_overlap(contour))
    iou, seen = np.array(iou), np.array(seen)
    whole = seen > 0.999
    assert whole.mean() > 0.9
    assert iou[whole].min() >= 0.98
    assert (iou >= seen - 0.04).all()  # no loss beyond the mesh's and the fold's


@pytest.fixture(scope="module")
def ellipses():
    """Thirteen ellipses 2 : 1, alike but for their size, all along x."""
    labels = np.zeros((70, 70 * 13), np.int32)
    y, x = np.indices(labels.shape)
    for n in range(13):
        a = 20 + n / 2
        labels[((x - 35 - 70 * n) / a) ** 2 + (2 * (y - 35) / a) ** 2 < 1] = n + 1
    return labels, measure_grains(labels, (labels > 0).astype(np.uint8), 1.0)


def test_masks_are_drawn_by_their_weights(ellipses):
    labels, table = ellipses
    only = table.assign(weight=np.where(table["grain"] == 5, 1.0, 1e-12))
    found = grains.build_library(labels, only, 8, np.random.default_rng(0), resolution=8, pieces=False).table
    assert (found[["mask_xy", "mask_xz", "mask_yz"]] == 5).all(axis=None)


def test_masks_are_turned_at_random(ellipses):
    """Ellipses that all lie along x would always make the same body, stretched by the same factor."""
    given = {"candidates": 1, "resolution": 8, "pieces": False}
    found = grains.build_library(*ellipses, 12, np.random.default_rng(0), **given).table
    assert found["stretch"].min() < 1.15
    assert found["stretch"].max() > 1.3


def test_figures_of_an_ellipsoid_are_its_axes():
    ball, faces = grains.sphere(4)
    _, found = _normalised(grains.Grain(ball * np.array([1.0, 3.0, 2.0]), faces))
    assert found["aspect_ratio"] == pytest.approx(3, rel=0.01)
    assert found["elongation"] == pytest.approx(2 / 3, rel=0.01)
    assert found["flatness"] == pytest.approx(1 / 2, rel=0.01)


def test_minerals_have_the_colours_of_their_numbers(tmp_path):
    table = pd.DataFrame({"kind": "grain", "phase": [1, 2, 7], "shape": -1, "scale": 1.0})
    table[["x", "y", "z", "qx", "qy", "qz"]], table["qw"] = 0.0, 1.0
    library = grains.Library([], [], pd.DataFrame())
    grains.export_bodies(table, library, tmp_path / "a.glb")
    scene = trimesh.load(tmp_path / "a.glb")
    found = {n: tuple(g.visual.material.baseColorFactor[:3]) for n, g in scene.geometry.items()}
    assert found == {f"phase{k}_shape-1": PHASE_COLOURS[(k - 1) % 6] for k in (1, 2, 7)}
