"""How many cars lie in memory: blocks of a fixed number of rows, each number of all cars of a block side by side.

Such structures of arrays let the compiler turn a loop over the cars into vector instructions. Here is the way between
a block and the named tuples that the laws are written with.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from bicycle_env.physics import compiled
from bicycle_env.physics.single_track import Car, CarState
from bicycle_env.tasks.episode import Memory, Rules, World
from bicycle_env.tasks.task import Task

KEPT = ("front_steer_command", "rear_steer_command", "steps", "settled_steps")
"""The numbers of Memory, without the route."""

ROW_COST = {4: 2.0, 8: 1.4, 64: 1.0}
"""Rows a block, and what a row costs in it, roughly: in a long block one row's work fills the waiting of another's.

At most 64: a step keeps the waiting cars of a block as the bits of one number.
"""


def best_length(num_envs: int) -> int:
    """Rows a block for so many cars; the last block is filled up."""
    return min(ROW_COST, key=lambda length: -(-num_envs // length) * length * ROW_COST[length])


class Layout(NamedTuple):
    """The first column of each group of numbers in a block, and how many columns there are."""

    state: int
    kept: int
    end: int
    """The end code of the episode, 0 while it is running."""
    route: int
    car: int
    """Car, settings and scales stand in the block only where rows differ in them."""
    settings: int
    scale: int
    width: int


class Pair(NamedTuple):
    """One number per axle."""

    front: Any
    rear: Any


class Kind(NamedTuple):
    """What lies in a block."""

    task: Task
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
        return compiled.NUMBA if self.dtype == "float64" else compiled.NUMBA_FLOAT32


def layout(kind: Kind) -> Layout:
    """The columns of a block."""
    kept = len(CarState._fields)
    end = kept + len(KEPT)
    route = end + 1
    car = route + len(kind.task.Route._fields)
    settings = car + (len(Car._fields) if kind.varied else 0)
    scale = settings + (len(kind.task.Settings._fields) if kind.varied else 0)
    return Layout(0, kept, end, route, car, settings, scale, scale + (kind.entries if kind.varied else 0))


def shared_numbers(
    car: Car, rules: Rules, settings: Any, scale: Any, bound: Any, preview_times: Any, step_limit: float, dtype: Any
) -> NDArray[Any]:
    """What all rows share; `step_limit` is infinite where episodes have none. Ends at a cache line."""
    numbers = [math.nan, step_limit, *car, *rules, *settings, *(1.0 / scale), *bound, *preview_times]
    numbers += [0.0] * (-len(numbers) % LINE)
    numbers[SIZE] = len(numbers)
    return np.array(numbers, dtype=dtype)


def columns(xp: Any, record: Any, first: int, length: int) -> Any:
    """``read(scratch, k) -> record`` of car k from the columns `first` and on.

    Written out as source: numba makes no tuple of a varying number of strided elements.
    """
    places = ", ".join(f"scratch[k + {(first + j) * length}]" for j in range(len(record._fields)))
    scope: dict[str, Any] = {"record": record}
    exec(f"def read(scratch, k):\n    return record({places})", scope)
    return xp.function(scope["read"])


def store(xp: Any, count: int, first: int, length: int) -> Any:
    """``write(scratch, k, values)`` of the first `count` values into the columns `first` and on."""
    lines = "".join(f"\n    scratch[k + {(first + j) * length}] = values[{j}]" for j in range(count))
    scope: dict[str, Any] = {}
    exec(f"def write(scratch, k, values):{lines or ' pass'}", scope)
    return xp.function(scope["write"])


class Access(NamedTuple):
    """Inlined functions between a block and the named tuples that the laws are written with; car k of the block."""

    shared: Any
    """``shared(world) -> World``, the numbers that all rows share."""
    world: Any
    """``world(block, k, shared) -> World`` of a car."""
    state: Any
    """``state(block, k) -> CarState``."""
    route: Any
    """``route(block, k)``."""
    memory: Any
    """``memory(block, k) -> Memory``."""
    keep_state: Any
    """``keep_state(block, k, state)``."""
    keep_memory: Any
    """``keep_memory(block, k, memory)``: all but the route, which stays the same."""
    scaling: Any
    """``scaling(world, j) -> (1 / scale, bound)`` of entry j of the observation, as all rows share them."""
    entry: Any
    """``entry(value, block, k, per_scale, bound, j) -> float32``: entry j of the observation, scaled and clipped."""


LINE = 16  # numbers: at least a cache line
SIZE, STEP_LIMIT, CAR = 0, 1, 2
"""Where the shared numbers stand: how many they are, the time limit in steps, Car, then the groups that follow."""
RULES = CAR + len(Car._fields)
SETTINGS = RULES + len(Rules._fields)


@functools.cache
def access(kind: Kind) -> Access:
    """Bind them for a kind."""
    xp, length, at = kind.xp, kind.length, layout(kind)
    Settings = kind.task.Settings
    car_size, rules_size, settings_size = len(Car._fields), len(Rules._fields), len(Settings._fields)
    scales = SETTINGS + settings_size
    bounds = scales + kind.entries
    kept = at.kept * length
    route = columns(xp, kind.task.Route, at.route, length)

    def shared(world: Any) -> World:
        return World(
            Car(*to_fixed_tuple(world[CAR:RULES], car_size)),
            Rules(*to_fixed_tuple(world[RULES:SETTINGS], rules_size)),
            Settings(*to_fixed_tuple(world[SETTINGS:scales], settings_size)),
        )

    def memory(block: Any, k: Any) -> Memory:
        j = k + kept
        return Memory(block[j], block[j + length], block[j + 2 * length], block[j + 3 * length], route(block, k))

    if kind.varied:
        own_car, own_settings = columns(xp, Car, at.car, length), columns(xp, Settings, at.settings, length)

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

    def scaling(world: Any, j: Any) -> Any:
        return world[scales + j], np.float32(world[bounds + j])

    def entry(value: Any, block: Any, k: Any, per_scale: Any, bound: Any, j: Any) -> Any:
        scaled = np.float32(value * scale_of(block, k, per_scale, j))
        return min(max(scaled, -bound), bound)

    return Access(
        xp.function(shared),
        xp.function(world),
        columns(xp, CarState, at.state, length),
        route,
        xp.function(memory),
        store(xp, len(CarState._fields), at.state, length),
        store(xp, len(KEPT), at.kept, length),
        xp.function(scaling),
        xp.function(entry),
    )


def preview_times(kind: Kind) -> int:
    """Where the look-ahead times begin in `world`."""
    return SETTINGS + len(kind.task.Settings._fields) + 2 * kind.entries
