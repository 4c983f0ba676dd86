"""Pore networks: what is conserved, what must connect and what must not."""

import numpy as np
import pytest

from grainfall import network
from grainfall.errors import InputError

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


@pytest.fixture(scope="module")
def extracted(porous):
    return network.extract(porous, 2.0)


def test_two_balls_are_two_pores_and_one_throat():
    pore = dumbbell()
    net = network.extract(pore, 3.0)
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


def test_unconnected_parts_stay_unconnected():
    from scipy.ndimage import label as components
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pore = np.random.default_rng(5).random((20, 20, 20)) < 0.3
    net = network.extract(pore, 1.0)
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


def test_lengths_scale_with_the_voxel(porous, extracted):
    other = network.extract(porous, 3.0)
    for name, power in network.LENGTH_POWER.items():
        assert other[name] == pytest.approx(extracted[name] * 1.5**power, rel=1e-12), name


def test_same_bytes_twice_and_back(porous, extracted, tmp_path):
    again = network.extract(porous, 2.0)
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
    assert network.summarise(net)["n"].tolist() == [0, 0, 0]


@pytest.mark.parametrize("shape", [(1, 1, 7), (1, 6, 5), (2, 2, 2), (3, 2, 1)])
def test_tiny_volumes(shape):
    pore = np.random.default_rng(1).random(shape) < 0.6
    pore.flat[0], pore.flat[-1] = True, False
    net = network.extract(pore, 1.0)
    assert net["pore.volume"].sum() == pytest.approx(pore.sum())


def test_openpnm_network_is_in_metres_and_keeps_the_measured_lengths(extracted):
    pytest.importorskip("openpnm")
    pn = network.to_openpnm(extracted)
    assert pn["pore.coords"] == pytest.approx(extracted["pore.coords"] * 1e-6)
    pn.regenerate_models()
    assert pn["throat.spacing"] == pytest.approx(extracted["throat.total_length"] * 1e-6)
    assert pn["pore.volume"].sum() == pytest.approx(extracted["pore.volume"].sum() * 1e-18)
    assert np.array_equal(pn.pores("xmin"), np.flatnonzero(extracted["pore.xmin"]))


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
    assert network.summarise(net).set_index("element").loc["coordination", "mean"] == 1


def test_a_speck_on_the_watershed_links_nothing():
    # PoreSpy floods through the solid: a closed part without a marker would belong to both sides, a link
    pore = dumbbell(radius=6.0)
    pore[:, :, 14:16] = False
    alone = network.extract(pore, 1.0)
    pore[12:18, 12:18, 14:16] = False
    pore[21:23, 14:16, 12:18] = True
    net = network.extract(pore, 1.0)
    assert len(alone["throat.conns"]) == len(net["throat.conns"]) == 0


def test_mistakes_are_named(tmp_path):
    with pytest.raises(InputError, match="unknown method"):
        network.extract(np.ones((3, 3, 3)), 1.0, method="magic")
    with pytest.raises(InputError, match="volume"):
        network.extract(np.ones((3, 3)), 1.0)
    (tmp_path / "p.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match=r"pore\.coords"):
        network.load(tmp_path / "p.csv", tmp_path / "p.csv")
