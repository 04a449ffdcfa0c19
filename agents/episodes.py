"""Drive episodes with a policy and summarise them; the same starts for every policy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np

from agents.statistics import mean, share
from bicycle_env.control import Policy
from bicycle_env.tasks.episode import World
from bicycle_env.tasks.metrics import Run, figures


@dataclass(frozen=True)
class Episode:
    """What came of one episode."""

    success: bool
    """The task's success: settled for the last second when the time was over."""
    on_road: bool
    """No end came before the time was over, settled or not."""
    end: str
    episode_return: float
    metrics: Mapping[str, float | None] = field(default_factory=dict)
    """The task's figures, by name; SI, angles in rad."""


def drive(env: gym.Env, policy: Policy, seed: int) -> Episode:
    """One episode from the start that the seed gives. `env` must be made with telemetry=True."""
    plant: Any = env.unwrapped
    observation, _ = env.reset(seed=seed)
    policy.reset()
    steps: list[dict[str, Any]] = []
    over = terminated = False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        over = terminated or truncated
        steps.append({**info, **plant.state._asdict(), "reward": float(reward)})
    columns = {name: np.array([step[name] for step in steps]) for name in steps[0] if name not in ("end", "is_success")}
    configuration = plant.configuration
    world = World(configuration.car, plant.rules, configuration.settings)
    return Episode(
        success=plant.is_success,
        on_road=not terminated,
        end=plant.end,
        episode_return=sum(step["reward"] for step in steps),
        metrics=figures(plant.task.metrics, Run(columns, plant.is_success, world)),
    )


PURPOSES = ("report", "tune", "select")
"""What starts are for. Those of different purposes are different for every seed: settings are never chosen on the
starts that a table reports."""


def start_seeds(episodes: int, seed: int, purpose: str = "report") -> list[int]:
    """The episode seeds of an evaluation, or of another of the `PURPOSES`: every policy drives from these same starts.

    32 random bits each; the purpose stands above them.
    """
    words = np.random.SeedSequence(seed).generate_state(episodes)
    return [int(word) + (PURPOSES.index(purpose) << 32) for word in words]


def evaluate(
    env: gym.Env, policy: Policy, episodes: int, seed: int, progress: Callable[[int], None] | None = None
) -> list[Episode]:
    """Drive `episodes` episodes from the starts of a seed."""
    driven = []
    for k, start in enumerate(start_seeds(episodes, seed)):
        driven.append(drive(env, policy, start))
        if progress is not None:
            progress(k + 1)
    return driven


def hardest_saved(first: list[Episode], second: list[Episode], seed: int) -> int:
    """Of an evaluation's starts that two policies both save, the one with the first's largest sideslip."""
    seeds = start_seeds(len(first), seed)
    both = [k for k in range(len(seeds)) if first[k].success and second[k].success]
    return seeds[max(both, key=lambda k: first[k].metrics["peak_sideslip"] or 0.0)] if both else seeds[0]


def summarise(driven: list[Episode]) -> dict[str, Any]:
    """Means with 95 % intervals: Wilson for the shares, bootstrap for the rest."""
    summary: dict[str, Any] = {
        "episodes": len(driven),
        "success_rate": share([episode.success for episode in driven]),
        "on_road_rate": share([episode.on_road for episode in driven]),
        "ends": {name or "time": [e.end for e in driven].count(name) for name in sorted({e.end for e in driven})},
    }
    columns = {"episode_return": [episode.episode_return for episode in driven]}
    columns |= {name: [episode.metrics[name] for episode in driven] for name in driven[0].metrics}
    for name, values in columns.items():
        known = [value for value in values if value is not None]
        if known:
            summary[name] = {**mean(known), "of": len(known)}
    return summary
