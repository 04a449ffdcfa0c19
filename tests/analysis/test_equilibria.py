"""Steady turns: closed forms, an independent search, symmetry, simulation, and a published case."""

import dataclasses
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from combinations import some_of

from bicycle_env import Vehicle, analysis, simulate, tires, vehicles
from bicycle_env.analysis.equilibria import RearBalance, kind_of
from bicycle_env.analysis.nonlinear_model import NonlinearModel
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarParameters, CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.single_track import SingleTrack

GRAVITY = 9.81
OVERSTEER = vehicles["oversteer"]
CRITICAL = OVERSTEER.critical_speed
NONLINEAR = ("tanh", "fiala", "magic_formula")


def random_vehicle(rng):
    return Vehicle(
        mass=rng.uniform(800, 2500),
        yaw_inertia=rng.uniform(1000, 5000),
        cg_to_front=rng.uniform(0.9, 2.0),
        cg_to_rear=rng.uniform(0.9, 2.0),
        front_cornering_stiffness=rng.uniform(3e4, 2e5),
        rear_cornering_stiffness=rng.uniform(3e4, 2e5),
    )


def kinds(turns):
    return [turn.kind for turn in turns]


# The linear tire: one steady turn


@pytest.mark.parametrize("speed_ratio", [0.3, 0.9, 1.2])
def test_linear_tire_is_the_steady_state_gain(speed_ratio):
    speed, steer = speed_ratio * CRITICAL, (0.01, -0.004)
    (turn,) = analysis.equilibria(OVERSTEER, speed, steer, tire="linear")
    for output in ("lateral_velocity", "yaw_rate", "sideslip", "lateral_acceleration"):
        gains = [analysis.steady_state_gain(OVERSTEER, speed, input, output) for input in ("front_steer", "rear_steer")]
        assert getattr(turn, output) == pytest.approx(np.dot(gains, steer), rel=1e-11), output
    np.testing.assert_allclose(np.sort(turn.eigenvalues), np.sort(analysis.eigenvalues(OVERSTEER, speed)), rtol=1e-12)
    assert turn.is_stable == analysis.is_stable(OVERSTEER, speed)
    assert (turn.kind == "saddle") == (speed_ratio > 1.0)


def test_linear_tire_outside_the_sideslip_limit_has_none():
    assert analysis.equilibria("oversteer", 1.001 * CRITICAL, (0.01, 0.0), tire="linear") == ()


@pytest.mark.parametrize("steer", [(0.0, 0.0), (0.02, 0.0)])
def test_linear_tire_at_the_critical_speed_is_refused(steer):
    with pytest.raises(ValueError, match=r"speed must differ from the critical speed 36\.06"):
        analysis.equilibria("oversteer", CRITICAL, steer, tire="linear")


# Closed forms of the saturating tires at zero steer


@pytest.mark.parametrize("friction", [1.0, 0.3])
@pytest.mark.parametrize("speed_ratio", [0.6, 0.9, 0.9999])
def test_tanh_saddles_of_the_oversteering_car(speed_ratio, friction):
    """Small angles: with x = C alpha / D equal on both axles, x / tanh x = (critical speed / speed)^2."""
    speed = speed_ratio * CRITICAL
    right, straight, left = analysis.equilibria("oversteer", speed, (0.0, 0.0), "tanh", friction, "small_angle")
    assert kinds((right, left)) == ["saddle", "saddle"]
    assert straight.is_stable
    for turn in (right, left):
        front = 110e3 * turn.front_slip_angle / (friction * OVERSTEER.front_axle_load)
        rear = 90e3 * turn.rear_slip_angle / (friction * OVERSTEER.rear_axle_load)
        assert front == pytest.approx(rear, rel=1e-10)
        assert front / math.tanh(front) == pytest.approx(speed_ratio**-2, rel=1e-10)
        assert turn.lateral_acceleration == pytest.approx(-friction * GRAVITY * math.tanh(front), rel=1e-10)


@pytest.mark.parametrize("friction", [1.0, 0.3])
@pytest.mark.parametrize("speed_ratio", [0.58, 0.8, 0.99])
def test_fiala_saddles_of_the_oversteering_car(speed_ratio, friction):
    """With z = C tan(alpha) / (3 mu Fz) equal on both axles, 1 - z + z^2/3 = (speed / critical speed)^2, exactly."""
    right, _, left = analysis.equilibria("oversteer", speed_ratio * CRITICAL, (0.0, 0.0), "fiala", friction, "exact")
    z = 1.5 * (1.0 - math.sqrt(1.0 - 4.0 / 3.0 * (1.0 - speed_ratio**2)))
    for turn, sign in ((right, 1.0), (left, -1.0)):
        assert math.tan(turn.rear_slip_angle) == pytest.approx(
            sign * z * 3.0 * friction * OVERSTEER.rear_axle_load / 90e3, rel=1e-9
        )
        assert turn.lateral_acceleration == pytest.approx(-sign * friction * GRAVITY * (1.0 - (1.0 - z) ** 3), rel=1e-9)
        assert turn.kind == "saddle"


def test_fiala_saddles_end_in_full_sliding():
    """z = 1 at speed^2 = critical speed^2 / 3: below it no saddle is left, only the continuum of sliding states."""
    for ratio, count in ((0.578, 3), (0.576, 1)):
        assert len(analysis.equilibria("oversteer", ratio * CRITICAL)) == count


@pytest.mark.parametrize("steer", [(0.0, 0.0), (0.06, 0.06)])
def test_full_sliding_is_a_continuum_and_not_listed(steer):
    speed, yaw_rate = 30.0, GRAVITY * math.cos(steer[0]) / 30.0
    model = NonlinearModel("understeer", speed)
    for lateral_velocity in (-12.0, -15.0, -20.0):
        np.testing.assert_allclose(model.rates(lateral_velocity, yaw_rate, *steer), 0.0, atol=1e-13)
    (turn,) = analysis.equilibria("understeer", speed, steer)
    assert abs(turn.yaw_rate) < 1e-12


# Number and kind


def three(middle):
    return ["saddle", middle, "saddle"]


@pytest.mark.parametrize(
    ("name", "speed", "tire", "expected"),
    [
        ("oversteer", 30.0, "tanh", three("stable node")),
        ("oversteer", 30.0, "fiala", three("stable node")),
        ("oversteer", 40.0, "tanh", ["saddle"]),
        ("oversteer", 40.0, "fiala", ["saddle"]),
        # the tires' peaks turn the wheels' forces round: above the critical speed two stable turns beside the saddle
        ("oversteer", 40.0, "magic_formula", ["stable focus", "saddle", "stable focus"]),
        # laws of one shape on both axles: an understeering car's front axle always slips more, no other turn exists
        ("understeer", 30.0, "tanh", ["stable focus"]),
        ("understeer", 30.0, "fiala", ["stable focus"]),
        # a law that falls beyond its peak lets the rear axle slip more at the same force
        ("understeer", 30.0, "magic_formula", three("stable focus")),
        ("understeer", 15.0, "magic_formula", three("stable focus")),
    ],
)
def test_number_and_kind(name, speed, tire, expected):
    turns = analysis.equilibria(name, speed, tire=tire)
    assert kinds(turns) == expected
    assert turns[len(turns) // 2][:6] == (0.0,) * 6
    assert [turn.yaw_rate for turn in turns] == sorted(turn.yaw_rate for turn in turns)


@pytest.mark.parametrize("tire", tires.LAWS)
@pytest.mark.parametrize("name", vehicles)
def test_straight_running_has_the_linear_eigenvalues(name, tire):
    for speed in (12.0, 50.0):
        (straight,) = [turn for turn in analysis.equilibria(name, speed, tire=tire) if turn.yaw_rate == 0.0]
        expected = np.sort_complex(analysis.eigenvalues(vehicles[name], speed))
        np.testing.assert_allclose(np.sort_complex(straight.eigenvalues), expected, rtol=1e-10)
        assert straight.is_stable == analysis.is_stable(vehicles[name], speed)


def test_the_pitchfork_at_the_critical_speed():
    """Two saddles close in on straight running as sqrt(critical speed - speed); then it is itself a saddle."""
    turns = {
        ratio: analysis.equilibria("oversteer", ratio * CRITICAL, tire="tanh") for ratio in (1 - 1e-6, 1.0, 1 + 1e-6)
    }
    below, at, above = turns.values()
    assert kinds(below) == three("stable node")
    assert kinds(at) == ["degenerate"]
    assert not at[0].is_stable
    assert kinds(above) == ["saddle"]
    # x / tanh x = 1 + x^2 / 3 = 1 + 2e-6; the exact geometry adds terms of the order of the slip angle squared
    assert 110e3 * below[0].front_slip_angle / OVERSTEER.front_axle_load == pytest.approx(math.sqrt(6e-6), rel=0.02)


@pytest.mark.parametrize(
    ("eigenvalues", "kind"),
    [
        ([-1.0, -2.0], "stable node"),
        ([1.0, 2.0], "unstable node"),
        ([-1.0, 2.0], "saddle"),
        ([-1.0 + 2.0j, -1.0 - 2.0j], "stable focus"),
        ([1.0 + 2.0j, 1.0 - 2.0j], "unstable focus"),
        ([1e-12, -2.0], "degenerate"),
        ([0.0, 0.0], "degenerate"),
        ([2.0j, -2.0j], "degenerate"),
    ],
)
def test_kind_by_hand(eigenvalues, kind):
    assert kind_of(np.array(eigenvalues, dtype=complex)) == kind


# All of them: an independent search


def rates_of(vehicle, speed, steer, tire, friction, geometry):
    car = CarParameters(*map(np.float64, car_on_road(vehicle, speed, friction, FRONT, REAR)))
    acting = SingleTrack.of(tire, geometry).axles(NUMPY)

    def rates(x):
        zero = 0.0 * x[0]
        state = CarState(zero, zero, zero, x[0], x[1], zero + steer[0], zero + steer[1])
        result = acting(state, car)
        return np.stack([result.lateral_acceleration - speed * x[1], result.yaw_acceleration])

    return rates


def newton_from_a_grid(vehicle, speed, steer, tire, friction, geometry, count=40):
    """Damped Newton with difference quotients from a grid of states; whatever it finds, without full sliding."""
    rates = rates_of(vehicle, speed, steer, tire, friction, geometry)
    widest = 1.001 * friction * GRAVITY / speed
    x = np.stack(np.meshgrid(np.linspace(-1.0, 1.0, count) * speed, np.linspace(-1.0, 1.0, count) * widest)).reshape(
        2, -1
    )
    scale = np.array([[0.2 * speed], [0.2 * widest]])
    for _ in range(60):
        value = rates(x)
        columns = [(rates(x + step) - rates(x - step)) / 2e-6 for step in 1e-6 * np.eye(2)[:, :, None]]
        determinant = columns[0][0] * columns[1][1] - columns[0][1] * columns[1][0]
        keep = np.abs(determinant) > 1e-9
        x, value, determinant = x[:, keep], value[:, keep], determinant[keep]
        (a, c), (b, d) = (column[:, keep] for column in columns)
        change = -np.stack([d * value[0] - b * value[1], a * value[1] - c * value[0]]) / determinant
        x = x + change / np.maximum(1.0, np.max(np.abs(change) / scale, axis=0))
    value = rates(x)
    inside = (np.max(np.abs(value), axis=0) < 1e-10) & (np.abs(x[0]) < 0.999 * speed)
    x = x[:, inside & (np.abs(determinant) > 1e-5)]  # where both axles slide, it is zero
    return np.unique(np.round(x / scale, 5), axis=1) * scale


@pytest.mark.parametrize("seed", some_of(range(12), range(6)))
def test_an_independent_search_finds_no_other(seed):
    rng = np.random.default_rng(seed)
    vehicle, tire = random_vehicle(rng), NONLINEAR[seed % 3]
    speed, friction = rng.uniform(6.0, 50.0), rng.choice([1.0, 0.3])
    steer = tuple((rng.uniform(-0.15, 0.15, 2) * rng.integers(0, 2, 2)).tolist())
    geometry = ("exact", "small_angle")[seed // 3 % 2]
    turns = analysis.equilibria(vehicle, speed, steer, tire, friction, geometry)
    rates = rates_of(vehicle, speed, steer, tire, friction, geometry)
    ours = np.array([turn[:2] for turn in turns]).reshape(-1, 2)
    for turn in ours:
        np.testing.assert_allclose(rates(turn), 0.0, atol=1e-11)
    for state in newton_from_a_grid(vehicle, speed, steer, tire, friction, geometry).T:
        distance = np.abs(ours - state) / [speed, friction * GRAVITY / speed]
        assert np.min(np.max(distance, axis=1), initial=np.inf) < 1e-4, f"{state} is missing in {ours}"


@pytest.mark.parametrize("seed", range(12))
def test_saddles_and_others_alternate(seed):
    """The index: along the curve of the rear balance, neighbouring zeros of one function have opposite slopes."""
    rng = np.random.default_rng(100 + seed)
    vehicle, speed = random_vehicle(rng), rng.uniform(6.0, 50.0)
    steer = tuple(rng.uniform(-0.15, 0.15, 2).tolist())
    turns = analysis.equilibria(vehicle, speed, steer, NONLINEAR[seed % 3], sideslip_limit=3.0)
    in_order = sorted(turns, key=lambda turn: turn.rear_slip_angle)
    saddles = [turn.kind == "saddle" for turn in in_order]
    assert all(this != following for this, following in itertools.pairwise(saddles))


def test_the_sideslip_limit_selects():
    everything = analysis.equilibria("oversteer", 28.0, (0.003, 0.0))
    sideslips = sorted(abs(turn.sideslip) for turn in everything)
    for limit, count in ((0.05, 1), (0.1, 2), (0.2, 3), (0.9, 5)):
        inside = analysis.equilibria("oversteer", 28.0, (0.003, 0.0), sideslip_limit=limit)
        assert [abs(turn.sideslip) <= limit for turn in inside] == [True] * count
        assert sideslips[:count] == pytest.approx(sorted(abs(turn.sideslip) for turn in inside), abs=1e-12)


def test_the_determinant_is_the_slope_of_the_residual():
    """det J = cos^2(rear slip + rear steer) dr'/d(rear slip), whatever the state on the curve."""
    model, steer = NonlinearModel("oversteer", 28.0, "magic_formula", 0.9), (0.05, -0.03)
    balance, slip = RearBalance(model), np.linspace(-0.6, 0.6, 25)
    determinant = np.linalg.det(model.jacobians(*balance.state(slip, steer[1]), *steer).state)
    expected = np.cos(slip + steer[1]) ** 2 * balance.slope(slip, *steer)
    np.testing.assert_allclose(determinant, expected, rtol=1e-10, atol=1e-10)


@dataclasses.dataclass(frozen=True)
class Cubic(tires.Tire):
    """A user's own law: a cubic that turns flat at two thirds of the friction with a kink in its slope's slope."""

    def law(self, xp):
        def lateral_force(slip_angle, cornering_stiffness, peak_force):
            x = xp.maximum(xp.minimum(slip_angle * (cornering_stiffness / peak_force), 1.0), -1.0)
            return -peak_force * (x - x**3 / 3.0)

        return lateral_force


def test_a_law_of_the_users_own():
    """x (1 - x^2/3) / x = (speed / critical speed)^2 in small angles; rounding at the edge of sliding adds no turn."""
    right, straight, left = analysis.equilibria("oversteer", 0.9 * CRITICAL, tire=Cubic(), geometry="small_angle")
    assert kinds((right, straight, left)) == three("stable node")
    x = 90e3 * right.rear_slip_angle / OVERSTEER.rear_axle_load
    assert x == pytest.approx(math.sqrt(3.0 * (1.0 - 0.9**2)), rel=1e-10)
    assert kinds(analysis.equilibria("oversteer", 0.9 * CRITICAL, tire=Cubic())) == three("stable node")


# Symmetry, simulation, published


@pytest.mark.parametrize("tire", NONLINEAR)
def test_mirrored_steer_mirrors_the_turns(tire):
    steer = (0.04, -0.01)
    left = analysis.equilibria("oversteer", 33.0, steer, tire)
    right = analysis.equilibria("oversteer", 33.0, (-steer[0], -steer[1]), tire)
    assert kinds(left) == kinds(right)[::-1]
    np.testing.assert_allclose([turn[:6] for turn in left], [-np.array(turn[:6]) for turn in right[::-1]], atol=1e-11)


@pytest.mark.parametrize("tire", NONLINEAR)
def test_a_simulated_car_stays_in_its_stable_turn(tire):
    steer = (0.02, 0.005)
    (turn,) = [turn for turn in analysis.equilibria("understeer", 25.0, steer, tire) if turn.is_stable]
    run = simulate("understeer", 25.0, steer, 6.0, tire=tire)  # from straight running
    for name in ("lateral_velocity", "yaw_rate", "sideslip", "front_slip_angle", "rear_slip_angle"):
        assert run[name][-1] == pytest.approx(getattr(turn, name), rel=1e-6), name
    assert run["lateral_acceleration"][-1] == pytest.approx(turn.lateral_acceleration, rel=1e-6)


def test_a_simulated_car_leaves_the_saddle_at_the_rate_of_its_eigenvalue():
    saddle = [turn for turn in analysis.equilibria("oversteer", 28.0, (0.003, 0.0)) if turn.kind == "saddle"][-1]
    start = {"lateral_velocity": saddle.lateral_velocity - 1e-6, "yaw_rate": saddle.yaw_rate + 1e-8}
    run = simulate("oversteer", 28.0, (0.003, 0.0), 20.0, initial_state=start)
    distance = np.abs(run["lateral_velocity"] - saddle.lateral_velocity)
    late = (distance > 1e-5) & (distance < 1e-3)
    rate = np.polyfit(run["time"][late], np.log(distance[late]), 1)[0]
    assert rate == pytest.approx(np.max(saddle.eigenvalues.real), rel=1e-3)


def test_published_skid_pad():
    """MENDES-SKIDPAD-R.constU: the radius of the steady turn itself, without simulation."""
    cases = json.loads((Path(__file__).parent.parent / "data" / "reference_cases.json").read_text(encoding="utf-8"))
    (case,) = [case for case in cases if case["id"] == "MENDES-SKIDPAD-R.constU"]
    given = case["parameters_SI"]
    vehicle = Vehicle(
        mass=given["m"],
        yaw_inertia=given["Iz"],
        cg_to_front=given["a"],
        cg_to_rear=given["b"],
        front_cornering_stiffness=given["Cf"],
        rear_cornering_stiffness=given["Cr"],
    )
    tire = tires.MagicFormula(shape=1.0, curvature=-1.0)
    turns = analysis.equilibria(vehicle, given["U"], (given["delta_f"], 0.0), tire, given["mu"])
    (turn,) = [turn for turn in turns if turn.is_stable]
    radius = math.hypot(given["U"], turn.lateral_velocity) / turn.yaw_rate
    assert radius == pytest.approx(case["published_value"], abs=case["tolerance"])
    assert radius == pytest.approx(case["computed_value"], abs=1e-9)


@pytest.mark.parametrize(("speed", "friction"), [(0.1, 1.0), (1.0, 1.0), (60.0, 0.01), (1000.0, 1.0)])
@pytest.mark.parametrize("tire", NONLINEAR)
def test_extreme_speeds_and_roads(speed, friction, tire):
    steer = (0.01, 0.0)
    turns = analysis.equilibria("understeer", speed, steer, tire, friction)
    assert sum(turn.is_stable for turn in turns) == 1
    rates = rates_of(vehicles["understeer"], speed, steer, tire, friction, "exact")
    for turn in turns:
        np.testing.assert_allclose(rates(np.array(turn[:2])), 0.0, atol=1e-9)
        assert abs(turn.yaw_rate) <= speed * (1.0 + math.tan(0.01)) / 1.4


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"vehicle": "oversteeer"}, "did you mean 'oversteer'"),
        ({"speed": -3.0}, "speed must be"),
        ({"steer": 0.1}, "steer must be a pair"),
        ({"steer": (0.0, float("nan"))}, "steer must be a pair"),
        ({"tire": "slick"}, "tire must be"),
        ({"friction": 0.0}, "friction must be"),
        ({"geometry": "exakt"}, "did you mean 'exact'"),
        ({"sideslip_limit": 0.0}, "sideslip_limit must be"),
    ],
)
def test_bad_input(keywords, message):
    with pytest.raises(ValueError, match=message):
        analysis.equilibria(**{"vehicle": "oversteer", "speed": 30.0} | keywords)
