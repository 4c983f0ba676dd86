"""S2 against direct sums, exact media and measured curves; the envelope test against its own law."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.stats import chisquare

from grainfall import correlation as c
from grainfall import random
from grainfall.volume import voxelise

small = hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=3, min_side=2, max_side=7))


def direct(indicator, axis, lag, periodic):
    """S2 by definition: all pairs, one by one."""
    line = np.moveaxis(indicator, axis, 0)
    n = len(line)
    starts = range(n) if periodic else range(n - lag)
    pairs = [line[i] & line[(i + lag) % n] for i in starts]
    return np.mean(pairs)


@settings(max_examples=60, deadline=None)
@given(small, st.booleans())
def test_s2_is_the_direct_double_sum(indicator, periodic):
    for axis in range(indicator.ndim):
        n = indicator.shape[axis]
        found = c.s2_along(indicator, axis, n - 1, periodic=periodic)
        expected = [direct(indicator, axis, lag, periodic) for lag in range(n)]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
        assert found[0] == indicator.mean()


@settings(max_examples=40, deadline=None)
@given(hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=8)))
def test_image_pools_the_pairs_of_both_axes(image):
    reach = min(image.shape) // 2
    pairs = [[] for _ in range(reach + 1)]
    for lag in range(reach + 1):
        pairs[lag] += list((image[: image.shape[0] - lag] & image[lag:]).ravel())
        pairs[lag] += list((image[:, : image.shape[1] - lag] & image[:, lag:]).ravel())
    np.testing.assert_allclose(c.s2_image(image), [np.mean(p) for p in pairs], atol=1e-14)


@settings(max_examples=8, deadline=None)
@given(hnp.arrays(bool, st.tuples(*[st.integers(5, 7)] * 3)), st.booleans())
def test_radial_average_is_the_direct_one(indicator, periodic):
    curve = c.s2_volume(indicator, 2.0, 4, periodic=periodic).query("axis == 'r'")
    reach = len(curve) - 1
    shells = [[] for _ in range(reach + 1)]
    lengths = [[] for _ in range(reach + 1)]
    points = list(np.ndindex(*indicator.shape))
    n = np.array(indicator.shape)
    for lag in np.ndindex(2 * reach + 1, 2 * reach + 1, 2 * reach + 1):
        lag = np.array(lag) - reach
        shell = int(np.rint(np.linalg.norm(lag)))
        if shell > reach:
            continue
        for point in points:
            other = (point + lag) % n if periodic else point + lag
            if np.all((other >= 0) & (other < n)):
                shells[shell].append(indicator[point] & indicator[tuple(other)])
                lengths[shell].append(2.0 * np.linalg.norm(lag))
    np.testing.assert_allclose(curve["s2"], [np.mean(s) for s in shells], atol=1e-12)
    np.testing.assert_allclose(curve["lag_um"], [np.mean(s) for s in lengths], atol=1e-12)


def test_berea_reference(shared_data):
    """Published pore-pore probability of Berea, all lags; its columns are axis 0, axis 2, axis 1."""
    import tifffile

    pore = tifffile.imread(shared_data / "berea/berea_400_pore1.tif") == 1
    reference = pd.read_csv(shared_data / "berea/s2_pore_pore.csv")
    for column, axis in (("x", 0), ("y", 2), ("z", 1)):
        found = c.s2_along(pore, axis, len(reference) - 1)
        np.testing.assert_allclose(found, reference[column], rtol=0, atol=1e-9)


def spheres(xyz, radius):
    """Spheres as bodies."""
    columns = dict.fromkeys(["qx", "qy", "qz"], 0.0) | {"kind": "grain", "phase": 1, "shape": -1, "qw": 1.0}
    table = pd.DataFrame(xyz, columns=["x", "y", "z"]).assign(scale=radius, **columns)
    return table.assign(id=np.arange(len(table)))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.integers(0, 6), st.integers(1, 2))
def test_blocks_and_threads_do_not_show(seed, periodic, size, threads):
    volume = np.random.default_rng(seed).random((13, 9, 11)) < 0.6
    whole = c.s2_volume(volume, 1.0, periodic=periodic)
    parts = c.s2_volume(volume, 1.0, periodic=periodic, threads=threads, block_bytes=10**size)
    pd.testing.assert_frame_equal(parts, whole, check_exact=True)


@settings(max_examples=30, deadline=None)
@given(
    hnp.arrays(bool, hnp.array_shapes(min_dims=3, max_dims=3, min_side=2, max_side=9)),
    st.integers(1, 12),
    st.booleans(),
    st.integers(0, 5),
)
def test_slabs_add_up_to_the_volume(volume, parts, periodic, size):
    """More slabs than planes, too: some are empty then."""
    options = {"periodic": periodic, "block_bytes": 10**size}
    counts = [c.pair_counts(volume, part=part, parts=parts, **options) for part in range(1, parts + 1)]
    assert all(found.dtype == np.int64 for slab in counts for found in slab.values())
    found = c.s2_of_counts(counts, volume.shape, 2.0, periodic=periodic)
    whole = c.s2_volume(volume, 2.0, periodic=periodic)
    pd.testing.assert_frame_equal(found, whole, check_exact=True)


class Reads:
    """An array that remembers how many planes and rows were read of it at a time."""

    def __init__(self, array):
        self.array, self.shape, self.read = array, array.shape, []

    def __getitem__(self, index):
        part = self.array[index]
        self.read.append(part.shape)
        return part


def test_a_slab_reads_its_planes_and_no_more_than_it_must():
    volume = Reads(np.random.default_rng(1).random((24, 16, 16)) < 0.5)
    c.pair_counts(volume, part=2, parts=4)
    assert volume.read == [(24, 4, 16), (6 + 4, 16, 16)]  # lags of up to 8 voxels, and of 4 in all directions


def test_sphere_array_has_its_surface_and_its_curve():
    """Array of spheres: S2'(0) = -S_v / 4, and S2 = phi (1 - 3r/4R + r^3/16R^3) until images meet."""
    n, radius = 96, 30.0
    phase, _ = voxelise(spheres([[48.3, 47.9, 48.1]], radius), None, (n, n, n), 1.0)
    curves = c.s2_volume(phase, 1.0, periodic=True)
    phi = 4 / 3 * np.pi * radius**3 / n**3
    for axis in "xyzr":
        curve = curves[curves["axis"] == axis]
        r = curve["lag_um"].to_numpy()
        own = r < n - 2 * radius
        expected = phi * (1 - 0.75 * r / radius + r**3 / (16 * radius**3))
        np.testing.assert_allclose(curve["s2"][own], expected[own], atol=0.003 * phi)
    surface = [
        c.surface_from_s2(*curves.loc[curves["axis"] == a, ["lag_um", "s2"]].to_numpy().T) for a in "xyz"
    ]
    assert np.mean(surface) == pytest.approx(3 * phi / radius, rel=0.01)


def test_packed_spheres_have_their_surface(shared_data):
    """The 621 spheres of Andra et al. (2013), triply periodic: S_v = 3 (1 - porosity) / R."""
    box = np.array([55.185506, 55.404375, 55.540488])
    radius = 3.5
    xyz = np.loadtxt(shared_data / "spherepack/andra2013_621.txt")[:, :3]
    images = np.concatenate([xyz + box * (np.array(i) - 1) for i in np.ndindex(3, 3, 3)])
    images = images[((images > -radius) & (images < box + radius)).all(axis=1)]
    h = 0.35
    phase, _ = voxelise(spheres(images, radius), None, (158, 158, 157), h)
    curves = c.s2_volume(phase, h, radial=False)
    assert curves.query("lag_um == 0")["s2"].iloc[0] == pytest.approx(1 - 0.343251, abs=0.002)
    mean = curves.groupby("lag_um")["s2"].mean()
    found = c.surface_from_s2(mean.index.to_numpy(), mean.to_numpy())
    assert found == pytest.approx(3 * (1 - 0.343251) / radius, rel=0.015)
    # Far apart, S2 levels off at the square of the fraction.
    assert mean.iloc[-20:].mean() == pytest.approx(mean.iloc[0] ** 2, abs=0.005)


def test_uncorrelated_noise_is_flat():
    noise = np.random.default_rng(1).random((300, 300)) < 0.6
    s2 = c.s2_image(noise)
    np.testing.assert_allclose(s2[1:], 0.36, atol=0.01)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 12), max_size=4))
def test_any_chunking_gives_the_same_rows(seed, cuts):
    rng = np.random.default_rng(seed)
    volume = rng.random((12, 10, 11)) < 0.5
    slices = random.slices(rng, volume.shape, 12)
    whole = c.s2_of_slices(volume, slices, 2.0)
    bounds = sorted([0, 12, *cuts])  # a chunk may be empty
    chunks = [c.s2_of_slices(volume, slices[a:b], 2.0, start=a) for a, b in pairwise(bounds)]
    pd.testing.assert_frame_equal(pd.concat(chunks, ignore_index=True), whole, check_exact=True)


def test_a_line_longer_than_a_chunk_of_lines_is_whole():
    np.testing.assert_array_equal(c.s2_along(np.ones(10_000, bool), 0, 3), np.ones(4))


def smooth_curves(n, rng, m=30):
    """Exchangeable random curves with correlated lags."""
    return np.cumsum(rng.normal(size=(n, m)), axis=1)


def test_envelope_p_is_uniform_under_exchangeability():
    rng = np.random.default_rng(2)
    n, repeats = 19, 600
    p = [c.global_envelope(x[0], x[1:])["p"] for x in (smooth_curves(n + 1, rng) for _ in range(repeats))]
    counts = np.bincount(np.rint(np.array(p) * (n + 1)).astype(int), minlength=n + 2)[1:]
    assert chisquare(counts).pvalue > 0.001


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.1, 0.25]), st.floats(0, 3))
def test_observed_leaves_the_envelope_exactly_when_rejected(seed, alpha, shift):
    rng = np.random.default_rng(seed)
    curves = smooth_curves(40, rng)
    observed = curves[0] + shift * np.sqrt(np.arange(1, 31))
    test = c.global_envelope(observed, curves[1:], alpha)
    outside = np.any((observed < test["lower"]) | (observed > test["upper"]))
    assert outside == (test["p"] <= alpha)


def test_envelope_of_a_curve_far_away_and_in_the_middle():
    curves = smooth_curves(199, np.random.default_rng(3))
    assert c.global_envelope(curves.max(axis=0) + 1, curves)["p"] == pytest.approx(1 / 200)
    assert c.global_envelope(np.median(curves, axis=0), curves)["p"] > 0.9


def test_fraction_inside():
    cloud = np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0]])
    assert c.fraction_inside(np.array([0.5, 1.0, 1.1, -0.1]), cloud) == 0.5


def test_windows_are_disjoint_centred_and_middle_first():
    image = np.arange(11 * 17).reshape(11, 17)
    windows = c.section_windows(image, (3, 5))
    assert len(windows) == 9
    values = np.concatenate([w.ravel() for w in windows])
    assert len(np.unique(values)) == len(values) == 9 * 15
    np.testing.assert_array_equal(windows[0], image[4:7, 6:11])
    np.testing.assert_array_equal(c.section_windows(image, image.shape)[0], image)


@pytest.mark.parametrize(
    ("section", "pixel", "twin", "voxel", "shape", "size"),
    [
        ((200, 300), 1.0, (80, 80, 80), 2.0, (80, 80), 2.0),
        ((50, 70), 2.0, (300, 200, 250), 1.0, (50, 70), 2.0),
        ((100, 100), 1.0, (100, 100, 100), 1.0, (100, 100), 1.0),
        ((30, 500), 1.5, (90, 90, 60), 1.5, (30, 60), 1.5),
    ],
)
def test_common_window(section, pixel, twin, voxel, shape, size):
    window = c.common_window(section, pixel, twin, voxel)
    assert (window.shape, window.pixel_size_um) == (shape, size)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 6), st.integers(0, 2**32 - 1))
def test_resampling_undoes_magnification(factor, seed):
    image = np.random.default_rng(seed).random((7, 9)) < 0.5
    fine = np.kron(image, np.ones((factor, factor), bool))
    window = c.common_window(fine.shape, 3.0 / factor, (9, 9, 9), 3.0)
    assert window.shape == image.shape
    np.testing.assert_array_equal(
        c.section_curves(fine, 3.0 / factor, window), c.section_curves(image, 3.0, window)
    )


def boolean_model(rng, shape, radius, fraction):
    """Random overlapping balls of a solid fraction, in 2D or 3D; a 3D one's slices are no 2D model."""
    from scipy.ndimage import distance_transform_edt

    volume = {2: np.pi * radius**2, 3: 4 / 3 * np.pi * radius**3}[len(shape)]
    pad = int(np.ceil(radius))
    seeds = rng.random([n + 2 * pad for n in shape]) < -np.log(1 - fraction) / volume
    near = distance_transform_edt(~seeds) < radius
    return near[tuple(slice(pad, -pad) for _ in shape)]


def test_section_of_the_same_medium_passes_and_of_another_fails():
    rng = np.random.default_rng(4)
    twins = [boolean_model(rng, (64, 64, 64), 6.0, 0.6) for _ in range(4)]
    same = boolean_model(rng, (64, 64, 64), 6.0, 0.6)[31]
    table, summary = c.compare_section(same, 1.0, twins, 1.0, 199, rng)
    assert list(table) == ["lag_um", "observed", "lower", "upper", "mean", "section"]
    assert summary["p"] > 0.05
    assert summary["n_slices"] == 200
    finer = boolean_model(rng, (64, 64, 64), 2.0, 0.6)[31]
    assert c.compare_section(finer, 1.0, twins, 1.0, 199, rng)[1]["p"] <= 0.05


def test_the_sections_own_curve_is_of_all_its_windows():
    rng = np.random.default_rng(5)
    section, twin = rng.random((32, 48)) < np.linspace(0.3, 0.9, 48), rng.random((16, 16, 16)) < 0.6
    table, summary = c.compare_section(section, 1.0, [twin], 1.0, 40, rng)
    assert summary["n_windows"] == 6
    assert table["section"][0] == pytest.approx(section.mean())
    assert table["observed"][0] == section[16:, 16:32].mean()


def test_lags_of_slices_are_micrometres():
    table = c.s2_of_slices(np.ones((8, 8, 8), bool), [(0, 3)], 2.5)
    assert table["lag_um"].tolist() == [0.0, 2.5, 5.0, 7.5, 10.0]


@pytest.mark.parametrize("axis", range(3))
def test_the_mean_of_three_axes_has_all_three(axis):
    """Layers two voxels thick: S2 across them is 1/2, 1/4, 0 ..., along them 1/2 throughout."""
    layers = np.moveaxis(np.indices((8, 8, 8))[0] // 2 % 2 == 0, 0, axis)
    lag, s2 = c.along_axes(c.s2_volume(layers, 3.0, 2, periodic=True))
    assert lag == pytest.approx([0, 3, 6])
    assert s2 == pytest.approx([1 / 2, (1 / 4 + 1) / 3, 1 / 3])


def test_windows_of_slices_lie_anywhere_in_them():
    """Solid but for a low corner: a window that always lay there would see one or the other."""
    z, y, x = np.indices((30, 30, 30))
    window = c.Window((10, 10), 1.0)
    curves = c.slice_curves(np.maximum(np.maximum(z, y), x) >= 10, 1.0, window, 60, np.random.default_rng(0))
    assert ((curves[:, 0] > 0) & (curves[:, 0] < 1)).any()
    far = c.slice_curves((z >= 20) & (y >= 20) & (x >= 20), 1.0, window, 60, np.random.default_rng(0))
    assert far[:, 0].max() > 0


def test_a_section_is_judged_by_its_middle_window_and_told_in_micrometres():
    """Eight windows as the twin's and a middle one like no slice: the mean of all would pass."""
    rng = np.random.default_rng(6)
    twin = rng.random((16, 16, 16)) < 0.6
    section = rng.random((48, 48)) < 0.6
    section[16:32, 16:32] = rng.random((16, 16)) < 0.3
    table, summary = c.compare_section(section, 2.0, [twin], 2.0, 39, rng)
    assert summary["p"] == pytest.approx(1 / 40)
    assert summary["inside"] < 0.1
    assert summary["windows_rejected"] <= 3 / 9
    assert summary["window_um"] == [32.0, 32.0]
    assert table["lag_um"].tolist() == [2.0 * lag for lag in range(9)]


def test_the_mean_is_of_the_curves_alone():
    test = c.global_envelope(np.full(3, 100.0), np.tile(np.arange(40.0)[:, None], 3))
    assert test["mean"] == pytest.approx(np.full(3, 19.5))
    assert test["n"] == 40


def test_a_section_is_judged_at_the_level_asked_for():
    rng = np.random.default_rng(8)
    twin, section = rng.random((16, 16, 16)) < 0.6, rng.random((16, 16)) < 0.6
    levels = [0.05, 0.5]
    tables = [
        c.compare_section(section, 1.0, [twin], 1.0, 39, np.random.default_rng(0), alpha)[0]
        for alpha in levels
    ]
    wide, narrow = (table["upper"] - table["lower"] for table in tables)
    assert (narrow <= wide).all()
    assert narrow.sum() < 0.8 * wide.sum()
