"""Steps per second of the single environment beside two peers, in one run, through gym.make with default wrappers.

    pip install -c constraints.txt -e ".[bench]" && python benchmarks/single_env.py

Prints the table and exits 1 if a ratio falls short of what is promised. Rounds alternate between the environments and
each keeps its best, because other work on the machine only ever makes a round slower. The share of an environment whose
step does nothing depends least on the machine.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import bicycle_env  # noqa: F401  (registers the environments)
from bicycle_env import provenance
from bicycle_env.files import write_json

PEERS = {"lane-keeping-v0": 30.0, "CartPole-v1": 1.5}  # 62 and 2.3 times on one processor, 45 and 2.0 on another
OURS = ("BicycleStab-v0", "BicycleLaneChange-v0")
NOTHING = "Nothing-v0"
LEAST_SHARE = 0.1


class Nothing(gym.Env[Any, Any]):
    """Spaces and results like those of BicycleStab-v0, and no work: what Gymnasium's own part of a step costs."""

    observation_space = gym.spaces.Box(-10.0, 10.0, (8,), np.float32)
    action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def __init__(self) -> None:
        self._results = np.zeros(8, np.float32), 0.0, False, False, {"end": "", "cost": 0.0}

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:  # noqa: ARG002
        super().reset(seed=seed)
        return self._results[0], self._results[4]

    def step(self, action: Any) -> Any:  # noqa: ARG002
        return self._results


def steps_per_second(env: gym.Env, steps: int) -> float:
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(64)]
    start = time.perf_counter()
    for k in range(steps):
        _, _, terminated, truncated, _ = env.step(actions[k % 64])
        if terminated or truncated:
            env.reset()
    return steps / (time.perf_counter() - start)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7, help="rounds, of which the best counts (default 7)")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    try:
        import highway_env

        gym.register_envs(highway_env)
    except ImportError:
        print('highway-env is missing: pip install -c constraints.txt -e ".[bench]"', file=sys.stderr)
        return 2

    gym.register(NOTHING, Nothing, max_episode_steps=400)
    gym.logger.min_level = gym.logger.ERROR  # what does nothing returns the same arrays again
    envs = {name: gym.make(name) for name in (*OURS, *PEERS, NOTHING)}
    best = dict.fromkeys(envs, 0.0)
    for _ in range(options.rounds):
        for name, env in envs.items():
            best[name] = max(best[name], steps_per_second(env, 300 if name == "lane-keeping-v0" else 20000))

    print(f"{'environment':24s} {'steps/s':>10s}")
    for name, rate in best.items():
        print(f"{name:24s} {rate:10,.0f}")
    print(f"\n{'ratio':48s} {'measured':>9s} {'must':>6s}")
    short = False
    ratios = {}
    for name in OURS:
        for peer, must in PEERS.items():
            ratio = best[name] / best[peer]
            ratios[f"{name} / {peer}"] = round(ratio, 2)
            short |= ratio < must
            print(f"{name + ' / ' + peer:48s} {ratio:9.1f} {must:6.1f}{'  SHORT' if ratio < must else ''}")
    shares = {name: round(best[name] / best[NOTHING], 3) for name in OURS}
    for name, share in shares.items():
        short |= share < LEAST_SHARE
        mark = "  SHORT" if share < LEAST_SHARE else ""
        print(f"{name + ': share of an environment that does nothing':57s} {share:6.1%} {LEAST_SHARE:6.0%}{mark}")
    if options.json:
        write_json(
            options.json,
            {
                "command": "python benchmarks/single_env.py",
                **provenance.collect(),
                "steps_per_second": {name: round(rate) for name, rate in best.items()},
                "ratios": ratios,
                "share_of_nothing": shares,
            },
        )
    return 1 if short else 0


if __name__ == "__main__":
    sys.exit(main())
