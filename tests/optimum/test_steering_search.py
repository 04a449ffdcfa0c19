"""What the search finds is true: the single environment repeats it."""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env  # noqa: F401
from agents.episodes import start_seeds
from bicycle_env import control
from bicycle_env.optimum import replay, search_steering
from bicycle_env.optimum.steering_search import Knots

ROOT = Path(__file__).parents[2]
REPORTED = start_seeds(200, 1)
SAVED_BY_A_TUNED_LQR = [REPORTED[k] for k in (7, 11, 22)]


def untuned():
    plant = gym.make("BicycleStab-v0").unwrapped
    return control.LQR(plant, control.Weights(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))


def test_from_an_untuned_feedback_it_saves_what_the_tuned_one_saves():
    done = []
    found = search_steering("BicycleStab-v0", {}, untuned(), SAVED_BY_A_TUNED_LQR, span=240, progress=done.append)
    assert [rescue.success for rescue in found] == [True, True, True]
    assert all(1 <= rescue.iterations <= 10 for rescue in found)  # the untuned feedback alone loses them
    assert done[-1] == 3
    for seed, rescue in zip(SAVED_BY_A_TUNED_LQR, found, strict=True):
        assert rescue.actions.dtype == np.float32
        repeated = replay("BicycleStab-v0", {}, seed, rescue.actions)
        assert repeated == (True, True, rescue.episode_return, len(rescue.actions))


def test_what_the_feedback_saves_needs_no_search():
    tuned = control.make("lqr", gym.make("BicycleStab-v0"))
    (rescue,) = search_steering("BicycleStab-v0", {}, tuned, SAVED_BY_A_TUNED_LQR[:1], iterations=0)
    assert (rescue.success, rescue.iterations, len(rescue.actions)) == (True, 0, 400)


def test_a_start_that_is_lost_has_the_best_failure_and_the_same_seed_finds_it_again():
    lost = [seed for seed in REPORTED[:12] if not replay_of_lqr(seed)][:1]
    search = {"samples": 16, "iterations": 2}
    tuned = control.make("lqr", gym.make("BicycleStab-v0"))
    (alone,) = search_steering("BicycleStab-v0", {}, tuned, lost, iterations=0)
    (first,) = search_steering("BicycleStab-v0", {}, tuned, lost, **search)
    (again,) = search_steering("BicycleStab-v0", {}, tuned, lost, **search)
    (other,) = search_steering("BicycleStab-v0", {}, tuned, lost, **search, seed=1)
    assert not first.success
    assert first.episode_return + len(first.actions) > alone.episode_return + len(alone.actions)
    assert np.array_equal(first.actions, again.actions)
    assert not np.array_equal(first.actions, other.actions)
    assert replay("BicycleStab-v0", {}, lost[0], first.actions)[:3] == first[:3]


def replay_of_lqr(seed):
    env = gym.make("BicycleStab-v0")
    policy = control.make("lqr", env)
    observation, _ = env.reset(seed=seed)
    over = False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        over = terminated or truncated
    return env.unwrapped.is_success


def test_too_few_samples_have_no_elite():
    with pytest.raises(ValueError, match=r"samples.*8.*got 7"):
        search_steering("BicycleStab-v0", {}, untuned(), [1], samples=7)


def test_knots_cover_the_span_and_end_at_nothing():
    assert [Knots.over(*given) for given in ((240, 1), (300, 1), (340, 1), (300, 5), (20, 1))] == [
        (40, 6),
        (50, 6),
        (49, 7),
        (30, 2),
        (4, 6),
    ]
    added = Knots(2, 3).between(np.array([[[1.0, 0.0], [4.0, -3.0]]]))
    found = [np.broadcast_to(added(step), (1, 2))[0].tolist() for step in range(7)]
    assert np.allclose(found, [[1, 0], [2, -1], [3, -2], [4, -3], [8 / 3, -2], [4 / 3, -1], [0, 0]])


COMMITTED = json.loads((ROOT / "results" / "headroom.steering.json").read_text())
SEQUENCES = [
    pytest.param(one, id=f"{name}-{k}", marks=[] if name == "BicycleStab-v0 medium" else pytest.mark.exhaustive)
    for name, many in COMMITTED["sequences"].items()
    for k, one in enumerate(many)
]


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_a_committed_sequence_saves_its_car(sequence):
    assert sequence["start"] in REPORTED
    actions = np.array(sequence["actions"], np.float32)
    assert replay(sequence["env_id"], sequence["keywords"], sequence["start"], actions)[:2] == (True, True)
