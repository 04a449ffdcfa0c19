"""What `info`, `state` and `stability` say, against formulas written out here."""

import itertools
import math

import gymnasium as gym
import numpy as np
import pytest
from combinations import some_of

from bicycle_env import Vehicle, analysis, tires, vehicles
from bicycle_env.physics.car import CarState, car_on_road
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.registration import ENVIRONMENTS

IDS = [row.id for row in ENVIRONMENTS]
GRAVITY = 9.81


def wander(env, number, seed=0):
    """(state, info) after each of many random steps."""
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    for _ in range(number):
        _, _, terminated, truncated, info = env.step(rng.uniform(-1.0, 1.0, 2))
        yield env.unwrapped.state, info
        if terminated or truncated:
            env.reset()


OFTEN = [("linear", "small_angle"), ("fiala", "exact"), ("tanh", "small_angle"), ("magic_formula", "exact")]
"""Compiled for other tests, too."""


@pytest.mark.parametrize(("tire", "geometry"), some_of(itertools.product(tires.LAWS, ("small_angle", "exact")), OFTEN))
def test_accelerations_and_forces(tire, geometry):
    env = gym.make("BicycleStab-v0", tire=tire, geometry=geometry, telemetry=True, friction=0.9)
    plant, car = env.unwrapped, env.unwrapped.vehicle
    law = tires.LAWS[tire]()
    rates = SingleTrack(law, geometry).rates(PYTHON)
    numbers = car_on_road(car, plant.speed, plant.friction, plant.front_actuator, plant.rear_actuator)
    peaks = {
        "front": 0.9 * car.mass * GRAVITY * car.cg_to_rear / car.wheelbase,
        "rear": 0.9 * car.mass * GRAVITY * car.cg_to_front / car.wheelbase,
    }
    exact = geometry == "exact"
    for state, info in wander(env, 120):
        steer = (state.front_steer, state.rear_steer)
        rate = rates(CarState(*state[:7]), steer, numbers)
        assert info["lateral_acceleration"] == pytest.approx(
            rate.lateral_velocity + plant.speed * state.yaw_rate, rel=1e-12, abs=1e-12
        )
        assert info["yaw_acceleration"] == pytest.approx(rate.yaw_rate, rel=1e-12, abs=1e-12)

        cosines = [math.cos(angle) if exact else 1.0 for angle in steer]
        front, rear = info["front_lateral_force"] * cosines[0], info["rear_lateral_force"] * cosines[1]
        assert info["lateral_acceleration"] == pytest.approx((front + rear) / car.mass, rel=1e-12, abs=1e-12)
        moment = car.cg_to_front * front - car.cg_to_rear * rear
        assert info["yaw_acceleration"] == pytest.approx(moment / car.yaw_inertia, rel=1e-12, abs=1e-12)

        angle = math.atan if exact else float
        slip = {
            "front": angle((state.lateral_velocity + car.cg_to_front * state.yaw_rate) / plant.speed) - steer[0],
            "rear": angle((state.lateral_velocity - car.cg_to_rear * state.yaw_rate) / plant.speed) - steer[1],
        }
        for axle in ("front", "rear"):
            assert info[f"{axle}_slip_angle"] == pytest.approx(slip[axle], rel=1e-12, abs=1e-13)
            stiffness = getattr(car, f"{axle}_cornering_stiffness")
            force = law.lateral_force(info[f"{axle}_slip_angle"], stiffness, peaks[axle])
            assert info[f"{axle}_lateral_force"] == pytest.approx(force, rel=1e-12, abs=1e-9)
            assert info[f"{axle}_saturation"] == pytest.approx(abs(force) / peaks[axle], rel=1e-12, abs=1e-12)
            assert tire == "linear" or info[f"{axle}_saturation"] <= 1.0 + 1e-12
        assert info["sideslip"] == state.lateral_velocity / plant.speed


@pytest.mark.parametrize("tire", ["linear", "fiala"])
def test_the_accelerations_are_the_slopes_of_the_motion(tire):
    """Against differences of two states, hence without any law of the package."""
    h = 1e-5
    env = gym.make("BicycleStab-v0", tire=tire, telemetry=True, control_timestep=h, physics_timestep=h)
    plant = env.unwrapped
    for seed in range(5):
        _, info = env.reset(seed=seed)
        before = plant.state
        _, _, _, _, after = env.step(np.zeros(2))
        now = plant.state
        mean = 0.5 * (info["lateral_acceleration"] + after["lateral_acceleration"])
        slope = (now.lateral_velocity - before.lateral_velocity) / h
        assert slope + plant.speed * 0.5 * (before.yaw_rate + now.yaw_rate) == pytest.approx(mean, rel=1e-6, abs=1e-6)
        mean = 0.5 * (info["yaw_acceleration"] + after["yaw_acceleration"])
        assert (now.yaw_rate - before.yaw_rate) / h == pytest.approx(mean, rel=1e-6, abs=1e-6)


def test_errors_against_a_straight_road():
    env = gym.make("BicycleStab-v0", telemetry=True)
    for state, info in wander(env, 60):
        assert info["lateral_error"] == info["goal_error"] == state.lateral_position
        assert info["heading_error"] == state.heading


def test_errors_against_the_path():
    env = gym.make("BicycleLaneChange-v0", telemetry=True)
    length = env.unwrapped.speed * 1.5
    during = 0
    for state, info in wander(env, 200, seed=2):
        s = min(max((state.longitudinal_position - state.change_start) / length, 0.0), 1.0)
        path = state.direction * 3.5 * (10 * s**3 - 15 * s**4 + 6 * s**5)
        slope = state.direction * 3.5 * 30 * s**2 * (1 - s) ** 2 / length
        assert info["lateral_error"] == pytest.approx(state.lateral_position - path, abs=1e-12)
        assert info["heading_error"] == pytest.approx(state.heading - math.atan(slope), abs=1e-12)
        assert info["goal_error"] == pytest.approx(state.lateral_position - state.direction * 3.5, abs=1e-12)
        during += 0.0 < s < 1.0
    assert during > 20


def test_telemetry_changes_nothing_else():
    plain, full = gym.make("BicycleStab-v0"), gym.make("BicycleStab-v0", telemetry=True)
    plain.reset(seed=1)
    full.reset(seed=1)
    for _ in range(15):
        one, other = plain.step(np.array([0.2, 0.4])), full.step(np.array([0.2, 0.4]))
        assert np.array_equal(one[0], other[0])
        assert one[1:4] == other[1:4]
        assert other[4].items() >= one[4].items()


# The state


@pytest.mark.parametrize("env_id", IDS)
def test_the_state_is_a_named_tuple_of_floats(env_id):
    env = gym.make(env_id, steer="both").unwrapped
    env.reset(seed=1)
    common = (
        "longitudinal_position",
        "lateral_position",
        "heading",
        "lateral_velocity",
        "yaw_rate",
        "front_steer",
        "rear_steer",
        "front_steer_command",
        "rear_steer_command",
        "time",
    )
    route = env.task.TaskState._fields
    for k in range(10):
        state = env.state
        assert isinstance(state, tuple)
        assert state._fields == common + route
        assert all(type(value) is float for value in state)
        assert state.time == k * env.control_timestep
        env.step(np.array([0.5, -2.0]))
        assert env.state.front_steer_command == 0.5 * env.front_actuator.angle_limit
        assert env.state.rear_steer_command == -env.rear_actuator.angle_limit
        assert state.time == k * env.control_timestep, "a state that was handed out has changed"


@pytest.mark.parametrize("env_id", IDS)
def test_the_observation_is_the_scaled_and_clipped_state(env_id):
    env = gym.make(env_id).unwrapped
    rng = np.random.default_rng(3)
    bound = env.observation_space.high
    clipped = 0
    for _ in range(200):
        state = {"lateral_position": rng.uniform(-14, 14), "heading": rng.uniform(-3, 3)}
        state |= {"lateral_velocity": rng.uniform(-100, 100), "yaw_rate": rng.uniform(-8, 8)}
        observation, _ = env.reset(options={"state": state})
        values = np.array([getattr(env.state, name) for name in env.observation_names[:8]])
        wanted = np.clip((values / env.observation_scale[:8]).astype(np.float32), -bound[:8], bound[:8])
        assert np.array_equal(observation[:8], wanted)
        assert env.observation_space.contains(observation)
        clipped += int(np.any(np.abs(observation[:8]) == bound[:8]))
    assert 20 < clipped < 200


# Stability


@pytest.mark.parametrize("speed", [10.0, 36.0, 45.0])
@pytest.mark.parametrize("name", vehicles)
def test_stability_is_what_the_analysis_says(name, speed):
    vehicle = vehicles[name]
    told = gym.make("BicycleStab-v0", vehicle=name, speed=speed).unwrapped.stability
    assert told.critical_speed == analysis.critical_speed(vehicle)
    assert told.speed_ratio == speed / analysis.critical_speed(vehicle)
    np.testing.assert_allclose(np.sort_complex(told.eigenvalues), np.sort_complex(analysis.eigenvalues(vehicle, speed)))
    roots = np.roots(analysis.characteristic_polynomial(vehicle, speed))
    growth = max(roots.real)
    assert (growth > 0.0) == (not analysis.is_stable(vehicle, speed))
    if growth > 0.0:
        assert told.time_to_double == pytest.approx(math.log(2.0) / growth, rel=1e-9)
    else:
        assert told.time_to_double == math.inf


def test_a_small_deviation_doubles_in_the_time_to_double():
    env = gym.make("BicycleStab-v0", control_timestep=0.001, physics_timestep=0.001).unwrapped
    values, vectors = np.linalg.eig(analysis.state_matrix(env.vehicle, env.speed))
    lateral_velocity, yaw_rate = 1e-6 * vectors[:, np.argmax(values.real)].real
    env.reset(options={"state": {"lateral_velocity": lateral_velocity, "yaw_rate": yaw_rate}})
    steps = round(env.stability.time_to_double / 0.001)
    assert steps > 50
    for _ in range(steps):
        env.step(np.zeros(2))
    assert env.state.yaw_rate / yaw_rate == pytest.approx(2.0, rel=5e-3)


# Cost


def test_the_cost_is_a_corner_outside_of_the_lane():
    vehicle = Vehicle(
        mass=1500.0,
        yaw_inertia=2500.0,
        cg_to_front=1.4,
        cg_to_rear=1.3,
        front_cornering_stiffness=110e3,
        rear_cornering_stiffness=90e3,
        front_overhang=0.7,
        rear_overhang=1.2,
        body_width=1.9,
    )
    corners = np.array([[x, y] for x in (1.4 + 0.7, -1.3 - 1.2) for y in (0.95, -0.95)])
    for env_id, centre, half in (("BicycleStab-v0", 0.0, 1.75), ("BicycleLaneChange-v0", 1.75, 3.5)):
        env = gym.make(env_id, vehicle=vehicle).unwrapped
        options = {} if env_id == "BicycleStab-v0" else {"direction": "left"}
        rng = np.random.default_rng(7)
        outside = 0
        for _ in range(400):
            state = {"lateral_position": centre + rng.uniform(-half, half), "heading": rng.uniform(-0.6, 0.6)}
            env.reset(options={"state": state, **options})
            _, _, _, _, info = env.step(np.zeros(2))
            psi = env.state.heading
            lateral = env.state.lateral_position + corners @ [math.sin(psi), math.cos(psi)]
            expected = float(np.any(np.abs(lateral - centre) > half))
            assert info["cost"] == expected
            outside += expected
        assert 20 < outside < 380
