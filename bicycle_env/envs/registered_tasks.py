"""Environments of tasks that users register: for each id a class for one car and a class for many."""

from __future__ import annotations

import importlib
from typing import Any

from bicycle_env.envs.many.vector_env import SingleTrackVectorEnv
from bicycle_env.envs.origin import check_levels
from bicycle_env.envs.setup import check_names
from bicycle_env.envs.single.single_track_env import SingleTrackEnv
from bicycle_env.envs.telemetry import check_metrics
from bicycle_env.physics.validation import whole
from bicycle_env.tasks.checking import check
from bicycle_env.tasks.task import Task

SEPARATOR = " of "
_CLASSES: dict[str, type] = {}


def checked(task: Any, max_episode_steps: int | None) -> tuple[Task, int]:
    """A task and its time limit; TypeError or ValueError."""
    if isinstance(task, type) and issubclass(task, Task):
        task = task()
    if not isinstance(task, Task):
        raise TypeError(f"task must be a bicycle_env.tasks.task.Task or a class of them, got {task!r}")
    check_names(task)
    check(task)
    check_levels(task)
    check_metrics(task)
    return task, whole("max_episode_steps", task.episode_steps if max_episode_steps is None else max_episode_steps)


def add(id: str, task: Task) -> tuple[str, str]:
    """Make the classes of an id; the entry points of one car and of many.

    An entry point names the task's module: a process that has not imported it, such as a spawned worker, does so then.
    """
    words, module = type(task).__doc__, type(task).__module__
    single = type("SingleTaskEnv", (SingleTrackEnv,), {"default_task": task, "__doc__": words})
    many = type("ManyTaskEnv", (SingleTrackVectorEnv,), {"single_class": single, "__doc__": words})
    entry_points = []
    for made, count in ((single, "one"), (many, "many")):
        name = f"{id} for {count}{SEPARATOR}{module}"
        made.__module__, made.__qualname__ = __name__, name
        _CLASSES[name] = made
        entry_points.append(f"{__name__}:{name}")
    return entry_points[0], entry_points[1]


def __getattr__(name: str) -> Any:
    module = name.rpartition(SEPARATOR)[2]
    if name not in _CLASSES and SEPARATOR in name and module != "__main__":
        importlib.import_module(module)
    if name in _CLASSES:
        return _CLASSES[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; bicycle_env.register() makes them")
