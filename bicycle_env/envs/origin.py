"""From an environment's keywords to what it is made of: those given, before its level's, before the task's defaults."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any, NamedTuple

from bicycle_env.envs.setup import NAMES, ONE_CAR, Setup, check_names, taken_from
from bicycle_env.physics.validation import choice, from_fields, known_keys
from bicycle_env.tasks.task import Task

OF_MANY = ("num_envs", "dtype", "threads", "autoreset_mode", "staggered_start", "on_invalid")
ELSEWHERE = {"seed": "reset(seed=...)", **dict.fromkeys(OF_MANY, "gym.make_vec(...), without vectorization_mode")}
"""Words that people look for among the keywords of a single environment."""


class Origin(NamedTuple):
    """What a fleet was made of: to make one with other cars."""

    task: Task
    """Without what is added to it."""
    setup: Setup
    time_limit: int | None
    of_level: tuple[Task, Setup]
    """What both are of the level alone, without another keyword."""


def origin_of(default: Task, keywords: Mapping[str, Any], time_limit: int | None = None) -> Origin:
    """Of an environment's task without keywords, and of its keywords.

    Raises:
        TypeError: an unknown keyword, with the nearest known one.
        ValueError, TypeError: a level that the task does not have; a bad value of a field of the task.
    """

    level = _level(default, keywords.get("level"))
    usual = _over(default.defaults, {} if level is None else default.levels[level])

    def made(given: Mapping[str, Any]) -> tuple[Task, Setup]:
        left = _over(usual, {**given, "level": level})
        setup = taken_from(left)
        return _changed(default, left), setup

    return Origin(*made(keywords), time_limit, made({}))


def _level(task: Task, level: Any) -> str | None:
    """The name of a level; None: that of the level without numbers, if there is one."""
    if level is None:
        return next((name for name, numbers in task.levels.items() if not numbers), None)
    if not task.levels:
        raise ValueError(f"level must be None, the task {type(task).__name__} has no levels; got {level!r}")
    return choice("level", level, task.levels)


def _over(below: Mapping[str, Any], keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Keywords with others below them; a speed hides a speed ratio below it, and the other way round."""
    left = dict(below)
    for given, other in (("speed", "speed_ratio"), ("speed_ratio", "speed")):
        if keywords.get(given) is not None:
            left.pop(other, None)
    return {**left, **keywords}


def check_levels(task: Task) -> None:
    """ValueError for a default or a level of a task that names no keyword of its environments, nor a field of it."""
    name, fields = type(task).__name__, inspect.signature(type(task)).parameters
    shared = [keyword for keyword in NAMES if keyword != "level"]
    known_keys(f"default of the task {name}", task.defaults, shared)
    for level, numbers in task.levels.items():
        known_keys(f"keyword of the level {level!r} of the task {name}", numbers, [*shared, *fields])


def names_of(task: Task) -> list[str]:
    """All keywords of the environments of a task: the shared ones, then its own."""
    return [*NAMES, *ONE_CAR, *inspect.signature(type(task)).parameters]


def _changed(default: Any, keywords: Mapping[str, Any]) -> Task:
    """The task with keywords of its own."""
    for name in keywords:
        if name in ELSEWHERE:
            raise TypeError(f"{name} is no keyword of one car: give it to {ELSEWHERE[name]}")
    known_keys("keyword", keywords, names_of(default), TypeError)
    check_names(default)
    given = dict(keywords)
    for name, value in keywords.items():
        if isinstance(value, Mapping) and dataclasses.is_dataclass(usual := getattr(default, name)):
            given[name] = from_fields(name, type(usual), value)  # as JSON has it
    return dataclasses.replace(default, **given)  # type: ignore[no-any-return]
