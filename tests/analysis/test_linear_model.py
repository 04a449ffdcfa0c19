"""The linear model of one control step against the environment's own step, and against closed forms."""

import itertools
import math

import gymnasium as gym
import numpy as np
import pytest
from scipy.linalg import expm

import bicycle_env  # noqa: F401 (registers the environments)
from bicycle_env import Actuator, analysis, vehicles
from bicycle_env.analysis.linear_model import STATE_NAMES, continuous_model, rk4_map
from bicycle_env.physics.actuators import FRONT, REAR

SPEED = 43.0
# Sizes of the deviations: the car's motion is linear, but the rate limits are not to be reached.
SIZES = {
    "lateral_position": 0.25,
    "heading": 0.0625,
    "lateral_velocity": 0.5,
    "yaw_rate": 0.125,
    "front_steer": 0.001,
    "rear_steer": 0.001,
}


def after_one_step(env, state, action):
    env.reset(seed=0, options={"state": state})
    env.step(np.asarray(action, dtype=np.float32))
    return np.array([getattr(env.state, name) for name in STATE_NAMES])


@pytest.mark.parametrize("steer", ["front", "rear", "both"])
def test_one_control_step_of_the_environment(steer):
    """With the linear tire the differences are exact, whatever their size."""
    env = gym.make("BicycleStab-v0", tire="linear", speed=SPEED, steer=steer).unwrapped
    model = env.linear_model()
    axles = len(model.input_names)
    still = np.zeros(axles)
    assert model.state_names == STATE_NAMES == tuple(SIZES)
    a = np.column_stack(
        [
            (after_one_step(env, {name: size}, still) - after_one_step(env, {name: -size}, still)) / (2.0 * size)
            for name, size in SIZES.items()
        ]
    )
    size = 2.0**-8
    b = np.column_stack(
        [
            (after_one_step(env, {}, size * row) - after_one_step(env, {}, -size * row)) / (2.0 * size)
            for row in np.eye(axles)
        ]
    )
    np.testing.assert_allclose(a, model.A, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(b, model.B, rtol=1e-10, atol=1e-12)


def test_the_map_of_the_environment_is_rk4_map_of_the_continuous_model():
    env = gym.make("BicycleStab-v0", tire="linear", speed=SPEED, control_timestep=0.04, physics_timestep=0.02).unwrapped
    model = env.linear_model()
    a, b = continuous_model(vehicles["oversteer"], SPEED, (FRONT, REAR))
    expected = rk4_map(a, b * np.array([FRONT.angle_limit, REAR.angle_limit]), 0.04, 2)
    np.testing.assert_array_equal(model.A, expected[0])
    np.testing.assert_array_equal(model.B, expected[1])
    assert model.timestep == 0.04


@pytest.mark.parametrize("tire", ["tanh", "fiala", "magic_formula"])
def test_saturating_tires_share_the_linear_model(tire):
    env = gym.make("BicycleStab-v0", tire=tire, speed=SPEED).unwrapped
    model, size = env.linear_model(), 1e-6
    still = np.zeros(2)
    columns = [
        (after_one_step(env, {name: size}, still) - after_one_step(env, {name: -size}, still)) / (2.0 * size)
        for name in STATE_NAMES
    ]
    np.testing.assert_allclose(np.column_stack(columns), model.A, rtol=1e-3, atol=1e-4)


def test_continuous_model_by_parts():
    vehicle = vehicles["understeer"]
    front, rear = Actuator(angle_limit=0.1, time_constant=0.05), Actuator(angle_limit=0.1, time_constant=0.2)
    a, b = continuous_model(vehicle, 20.0, (front, rear))
    np.testing.assert_array_equal(a[0], [0.0, 20.0, 1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(a[1], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    np.testing.assert_array_equal(a[2:4, 2:4], analysis.state_matrix(vehicle, 20.0))
    np.testing.assert_array_equal(a[2:4, 4:6], analysis.input_matrix(vehicle, 20.0))
    np.testing.assert_array_equal(a[2:4, :2], 0.0)
    np.testing.assert_allclose(a[4:], [[0, 0, 0, 0, -20.0, 0], [0, 0, 0, 0, 0, -5.0]], rtol=1e-14)
    np.testing.assert_allclose(b, [[0, 0]] * 4 + [[20.0, 0.0], [0.0, 5.0]], rtol=1e-14)


def test_rk4_map_by_hand():
    """x' = -x + u, one step: 1 - h + h^2/2 - h^3/6 + h^4/24, and one minus it for the input."""
    h = 0.5
    a, b = rk4_map(np.array([[-1.0]]), np.array([[1.0]]), h, 1)
    factor = 1 - h + h**2 / 2 - h**3 / 6 + h**4 / 24
    assert a[0, 0] == pytest.approx(factor, rel=1e-15)
    assert b[0, 0] == pytest.approx(1.0 - factor, rel=1e-14)
    a, b = rk4_map(np.array([[-1.0]]), np.array([[1.0]]), 3 * h, 3)
    assert a[0, 0] == pytest.approx(factor**3, rel=1e-14)
    assert b[0, 0] == pytest.approx(1.0 - factor**3, rel=1e-14)


def test_rk4_map_converges_to_the_exponential_with_fourth_order():
    a, b = continuous_model(vehicles["oversteer"], SPEED, (FRONT, REAR))
    whole = np.zeros((8, 8))
    whole[:6, :6], whole[:6, 6:] = a, b
    exact = expm(0.1 * whole)[:6]
    errors = [np.abs(np.hstack(rk4_map(a, b, 0.1, n)) - exact).max() for n in (8, 16, 32)]
    assert errors[-1] > 0.0
    for coarse, fine in itertools.pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(4.0, abs=0.2)
