"""Compiled start, step and look of one task on one car: the tasks' pure functions over flat arrays.

All numbers of an environment lie in one float64 array, because handing an array to compiled code takes as long as a
tenth of a step. First the episode: CarState, the four numbers of Memory, the route. Then what stays the same: Car,
Rules, the task's settings, 1 / scale and bound of each observation entry, the preview times.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from bicycle_env.physics import announcements, compiled
from bicycle_env.physics.compiled import NUMBA
from bicycle_env.physics.single_track import Car, CarState, axles
from bicycle_env.physics.tires import Tire
from bicycle_env.tasks.episode import Memory, Rules, World
from bicycle_env.tasks.rewards import Reward
from bicycle_env.tasks.task import Task
from bicycle_env.tasks.transition import transition

Row = NDArray[np.float64]

CAR, RULES, STATE = len(Car._fields), len(Rules._fields), len(CarState._fields)
MEMORY = STATE + len(Memory._fields) - 1
STEPS, SETTLED = MEMORY - 2, MEMORY - 1

BAD_ACTION = -1
"""End code for an action that is not finite; nothing has changed then."""

_row = numba.float64[::1]
_observation = numba.float32[::1]


class Kernels(NamedTuple):
    """The compiled functions of one combination."""

    start: Callable[[Row, Any, Row], float]
    """``start(memory, observation, uniforms) -> cost``."""
    look: Callable[[Row, Any], float]
    """``look(memory, observation) -> cost``: the observation of the episode as it is."""
    step: Callable[[Row, Any, float, float], tuple[float, int, float]]
    """``step(memory, observation, front, rear) -> (reward, end, cost)``; front and rear are actions."""
    measure: Callable[[Row, Row], None]
    """``measure(memory, out)``: the values of ``telemetry.MEASURED``. Compiled when it is first called."""


def episode_size(task: Task) -> int:
    """How many numbers of the memory belong to the episode."""
    return MEMORY + len(task.Route._fields)


def place_of_rule(task: Task, name: str) -> int:
    """Where a number of ``Rules`` stands in the memory."""
    return episode_size(task) + CAR + Rules._fields.index(name)


def new_memory(task: Task, car: Car, rules: Rules, settings: Any, scale: Any, bound: Any) -> Row:
    """The array of one environment, its episode not yet started."""
    episode = [math.nan] * episode_size(task)
    return np.array([*episode, *car, *rules, *settings, *(1.0 / scale), *bound, *task.preview_times], dtype=np.float64)


class _Access(NamedTuple):
    """Inlined functions between the array and the named tuples that the laws are written with."""

    world: Any
    """``world(memory) -> World``."""
    state: Any
    """``state(memory) -> CarState``."""
    kept: Any
    """``kept(memory) -> Memory``."""
    keep: Any
    """``keep(state, kept, memory)``: all but the route, which stays the same."""
    keep_route: Any
    """``keep_route(route, memory)``."""
    write: Any
    """``write(state, kept, world, memory, observation)``."""


@functools.cache
def _access(task: Task) -> _Access:
    Route, Settings = task.Route, task.Settings
    route_size, settings_size = len(Route._fields), len(Settings._fields)
    cars = MEMORY + route_size
    rules, settings = cars + CAR, cars + CAR + RULES
    scales = settings + settings_size
    observe_law = NUMBA.function(task.observe(NUMBA))
    preview_law = NUMBA.function(task.preview(NUMBA))

    def world(memory: Any) -> World:
        return World(
            Car(*to_fixed_tuple(memory[cars:rules], CAR)),
            Rules(*to_fixed_tuple(memory[rules:settings], RULES)),
            Settings(*to_fixed_tuple(memory[settings:scales], settings_size)),
        )

    def state(memory: Any) -> CarState:
        return CarState(*to_fixed_tuple(memory[:STATE], STATE))

    def kept(memory: Any) -> Memory:
        route = Route(*to_fixed_tuple(memory[MEMORY:cars], route_size))
        return Memory(memory[STATE], memory[STATE + 1], memory[STEPS], memory[SETTLED], route)

    def keep(state: CarState, kept: Memory, memory: Any) -> None:
        for j in range(STATE):
            memory[j] = state[j]
        memory[STATE] = kept.front_steer_command
        memory[STATE + 1] = kept.rear_steer_command
        memory[STEPS] = kept.steps
        memory[SETTLED] = kept.settled_steps

    def keep_route(route: Any, memory: Any) -> None:
        for j in range(route_size):
            memory[MEMORY + j] = route[j]

    def keep_nothing(_route: Any, _memory: Any) -> None:  # numba cannot index an empty tuple
        return

    def write(state: CarState, kept: Memory, world: World, memory: Any, observation: Any) -> None:
        entries = len(observation)
        bounds, times = scales + entries, scales + 2 * entries
        values = observe_law(state, kept, world)
        fixed = len(values)
        for j in range(fixed):
            observation[j] = values[j] * memory[scales + j]
        for j in range(fixed, entries):
            ahead = preview_law(state, kept.route, world, memory[times + j - fixed])
            observation[j] = ahead * memory[scales + j]
        for j in range(entries):
            bound = np.float32(memory[bounds + j])
            observation[j] = min(max(observation[j], -bound), bound)

    route_keeper: Any = keep_route if route_size else keep_nothing
    bind: Any = NUMBA.function
    return _Access(bind(world), bind(state), bind(kept), bind(keep), bind(route_keeper), bind(write))


@functools.cache
def _beginning(task: Task) -> tuple[Any, Any]:
    """``start`` and ``look``, the same for every tire, geometry and reward."""
    access = _access(task)
    start_law = NUMBA.function(task.start(NUMBA))
    reference_law = NUMBA.function(task.reference(NUMBA))
    cost_law = NUMBA.function(task.cost(NUMBA))

    @NUMBA.function
    def look(memory: Any, observation: Any) -> float:
        world, state, kept = access.world(memory), access.state(memory), access.kept(memory)
        access.write(state, kept, world, memory, observation)
        cost: float = cost_law(state, reference_law(state, kept.route, world), world)
        return cost

    def start(memory: Any, observation: Any, uniforms: Any) -> float:
        world = access.world(memory)
        state, route = start_law(uniforms, world)
        zero = 0.0 * uniforms[0]
        kept = Memory(zero, zero, zero, zero, route)
        access.keep(state, kept, memory)
        access.keep_route(route, memory)
        return look(memory, observation)

    def just_look(memory: Any, observation: Any) -> float:
        return look(memory, observation)

    return (
        compiled.entry_point(start, numba.float64(_row, _observation, _row)),
        compiled.entry_point(just_look, numba.float64(_row, _observation)),
    )


@functools.cache
def _stepping(task: Task, tire: Tire, geometry: str, reward: Reward) -> Any:
    access = _access(task)
    step_law = NUMBA.function(transition(NUMBA, task, tire, geometry, reward))

    def step(memory: Any, observation: Any, front: float, rear: float) -> tuple[float, int, float]:
        if not (np.isfinite(front) and np.isfinite(rear)):
            return 0.0, BAD_ACTION, 0.0
        world = access.world(memory)
        front = min(max(front, -1.0), 1.0) * world.rules.steers_front
        rear = min(max(rear, -1.0), 1.0) * world.rules.steers_rear
        state, kept, gained, end, cost = step_law(
            access.state(memory), access.kept(memory), (front, rear), world, int(world.rules.substeps)
        )
        access.keep(state, kept, memory)
        access.write(state, kept, world, memory, observation)
        return gained, end, cost

    result = numba.types.Tuple((numba.float64, numba.int64, numba.float64))
    return compiled.entry_point(step, result(_row, _observation, numba.float64, numba.float64))


@functools.cache
def _measuring(task: Task, tire: Tire, geometry: str) -> Any:
    access = _access(task)
    axles_law = NUMBA.function(axles(NUMBA, tire, geometry))
    reference_law = NUMBA.function(task.reference(NUMBA))

    def measure(memory: Any, out: Any) -> None:
        world, state = access.world(memory), access.state(memory)
        acting = axles_law(state, world.car)
        reference = reference_law(state, access.kept(memory).route, world)
        for j in range(len(acting)):
            out[j] = acting[j]
        for j in range(len(reference)):
            out[len(acting) + j] = reference[j]

    with announcements.progress(_label(task, tire, geometry)):
        return compiled.entry_point(measure, numba.void(_row, _row))


def _label(task: Task, tire: Tire, geometry: str) -> str:
    return f"{task.name} with the {type(tire).__name__} tire, {geometry} geometry"


def kernels(task: Task, tire: Tire, geometry: str, reward: Reward) -> Kernels:
    """Compiled functions, shared by all environments of the same combination in this process."""

    def measure(memory: Any, out: Any) -> None:
        _measuring(task, tire, geometry)(memory, out)

    with announcements.progress(_label(task, tire, geometry)):
        start, look = _beginning(task)
        return Kernels(start, look, _stepping(task, tire, geometry, reward), measure)
