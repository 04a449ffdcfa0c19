"""Every trainer comes to the known optimum of a tiny task, in seconds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from told_task import BEST, ENV_ID, STEPS, STRAIGHT

from agents import policy_search, ppo, settings, train, training
from bicycle_env import control, optimum

QUIET = Console(quiet=True)
SHORT = {"env_id": ENV_ID, "quiet": True, "seed": 0}
NEAR = {"gamma": (0.5, 0.5), "reward_scale": 1.0}  # an action pays a step later, and not for long


def with_ppo(folder):
    size = {"total_timesteps": 80_000, "cars": 64, "decisions": 16, "width": 16}
    ppo.train(ppo.Args(**SHORT, **NEAR, **size, out=folder, minibatch=256), QUIET)


def with_policy_search(folder):
    size = {"total_timesteps": 1_000_000, "pairs": 16, "starts": 32, "width": 8}
    policy_search.train(policy_search.Args(**SHORT, **size, out=folder), QUIET)


def with_ppo_jax(folder):
    pytest.importorskip("optax")
    from agents import ppo_jax

    size = {"total_timesteps": 80_000, "cars": 64, "decisions": 16, "width": 16}
    ppo_jax.train(ppo_jax.Args(**SHORT, **NEAR, **size, out=folder, minibatches=4), QUIET)


def with_sb3(algo, steps, **model):
    def learn(folder):
        found = settings.read("BicycleStab-v0", algo)
        chosen = replace(found, n_envs=16, model={**found.model, "gamma": 0.5, **model}, total_timesteps=steps)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(settings, "read", lambda *_: chosen)
            train.train(train.Args(**SHORT, algo=algo, out=folder), QUIET)

    return learn


SB3 = {
    "ppo": with_sb3("ppo", 30_000, n_steps=32, batch_size=128),
    "sac": with_sb3("sac", 5_000, learning_starts=300, learning_rate=3e-3),
    "td3": with_sb3("td3", 8_000, learning_starts=300, learning_rate=3e-3),
}
TRAINERS = {"agents.ppo": with_ppo, "agents.policy_search": with_policy_search, "agents.ppo_jax": with_ppo_jax, **SB3}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", TRAINERS)
def test_it_comes_to_the_known_optimum(name, tmp_path, monkeypatch):
    """It misses a twentieth of what straight wheels miss, or less."""
    monkeypatch.setattr(training, "SELECTED", 256)
    TRAINERS[name](tmp_path / "run")
    cars = optimum.Cars(ENV_ID, {})
    policy = control.load(tmp_path / "run")
    targets = cars.of(2000).reset(seed=list(range(2000)))[0][:, -1] * 0.5
    best = STEPS - np.mean(np.square(targets, dtype=np.float64))
    outcomes = optimum.drive(cars.of(2000), optimum.by(policy), list(range(2000)))
    missed = best - np.mean(outcomes.episode_return)
    assert abs(best - BEST) < 0.01
    assert -1e-6 < missed < 0.05 * (BEST - STRAIGHT), missed
