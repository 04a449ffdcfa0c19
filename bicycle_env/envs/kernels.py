"""Compiled start, step and look of one task on one car: the tasks' pure functions over flat arrays.

An episode lives in one float64 row: CarState, the four numbers of Memory, the route. What stays the same lies in a
second one: Car, Rules, the task's settings, then scale and bound of each observation entry and the preview times.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from bicycle_env.physics import compiled
from bicycle_env.physics.compiled import NUMBA
from bicycle_env.physics.single_track import Axles, Car, CarState, axles
from bicycle_env.physics.tires import Tire
from bicycle_env.tasks.task import Memory, Reference, Rules, Task, World
from bicycle_env.tasks.transition import transition

Row = NDArray[np.float64]

CAR, RULES, STATE = len(Car._fields), len(Rules._fields), len(CarState._fields)
MEMORY = STATE + len(Memory._fields) - 1
STEPS, SETTLED = MEMORY - 2, MEMORY - 1

BAD_ACTION = -1
"""End code for an action that is not finite; nothing has changed then."""

TELEMETRY = (*Axles._fields, *(f"reference_{name}" for name in Reference._fields))

_row = numba.float64[::1]
_observation = numba.float32[::1]


class Kernels(NamedTuple):
    """The compiled functions of one combination."""

    start: Callable[[Row, Row, Row, Any], None]
    """``start(row, world, uniforms, observation)``."""
    look: Callable[[Row, Row, Any], None]
    """``look(row, world, observation)``: the observation of the row as it is."""
    step: Callable[[Row, Row, Row, Any], tuple[float, int, float]]
    """``step(row, world, action, observation) -> (reward, end, cost)``."""
    measure: Callable[[Row, Row, Row], None]
    """``measure(row, world, out)``: the values of ``TELEMETRY``."""


def row_size(task: Task) -> int:
    return MEMORY + len(task.Route._fields)


def world_row(car: Car, rules: Rules, settings: Any, scale: Any, bound: Any, preview_times: Any) -> Row:
    """All constants of an episode in one array."""
    return np.array([*car, *rules, *settings, *scale, *bound, *preview_times], dtype=np.float64)


@functools.cache
def _kernels(
    task_class: type[Task], entries: int, previews: int, tire: Tire, geometry: str, reward: str
) -> Kernels:
    task = task_class()
    Route, Settings = task.Route, task.Settings
    route_size, settings_size = len(Route._fields), len(Settings._fields)
    own, scales = CAR + RULES, CAR + RULES + settings_size
    bounds, times = scales + entries, scales + 2 * entries
    fixed = entries - previews

    start_law = NUMBA.function(task.start(NUMBA))
    observe_law = NUMBA.function(task.observe(NUMBA))
    preview_law = NUMBA.function(task.preview(NUMBA))
    reference_law = NUMBA.function(task.reference(NUMBA))
    step_law = NUMBA.function(transition(NUMBA, task, tire, geometry, reward))
    axles_law = NUMBA.function(axles(NUMBA, tire, geometry))

    @NUMBA.function
    def world_of(numbers: Any) -> World:
        return World(
            Car(*to_fixed_tuple(numbers[:CAR], CAR)),
            Rules(*to_fixed_tuple(numbers[CAR:own], RULES)),
            Settings(*to_fixed_tuple(numbers[own:scales], settings_size)),
        )

    @NUMBA.function
    def state_of(row: Any) -> CarState:
        return CarState(*to_fixed_tuple(row[:STATE], STATE))

    @NUMBA.function
    def memory_of(row: Any) -> Memory:
        route = Route(*to_fixed_tuple(row[MEMORY:], route_size))
        return Memory(row[STATE], row[STATE + 1], row[STEPS], row[SETTLED], route)

    @NUMBA.function
    def keep(state: CarState, memory: Memory, row: Any) -> None:
        for j in range(STATE):
            row[j] = state[j]
        row[STATE] = memory.front_steer_command
        row[STATE + 1] = memory.rear_steer_command
        row[STEPS] = memory.steps
        row[SETTLED] = memory.settled_steps

    def nothing_to_keep(route: Any, row: Any) -> None:
        return  # numba cannot index an empty tuple

    def keep_all(route: Any, row: Any) -> None:
        for j in range(route_size):
            row[MEMORY + j] = route[j]

    keep_route = NUMBA.function(keep_all if route_size else nothing_to_keep)

    @NUMBA.function
    def write(state: CarState, memory: Memory, world: World, numbers: Any, observation: Any) -> None:
        values = observe_law(state, memory, world)
        for j in range(fixed):
            observation[j] = values[j] / numbers[scales + j]
        for j in range(previews):
            ahead = preview_law(state, memory.route, world, numbers[times + j])
            observation[fixed + j] = ahead / numbers[scales + fixed + j]
        for j in range(entries):
            bound = np.float32(numbers[bounds + j])
            observation[j] = min(max(observation[j], -bound), bound)

    def start(row: Any, numbers: Any, uniforms: Any, observation: Any) -> None:
        world = world_of(numbers)
        state, route = start_law(uniforms, world)
        zero = 0.0 * uniforms[0]
        memory = Memory(zero, zero, zero, zero, route)
        keep(state, memory, row)
        keep_route(route, row)
        write(state, memory, world, numbers, observation)

    def look(row: Any, numbers: Any, observation: Any) -> None:
        write(state_of(row), memory_of(row), world_of(numbers), numbers, observation)

    def step(row: Any, numbers: Any, action: Any, observation: Any) -> tuple[float, int, float]:
        for j in range(len(action)):
            if not np.isfinite(action[j]):
                return 0.0, BAD_ACTION, 0.0
        world = world_of(numbers)
        rules = world.rules
        front = rear = 0.0
        if rules.front_column >= 0.0:
            front = min(max(action[int(rules.front_column)], -1.0), 1.0)
        if rules.rear_column >= 0.0:
            rear = min(max(action[int(rules.rear_column)], -1.0), 1.0)
        state, memory, gained, end, cost = step_law(
            state_of(row), memory_of(row), (front, rear), world, int(rules.substeps)
        )
        keep(state, memory, row)
        write(state, memory, world, numbers, observation)
        return gained, end, cost

    def measure(row: Any, numbers: Any, out: Any) -> None:
        world, state = world_of(numbers), state_of(row)
        acting = axles_law(state, world.car)
        reference = reference_law(state, memory_of(row).route, world)
        for j in range(len(acting)):
            out[j] = acting[j]
        for j in range(len(reference)):
            out[len(acting) + j] = reference[j]

    result = numba.types.Tuple((numba.float64, numba.int64, numba.float64))
    with compiled.progress(f"{task.name} with the {type(tire).__name__} tire, {geometry} geometry"):
        return Kernels(
            start=compiled.entry_point(start, numba.void(_row, _row, _row, _observation)),
            look=compiled.entry_point(look, numba.void(_row, _row, _observation)),
            step=compiled.entry_point(step, result(_row, _row, _row, _observation)),
            measure=compiled.entry_point(measure, numba.void(_row, _row, _row)),
        )


def kernels(task: Task, entries: int, tire: Tire, geometry: str, reward: str) -> Kernels:
    """Compiled functions, shared by all environments of the same combination in this process."""
    return _kernels(type(task), entries, len(task.preview_times), tire, geometry, reward)
