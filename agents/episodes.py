"""Drive episodes with a policy and summarise them; the same starts for every policy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from agents.statistics import mean, share
from bicycle_env.control import Policy


@dataclass(frozen=True)
class Episode:
    """Figures of one episode; SI, angles in rad. The last four are None where the task has no lane change."""

    success: bool
    """The task's success: settled for the last second when the time was over."""
    on_road: bool
    """The time was over before the car spun or left the road, settled or not."""
    end: str
    episode_return: float
    seconds: float
    peak_sideslip: float
    steering_effort: float
    """Root of the mean over time of front_steer^2 + rear_steer^2, rad."""
    cost: float
    """Seconds with a corner of the body outside."""
    peak_lateral_acceleration: float
    largest_tracking_error: float
    """Largest |lateral position - path|, m."""
    overshoot: float | None = None
    """How far beyond the new lane's middle, m."""
    settling_time: float | None = None
    """From the start of the change until |y error| stays below the tolerance, s; None without success."""


def drive(env: gym.Env, policy: Policy, seed: int) -> Episode:
    """One episode from the start that the seed gives. `env` must be made with telemetry=True."""
    plant: Any = env.unwrapped
    lane_change = hasattr(plant.state, "direction")
    observation, info = env.reset(seed=seed)
    policy.reset()
    total, effort, outside, steps = 0.0, 0.0, 0.0, 0
    sideslip = acceleration = error = 0.0
    overshoot, unsettled_until = 0.0, 0.0
    over = terminated = False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        over = terminated or truncated
        state = plant.state
        total += float(reward)
        steps += 1
        effort += state.front_steer**2 + state.rear_steer**2
        outside += info["cost"]
        sideslip = max(sideslip, abs(info["sideslip"]))
        acceleration = max(acceleration, abs(info["lateral_acceleration"]))
        error = max(error, abs(info["lateral_error"]))
        if lane_change:
            overshoot = max(overshoot, state.direction * info["goal_error"])
            if abs(info["goal_error"]) >= plant.rules.lateral_tolerance:
                unsettled_until = state.time
    seconds = steps * plant.control_timestep
    extra: dict[str, float | None] = {}
    if lane_change:
        begin = state.change_start / plant.speed
        extra["overshoot"] = overshoot
        extra["settling_time"] = unsettled_until - begin if plant.is_success else None
    return Episode(
        success=plant.is_success,
        on_road=not terminated,
        end=info["end"],
        episode_return=total,
        seconds=seconds,
        peak_sideslip=sideslip,
        steering_effort=math.sqrt(effort / steps),
        cost=outside * plant.control_timestep,
        peak_lateral_acceleration=acceleration,
        largest_tracking_error=error,
        **extra,
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
    return seeds[max(both, key=lambda k: first[k].peak_sideslip)] if both else seeds[0]


def summarise(driven: list[Episode]) -> dict[str, Any]:
    """Means with 95 % intervals: Wilson for the shares, bootstrap for the rest."""
    summary: dict[str, Any] = {
        "episodes": len(driven),
        "success_rate": share([episode.success for episode in driven]),
        "on_road_rate": share([episode.on_road for episode in driven]),
        "ends": {name or "time": [e.end for e in driven].count(name) for name in sorted({e.end for e in driven})},
    }
    for name in asdict(driven[0]):
        values = [value for episode in driven if isinstance(value := getattr(episode, name), float)]
        if values:
            summary[name] = {**mean(values), "of": len(values)}
    return summary
