"""The full physical detail in ``info``, for one car or many."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bicycle_env.physics.lateral import Axles
from bicycle_env.physics.validation import known_keys
from bicycle_env.tasks.checking import world_of
from bicycle_env.tasks.episode import Reference
from bicycle_env.tasks.metrics import Run
from bicycle_env.tasks.task import Task

MOMENT = ("front_peak_force", "rear_peak_force", "speed")
"""Of the car of the moment."""
MEASURED = (*Axles._fields, *(f"reference_{name}" for name in Reference._fields), *MOMENT, "clearance")
"""What the compiled ``measure`` writes, in this order; N and m/s for the car of the moment, the clearance is from the
corridor's edge to the nearest corner of the body [m], negative outside."""


def columns(task: Task) -> tuple[str, ...]:
    """The names in ``run.steps`` of a metric."""
    state = task.State(*(1.0 for _ in task.State._fields))
    return *state._fields, *telemetry(state, dict.fromkeys(MEASURED, 1.0)), "reward", "cost"


def check_metrics(task: Task) -> None:
    """ValueError for a metric that asks for a column that no episode has."""
    steps = dict.fromkeys(columns(task), np.linspace(0.1, 0.3, 3))
    for metric in task.metrics:
        try:
            with np.errstate(all="ignore"):
                metric.law(Run(steps, True, world_of(task)))
        except KeyError as error:
            known_keys(f"column of run.steps (metric {metric.name!r} of the task {task.name})", error.args, steps)
        except Exception:  # of numbers that no episode has
            continue


def telemetry(state: Any, measured: Mapping[str, Any]) -> dict[str, Any]:
    """From what was measured in a state to the entries of ``info``; floats, or arrays of one shape."""
    return {
        **{name: measured[name] for name in Axles._fields},
        "sideslip": state.lateral_velocity / measured["speed"],
        "front_saturation": abs(measured["front_lateral_force"]) / measured["front_peak_force"],
        "rear_saturation": abs(measured["rear_lateral_force"]) / measured["rear_peak_force"],
        "lateral_error": state.lateral_position - measured["reference_lateral_position"],
        "goal_error": state.lateral_position - measured["reference_goal"],
        "heading_error": state.heading - measured["reference_heading"],
        "clearance": measured["clearance"],
    }
