"""Many cars at once: compiled start, step, look and measure over blocks of rows.

The laws are the ones of the single environment; what is here brings their arguments from the blocks and their results
back. Three things keep the loops over the cars of a block vectorisable: all that a step needs lies in ONE scratch
array at constant distances, so that the compiler sees that nothing overlaps; indices start from 0, which spares
numba's wrap-around of negative ones; no such loop holds another.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

from bicycle_env.envs import blocks
from bicycle_env.envs.blocks import SIZE, STEP_LIMIT, Kind, Pair, columns, layout, preview_times, store
from bicycle_env.envs.draws import next_double
from bicycle_env.physics import compiled
from bicycle_env.physics.single_track import Axles, axles
from bicycle_env.tasks.ends import corner_outside
from bicycle_env.tasks.task import Reference
from bicycle_env.tasks.transition import stages

BAD_ACTION = -1
"""What ``step`` returns for an action that is not finite; nothing has changed then."""


class Kernels(NamedTuple):
    """The compiled functions. `numbers`: what all rows share, then the blocks, one flat array.

    Of a step they fill observation (n, entries), values (2, n): reward and cost, flags (3, n): terminated, truncated,
    either, and end (n,): codes.
    """

    step: Callable[..., int]
    """``step(numbers, actions, observation, values, flags, end, first, last) -> rows that ended``.

    Of the blocks from `first` to before `last`.
    """
    start: Callable[..., int]
    """``start(numbers, mask, generators, observation, values, flags, end, whole) -> rows that had ended``.

    A random start of the rows in the mask (n,). `whole`: nothing of the step that was taken is theirs.
    """
    look: Callable[..., None]
    """``look(numbers, mask, observation, values)``: observation and cost of the rows in the mask as they are."""
    measure: Callable[..., None]
    """``measure(numbers, out)``: (n, len(telemetry.MEASURED))."""


def number_type(kind: Kind) -> Any:
    """numba's type of the numbers."""
    return numba.from_dtype(np.dtype(kind.dtype))


@compiled.inlined
def split(numbers: Any) -> Any:
    """What all rows share, and the blocks."""
    size = int(numbers[SIZE])
    return numbers[:size], numbers[size:]


@functools.cache
def _step(kind: Kind) -> Any:
    xp, length, entries, access = kind.xp, kind.length, kind.entries, blocks.access(kind)
    task, block_columns = kind.task_class(), layout(kind).width
    block_size = block_columns * length
    begin, advance, finish = (xp.function(law) for law in stages(xp, task, kind.tire, kind.geometry, kind.reward))
    observe, preview = xp.function(task.observe(xp)), xp.function(task.preview(xp))
    times = preview_times(kind)

    # The scratch: a block, and after it what one step needs of each car.
    action_at, stage_at, result_at, seen_at = (block_columns + k for k in (0, 4, 5, 8))
    size = (seen_at + entries) * length
    read_action, keep_action = columns(xp, Pair, action_at, length), store(xp, 2, action_at, length)
    read_command, keep_command = columns(xp, Pair, action_at + 2, length), store(xp, 2, action_at + 2, length)
    keep_result = store(xp, 3, result_at, length)
    stage_column, reward_column, cost_column, code_column = (
        column * length for column in (stage_at, result_at, result_at + 1, result_at + 2)
    )

    def limit(action: Any, steers: Any) -> Any:
        return xp.maximum(xp.minimum(action, 1.0), -1.0) * steers

    limited = xp.function(limit)

    def step(
        numbers: Any, actions: Any, observation: Any, values: Any, flags: Any, end: Any, first: Any, last: Any
    ) -> int:
        world, rows = split(numbers)
        cars, axle = actions.shape[0], actions.shape[1] - 1
        bad = False
        for row in range(first * length, min(last * length, cars)):
            bad |= not (np.isfinite(actions[row, 0]) and np.isfinite(actions[row, axle]))
        if bad:
            return BAD_ACTION
        shared = access.shared(world)
        rules, step_limit = shared.rules, world[STEP_LIMIT]
        substeps = int(rules.substeps)
        scratch = np.zeros(size, rows.dtype)
        seen = np.empty(entries * length, np.float32)
        ended = 0
        for block in range(first, last):
            row = block * length
            here = min(length, cars - row)
            stored = rows[block * block_size : (block + 1) * block_size]
            for k in range(block_size):
                scratch[k] = stored[k]
            for k in range(here):
                keep_action(scratch, k, (actions[row + k, 0], actions[row + k, axle]))
            for k in range(length):
                action = read_action(scratch, k)
                front = limited(action.front, rules.steers_front)
                rear = limited(action.rear, rules.steers_rear)
                mine = access.world(scratch, k, shared)
                command, stage = begin(access.state(scratch, k), access.memory(scratch, k), (front, rear), mine)
                keep_action(scratch, k, (front, rear))
                keep_command(scratch, k, command)
                scratch[k + stage_column] = stage
            for _ in range(substeps):
                for k in range(length):
                    command = read_command(scratch, k)
                    mine = access.world(scratch, k, shared)
                    state = advance(access.state(scratch, k), (command.front, command.rear), mine)
                    access.keep_state(scratch, k, state)
            for k in range(length):
                action = read_action(scratch, k)
                memory, reward, code, cost = finish(
                    access.state(scratch, k),
                    access.memory(scratch, k),
                    (action.front, action.rear),
                    scratch[k + stage_column],
                    access.world(scratch, k, shared),
                )
                access.keep_memory(scratch, k, memory)
                keep_result(scratch, k, (reward, cost, code))
            for k in range(block_size):
                stored[k] = scratch[k]

            for k in range(length):
                mine = access.world(scratch, k, shared)
                seen_values = observe(access.state(scratch, k), access.memory(scratch, k), mine)
                for j in range(len(seen_values)):
                    scratch[k + (seen_at + j) * length] = seen_values[j]
            for j in range(len(seen_values), entries):
                time = world[times + j - len(seen_values)]
                for k in range(length):
                    mine = access.world(scratch, k, shared)
                    ahead = preview(access.state(scratch, k), access.route(scratch, k), mine, time)
                    scratch[k + (seen_at + j) * length] = ahead
            for j in range(entries):
                for k in range(length):
                    seen[k + j * length] = access.entry(scratch[k + (seen_at + j) * length], scratch, k, world, j)

            for k in range(here):
                values[0, row + k] = scratch[k + reward_column]
                values[1, row + k] = scratch[k + cost_column]
                code_number = int(scratch[k + code_column])
                late = access.memory(scratch, k).steps >= step_limit
                end[row + k] = code_number
                flags[0, row + k] = code_number > 0
                flags[1, row + k] = late
                over = (code_number > 0) | late
                flags[2, row + k] = over
                ended += over
                for j in range(entries):
                    observation[row + k, j] = seen[k + j * length]
        return ended

    table = numba.float32[:, ::1]
    signature = numba.int64(
        number_type(kind)[::1],
        table,
        table,
        numba.float64[:, ::1],
        numba.boolean[:, ::1],
        numba.int8[::1],
        numba.int64,
        numba.int64,
    )
    return compiled.entry_point(step, signature, nogil=True)


@functools.cache
def _beginning(kind: Kind) -> tuple[Any, Any]:
    """``start`` and ``look``."""
    xp, length, entries, access = kind.xp, kind.length, kind.entries, blocks.access(kind)
    task, at = kind.task_class(), layout(kind)
    block_size, uniforms = at.width * length, task.uniforms
    observe, preview = xp.function(task.observe(xp)), xp.function(task.preview(xp))
    start_law = xp.function(task.start(xp))
    reference = xp.function(task.reference(xp))
    outside = xp.function(corner_outside(xp))
    keep_route = store(xp, len(task.Route._fields), at.route, length)
    times = preview_times(kind)

    def show_row(block: Any, k: Any, world: Any, shared: Any, observation: Any) -> Any:
        mine, state, memory = access.world(block, k, shared), access.state(block, k), access.memory(block, k)
        values = observe(state, memory, mine)
        for j in range(len(values)):
            observation[j] = access.entry(values[j], block, k, world, j)
        for j in range(len(values), entries):
            ahead = preview(state, memory.route, mine, world[times + j - len(values)])
            observation[j] = access.entry(ahead, block, k, world, j)
        return outside(state, reference(state, memory.route, mine), mine)

    show = xp.function(show_row)

    def start(
        numbers: Any, mask: Any, generators: Any, observation: Any, values: Any, flags: Any, end: Any, whole: Any
    ) -> int:
        world, rows = split(numbers)
        shared = access.shared(world)
        drawn = np.empty(uniforms)
        over = 0
        for row in range(len(mask)):
            if mask[row]:
                block, k = rows[row // length * block_size : (row // length + 1) * block_size], row % length
                for j in range(uniforms):
                    drawn[j] = next_double(generators[row])
                state, route = start_law(drawn, access.world(block, k, shared))
                access.keep_state(block, k, state)
                access.keep_memory(block, k, (0.0, 0.0, 0.0, 0.0))
                keep_route(block, k, route)
                values[1, row] = show(block, k, world, shared, observation[row])
                over += flags[2, row]
                flags[2, row] = False
                end[row] = 0
                if whole:
                    values[0, row] = 0.0
                    flags[0, row] = False
                    flags[1, row] = False
        return over

    def look(numbers: Any, mask: Any, observation: Any, values: Any) -> None:
        world, rows = split(numbers)
        shared = access.shared(world)
        for row in range(len(mask)):
            if mask[row]:
                block = rows[row // length * block_size : (row // length + 1) * block_size]
                values[1, row] = show(block, row % length, world, shared, observation[row])

    flat, mask_type, table = number_type(kind)[::1], numba.boolean[::1], numba.float32[:, ::1]
    values_type, flags_type, end_type = numba.float64[:, ::1], numba.boolean[:, ::1], numba.int8[::1]
    addresses = numba.uint64[::1]
    return (
        compiled.entry_point(
            start,
            numba.int64(flat, mask_type, addresses, table, values_type, flags_type, end_type, numba.boolean),
            nogil=True,
        ),
        compiled.entry_point(look, numba.void(flat, mask_type, table, values_type), nogil=True),
    )


@functools.cache
def _measure(kind: Kind) -> Any:
    xp, length, access = kind.xp, kind.length, blocks.access(kind)
    block_size = layout(kind).width * length
    axles_law = xp.function(axles(xp, kind.tire, kind.geometry))
    reference_law = xp.function(kind.task_class().reference(xp))
    keep_acting = store(xp, len(Axles._fields), 0, 1)
    keep_reference = store(xp, len(Reference._fields), len(Axles._fields), 1)

    def measure(numbers: Any, out: Any) -> None:
        world, rows = split(numbers)
        shared = access.shared(world)
        for row in range(len(out)):
            block, k = rows[row // length * block_size : (row // length + 1) * block_size], row % length
            state, mine = access.state(block, k), access.world(block, k, shared)
            keep_acting(out[row], 0, axles_law(state, mine.car))
            keep_reference(out[row], 0, reference_law(state, access.route(block, k), mine))

    return compiled.entry_point(measure, numba.void(number_type(kind)[::1], numba.float64[:, ::1]), nogil=True)


@functools.cache
def kernels(kind: Kind) -> Kernels:
    """Compile the functions of a kind, or load them from the cache on disk."""
    label = f"{kind.task_class.name} for many cars with the {type(kind.tire).__name__} tire, {kind.geometry} geometry"
    with compiled.progress(label):
        start, look = _beginning(kind)
        return Kernels(_step(kind), start, look, _measure(kind))
