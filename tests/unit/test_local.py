"""Conductances from local solutions: exact in ducts however they are parted, invariants, random media."""

from functools import partial

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from grainfall import flow
from grainfall.flow import elliptic, local, mobility, multiport
from grainfall.network import Interfaces, find_interfaces, partition


def rock(n: int = 32, porosity: float = 0.3, seed: int = 1) -> np.ndarray:
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal((n, n, n)), 2.0, mode="wrap")
    return noise > np.quantile(noise, 1 - porosity)


def cut(pore: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, Interfaces]:
    """A pore space parted as ``labels`` say, with one throat between any two that touch."""
    labels = np.where(pore, labels, 0).astype(np.int32)
    voxels, axes, pairs = [], [], []
    index = np.arange(labels.size).reshape(labels.shape)
    for axis in range(3):
        here, there = np.moveaxis(labels, axis, 0)[:-1], np.moveaxis(labels, axis, 0)[1:]
        apart = (here != there) & (here > 0) & (there > 0)
        voxels.append(np.moveaxis(index, axis, 0)[:-1][apart])
        axes.append(np.full(len(voxels[-1]), axis, np.int8))
        pairs.append(np.sort(np.stack([here[apart], there[apart]], axis=1) - 1, axis=1))
    conns, throats = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
    order = np.argsort(throats.ravel(), kind="stable")
    found = (np.concatenate(voxels)[order], np.concatenate(axes)[order], throats.ravel()[order], conns)
    none = np.zeros(len(conns), np.int64)
    return labels, Interfaces(*found, none, none > 0)


def parted(pore: np.ndarray) -> dict[str, local.Rates]:
    parts = partition(pore)
    return local.solve(parts.labels, find_interfaces(parts))


@pytest.fixture
def closely(monkeypatch):
    """Potentials far closer than a network's permeability needs them."""
    monkeypatch.setattr(multiport, "CLOSE", 1e-6)
    monkeypatch.setattr(local, "mobility", partial(mobility.mobility, close=1e-6))


class TestDucts:
    @pytest.fixture(scope="class")
    @staticmethod
    def pore():
        pore = np.zeros((9, 8, 30), bool)
        pore[1:7, 1:6] = True
        pore[6, 1] = False
        return pore

    @pytest.mark.parametrize("tilt", [0, 1])
    def test_however_it_is_parted(self, pore, tilt, closely):
        z, y, x = np.indices(pore.shape)
        whole = local.solve(*cut(pore, np.ones(pore.shape)))["x"]
        assert whole.hydraulic == pytest.approx(elliptic.solve(pore, "x").k * 72 / 30, rel=1e-4)
        assert whole.electrical == pytest.approx(29 / 30, rel=1e-4)
        parts = local.solve(*cut(pore, 1 + np.digitize(x + tilt * (y - z) / 2, [4, 11, 12, 22])))["x"]
        # across a tilted cut the pressure is a plane too, but the steps of the voxels ruffle the velocity
        assert parts.hydraulic == pytest.approx(whole.hydraulic, rel=0.06 if tilt else 1e-4)
        assert parts.electrical == pytest.approx(whole.electrical, rel=0.02 if tilt else 1e-4)

    def test_parted_lengthwise(self, pore):
        _, y, x = np.indices(pore.shape)
        whole = local.solve(*cut(pore, np.ones(pore.shape)))["x"]
        parts = local.solve(*cut(pore, 1 + (y > 3) + 2 * (x > 14)))["x"]
        assert parts.electrical == pytest.approx(whole.electrical, rel=0.02)

    def test_across_nothing_flows(self, pore):
        for axis in "yz":
            assert parted(pore)[axis] == (0, 0, 0)

    def test_a_plug_stops_the_flow(self, pore):
        pore = pore.copy()
        pore[:, :, 20] = False
        assert parted(pore)["x"] == (0, 0, 0)


class TestRock:
    @pytest.fixture(scope="class")
    @staticmethod
    def rates():
        return parted(rock())

    @pytest.mark.parametrize("axis", flow.AXES)
    def test_close_to_the_solution_of_the_whole(self, rates, axis):
        n = len(rock())
        assert rates[axis].hydraulic == pytest.approx(elliptic.solve(rock(), axis).k * n, rel=0.06)
        # pressures held to planes let more through
        exact = n / elliptic.formation_factor(rock(), axis)
        assert exact < rates[axis].electrical < 1.08 * exact

    @pytest.mark.parametrize("axis", flow.AXES)
    def test_flow_balances(self, rates, axis):
        assert rates[axis].imbalance < 1e-9

    @pytest.mark.parametrize("seed", [1, 2, 3])
    def test_permuting_the_axes_permutes_the_answer(self, seed):
        rates = parted(rock(seed=seed))
        turned = parted(np.ascontiguousarray(rock(seed=seed).transpose(1, 2, 0)))
        for axis, same in zip("xyz", "zxy", strict=True):
            assert turned[axis][:2] == pytest.approx(rates[same][:2], rel=2e-3)

    def test_iterated_as_factorised(self, rates, monkeypatch):
        monkeypatch.setattr(local, "MANY", 0)
        iterated = parted(rock())
        for axis in flow.AXES:
            assert iterated[axis].imbalance < 1e-9
            assert iterated[axis][:2] == pytest.approx(rates[axis][:2], rel=1e-9)

    def test_an_isolated_pore_changes_nothing(self, closely):
        pore = np.pad(rock(), ((0, 9), (0, 0), (0, 0)))
        without = parted(pore)["x"]
        pore[34:39, 5:9, 5:9] = True
        assert parted(pore)["x"][:2] == pytest.approx(without[:2], rel=1e-5)  # single precision

    def test_threads_do_not_show(self):
        once, again = (flow.permeability(rock(), 2.0, threads=n) for n in (1, 3))
        assert again.drop(columns="wall_s").equals(once.drop(columns="wall_s"))

    def test_permeability_scales_with_the_square_of_the_voxel(self, rates):
        table, once = (flow.permeability(rock(), voxel_um).set_index("axis") for voxel_um in (3.0, 1.0))
        assert table["k_md"].tolist() == pytest.approx((9 * once["k_md"]).tolist(), rel=1e-9)
        assert table["formation_factor"].tolist() == pytest.approx(once["formation_factor"].tolist())
        assert once["formation_factor"]["x"] == pytest.approx(len(rock()) / rates["x"].electrical)


class TestMobility:
    def test_exact_in_a_slit(self):
        width = 7
        pore = np.zeros((width + 4, 12, 12), bool)
        pore[2:-2] = True
        found = mobility.mobility(pore, 1e-6)
        across = found.lower.reshape(width, 12, 12, 3)[:, 6, 6]
        # the volume's sides are walls to what flows along them, so the slit is a duct 12 wide
        duct = elliptic.solve(pore[:, :, :1].repeat(12, axis=2), "x").flux[2][2:-2, 6, 5] * 12
        assert across[:, 2] == pytest.approx(duct, rel=1e-3)
        depth = np.arange(width)
        assert (across[:, 0] <= depth * (width - depth) / 2).all()
        assert found.upper[0].max() == 0
        assert (found.upper[1][2:-2] > 0).all()

    def test_block_by_block_as_at_once(self):
        at_once, parts = (mobility.mobility(rock(48), 1e-5, block) for block in (48, 12))
        scale = at_once.lower.max()
        assert np.abs(parts.lower - at_once.lower).max() < 0.01 * scale
        for one, other in zip(parts.upper, at_once.upper, strict=True):
            assert np.abs(one - other).max() < 0.02 * scale


def test_what_is_solved_at_once_waits_for_the_rest():
    """A grid, through which many steps are needed, and a row beside it, for which the factors are exact."""
    shape, row = (8, 8, 8), np.arange(8)
    voxels = np.concatenate([np.arange(8**3), 9 * 64 + row])
    near = multiport._stencil((10, *shape[1:]), voxels, np.array([0]), np.array([0], np.int8))
    link, bond = multiport._bonds(near, np.full((len(voxels), 3), 0.7, np.float32))
    own = np.zeros(len(voxels), np.float32)
    own[[0, 8**3]] = 2, 3
    source = np.zeros((len(voxels) + 1, 8), np.float32)
    source[8**3 - 1, 0] = 1
    inflow = np.linspace(0.1, 1, 7, dtype=np.float32)
    source[-2, 1:] = inflow
    factors = multiport._factors(link, bond, own)
    found = multiport._gradients(link, bond, *factors, source, np.zeros_like(source), 1e-6)
    # what comes in at the far end leaves by the port
    assert found[0, 0] == pytest.approx(1 / 2, rel=1e-4)
    assert found[8**3, 1:] == pytest.approx(inflow / 3, rel=1e-4)
