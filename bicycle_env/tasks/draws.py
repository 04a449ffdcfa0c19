"""What tasks draw for each episode: numbers, uniform in ranges that are their fields, and a side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bicycle_env.physics.records import record_of, sequence
from bicycle_env.physics.validation import check_fields, choice, pair
from bicycle_env.tasks.path import DIRECTIONS, chosen_side
from bicycle_env.tasks.task import Law

Ranges = Mapping[str, tuple[float, float]]
"""By the names of fields, each a pair (low, high): within which numbers."""


def check_draws(task: Any, ranges: Ranges) -> None:
    """The direction and the ranges of a task; ValueError or TypeError names a bad one."""
    check_fields(task, choice, direction=(DIRECTIONS,))
    check_fields(task, pair, **ranges)


def draws_record(ranges: Ranges) -> Any:
    """Class of the settings: +1, -1 or 0 for random; least value and width of what is drawn."""
    return record_of("Draws", ("direction", *(f"{name}_{what}" for name in ranges for what in ("least", "width"))))


def draws_of(task: Any, ranges: Ranges) -> Any:
    """The settings of a task."""
    ends = (getattr(task, name) for name in ranges)
    return task.Settings(DIRECTIONS[task.direction], *(value for low, high in ends for value in (low, high - low)))


def drawn(xp: Any, ranges: Ranges, first: int) -> Law:
    """``drawn(uniforms, draws) -> (side, value, ...)``: from the uniform numbers from the place `first` on."""

    def within(uniform: Any, least: Any, width: Any) -> Any:
        return xp.multiply_add(width, uniform, least)

    values = (f"within(uniforms[{first + k}], draws.{one}_least, draws.{one}_width)" for k, one in enumerate(ranges, 1))
    side = f"side(uniforms[{first}], draws.direction)"
    found: Law = sequence(xp, [side, *values], "uniforms, draws", within=within, side=chosen_side(xp))
    return found
