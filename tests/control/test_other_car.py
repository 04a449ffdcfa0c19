"""A controller designed for another car or speed than the one that it drives."""

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env  # noqa: F401
from bicycle_env import control, vehicles

ME303 = vehicles["me303"]
QUICK = {"tire": "linear", "geometry": "small_angle"}


def in_si(env, observations):
    return (observations / env.unwrapped.observation_scale).astype(np.float32)


@pytest.mark.parametrize("name", ["lqr", "lqr-continuous", "lqg"])
@pytest.mark.parametrize(
    "other", [{"vehicle": "me303"}, {"speed": 35.0}, {"vehicle": vehicles["me303"], "speed": 30.0}]
)
def test_it_does_what_one_made_for_the_other_car_does(name, other):
    """The same SI values observed, each in its own environment's scales, give the same action."""
    env = gym.make("BicycleStab-v0", **QUICK, speed=40.0)
    twin = gym.make("BicycleStab-v0", **QUICK, **{"speed": 40.0, **other})
    mine, theirs = control.make(name, env, **other), control.make(name, twin)
    plain = control.make(name, env)
    numbers = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 8)) * [0.3, 0.02, 1.0, 0.1, 0.01, 0.005, 0.01, 0.005]
    for policy in (mine, theirs, plain):
        policy.reset()
    acted, expected = mine.act(in_si(env, numbers)), theirs.act(in_si(twin, numbers))
    if name == "lqg":  # what its sensors read is the driven car's: only the first estimate is compared
        assert acted.shape == expected.shape
    else:
        np.testing.assert_allclose(acted, expected, atol=2e-6)
    assert not np.allclose(acted, plain.act(in_si(env, numbers)), atol=1e-3)


def test_a_design_for_a_stiffer_car_still_catches_the_one_that_is_driven():
    env = gym.make("BicycleStab-v0")
    policy = control.make("lqr", env, speed=1.05 * env.unwrapped.speed)
    saved = 0
    for seed in range(10):
        observation, _ = env.reset(seed=seed)
        policy.reset()
        over = False
        while not over:
            observation, _, terminated, truncated, _ = env.step(policy.act(observation))
            over = terminated or truncated
        saved += env.unwrapped.is_success
    assert saved >= 6


def test_mistakes_are_named():
    env = gym.make("BicycleStab-v0", **QUICK)
    with pytest.raises(ValueError, match="did you mean 'me303'"):
        control.make("lqr", env, vehicle="me30")
    with pytest.raises(ValueError, match="speed must be"):
        control.make("lqr", env, speed=-1.0)
    with pytest.raises(ValueError, match=r"an environment that gym\.make has made"):
        control.make("lqr", type(env.unwrapped)(**QUICK), speed=30.0)
