"""Tune the LQR's weights per task, so that a learner is compared with a good regulator and not with a straw man.

    python -m agents.tune_lqr            # about five minutes; writes bicycle_env/control/lqr_weights.json

Differential evolution over the logarithms of the weights. The score is the success rate plus the mean of the default
reward per step, over starts that no evaluation uses.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize
import tyro
from rich.console import Console
from rich.progress import Progress

import bicycle_env
from agents import messages
from agents.episodes import start_seeds
from agents.evaluate import make_env
from bicycle_env import control, provenance
from bicycle_env.files import write_json

ENV_IDS = ("BicycleStab-v0", "BicycleLaneChange-v0")
WEIGHTS_FILE = Path(bicycle_env.__file__).parent / "control" / "lqr_weights.json"
BOUNDS = {  # log10 of each weight; one of them only scales the others, and is held at 1
    "lateral_position": (0.0, 0.0),
    "heading": (0.0, 3.5),
    "sideslip": (-1.0, 3.5),
    "yaw_rate": (-2.0, 2.5),
    "front_command": (-2.0, 1.5),
    "rear_command": (-2.0, 1.5),
}


@dataclass
class Args:
    """Find weights for the LQR of every task and write them into the package."""

    episodes: int = 100
    """Starts per candidate."""
    generations: int = 10
    """Of the differential evolution."""
    seed: int = 987654321
    """Of the search and of its starts; an evaluation must use another."""


def score(env: Any, policy: control.Policy, starts: list[int]) -> tuple[float, float]:
    """Success rate and mean default reward per step of a full episode."""
    plant = env.unwrapped
    wins, total = 0, 0.0
    for start in starts:
        observation, _ = env.reset(seed=start)
        over = False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(policy.act(observation))
            total += reward
            over = terminated or truncated
        wins += plant.is_success
    return wins / len(starts), total / (len(starts) * plant.task.episode_steps)


def tune(env_id: str, args: Args, bar: Progress) -> dict[str, Any]:
    """The best weights found for one id, with their score."""
    env = make_env(env_id, {})
    starts = start_seeds(args.episodes, args.seed)
    free = [name for name, (low, high) in BOUNDS.items() if low < high]
    population = 8 * len(free)
    job = bar.add_task(env_id, total=(args.generations + 1) * population)

    def weights(logarithms: np.ndarray) -> control.Weights:
        found = dict.fromkeys(BOUNDS, 1.0) | {name: 10.0 ** float(x) for name, x in zip(free, logarithms, strict=True)}
        return control.Weights(**found)

    def loss(logarithms: np.ndarray) -> float:
        bar.advance(job)
        try:
            policy = control.LQR(env.unwrapped, weights(logarithms))
        except np.linalg.LinAlgError:  # no stabilising solution to working precision
            return 0.0
        return -sum(score(env, policy, starts))

    result = scipy.optimize.differential_evolution(
        loss, [BOUNDS[name] for name in free], maxiter=args.generations, popsize=8, polish=False, rng=args.seed
    )
    bar.update(job, completed=(args.generations + 1) * population)
    best = control.Weights(*(float(f"{value:.4g}") for value in weights(result.x)))
    success, reward = score(env, control.LQR(env.unwrapped, best), starts)
    return {"weights": best._asdict(), "success_rate": success, "reward_per_step": round(reward, 5)}


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.tune_lqr", description=__doc__)
    console = Console()
    found: dict[str, Any] = {
        "command": f"python -m agents.tune_lqr --episodes {args.episodes} --generations {args.generations} "
        f"--seed {args.seed}",
        **provenance.collect(),
    }
    with Progress(console=Console(stderr=True)) as bar:
        for env_id in ENV_IDS:
            plant: Any = make_env(env_id, {}).unwrapped
            found[plant.task.name] = tune(env_id, args, bar)
            console.print(env_id, json.dumps(found[plant.task.name]))
    write_json(WEIGHTS_FILE, found)
    console.print(f"written: {WEIGHTS_FILE.name}")


if __name__ == "__main__":
    messages.run(main)
