"""The one table of environment ids."""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium as gym


class Row(NamedTuple):
    """One environment id. Defaults live in the constructors: gym.make merges these keywords with the user's."""

    id: str
    entry_point: str
    vector_entry_point: str
    max_episode_steps: int


ENVIRONMENTS = (
    Row(
        "BicycleStab-v0",
        "bicycle_env.envs.bicycle_stab:BicycleStabEnv",
        "bicycle_env.envs.bicycle_stab:BicycleStabVectorEnv",
        400,
    ),
    Row(
        "BicycleLaneChange-v0",
        "bicycle_env.envs.bicycle_lane_change:BicycleLaneChangeEnv",
        "bicycle_env.envs.bicycle_lane_change:BicycleLaneChangeVectorEnv",
        300,
    ),
    Row(
        "BicycleDoubleLaneChange-v0",
        "bicycle_env.envs.bicycle_double_lane_change:BicycleDoubleLaneChangeEnv",
        "bicycle_env.envs.bicycle_double_lane_change:BicycleDoubleLaneChangeVectorEnv",
        400,
    ),
    Row(
        "BicycleActiveSteer-v0",
        "bicycle_env.envs.bicycle_active_steer:BicycleActiveSteerEnv",
        "bicycle_env.envs.bicycle_active_steer:BicycleActiveSteerVectorEnv",
        300,
    ),
    Row(
        "BicycleEvade-v0",
        "bicycle_env.envs.bicycle_evade:BicycleEvadeEnv",
        "bicycle_env.envs.bicycle_evade:BicycleEvadeVectorEnv",
        340,
    ),
)


def _register_own() -> None:
    for row in ENVIRONMENTS:
        if row.id not in gym.registry:
            gym.register(
                row.id,
                entry_point=row.entry_point,
                vector_entry_point=row.vector_entry_point,
                max_episode_steps=row.max_episode_steps,
            )


def register(id: str, task: Any, max_episode_steps: int | None = None) -> None:
    """Register an environment of a task of one's own.

    ``gym.make``, ``gym.make_vec`` and ``TorchVectorEnv`` then know it, with all keywords that the other environments
    have and with the task's fields. In a module that can be imported, say ``my_task.py``, it is found as
    ``my_task:Mine/Gusty-v0``, too, and workers that are spawned import the task's module by themselves.

    Args:
        id: ``"Mine/Gusty-v0"``; registering an id again replaces it.
        task: a :class:`bicycle_env.tasks.task.Task`, or a class of them whose fields all have defaults.
        max_episode_steps: time limit; by default the task's ``episode_steps``.

    Raises:
        TypeError, ValueError: not a task, or one that the environments would contradict; a bad number of steps; an id
            of this package.
    """
    from bicycle_env.envs import registered_tasks  # compiled code is loaded when an environment is made

    if id in {row.id for row in ENVIRONMENTS}:
        raise ValueError(f"id must not be one of this package's own, got {id!r}")
    task, steps = registered_tasks.checked(task, max_episode_steps)
    single, many = registered_tasks.add(id, task)
    gym.registry.pop(id, None)
    gym.register(id, entry_point=single, vector_entry_point=many, max_episode_steps=steps)


def check_task(id: str, *, cars: int = 8, seed: int = 0, **keywords: Any) -> tuple[str, ...]:
    """Try what every environment of this package promises on one of a task of one's own.

    One car and the same among many: to the bit. On tensors, where torch is installed: a step to 1e-12. The mirror
    image: exactly, unless the task has none. A picture, where pygame is installed. Random actions, whole episodes.

    Args:
        id: as ``gym.make`` takes it, ``"my_task:Mine/Gusty-v0"`` too.
        cars: how many are driven.
        seed: of starts and actions.
        **keywords: of the environment, ``level="hard"`` for example.

    Returns:
        A line about each.

    Raises:
        ValueError: the first promise that is not kept: in which number, of which car, after how many steps.
        TypeError, gymnasium.error.Error: what ``gym.make`` raises.
    """
    from bicycle_env.envs.agreement import check_task as tried

    return tried(id, cars, seed, keywords)


_register_own()
