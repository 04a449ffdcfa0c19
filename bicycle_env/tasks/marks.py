"""What stands or lies on a task's road, for the pictures; nobody is judged by it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bicycle_env.physics.validation import choice, number, whole

KINDS = {"cones": 1, "ice": 3, "obstacle": 3}
"""How many points each has at least."""


class Mark(NamedTuple):
    """``Mark("cones", points)``: one at each point. "ice" and "obstacle": a patch with these corners."""

    kind: str
    points: tuple[tuple[float, float], ...]
    """(x along the road, y to the left), m."""


def checked(marks: Iterable[Mark]) -> tuple[Mark, ...]:
    """The marks, in plain floats; ValueError or TypeError for what is none."""
    found = [
        Mark(choice("kind", kind, KINDS), tuple((number("x", x), number("y", y)) for x, y in points))
        for kind, points in marks
    ]
    for mark in found:
        whole(f"number of points of {mark.kind}", len(mark.points), KINDS[mark.kind])
    return tuple(found)
