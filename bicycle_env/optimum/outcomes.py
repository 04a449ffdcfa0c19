"""Episodes of many cars at once, and how they came out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Act = Callable[[Array, int], Array]
"""``act(observation, step)``: (cars, entries) and the control step, from 0, to actions (cars, axles)."""


class Outcomes(NamedTuple):
    """One episode of each car, (cars,) each."""

    success: NDArray[np.bool_]
    """The task's success: the car had been settled for the last second when the time was over."""
    on_road: NDArray[np.bool_]
    """The car neither spun nor left its lane, settled or not."""
    episode_return: NDArray[np.float64]
    """Sum of the rewards."""
    steps: NDArray[np.int64]
    """Control steps until the end."""


def make_cars(env_id: str, keywords: Mapping[str, Any], cars: int) -> Any:
    """The native vector environment for :func:`drive`: rows that have ended wait."""
    return gym.make_vec(env_id, cars, vectorization_mode="vector_entry_point", autoreset_mode="Disabled", **keywords)


def drive(cars: Any, act: Act, seeds: Sequence[int]) -> Outcomes:
    """Drive one episode of every car.

    Args:
        cars: a native vector environment with autoreset_mode="Disabled".
        act: gives the actions of all cars; those of a car whose episode has ended do nothing.
        seeds: one per car; its start is that of the single environment's ``reset(seed=...)``.
    """
    plant = cars.unwrapped
    observation, _ = cars.reset(seed=list(seeds))
    running = np.ones(plant.num_envs, np.bool_)
    success, on_road = np.zeros_like(running), np.zeros_like(running)
    total, steps = np.zeros(plant.num_envs), np.zeros(plant.num_envs, np.int64)
    step = 0
    while np.any(running):
        observation, reward, terminated, truncated, _ = cars.step(act(observation, step))
        total[running] += reward[running]
        steps[running] += 1
        over = running & (terminated | truncated)
        if np.any(over):
            timed_out = over & ~terminated
            on_road |= timed_out
            success |= timed_out & plant.is_success
            running &= ~over
        step += 1
    return Outcomes(success, on_road, total, steps)
