"""Why one car takes longer in the vector environment than alone: microseconds of a step, and of its parts.

    pip install -c constraints.txt -e ".[bench]" && python benchmarks/one_car.py --json results/one_car.json

A step of the vector environment is taken once more with a kernel that has the same arguments and does nothing: what is
left are numba's seven arrays, numpy's four results, and the views, masks and entries of `info` that Gymnasium asks for.
What the arithmetic takes is seen in the single environment, with five RK4 steps and with one. Rounds of all alternate,
the shortest counts.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numba
import numpy as np

from bicycle_env import provenance, tires
from bicycle_env.files import write_json

STEPS = 2000  # a round


def nothing(_numbers, _actions, _generators, _observation, _values, _flags, _end, _restarts, _first, _last):
    """The arguments of a kernel's step, and no step."""
    return 0


def vector(tire: str, idle: bool) -> Any:
    """A step of one car in the vector environment; `idle`: of its interface alone."""
    env = gym.make_vec("BicycleStab-v0", num_envs=1, tire=tire)
    env.reset(seed=0)
    unwrapped: Any = env.unwrapped
    if idle:
        (signature,) = unwrapped._kernels.step.signatures
        unwrapped._run = numba.njit(numba.int64(*signature), nogil=True)(nothing)
    action = np.zeros((1, 2), np.float32)

    def step() -> None:
        env.step(action)

    return step


def single(tire: str, substeps: int) -> Any:
    """A step of the single environment, of so many RK4 steps of 4 ms, and its resets."""
    env = gym.make("BicycleStab-v0", tire=tire, control_timestep=0.004 * substeps, physics_timestep=0.004)
    env.reset(seed=0)
    action = np.zeros(2, np.float32)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    return step


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tire", default="tanh", choices=tires.LAWS, help="tire of both environments (default tanh)")
    parser.add_argument("--rounds", type=int, default=60, help="rounds, of which the shortest counts (default 60)")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    if options.rounds < 1:
        parser.error(f"--rounds must be >= 1, got {options.rounds}")
    steps = {
        "single environment": single(options.tire, substeps=5),
        "single environment, one RK4 step instead of five": single(options.tire, substeps=1),
        "vector environment": vector(options.tire, idle=False),
        "vector environment, kernel does nothing": vector(options.tire, idle=True),
    }
    best = dict.fromkeys(steps, float("inf"))
    for _ in range(options.rounds):
        for name, step in steps.items():
            start = time.process_time()
            for _ in range(STEPS):
                step()
            best[name] = min(best[name], (time.process_time() - start) / STEPS * 1e6)
    for name, microseconds in best.items():
        print(f"{name:50s}{microseconds:8.2f} microseconds a step")
    if options.json:
        result = {
            "command": f"python benchmarks/one_car.py --tire {options.tire} --rounds {options.rounds}",
            **provenance.collect(),
            "tire": options.tire,
            "microseconds a step": {name: round(value, 2) for name, value in best.items()},
        }
        write_json(options.json, result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
