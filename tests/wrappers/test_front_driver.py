"""A policy at the front wheels, the action at the rear ones."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from combinations import ON_ROADS
from gymnasium.utils.env_checker import check_env

from bicycle_env.control.driver import Preview, Stanley
from bicycle_env.control.lqr import LQR
from bicycle_env.wrappers import FrontDriver

pytestmark = pytest.mark.filterwarnings("ignore:FrontDriver is deprecated")

IDS = list(ON_ROADS)


def wrapped(env_id="BicycleLaneChange-v0", driver=Preview, **keywords):
    env = gym.make(env_id, **keywords)
    return FrontDriver(env, driver(env.unwrapped))


def rears(number, seed=0):
    return list(np.random.default_rng(seed).uniform(-0.5, 0.5, (number, 1)).astype(np.float32))


def record(env, actions, seed):
    observation, info = env.reset(seed=seed)
    seen = [(observation.tobytes(), info)]
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append((observation.tobytes(), reward, terminated, truncated, info))
        if terminated or truncated:
            break
    return seen


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")
@pytest.mark.parametrize("env_id", IDS)
def test_it_is_a_gymnasium_environment(env_id):
    env = wrapped(env_id)
    assert env.action_space == gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
    assert env.observation_space == env.env.observation_space
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("driver", [Preview, Stanley, LQR])
@pytest.mark.parametrize("env_id", IDS)
def test_the_driver_steers_the_front_and_the_action_the_rear(env_id, driver):
    env, plain = wrapped(env_id, driver), gym.make(env_id)
    policy = driver(plain.unwrapped)
    observation, _ = plain.reset(seed=5)
    seen, _ = env.reset(seed=5)
    for action in rears(40):
        assert np.array_equal(seen, observation)
        front = policy.act(observation)[0]
        observation, reward, terminated, _, info = plain.step(np.array([front, action[0]], np.float32))
        seen, *same = env.step(action)
        assert same == [reward, terminated, False, info]
        state = env.unwrapped.state
        assert state == plain.unwrapped.state
        assert state.front_steer_command == pytest.approx(front * env.unwrapped.front_actuator.angle_limit)
        if terminated:
            break


def test_the_same_seed_gives_the_same_episode():
    first, second = (record(wrapped(), rears(120), 3) for _ in range(2))
    assert first == second
    assert first != record(wrapped(), rears(120), 4)
    env = wrapped()
    record(env, rears(30, seed=9), 8)
    assert record(env, rears(120), 3) == first, "the driver forgets the last episode"


@pytest.mark.parametrize("copier", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_drive_on_alone(copier):
    """With the driver's memory: his delay is full when the copy is made."""
    env = wrapped()
    env.reset(seed=1)
    for action in rears(60):
        env.step(action)
    twin = copier(env)
    actions = rears(40, seed=2)
    first = [env.step(action)[0].tobytes() for action in actions]
    assert first == [twin.step(action)[0].tobytes() for action in actions]


def test_it_can_be_made_again_from_its_spec():
    env = wrapped()
    record(env, rears(20), 2)
    again = gym.make(env.spec)
    assert isinstance(again, FrontDriver)
    assert again.driver is not env.driver
    assert record(again, rears(100), 3) == record(wrapped(), rears(100), 3)


def test_what_it_returns_is_the_users_own():
    env, twin = wrapped(), wrapped()
    observation, _ = env.reset(seed=1)
    twin.reset(seed=1)
    observation[:] = 9.0
    for action in rears(30):
        observation = env.step(action)[0]
        assert np.array_equal(observation, twin.step(action)[0])
        observation[:] = 9.0


def test_another_environment_is_refused():
    for steer in ("front", "rear"):
        env = gym.make("BicycleStab-v0", steer=steer)
        with pytest.raises(ValueError, match=r"env must steer both axles.*got Box\(-1.0, 1.0, \(1,\), float32\)"):
            FrontDriver(env, Preview(gym.make("BicycleStab-v0").unwrapped))


@pytest.mark.parametrize("driver", [None, "preview", Preview])
def test_no_driver_is_refused(driver):
    with pytest.raises(TypeError, match=r"driver must be a policy with act\(observation\) and reset\(\), got"):
        FrontDriver(gym.make("BicycleStab-v0"), driver)


@pytest.mark.parametrize("action", [np.zeros(2), np.float32(0.1), np.array([np.nan]), np.array([np.inf])])
def test_bad_actions_change_nothing(action):
    env, twin = wrapped(), wrapped()
    env.reset(seed=1)
    twin.reset(seed=1)
    for good in rears(20):
        with pytest.raises(ValueError, match="action must be one finite number"):
            env.step(action)
        assert np.array_equal(env.step(good)[0], twin.step(good)[0])
    with pytest.raises(TypeError, match="action must be one real number"):
        env.step(["left"])


def test_a_step_needs_a_reset():
    with pytest.raises(gym.error.ResetNeeded, match="reset"):
        wrapped().step(np.zeros(1, np.float32))


def test_it_says_what_takes_its_place():
    env = gym.make("BicycleStab-v0")
    with pytest.warns(DeprecationWarning, match="driver= and steer='rear'"):
        FrontDriver(env, Preview(env.unwrapped))
