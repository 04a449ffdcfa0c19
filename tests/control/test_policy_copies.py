"""Policies copy and pickle: the copy goes on as the original does, and remembers on its own."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import control
from bicycle_env.control import LQG, Network
from bicycle_env.control.design.estimation import Noise

IDS = ("BicycleStab-v0", "BicycleActiveSteer-v0", "BicycleEvade-v0")
ENV, ACTIVE, EVADE = (gym.make(env_id).unwrapped for env_id in IDS)
HOMES = {"evade-path": EVADE, **dict.fromkeys(control.REAR_STEERINGS, ACTIVE)}
"""Where those drive that are of one id alone."""
WAYS = {"copy": copy.copy, "deepcopy": copy.deepcopy, "pickle": lambda policy: pickle.loads(pickle.dumps(policy))}
MOST = max(len(env.observation_names) for env in (ENV, ACTIVE, EVADE))
OBSERVATIONS = np.random.default_rng(0).uniform(-0.2, 0.2, (6, MOST)).astype(np.float32)


def make(name):
    if name == "mpc":
        pytest.importorskip("casadi")
        return control.MPC(ENV, horizon=10)
    if name == "noisy lqg":
        return LQG(ENV, sensor_noise=Noise(0.01, 0.1), seed=3)
    if name in ("network", "network that remembers"):
        acts = {} if name == "network" else {"hold": 2, "history": 2}
        width = len(ENV.observation_names) * acts.get("history", 1)
        layers = [(np.full((4, width), 0.1), np.zeros(4)), (np.full((2, 4), 0.1), np.zeros(2))]
        return Network(layers, "tanh", "clip", {"observation_names": list(ENV.observation_names), **acts})
    if name == "scripted":
        return control.Scripted(ENV, {"name": "step", "start": 0.05, "side": "left"})
    return control.make(name, HOMES.get(name, ENV))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "name", [*control.POLICIES, "noisy lqg", "preview+sano", "scripted", "network", "network that remembers"]
)
def test_a_copy_goes_on_as_the_original(name, way):
    policy = make(name)
    policy.reset()
    seen = OBSERVATIONS[:, : len(HOMES.get(name, ENV).observation_names)]
    for observation in seen[:3]:
        policy.act(observation)
    other = WAYS[way](policy)
    actions = [policy.act(observation) for observation in seen[3:]]  # the original first: nothing is shared
    assert [action.tolist() for action in actions] == [other.act(row).tolist() for row in seen[3:]]
    if name in ("mpc", "lqg", "scripted", "network that remembers"):
        other.reset()
        assert other.act(seen[3]).tolist() != actions[0].tolist(), "it remembers nothing, so this test is empty"


class Fleet:
    """A vector environment with cars that differ, as the controllers see it."""

    def __init__(self, env=ENV):
        self.env = env
        self.vehicle, self.speed = (ENV.vehicle,) * 2, np.array([40.0, 45.0])

    @property
    def unwrapped(self):
        return self

    def __getattr__(self, name):
        return getattr(self.env, name)

    def linear_model(self, quasi_static=False):
        raise ValueError("the cars of this environment differ")


@pytest.mark.parametrize("name", [name for name in control.NAMES if name != "zero"])
def test_cars_that_differ_are_refused_alike(name):
    if name == "mpc":
        pytest.importorskip("casadi")
    with pytest.raises(ValueError, match="the cars of this environment differ"):
        control.make(name, Fleet(HOMES.get(name, ENV)))
