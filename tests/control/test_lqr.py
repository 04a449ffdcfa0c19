"""Gains of the regulators, against the equations that define them and against brute force."""

import itertools
import json
import math

import gymnasium as gym
import numpy as np
import pytest
from combinations import ON_ROADS, only_all

from bicycle_env import analysis, vehicles
from bicycle_env.analysis.linear_model import continuous_model, rk4_map
from bicycle_env.control.design.gains import continuous_gain, discrete_gain, preview_gain
from bicycle_env.control.lqr import LQR, Weights, read_weights, tuned_weights
from bicycle_env.physics.actuators import FRONT, REAR

IDS = list(ON_ROADS)
STEERS = ("front", "rear", "both")


def plant(steer="both", **keywords):
    return gym.make("BicycleStab-v0", steer=steer, **keywords).unwrapped


def costs(model):
    """Weights that make every state visible."""
    return np.diag([0.25, 10.0, 0.02, 4.0, 0.1, 0.1]), 0.1 * np.eye(len(model.input_names))


@pytest.mark.parametrize("ratio", [0.5, 1.2, 2.0])
@pytest.mark.parametrize("steer", STEERS)
def test_the_discrete_riccati_equation(steer, ratio):
    model = plant(steer, speed_ratio=ratio).linear_model()
    A, B = model.A, model.B
    Q, R = costs(model)
    K, P = discrete_gain(A, B, Q, R)
    assert K.shape == (B.shape[1], 6)
    np.testing.assert_allclose(P, P.T, rtol=1e-8, atol=1e-8 * np.max(P))
    assert np.min(np.linalg.eigvalsh((P + P.T) / 2)) > 0.0
    residual = A.T @ P @ A - P - A.T @ P @ B @ np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A) + Q
    assert np.max(np.abs(residual)) < 1e-9 * np.max(P)
    closed = A - B @ K
    assert np.max(np.abs(np.linalg.eigvals(closed))) < 1.0
    # The cost to go of the closed loop is P itself (a Lyapunov equation, not the Riccati equation).
    np.testing.assert_allclose(closed.T @ P @ closed + Q + K.T @ R @ K, P, rtol=1e-7, atol=1e-9 * np.max(P))
    if ratio > 1.0:
        assert np.max(np.abs(np.linalg.eigvals(A))) > 1.0


@pytest.mark.parametrize("steer", STEERS)
def test_the_continuous_riccati_equation(steer):
    a, b = continuous_model(vehicles["oversteer"], 43.0, (FRONT, REAR))
    b = b[:, {"front": [0], "rear": [1], "both": [0, 1]}[steer]]
    Q, R = np.diag([0.25, 10.0, 0.02, 4.0, 0.1, 0.1]), 20.0 * np.eye(b.shape[1])
    K, _ = continuous_gain(a, b, Q, R)
    closed = a - b @ K
    assert np.max(np.linalg.eigvals(closed).real) < 0.0
    # P from the Lyapunov equation of the closed loop; then K = R^-1 b'P is the optimality condition.
    P = np.linalg.solve(np.kron(np.eye(6), closed.T) + np.kron(closed.T, np.eye(6)), -(Q + K.T @ R @ K).ravel())
    np.testing.assert_allclose(np.linalg.solve(R, b.T @ P.reshape(6, 6)), K, rtol=1e-7)


def test_the_discrete_gain_tends_to_the_continuous_one():
    a, b = continuous_model(vehicles["oversteer"], 43.0, (FRONT, REAR))
    Q, R = np.diag([0.25, 10.0, 0.02, 4.0, 0.1, 0.1]), 20.0 * np.eye(2)
    limit, _ = continuous_gain(a, b, Q, R)
    errors = []
    for timestep in (0.02, 0.01, 0.005, 0.0025):
        A, B = rk4_map(a, b, timestep, 10)
        K, _ = discrete_gain(A, B, Q * timestep, R * timestep)
        errors.append(np.max(np.abs(K - limit)) / np.max(np.abs(limit)))
    assert errors[-1] < 0.05
    for coarse, fine in itertools.pairwise(errors):
        assert 1.7 < coarse / fine < 2.3, "first order in the timestep"


def test_the_least_cost_is_the_cost_of_a_long_simulation():
    model = plant().linear_model()
    Q, R = costs(model)
    K, P = discrete_gain(model.A, model.B, Q, R)
    x0 = np.array([0.5, 0.1, -1.0, 0.2, 0.01, 0.0])
    x, cost = x0, 0.0
    for _ in range(4000):
        u = -K @ x
        cost += x @ Q @ x + u @ R @ u
        x = model.A @ x + model.B @ u
    assert cost == pytest.approx(x0 @ P @ x0, rel=1e-9)


# Preview


def brute_force(A, B, Q, R, reference, horizon, steps=4000):
    """The gains of a long finite horizon for the car and the signal together, by the Riccati difference equation."""
    n, m = len(A), horizon + 1
    shift = np.eye(m, k=1)
    shift[-1, -1] = 1.0
    big = np.zeros((n + m, n + m))
    big[:n, :n], big[n:, n:] = A, shift
    steer = np.vstack([B, np.zeros((m, B.shape[1]))])
    wanted = np.hstack([np.eye(n), -reference])
    cost = wanted.T @ Q @ wanted
    P = cost.copy()
    for _ in range(steps):
        gain = np.linalg.solve(R + steer.T @ P @ steer, steer.T @ P @ big)
        P = cost + big.T @ P @ (big - steer @ gain)
        P = 0.5 * (P + P.T)
    return gain[:, :n], gain[:, n:]


def wanted_path(model, speed, horizon):
    """Lateral position, heading and yaw rate of a path given by its positions, a control step apart."""
    step = speed * model.timestep
    wanted = np.zeros((6, horizon + 1))
    wanted[0, 0] = 1.0
    wanted[1, :2] = np.array([-1.0, 1.0]) / step
    wanted[3, :3] = np.array([1.0, -2.0, 1.0]) / (step * model.timestep)
    return wanted


@pytest.mark.parametrize("horizon", [2, 5, 20])
@pytest.mark.parametrize("steer", STEERS)
def test_the_preview_gain_is_the_one_of_brute_force(steer, horizon):
    env = plant(steer)
    model = env.linear_model()
    Q, R = np.diag([0.25, 10.0, 0.0, 4.0, 0.0, 0.0]), 0.1 * np.eye(model.B.shape[1])
    wanted = wanted_path(model, env.speed, horizon)
    K, G = preview_gain(model.A, model.B, Q, R, wanted, horizon)
    K_long, G_long = brute_force(model.A, model.B, Q, R, wanted, horizon)
    assert G.shape == (model.B.shape[1], horizon + 1)
    np.testing.assert_allclose(K, K_long, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(G, G_long, rtol=1e-6, atol=1e-6 * np.max(np.abs(G)))
    assert np.max(np.abs(G)) > 0.01


@pytest.mark.parametrize("points", [3, 10])
def test_the_policy_uses_the_path_up_to_its_last_point(points):
    """With a point in each control step its preview is the brute force's, the last point included."""
    spacing = 0.02
    env = gym.make("BicycleLaneChange-v0", preview_length=points * spacing, preview_spacing=spacing).unwrapped
    assert len(env.task.preview_times) == points
    weights, model = tuned_weights("lane_change"), env.linear_model()
    Q, R = weights.matrices(env.speed, model.input_names)
    _, expected = brute_force(model.A, model.B, Q, R, wanted_path(model, env.speed, points), points)
    np.testing.assert_allclose(LQR(env).preview, expected, rtol=1e-5, atol=1e-6 * np.max(np.abs(expected)))


def test_the_preview_gain_of_a_scalar_plant_by_hand():
    """x+ = x + u, cost (x - w)^2 + u^2: P = (1 + sqrt 5)/2, K = P/(1 + P) = 1/P; a step ahead weighs 1 - K as much."""
    golden = (1.0 + math.sqrt(5.0)) / 2.0
    one = np.eye(1)
    horizon = 6
    wanted = np.zeros((1, horizon + 1))
    wanted[0, 0] = 1.0
    K, G = preview_gain(one, one, one, one, wanted, horizon)
    assert K[0, 0] == pytest.approx(1.0 / golden, rel=1e-12)
    # u = -K x - G w with s = -sum over i of (1-K)^i w_{k+i}; w_0 is past mending.
    rho = 1.0 - 1.0 / golden
    expected = [0.0, *(-(rho**i) / (1.0 + golden) for i in range(horizon))]
    expected[-1] = -(rho ** (horizon - 1)) / (1.0 + golden) / (1.0 - rho)  # the last value is held for ever
    np.testing.assert_allclose(G[0], expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("horizon", [2, 10, 60])
@pytest.mark.parametrize("steer", STEERS)
def test_a_path_that_is_moved_aside_moves_the_car_aside(steer, horizon):
    env = plant(steer)
    model = env.linear_model()
    Q, R = np.diag([0.25, 10.0, 0.0, 4.0, 0.0, 0.0]), 0.1 * np.eye(model.B.shape[1])
    K, G = preview_gain(model.A, model.B, Q, R, wanted_path(model, env.speed, horizon), horizon)
    np.testing.assert_allclose(K[:, 0] + G.sum(axis=1), 0.0, atol=1e-9 * np.max(np.abs(G)))
    assert np.all(np.abs(K[:, 0]) > 1e-3)


def test_a_longer_preview_adds_what_was_missing_and_converges():
    env = plant()
    model = env.linear_model()
    Q, R = np.diag([0.25, 10.0, 0.0, 4.0, 0.0, 0.0]), 0.1 * np.eye(2)
    gains = [
        preview_gain(model.A, model.B, Q, R, wanted_path(model, env.speed, horizon), horizon)[1]
        for horizon in (50, 100, 200)
    ]
    first = np.max(np.abs(gains[0][:, :40] - gains[1][:, :40]))
    assert first < 1e-8 * np.max(np.abs(gains[0]))
    assert np.max(np.abs(gains[2][:, 150:])) < 0.05 * np.max(np.abs(gains[2]))


# The policy


@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", IDS)
def test_the_policy_is_its_gains(env_id, steer):
    env = gym.make(env_id, steer=steer).unwrapped
    policy = LQR(env)
    lane_change = "Lane" in env_id
    previews = len(env.task.preview_times)
    assert policy.gain.shape == (len(policy.model.input_names), 6)
    assert policy.preview.shape == (len(policy.model.input_names), previews + 1)
    rng = np.random.default_rng(1)
    unclipped = 0
    for seed in range(30):
        state = {"lateral_position": rng.uniform(-0.05, 0.05), "heading": rng.uniform(-0.01, 0.01)}
        state |= {"lateral_velocity": rng.uniform(-0.2, 0.2), "yaw_rate": rng.uniform(-0.02, 0.02)}
        state |= {"front_steer": rng.uniform(-0.005, 0.005), "rear_steer": rng.uniform(-0.005, 0.005)}
        state["longitudinal_position"] = rng.uniform(0.0, 5.0)
        observation, _ = env.reset(seed=seed, options={"state": state})
        x = np.array([getattr(env.state, name) for name in policy.model.state_names])
        x[0] = 0.0  # lateral positions are counted from the car
        w = [env.measure()["reference_lateral_position"] - env.state.lateral_position]
        if lane_change:
            w += list(observation[10:].astype(float))
        expected = -policy.gain @ x - policy.preview @ w
        unclipped += int(np.all(np.abs(expected) < 1.0))
        action = policy.act(observation)
        assert action.dtype == np.float32
        np.testing.assert_allclose(action, np.clip(expected, -1.0, 1.0), atol=2e-6)
    assert unclipped >= 5


@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", IDS)
def test_the_policy_does_not_care_where_the_lane_is(env_id, steer):
    policy = LQR(gym.make(env_id, steer=steer).unwrapped)
    largest = np.max(np.abs(policy.preview))
    np.testing.assert_allclose(policy.gain[:, 0] + policy.preview.sum(axis=1), 0.0, atol=1e-8 * largest)


@pytest.mark.parametrize(
    "keywords", [{"preview_length": 0.0}, only_all({"preview_length": 0.1}), only_all({"preview_length": 0.5}), {}]
)
def test_previews_of_any_length(keywords, interpreted):
    env = gym.make("BicycleLaneChange-v0", **keywords).unwrapped
    policy = LQR(env)
    observation, _ = env.reset(options={"state": {}, "direction": "left", "change_start": 0.02})
    ahead = policy.act(observation)
    assert ahead.shape == (2,)
    observation, _ = env.reset(options={"state": {}, "direction": "right", "change_start": 0.02})
    np.testing.assert_array_equal(policy.act(observation), -ahead)
    assert np.any(ahead != 0.0) == (len(env.task.preview_times) > 0)


@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", IDS)
def test_the_linear_closed_loop_is_stable(env_id, steer):
    policy = LQR(gym.make(env_id, steer=steer, vehicle="oversteer", speed_ratio=1.2).unwrapped)
    closed = policy.model.A - policy.model.B @ policy.gain
    assert np.max(np.abs(np.linalg.eigvals(closed))) < 1.0
    assert np.max(np.abs(np.linalg.eigvals(policy.model.A))) > 1.0


def test_it_holds_a_car_that_would_spin():
    for steer in STEERS:
        env = gym.make("BicycleStab-v0", steer=steer).unwrapped
        policy = LQR(env)
        observation, _ = env.reset(options={"state": {"yaw_rate": 0.02, "lateral_position": 0.05}})
        for _ in range(400):
            observation, _, terminated, _, _ = env.step(policy.act(observation))
            assert not terminated
        assert max(map(abs, observation)) < 0.05


def test_other_weights_are_another_policy():
    env = plant()
    weights = tuned_weights("stabilise")
    default, same = LQR(env), LQR(env, weights)
    other = LQR(env, weights._replace(heading=weights.heading * 3.0))
    assert np.array_equal(default.gain, same.gain)
    assert not np.allclose(default.gain, other.gain)
    assert isinstance(tuned_weights("lane_change"), Weights)


def test_weights_are_on_what_their_names_say():
    """sideslip is V/U: its weight, divided by U^2, is the one on V."""
    env = plant()
    weights = Weights(0.25, 10.0, 30.0, 4.0, 0.1, 0.2)
    model = env.linear_model()
    Q = np.diag([0.25, 10.0, 30.0 / env.speed**2, 4.0, 0.0, 0.0])
    K, _ = discrete_gain(model.A, model.B, Q, np.diag([0.1, 0.2]))
    np.testing.assert_allclose(LQR(env, weights).gain, K, rtol=1e-9)


def test_the_stability_that_the_design_starts_from():
    env = plant()
    growth = max(np.log(np.linalg.eigvals(env.linear_model().A.astype(complex))).real) / env.control_timestep
    assert growth == pytest.approx(max(analysis.eigenvalues(env.vehicle, env.speed).real), rel=1e-6)


GOOD = tuned_weights("stabilise")._asdict()


def test_weights_from_a_file(tmp_path):
    path = tmp_path / "weights.json"
    path.write_text(json.dumps({"command": "whatever", "weights": GOOD}))
    assert read_weights(path) == tuned_weights("stabilise")


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("[1", "JSON"),
        ("[]", "must be a table of weights"),
        ('{"command": 1}', "missing: 'weights'"),
        (json.dumps({"weights": {**GOOD, "heading": 0.0}}), "weights.heading must be"),
        (json.dumps({"weights": {**GOOD, "heading": "1"}}), "weights.heading must be"),
        (json.dumps({"weights": {**GOOD, "headnig": 1.0}}), "did you mean 'heading'"),
        (json.dumps({"weights": {"heading": 1.0}}), "missing: 'lateral_position'"),
    ],
)
def test_a_damaged_file_of_weights_is_one_line_that_names_it(tmp_path, content, text):
    path = tmp_path / "weights.json"
    path.write_text(content)
    with pytest.raises(ValueError, match=text) as raised:
        read_weights(path)
    assert "weights.json" in str(raised.value)
    assert "\n" not in str(raised.value)
