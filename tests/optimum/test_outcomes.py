"""Many cars' episodes are those of the single environment; success and staying on the road are two things."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env  # noqa: F401
from bicycle_env.optimum import drive, make_cars, replay

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


HIDING = {"randomise": {"friction": (0.2, 0.6)}}


@pytest.mark.exhaustive
def test_what_is_hidden_may_be_that_of_another_seed():
    """Row by row the single environment's start, with the friction that the other seed draws."""
    others = [7, 5, 2**33 + 5, 8]
    driven = drive(make_cars("BicycleStab-v0", HIDING, 4), lambda observation, step: ACTIONS, SEEDS, others)
    env = gym.make("BicycleStab-v0", **HIDING)
    for row in range(4):
        env.reset(seed=others[row])
        friction = env.unwrapped.state.friction
        env.reset(seed=SEEDS[row], options={"friction": friction})
        total, over = 0.0, False
        while not over:
            _, reward, terminated, truncated, _ = env.step(ACTIONS[row])
            total, over = total + reward, terminated or truncated
        assert driven.episode_return[row] == total


@pytest.mark.parametrize(
    ("env_id", "keywords"),
    [
        ("BicycleActiveSteer-v0", {"frequency": (0.45, 1.0), "dwell": (0.0, 0.8)}),
        ("BicycleEvade-v0", {}),
        ("BicycleEvade-v0", {"randomise": {"mass": (1400.0, 1700.0)}, "disturbances": [{"name": "gust"}]}),
    ],
)
def test_no_first_observation_tells_what_is_hidden(env_id, keywords):
    cars = make_cars(env_id, keywords, 4).unwrapped
    cars.reset(seed=[7, 8, 9, 10])
    other = cars.snapshot()
    first, _ = cars.reset(seed=SEEDS)
    mine = cars.snapshot()
    state = cars.state
    assert np.array_equal(cars.restore(cars.mixed(mine, other, cars.task.hidden)), first)
    changed = {name for name in state._fields if not np.array_equal(getattr(cars.state, name), getattr(state, name))}
    assert changed == set(cars.task.hidden) - {"gust_start"}  # always the same
    with pytest.raises(ValueError, match="got 'relative_frictoin'; did you mean 'relative_friction'"):
        cars.mixed(mine, other, ["relative_frictoin"])


@pytest.mark.exhaustive
def test_sensors_hide_the_key_of_their_noise():
    task = gym.make("BicycleStab-v0", sensors={"noise": {"yaw_rate": 0.01}}, driver="step").unwrapped.task
    assert task.hidden == ("driver_side", *(f"noise_key_{k}" for k in range(4)))


def test_a_replay_takes_the_actions_of_a_whole_episode():
    actions = np.tile(ACTIONS[0], (400, 1))
    success, on_road, total, steps = alone(SEEDS[0], ACTIONS[0])
    assert replay("BicycleStab-v0", {}, SEEDS[0], actions[:steps]) == (success, on_road, total, steps)
    for given, words in ((steps + 1, f"got {steps + 1}: it ends after {steps}"), (steps - 1, "it has not ended")):
        with pytest.raises(ValueError, match=words):
            replay("BicycleStab-v0", {}, SEEDS[0], actions[:given])
