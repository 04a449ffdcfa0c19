"""The time limit of one car: Gymnasium puts it into a wrapper, and tells the environment inside nothing of it."""

from __future__ import annotations

import sys
from typing import Any

from gymnasium import logger
from gymnasium.wrappers import TimeLimit


def limit_around(env: Any) -> int | None:
    """The steps of the ``TimeLimit`` through which ``env.reset()`` is being called; None if there is none.

    ``gym.make`` neither passes the limit to the constructor nor writes it into ``env.unwrapped.spec``. But the wrapper
    stands among the callers of ``reset()``, and its own ``spec`` says it.
    """
    limits = []
    frame = sys._getframe(1)
    while frame is not None:
        caller = frame.f_locals.get("self")
        if isinstance(caller, TimeLimit) and caller.unwrapped is env:
            limits.append(caller.spec.max_episode_steps if caller.spec is not None else caller._max_episode_steps)
        frame = frame.f_back  # type: ignore[assignment]
    return min(limits, default=None)


def resolve_horizon(given: int | None, limit: int | None, task_steps: int) -> int:
    """Steps that a failure of the quadratic reward pays for: as given, else the time limit, else the task's own."""
    if given is not None:
        return given
    return task_steps if limit is None else limit


def remark(limit: int | None, horizon: int | None, configuration: Any) -> None:
    """Say what is odd about a time limit: another explicit `horizon`, or no time for a success."""
    if limit is None:
        return
    if configuration.reward.uses_horizon and horizon is not None and horizon != limit:
        logger.warn(
            f"horizon = {horizon} is not the time limit of {limit} steps: with the quadratic reward a failure pays for "
            f"the steps up to horizon. Without horizon= it is the time limit."
        )
    if limit < configuration.steps_to_settle:
        logger.warn(
            f"max_episode_steps = {limit} makes success impossible: a car must have been settled for "
            f"{configuration.steps_to_settle} steps when the time is over"
        )
    elif limit < configuration.steps_to_pass:
        logger.warn(
            f"max_episode_steps = {limit} makes success impossible: at {configuration.speed:g} m/s it takes at least "
            f"{configuration.steps_to_pass} steps"
        )
