"""Episodes of many cars at once, and how they came out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from bicycle_env.control import Policy

Array = NDArray[Any]
Act = Callable[[Array, int], Array]
"""``act(observation, step)``: (cars, entries) and how many actions were before, to actions (cars, axles)."""
Watch = Callable[[Array, dict[str, Any]], None]
"""``watch(rewards, info)`` of a step, (cars,) each."""


class Outcome(NamedTuple):
    """One car's episode."""

    success: bool
    """The task's success when the time was over."""
    on_road: bool
    """The time was over: the car neither spun nor left its lane, settled or not."""
    episode_return: float
    """Sum of the rewards."""
    steps: int
    """Actions until the end."""


class Outcomes(NamedTuple):
    """One episode of each car, (cars,) each, as those of :class:`Outcome`."""

    success: NDArray[np.bool_]
    on_road: NDArray[np.bool_]
    episode_return: NDArray[np.float64]
    steps: NDArray[np.int64]

    def one(self, row: int) -> Outcome:
        """That of a car."""
        success, on_road, episode_return, steps = (values[row].item() for values in self)
        return Outcome(success, on_road, episode_return, steps)


def make_cars(env_id: str, keywords: Mapping[str, Any], cars: int) -> Any:
    """The native vector environment for :func:`drive`: rows that have ended wait."""
    return gym.make_vec(env_id, cars, vectorization_mode="vector_entry_point", autoreset_mode="Disabled", **keywords)


class Cars:
    """Cars of an environment, as many as are asked for; the last ones are kept. ``plant``: the single environment.

    Args:
        env_id, keywords: of the environment.
        own: given how many cars, keywords of which each has its own, such as their speeds; the plant has none of them.
    """

    def __init__(
        self, env_id: str, keywords: Mapping[str, Any], own: Callable[[int], Mapping[str, Any]] | None = None
    ) -> None:
        env = gym.make(env_id, **keywords)
        plant: Any = env.unwrapped
        self.plant = plant
        limit = env.spec.max_episode_steps if env.spec is not None else None
        self.episode_steps: int = limit or plant.task.episode_steps
        self._env_id, self._keywords, self._own, self._last = env_id, keywords, own, None

    def of(self, count: int) -> Any:
        """A native vector environment."""
        if self._last is None or self._last.num_envs != count:
            own = {} if self._own is None else self._own(count)
            self._last = make_cars(self._env_id, {**self._keywords, **own}, count)
        return self._last


def by(policy: Policy) -> Act:
    """What a policy does, which forgets what was before."""
    policy.reset()
    return lambda observation, _: policy.act(observation)


def drive(
    cars: Any, act: Act, seeds: Sequence[int], draws: Sequence[int] | None = None, watch: Watch | None = None
) -> Outcomes:
    """Drive one episode of every car.

    Args:
        cars: a native vector environment with autoreset_mode="Disabled".
        act: gives the actions of all cars; those of a car whose episode has ended do nothing.
        seeds: one per car; its start is that of the single environment's ``reset(seed=...)``.
        draws: seeds, one per car, of what is hidden: what the task's ``hidden`` names is as a start with that seed has
            it, such as friction, the driver's script, the key of the sensors' noise, what ``randomise=`` draws; all
            else is the car's own start. None: its own, too.
        watch: called after each step, also with what the cars say that wait.
    """
    plant = cars.unwrapped
    if draws is None:
        observation, _ = cars.reset(seed=list(seeds))
    else:
        cars.reset(seed=list(draws))
        drawn = plant.snapshot()
        cars.reset(seed=list(seeds))
        observation = plant.restore(plant.mixed(plant.snapshot(), drawn, plant.task.hidden))
    running = np.ones(plant.num_envs, np.bool_)
    success, on_road = np.zeros_like(running), np.zeros_like(running)
    total, steps = np.zeros(plant.num_envs), np.zeros(plant.num_envs, np.int64)
    step = 0
    while np.any(running):
        observation, reward, terminated, truncated, info = cars.step(act(observation, step))
        if watch is not None:
            watch(reward, info)
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


def replay(env_id: str, keywords: Mapping[str, Any], seed: int, actions: Array) -> Outcome:
    """Drive an episode's recorded actions in the single environment: the proof of a success.

    Args:
        env_id, keywords: of the environment, the keywords as JSON may hold them.
        seed: of the start.
        actions: (steps, axles), of the whole episode.

    Raises:
        ValueError: the episode ends before the actions do, or has not ended with them.
    """
    env = gym.make(env_id, **keywords)
    env.reset(seed=seed)
    total, steps, over, terminated = 0.0, 0, False, False
    for action in np.asarray(actions, np.float32):
        if over:
            break
        _, reward, terminated, truncated, _ = env.step(action)
        total, steps, over = total + float(reward), steps + 1, terminated or truncated
    plant: Any = env.unwrapped
    success = bool(plant.is_success)
    env.close()
    if not over or steps < len(actions):
        found = f"it ends after {steps}" if over else "it has not ended"
        raise ValueError(f"actions must be those of the whole episode from seed {seed}, got {len(actions)}: {found}")
    return Outcome(success, not terminated, total, steps)
