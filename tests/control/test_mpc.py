"""MPC: its model is the package's, it is LQR where nothing is at a limit, and it saves cars that LQR loses."""

import math
import sys

import gymnasium as gym
import numpy as np
import pytest
from combinations import only_all

from bicycle_env.control import LQR, MPC, PolePlacement
from bicycle_env.control.design.symbolic import casadi_namespace, control_step
from bicycle_env.physics.actuators import Actuator
from bicycle_env.physics.car import CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.integrators import rk4

IDS = ("BicycleStab-v0", "BicycleLaneChange-v0")
STEERS = ("front", "rear", "both")
SIZES = np.array([0.5, 0.2, 4.0, 0.5, 0.05, 0.04])


def plant(env_id="BicycleStab-v0", steer="both", **keywords):
    return gym.make(env_id, steer=steer, **keywords).unwrapped


# The model


@pytest.mark.parametrize(
    ("tire", "geometry"),
    [
        ("linear", "small_angle"),
        ("tanh", "exact"),
        ("fiala", "small_angle"),
        ("magic_formula", "exact"),
        *(only_all(*pair) for pair in (("tanh", "small_angle"), ("fiala", "exact"), ("magic_formula", "small_angle"))),
        only_all("linear", "exact"),
    ],
)
def test_the_model_is_the_one_source_of_physics(tire, geometry):
    """One control step in CasADi's symbols against numpy, without rate limits."""
    free = {f"{axle}_actuator": Actuator(0.1, math.inf, 0.05) for axle in ("front", "rear")}
    car = plant(tire=tire, geometry=geometry, **free)
    step = control_step(car, 3)
    advance = rk4(NUMPY, CarState, car.model.actuated_rates(NUMPY))
    numbers = car_on_road(car.vehicle, car.speed, car.friction, car.front_actuator, car.rear_actuator)
    rng = np.random.default_rng(4)
    for _ in range(20):
        start, action = SIZES * rng.uniform(-1.0, 1.0, 6), rng.uniform(-1.0, 1.0, 2)
        command = tuple(0.1 * action)
        state = CarState(0.0, *start)
        for _ in range(3):
            state = advance(state, command, command, command, numbers, car.control_timestep / 3)
        found = np.asarray(step(start, action)).ravel()
        np.testing.assert_allclose(found, np.array(state[1:], float), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("steer", STEERS)
def test_its_linearisation_is_the_linear_model(steer):
    import casadi

    car = plant(steer=steer)
    step, policy = control_step(car, 1), MPC(car, horizon=2)
    state, action = casadi.SX.sym("x", 6), casadi.SX.sym("u", car.action_space.shape[0])
    slopes = casadi.Function("slopes", [state, action], casadi_jacobians(step, state, action))
    np.testing.assert_allclose(policy.gain, LQR(car).gain, rtol=2e-3)  # one RK4 step a control step against five
    A, B = slopes(np.full(6, 1e-9), np.zeros(action.shape[0]))
    np.testing.assert_allclose(np.asarray(A), policy.model.A, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(np.asarray(B), policy.model.B, rtol=1e-7, atol=1e-9)


def casadi_jacobians(step, state, action):
    import casadi

    following = step(state, action)
    return [casadi.jacobian(following, state), casadi.jacobian(following, action)]


def test_the_namespace_agrees_with_the_packages_own_functions():
    xp = casadi_namespace()
    for name in ("sin", "cos", "tan", "atan", "tanh", "near_sin", "near_cos"):
        values = np.linspace(-1.5, 1.5, 41)
        np.testing.assert_allclose(
            [float(getattr(xp, name)(value)) for value in values], getattr(NUMPY, name)(values), rtol=1e-13, atol=1e-14
        )


def test_fast_wheels_are_integrated_in_short_steps():
    quick = Actuator(0.1, math.inf, 0.005)
    car = plant(front_actuator=quick, rear_actuator=quick, physics_timestep=0.002)
    policy = MPC(car, horizon=20)
    np.testing.assert_allclose(policy.gain, LQR(car).gain, rtol=5e-3, atol=1e-4)
    observation, _ = car.reset(options={"state": {"lateral_velocity": 4.0, "yaw_rate": 0.2, "heading": -0.1}})
    for _ in range(20):
        observation, _, terminated, _, _ = car.step(policy.act(observation))
        assert not terminated
    assert policy.failures == 0


# LQR where nothing is at a limit


@pytest.mark.parametrize("horizon", [5, 30])
@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", IDS)
def test_on_the_linear_car_it_is_lqr(env_id, steer, horizon):
    """Whatever the horizon: what is beyond it has LQR's cost. With the path ahead in it, too."""
    car = plant(env_id, steer, tire="linear")
    policy, regulator = MPC(car, horizon=horizon, substeps=car.substeps), LQR(car)
    np.testing.assert_allclose(policy.gain, regulator.gain, rtol=1e-9)
    np.testing.assert_allclose(policy.preview, regulator.preview, rtol=1e-9, atol=1e-12)
    rng = np.random.default_rng(0)
    observation = (0.01 * rng.uniform(-1.0, 1.0, (2, len(car.observation_names)))).astype(np.float32)
    expected = regulator.act(observation)
    assert 0.03 < np.max(np.abs(expected)) < 0.3
    np.testing.assert_allclose(policy.act(observation), expected, atol=2e-4)
    assert policy.failures == 0


@pytest.mark.parametrize("steer", STEERS)
def test_near_straight_running_every_car_is_linear(steer):
    """The Fiala tire, exact geometry: the smaller the deviation, the nearer to LQR."""
    car = plant(steer=steer)
    policy, regulator = MPC(car, horizon=20), LQR(car)
    observation = np.array([0.1, -0.05, 0.1, 0.05, 0.0, 0.0, 0.0, 0.0], np.float32)
    errors = []
    for size in (1.0, 0.1):
        policy.reset()
        small = np.float32(size) * observation
        errors.append(np.max(np.abs(policy.act(small) - regulator.act(small))) / size)
    assert errors[1] < 0.02
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize("steer", STEERS)
def test_at_rest_on_the_path_it_knows_its_tires(steer):
    """All states exactly 0, where an automatic derivative of |slip| would be 0: a slow lane change is to come."""
    car = plant("BicycleLaneChange-v0", steer, duration=10.0)
    observation, _ = car.reset(options={"state": {}, "direction": "left", "change_start": 0.3})
    expected = LQR(car).act(observation)
    assert np.max(np.abs(expected)) > 1e-4
    np.testing.assert_allclose(MPC(car, horizon=20).act(observation), expected, atol=0.02 * np.max(np.abs(expected)))


def test_it_stays_lqr_for_a_whole_episode():
    """Step after step from the plan before: the linear tire, commands within all limits."""
    free = {f"{axle}_actuator": Actuator(0.1, math.inf, 0.05) for axle in ("front", "rear")}
    car = plant(tire="linear", **free)
    policy, regulator = MPC(car, substeps=car.substeps), LQR(car)
    observation, _ = car.reset(options={"state": {"lateral_velocity": 0.6, "yaw_rate": -0.05, "heading": -0.02}})
    for _ in range(60):
        action = policy.act(observation)
        np.testing.assert_allclose(action, regulator.act(observation), atol=2e-5)
        observation, *_ = car.step(action)
    assert policy.failures == 0


# Limits


def test_the_plan_keeps_the_actuators_limits():
    car = plant()
    policy = MPC(car)
    observation, _ = car.reset(options={"state": {"lateral_velocity": 6.0, "yaw_rate": 0.5, "heading": -0.14}})
    policy.act(observation)
    states, actions = policy.planned()
    assert states.shape == (61, 6)
    assert actions.shape == (60, 2)
    assert np.max(np.abs(actions)) <= 1.0 + 1e-5
    for column, actuator in ((4, car.front_actuator), (5, car.rear_actuator)):
        furthest = np.max(np.abs(np.diff(states[:, column])))
        most = actuator.rate_limit * car.control_timestep
        assert 0.99 * most < furthest < 1.001 * most, "the limit is kept, and is at work here"


def test_the_moved_plan_is_seen_from_the_cars_new_place():
    """The same motion, a step later: lateral positions count from the car, which has moved."""
    car = plant()
    policy = MPC(car, horizon=20)
    observation, _ = car.reset(options={"state": {"lateral_velocity": 3.0, "yaw_rate": 0.3, "heading": -0.07}})
    action = policy.act(observation)
    before, _ = policy.planned()
    observation = car.step(action)[0]
    policy.iterations = 0  # what it starts from, as it is
    policy.act(observation)
    moved, _ = policy.planned()
    place = np.zeros(6)
    place[0] = before[1, 0]
    assert abs(place[0]) > 1e-3
    np.testing.assert_allclose(moved[1:-2], before[2:-1] - place, rtol=0.0, atol=1e-12)
    assert moved[0, 0] == 0.0


def test_the_plan_is_what_the_car_then_does():
    """Up to the corner of the rate limit, which the plan rounds off: a few per cent of a wheel's way in a step."""
    car = plant()
    policy = MPC(car, horizon=20, substeps=car.substeps)
    observation, _ = car.reset(options={"state": {"lateral_velocity": 3.0, "yaw_rate": 0.3, "heading": -0.07}})
    policy.act(observation)
    states, actions = policy.planned()
    for k in range(20):
        car.step(actions[k])
        state = np.array([getattr(car.state, name) for name in policy.model.state_names])
        assert np.all(np.abs(state - states[k + 1]) < 0.03 * SIZES)
    assert np.max(np.abs(states[-1] - states[0]) / SIZES) > 0.5


def test_no_other_steering_is_better():
    """A start at the limits: random changes of the planned actions, driven through the model, cost more."""
    car = plant()
    policy = MPC(car, horizon=30)
    observation, _ = car.reset(options={"state": {"lateral_velocity": 5.0, "yaw_rate": 0.4, "heading": -0.12}})
    policy.act(observation)
    states, actions = policy.planned()
    step, model = control_step(car, 1), policy.model
    from bicycle_env.control.lqr import tuned_weights

    Q, R = tuned_weights("stabilise").matrices(car.speed, model.input_names)
    P = lyapunov_cost(model, policy.gain, Q, R)
    limits = np.array([car.front_actuator.rate_limit, car.rear_actuator.rate_limit])
    lags = np.array([car.front_actuator.time_constant, car.rear_actuator.time_constant])
    reach = limits * car.control_timestep / -np.expm1(-car.control_timestep / lags)

    def cost(chosen):
        x, total = states[0], 0.0
        for wanted in chosen:
            command = np.clip(wanted * model.input_scale, x[4:6] - reach, x[4:6] + reach)
            u = np.clip(command / model.input_scale, -1.0, 1.0)
            total += x @ Q @ x + u @ R @ u
            x = np.asarray(step(x, u)).ravel()
        return total + x @ P @ x

    best = cost(actions)
    assert np.any(np.abs(actions[0] * model.input_scale) > 0.99 * reach), "at a rate limit"
    rng = np.random.default_rng(8)
    for size in (0.003, 0.03, 0.3):
        for _ in range(10):
            assert cost(actions + size * rng.normal(size=actions.shape)) > best * (1.0 - 1e-4)
    assert cost(np.zeros_like(actions)) > 1.5 * best


def lyapunov_cost(model, gain, Q, R):
    closed, stage = model.A - model.B @ gain, Q + gain.T @ R @ gain
    P = np.zeros_like(Q)
    for _ in range(3000):
        P = stage + closed.T @ P @ closed
    return P


def drive(car, policy, start, steps):
    observation, _ = car.reset(options={"state": start})
    policy.reset()
    for _ in range(steps):
        observation, _, terminated, _, _ = car.step(policy.act(observation))
        if terminated:
            return False
    return car.is_success


def test_it_saves_a_car_that_clipped_lqr_loses():
    """With the rear wheels alone, slow as they are: an optimisation over 3 s finds a way, pole placement does not."""
    car = plant(steer="rear")
    start = {"lateral_position": 0.17, "heading": -0.185, "lateral_velocity": 7.95, "yaw_rate": 0.2}
    for other in (LQR(car), PolePlacement(car)):
        assert not drive(car, other, start, 400)
    policy = MPC(car)
    assert drive(car, policy, start, 400)
    assert policy.failures == 0


# What it remembers


def test_rows_are_cars_of_their_own():
    car = plant()
    many, single = MPC(car, horizon=10), MPC(car, horizon=10)
    rng = np.random.default_rng(5)
    path = rng.uniform(-0.1, 0.1, (5, 3, len(car.observation_names)))
    together = np.array([many.act(step) for step in path])
    for row in range(3):
        single.reset()
        np.testing.assert_array_equal(np.array([single.act(step[row]) for step in path]), together[:, row])
    many.reset(np.array([False, True, False]))
    begun = many.act(path[0])
    np.testing.assert_array_equal(begun[1], together[0, 1])
    with pytest.raises(IndexError):
        many.planned(3)
    many.reset()
    with pytest.raises(IndexError):
        many.planned()


def test_where_the_solver_fails_the_moved_plan_is_driven():
    car = plant()
    policy = MPC(car, horizon=20)
    observation, _ = car.reset(options={"state": {"lateral_velocity": 4.0, "yaw_rate": 0.2, "heading": -0.1}})
    policy.act(observation)
    _, planned = policy.planned()
    observation, *_ = car.step(planned[0])

    class Failing:
        def __call__(self, **_):
            return {"x": np.full(1, math.nan)}

        def stats(self):
            return {"success": False}

    policy._shooting.quadratic_program = Failing()
    for k in (1, 2):
        np.testing.assert_allclose(policy.act(observation)[0], planned[k, 0], atol=1e-6)
        assert policy.failures == k
    policy.reset()
    np.testing.assert_allclose(policy.act(observation), LQR(car).act(observation), atol=2e-2)
    assert policy.failures == 3


def test_the_other_solver_finds_the_same(monkeypatch):
    import casadi

    car = plant()
    observation, _ = car.reset(options={"state": {"lateral_velocity": 4.0, "yaw_rate": 0.2, "heading": -0.1}})
    structured = MPC(car, horizon=10).act(observation)
    monkeypatch.setattr(casadi, "has_conic", lambda _: False)
    general = MPC(car, horizon=10)
    np.testing.assert_allclose(general.act(observation), structured, atol=1e-3)
    assert general.failures == 0


# Mistakes


def test_without_casadi_there_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(ModuleNotFoundError, match=r'pip install -c constraints\.txt -e "\.\[mpc\]"'):
        MPC(plant())


@pytest.mark.parametrize(
    "keywords",
    [{"horizon": 1}, {"iterations": 0}, {"lane_half_width": -1.0}, {"sideslip_limit": 0.0}, {"substeps": 0}],
)
def test_bad_arguments_are_refused(keywords):
    with pytest.raises(ValueError, match=next(iter(keywords))):
        MPC(plant(), **keywords)
