"""After close() nothing can be done any more, and each attempt says so; what is can still be asked."""

import copy
import pickle
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ClosedEnvironmentError
from vector_cases import IDS, MODES, STAB

from bicycle_env.envs import TorchVectorEnv
from bicycle_env.wrappers import SB3VecEnv

STILL = np.zeros(2, np.float32)


def refused(*attempts):
    for asked, attempt in attempts:
        with pytest.raises(ClosedEnvironmentError, match=rf"{asked}\(\) after close\(\): make a new environment"):
            attempt()


@pytest.mark.parametrize("started", ["not started", "running", "over"])
@pytest.mark.parametrize("env_id", IDS)
def test_one_car(env_id, started):
    env = gym.make(env_id, steer="both").unwrapped
    if started != "not started":
        env.reset(
            seed=0,
            options={
                "state": {"yaw_rate": 1.9, "heading": env.task.limits.heading - 0.01} if started == "over" else {}
            },
        )
        assert env.step(STILL)[2] == (started == "over")
    state, end = env.state, env.end
    env.close()
    refused(("step", lambda: env.step(STILL)), ("reset", lambda: env.reset(seed=0)))
    np.testing.assert_equal(env.state, state)
    assert env.end == end
    env.close()


def test_one_car_that_draws():
    env = gym.make(STAB, render_mode="rgb_array")
    env.reset(seed=0)
    env.render()
    env.close()
    refused(("render", env.render))


def test_through_wrappers():
    env = gym.make(STAB)
    env.reset(seed=0)
    env.close()
    refused(("step", lambda: env.step(STILL)), ("reset", env.reset))


@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
def test_a_copy_of_a_closed_environment_is_closed_and_a_copy_from_before_is_not(how):
    makers = (lambda: gym.make(STAB).unwrapped, lambda: gym.make_vec(STAB, num_envs=3), lambda: TorchVectorEnv(STAB, 3))
    actions = (STILL, np.zeros((3, 2), np.float32), torch.zeros(3, 2))
    for make, action in zip(makers, actions, strict=True):
        env = make()
        env.reset(seed=0)
        before = how(env)
        env.close()
        closed = how(env)
        refused(("step", lambda: closed.step(action)), ("reset", closed.reset))  # noqa: B023 (called at once)
        before.step(action)
        before.close()


@pytest.mark.parametrize("started", [True, False])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("mode", MODES)
def test_many_cars(mode, threads, started):
    num_envs = 1100 if threads > 1 else 5
    env = gym.make_vec(STAB, num_envs=num_envs, autoreset_mode=mode, threads=threads)
    actions = np.zeros((num_envs, 2), np.float32)
    snapshot = None
    if started:
        env.reset(seed=0)
        env.step(actions)
        snapshot = env.snapshot()
    state = env.state
    env.close()
    assert env.closed
    refused(("step", lambda: env.step(actions)), ("reset", lambda: env.reset(seed=0)), ("snapshot", env.snapshot))
    if started:
        refused(("restore", lambda: env.restore(snapshot)))
    np.testing.assert_equal(env.state, state)
    env.close()


@pytest.mark.parametrize("started", [True, False])
def test_many_cars_on_tensors(started):
    envs = TorchVectorEnv(STAB, 3)
    snapshot = None
    if started:
        envs.reset(seed=0)
        snapshot = envs.snapshot()
    envs.close()
    assert envs.closed
    refused(("snapshot", envs.snapshot))
    if started:
        refused(("restore", lambda: envs.restore(snapshot)))
    refused(("step", lambda: envs.step(torch.zeros(3, 2))), ("reset", lambda: envs.reset(seed=0)))
    envs.close()


def test_for_stable_baselines():
    envs = SB3VecEnv(gym.make_vec(STAB, num_envs=3, autoreset_mode="SameStep"))
    envs.reset()
    envs.close()
    refused(("step", lambda: envs.step(np.zeros((3, 2), np.float32))), ("reset", envs.reset))


def test_a_step_does_not_ask_whether_it_may():
    """It is the way through compiled code that is changed: not a line more runs in each step."""
    env = gym.make(STAB).unwrapped
    env.reset(seed=0)
    env.step(STILL)  # the first one looks for the compiled function
    seen = []
    sys.setprofile(lambda frame, event, _: seen.append(frame.f_code.co_name) if event == "call" else None)
    env.step(STILL)
    sys.setprofile(None)
    assert set(seen) == {"step"}  # the method, and the compiled function
