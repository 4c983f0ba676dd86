"""Packings that physics knows, reduced: ``make bench-packing`` has them all, with more seeds and cores."""

import numpy as np
import packing
import pytest
from packing import RADIUS, Case, angle_of_repose, grains

from grainfall.contacts import closest_points
from grainfall.packing import container, deposit


@pytest.mark.parametrize(("engine", "tolerance"), [("physx", 1e-4), ("bullet", 1e-3)])
def test_frictionless_spheres_have_three_contacts_each(engine, tolerance):
    """Without friction a bed is isostatic: 3 n forces, walls and floor counted, balance n spheres.

    Of equal ones the walls may make a crystal, which has contacts in excess (3.3 in a bed seen in Bullet).
    Bullet, one small bed: its contacts hold to a tolerance ten times that of PhysX only.
    """
    diameter = 2 * RADIUS
    box = container(3 * diameter, diameter, 1.0)
    case = Case("poured", engine, 0.0)
    rng = np.random.default_rng(1)
    supply = grains(100, scale=RADIUS * rng.uniform(0.9, 1.1, 100))
    bodies = deposit(supply, None, box, case.parameters, rng)
    reach = tolerance * diameter
    place = bodies[["x", "y", "z"]].to_numpy() + box.margin_um
    radius = bodies[["scale"]].to_numpy()
    gaps = [(place - radius).ravel(), (box.sides_um - place[:, :2] - radius).ravel()]
    between = closest_points(bodies, None, reach)["gap_um"]
    contacts = (between < reach).sum() + (np.concatenate(gaps) < reach).sum()
    assert contacts / len(bodies) == pytest.approx(3, abs=0.12)


def test_friction_loosens_equal_spheres():
    """One seed a friction, walls 1.5 diameters off; so small a core scatters by 0.01 from seed to seed."""
    rows = [
        packing.pour(Case("spheres", friction=mu), 0, grains(200), None, 3.5, 1.5) for mu in (0.1, 0.3, 1.0)
    ]
    fractions, contacts = ([row[name] for row in rows] for name in ("solid_fraction", "z"))
    assert 0.643 > fractions[0] > fractions[1] > fractions[2] > 0.55
    assert 6.0 > contacts[0] > contacts[1] > contacts[2] > 4.0
    for row in rows:
        assert row["drift"] < 1e-3
        assert row["net_force"] < 1e-2
        assert row["energy_rise"] < 1e-3


def test_ellipsoids_lie_denser_than_spheres():
    """Without friction, one small bed each, a diameter from the walls, which loosen both."""
    oblong = packing.ellipsoids(Case("ellipsoids", friction=0.0), 0, 2.5, 1.0, fine=1)
    equal = packing.pour(Case("poured", friction=0.0), 0, grains(200), None, 2.5, 1.0)
    assert 0.735 > oblong["solid_fraction"] > equal["solid_fraction"] + 0.05
    # isostatic beds have two contacts for each way a body may move: 6 a sphere, up to 12 where it may turn
    assert oblong["z"] > equal["z"] + 1


def test_fines_fill_the_voids_of_coarse_spheres():
    """Without friction, one small bed each: densest with a quarter of fines, not with few."""
    some, few = (
        packing.two_sizes(Case("two_sizes", friction=0.0, coarse_share=share), 0, margin=0.5)
        for share in (0.75, 0.93)
    )
    assert some["solid_fraction"] > max(0.70, few["solid_fraction"] + 0.05)


def test_the_angle_of_a_cone():
    rng = np.random.default_rng(0)
    for wanted in (15, 25, 35):
        foot = 16.0
        r, z = foot * np.sqrt(rng.random(20000)), rng.random(20000) * foot * np.tan(np.radians(wanted))
        inside = z < (foot - r) * np.tan(np.radians(wanted))
        turn = 2 * np.pi * rng.random(inside.sum())
        points = np.column_stack([r[inside] * np.cos(turn), r[inside] * np.sin(turn), z[inside]])
        # the tops of unit spheres in columns three wide: known to a degree
        assert angle_of_repose(points) == pytest.approx(wanted, abs=1.0)


def test_friction_steepens_a_heap():
    gentle, steep = (packing.heap(Case("heap", friction=mu), 0, n=320)["angle_deg"] for mu in (0.1, 1.0))
    assert gentle + 1 < steep < 40


@pytest.mark.parametrize("engine", ["physx", "bullet"])
def test_grains_set_free_stay_where_they_are(engine):
    """One seed an engine, a bed four diameters wide."""
    found = packing.rest(Case("rest", engine), 0, roi=2.0)
    assert found["drift"] < 1e-3
    assert found["net_force"] < 1e-2
    assert found["energy_rise"] < 1e-3
    assert found["max_overlap"] < 0.02
