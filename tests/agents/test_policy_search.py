"""The evolution strategy: its networks are the file's, it climbs, and a stop changes nothing."""

from __future__ import annotations

import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from agents import policy_search, stopping, training
from bicycle_env import control, optimum

TINY = policy_search.Args(seed=2, quiet=True, pairs=4, starts=4, width=4, history=2, hold=2, total_timesteps=8 * 12800)
UPDATE = 2 * TINY.pairs * TINY.starts * 400


def start(folder, stop_at=None, **changes):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "SELECTED", 16)
        patch.setattr(os, "fsync", lambda _: None)
        learn, count = policy_search.Search.learn, [0]

        def learn_and_signal(self, *arguments):
            if count[0] == stop_at:
                signal.raise_signal(signal.SIGTERM)
            count[0] += 1
            return learn(self, *arguments)

        patch.setattr(policy_search.Search, "learn", learn_and_signal)
        return policy_search.train(replace(TINY, out=folder, **changes), Console(quiet=True))


def content(folder):
    return (folder / "policy.safetensors").read_bytes()


def test_many_networks_act_as_the_policies_of_their_weights():
    plant = optimum.Cars("BicycleStab-v0", {}).plant
    networks = policy_search.Networks(TINY, plant)
    random = np.random.default_rng(0)
    weights = random.standard_normal((3, networks.count)).astype(np.float32)
    act, per = networks.act(weights), 2
    seen = random.uniform(-1.0, 1.0, (5, 3 * per, len(plant.observation_names))).astype(np.float32)
    manner = training.manner(TINY, plant)
    description = {"observation_names": list(plant.observation_names), **manner}
    files = [control.Network(networks.layers(row), "tanh", "clip", description) for row in weights]
    for step, observation in enumerate(seen):
        found = act(observation, step)
        for k, network in enumerate(files):
            rows = slice(k * per, (k + 1) * per)
            np.testing.assert_allclose(found[rows], network.act(observation[rows]), rtol=1e-5, atol=1e-6)


def test_the_mean_moves_towards_what_does_better():
    networks = policy_search.Networks(TINY, optimum.Cars("BicycleStab-v0", {}).plant)
    search = policy_search.Search(TINY, networks)
    aim = search.mean + 1.0
    begin = float(np.mean(np.abs(search.mean - aim)))
    for _ in range(60):
        weights = search.drawn(TINY)
        search.learn(TINY, -np.sum((weights - aim) ** 2, axis=1).astype(float), 0.03)
    assert float(np.mean(np.abs(search.mean - aim))) < 0.7 * begin


@pytest.mark.exhaustive
def test_a_stopped_search_gives_the_bits_of_a_straight_one(tmp_path):
    straight = start(tmp_path / "straight")
    with pytest.raises(stopping.Stopped, match="stopped at"):
        start(tmp_path / "stopped", stop_at=3)
    stopped = start(tmp_path / "stopped", resume=True)
    assert content(stopped) == content(straight)
    assert content(start(tmp_path / "other", seed=3)) != content(straight)
