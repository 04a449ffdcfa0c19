"""An episode in words: why it ended, and what was drawn for it and cannot be seen on the road."""

from __future__ import annotations

import math
from typing import Any

from bicycle_env.tasks.sensors import KEY
from bicycle_env.tasks.task import Task

UNITS = {
    "force": "N",
    "start": "s",
    "at": "s",
    "begin": "m",
    "dwell": "s",
    "constant": "s",
    "frequency": "Hz",
    "mass": "kg",
    "inertia": "kg m²",
    "stiffness": "N/rad",
}
"""By the last word of a name; SI, as all states."""
ANGLES = ("amplitude",)


def in_words(end: str) -> str:
    """An end as words: "left_lane" must not be read as the lane on the left."""
    return end.replace("left_", "left the ").replace("_", " ")


def drawn_in_words(task: Task, own: Any) -> tuple[str, ...]:
    """Of each number that the start does not show, its name, value and unit."""
    return tuple(_told(name, getattr(own, name)) for name in task.hidden if name not in KEY)


def _told(name: str, value: float) -> str:
    words, last = name.replace("_", " "), name.rpartition("_")[2]
    if last == "side":
        return f"{words} {'left' if value > 0.0 else 'right'}"
    if last in ANGLES:
        return f"{words} {math.degrees(value):.1f}°"
    return f"{words} {value:.{0 if abs(value) >= 100.0 else 2}f} {UNITS.get(last, '')}".rstrip()
