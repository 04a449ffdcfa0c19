"""reset(options=...): what it accepts, what it refuses, and that a refusal changes nothing."""

import math

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import Actuator
from bicycle_env.registration import ENVIRONMENTS

IDS = [row.id for row in ENVIRONMENTS]
LANE_CHANGE = "BicycleLaneChange-v0"

BAD_STATES = [
    ({"lateral_velocty": 1.0}, ValueError, r"unknown state name 'lateral_velocty'; did you mean 'lateral_velocity'"),
    ({"sideslip": 0.1}, ValueError, "unknown state name 'sideslip'"),
    ({"time": 1.0}, ValueError, "unknown state name 'time'"),
    ({3: 1.0}, ValueError, "unknown state name 3"),
    ({"yaw_rate": math.nan}, ValueError, "yaw_rate"),
    ({"yaw_rate": math.inf}, ValueError, "yaw_rate"),
    ({"yaw_rate": -11.0}, ValueError, "yaw_rate"),
    ({"heading": 3.2}, ValueError, "heading"),
    ({"lateral_position": 1e4}, ValueError, "lateral_position"),
    ({"lateral_velocity": "fast"}, TypeError, "lateral_velocity"),
    ({"lateral_velocity": None}, TypeError, "lateral_velocity"),
    ({"lateral_velocity": True}, TypeError, "lateral_velocity"),
    ({"lateral_velocity": [1.0]}, TypeError, "lateral_velocity"),
    ({"lateral_velocity": np.ones(2)}, TypeError, "lateral_velocity"),
    ({"front_steer": 0.2}, ValueError, "front_steer"),
    ({"rear_steer": -0.053}, ValueError, "rear_steer"),
    ({"front_steer_command": -0.2}, ValueError, "front_steer_command"),
    ({"rear_steer_command": 0.053}, ValueError, "rear_steer_command"),
    ({"yaw_rate": 0.1, "heading": math.nan}, ValueError, "heading"),
    ([0.0] * 9, TypeError, "mapping"),
    ("lateral_velocity", TypeError, "mapping"),
    (None, TypeError, "mapping"),
    (1.0, TypeError, "mapping"),
]
BAD_OPTIONS = [
    *(({"state": state}, error, match) for state, error, match in BAD_STATES),
    ({"stat": {}}, ValueError, "unknown reset option 'stat'; did you mean 'state'"),
    ({"seed": 3}, ValueError, "unknown reset option 'seed'"),
    ({"state": {}, "low": 0.1}, ValueError, "unknown reset option 'low'"),
    ([("state", {})], TypeError, "options must be a mapping"),
    ("state", TypeError, "options must be a mapping"),
    (3, TypeError, "options must be a mapping"),
]
BAD_EVADE = [
    ({"direction": "up"}, ValueError, "direction.*'left', 'right', got 'up'"),
    ({"relative_friction": 0.0}, ValueError, "relative_friction"),
    ({"obstacle_time": 2.6}, ValueError, "obstacle_time"),
    ({"obstacle_length": "long"}, TypeError, "obstacle_length"),
    ({"return_time": math.nan}, ValueError, "return_time"),
    ({"side": "left"}, ValueError, "unknown reset option 'side'"),
]
BAD_LANE_CHANGE = [
    ({"direction": "up"}, ValueError, "direction.*'left', 'right', got 'up'"),
    ({"direction": "lefft"}, ValueError, "did you mean 'left'"),
    ({"direction": "random"}, ValueError, "direction"),
    ({"direction": 0.5}, TypeError, "direction"),
    ({"direction": None}, TypeError, "direction"),
    ({"change_start": -0.1}, ValueError, "change_start"),
    ({"change_start": math.nan}, ValueError, "change_start"),
    ({"change_start": math.inf}, ValueError, "change_start"),
    ({"change_start": 101.0}, ValueError, "change_start"),
    ({"change_start": "soon"}, TypeError, "change_start"),
    ({"change_start": None}, TypeError, "change_start"),
    ({"state": {"yaw_rate": 0.3}, "direction": "left", "change_start": -1.0}, ValueError, "change_start"),
    ({"start": 0.1}, ValueError, "unknown reset option 'start'"),
]
CASES = [(env_id, *case) for env_id in IDS for case in BAD_OPTIONS]
CASES += [(LANE_CHANGE, *case) for case in BAD_LANE_CHANGE]
CASES += [("BicycleEvade-v0", *case) for case in BAD_EVADE]
CASES += [(LANE_CHANGE, {"direction": ["left", "right"]}, TypeError, "direction")]
CASES += [(LANE_CHANGE, {"change_start": [0.5, 1.0]}, TypeError, "change_start")]
CASES += [("BicycleStab-v0", {"direction": "left"}, ValueError, "unknown reset option 'direction'")]

FORWARD = np.array([0.3, -0.2], np.float32)


def twins(env_id):
    pair = [gym.make(env_id, steer="both").unwrapped for _ in range(2)]
    for env in pair:
        env.reset(seed=31)
        for _ in range(7):
            env.step(FORWARD)
    return pair


def assert_still_twins(env, twin):
    assert env.state == twin.state
    assert env.np_random_seed == twin.np_random_seed
    assert env.np_random.bit_generator.state == twin.np_random.bit_generator.state
    for _ in range(3):
        one, other = env.step(FORWARD), twin.step(FORWARD)
        assert np.array_equal(one[0], other[0])
        assert one[1:] == other[1:]
    assert np.array_equal(env.reset()[0], twin.reset()[0])
    assert env.state == twin.state


@pytest.mark.parametrize(("env_id", "options", "error", "match"), CASES)
@pytest.mark.parametrize("seed", [None, 99])
def test_a_refused_reset_changes_nothing(env_id, options, error, match, seed):
    env, twin = twins(env_id)
    with pytest.raises(error, match=match):
        env.reset(seed=seed, options=options)
    assert_still_twins(env, twin)


@pytest.mark.parametrize("seed", [-1, "seven", 1.5])
@pytest.mark.parametrize("env_id", IDS)
def test_a_bad_seed_changes_nothing(env_id, seed):
    env, twin = twins(env_id)
    with pytest.raises((gym.error.Error, TypeError, ValueError), match=r"[Ss]eed"):
        env.reset(seed=seed, options={"state": {"yaw_rate": 0.5}})
    assert_still_twins(env, twin)


@pytest.mark.parametrize("env_id", IDS)
def test_a_refused_first_reset_leaves_the_environment_unstarted(env_id):
    env = gym.make(env_id, steer="both").unwrapped
    with pytest.raises(ValueError, match="yaw_rate"):
        env.reset(seed=0, options={"state": {"yaw_rate": math.nan}})
    with pytest.raises(gym.error.ResetNeeded):
        env.step(FORWARD)


@pytest.mark.parametrize("env_id", IDS)
def test_the_given_state_is_the_state(env_id):
    env = gym.make(env_id, steer="both").unwrapped
    given = {
        "longitudinal_position": 12.0,
        "lateral_position": -0.4,
        "heading": 0.1,
        "lateral_velocity": -2.0,
        "yaw_rate": 0.3,
        "front_steer": 0.02,
        "rear_steer": -0.01,
        "front_steer_command": -0.05,
        "rear_steer_command": 0.03,
    }
    observation, _ = env.reset(seed=1, options={"state": given})
    assert env.state._asdict().items() >= given.items()
    assert env.state.time == 0.0
    seen = [k for k, name in enumerate(env.observation_names) if name in given]
    shown = np.array([given[env.observation_names[k]] for k in seen]) / env.observation_scale[seen]
    assert len(seen) >= 4
    assert np.array_equal(observation[seen], shown.astype(np.float32))
    env.step(FORWARD)
    env.reset(options={"state": {"yaw_rate": 0.25}})
    assert env.state[:9] == (0.0, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("env_id", IDS)
def test_a_start_takes_the_same_random_numbers_with_options_or_without(env_id):
    env, twin = gym.make(env_id, steer="both").unwrapped, gym.make(env_id, steer="both").unwrapped
    options = {"state": {"yaw_rate": 0.1}}
    if env_id == LANE_CHANGE:
        options |= {"direction": "left", "change_start": 0.7}
    env.reset(seed=5, options=options)
    twin.reset(seed=5)
    for _ in range(3):
        assert np.array_equal(env.reset()[0], twin.reset()[0])
        env.reset(options=options)
        twin.reset()


@pytest.mark.parametrize("env_id", IDS)
def test_options_are_for_one_episode_and_stay_the_callers(env_id):
    env, twin = gym.make(env_id, steer="both").unwrapped, gym.make(env_id, steer="both").unwrapped
    options = {"state": {"yaw_rate": 0.1}}
    env.reset(seed=5, options=options)
    assert options == {"state": {"yaw_rate": 0.1}}
    twin.reset(seed=5)
    assert np.array_equal(env.reset(options={})[0], twin.reset(options=None)[0])


def test_the_limits_of_the_steer_angles_are_those_of_the_actuators():
    env = gym.make("BicycleStab-v0", rear_actuator=Actuator(0.3)).unwrapped
    env.reset(options={"state": {"rear_steer": -0.3, "rear_steer_command": 0.3}})
    assert env.state.rear_steer == -0.3
    with pytest.raises(ValueError, match="rear_steer"):
        env.reset(options={"state": {"rear_steer": -0.31}})


def test_numpy_numbers_and_whole_numbers_are_numbers():
    env = gym.make("BicycleStab-v0").unwrapped
    env.reset(options={"state": {"lateral_velocity": 1, "yaw_rate": np.float32(0.25), "heading": np.array(0.5)}})
    assert env.state[2:5] == (0.5, 1.0, 0.25)
    assert all(type(value) is float for value in env.state)


def test_the_options_of_the_lane_change():
    env = gym.make(LANE_CHANGE).unwrapped
    for direction, sign in (("left", 1.0), ("right", -1.0), (1.0, 1.0), (-1, -1.0)):
        env.reset(seed=2, options={"direction": direction, "change_start": 0.25})
        assert env.state.direction == sign
        assert env.state.change_start == 0.25 * env.speed
    env.reset(seed=2)
    drawn = env.state
    env.reset(seed=2, options={"change_start": 0.25})
    assert env.state == drawn._replace(change_start=0.25 * env.speed)
    env.reset(seed=2, options={"direction": "left"})
    assert env.state == drawn._replace(direction=1.0)
    env.reset(seed=2, options={"direction": "right"})
    assert env.state == drawn._replace(direction=-1.0)
