"""The handling diagram: closed forms, the linear gradient, and the equations of motion that it is about."""

import math

import numpy as np
import pytest

from bicycle_env import analysis, tires, vehicles
from bicycle_env.analysis.nonlinear_model import NonlinearModel

GRAVITY = 9.81
LIMIT = {"understeer": "plows", "oversteer": "spins", "neutral": "neutral"}


@pytest.mark.parametrize("tire", tires.LAWS)
@pytest.mark.parametrize("name", vehicles)
def test_the_curve_begins_with_the_linear_figures(name, tire):
    vehicle = vehicles[name]
    curve = analysis.handling_diagram(name, tire).curves[0]
    assert curve.lateral_acceleration[0] == curve.slip_difference[0] == 0.0
    assert curve.understeer_gradient[0] == pytest.approx(analysis.understeer_gradient(vehicle), rel=1e-11, abs=1e-15)
    assert curve.critical_speed[0] == pytest.approx(vehicle.critical_speed, rel=1e-9)


@pytest.mark.parametrize("name", ["oversteer", "understeer", "neutral", "me303", "civic"])
@pytest.mark.parametrize("friction", [1.0, 0.3])
def test_tanh_and_fiala_closed_forms(name, friction):
    """The slip angles of a share u of the friction: (D/C) atanh u, and atan((3D/C) (1 - (1 - u)^(1/3)))."""
    vehicle = vehicles[name]
    scales = [
        friction * load / stiffness
        for load, stiffness in (
            (vehicle.front_axle_load, vehicle.front_cornering_stiffness),
            (vehicle.rear_axle_load, vehicle.rear_cornering_stiffness),
        )
    ]
    forms = {
        "tanh": lambda scale, u: scale * np.arctanh(u),
        "fiala": lambda scale, u: np.arctan(3.0 * scale * (1.0 - np.cbrt(1.0 - u))),
    }
    for tire, slip in forms.items():
        (curve,) = analysis.handling_diagram(name, tire, friction).curves
        share = curve.lateral_acceleration / (friction * GRAVITY)
        front, rear = (slip(scale, np.minimum(share, 1.0)) for scale in scales)
        # at the peak itself the cube root of the rounding unit is left
        np.testing.assert_allclose(curve.front_slip_angle[:-1], -front[:-1], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(curve.slip_difference[:-1], (front - rear)[:-1], rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("friction", [1.0, 0.5])
@pytest.mark.parametrize("tire", ["tanh", "fiala", "magic_formula"])
@pytest.mark.parametrize("name", vehicles)
def test_the_largest_lateral_acceleration_is_the_friction(name, tire, friction):
    """With static loads both axles reach their peak at mu g; the sign of the balance says which slips away."""
    diagram = analysis.handling_diagram(name, tire, friction, points=31)
    assert diagram.largest_lateral_acceleration == pytest.approx(friction * GRAVITY, rel=1e-12)
    assert diagram.limit == LIMIT[analysis.classification(vehicles[name])]
    last = diagram.curves[0].lateral_acceleration[-1] / (friction * GRAVITY)
    assert 0.99 < last <= 1.0 + 1e-12


def test_linear_tire_has_no_limit():
    diagram = analysis.handling_diagram("oversteer", "linear")
    assert diagram.largest_lateral_acceleration == math.inf
    curve = diagram.curves[0]
    expected = analysis.understeer_gradient(vehicles["oversteer"])
    np.testing.assert_allclose(curve.understeer_gradient, expected, rtol=1e-12)
    np.testing.assert_allclose(curve.slip_difference, expected * curve.lateral_acceleration, rtol=1e-12)


@pytest.mark.parametrize("tire", tires.LAWS)
def test_the_gradient_is_the_slope(tire):
    for curve in analysis.handling_diagram("civic", tire, points=2001).curves:
        inner = slice(100, -100)
        slope = np.gradient(curve.slip_difference, curve.lateral_acceleration)
        np.testing.assert_allclose(curve.understeer_gradient[inner], slope[inner], rtol=5e-3)


@pytest.mark.parametrize("name", ["oversteer", "understeer"])
def test_all_curves_of_the_magic_formula_are_steady_turns(name):
    """Small angles: a turn at any speed, steered by L / R + slip difference, on either side of the axles' peaks."""
    diagram, speed = analysis.handling_diagram(name, "magic_formula", 0.8, points=21), 27.0
    sides = [(curve.front_side, curve.rear_side) for curve in diagram.curves]
    below, beyond = "below peak", "beyond peak"
    assert sides == [(below, below), (below, beyond), (beyond, below), (beyond, beyond)]
    model = NonlinearModel(name, speed, "magic_formula", 0.8, "small_angle")
    for curve in diagram.curves:
        yaw_rate = curve.lateral_acceleration / speed
        lateral_velocity = speed * curve.rear_slip_angle + vehicles[name].cg_to_rear * yaw_rate
        steer = 2.7 * curve.lateral_acceleration / speed**2 + curve.slip_difference
        np.testing.assert_allclose(model.rates(lateral_velocity, yaw_rate, steer, 0.0), 0.0, atol=1e-6)
        assert np.all(np.diff(curve.lateral_acceleration) > 0.0)


@pytest.mark.parametrize("tire", ["tanh", "fiala", "magic_formula"])
def test_the_critical_speed_along_the_curve(tire):
    """There det J = 0, in small angles; a little slower the turn is stable, a little faster a saddle."""
    curve = analysis.handling_diagram("oversteer", tire, points=11).curves[0]
    for k in range(9):
        ay, determinants = curve.lateral_acceleration[k], []
        for ratio in (0.99, 1.0, 1.01):
            speed = ratio * curve.critical_speed[k]
            lateral_velocity = speed * curve.rear_slip_angle[k] + 1.3 * ay / speed
            steer = 2.7 * ay / speed**2 + curve.slip_difference[k]
            model = NonlinearModel("oversteer", speed, tire, 1.0, "small_angle")
            determinants.append(np.linalg.det(model.jacobians(lateral_velocity, ay / speed, steer, 0.0).state))
        slower, there, faster = determinants
        assert slower > 0.0 > faster
        assert abs(there) < 1e-6 * (slower - faster)


def test_steer_at_a_speed_and_on_a_radius():
    diagram = analysis.handling_diagram("understeer")
    curve = diagram.curves[0]
    np.testing.assert_allclose(diagram.speed_line(20.0), 2.7 * curve.lateral_acceleration / 400.0, rtol=1e-14)
    np.testing.assert_allclose(diagram.steer_at_speed(20.0), diagram.speed_line(20.0) + curve.slip_difference)
    np.testing.assert_allclose(diagram.steer_on_radius(80.0), 2.7 / 80.0 + curve.slip_difference)
    for k in (20, 80, 140):
        steer = diagram.steer_at_speed(20.0)[k]
        (turn,) = analysis.equilibria("understeer", 20.0, (steer, 0.0), geometry="small_angle")
        assert turn.lateral_acceleration == pytest.approx(curve.lateral_acceleration[k], rel=1e-9)
        assert turn.front_slip_angle == pytest.approx(curve.front_slip_angle[k], rel=1e-9)


# The steer angle of a turn, from the equations of motion


@pytest.mark.parametrize("geometry", ["small_angle", "exact"])
@pytest.mark.parametrize("tire", tires.LAWS)
def test_steer_for_turn_makes_that_turn(tire, geometry):
    wanted = np.array([-8.0, -3.0, 0.0, 1.0, 9.0])
    steer = analysis.steer_for_turn("oversteer", wanted, speed=25.0, rear_steer=0.02, tire=tire, geometry=geometry)
    assert steer.shape == (5,)
    for ay, angle in zip(wanted, steer, strict=True):
        turns = analysis.equilibria("oversteer", 25.0, (angle, 0.02), tire, geometry=geometry)
        assert min(abs(turn.lateral_acceleration - ay) for turn in turns) < 1e-9


def test_steer_for_turn_in_small_angles_is_the_handling_curve():
    diagram = analysis.handling_diagram("civic", "fiala", 0.7, points=12)
    ay = diagram.curves[0].lateral_acceleration
    for keywords, expected in (
        ({"speed": 30.0}, diagram.steer_at_speed(30.0)),
        ({"radius": 60.0}, diagram.steer_on_radius(60.0)),
    ):
        steer = analysis.steer_for_turn("civic", ay, **keywords, friction=0.7, geometry="small_angle")
        np.testing.assert_allclose(steer[:-1], expected[:-1], atol=1e-9)


def test_on_a_circle_the_speed_follows():
    steer = analysis.steer_for_turn("understeer", 5.0, radius=80.0)
    assert isinstance(steer, float)
    (turn,) = analysis.equilibria("understeer", 20.0, (steer, 0.0))
    assert 20.0 / turn.yaw_rate == pytest.approx(80.0, rel=1e-9)
    # rolling without slip: tan(front) - tan(rear) = L / R
    assert analysis.steer_for_turn("understeer", 0.0, radius=80.0) == pytest.approx(math.atan(2.7 / 80.0), rel=1e-14)
    assert analysis.steer_for_turn("understeer", 0.02, radius=80.0) == pytest.approx(math.atan(2.7 / 80.0), rel=1e-3)
    assert analysis.steer_for_turn("understeer", 0.0, speed=20.0, rear_steer=0.03) == pytest.approx(0.03, rel=1e-14)


@pytest.mark.parametrize("tire", ["tanh", "fiala"])
def test_the_fold_is_where_the_steer_angle_is_largest(tire):
    """Below the critical speed the steer angle that a turn needs first rises, then falls: its maximum is the fold."""
    branches = analysis.equilibrium_branches("oversteer", 28.0, tire=tire, geometry="small_angle", steer_limit=0.05)
    fold = max((found for branch in branches for found in branch.bifurcations), key=lambda found: found.front_steer)
    ay = fold.equilibrium.lateral_acceleration + np.array([-0.1, 0.0, 0.1])
    steer = analysis.steer_for_turn("oversteer", ay, speed=28.0, tire=tire, geometry="small_angle")
    assert steer[1] == pytest.approx(fold.front_steer, abs=1e-12)
    assert steer[1] > max(steer[0], steer[2])


def test_a_turn_beyond_the_friction_has_no_steer_angle():
    steer = analysis.steer_for_turn("understeer", [5.0, 9.82, -20.0], speed=20.0)
    np.testing.assert_array_equal(np.isnan(steer), [False, True, True])
    # the cosine of a large steer angle: on a tight circle less than mu g
    assert math.isnan(analysis.steer_for_turn("understeer", 9.7, radius=12.0))
    assert not math.isnan(analysis.steer_for_turn("understeer", 9.0, radius=12.0))
    # the rear axle, steered more than the front one, carries mu g cos(0.3) = 9.37 m/s^2
    steer = analysis.steer_for_turn("understeer", [9.3, 9.5], speed=40.0, rear_steer=-0.3)
    assert abs(steer[0]) < 0.3
    assert math.isnan(steer[1])


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({}, "exactly one of speed and radius"),
        ({"speed": 20.0, "radius": 50.0}, "exactly one of speed and radius"),
        ({"speed": 0.0}, "speed must be"),
        ({"radius": -1.0}, "radius must be"),
        ({"radius": 1e-4}, "speed must be"),
        ({"speed": 20.0, "lateral_acceleration": math.nan}, "lateral_acceleration must be finite"),
        ({"speed": 20.0, "rear_steer": 2.0}, "rear_steer must be"),
        ({"speed": 20.0, "vehicle": "civc"}, "did you mean 'civic'"),
    ],
)
def test_bad_input_for_a_turn(keywords, message):
    with pytest.raises(ValueError, match=message):
        analysis.steer_for_turn(**{"vehicle": "civic", "lateral_acceleration": 1.0} | keywords)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"vehicle": "civc"}, "did you mean 'civic'"),
        ({"tire": "slick"}, "tire must be"),
        ({"friction": 0.0}, "friction must be"),
        ({"points": 2}, "points must be"),
    ],
)
def test_bad_input_for_the_diagram(keywords, message):
    with pytest.raises(ValueError, match=message):
        analysis.handling_diagram(**{"vehicle": "civic"} | keywords)


@pytest.mark.parametrize("name", ["speed_line", "steer_at_speed", "steer_on_radius"])
def test_bad_input_for_the_methods(name):
    with pytest.raises(ValueError, match="must be"):
        getattr(analysis.handling_diagram("civic", points=3), name)(0.0)
