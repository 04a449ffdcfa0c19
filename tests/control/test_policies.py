"""The one interface of all policies: one observation or many, float32 in [-1, 1], no memory."""

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import control
from bicycle_env.registration import ENVIRONMENTS

IDS = [row.id for row in ENVIRONMENTS]


def network(env, axles):
    rng = np.random.default_rng(0)
    width = len(env.observation_names)
    layers = [
        ((0.1 * rng.normal(size=(16, width))).astype(np.float32), rng.normal(size=16).astype(np.float32)),
        ((0.1 * rng.normal(size=(axles, 16))).astype(np.float32), np.zeros(axles, np.float32)),
    ]
    return control.Network(layers, "tanh", "clip", {"env_id": "x", "observation_names": list(env.observation_names)})


POLICIES = {
    "zero": lambda env: control.make("zero", env),
    "lqr": lambda env: control.make("lqr", env),
    "network": lambda env: network(env, env.action_space.shape[0]),
}


@pytest.mark.parametrize("steer", ["front", "rear", "both"])
@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("name", POLICIES)
def test_one_observation_and_many(name, env_id, steer):
    env = gym.make(env_id, steer=steer).unwrapped
    policy = POLICIES[name](env)
    axles = env.action_space.shape[0]
    rng = np.random.default_rng(2)
    bound = env.observation_space.high
    many = (rng.uniform(-0.01, 0.01, (50, len(bound))) * bound).astype(np.float32)
    many[0] = 0.0
    many[1:4] = [bound, -bound, bound * rng.uniform(-1, 1, len(bound))]
    given = many.copy()
    actions = policy.act(many)
    assert np.array_equal(many, given)
    assert actions.shape == (50, axles)
    assert actions.dtype == np.float32
    assert np.all(np.abs(actions) <= 1.0)
    for observation, expected in zip(many, actions, strict=True):
        action = policy.act(observation)
        assert action.shape == (axles,)
        assert action.dtype == np.float32
        assert env.action_space.contains(action)
        np.testing.assert_allclose(action, expected, rtol=1e-5, atol=1e-6)
        assert np.array_equal(action, policy.act(observation)), "a policy holds no state"
    assert policy.act(many[:0]).shape == (0, axles)
    if name != "zero":
        assert len(np.unique(actions, axis=0)) > 10


def test_zero_steers_nothing():
    env = gym.make("BicycleStab-v0").unwrapped
    policy = control.make("zero", env)
    assert not np.any(policy.act(np.ones((7, 8), np.float32)))
    first = policy.act(np.ones(8, np.float32))
    first[:] = 1.0
    assert not np.any(policy.act(np.ones(8, np.float32)))


def test_every_policy_has_its_name():
    env = gym.make("BicycleStab-v0").unwrapped
    for name, cls in control.POLICIES.items():
        assert cls.name == name
        assert control.make(name, env).name == name
