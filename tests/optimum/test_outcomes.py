"""Many cars' episodes are those of the single environment; success and staying on the road are two things."""

from __future__ import annotations

import gymnasium as gym
import numpy as np

import bicycle_env  # noqa: F401
from bicycle_env.optimum import drive, make_cars

SEEDS = [5, 2**32 + 5, 2**33 + 5, 17]
ACTIONS = np.array([[0.3, -0.2], [0.0, 0.0], [-1.0, 0.5], [0.1, 0.1]], np.float32)


def alone(seed, action, **keywords):
    env = gym.make("BicycleStab-v0", **keywords)
    env.reset(seed=seed)
    total, steps, over = 0.0, 0, False
    while not over:
        _, reward, terminated, truncated, _ = env.step(action)
        total, steps, over = total + reward, steps + 1, terminated or truncated
    return env.unwrapped.is_success, not terminated, total, steps


def test_each_row_is_the_single_environment():
    driven = drive(make_cars("BicycleStab-v0", {}, 4), lambda observation, step: ACTIONS, SEEDS)
    for row in range(4):
        assert tuple(values[row] for values in driven) == alone(SEEDS[row], ACTIONS[row])


def test_who_is_on_the_road_when_the_time_is_over_need_not_be_a_success():
    """Twenty steps are too short to settle in, and to leave the road in."""
    driven = drive(
        make_cars("BicycleStab-v0", {"max_episode_steps": 20}, 4), lambda observation, step: 0.0 * ACTIONS, SEEDS
    )
    assert driven.on_road.all()
    assert not driven.success.any()
    assert (driven.steps == 20).all()
