"""Figures of the headroom study, as its file holds them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from agents.episodes import drive, summarise
from agents.statistics import mean, share
from bicycle_env import control
from bicycle_env.optimum import Outcomes

HOPELESS_SIDESLIP = 0.3
"""rad, at which a training may end an episode of BicycleActiveSteer-v0 as hopeless."""


def rate(values: NDArray[Any]) -> dict[str, Any]:
    """A share with its interval; of shares, one of each start, their mean."""
    return share(values) if values.dtype == bool else mean(values)


def of_driver(outcomes: Outcomes, sees: str, searched: int, seconds: float) -> dict[str, Any]:
    """How a driver did: on all starts, and on the first, which the search for steering drives, too."""
    return {
        "sees": sees,
        "success_rate": rate(outcomes.success),
        "on_road_rate": rate(outcomes.on_road),
        "episode_return": mean(outcomes.episode_return),
        "starts": len(outcomes.success),
        "success_rate_of_searched": float(np.mean(outcomes.success[:searched])),
        "seconds": seconds,
    }


def side(driver: str, outcomes: Outcomes, starts: int) -> dict[str, Any]:
    """A driver's means on the first starts."""
    success, _, episode_return, _ = (np.mean(column[:starts]) for column in outcomes)
    return {
        "driver": driver, "success_rate": float(success), "episode_return": float(episode_return), "starts": starts
    }  # fmt: skip


def of_sequences(env_id: str, keywords: Mapping[str, Any], sequences: Mapping[int, NDArray[Any]]) -> dict[str, float]:
    """Means of the task's figures over recorded actions by start, and the share beyond `HOPELESS_SIDESLIP`."""
    env = gym.make(env_id, **keywords, telemetry=True)
    driven = []
    for start, actions in sequences.items():
        rest = iter(actions)
        driven.append(drive(env, control.Function("recorded", lambda _, rest=rest: next(rest)), start))
    if not driven:
        return {}
    summary = summarise(driven)
    beyond = float(np.mean([(one.metrics["peak_sideslip"] or 0.0) > HOPELESS_SIDESLIP for one in driven]))
    return {
        **{name: summary[name]["value"] for name in driven[0].metrics if name in summary},
        f"peak_sideslip_beyond_{HOPELESS_SIDESLIP:g}": beyond,
    }


def plain(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Keywords as JSON holds them: an actuator by its fields, an infinite rate by leaving it out."""
    found: dict[str, Any] = {}
    for name, value in keywords.items():
        fields = getattr(value, "__dataclass_fields__", None)
        if fields is None:
            found[name] = value
        else:
            numbers = {field: getattr(value, field) for field in fields}
            found[name] = {field: number for field, number in numbers.items() if math.isfinite(number)}
    return found
