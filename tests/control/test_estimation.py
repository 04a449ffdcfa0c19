"""The Kalman filter against the equations that define it, and on simulated cars; LQG knows no more than it may."""

import math

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import analysis
from bicycle_env.control import LQG, LQR
from bicycle_env.control.design.estimation import Disturbance, KalmanFilter, MeasuredSignals, Noise, sideslip_filter
from bicycle_env.control.design.gains import observer_gain
from bicycle_env.physics.actuators import Actuator

STEERS = ("front", "rear", "both")


def plant(env_id="BicycleStab-v0", **keywords):
    return gym.make(env_id, **keywords).unwrapped


def noise_covariances(car, noise, disturbance):
    """Q, R, S by integrating a push that is held for one step: brute force, not the package's way."""
    timestep, steps = car.control_timestep, 20_000
    A = car_matrices(car)[0]
    push, h = np.eye(2), timestep / 20_000
    into = np.zeros((2, 2))
    for _ in range(steps):  # midpoint rule of x' = A x + d
        middle = into + 0.5 * h * (A @ into + push)
        into = into + h * (A @ middle + push)
    D = np.diag(np.square(disturbance))
    E = np.array([[0.0, 0.0], [1.0, 0.0]])
    return into @ D @ into.T, E @ D @ E.T + np.diag(np.square(noise)), into @ D @ E.T


def car_matrices(car):
    return analysis.state_matrix(car.vehicle, car.speed), analysis.input_matrix(car.vehicle, car.speed)


def test_the_covariance_is_that_of_the_riccati_recursion():
    """Run the time-varying filter (Joseph's form, from a large covariance) until it no longer changes."""
    car, noise, disturbance = plant(), Noise(), Disturbance()
    known = sideslip_filter(car, noise, disturbance)
    Q, R, S = noise_covariances(car, noise, disturbance)
    A, C = known.A, known.C
    P = 100.0 * np.eye(2)
    for _ in range(500):
        L = (A @ P @ C.T + S) @ np.linalg.inv(C @ P @ C.T + R)
        F = A - L @ C
        P = F @ P @ F.T + Q + L @ R @ L.T - L @ S.T - S @ L.T
    np.testing.assert_allclose(known.covariance, P, rtol=1e-6)
    np.testing.assert_allclose(known.predictor_gain, L, rtol=1e-6)
    assert np.max(np.abs(np.linalg.eigvals(A - L @ C))) < 1.0


def test_no_other_gain_has_a_smaller_error():
    car = plant()
    known = sideslip_filter(car)
    Q, R, S = noise_covariances(car, Noise(), Disturbance())

    def error(L):
        F, P = known.A - L @ known.C, np.zeros((2, 2))
        for _ in range(2000):
            P = F @ P @ F.T + Q + L @ R @ L.T - L @ S.T - S @ L.T
        return np.trace(P)

    least = error(known.predictor_gain)
    assert least == pytest.approx(np.trace(known.covariance), rel=1e-6)
    rng = np.random.default_rng(3)
    for _ in range(10):
        assert error(known.predictor_gain * rng.uniform(0.9, 1.1, (2, 2))) > least


def test_the_filter_is_an_observer_with_its_own_poles():
    """Pole placement of the dual system at the filter's poles gives the filter's poles back."""
    known = sideslip_filter(plant())
    poles = np.linalg.eigvals(known.A - known.predictor_gain @ known.C)
    L = observer_gain(known.A, known.C, poles)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(known.A - L @ known.C)), np.sort_complex(poles), rtol=1e-9
    )


def test_a_scalar_filter_by_hand():
    """x+ = x + w, z = x + v, unit noises: P = (1 + sqrt 5)/2, the golden ratio; M = P / (P + 1) = 1 / P."""
    one = np.eye(1)
    known = KalmanFilter(one, np.zeros((1, 1)), one, np.zeros((1, 1)), one, one)
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    assert known.covariance[0, 0] == pytest.approx(golden, rel=1e-12)
    assert known.gain[0, 0] == pytest.approx(1.0 / golden, rel=1e-12)


@pytest.mark.parametrize("steer", STEERS)
def test_the_model_is_the_car(steer):
    """With the linear tire and no rate limit at work, prediction and measurement are the environment's to rounding."""
    car = plant(steer=steer, tire="linear")
    known, sensors = sideslip_filter(car), MeasuredSignals(car)
    rng = np.random.default_rng(0)
    for _ in range(20):
        state = dict(zip(("lateral_velocity", "yaw_rate"), rng.uniform(-0.3, 0.3, 2), strict=True))
        state |= {"front_steer": rng.uniform(-0.01, 0.01), "rear_steer": rng.uniform(-0.002, 0.002), "heading": 0.05}
        car.reset(options={"state": state})
        x = np.array([getattr(car.state, name) for name in car.linear_model().state_names])
        action = rng.uniform(-0.05, 0.05, car.action_space.shape)
        inputs = np.concatenate([x[4:6], action])
        measured = sensors.read(x[None])[0]
        assert measured[1] == pytest.approx(car.measure()["lateral_acceleration"], rel=1e-12)
        np.testing.assert_allclose(known.innovation(x[2:4], inputs, measured), 0.0, atol=1e-12)
        np.testing.assert_allclose(known.first(inputs, measured), x[2:4], rtol=1e-9)
        car.step(action)
        predicted = known.predict(x[2:4], np.zeros(2), inputs)
        np.testing.assert_allclose(predicted, [car.state.lateral_velocity, car.state.yaw_rate], rtol=1e-9, atol=1e-12)


def test_it_converges_from_a_wrong_start():
    """The error goes with (A - L C)^k, whatever the car does meanwhile."""
    car = plant(tire="linear")
    known, sensors, regulator = sideslip_filter(car), MeasuredSignals(car), LQR(car)
    observation, _ = car.reset(options={"state": {"lateral_velocity": 0.5, "yaw_rate": 0.05}})
    error_map = known.A - known.predictor_gain @ known.C
    predicted = np.array([-3.0, 0.5])
    x = np.array([car.state.lateral_velocity, car.state.yaw_rate])
    expected = predicted - x
    for _ in range(250):
        full = np.array([getattr(car.state, name) for name in car.linear_model().state_names])
        action = regulator.act(observation)
        inputs = np.concatenate([full[4:6], action])
        innovation = known.innovation(predicted, inputs, sensors.read(full[None])[0])
        predicted = known.predict(known.update(predicted, innovation), innovation, inputs)
        observation, *_ = car.step(action)
        expected = error_map @ expected
        x = np.array([car.state.lateral_velocity, car.state.yaw_rate])
        np.testing.assert_allclose(predicted - x, expected, atol=2e-6)
    assert np.max(np.abs(expected)) < 1e-4


def test_innovations_have_the_covariance_that_they_should():
    """A seeded run of the filter's own stochastic model: white innovations of covariance C P C' + R."""
    car = plant()
    noise, disturbance = Noise(), Disturbance()
    known = sideslip_filter(car, noise, disturbance)
    Q, R, S = noise_covariances(car, noise, disturbance)
    steps = 20_000
    rng = np.random.default_rng(7)
    drawn = rng.multivariate_normal(np.zeros(4), np.block([[Q, S], [S.T, R]]), steps)
    feedback = np.array([[-0.02, 0.3], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])  # keeps the unstable car near the road
    x, predicted, innovations = np.zeros(2), np.zeros(2), []
    for w in drawn:
        inputs = -feedback @ predicted
        measured = known.C @ x + known.D @ inputs + w[2:]
        innovation = known.innovation(predicted, inputs, measured)
        innovations.append(innovation)
        predicted = known.predict(known.update(predicted, innovation), innovation, inputs)
        x = known.A @ x + known.B @ inputs + w[:2]
    innovations = np.array(innovations[200:])
    covariance = np.cov(innovations.T)
    np.testing.assert_allclose(covariance, known.innovation_covariance, rtol=0.05, atol=0.03 * covariance.max() ** 0.5)
    size = np.sqrt(np.diag(covariance))
    for lag in (1, 2, 5):
        correlation = innovations[lag:].T @ innovations[:-lag] / len(innovations) / np.outer(size, size)
        assert np.max(np.abs(correlation)) < 4.0 / np.sqrt(steps)


def test_sensor_noise_is_seeded_and_has_its_size():
    car = plant()
    states = np.zeros((50_000, 6))
    first, same, other = (MeasuredSignals(car, Noise(0.01, 0.2), seed).read(states) for seed in (1, 1, 2))
    assert np.array_equal(first, same)
    assert not np.array_equal(first, other)
    np.testing.assert_allclose(first.std(axis=0), [0.01, 0.2], rtol=0.02)
    assert not np.any(MeasuredSignals(car).read(states[:2]))


# LQG


def test_the_lateral_velocity_reaches_lqg_through_the_accelerometer_only():
    """Where accelerometer and steer sensors tell of it, the filter finds it; with dead sensors it does not matter."""
    car = plant(tire="linear")
    policy = LQG(car)
    known, names, scale = policy.filter, car.observation_names, car.observation_scale
    observation = np.zeros((2, len(names)))
    observation[:, names.index("yaw_rate")] = 0.1
    observation[0, names.index("lateral_velocity")] = 2.0 / scale[names.index("lateral_velocity")]
    # The front steer that makes up in V' + U r for 2 m/s less of V.
    change = 2.0 * known.C[1, 0] / known.D[1, 0]
    observation[1, names.index("front_steer")] = change / scale[names.index("front_steer")]
    states = observation * scale
    read = MeasuredSignals(car).read(states[:, :6])
    np.testing.assert_allclose(read[0], read[1], rtol=1e-12)
    policy.reset()
    both = policy.act(observation)
    x = states[:, :6].copy()
    x[:, 0] = 0.0
    np.testing.assert_allclose(both, np.clip(-x @ policy.gain.T, -1.0, 1.0), atol=1e-6)
    blind = LQG(car)
    blind._sensors.read = lambda states: np.zeros((len(states), 2))
    observation[1] = observation[0]
    observation[1, names.index("lateral_velocity")] = -9.0
    first, second = blind.act(observation)
    assert np.array_equal(first, second), "with dead sensors the lateral velocity must not matter"


@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", ["BicycleStab-v0", "BicycleLaneChange-v0"])
def test_on_the_linear_car_lqg_is_lqr(env_id, steer):
    """Without noise the first measurement tells the whole state of the linear car, and the estimate stays exact."""
    free = {f"{axle}_actuator": Actuator(0.1, math.inf, 0.05) for axle in ("front", "rear")}
    car = plant(env_id, steer=steer, tire="linear", **free)
    lqg, lqr = LQG(car), LQR(car)
    observation, _ = car.reset(seed=4, options={"state": {"lateral_velocity": 0.3, "yaw_rate": -0.03}})
    lqg.reset()
    for _ in range(100):
        action = lqg.act(observation)
        np.testing.assert_allclose(action, lqr.act(observation), atol=5e-5)
        observation, _, terminated, _, _ = car.step(action)
        assert not terminated


def test_lqg_acts_on_what_it_measures_now():
    """A gust that no prediction knew of moves the wheels in the same step, by the filter's gain."""
    car = plant(tire="linear")
    policy, still = LQG(car), np.zeros(len(car.observation_names))
    policy.reset()
    assert not np.any(policy.act(still))
    blown = still.copy()
    k = car.observation_names.index("yaw_rate")
    blown[k] = 0.01 / car.observation_scale[k]
    measured = np.array([0.01, policy.filter.C[1, 1] * 0.01])
    expected = -policy.gain[:, 2:4] @ (policy.filter.gain @ measured)
    assert np.all(abs(expected) > 1e-3)
    np.testing.assert_allclose(policy.act(blown), expected, rtol=1e-5)


def test_it_holds_a_car_that_would_spin_with_noisy_sensors():
    car = plant()
    policy = LQG(car, sensor_noise=Noise(), seed=3)
    observation, _ = car.reset(options={"state": {"yaw_rate": 0.05, "lateral_position": 0.1}})
    largest = 0.0
    for k in range(400):
        observation, _, terminated, _, _ = car.step(policy.act(observation))
        assert not terminated
        largest = max(largest, abs(car.state.lateral_position)) if k > 200 else largest
    assert 1e-4 < largest < 0.2


def test_rows_are_cars_of_their_own():
    car = plant()
    many, single = LQG(car), LQG(car)
    rng = np.random.default_rng(5)
    path = rng.uniform(-0.3, 0.3, (30, 3, len(car.observation_names)))
    together = np.array([many.act(step) for step in path])
    for row in range(3):
        single.reset()
        alone = np.array([single.act(step[row]) for step in path])
        np.testing.assert_allclose(alone, together[:, row], atol=1e-6)
    many.reset(np.array([False, True, False]))
    begun = many.act(path[0])
    np.testing.assert_allclose(begun[1], together[0, 1], atol=1e-6)
    assert not np.allclose(begun[0], together[0, 0], atol=1e-6)
