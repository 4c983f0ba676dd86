"""Non-convex grains collide as convex parts: the parts are the grain, and rest where the grain would."""

import numpy as np
import pytest
import trimesh

from grainfall.contacts import Hulls, closest_points
from grainfall.grains import cut
from grainfall.packing import Parameters
from grainfall.packing.engine import Solid, start
from grainfall.packing.shapes import SPHERE_DEVIATION, choose_kind, collision_shape

ENGINES = ["physx", "bullet"]
CENTRE = np.array([5 / 6, 0.5, 7 / 6])  # of the L below
UPRIGHT = np.array([1.0, 0, 0, 0])


def shape_of(ell, decomposition: str = "auto"):
    return collision_shape(*ell, Parameters(decomposition=decomposition), cut(*ell)[0])


def test_an_l_collides_as_its_two_boxes(ell):
    shape = shape_of(ell)
    assert shape.kind == "parts"
    assert len(shape.parts) == 2
    assert shape.hull_excess == pytest.approx(1 / 6)
    assert shape.excess == pytest.approx(0, abs=0.01)


def body(ell, decomposition: str) -> tuple[Solid, np.ndarray]:
    """The L for an engine, and the quaternion at which it stands as drawn."""
    shape = shape_of(ell, decomposition)
    solid = Solid(shape.parts, shape.bound, 3.0, shape.inertia)
    x, y, z, w = shape.frame.as_quat()
    return solid, np.array([w, x, y, z])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_decomposed_l_rests_at_its_height(ell, engine):
    """It stands on one cube, its centre of mass over it, at 7/6 of a cube."""
    box = start(Parameters.named(engine=engine), 10, 10)
    solid, turn = body(ell, "auto")
    assert len(solid.parts) == 2
    box.add(solid, np.array([5, 5, CENTRE[2] + 0.2]), turn, np.zeros(3))
    box.step(500)
    assert box.state().position[0, 2] == pytest.approx(CENTRE[2], abs=0.01)
    box.close()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("decomposition", ["auto", "off"])
def test_an_l_nests_over_a_peg_where_its_hull_does_not(ell, engine, decomposition):
    peg = np.array([[x, y, z] for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (-0.4, 0.4)])
    # lowered rather than dropped: its centre of mass is near the edge of its foot, and a bounce tips it over
    box = start(Parameters.named(engine=engine, linear_damping=20.0, angular_damping=20.0), 10, 10)
    at = np.array([5.0, 5.0, 0.4])
    box.add(Solid((peg,), 0.6, 1.0, np.ones(3)), at, UPRIGHT, np.zeros(3))
    box.fix([0])
    solid, turn = body(ell, decomposition)
    notch = np.array([1.5, 0.5, 0.4])
    box.add(solid, at + CENTRE - notch + [0, 0, 0.9], turn, np.zeros(3))
    box.step(500)
    place = box.state().position[-1]
    nested = np.abs(place - (at + CENTRE - notch)).max() < 0.05
    assert nested == (decomposition == "auto")
    box.close()


@pytest.mark.parametrize("decomposition", ["auto", "on", "off"])
def test_a_convex_grain_stays_one_piece(decomposition):
    for grain in (trimesh.creation.box([1, 2, 3]), trimesh.creation.icosphere(3).apply_scale([1, 1.2, 0.7])):
        shape = shape_of((np.array(grain.vertices), np.array(grain.faces)), decomposition)
        assert shape.kind == "hull"
        assert len(shape.parts) == 1


def test_a_ball_collides_as_a_sphere_and_an_ellipsoid_does_not():
    ball = trimesh.creation.icosphere(4)
    for stretch, kind in ((1.0, "sphere"), (1 + 4 * SPHERE_DEVIATION, "hull")):
        shape = collision_shape(np.array(ball.vertices) * [1, 1, stretch], np.array(ball.faces))
        assert shape.kind == kind
        assert (len(shape.parts) == 0) == (kind == "sphere")


def test_any_grain_collides_as_the_sphere_of_its_volume_where_that_is_asked_for(ell):
    plain, ball = (
        collision_shape(*ell, Parameters(collision_shape=wanted), cut(*ell)[0])
        for wanted in ("auto", "sphere")
    )
    assert ball.kind == "sphere"
    assert ball.parts == ()
    assert ball.bound == pytest.approx((3 * 3 / (4 * np.pi)) ** (1 / 3))
    assert ball.inertia == pytest.approx(plain.inertia)
    assert ball.hull_excess == plain.hull_excess


@pytest.mark.parametrize(
    ("figures", "kind"),
    [
        ((0.2, 0.03, 0.5, "auto", 0.1), "parts"),
        ((0.1, 0.03, 0.5, "auto", 0.1), "hull"),
        ((0.2, 0.03, 0.5, "off", 0.1), "hull"),
        ((0.01, 0.03, 0.5, "on", 0.1), "parts"),
        ((0.0, 0.03, 0.002, "auto", 0.1), "sphere"),
        ((0.0, 0.03, 0.010, "auto", 0.1), "hull"),
        ((0.0, 0.001, 0.002, "auto", 0.1), "hull"),
    ],
)
def test_the_choice_follows_its_measures(figures, kind):
    found, reason = choose_kind(*figures)
    assert found == kind
    assert reason


@pytest.mark.parametrize("decomposition", ["auto", "on"])
def test_a_grain_without_pieces_collides_as_its_hull(ell, decomposition):
    shape = collision_shape(*ell, Parameters(decomposition=decomposition))
    assert shape.kind == "hull"
    assert "one piece" in shape.reason
    assert shape.excess == pytest.approx(1 / 6)


def test_contacts_are_judged_by_the_parts():
    """A ball in the notch of an L made of two boxes: 0.2 from both; in the hull it would be inside."""
    import pandas as pd

    corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T.astype(float)
    parts = Hulls({0: (corners * [1, 1, 2], corners + np.array([1, 0, 1])), 1: ()})
    table = pd.DataFrame({"id": [0, 1], "shape": [0, 1], "scale": [1.0, 0.3], "x": [0, 1.5], "y": [0, 0.5]})
    table = table.assign(z=[0, 0.4], qw=1.0, qx=0.0, qy=0.0, qz=0.0)
    pair = closest_points(table, parts, 1.0).loc[0]
    assert pair["gap_um"] == pytest.approx(0.2, abs=1e-6)
    np.testing.assert_allclose(pair[["nx", "ny", "nz"]].to_numpy(float), [1, 0, 0], atol=1e-5)
