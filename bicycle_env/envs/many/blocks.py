"""How cars lie in memory: blocks of a fixed number of rows, each number of all cars of a block side by side.

Such structures of arrays let the compiler turn a loop over the cars into vector instructions; one car is a block of one
row. Here is the way between a block and the named tuples that the laws are written with.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from bicycle_env.backends.compiled import NUMBA
from bicycle_env.backends.single_precision import NUMBA_FLOAT32
from bicycle_env.physics.car import CarParameters
from bicycle_env.physics.model import Model
from bicycle_env.physics.records import reader, writer
from bicycle_env.tasks.episode import EpisodeState, Rules, World
from bicycle_env.tasks.task import Task

KEPT = ("front_steer_command", "rear_steer_command", "steps", "settled_steps")
"""The numbers of EpisodeState, without the task's own."""

ROW_COST = {4: 2.0, 8: 1.4, 64: 1.0}
"""Rows a block, and what a row costs in it, roughly: in a long block one row's work fills the waiting of another's.

At most 64: a step keeps the waiting cars of a block as the bits of one number.
"""


def best_length(num_envs: int) -> int:
    """Rows a block for so many cars; the last block is filled up."""
    return min(ROW_COST, key=lambda length: -(-num_envs // length) * length * ROW_COST[length])


class Kind(NamedTuple):
    """What lies in a block."""

    task: Task
    model: Model
    entries: int
    """Of the observation."""
    length: int
    """Rows a block."""
    varied: bool
    """Rows have their own car, settings and scales."""
    dtype: str
    """"float64" or "float32"."""

    @property
    def xp(self) -> Any:
        """The namespace of the laws."""
        return NUMBA if self.dtype == "float64" else NUMBA_FLOAT32


class Layout(NamedTuple):
    """The first column of each group of numbers in a block, and how many columns there are."""

    state: int
    kept: int
    end: int
    """The end code of the episode, 0 while it is running."""
    task_state: int
    car: int
    """Car, settings and scales stand in the block only where rows differ in them."""
    settings: int
    scale: int
    width: int


def layout(kind: Kind) -> Layout:
    """The columns of a block."""
    sizes = [len(kind.model.State._fields), len(KEPT), 1, len(kind.task.TaskState._fields)]
    car, settings = len(CarParameters._fields), len(kind.task.Settings._fields)
    return Layout(*_places([*sizes, *(size if kind.varied else 0 for size in (car, settings, kind.entries))]))


class SharedLayout(NamedTuple):
    """Where each group of the numbers that all rows share begins, and how many numbers those are."""

    step_limit: int
    """In steps; infinite where episodes have none."""
    steps_to_settle: int
    """Consecutive steps within the tolerances that make a success."""
    car: int
    rules: int
    settings: int
    scale: int
    """1 / scale of each entry of the observation."""
    bound: int
    times: int
    """Look-ahead times of the preview."""
    whole: int
    """Filled up, so that the blocks begin at a cache line."""


LINE = 16  # numbers: at least a cache line


def shared_layout(kind: Kind) -> SharedLayout:
    """The places of what all rows share; the blocks follow."""
    world = [len(record._fields) for record in (CarParameters, Rules, kind.task.Settings)]
    *places, end = _places([1, 1, *world, kind.entries, kind.entries, len(kind.task.preview_times)])
    return SharedLayout._make([*places, end + -end % LINE])


def _places(sizes: list[int]) -> list[int]:
    """Where each group begins, and the sum."""
    return [sum(sizes[:k]) for k in range(len(sizes) + 1)]


def shared_numbers(kind: Kind, world: World, scale: Any, bound: Any, step_limit: float, steps_to_settle: int) -> Any:
    """The array of :class:`SharedLayout`."""
    car, rules, settings = world
    numbers = [step_limit, steps_to_settle, *car, *rules, *settings, *(1.0 / scale), *bound, *kind.task.preview_times]
    return np.array([*numbers, *[0.0] * (shared_layout(kind).whole - len(numbers))], dtype=kind.dtype)


class Access(NamedTuple):
    """Inlined functions between a block and the named tuples that the laws are written with; car k of the block."""

    shared: Any
    """``shared(numbers) -> World``, the numbers that all rows share."""
    world: Any
    """``world(block, k, shared) -> World`` of a car."""
    state: Any
    """``state(block, k)``, as the model's State."""
    task_state: Any
    """``task_state(block, k)``."""
    episode: Any
    """``episode(block, k) -> EpisodeState``."""
    keep_state: Any
    """``keep_state(block, k, state)``."""
    keep_episode: Any
    """``keep_episode(block, k, episode)``: all but the task's own."""
    keep_task_state: Any
    """``keep_task_state(block, k, task_state)``."""
    scaling: Any
    """``scaling(numbers, j) -> (1 / scale, bound)`` of entry j of the observation, as all rows share them."""
    entry: Any
    """``entry(value, block, k, per_scale, bound, j) -> float32``: entry j of the observation, scaled and clipped."""


@functools.cache
def access(kind: Kind) -> Access:
    """Bind them for a kind."""
    xp, length, at, place = kind.xp, kind.length, layout(kind), shared_layout(kind)
    Settings, TaskState = kind.task.Settings, kind.task.TaskState
    shared_car, shared_rules = reader(xp, CarParameters, place.car, 1), reader(xp, Rules, place.rules, 1)
    shared_settings = reader(xp, Settings, place.settings, 1)
    scales, bounds = place.scale, place.bound
    kept = at.kept * length
    task_state = reader(xp, TaskState, at.task_state, length)

    def shared(numbers: Any) -> World:
        return World(shared_car(numbers, 0), shared_rules(numbers, 0), shared_settings(numbers, 0))

    def episode(block: Any, k: Any) -> EpisodeState:
        j = k + kept
        return EpisodeState(
            block[j], block[j + length], block[j + 2 * length], block[j + 3 * length], task_state(block, k)
        )

    if kind.varied:
        own_car, own_settings = reader(xp, CarParameters, at.car, length), reader(xp, Settings, at.settings, length)

        def world(block: Any, k: Any, shared: Any) -> World:
            return World(own_car(block, k), shared.rules, own_settings(block, k))

        def own_scale(block: Any, k: Any, per_scale: Any, j: Any) -> Any:
            return block[k + (at.scale + j) * length]
    else:

        def world(block: Any, k: Any, shared: Any) -> World:
            same: World = shared
            return same

        def own_scale(block: Any, k: Any, per_scale: Any, j: Any) -> Any:
            return per_scale

    scale_of = xp.function(own_scale)

    def scaling(numbers: Any, j: Any) -> Any:
        return numbers[scales + j], np.float32(numbers[bounds + j])

    def entry(value: Any, block: Any, k: Any, per_scale: Any, bound: Any, j: Any) -> Any:
        scaled = np.float32(value * scale_of(block, k, per_scale, j))
        return min(max(scaled, -bound), bound)

    return Access(
        xp.function(shared),
        xp.function(world),
        reader(xp, kind.model.State, at.state, length),
        task_state,
        xp.function(episode),
        writer(xp, len(kind.model.State._fields), at.state, length),
        writer(xp, len(KEPT), at.kept, length),
        writer(xp, len(TaskState._fields), at.task_state, length),
        xp.function(scaling),
        xp.function(entry),
    )


def keeper(kind: Kind) -> Any:
    """``keep(block, k, episode)`` of what a control step changes: the task's own only where it remembers."""
    own = access(kind)
    if kind.task.remember(kind.xp) is None:
        return own.keep_episode

    def keep(block: Any, k: Any, episode: Any) -> None:
        own_episode(block, k, episode)
        own_task_state(block, k, episode.task_state)

    own_episode, own_task_state = own.keep_episode, own.keep_task_state
    return kind.xp.function(keep)


def companions(kind: Kind, accompany: Any) -> Any:
    """``beside(block, k, shared, elapsed)``: a substep of what the task moves beside car k, if it does."""

    def nothing(block: Any, k: Any, shared: Any, elapsed: Any) -> None:
        pass

    def beside(block: Any, k: Any, shared: Any, elapsed: Any) -> None:
        mine, state, episode = own.world(block, k, shared), own.state(block, k), own.episode(block, k)
        own.keep_task_state(block, k, law(state, episode, elapsed, mine))

    if accompany is None:
        return kind.xp.function(nothing)
    own, law = access(kind), kind.xp.function(accompany)
    return kind.xp.function(beside)
