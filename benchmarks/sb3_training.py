"""What the environment costs in a training: PPO of Stable-Baselines3 on 64 cars, and on one that does nothing.

    pip install -c constraints.txt -e ".[agents]" && python benchmarks/sb3_training.py --json results/sb3_training.json

Steps per second of training, which is rollouts and updates, with the settings of agents/configs but without the early
stop: then an update is the same work for all, and its best time counts for all. The null environment has the same
spaces, goes through the same adapter, hands out the same arrays at every step, and no episode ever ends. DummyVecEnv,
what Stable-Baselines3 makes of single environments, is measured beside. Rounds alternate, the best counts; processor
time, one thread. Exits 1 if training falls short.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor

import bicycle_env  # noqa: F401
from bicycle_env import provenance
from bicycle_env.files import write_json
from bicycle_env.wrappers import SB3VecEnv

ENV_ID, NUM_ENVS, MUST = "BicycleStab-v0", 64, 0.95
SETTINGS: dict[str, Any] = {
    "n_steps": 128,
    "batch_size": 256,
    "n_epochs": 10,
    "learning_rate": 1e-3,
    "gamma": 0.98,
    "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -1.0},
}
STEPS_OF_A_ROUND = NUM_ENVS * SETTINGS["n_steps"]
"""One rollout and one update."""


class NullVectorEnv(VectorEnv[Any, Any, Any]):
    """The spaces of an environment and nothing behind them."""

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 (declared so by Gymnasium)

    def __init__(self, like: VectorEnv[Any, Any, Any]) -> None:
        self.num_envs = like.num_envs
        self.single_observation_space, self.observation_space = like.single_observation_space, like.observation_space
        self.single_action_space, self.action_space = like.single_action_space, like.action_space
        self._observation = np.random.default_rng(0).normal(size=self.observation_space.shape).astype(np.float32)
        never = np.zeros(self.num_envs, np.bool_)
        self._result = self._observation, np.ones(self.num_envs), never, never, {}

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:
        return self._observation, {}

    def step(self, _: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        return self._result


def native() -> VectorEnv[Any, Any, Any]:
    return gym.make_vec(ENV_ID, NUM_ENVS, autoreset_mode="SameStep")


CONTESTANTS: dict[str, Callable[[], VecEnv]] = {
    "null": lambda: SB3VecEnv(NullVectorEnv(native())),
    "native": lambda: SB3VecEnv(native()),
    "DummyVecEnv": lambda: DummyVecEnv([lambda: gym.make(ENV_ID)] * NUM_ENVS),
}


class Stopwatch(BaseCallback):
    """Processor time of the rollouts."""

    def _on_rollout_start(self) -> None:
        self.start = time.process_time()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self.seconds = time.process_time() - self.start


class Rates(NamedTuple):
    """Steps per second."""

    training: float
    rollouts: float


def contest(names: tuple[str, ...], rounds: int) -> dict[str, Rates]:
    """The best rates of each."""
    torch.set_num_threads(1)
    models = {
        name: PPO("MlpPolicy", VecMonitor(CONTESTANTS[name]()), seed=0, device="cpu", **SETTINGS) for name in names
    }
    for model in models.values():
        model.learn(STEPS_OF_A_ROUND)
    rollouts, update = dict.fromkeys(names, math.inf), math.inf
    for _ in range(rounds):
        for name, model in models.items():
            watch, start = Stopwatch(), time.process_time()
            model.learn(STEPS_OF_A_ROUND, callback=watch)
            rollouts[name] = min(rollouts[name], watch.seconds)
            update = min(update, time.process_time() - start - watch.seconds)
    return {
        name: Rates(STEPS_OF_A_ROUND / (rollout + update), STEPS_OF_A_ROUND / rollout)
        for name, rollout in rollouts.items()
    }


def ratio(rounds: int = 5) -> float:
    """Steps per second of training with the cars over those without."""
    best = contest(("null", "native"), rounds)
    return best["native"].training / best["null"].training


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7, help="rounds, of which the best counts (default 7)")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()

    best = contest(tuple(CONTESTANTS), options.rounds)
    print(f"{'steps/s':14s} {'training':>10s} {'rollouts':>10s}")
    for name, rates in best.items():
        print(f"{name:14s} {rates.training:10,.0f} {rates.rollouts:10,.0f}")
    of = {
        f"native / {peer}": {
            kind: round(getattr(best["native"], kind) / getattr(best[peer], kind), 3) for kind in Rates._fields
        }
        for peer in ("null", "DummyVecEnv")
    }
    for name, ratios in of.items():
        print(f"{name:22s} {ratios['training']:.3f} training, {ratios['rollouts']:.3f} rollouts")
    share = of["native / null"]["training"]
    print(f"training, native / null: {share:.3f}, must {MUST}{'' if share >= MUST else '  SHORT'}")
    if options.json:
        write_json(
            options.json,
            {
                "command": "python benchmarks/sb3_training.py",
                **provenance.collect(),
                "env_id": ENV_ID,
                "num_envs": NUM_ENVS,
                "settings": SETTINGS,
                "steps_per_second": {
                    name: {k: round(v) for k, v in rates._asdict().items()} for name, rates in best.items()
                },
                "ratios": of,
                "must": MUST,
            },
        )
    return 0 if share >= MUST else 1


if __name__ == "__main__":
    sys.exit(main())
