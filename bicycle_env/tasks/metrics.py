"""Figures of an episode, computed in numpy after it: each has a name, a unit and a meaning."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.tasks.episode import World


class Run(NamedTuple):
    """An episode from its start to its end: what its figures are functions of."""

    steps: Mapping[str, NDArray[np.float64]]
    """(n,) each, after every control step: by the names of the state and of the telemetry, "reward" and "cost"."""
    success: bool
    world: World
    """With the nominal car."""


class Metric(NamedTuple):
    """One figure; SI, angles in rad."""

    name: str
    unit: str
    meaning: str
    law: Callable[[Run], float | None]
    """None where the episode has no such figure."""
    in_tables: bool = True
    """Whether tables show it, or only files."""


def largest(name: str) -> Callable[[Run], float]:
    """The largest |value| of a number of each step."""
    return lambda run: float(np.max(np.abs(run.steps[name])))


def least(name: str) -> Callable[[Run], float]:
    """The least value of a number of each step."""
    return lambda run: float(np.min(run.steps[name]))


def _seconds(run: Run) -> float:
    return len(run.steps["time"]) * float(run.world.rules.control_timestep)


def _steering_effort(run: Run) -> float:
    return float(np.sqrt(np.mean(run.steps["front_steer"] ** 2 + run.steps["rear_steer"] ** 2)))


def _cost(run: Run) -> float:
    return float(np.sum(run.steps["cost"])) * float(run.world.rules.control_timestep)


SHARED = (
    Metric("seconds", "s", "length of the episode", _seconds, in_tables=False),
    Metric("peak_sideslip", "rad", "largest |sideslip|", largest("sideslip")),
    Metric("steering_effort", "rad", "root of the mean of front_steer^2 + rear_steer^2", _steering_effort),
    Metric("cost", "s", "seconds with a corner of the body outside", _cost, in_tables=False),
    Metric("peak_lateral_acceleration", "m/s2", "largest |lateral acceleration|", largest("lateral_acceleration")),
    Metric("largest_tracking_error", "m", "largest |lateral position - path|", largest("lateral_error")),
)
"""Of every task."""


def figures(metrics: tuple[Metric, ...], run: Run) -> dict[str, Any]:
    """All figures of an episode, by name."""
    return {metric.name: metric.law(run) for metric in metrics}
