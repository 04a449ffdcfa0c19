"""The path round the obstacle, and who follows it."""

from dataclasses import asdict, replace

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import control
from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.control import EvadePath, PathRound

ID = "BicycleEvade-v0"
PATHS = {steer: EvadePath(gym.make(ID, steer=steer).unwrapped).path for steer in ("front", "both")}


@pytest.mark.parametrize("steer", PATHS)
def test_the_path_at_its_knots(steer):
    path = PATHS[steer]
    begin, end, last = 1.2, 1.8, 3.3
    back = end + path.back_begin + path.back_share * (last - end)
    knots = np.array([begin + path.out_end - path.out_length, begin + path.out_end, back, last + path.back_end, 9.0])
    places = path.lateral_position(begin, end, last, knots)
    expected = [0.0, path.offset, path.offset, path.return_offset, path.return_offset]
    np.testing.assert_allclose(places, expected, atol=1e-12)
    middle = begin + path.out_end - 0.5 * path.out_length
    assert path.lateral_position(begin, end, last, np.array([middle]))[0] == pytest.approx(0.5 * path.offset)
    later = path.lateral_position(begin - 0.3, end - 0.3, last - 0.3, knots - 0.3)  # it lies where the gates are
    np.testing.assert_allclose(later, expected, atol=1e-12)


def test_a_way_back_takes_its_time():
    path = replace(PATHS["front"], back_begin=2.0, back_share=0.0, back_end=-2.0)
    begins = 1.8 + 2.0
    places = path.lateral_position(1.2, 1.8, 3.3, begins + np.array([0.0, 0.15, 0.3]))
    assert places[0] > places[1] > places[2] == pytest.approx(path.return_offset)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"out_length": 0.2}, "out_length"),
        ({"offset": float("nan")}, "offset"),
        ({"back_share": 1.1}, "back_share"),
        ({"ofset": 3.0}, "ofset"),
    ],
)
def test_bad_numbers_are_refused(numbers, words):
    with pytest.raises((ValueError, TypeError), match=words):
        PathRound(**{**asdict(PATHS["front"]), **numbers})


def test_who_sees_no_gates_is_refused():
    with pytest.raises(ValueError, match=r"'evade-path' needs side, obstacle_begin, obstacle_end, last_gate in the"):
        control.make("evade-path", gym.make("BicycleStab-v0"))


@pytest.mark.parametrize("steer", ["front", "both"])
def test_it_follows_the_path_with_optimal_preview(steer):
    """From its definition: place after place of the path, in front of, beside and behind the obstacle."""
    env = gym.make(ID, steer=steer).unwrapped
    policy, scale = EvadePath(env), env.observation_scale
    at = {name: env.observation_names.index(name) for name in ("side", "lateral_position", "obstacle_begin")}
    ahead = env.control_timestep * np.arange(policy.preview.shape[1])
    wanted = []
    observations = np.random.default_rng(0).uniform(-0.01, 0.01, (200, len(scale))).astype(np.float32)
    observations[:, at["side"]] = np.sign(observations[:, at["side"]])
    for row, ahead_of_it in zip(observations, np.linspace(1.5, -4.0, 200), strict=True):
        first = at["obstacle_begin"]
        row[first : first + 3] = (ahead_of_it + np.array([0.0, 0.6, 2.3])) * env.speed / scale[first : first + 3]
        seen = row * scale
        place = policy.path.lateral_position(*seen[first : first + 3] / env.speed, ahead)
        away = seen[at["side"]] * place - seen[at["lateral_position"]]
        state = np.array([0.0, *(seen[env.observation_names.index(name)] for name in STATE_NAMES[1:])])
        wanted.append(np.clip(-policy.gain @ state - policy.preview @ away, -1.0, 1.0))
    found = policy.act(observations)
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert np.mean(np.abs(found) < 1.0) > 0.1


def test_its_gains_are_those_of_the_lqr():
    env = gym.make(ID).unwrapped
    lqr, weights = control.make("lqr", env), control.tuned_weights("evade")
    policy = EvadePath(env, weights=weights)
    np.testing.assert_allclose(policy.gain, lqr.gain, rtol=1e-9)
    assert policy.preview.sum() == pytest.approx(-lqr.gain[0, 0], rel=1e-6), "of a path that is shifted"
    other = EvadePath(env, replace(PATHS["front"], offset=0.0, return_offset=0.0), weights)
    observation, _ = env.reset(seed=3, options={"state": {"longitudinal_position": 1e4, "yaw_rate": 0.1}})
    np.testing.assert_allclose(other.act(observation), lqr.act(observation), atol=1e-6)


def successes(name):
    envs, policy = gym.make_vec(ID, 64, autoreset_mode="Disabled"), control.make(name, gym.make(ID).unwrapped)
    observations, _ = envs.reset(seed=1000)
    over = np.zeros(64, bool)
    while not over.all():
        observations, _, terminated, truncated, info = envs.step(policy.act(observations))
        over |= terminated | truncated
    return float(np.mean(info["is_success"]))


def test_it_rounds_obstacles_and_plain_lqr_none():
    assert successes("evade-path") > 0.35
    assert successes("lqr") == 0.0
