"""Random starts: uniform in the documented box, and a pure function of the generator's next numbers."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils import seeding
from scipy import stats

import bicycle_env  # noqa: F401  (registers the environments)

DRAWS = 4000


def starts(env, number=DRAWS):
    states = []
    for k in range(number):
        env.reset(seed=123 if k == 0 else None)
        states.append(env.state)
    return {name: np.array([getattr(state, name) for state in states]) for name in states[0]._fields}


@pytest.fixture(scope="module")
def stab():
    env = gym.make("BicycleStab-v0").unwrapped
    drawn = starts(env)
    drawn["sideslip"] = drawn["lateral_velocity"] / env.speed
    drawn["course"] = drawn["heading"] + drawn["sideslip"]
    return drawn


@pytest.fixture(scope="module")
def lane_change():
    env = gym.make("BicycleLaneChange-v0").unwrapped
    drawn = starts(env)
    drawn["change_start"] = drawn["change_start"] / env.speed
    return drawn


def assert_uniform(values, low, high):
    width = high - low
    assert np.all(values >= low - 1e-9 * width)
    assert np.all(values <= high + 1e-9 * width)
    assert np.min(values) < low + 0.01 * width
    assert np.max(values) > high - 0.01 * width
    counts, _ = np.histogram(values, bins=20, range=(low - 1e-9 * width, high + 1e-9 * width))
    assert counts.sum() == len(values)
    assert stats.chisquare(counts).pvalue > 1e-3


BOX = {"lateral_position": 0.3, "course": 0.01, "sideslip": 0.3, "yaw_rate": 0.8}
ROAD = {"lateral_position": (-0.3, 0.3), "heading": (-0.02, 0.02), "change_start": (0.5, 1.5)}


@pytest.mark.parametrize("name", BOX)
def test_stab_starts_uniformly(stab, name):
    assert_uniform(stab[name], -BOX[name], BOX[name])


@pytest.mark.parametrize("name", ROAD)
def test_the_lane_change_starts_uniformly(lane_change, name):
    assert_uniform(lane_change[name], *ROAD[name])


def test_left_and_right_are_as_frequent(lane_change):
    assert set(lane_change["direction"]) == {-1.0, 1.0}
    assert stats.binomtest(int(np.sum(lane_change["direction"] > 0)), DRAWS).pvalue > 1e-3


def test_the_draws_are_independent(stab, lane_change):
    for drawn, names in ((stab, list(BOX)), (lane_change, [*ROAD, "direction"])):
        correlation = np.corrcoef([drawn[name] for name in names])
        assert np.max(np.abs(correlation - np.eye(len(names)))) < 4.0 / np.sqrt(DRAWS)


def test_everything_else_starts_at_zero(stab, lane_change):
    still = ("longitudinal_position", "front_steer", "rear_steer", "front_steer_command", "rear_steer_command", "time")
    for name in still:
        assert not np.any(stab[name])
    for name in (*still, "lateral_velocity", "yaw_rate"):
        assert not np.any(lane_change[name])


def test_a_start_is_a_function_of_the_next_four_numbers():
    env = gym.make("BicycleStab-v0").unwrapped
    generator, _ = seeding.np_random(77)
    for k in range(5):
        env.reset(seed=77 if k == 0 else None)
        u = 2.0 * generator.random(4) - 1.0
        sideslip = 0.3 * u[2]
        expected = (0.0, 0.3 * u[0], 0.01 * u[1] - sideslip, sideslip * env.speed, 0.8 * u[3], 0.0, 0.0, 0.0, 0.0, 0.0)
        assert env.state == pytest.approx(expected, abs=1e-14)


def test_a_lane_change_starts_from_the_next_four_numbers():
    env = gym.make("BicycleLaneChange-v0").unwrapped
    generator, _ = seeding.np_random(78)
    sides = set()
    for k in range(8):
        env.reset(seed=78 if k == 0 else None)
        u = generator.random(4)
        side = -1.0 if u[3] < 0.5 else 1.0
        expected = (0.0, 0.3 * (2 * u[0] - 1), 0.02 * (2 * u[1] - 1), *([0.0] * 7), side, env.speed * (0.5 + u[2]))
        assert env.state == pytest.approx(expected, rel=1e-12, abs=1e-14)
        sides.add(side)
    assert sides == {-1.0, 1.0}


def test_the_same_seed_starts_every_car_at_the_same_sideslip():
    slow, fast = gym.make("BicycleStab-v0", speed=30.0).unwrapped, gym.make("BicycleStab-v0", speed=60.0).unwrapped
    slow.reset(seed=5)
    fast.reset(seed=5)
    assert slow.state.lateral_velocity / 30.0 == pytest.approx(fast.state.lateral_velocity / 60.0, rel=1e-14)
    assert slow.state.yaw_rate == fast.state.yaw_rate
