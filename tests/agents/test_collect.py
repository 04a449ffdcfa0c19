"""Minari datasets: what is written is what was driven, and the environment comes back from it."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from agents import collect
from agents.episodes import start_seeds
from agents.messages import UserError

minari = pytest.importorskip("minari")

KEYWORDS = '{"friction": 0.8, "max_episode_steps": 30}'


@pytest.fixture
def command(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")

    def run(*words: str) -> None:
        monkeypatch.setattr(sys, "argv", ["collect", "--root", str(tmp_path), *words])
        collect.main()

    return run


@pytest.mark.parametrize(("policy", "noise"), [("lqr", "0"), ("lqr", "0.2"), ("random", "0")])
def test_a_dataset_is_driven_again_to_the_bit(policy, noise, command, capsys):
    command("--policy", policy, "--noise", noise, "--episodes", "3", "--env-keywords", KEYWORDS, "--seed", "4")
    name = f"bicycle/stab-medium/{policy}-v0"
    assert f"{name}: 3 episodes" in capsys.readouterr().out
    dataset = minari.load_dataset(name)
    assert dataset.storage.metadata["ref_min_score"] < dataset.storage.metadata["ref_max_score"]
    env = dataset.recover_environment()
    assert env.spec.id == "bicycle_env:BicycleStab-v0"
    assert env.unwrapped.friction == 0.8
    for seed, episode in zip(start_seeds(3, 4, "collect"), dataset.iterate_episodes(), strict=True):
        observation, _ = env.reset(seed=seed)
        assert len(episode.observations) == len(episode.actions) + 1
        np.testing.assert_array_equal(episode.observations[0], observation)
        for k, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, _ = env.step(action)
            np.testing.assert_array_equal(episode.observations[k + 1], observation)
            assert (reward, terminated, truncated) == (
                episode.rewards[k],
                episode.terminations[k],
                episode.truncations[k],
            )
        assert terminated or truncated


def test_noise_is_added_and_seeded(command):
    shared = ("--policy", "lqr", "--episodes", "2", "--env-keywords", KEYWORDS)
    for noise, seed, name in (("0", "0", "a-v0"), ("0.2", "0", "b-v0"), ("0.2", "0", "c-v0"), ("0.2", "1", "d-v0")):
        command(*shared, "--noise", noise, "--seed", seed, "--dataset-id", name)
    first = {name: minari.load_dataset(f"{name}-v0")[0].actions for name in "abcd"}
    np.testing.assert_array_equal(first["b"], first["c"])
    assert not np.array_equal(first["a"], first["b"])
    assert not np.array_equal(first["b"], first["d"])


@pytest.mark.exhaustive
def test_the_search_is_a_policy_too(command):
    command("--policy", "search", "--episodes", "4")
    episodes = list(minari.load_dataset("bicycle/stab-medium/search-v0").iterate_episodes())
    assert sum(len(episode.rewards) == 400 for episode in episodes) >= 2


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--noise", "-1"], "--noise must be a finite number of at least 0, got -1"),
        (["--noise", "0.1", "--policy", "search"], "--noise is for policies that are driven, not for 'search'"),
        (["--episodes", "0"], "--episodes must be at least 1, got 0"),
        (["--policy", "lqrr"], "'lqr'"),
        (["--dataset-id", "a//b"], "--dataset-id: Malformed dataset ID: a//b"),
    ],
)
def test_a_mistake_is_one_line(words, text, command):
    with pytest.raises(UserError, match=text):
        command(*words)


def test_a_dataset_is_never_overwritten(command):
    words = ("--episodes", "1", "--env-keywords", KEYWORDS)
    command(*words)
    with pytest.raises(UserError, match="there is a dataset 'bicycle/stab-medium/lqr-v0' already"):
        command(*words)
