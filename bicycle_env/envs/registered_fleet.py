"""The cars of a registered id, from its keywords."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator

from bicycle_env.envs.fleet import Fleet, configure_fleet
from bicycle_env.envs.origin import origin_of
from bicycle_env.envs.setup import ONE_CAR
from bicycle_env.envs.single.single_track_env import SingleTrackEnv, keyword_names


def registered_spec(env_id: object) -> Any:
    """The registered row; "module:id" imports the module first, as gym.make does."""
    if not isinstance(env_id, str):
        raise TypeError(f"env_id must be the id of a registered environment, got {env_id!r}")
    module, _, name = env_id.rpartition(":")
    if module:
        importlib.import_module(module)
    return gym.spec(name)


def registered_fleet(
    spec: Any, num_envs: int, keywords: Mapping[str, Any], time_limit: int | None = None, varied: bool = False
) -> Fleet:
    """The cars of a registered id: the single environment's defaults, the registered keywords, then those given.

    `time_limit`: steps of an episode, None where there is none.

    Raises:
        ValueError: the id is not of a single-track environment.
        TypeError: a keyword that the single environment does not have, or that is for one car only.
    """
    task = _class_of(spec).default_task
    return configure_fleet(origin_of(task, {**spec.kwargs, **keywords}, time_limit), num_envs, varied)


def keywords_of_id(spec: Any) -> list[str]:
    """The keywords of an id's cars; ValueError as :func:`registered_fleet`."""
    return [name for name in keyword_names(_class_of(spec)) if name not in ONE_CAR]


def _class_of(spec: Any) -> type[SingleTrackEnv]:
    env_class = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    if not (isinstance(env_class, type) and issubclass(env_class, SingleTrackEnv)):
        raise ValueError(f"env_id must be of a single-track environment, got {spec.id!r}")
    return env_class
