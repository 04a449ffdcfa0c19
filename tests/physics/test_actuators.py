"""The steering actuators: lag, rate limit, and what their constructor refuses."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest

from bicycle_env import Actuator, vehicles
from bicycle_env.physics.actuators import FRONT, REAR, resolve, steer_rate
from bicycle_env.physics.car import CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY, PYTHON
from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.physics.tires import Linear

AT_REST = CarState(*[0.0] * 7)


def follow(front, rear, command, duration, timestep=1e-3):
    """Histories of the two steer angles while both commands are held."""
    advance = rk4(PYTHON, CarState, SingleTrack(Linear(), "small_angle").actuated_rates(PYTHON))
    car = car_on_road(vehicles["understeer"], 20.0, 1.0, front, rear)
    state, angles = AT_REST, [(0.0, 0.0)]
    for _ in range(round(duration / timestep)):
        state = advance(state, command, command, command, car, timestep)
        angles.append((state.front_steer, state.rear_steer))
    return np.array(angles), np.arange(len(angles)) * timestep


def test_step_response_of_the_lag():
    front = Actuator(angle_limit=0.1, time_constant=0.05)
    rear = Actuator(angle_limit=0.1, time_constant=0.12)
    angles, time = follow(front, rear, (0.08, -0.03), 0.6)
    np.testing.assert_allclose(angles[:, 0], 0.08 * -np.expm1(-time / 0.05), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(angles[:, 1], -0.03 * -np.expm1(-time / 0.12), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_rate_limit_is_reached_and_not_passed(side):
    front = Actuator(angle_limit=0.3, rate_limit=0.5, time_constant=0.05)
    rear = Actuator(angle_limit=0.3, rate_limit=0.2, time_constant=0.05)
    angles, time = follow(front, rear, (side * 0.2, side * 0.2), 0.3)
    # limited until the remaining angle is rate_limit x time_constant, a lag from there
    for angle, limit in zip(side * angles.T, (0.5, 0.2), strict=True):
        handover = (0.2 - limit * 0.05) / limit
        limited = time <= handover
        np.testing.assert_allclose(angle[limited], limit * time[limited], rtol=0.0, atol=1e-12)
        assert np.diff(angle).max() <= limit * 1e-3 * (1.0 + 1e-9)
        later = time >= handover + 1e-3
        expected = 0.2 - limit * 0.05 * np.exp(-(time[later] - handover) / 0.05)
        np.testing.assert_allclose(angle[later], expected, rtol=0.0, atol=1e-6)


def test_the_law_by_hand():
    rate = steer_rate(PYTHON)
    assert rate(0.01, 0.03, math.inf, 0.05) == pytest.approx(0.4, rel=1e-14)
    assert rate(0.01, 0.03, 0.1, 0.05) == 0.1
    assert rate(0.03, 0.01, 0.1, 0.05) == -0.1
    assert rate(0.02, 0.02, 0.1, 0.05) == 0.0


def test_the_law_is_odd_to_the_bit():
    rng = np.random.default_rng(0)
    steer, command = rng.uniform(-0.1, 0.1, (2, 1000))
    rate = steer_rate(NUMPY)
    assert np.array_equal(rate(-steer, -command, 0.7, 0.05), -rate(steer, command, 0.7, 0.05))


@pytest.mark.parametrize("name", ["angle_limit", "rate_limit", "time_constant"])
@pytest.mark.parametrize(
    ("bad", "error"),
    [
        (math.nan, ValueError),
        (-math.inf, ValueError),
        (0.0, ValueError),
        (-0.1, ValueError),
        ("fast", TypeError),
        (None, TypeError),
        (True, TypeError),
        ([0.1], TypeError),
    ],
    ids=repr,
)
def test_a_bad_value_is_named(name, bad, error):
    with pytest.raises(error, match=rf"^{name} must be"):
        Actuator(**({"angle_limit": 0.1} | {name: bad}))


def test_infinite_values():
    assert Actuator(angle_limit=0.1, rate_limit=math.inf).rate_limit == math.inf
    for name in ("angle_limit", "time_constant"):
        with pytest.raises(ValueError, match=name):
            Actuator(**({"angle_limit": 0.1} | {name: math.inf}))


def test_the_angle_limit_stays_below_a_right_angle():
    with pytest.raises(ValueError, match="angle_limit"):
        Actuator(angle_limit=math.pi / 2)
    assert Actuator(angle_limit=1.57).angle_limit == 1.57


def test_an_unknown_keyword_is_answered_with_the_nearest():
    with pytest.raises(TypeError, match=r"'rate_limits'; did you mean 'rate_limit'\?"):
        Actuator(angle_limit=0.1, rate_limits=1.0)


def test_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        FRONT.angle_limit = 0.2


def test_the_defaults():
    assert math.degrees(FRONT.angle_limit) == pytest.approx(6.0)
    assert math.degrees(REAR.angle_limit) == pytest.approx(3.0)
    assert math.degrees(FRONT.rate_limit) == pytest.approx(40.0)
    assert math.degrees(REAR.rate_limit) == pytest.approx(9.0)


@pytest.mark.parametrize("infinity", [math.inf, np.float32("inf"), np.float64("inf"), np.array(np.inf)])
def test_infinity_of_any_type_switches_the_rate_limit_off(infinity):
    assert Actuator(angle_limit=0.1, rate_limit=infinity) == Actuator(angle_limit=0.1)


@pytest.mark.parametrize("bad", [-math.inf, np.float32("-inf"), np.float32("nan")])
def test_other_unbounded_rate_limits_are_refused(bad):
    with pytest.raises(ValueError, match="rate_limit must be a finite number"):
        Actuator(angle_limit=0.1, rate_limit=bad)


@pytest.mark.parametrize("actuator", [FRONT, REAR, Actuator(angle_limit=0.1)])
def test_the_plain_form_makes_the_actuator_again(actuator):
    assert resolve("front_actuator", json.loads(json.dumps(dataclasses.asdict(actuator)))) == actuator
    assert resolve("front_actuator", actuator) is actuator


def test_the_plain_form_has_defaults_and_takes_numpys_scalars():
    assert resolve("rear_actuator", {"angle_limit": np.float64(0.1)}) == Actuator(angle_limit=0.1)


@pytest.mark.parametrize(
    ("bad", "error", "text"),
    [
        ({"angle": 0.1}, ValueError, "unknown field of front_actuator 'angle'; did you mean 'angle_limit'?"),
        ({}, ValueError, "front_actuator: missing field 'angle_limit'"),
        ({"angle_limit": 2.0}, ValueError, "front_actuator: angle_limit must be"),
        ({"angle_limit": "wide"}, TypeError, "front_actuator: angle_limit must be"),
        (0.1, TypeError, "front_actuator must be an Actuator(angle_limit, rate_limit, time_constant) or a dict"),
    ],
)
def test_a_mistake_in_a_plain_form_is_named(bad, error, text):
    with pytest.raises(error, match=re.escape(text)):
        resolve("front_actuator", bad)
