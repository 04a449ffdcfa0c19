"""Pole placement, continuous and scheduled LQR as policies: their poles, their decay in simulation, their paths."""

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import analysis
from bicycle_env.control import LQR, ContinuousLQR, PolePlacement, ScheduledLQR
from bicycle_env.control.pole_placement import steady_turn, wanted_poles

IDS = ("BicycleStab-v0", "BicycleLaneChange-v0")
STEERS = ("front", "rear", "both")


def plant(env_id="BicycleStab-v0", steer="both", **keywords):
    return gym.make(env_id, steer=steer, **keywords).unwrapped


def by_size(values):
    return np.sort_complex(np.asarray(values, complex))


# Closed loops against simulation


@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("kind", [LQR, ContinuousLQR, ScheduledLQR, PolePlacement])
def test_the_decay_in_the_environment_is_that_of_the_closed_loop(kind, steer):
    """The nonlinear car (Fiala tire, exact geometry), started along the slowest mode at a small amplitude."""
    car = plant(steer=steer)
    policy = kind(car)
    gain = policy.gain_at(car.speed) if kind is ScheduledLQR else policy.gain
    model = car.linear_model()
    values, modes = np.linalg.eig(model.A - model.B @ gain)
    slowest = np.argmax(np.abs(values))
    assert abs(values[slowest]) < 1.0
    start = np.real(modes[:, slowest])
    start *= 1e-4 / np.max(np.abs(start))
    car.reset(options={"state": dict(zip(model.state_names, start.tolist(), strict=True))})
    expected, steps = start, 60
    observation = car.restore(car.snapshot())
    for _ in range(steps):
        # Observations are float32 and near zero: rounding is relative, so the action is exact enough.
        observation, *_ = car.step(policy.act(observation).astype(float))
        expected = (model.A - model.B @ gain) @ expected
        state = np.array([getattr(car.state, name) for name in model.state_names])
        np.testing.assert_allclose(state, expected, atol=2e-3 * np.max(np.abs(start)))
    assert np.max(np.abs(expected)) < 0.95 * np.max(np.abs(start))


@pytest.mark.parametrize("kind", [ContinuousLQR, PolePlacement])
@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", IDS)
def test_a_path_that_is_moved_aside_moves_the_car_aside(env_id, steer, kind):
    """Only distances matter: the same observation, the whole road moved, gives the same action."""
    car = plant(env_id, steer)
    policy = kind(car)
    observation = np.random.default_rng(0).uniform(-0.01, 0.01, len(car.observation_names)).astype(np.float32)
    moved = observation.copy()
    if "Lane" in env_id:
        moved[car.observation_names.index("lateral_position")] += 2.0
        np.testing.assert_allclose(policy.act(moved), policy.act(observation), atol=2e-6)
    np.testing.assert_array_equal(policy.act(-observation), -policy.act(observation))


@pytest.mark.parametrize("steer", ["front", "both"])
def test_continuous_lqr_follows_a_lane_change(steer):
    car = plant("BicycleLaneChange-v0", steer)
    policy, regulator = ContinuousLQR(car), LQR(car)
    for chosen in (policy, regulator):
        observation, _ = car.reset(seed=2)
        for _ in range(299):
            observation, _, terminated, _, _ = car.step(chosen.act(observation))
            assert not terminated
        car.step(chosen.act(observation))
        assert car.is_success
    assert policy.model.timestep == 0.0
    assert policy.preview.shape == regulator.preview.shape


# Pole placement


@pytest.mark.parametrize("speed_ratio", [0.6, 1.0, 1.2, 1.6])
@pytest.mark.parametrize("steer", STEERS)
def test_pole_placement_hits_its_poles(steer, speed_ratio):
    car = plant(steer=steer, speed_ratio=speed_ratio)
    policy = PolePlacement(car)
    model = policy.model
    closed = np.linalg.eigvals(model.A - model.B @ policy.gain)
    expected = np.exp(policy.poles * model.timestep)
    if steer != "both":  # the actuator of the other axle
        idle = car.rear_actuator if steer == "front" else car.front_actuator
        expected = np.append(expected, np.exp(-model.timestep / idle.time_constant))
    np.testing.assert_allclose(by_size(closed), by_size(expected), rtol=1e-5)


def test_the_wanted_poles_follow_from_the_open_loop():
    car = plant(speed_ratio=1.5)
    unstable, stable = sorted(analysis.eigenvalues(car.vehicle, car.speed).real, reverse=True)
    assert unstable > 1.0
    poles = wanted_poles(car, 0.5, 0.7)
    np.testing.assert_allclose(poles[:2], 0.5 * (-0.7 + np.array([1j, -1j]) * np.sqrt(1 - 0.7**2)))
    assert {round(pole.real, 9) for pole in poles[2:4]} == {round(-unstable, 9), round(stable, 9)}
    assert len(poles) == 6
    assert len(set(np.round(poles, 6))) == 6
    # An understeering car at speed is badly damped: the frequency stays, the damping rises.
    calm = plant(vehicle="understeer", speed=60.0)
    own = analysis.eigenvalues(calm.vehicle, calm.speed)
    ratio = -own[0].real / abs(own[0])
    assert ratio < 0.7
    body = wanted_poles(calm, 2.0, 0.7)[2:4]
    np.testing.assert_allclose(np.abs(body), np.abs(own))
    np.testing.assert_allclose(-body.real / np.abs(body), 0.7)
    well = wanted_poles(calm, 2.0, 0.9 * ratio)[2:4]
    np.testing.assert_allclose(by_size(well), by_size(own))


@pytest.mark.parametrize("keywords", [{"path_frequency": -1.0}, {"least_damping": 0.0}, {"least_damping": 1.5}])
def test_bad_poles_are_refused(keywords):
    with pytest.raises(ValueError, match=next(iter(keywords))):
        PolePlacement(plant(), **keywords)


@pytest.mark.parametrize("steer", STEERS)
def test_pole_placement_steers_ahead_by_the_lag_and_half_a_step(steer):
    """Ahead of a car that stands on the path y = t^3 the acceleration is 6 t, of y = t^2 it is 2: their ratio is 3 t.

    A command is held for a step, so on the average it comes half a step late, and the wheels follow by their lag.
    """
    car = plant("BicycleLaneChange-v0", steer)
    times = np.array(car.task.preview_times)
    actions = []
    for power in (2, 3):
        observation = np.zeros(len(car.observation_names))
        observation[-len(times) :] = times**power / car.observation_scale[-len(times) :]
        actions.append(observation @ steady_turn(car)[1])
    actuators = {"front": [car.front_actuator], "rear": [car.rear_actuator]}.get(
        steer, [car.front_actuator, car.rear_actuator]
    )
    expected = [actuator.time_constant + 0.5 * car.control_timestep for actuator in actuators]
    np.testing.assert_allclose(actions[1] / actions[0] / 3.0, expected, rtol=1e-9)


@pytest.mark.parametrize("steer", STEERS)
def test_pole_placement_holds_a_steady_turn(steer):
    """On a path of constant curvature the linear car, started in the steady turn, stays on it."""
    car = plant("BicycleLaneChange-v0", steer, tire="linear")
    policy = PolePlacement(car)
    model, names, scale = policy.model, car.observation_names, car.observation_scale
    yaw_rate = 0.02
    times = np.array([0.0, *car.task.preview_times])
    x = None
    for k in range(100):
        now = k * model.timestep
        path = 0.5 * car.speed * yaw_rate * (now + times) ** 2  # lateral acceleration U r
        course = yaw_rate * now
        if x is None:
            x = steady_state(car, policy, yaw_rate)
        observation = np.zeros(len(names))
        for name, value in zip(model.state_names, x, strict=True):
            observation[names.index(name)] = value
        observation[names.index("lateral_error")] = x[0] - path[0]
        observation[names.index("heading_error")] = x[1] - course
        observation[-len(times) + 1 :] = path[1:] - x[0]
        x = model.A @ x + model.B @ policy.act(observation / scale)
    end = 100 * model.timestep
    assert x[0] == pytest.approx(0.5 * car.speed * yaw_rate * end**2, abs=2e-3)
    assert x[3] == pytest.approx(yaw_rate, rel=1e-3)


def steady_state(car, policy, yaw_rate):
    """States of the turn: r, V and steer with V' = r' = 0 (least squares for two axles), heading by y' = V + U psi."""
    axles = [0] if car.steer == "front" else [1] if car.steer == "rear" else [0, 1]
    A, B = analysis.state_matrix(car.vehicle, car.speed), analysis.input_matrix(car.vehicle, car.speed)[:, axles]
    unknown = np.linalg.lstsq(np.column_stack([A[:, 0] * car.speed, B]), -A[:, 1] * yaw_rate, rcond=None)[0]
    x = np.zeros(6)
    x[1], x[2], x[3] = -unknown[0], car.speed * unknown[0], yaw_rate
    x[[4 + axle for axle in axles]] = unknown[1:]
    return x


# Gain scheduling


@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", IDS)
def test_at_its_nodes_the_schedule_is_the_direct_design(env_id, steer):
    car = plant(env_id, steer)
    policy = ScheduledLQR(car, speeds=[30.0, car.speed, 50.0])
    for speed in policy.speeds:
        direct = LQR(plant(env_id, steer, speed=float(speed)))
        np.testing.assert_allclose(policy.gain_at(speed), direct.gain, rtol=1e-9)
        np.testing.assert_allclose(policy.preview_at(speed), direct.preview, rtol=1e-9, atol=1e-12)
    observation = np.random.default_rng(1).uniform(-0.02, 0.02, (7, len(car.observation_names))).astype(np.float32)
    np.testing.assert_allclose(policy.act(observation), LQR(car).act(observation), atol=1e-6)


@pytest.mark.parametrize("steer", STEERS)
def test_between_its_nodes_the_schedule_stabilises(steer):
    car = plant(steer=steer)
    policy = ScheduledLQR(car)
    assert len(policy.speeds) == 9
    for speed in 0.5 * (policy.speeds[1:] + policy.speeds[:-1]):
        best = LQR(plant(steer=steer, speed=float(speed)))
        model, best = best.model, best.gain
        closed = model.A - model.B @ policy.gain_at(speed)
        assert np.max(np.abs(np.linalg.eigvals(closed))) < 1.0
        assert np.max(np.abs(policy.gain_at(speed) - best)) < 0.03 * np.max(np.abs(best))


def test_the_gain_of_one_speed_does_not_serve_another():
    """What the schedule is for: far above its speed a fixed gain is worse than the scheduled one."""
    fast = plant(speed_ratio=1.6)
    policy = ScheduledLQR(plant(speed_ratio=1.2), speeds=np.linspace(20.0, 60.0, 9))
    policy.speed = fast.speed
    fixed = LQR(plant(speed_ratio=0.6))
    model = fast.linear_model()
    scheduled, unscheduled = (
        np.max(np.abs(np.linalg.eigvals(model.A - model.B @ gain))) for gain in (policy.gain_at(fast.speed), fixed.gain)
    )
    assert scheduled < 1.0
    assert scheduled < unscheduled


def test_one_speed_per_car():
    car = plant("BicycleLaneChange-v0")
    policy = ScheduledLQR(car, speeds=[30.0, 40.0, 50.0])
    observation = np.random.default_rng(1).uniform(-0.02, 0.02, (3, len(car.observation_names))).astype(np.float32)
    alone = []
    for speed, row in zip((31.0, 40.0, 49.0), observation, strict=True):
        policy.speed = speed
        alone.append(policy.act(row))
    policy.speed = [31.0, 40.0, 49.0]
    np.testing.assert_allclose(policy.act(observation), alone, atol=1e-6)
    np.testing.assert_array_equal(policy.speed, [31.0, 40.0, 49.0])
    with pytest.raises(ValueError, match="3 cars"):
        policy.act(observation[:2])


@pytest.mark.parametrize(
    ("speeds", "message"),
    [
        ([40.0], "at least two rising"),
        ([50.0, 40.0], "at least two rising"),
        ([10.0, 20.0], "speed must be"),
        ([0.0, 50.0], "speeds must be"),
    ],
)
def test_bad_nodes_are_refused(speeds, message):
    with pytest.raises(ValueError, match=message):
        ScheduledLQR(plant(), speeds=speeds)


def test_a_speed_outside_of_the_nodes_is_refused():
    policy = ScheduledLQR(plant())
    with pytest.raises(ValueError, match="speed must be"):
        policy.speed = 200.0
    with pytest.raises(ValueError, match="speed must be"):
        policy.gain_at(1.0)
