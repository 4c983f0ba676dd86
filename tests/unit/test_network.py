"""Pore networks: what is conserved and what must connect; topology and geometry of known shapes."""

from pathlib import Path

import numpy as np
import pytest

from grainfall import export, io, network, volume
from grainfall.errors import InputError
from grainfall.network.geometry import cross_sections

pytest.importorskip("porespy")


def dumbbell(size: int = 30, radius: float = 6.0) -> np.ndarray:
    """Two balls on the x axis, centres 14 voxels apart, overlapping only by a channel of four voxels."""
    z, y, x = np.indices((size, size, size)) + 0.5
    middle = size / 2
    ball = [(z - middle) ** 2 + (y - middle) ** 2 + (x - middle - s) ** 2 < radius**2 for s in (-7, 7)]
    channel = (abs(z - middle) < 2) & (abs(y - middle) < 2) & (abs(x - middle) < 7)
    return ball[0] | ball[1] | channel


@pytest.fixture(scope="module")
def porous() -> np.ndarray:
    """Overlapping spheres as pores, about 60 % of 32 x 36 x 40 voxels."""
    rng = np.random.default_rng(3)
    z, y, x = np.indices((32, 36, 40))
    pore = np.zeros(z.shape, bool)
    for c in rng.random((45, 3)) * z.shape:
        pore |= (z - c[0]) ** 2 + (y - c[1]) ** 2 + (x - c[2]) ** 2 < 36
    return pore


@pytest.fixture(scope="module", params=network.METHODS)
def method(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def extracted(porous, method):
    return network.extract(porous, 2.0, method, persistence=0.1)


def test_two_balls_are_two_pores_and_one_throat(method):
    pore = dumbbell()
    net = network.extract(pore, 3.0, method)
    assert len(net["pore.coords"]) == 2
    assert net["throat.conns"].tolist() == [[0, 1]]
    assert not net["pore.boundary"].any()
    middle = 15.0
    expected = 3.0 * np.array([[middle - 7, middle, middle], [middle + 7, middle, middle]])  # (x, y, z)
    assert net["pore.coords"] == pytest.approx(expected, abs=3.0)
    assert net["pore.inscribed_diameter"] == pytest.approx(36.0, abs=2 * 3.0)
    assert net["throat.inscribed_diameter"] == pytest.approx(12.0, abs=3.0)


def test_pore_volumes_add_up_to_the_pore_space(porous, extracted):
    assert extracted["pore.volume"].sum() == pytest.approx(np.count_nonzero(porous) * 8.0, rel=1e-12)


def test_unconnected_parts_stay_unconnected(method):
    from scipy.ndimage import label as components
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pore = np.random.default_rng(5).random((20, 20, 20)) < 0.3
    net = network.extract(pore, 1.0, method)
    inner = ~net["pore.boundary"]
    net = network.subnetwork(net, inner)
    n = len(net["pore.coords"])
    i, j = net["throat.conns"].T
    clusters, _ = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
    assert clusters == components(pore)[1]


def test_boundary_pores_lie_outside_their_own_face(porous, extracted):
    size = 2.0 * np.array(porous.shape[::-1])
    for axis, letter in enumerate("xyz"):
        assert (extracted["pore.coords"][extracted[f"pore.{letter}min"], axis] < 0).all()
        assert (extracted["pore.coords"][extracted[f"pore.{letter}max"], axis] > size[axis]).all()
    faces = np.sum([extracted[f"pore.{f}"] for f in network.FACES], axis=0)
    assert np.array_equal(faces, extracted["pore.boundary"].astype(int))
    inside = extracted["pore.coords"][~extracted["pore.boundary"]]
    assert ((inside > 0) & (inside < size)).all()


def test_lengths_scale_with_the_voxel(porous, extracted, method):
    other = network.extract(porous, 3.0, method)
    for name, power in network.LENGTH_POWER.items():
        assert other[name] == pytest.approx(extracted[name] * 1.5**power, rel=1e-12), name


def test_same_bytes_twice_and_back(porous, extracted, method, tmp_path):
    again = network.extract(porous, 2.0, method)
    paths = [(tmp_path / f"p{i}.csv", tmp_path / f"t{i}.csv") for i in (0, 1)]
    for net, (pores, throats) in zip((extracted, again), paths, strict=True):
        network.save(net, pores, throats)
    assert [p.read_bytes() for p in paths[0]] == [p.read_bytes() for p in paths[1]]
    back = network.load(*paths[0])
    assert back.keys() == extracted.keys()
    for name, values in extracted.items():
        assert back[name].dtype == values.dtype
        assert np.array_equal(back[name], values), name


@pytest.mark.parametrize("fill", [False, True])
@pytest.mark.parametrize("shape", [(1, 1, 1), (6, 7, 8)])
def test_nothing_to_partition_gives_an_empty_network(fill, shape, tmp_path):
    net = network.extract(np.full(shape, fill), 1.0)
    assert len(net["pore.coords"]) == len(net["throat.conns"]) == 0
    network.save(net, tmp_path / "p.csv", tmp_path / "t.csv")
    back = network.load(tmp_path / "p.csv", tmp_path / "t.csv")
    assert {k: (v.shape, v.dtype) for k, v in back.items()} == {k: (v.shape, v.dtype) for k, v in net.items()}
    assert network.summarise(net)["n"].tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize("shape", [(1, 1, 7), (1, 6, 5), (2, 2, 2), (3, 2, 1)])
def test_tiny_volumes(shape, method):
    pore = np.random.default_rng(1).random(shape) < 0.6
    pore.flat[0], pore.flat[-1] = True, False
    net = network.extract(pore, 1.0, method)
    assert net["pore.volume"].sum() == pytest.approx(pore.sum())


def test_openpnm_network_is_in_metres_and_keeps_the_measured_lengths(extracted):
    pytest.importorskip("openpnm")
    pn = network.to_openpnm(extracted)
    assert pn["pore.coords"] == pytest.approx(extracted["pore.coords"] * 1e-6)
    pn.regenerate_models()
    assert pn["throat.spacing"] == pytest.approx(extracted["throat.total_length"] * 1e-6)
    assert pn["pore.volume"].sum() == pytest.approx(extracted["pore.volume"].sum() * 1e-18)
    assert np.array_equal(pn.pores("xmin"), np.flatnonzero(extracted["pore.xmin"]))


def test_openpnm_reads_the_csv_back(extracted, tmp_path):
    openpnm = pytest.importorskip("openpnm")
    network.save_openpnm(extracted, tmp_path / "network.csv")
    assert [file.name for file in tmp_path.iterdir()] == ["network.csv"]
    looped = {
        name: np.append(v, v[:1], axis=0) if name.startswith("throat.") else v
        for name, v in extracted.items()
    }
    looped["throat.conns"][-1] = 3  # from a pore to itself: OpenPNM's models refuse such
    network.save_openpnm(looped, tmp_path / "network.csv")
    back, expected = openpnm.io.network_from_csv(tmp_path / "network.csv"), network.to_openpnm(extracted)
    assert np.array_equal(back["throat.conns"], extracted["throat.conns"])
    for name in extracted:
        np.testing.assert_allclose(back[name], expected[name], rtol=1e-12)


def test_openpnm_reads_back_pores_that_outnumber_the_throats(tmp_path):
    """Isolated ones, as of tight rocks; boundary pores stand last."""
    openpnm = pytest.importorskip("openpnm")
    pore = np.zeros((12, 30, 30), bool)
    pore[4:8, 2:28:6, 2:28:6] = pore[:, 14:16, 14:16] = True
    found = network.extract(pore, 2.0)
    assert len(found["pore.coords"]) > len(found["throat.conns"]) > 0
    network.save_openpnm(found, tmp_path / "network.csv")
    back = openpnm.io.network_from_csv(tmp_path / "network.csv")
    assert back.Np == len(found["pore.coords"])
    assert np.array_equal(back["throat.conns"], found["throat.conns"])
    assert np.array_equal(back["pore.boundary"].astype(bool), found["pore.boundary"])
    np.testing.assert_allclose(back["pore.coords"], found["pore.coords"] * 1e-6, rtol=1e-12)


def test_every_throat_is_counted_at_both_ends(extracted):
    numbers = network.coordination_numbers(extracted)
    assert numbers.sum() == 2 * len(extracted["throat.conns"])


def test_sizes_of_two_balls_and_a_speck():
    pore = dumbbell()
    pore[2, 2, 2] = True
    net = network.extract(pore, 3.0)
    assert len(net["pore.coords"]) == 3
    sizes = network.element_sizes(net)
    assert sizes["coordination"].tolist() == [1, 1]
    assert sizes["pore_radius_um"] == pytest.approx([18, 18], abs=3)
    assert sizes["throat_radius_um"] == pytest.approx([6], abs=1.5)
    assert sizes["pore_volume_um3"].sum() == pytest.approx((pore.sum() - 1) * 27)
    assert network.summarise(net).set_index("element").loc["coordination", "mean"] == 1


def test_crevices_that_hold_nothing_change_no_pore_size():
    """By number they would be nine pores of ten."""
    pores = {"pore_radius_um": np.array([10.0, 20.0]), "pore_volume_um3": np.array([1.0, 3.0])}
    crevices = {"pore_radius_um": np.full(18, 1.0), "pore_volume_um3": np.full(18, 1e-9)}
    both = {key: np.append(pores[key], crevices[key]) for key in pores}
    assert network.mean_pore_radius(pores) == 17.5
    assert network.mean_pore_radius(both) == pytest.approx(17.5)
    assert network.pore_radius_quantile(both, 0.2) == 10
    assert network.pore_radius_quantile(both, 0.3) == 20
    assert network.pore_volume_below(both, [0, 9.9, 10, 20]) == pytest.approx([0, 0, 0.25, 1], abs=1e-6)
    assert network.pore_size_distance(pores, pores) == 0
    assert network.pore_size_distance(both, pores) == pytest.approx(0, abs=1e-6)
    # all volume moves by one: so does the distance, either way
    moved = pores | {"pore_radius_um": pores["pore_radius_um"] + 1}
    assert network.pore_size_distance(moved, pores) == pytest.approx(1)
    # a quarter of the volume lies ten further out
    assert network.pore_size_distance(pores, {**pores, "pore_volume_um3": np.ones(2)}) == pytest.approx(2.5)
    assert network.pore_size_distance(pores, {key: np.empty(0) for key in pores}) is None


def test_a_speck_on_the_watershed_links_nothing(method):
    # PoreSpy floods through the solid: a closed part without a marker would belong to both sides, a link
    pore = dumbbell(radius=6.0)
    pore[:, :, 14:16] = False
    alone = network.extract(pore, 1.0, method)
    pore[12:18, 12:18, 14:16] = False
    pore[21:23, 14:16, 12:18] = True
    net = network.extract(pore, 1.0, method)
    assert len(alone["throat.conns"]) == len(net["throat.conns"]) == 0


def test_mistakes_are_named(tmp_path):
    with pytest.raises(InputError, match="unknown method"):
        network.extract(np.ones((3, 3, 3)), 1.0, method="magic")
    with pytest.raises(InputError, match="volume"):
        network.extract(np.ones((3, 3)), 1.0)
    (tmp_path / "p.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match=r"pore\.coords"):
        network.load(tmp_path / "p.csv", tmp_path / "p.csv")


# ---- topology: components and loops of the pore space, whatever the partition


def tube(path: np.ndarray, radius: float, shape: tuple[int, int, int]) -> np.ndarray:
    """Voxels nearer to a path (n, 3) than the radius."""
    from scipy.ndimage import distance_transform_edt

    away = np.ones(shape, bool)
    away[tuple(np.round(path).astype(int).T)] = False
    return distance_transform_edt(away) < radius


def trefoil() -> np.ndarray:
    """A knotted tube: as a space one loop, like the torus."""
    t = np.linspace(0, 2 * np.pi, 4000)
    path = np.stack([-np.sin(3 * t), np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t)], axis=1)
    return tube(path * [8, 8, 8] + [13, 30, 30], 3.2, (27, 60, 60))


def lattice(n: int, width: int = 3, pitch: int = 9) -> np.ndarray:
    """Three sets of n x n square ducts that cross: a cubic lattice with its ends open."""
    size = n * pitch
    line = np.arange(size) % pitch < width
    z, y, x = line[:, None, None], line[None, :, None], line[None, None, :]
    return (z & y) | (z & x) | (y & x)


def balls(centres: list[tuple[float, float, float]], radius: float, shape: tuple) -> np.ndarray:
    z, y, x = np.indices(shape)
    return np.any([(z - c) ** 2 + (y - b) ** 2 + (x - a) ** 2 < radius**2 for a, b, c in centres], axis=0)


def blobs(seed: int, n: int = 48) -> np.ndarray:
    from scipy.ndimage import gaussian_filter

    field = gaussian_filter(np.random.default_rng(seed).standard_normal((n, n, n)), 1.5)
    return field > np.quantile(field, 0.6)


def shapes() -> dict[str, tuple[np.ndarray, tuple[int, int, int] | None]]:
    """Pore spaces and, where known, their components, loops and cavities."""
    z, y, x = np.indices((40, 40, 40)) - 19.5
    r = np.sqrt(z**2 + y**2 + x**2)
    torus = np.hypot(np.hypot(z, y) - 12, x) < 4.3
    n = 3
    loops = 3 * n * n * (n - 1) - n**3 + 1
    rng = np.random.default_rng(4)
    return {
        "ball": (r < 15, (1, 0, 0)),
        "hollow ball": ((r < 15) & (r > 7), (1, 0, 1)),
        "ball in a shell": ((r < 15) & ((r > 9) | (r < 5)), (2, 0, 1)),
        "torus": (torus, (1, 1, 0)),
        "two linked rings": (
            tube(
                np.array([[12, 12 + 8 * np.cos(t), 14 + 8 * np.sin(t)] for t in np.linspace(0, 7, 900)]),
                2,
                (26, 26, 40),
            )
            | tube(
                np.array([[12 + 8 * np.cos(t), 12, 24 + 8 * np.sin(t)] for t in np.linspace(0, 7, 900)]),
                2,
                (26, 26, 40),
            ),
            (2, 2, 0),
        ),
        "trefoil": (trefoil(), (1, 1, 0)),
        "lattice": (lattice(n), (1, loops, 0)),
        "hollow torus": (torus & ~(np.hypot(np.hypot(z, y) - 12, x) < 2.1), (1, 2, 1)),
        "noise": (rng.random((12, 13, 14)) < 0.5, None),
        "dense noise": (rng.random((12, 13, 14)) < 0.8, None),
        "blobs": (blobs(7), None),
    }


@pytest.mark.parametrize("name", shapes())
@pytest.mark.parametrize("persistence", [0.0, 0.1, 0.6])
def test_network_has_the_components_and_loops_of_the_pore_space(name, persistence):
    pore, known = shapes()[name]
    counted = network.pore_betti_numbers(pore)
    if known is not None:
        assert counted == known
    net = network.extract(pore, 1.0, persistence=persistence)
    assert network.betti_numbers(net) == counted[:2]


def test_berea_keeps_its_topology(shared_data):
    import tifffile

    pore = tifffile.imread(shared_data / "berea" / "berea_400_pore1.tif")[:100, 50:150, 100:200] == 1
    net = network.extract(pore, 5.345)
    assert network.betti_numbers(net) == network.pore_betti_numbers(pore)[:2]


def test_a_pore_that_is_a_ring_has_a_throat_to_itself():
    torus, _ = shapes()["torus"]
    net = network.extract(torus, 1.0)
    assert net["throat.conns"].tolist() == [[0, 0]]
    assert net["throat.cross_sectional_area"][0] == pytest.approx(np.pi * 4.3**2, rel=0.15)
    assert network.coordination_numbers(net).tolist() == [0]  # none of them leads to another pore
    assert not any(len(sizes) for sizes in network.element_sizes(net).values())


def test_two_channels_between_two_balls_are_two_throats_and_a_loop():
    pore = balls([(10, 12, 12), (32, 12, 12)], 9.5, (24, 24, 44))
    for y in (6, 17):
        pore[11:14, y : y + 3, 8:34] = True
    net = network.extract(pore, 1.0)
    assert net["throat.conns"].tolist() == [[0, 1], [0, 1]]
    assert not net["throat.disc_bounding"].any()
    assert network.betti_numbers(net) == (1, 1)


def test_three_balls_that_meet_bound_a_disc_unless_there_is_a_hole():
    corners = [(20 + 9 * np.cos(t), 20 + 9 * np.sin(t), 16) for t in np.arange(3) * 2 * np.pi / 3]
    met = balls(corners, 9.6, (33, 40, 40))
    whole = network.extract(met, 1.0)
    assert sorted(whole["throat.conns"].tolist()) == [[0, 1], [0, 2], [1, 2]]
    assert whole["throat.disc_bounding"].sum() == 1  # all three conduct, and one closes no loop of the space
    met[:, 18:23, 18:23] = False
    holed = network.extract(met, 1.0)
    assert sorted(holed["throat.conns"].tolist()) == [[0, 1], [0, 2], [1, 2]]
    assert not holed["throat.disc_bounding"].any()


# ---- the partition


def test_pores_do_not_depend_on_threads():
    pore = blobs(2)
    first, again = (network.extract(pore, 1.0, threads=n) for n in (1, 2))
    assert all(np.array_equal(first[name], again[name]) for name in first)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("order", [(2, 0, 1), (0, 2, 1)])
def test_pores_do_not_depend_on_the_order_of_the_axes(seed, order):
    pore = blobs(seed)
    parts = network.partition(pore)
    turned = network.partition(np.ascontiguousarray(pore.transpose(order)))
    assert turned.peaks.size == parts.peaks.size
    # boundaries where they were: numbers may differ
    both = np.stack([parts.labels.transpose(order).ravel(), turned.labels.ravel()])
    pairs, voxels = np.unique(both[:, pore.transpose(order).ravel()], axis=1, return_counts=True)
    moved = pore.sum() - sum(voxels[pairs[0] == label].max() for label in np.unique(pairs[0]))
    assert moved < 1e-3 * pore.sum()
    first, other = (network.measure(p, network.find_interfaces(p), 1.0) for p in (parts, turned))
    assert len(other["throat.conns"]) == pytest.approx(len(first["throat.conns"]), rel=0.005)
    for name in ("pore.volume", "throat.cross_sectional_area", "throat.total_length"):
        assert other[name].sum() == pytest.approx(first[name].sum(), rel=0.002), name


def test_magnification_changes_no_number():
    small = balls([(9, 10, 10), (19, 10, 10), (28, 12, 10)], 7.2, (20, 22, 38))
    large = np.kron(small, np.ones((3, 3, 3), bool))
    one, other = (network.extract(p, 1.0) for p in (small, large))
    assert other["throat.conns"].tolist() == one["throat.conns"].tolist()


def test_pores_fall_with_persistence():
    counts = [network.partition(blobs(1), persistence=h).peaks.size for h in (0, 0.2, 0.4, 0.8)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1]
    with pytest.raises(InputError, match=r"network\.persistence"):
        network.extract(blobs(1), 1.0, persistence=1.0)


def test_partition_covers_the_pore_space_with_connected_pores():
    from scipy.ndimage import label

    pore = blobs(3)
    parts = network.partition(pore)
    assert np.array_equal(parts.labels > 0, pore)
    assert all(label(parts.labels == i)[1] == 1 for i in range(1, parts.peaks.size + 1))
    radius = parts.squared_distance.ravel()[parts.peaks]
    assert (np.diff(radius.astype(int)) <= 0).all()


# ---- geometry


def test_a_ball_is_measured():
    pore = balls([(20, 20, 20)], 15.3, (41, 41, 41))
    net = network.extract(pore, 2.0)
    assert net["pore.coords"] == pytest.approx(np.full((1, 3), 41.0))
    assert net["pore.surface_area"][0] == pytest.approx(4 * np.pi * 30.6**2, rel=0.04)
    assert net["pore.inscribed_diameter"][0] == pytest.approx(61.2, abs=2)
    assert net["pore.shape_factor"][0] == pytest.approx(1 / (6 * np.pi), rel=0.05)


@pytest.mark.parametrize("normal", [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0.5, 0.2)])
@pytest.mark.parametrize("section", ["circle", "square"])
def test_throat_across_any_direction(normal, section):
    """A straight neck between two widenings: area, perimeter and shape factor of its section."""
    n = np.array(normal) / np.linalg.norm(normal)
    u = np.cross(n, [0.3, 0.2, 0.9])
    u /= np.linalg.norm(u)
    place = np.indices((56, 56, 56)).reshape(3, -1).T - 27.4
    along, a, b = place @ n, place @ u, place @ np.cross(n, u)
    reach = 6 * (1 + np.maximum(0, abs(along) - 3) / 14)
    across = np.hypot(a, b) if section == "circle" else np.maximum(abs(a), abs(b))
    pore = ((across < reach) & (abs(along) < 22)).reshape(56, 56, 56)
    net = network.extract(pore, 1.0)
    area, perimeter = (np.pi * 36, np.pi * 12) if section == "circle" else (144, 48)
    neck = net["throat.cross_sectional_area"].argmax()  # corners of the ends may be pores of their own
    assert net["throat.conns"][neck].tolist() == [0, 1]
    assert net["throat.cross_sectional_area"][neck] == pytest.approx(area, rel=0.08)
    assert net["throat.perimeter"][neck] == pytest.approx(perimeter, rel=0.08)
    assert net["throat.shape_factor"][neck] == pytest.approx(area / perimeter**2, rel=0.1)
    assert net["throat.inscribed_diameter"][neck] == pytest.approx(12, abs=2)
    assert net["throat.half_lengths"][neck].sum() == pytest.approx(net["throat.total_length"][neck])


def test_openings_of_a_duct():
    pore = np.zeros((20, 24, 30), bool)
    pore[4:14, 5:17] = True
    net = network.extract(pore, 1.0)
    assert network.coordination_numbers(net).tolist() == [2, 1, 1]
    assert net["pore.xmin"].sum() == net["pore.xmax"].sum() == 1
    assert net["pore.boundary"].sum() == 2
    assert net["throat.cross_sectional_area"] == pytest.approx([120, 120])
    assert net["throat.perimeter"] == pytest.approx([44, 44], rel=0.12)  # Sobel rounds four corners
    assert net["throat.total_length"].sum() == pytest.approx(30 + 1, abs=1)


# ---- files of other programs


def test_statoil_files(porous, tmp_path):
    pytest.importorskip("openpnm")
    import openpnm

    net = network.extract(porous, 2.0)
    size = tuple(2.0 * n for n in porous.shape[::-1])
    network.save_statoil(net, tmp_path / "rock", size)
    back = openpnm.io.network_from_statoil(path=tmp_path, prefix="rock")
    inner = ~net["pore.boundary"]
    n = inner.sum()
    assert (tmp_path / "rock_node1.dat").read_text().split()[0] == str(n)
    assert back["pore.coords"][:n] == pytest.approx(net["pore.coords"][inner] * 1e-6, rel=1e-5)
    conns = net["throat.conns"]
    known = inner | net["pore.xmin"] | net["pore.xmax"]
    through = known[conns].all(axis=1) & (conns[:, 0] != conns[:, 1])
    rows = np.loadtxt(tmp_path / "rock_link1.dat", skiprows=1)
    assert len(rows) == through.sum()
    assert (rows[:, 2] == -1).sum() == net["pore.xmin"].sum()
    assert (rows[:, 2] == 0).sum() == net["pore.xmax"].sum()
    assert rows[:, 3] == pytest.approx(net["throat.inscribed_diameter"][through] / 2 * 1e-6, rel=1e-5)
    lengths = np.loadtxt(tmp_path / "rock_link2.dat")[:, 3:6]
    assert (lengths >= 0).all()
    assert lengths.sum(axis=1) == pytest.approx(rows[:, 5], rel=1e-4)
    volumes = np.loadtxt(tmp_path / "rock_node2.dat")[:, 1]
    assert volumes.sum() == pytest.approx(np.count_nonzero(porous) * 8e-18, rel=1e-4)


def test_statoil_box_is_what_the_network_was_measured_on(porous, tmp_path):
    """Of 25 voxels joined in fours the network has 24."""
    phase = (~porous[:25, :25, :25]).astype(np.uint8)
    io.write_volume(tmp_path / "twin.zarr.zip", {"phase": phase}, 2.0, {"phases": ["pore", "solid"]})
    pore, size = volume.coarsen(phase == 0, 2.0, 4)
    network.save(
        network.extract(pore, size), tmp_path / "network_pores.csv", tmp_path / "network_throats.csv"
    )
    twin = export.Twin(tmp_path, tmp_path, coarsen=4)
    export.export_twin(twin, tmp_path, ["statoil"])
    box = (tmp_path / "network_node1.dat").read_text().split()[1:4]
    assert [float(side) for side in box] == pytest.approx([24 * 2e-6] * 3)


def test_vtp(extracted, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    network.save_vtp(extracted, tmp_path / "net.vtp")
    back = pyvista.read(tmp_path / "net.vtp")
    assert np.asarray(back.points) == pytest.approx(extracted["pore.coords"])
    assert np.array_equal(back.lines.reshape(-1, 3)[:, 1:], extracted["throat.conns"])
    assert np.array_equal(back.point_data["pore.volume"], extracted["pore.volume"])
    assert np.array_equal(back.cell_data["throat.half_lengths"], extracted["throat.half_lengths"])
    network.save_vtp(network.empty(), tmp_path / "nothing.vtp")
    assert pyvista.read(tmp_path / "nothing.vtp").n_points == 0


@pytest.mark.parametrize(
    ("name", "writer"), [("openpnm", "pandas.DataFrame.to_csv"), ("vtp", "pyvista.PolyData.save")]
)
def test_a_network_half_written_leaves_nothing(tmp_path, monkeypatch, name, writer):
    def full(*arguments, **keywords):
        Path(keywords.get("filename") or arguments[-1]).write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writer, full)
    with pytest.raises(OSError, match="No space left"):
        getattr(network, f"save_{name}")(network.empty(), tmp_path / f"net.{name}")
    assert list(tmp_path.iterdir()) == []


def test_a_pore_of_one_voxel_is_measured():
    """Its wall is its six faces, its length its edge, its sphere that of its volume."""
    pore = np.zeros((7, 7, 7), bool)
    pore[3, 3, 3] = True
    net = network.extract(pore, 2.0)
    assert net["pore.surface_area"] == pytest.approx([6 * 2**2])
    assert net["pore.shape_factor"] == pytest.approx([1 / 36])
    assert net["pore.equivalent_diameter"] == pytest.approx([2 * (6 / np.pi) ** (1 / 3)])


def test_openings_are_no_pores_and_lengths_go_from_pore_to_pore(porous):
    net = network.extract(porous, 2.0)
    inner = ~net["pore.boundary"]
    linked = inner & (network.coordination_numbers(net) > 0)
    assert len(network.element_sizes(net)["pore_radius_um"]) == linked.sum() < inner.size
    ends = net["pore.coords"][net["throat.conns"]]
    assert net["throat.direct_length"] == pytest.approx(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))
    area = net["throat.cross_sectional_area"]
    assert np.pi / 4 * net["throat.equivalent_diameter"] ** 2 == pytest.approx(area)
    for kind in ("pore", "throat"):
        assert (net[f"{kind}.shape_factor"] <= (1 + 1e-9) / (4 * np.pi)).all()


def test_pores_are_as_wide_as_the_whole_pore_space_lets_them():
    net = network.extract(dumbbell(), 1.0)
    sizes = network.element_sizes(net | {"pore.inscribed_diameter": net["pore.inscribed_diameter"] / 2})
    assert sizes["pore_radius_um"] == pytest.approx(network.element_sizes(net)["pore_radius_um"])


def test_the_interface_about_an_enclosed_pore_has_the_area_of_its_shadow():
    """The faces of a ball of voxels: those across each axis cover its disc twice."""
    ball = balls([(20, 20, 20)], 15.3, (41, 41, 41))
    faces = sum(np.count_nonzero(np.diff(ball.astype(int), axis=axis)) for axis in range(3))
    area, _ = cross_sections(np.zeros((1, 3)), np.array([float(faces)]))
    assert area == pytest.approx([np.pi * 15.3**2], rel=0.02)


@pytest.mark.parametrize(("persistence", "pores"), [(0.3, 2), (0.5, 1)])
def test_a_neck_is_held_against_the_radius_of_the_pore(persistence, pores):
    """Balls of radius 12 that meet in a neck of radius 7: it narrows by 0.42 of theirs, 0.71 of its own."""
    pore = balls([(16, 16, 16), (36, 16, 16)], 12.2, (33, 33, 53))
    assert len(network.extract(pore, 1.0, persistence=persistence)["pore.coords"]) == pores


def test_statoil_tells_pores_from_throats(porous, tmp_path):
    net = network.extract(porous, 2.0)
    network.save_statoil(net, tmp_path / "rock", (80.0, 72.0, 64.0))
    inner = ~net["pore.boundary"]
    radius = np.loadtxt(tmp_path / "rock_node2.dat")[:, 2]
    assert radius == pytest.approx(net["pore.inscribed_diameter"][inner] / 2 * 1e-6, rel=1e-5)
    conns = net["throat.conns"]
    known = inner | net["pore.xmin"] | net["pore.xmax"]
    through = known[conns].all(axis=1) & (conns[:, 0] != conns[:, 1])
    # the first pore, the second, and the throat between
    lengths = network.conduit_lengths(net)[through][:, [0, 2, 1]] * 1e-6
    assert np.loadtxt(tmp_path / "rock_link2.dat")[:, 3:6] == pytest.approx(lengths, rel=1e-5)


def test_percentiles_rise(porous):
    table = network.summarise(network.extract(porous, 1.0))
    assert (table["p10"] < table["p90"]).all()
