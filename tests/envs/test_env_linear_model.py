"""linear_model(): exactly what a control step integrates, and a cost that theory predicts to the last digits."""

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import Actuator, analysis, vehicles
from bicycle_env.control.design.gains import discrete_gain

STEERS = ("front", "rear", "both")
LINEAR = {"tire": "linear", "geometry": "small_angle"}
STRAIGHT = {"BicycleStab-v0": {}, "BicycleLaneChange-v0": {"change_start": 100.0}}
"""Keywords with which the reference of a whole episode is the straight line y = 0; other tasks have no such ones."""
IDS = list(STRAIGHT)

VARIANTS = {
    "default": {},
    "one substep": {"physics_timestep": 0.02},
    "five times as long": {"control_timestep": 0.1, "physics_timestep": 0.01},
    "no rate limit": {"front_actuator": Actuator(0.3, time_constant=0.2), "rear_actuator": Actuator(0.1)},
    "below the critical speed": {"speed_ratio": 0.5},
    "understeer": {"vehicle": "understeer", "speed": 25.0},
    "neutral": {"vehicle": "neutral", "speed": 60.0},
}


def vector(env):
    return np.array([getattr(env.state, name) for name in env.linear_model().state_names])


def start(env, x):
    model = env.linear_model()
    env.reset(options={"state": dict(zip(model.state_names, x.tolist(), strict=True))})


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", IDS)
def test_a_step_is_the_linear_map(env_id, steer, variant):
    env = gym.make(env_id, steer=steer, **LINEAR, **STRAIGHT[env_id], **VARIANTS[variant]).unwrapped
    model = env.linear_model()
    axles = 2 if steer == "both" else 1
    assert model.A.shape == (6, 6)
    assert model.B.shape == (6, axles)
    rng = np.random.default_rng(1)
    for _ in range(20):
        # Small enough that neither a limit of a rate nor of the lane is reached.
        x = rng.uniform(-1.0, 1.0, 6) * [0.3, 0.05, 1.0, 0.1, 1e-3, 1e-3]
        u = rng.uniform(-0.03, 0.03, axles)
        start(env, x)
        assert not env.step(u)[2]
        np.testing.assert_allclose(vector(env), model.A @ x + model.B @ u, rtol=0.0, atol=1e-12)
        assert not np.allclose(vector(env), model.A @ x, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("steer", STEERS)
def test_names_scales_and_costs(steer):
    env = gym.make("BicycleStab-v0", steer=steer).unwrapped
    model = env.linear_model()
    names = {"front": ("front_steer_command",), "rear": ("rear_steer_command",)}
    assert model.input_names == names.get(steer, names["front"] + names["rear"])
    limits = {"front": [env.front_actuator.angle_limit], "rear": [env.rear_actuator.angle_limit]}
    assert model.input_scale.tolist() == limits.get(steer, limits["front"] + limits["rear"])
    assert model.timestep == env.control_timestep
    assert model.state_names == (
        "lateral_position",
        "heading",
        "lateral_velocity",
        "yaw_rate",
        "front_steer",
        "rear_steer",
    )
    assert np.count_nonzero(model.Q - np.diag(np.diag(model.Q))) == 0
    assert model.Q.shape == (6, 6)
    assert model.R.shape == (len(model.input_names),) * 2


@pytest.mark.parametrize(("tire", "geometry"), [("fiala", "exact"), ("tanh", "exact"), ("magic_formula", "exact")])
def test_it_is_the_linearisation_of_the_saturating_cars_too(tire, geometry):
    """The error of a step falls with the square of the deviation at least."""
    env = gym.make("BicycleStab-v0", tire=tire, geometry=geometry).unwrapped
    model = env.linear_model()
    direction = np.array([0.1, 0.02, 0.8, 0.1, 0.001, -0.001])
    command = np.array([0.02, -0.02])
    errors = []
    for size in (1.0, 0.1, 0.01):
        start(env, size * direction)
        env.step(size * command)
        errors.append(np.max(np.abs(vector(env) - size * (model.A @ direction + model.B @ command))))
    assert errors[0] > 1e-7
    assert errors[1] < errors[0] / 50.0
    assert errors[2] < errors[1] / 50.0


def test_the_limit_of_a_short_step_is_the_state_matrix():
    vehicle = vehicles["oversteer"]
    env = gym.make("BicycleStab-v0", control_timestep=1e-6, physics_timestep=1e-6).unwrapped
    model = env.linear_model()
    rates = (model.A - np.eye(6)) / 1e-6
    np.testing.assert_allclose(rates[2:4, 2:4], analysis.state_matrix(vehicle, env.speed), rtol=1e-4)
    np.testing.assert_allclose(rates[2:4, 4:6], analysis.input_matrix(vehicle, env.speed), rtol=1e-4)
    np.testing.assert_allclose(rates[0, :4], [0.0, env.speed, 1.0, 0.0], atol=1e-4)
    assert rates[1, 3] == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", IDS)
def test_the_reward_is_the_quadratic_stage_cost(env_id, steer):
    env = gym.make(env_id, steer=steer, reward="quadratic", **STRAIGHT[env_id]).unwrapped
    model = env.linear_model()
    rng = np.random.default_rng(2)
    for _ in range(20):
        x = rng.uniform(-1.0, 1.0, 6) * [0.5, 0.1, 2.0, 0.4, 0.05, 0.05]
        u = rng.uniform(-1.5, 1.5, len(model.input_names))
        clipped = np.clip(u, -1.0, 1.0)
        start(env, x)
        reward = env.step(u)[1]
        assert reward == pytest.approx(-(x @ model.Q @ x + clipped @ model.R @ clipped), rel=1e-13)


def run_lqr(env, gain, x0):
    """Cost and last state of an episode with u = -K x, and how near it came to a limit."""
    start(env, x0)
    cost, largest = 0.0, 0.0
    for _ in range(env.task.episode_steps):
        x = vector(env)
        action = -gain @ x
        largest = max(largest, float(np.max(np.abs(action))))
        _, reward, terminated, _, _ = env.step(action)
        assert not terminated
        cost -= reward
    assert largest < 0.1
    return cost, vector(env)


@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", IDS)
def test_the_measured_cost_of_the_lqr_is_the_predicted_one(env_id, steer):
    env = gym.make(env_id, steer=steer, reward="quadratic", **LINEAR, **STRAIGHT[env_id]).unwrapped
    model = env.linear_model()
    gain, P = discrete_gain(model.A, model.B, model.Q, model.R)
    rng = np.random.default_rng(3)
    for _ in range(2):
        x0 = rng.uniform(-1.0, 1.0, 6) * [1e-3, 1e-4, 1e-3, 1e-4, 1e-5, 1e-5]
        cost, last = run_lqr(env, gain, x0)
        assert cost + last @ P @ last == pytest.approx(x0 @ P @ x0, rel=1e-9)
        assert last @ P @ last < 0.05 * (x0 @ P @ x0), "the car was not stabilised"
        for factor in (0.9, 1.1):
            worse, end = run_lqr(env, factor * gain, x0)
            assert worse + end @ P @ end > (1.0 + 1e-4) * (x0 @ P @ x0)
