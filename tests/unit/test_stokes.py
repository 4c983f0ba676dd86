"""Flow through voxels: exact solutions of the difference equations and of Stokes', bounds, symmetries."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from grainfall.errors import InputError
from grainfall.flow import direct, elliptic, multigrid, permeability
from grainfall.flow.staggered import assemble

SQUARE_DUCT = 0.0351443
"""Flow rate of a square duct over side^4 times pressure gradient over viscosity (series solution)."""

ZICK_HOMSY = {0.125: 4.292, 0.343: 15.4, 0.5236: 42.1}
"""Drag of simple cubic spheres over 6 pi mu a U, by solid fraction."""

SOLVERS = {"elliptic": elliptic.solve, "direct": direct.solve}
REPEATED = {"ends": "periodic", "sides": "periodic"}


def rock(n: int = 20, porosity: float = 0.35, seed: int = 1) -> np.ndarray:
    """Pores between blobs that repeat themselves along every axis."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal((n, n, n)), 1.6, mode="wrap")
    return noise > np.quantile(noise, 1 - porosity)


def sphere_array(c: float, n: int) -> tuple[np.ndarray, float]:
    """Distance to a sphere in a cell of n voxels, and the exact permeability of the array in voxels^2."""
    radius = (3 * c / (4 * np.pi)) ** (1 / 3)
    at = (np.arange(n) + 0.5) / n - 0.5
    distance = np.sqrt(at[:, None, None] ** 2 + at[:, None] ** 2 + at**2) - radius
    return distance * n, 2 * radius**2 / (9 * c * ZICK_HOMSY[c]) * n**2


def duct_rate(width: int) -> float:
    """Flow rate through a square duct by the five-point formula with walls half a voxel off, densely."""
    second = 2 * np.eye(width) - np.eye(width, k=1) - np.eye(width, k=-1)
    second[[0, -1], [0, -1]] += 1
    laplacian = np.kron(second, np.eye(width)) + np.kron(np.eye(width), second)
    return np.linalg.solve(laplacian, np.ones(width**2)).sum()


@pytest.mark.parametrize("solve", SOLVERS.values(), ids=SOLVERS)
class TestStraightChannels:
    """Nothing converges or turns, so the bounds meet at the solution of the difference equations."""

    @pytest.mark.parametrize("conditions", [{"sides": "periodic"}, REPEATED, {"sides": "slip"}])
    def test_slit(self, solve, conditions):
        width, pitch = 5, 7
        pore = np.ones((4, pitch, 6), bool)
        pore[:, [0, -1]] = False
        # parabola through half-voxel walls: 2 / width^2 above the continuum
        exact = width**3 / 12 / pitch * (1 + 2 / width**2)
        assert solve(pore, "x", **conditions).k == pytest.approx(exact, rel=1e-6)
        assert solve(np.moveaxis(pore, 2, 0), "z", **conditions).k == pytest.approx(exact, rel=1e-6)
        assert solve(pore, "y", **conditions).k == 0

    @pytest.mark.parametrize("axis", ["x", "y", "z"])
    def test_square_duct(self, solve, axis):
        width, shape = 6, (9, 8)
        pore = np.zeros((*shape, 10), bool)
        pore[2 : 2 + width, 1 : 1 + width] = True
        pore = np.moveaxis(pore, 2, elliptic.image_axis(axis))
        found = solve(pore, axis)
        assert found.k == pytest.approx(duct_rate(width) / np.prod(shape), rel=1e-6)
        assert found.k == pytest.approx(SQUARE_DUCT * width**4 / np.prod(shape), rel=4 / width**2)

    def test_walls_of_the_volume_are_walls(self, solve):
        pore = np.ones((6, 6, 5), bool)
        assert solve(pore, "x").k == pytest.approx(duct_rate(6) / 36, rel=1e-6)

    def test_round_tube_by_its_distance_field(self, solve):
        for radius in (5.1, 10.2):
            n = 2 * int(radius) + 4
            at = np.arange(n) - (n - 1) / 2 + 0.3
            distance = radius - np.hypot(at[:, None], at)
            k = solve(np.repeat(distance[:, :, None], 3, axis=2), "x").k
            assert k == pytest.approx(np.pi * radius**4 / 8 / n**2, rel=1.1 / radius**2)


@pytest.mark.parametrize("c", ZICK_HOMSY)
def test_simple_cubic_spheres(c):
    """Zick & Homsy (1982): the distance field converges with the square of the voxel, or nearly so."""
    errors = []
    for n in (12, 24):
        distance, exact = sphere_array(c, n)
        errors.append(direct.solve(distance, "x", **REPEATED).k / exact - 1)
    assert abs(errors[1]) < 0.01
    assert abs(errors[1]) < abs(errors[0]) / 2


def test_the_solver_solves_its_equations():
    """The bracket holds the solution of the whole system by dense algebra."""
    pore = rock(9, 0.45)
    grid = assemble(np.ascontiguousarray(np.moveaxis(pore, 2, 0)), "pressure", "sealed")
    n, m = grid.gradient.shape
    system = np.block(
        [[grid.friction.toarray(), -grid.gradient.toarray()], [grid.gradient.T.toarray(), np.zeros((m, m))]]
    )
    assert np.array_equal(grid.friction.toarray(), grid.friction.toarray().T)
    velocity = np.linalg.lstsq(system, np.append(grid.drive, np.zeros(m)))[0][:n]
    exact = grid.drive @ velocity / 9
    found = direct.solve(pore, "x", tolerance=1e-6)
    assert found.k == pytest.approx(exact, rel=1e-6)
    assert found.k_lower <= exact * (1 + 1e-9)
    assert found.k_upper >= exact * (1 - 1e-9)


def test_what_does_not_converge_is_an_error(monkeypatch):
    """A bound that is none must not pass for one."""
    rock = np.random.default_rng(0).random((12, 12, 12)) < 0.7
    monkeypatch.setattr(multigrid, "MOST_STEPS", 2)
    with pytest.raises(RuntimeError, match="after 2 steps"):
        elliptic.solve(rock)


class TestRock:
    @pytest.fixture(scope="class")
    @staticmethod
    def flows():
        return {name: solve(rock(), "x") for name, solve in SOLVERS.items()}

    def test_the_bounds_enclose(self, flows):
        found = flows["direct"]
        assert flows["elliptic"].k < found.k_lower <= found.k <= found.k_upper
        assert found.k_upper - found.k_lower <= 1e-3 * found.k_upper
        coarse = direct.solve(rock(), "x", tolerance=0.1)
        assert coarse.k_lower <= found.k_upper
        assert coarse.k_upper >= found.k_lower

    def test_straining_costs_little_beside_the_elliptic_model(self, flows):
        assert flows["elliptic"].k == pytest.approx(flows["direct"].k, rel=0.05)

    @pytest.mark.parametrize("name", SOLVERS)
    def test_mass_is_conserved(self, flows, name):
        flux, pressure = flows[name].flux, flows[name].pressure
        divergence = sum(np.diff(flux[a], axis=a) for a in range(3))
        through = flux[2].sum(axis=(0, 1))
        assert np.abs(divergence).max() < 1e-6 * np.abs(flux[2]).max()
        assert through == pytest.approx(np.full(21, flows[name].k * 20), rel=1e-6)
        assert not np.isfinite(pressure[~rock()]).any()
        assert np.nanmax(pressure) <= 1.1

    @pytest.mark.parametrize("name", SOLVERS)
    def test_turned_and_mirrored(self, flows, name):
        solve = SOLVERS[name]
        k = flows[name].k
        assert solve(np.transpose(rock(), (2, 0, 1)), "z").k == pytest.approx(k, rel=1e-5)
        for axis in range(3):
            assert solve(np.flip(rock(), axis), "x").k == pytest.approx(k, rel=1e-5)

    @pytest.mark.parametrize("name", SOLVERS)
    def test_periods_do_not_care_where_the_cut_is(self, name):
        solve = SOLVERS[name]
        k = solve(rock(), "y", **REPEATED).k
        assert solve(np.roll(rock(), (3, 7, 5), (0, 1, 2)), "y", **REPEATED).k == pytest.approx(k, rel=1e-5)

    def test_what_does_not_conduct_changes_nothing(self, flows):
        pore = np.pad(rock(), ((0, 4), (0, 0), (0, 0)))
        pore[22, 5:9, 5:9] = True
        assert direct.solve(pore, "x").k * 24 == pytest.approx(flows["direct"].k * 20, rel=1e-9)

    def test_same_bytes_again(self, flows):
        again = direct.solve(rock(), "x")
        assert again.k == flows["direct"].k
        assert all(np.array_equal(a, b) for a, b in zip(again.flux, flows["direct"].flux, strict=True))


@pytest.mark.parametrize("solve", SOLVERS.values(), ids=SOLVERS)
class TestNothingFlows:
    def test_plugged(self, solve):
        pore = rock()
        pore[:, :, 9] = False
        found = solve(pore, "x")
        assert found.k == found.k_lower == found.k_upper == 0
        assert all(not a.any() for a in found.flux)
        assert np.isnan(elliptic.formation_factor(pore, "x"))

    def test_ends_that_do_not_meet(self, solve):
        pore = np.zeros((9, 9, 12), bool)
        pore[2:5, 2:5, :7] = True
        pore[2:5, 2:9, 6:8] = True
        pore[2:5, 6:9, 7:] = True
        assert solve(pore, "x").k > 0
        assert solve(pore, "x", **REPEATED).k == 0

    def test_a_screw_winds_through_its_neighbours(self, solve):
        """The path leaves by a side, and comes back displaced only in a volume that repeats itself."""
        y, x = np.indices((8, 12))
        pore = np.zeros((4, 8, 12), bool)
        pore[1:3] = (y + 4 - x * 8 // 12) % 8 < 4
        assert solve(pore, "x", **REPEATED).k > 0
        assert solve(pore, "x").k == 0


class TestFormationFactor:
    def test_duct(self):
        pore = np.zeros((9, 8, 10), bool)
        pore[2:6, 1:7] = True
        assert elliptic.formation_factor(pore, "x") == pytest.approx(72 / 24, rel=1e-9)
        assert np.isnan(elliptic.formation_factor(pore, "y"))

    def test_dilute_spheres_follow_maxwell(self):
        distance, _ = sphere_array(0.125, 16)
        pore = distance > 0
        c = 1 - pore.mean()
        assert elliptic.formation_factor(pore, "z", **REPEATED) == pytest.approx(
            (2 + c) / (2 - 2 * c), rel=0.03
        )


def test_one_table_for_all_methods():
    pore = rock()
    for method in SOLVERS:
        lines = []
        table = permeability(pore, 2.0, method, progress=lines.append)
        assert table["method"].unique() == [method]
        assert (table["formation_factor"] > 1).all()
        assert bool(lines) == (method == "direct")


@pytest.mark.parametrize("solve", SOLVERS.values(), ids=SOLVERS)
@pytest.mark.parametrize(
    ("pore", "given", "named"),
    [
        (np.ones((4, 4), bool), {}, "volume"),
        (np.ones((4, 4, 4), np.uint8), {}, "bool"),
        (np.ones((4, 4, 4), bool), {"axis": "w"}, "axis"),
        (np.ones((4, 4, 4), bool), {"sides": "open"}, "sides"),
        (np.ones((4, 4, 4), bool), {"ends": "open"}, "ends"),
        (np.ones((4, 4, 4), bool), REPEATED, "walls"),
    ],
)
def test_mistakes_are_named(solve, pore, given, named):
    with pytest.raises(InputError, match=named):
        solve(pore, **given)


@pytest.mark.parametrize("solve", SOLVERS.values(), ids=SOLVERS)
def test_the_flux_through_a_distance_field_carries_k(solve):
    at = np.arange(14) - 6.2
    distance = 5.1 - np.hypot(at[:, None], at)
    found = solve(np.repeat(distance[:, :, None], 3, axis=2), "x")
    assert found.flux[2].sum(axis=(0, 1)) == pytest.approx(np.full(4, found.k * 14**2 / 3), rel=1e-6)
