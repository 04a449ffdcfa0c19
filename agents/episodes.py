"""Drive episodes with a policy and summarise them; the same starts for every policy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from agents.statistics import mean, share
from bicycle_env import optimum
from bicycle_env.control import Policy, alone_among_many
from bicycle_env.tasks.episode import World
from bicycle_env.tasks.metrics import Run, figures

FEW = 20
"""Up to so many episodes are driven one at a time: less work than to compile for many cars."""
CAR_STEPS = 100_000
"""Of the cars that are driven at once; each has some forty numbers, which are kept until their figures are known."""
Steps = Mapping[str, NDArray[np.float64]]
"""Of one car (n,), or (cars, n): by name, numbers after each step."""


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
    return _episode(plant, _columns(steps), plant.is_success, not terminated, plant.end)


def _columns(steps: Sequence[Mapping[str, Any]]) -> dict[str, NDArray[np.float64]]:
    """What a metric may ask for, of every step."""
    names = [name for name in steps[0] if name not in ("end", "is_success") and not name.startswith("_")]
    return {name: np.ascontiguousarray(np.array([step[name] for step in steps]).T) for name in names}


def _episode(plant: Any, steps: Steps, success: bool, on_road: bool, end: str) -> Episode:
    configuration = plant.configuration
    run = Run(steps, success, World(configuration.car, plant.rules, configuration.settings))
    return Episode(success, on_road, end, sum(steps["reward"].tolist()), figures(plant.task.metrics, run))


PURPOSES = ("report", "tune", "select", "collect")
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
    """Drive `episodes` episodes from the starts of a seed; many at once where that changes no bit."""
    seeds, driven, tell = start_seeds(episodes, seed), list[Episode](), progress or (lambda _: None)
    cars = _cars_at_once(env, policy, episodes)
    if cars > 1:
        return _drive_many(env, policy, seeds, cars, tell)
    for k, start in enumerate(seeds):
        driven.append(drive(env, policy, start))
        tell(k + 1)
    return driven


def _cars_at_once(env: gym.Env, policy: Policy, episodes: int) -> int:
    """1 where the policy, or what is wrapped around the environment, may not be the same for many cars."""
    spec = env.spec
    if episodes <= FEW or not alone_among_many(policy) or spec is None or spec.additional_wrappers:
        return 1
    groups = math.ceil(episodes * (spec.max_episode_steps or math.inf) / CAR_STEPS)
    return math.ceil(episodes / groups)


def _drive_many(
    env: gym.Env, policy: Policy, seeds: list[int], at_once: int, tell: Callable[[int], None]
) -> list[Episode]:
    """As :func:`drive` one after the other, to the bit, in groups of so many."""
    env.reset(seed=seeds[0])  # from then on it knows its time limit
    spec: Any = env.spec
    keywords = {**spec.kwargs, "max_episode_steps": spec.max_episode_steps}
    keywords.pop("render_mode", None)
    cars = optimum.make_cars(spec.id, keywords, at_once).unwrapped
    driven: list[Episode] = []
    for begin in range(0, len(seeds), at_once):
        group = seeds[begin : begin + at_once]
        filled = group + group[-1:] * (at_once - len(group))  # always as many cars: nothing is compiled anew
        driven += _drive_group(env.unwrapped, policy, cars, filled)[: len(group)]
        tell(len(driven))
    cars.close()
    return driven


def _drive_group(plant: Any, policy: Policy, cars: Any, seeds: list[int]) -> list[Episode]:
    steps: list[dict[str, Any]] = []

    def watch(reward: Any, info: dict[str, Any]) -> None:
        steps.append({**info, **cars.state._asdict(), "reward": reward})

    outcomes = optimum.drive(cars, optimum.by(policy), seeds, watch=watch)
    columns, ends = _columns(steps), steps[-1]["end"]
    driven = []
    for k in range(len(seeds)):
        mine = {name: values[k, : outcomes.steps[k]] for name, values in columns.items()}
        success, on_road = bool(outcomes.success[k]), bool(outcomes.on_road[k])
        driven.append(_episode(plant, mine, success, on_road, cars.end_names[ends[k]]))
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
