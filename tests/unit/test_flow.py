"""Permeability: ducts with known solutions, invariants, and volumes through which nothing flows."""

import numpy as np
import pytest
from scipy import ndimage

from grainfall import flow, network
from grainfall.errors import InputError
from grainfall.units import MILLIDARCY_M2

SQUARE_DUCT = 0.0351443
"""Flow rate of a square duct over side^4 times pressure gradient over viscosity (series solution)."""


def um2(k_md):
    """From millidarcy to square micrometres."""
    return np.asarray(k_md) * MILLIDARCY_M2 * 1e12


def duct(width: int, length: int, shape: tuple[int, int], corner: tuple[int, int] = (2, 2)) -> np.ndarray:
    """A straight square duct along x."""
    pore = np.zeros((*shape, length), bool)
    pore[corner[0] : corner[0] + width, corner[1] : corner[1] + width] = True
    return pore


def serpentine(length: int, width: int, rows: int) -> np.ndarray:
    """A square duct from face to face along y that goes to and fro along x, with walls of two voxels."""
    pitch = width + 2
    pore = np.zeros((width + 2, rows * pitch, length + 2 * width), bool)
    inside, (left, right) = slice(1, 1 + width), ((1, 1 + width), (length - 1, length - 1 + width))
    for row in range(rows):
        across = slice(1 + row * pitch, 1 + row * pitch + width)
        pore[inside, across, left[0] : right[1]] = True
        turn = right if row % 2 == 0 else left
        pore[inside, across.start : across.stop + pitch, slice(*turn)] = True
    pore[inside, 0, slice(*left)] = True
    return pore


def chain(diameter: float, spacing: float, n: int) -> network.Network:
    """``n`` pores in a row along x, as wide as their throats: a straight duct of square section."""
    net = network.empty()
    net["pore.coords"] = np.outer(np.arange(n), [spacing, 0, 0])
    net["throat.conns"] = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    for name in list(net):
        if name.endswith("_diameter"):
            net[name] = np.full(n if name.startswith("pore.") else n - 1, diameter)
        elif name in ("pore.volume", "pore.surface_area"):
            net[name] = np.zeros(n)
        elif name == "throat.coords":
            net[name] = net["pore.coords"][:-1] + np.array([spacing / 2, 0, 0])
        elif name == "throat.half_lengths":
            net[name] = np.full((n - 1, 2), spacing / 2)
        elif name.endswith(".shape_factor"):
            net[name] = np.full(n if name.startswith("pore.") else n - 1, 1 / 16)
        elif name.startswith("throat.") and name != "throat.conns":
            net[name] = np.full(n - 1, spacing)
    for name in ("boundary", *network.FACES):
        net[f"pore.{name}"] = np.zeros(n, bool)
    net["throat.disc_bounding"] = np.zeros(n - 1, bool)
    net["pore.xmin"][0] = net["pore.xmax"][-1] = True
    net["pore.boundary"][[0, -1]] = True
    return net


class TestNetworkOfKnownConductance:
    def test_straight_chain_is_a_duct(self):
        pytest.importorskip("openpnm")
        diameter, spacing, n = 3.0, 10.0, 6
        length = spacing * (n - 1)
        hydraulic, electrical = flow.conductances(chain(diameter, spacing, n), "x", "pyramids")
        # OpenPNM's cuboid: A^2 / (16 pi^2 I L) with I = 1/6, 8 % above the square duct's exact solution
        assert hydraulic == pytest.approx(6 / (16 * np.pi**2) * diameter**4 / length, rel=1e-9)
        assert hydraulic == pytest.approx(SQUARE_DUCT * diameter**4 / length, rel=0.09)
        assert electrical == pytest.approx(diameter**2 / length, rel=1e-9)

    @pytest.mark.parametrize(
        ("shape_factor", "area", "rate"),
        [
            (1 / (4 * np.pi), np.pi / 4, np.pi / 128),
            (1 / 16, 1.0, SQUARE_DUCT),
            (3**0.5 / 36, 27**0.5 / 4, 3**0.5 / 320 * 3**2),
        ],
        ids=["circle", "square", "equilateral triangle"],
    )
    def test_ducts_by_their_shape_factors(self, shape_factor, area, rate):
        """Area and flow rate of the duct about a circle of unit diameter."""
        diameter, spacing, n = 3.0, 10.0, 6
        net = chain(diameter, spacing, n)
        net["pore.shape_factor"][:] = net["throat.shape_factor"][:] = shape_factor
        length = spacing * (n - 1)
        hydraulic, electrical = flow.conductances(net, "x")
        assert hydraulic == pytest.approx(rate * diameter**4 / length, rel=1e-4)
        assert electrical == pytest.approx(area * diameter**2 / length, rel=1e-9)

    def test_clusters_that_miss_a_face_do_not_conduct(self):
        net = chain(3.0, 10.0, 6)
        assert flow.conductances(net, "y") == (0.0, 0.0)
        net["pore.xmax"][:] = False
        assert flow.conductances(net, "x") == (0.0, 0.0)


NETWORKS = {
    "local": ("persistence", "local", 0.07, 1e-4),
    "shape_factor": ("persistence", "shape_factor", 0.2, 1e-6),
    "snow2": ("snow2", "pyramids", 0.25, 1e-6),
}
"""Extraction, conductance, how well it knows ducts 12 and 16 voxels wide, and how far its solution goes.

A disc of voxels has 3 % more area than the circle, inscribed circles are known to half a voxel, and snow2
makes one long pore of a duct."""


@pytest.fixture(params=NETWORKS, scope="module")
def through(request):
    """Permeability by a network, its accuracy, and that of its solution."""
    extraction, conductance, accuracy, solution = NETWORKS[request.param]
    if extraction == "snow2":
        pytest.importorskip("porespy")
        pytest.importorskip("openpnm")

    def measure(pore, voxel_um=1.0):
        found = network.extract(pore, voxel_um, extraction)
        return flow.permeability(pore, voxel_um, conductance=conductance, network=found)

    return measure, accuracy, solution


class TestVoxelDucts:
    @pytest.fixture(scope="class")
    @staticmethod
    def straight(through):
        return through[0](duct(12, 40, (28, 16)))

    def test_known_permeability_and_formation_factor(self, straight, through):
        along = straight.set_index("axis").loc["x"]
        assert um2(along["k_md"]) == pytest.approx(SQUARE_DUCT * 12**4 / (28 * 16), rel=through[1])
        assert along["formation_factor"] == pytest.approx(28 * 16 / 12**2, rel=through[1])

    def test_across_nothing_flows(self, straight):
        across = straight.set_index("axis").loc[["y", "z"]]
        assert (across["k_md"] == 0).all()
        assert across["formation_factor"].isna().all()

    def test_circular_tube(self, through):
        across = np.arange(20) - 9.5
        disc = across[:, None] ** 2 + across**2 < 8**2
        k = um2(through[0](np.repeat(disc[:, :, None], 40, axis=2))["k_md"][0])
        assert k == pytest.approx(np.pi * 8**4 / 8 / 20**2, rel=through[1])

    def test_two_ducts_carry_twice_as_much(self, straight, through):
        one = duct(12, 40, (56, 16))
        two = one | duct(12, 40, (56, 16), corner=(30, 2))
        k = [through[0](p)["k_md"][0] for p in (one, two)]
        assert k[1] == pytest.approx(2 * k[0], rel=through[2])
        assert k[1] == pytest.approx(straight["k_md"][0], rel=through[2])

    def test_turned_duct_turns_the_answer(self, straight, through):
        turned = through[0](np.moveaxis(duct(12, 40, (28, 16)), (0, 1, 2), (2, 1, 0)))
        assert turned["k_md"].tolist() == pytest.approx(straight["k_md"].tolist()[::-1], rel=through[2])

    def test_permeability_scales_with_the_square_of_the_voxel(self, straight, through):
        larger = through[0](duct(12, 40, (28, 16)), 3.0)
        assert larger["k_md"].tolist() == pytest.approx((9 * straight["k_md"]).tolist(), rel=1e-9)
        assert larger["formation_factor"][0] == pytest.approx(straight["formation_factor"][0], rel=1e-9)

    def test_an_isolated_pore_changes_nothing(self, straight, through):
        pore = duct(12, 40, (28, 16))
        pore[18:24, 5:11, 10:16] = True
        assert through[0](pore)["k_md"].tolist() == pytest.approx(straight["k_md"].tolist(), rel=through[2])

    def test_a_plug_stops_the_flow(self, through):
        pore = duct(12, 40, (16, 16))
        pore[:, :, 20] = False
        table = through[0](pore)
        assert (table["k_md"] == 0).all()
        assert table["formation_factor"].isna().all()


@pytest.mark.parametrize("method", flow.METHODS)
@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 3, 1), (9, 8, 7)])
def test_all_solid_and_all_pore(method, shape):
    solid = flow.permeability(np.zeros(shape, bool), 1.0, method)
    assert (solid["k_md"] == 0).all()
    assert solid["formation_factor"].isna().all()
    void = flow.permeability(np.ones(shape, bool), 1.0, method)
    assert void["k_md"].isna().all()
    assert (void["formation_factor"] == 1).all()
    assert void["axis"].tolist() == ["x", "y", "z"]


def test_a_duct_that_winds_conducts_by_its_length_not_by_its_extent():
    """One pore of rows side by side, which blocks of voxels join where nothing flows."""
    pore = serpentine(60, 4, 9)
    network, elliptic, direct = (
        flow.permeability(pore, 1.0, method).set_index("axis").loc["y"]
        for method in ("network", "elliptic", "direct")
    )
    assert network["formation_factor"] == pytest.approx(elliptic["formation_factor"], rel=0.01)
    assert network["k_md"] == pytest.approx(direct["k_md"], rel=0.05)


def test_a_duct_too_long_for_single_precision_is_refused(monkeypatch):
    monkeypatch.setattr("grainfall.flow.multiport.SINGLE", 1e-3)
    with pytest.raises(InputError, match="winds too far"):
        flow.permeability(serpentine(60, 4, 9), 1.0, "network")


class TestEstimate:
    def test_kozeny_carman_of_a_bed_of_cubes(self):
        # cubes of edge a, one per (2a)^3, apart: phi = 7/8, true surface of the faces 6 a^2
        a, n = 4, 3
        unit = np.ones((2 * a, 2 * a, 2 * a), bool)
        unit[2 : a + 2, 2 : a + 2, 2 : a + 2] = False
        pore = np.tile(unit, (n, n, n))
        # seen at 23 steps of 24 voxels
        surface = 24 / 23 * 2 / 3 * 6 * a**2 / (2 * a) ** 3
        table = flow.permeability(pore, 1.0, "estimate")
        assert um2(table["k_md"]) == pytest.approx([(7 / 8) ** 3 / (5 * surface**2)] * 3)
        assert table["formation_factor"].tolist() == pytest.approx([(7 / 8) ** -1.5] * 3)

    def test_other_images_than_of_booleans_are_refused(self):
        """Of phases, or of 0 and 255, the mean is no porosity."""
        for pore in (duct(4, 10, (8, 8)).astype(np.uint8) * 255, np.ones((4, 4), bool)):
            with pytest.raises(InputError, match="pore: an image of"):
                flow.kozeny_carman(pore, 1.0)

    def test_only_along_axes_that_percolate(self):
        table = flow.permeability(duct(4, 10, (8, 8)), 1.0, "estimate")
        assert (table["k_md"] > 0).tolist() == [True, False, False]
        assert table["k_md"].tolist()[1:] == [0, 0]
        assert flow.percolates(np.moveaxis(duct(4, 10, (8, 8)), 2, 0)) == (False, False, True)

    def test_diagonal_neighbours_are_not_connected(self):
        pore = np.zeros((2, 2, 2), bool)
        pore[0, 0, 0] = pore[0, 0, 1] = pore[1, 1, 0] = pore[1, 1, 1] = True
        assert flow.percolates(pore) == (True, False, False)


def test_mistakes_are_named():
    with pytest.raises(InputError, match="unknown method"):
        flow.permeability(np.ones((2, 2, 2)), 1.0, "guess")
    with pytest.raises(InputError, match="unknown conductance"):
        flow.permeability(np.ones((2, 2, 2)), 1.0, conductance="guess")
    for method in flow.METHODS:
        for shape in ((4, 4), (0, 4, 4)):
            with pytest.raises(InputError, match="give a volume"):
                flow.permeability(np.zeros(shape), 1.0, method)
        # phases, 0 the pore, as all files hold them, would give K of the grains
        with pytest.raises(InputError, match="an image of uint8"):
            flow.permeability(np.ones((4, 4, 4), np.uint8), 1.0, method)
        for size in (-1.0, 0.0, np.nan, np.inf):
            with pytest.raises(InputError, match="no length"):
                flow.permeability(np.ones((4, 4, 4), bool), size, method)


def test_pyramids_of_swallowed_pores_conduct_nothing_backwards():
    """Lengths between pores, of which one reaches beyond the centre of the other, come out negative."""
    rng = np.random.default_rng(3)
    pore = ndimage.gaussian_filter(rng.standard_normal((26, 21, 29)), 2) > 0
    found = network.extract(pore, 1.0)
    for conductances in flow.MODELS["pyramids"](found):
        assert (conductances > 0).all()
    assert (flow.permeability(pore, 1.0, conductance="pyramids", network=found).k_md >= 0).all()


def test_a_network_that_misses_the_only_path_has_no_permeability():
    """A channel of one voxel: snow2 has no boundary pores on it."""
    pore = np.zeros((20, 11, 11), bool)
    pore[:, 5, 5] = True
    found = network.extract(pore, 1.0, "snow2")
    table = flow.permeability(pore, 1.0, conductance="pyramids", network=found).set_index("axis")
    assert table.loc[["x", "y"], "k_md"].tolist() == [0, 0]
    assert np.isnan(table.loc["z", "k_md"])


def test_rounding_eats_no_conductance_of_a_chain():
    """Resistors in a row, 1e14 apart: the law of series, to which the flow counted at the inlet is blind."""
    n = 100
    conns = np.stack([np.arange(n), np.arange(1, n + 1)], axis=1)
    g = np.where(np.arange(n) % 2, 1e-14, 1.0)
    ends = np.array([0]), np.array([n])
    assert flow.two_face_conductance(conns, g, *ends) == pytest.approx(1 / (1 / g).sum(), rel=1e-9)
    assert flow.two_face_conductance(conns[:1], g[:1], ends[0], np.array([1])) == 1


@pytest.mark.parametrize("method", ["estimate", "elliptic", "direct"])
def test_on_voxels_permeability_goes_with_their_square(method):
    pore = duct(4, 6, (7, 8))
    small, large = (flow.permeability(pore, h, method).set_index("axis").loc["x"] for h in (1.0, 3.0))
    assert large["k_md"] == pytest.approx(9 * small["k_md"])
    assert large["formation_factor"] == pytest.approx(small["formation_factor"])


def test_a_narrow_throat_takes_its_share_of_the_way():
    """Dong & Blunt: of each half of the way 0.6 r_t / r_p are the throat's."""
    net = chain(4.0, 10.0, 2)
    net["throat.inscribed_diameter"][:] = 2.0
    pores, throat = 10 - 2 * 0.6 * 2 / 4 * 5, 2 * 0.6 * 2 / 4 * 5
    hydraulic, electrical = flow.conductances(net, "x")
    assert electrical == pytest.approx(1 / (pores / 4**2 + throat / 2**2))
    assert hydraulic == pytest.approx(SQUARE_DUCT / (pores / 4**4 + throat / 2**4), rel=1e-4)


@pytest.mark.parametrize(("shape_factor", "factor"), [(0.040, 0.6), (0.068, 0.5623), (0.074, 0.5)])
def test_a_section_conducts_as_the_nearer_of_square_and_circle(shape_factor, factor):
    net = chain(3.0, 10.0, 2)
    net["pore.shape_factor"][:] = net["throat.shape_factor"][:] = shape_factor
    area = 3.0**2 / (16 * shape_factor)
    assert flow.conductances(net, "x")[0] == pytest.approx(factor * shape_factor * area**2 / 10)


def test_a_dead_end_does_not_span():
    net = chain(3.0, 10.0, 6)
    keep = np.arange(6) != 3
    assert flow.spanning(net, "x").all()
    cut = network.subnetwork(net, keep)
    cut["pore.xmax"][:] = False
    assert not flow.spanning(cut, "x").any()
