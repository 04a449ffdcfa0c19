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

from bicycle_env.backends import announcements, compiled
from bicycle_env.backends.compiled import first_bit
from bicycle_env.backends.compiled_random import fetch
from bicycle_env.envs.many import blocks
from bicycle_env.envs.many.blocks import Kind, layout, shared_layout
from bicycle_env.envs.many.car_functions import car_functions
from bicycle_env.physics.lateral import Axles
from bicycle_env.physics.records import reader, writer
from bicycle_env.physics.tires import Linear
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.control_step import car_of_the_moment, parts
from bicycle_env.tasks.ends import clearance
from bicycle_env.tasks.episode import Reference
from bicycle_env.tasks.rewards import Reward
from bicycle_env.tasks.task import Task

BAD_ACTION = -1
"""What ``step`` returns for an action that is not finite; nothing has changed then."""

LONG = 64
"""Rows a block from which on the compiler takes twice as many cars at a time as fit into a vector register.

Not with the linear tire and small angles, which have nothing to wait for.
"""


class Kernels(NamedTuple):
    """The compiled functions. `numbers`: what all rows share, then the blocks, one flat array.

    Of a step they fill observation (n, entries), values (2, n): reward and cost, flags (3 or more, n): terminated,
    truncated and success, and end (n,): codes. Rows whose episode has ended are waiting.
    """

    step: Callable[..., Any]
    """``step(numbers, actions, generators, observation, values, flags, end, restarts, first, last) -> ended rows``.

    Of the blocks from `first` to before `last`. Rows that are waiting start anew if `restarts`, else they stay as they
    are; either way they get no reward, and their actions are not looked at.
    """
    start: Callable[..., None]
    """``start(numbers, mask, generators)``: a random start of the rows in the mask (n,)."""
    look: Callable[..., None]
    """``look(numbers, mask, observation, values)``: observation and cost of the rows in the mask as they are."""
    measure: Callable[..., None]
    """``measure(numbers, out)``: (n, len(telemetry.MEASURED)). Compiled when it is first called."""


def number_type(kind: Kind) -> Any:
    """numba's type of the numbers."""
    return numba.from_dtype(np.dtype(kind.dtype))


class Pair(NamedTuple):
    """One number per axle."""

    front: Any
    rear: Any


@functools.cache
def _step(kind: Kind, reward: Reward) -> Any:
    xp, length, entries, access, place = kind.xp, kind.length, kind.entries, blocks.access(kind), shared_layout(kind)
    task, block_columns, car = kind.task, layout(kind).width, car_functions(kind)
    block_size, uniforms = block_columns * length, task.uniforms
    made = parts(xp, task, kind.model, reward)
    begin, advance, finish = (xp.function(law) for law in made[:3])
    beside, keep_after = blocks.companions(kind, made.accompany), blocks.keeper(kind)
    limit_at, settle_at, times, shared_size = place.step_limit, place.steps_to_settle, place.times, place.whole

    # The scratch: a block, and after it what one step needs of each car.
    action_at, before_at, result_at, waits_at, seen_at = (block_columns + k for k in (0, 4, 5, 7, 8))
    size = (seen_at + 2 * entries) * length
    read_action, keep_action = reader(xp, Pair, action_at, length), writer(xp, 2, action_at, length)
    read_command, keep_command = reader(xp, Pair, action_at + 2, length), writer(xp, 2, action_at + 2, length)
    keep_result = writer(xp, 2, result_at, length)
    before_column, reward_column, cost_column, waits_column, end_column, shown_column = (
        column * length
        for column in (before_at, result_at, result_at + 1, waits_at, layout(kind).end, seen_at + entries)
    )

    def limit(action: Any, steers: Any) -> Any:
        return xp.maximum(xp.minimum(action, 1.0), -1.0) * steers

    limited = xp.function(limit)
    largest, one = np.finfo(np.float32).max, np.uint64(1)

    def step(
        numbers: Any,
        actions: Any,
        generators: Any,
        observation: Any,
        values: Any,
        flags: Any,
        end: Any,
        restarts: Any,
        first: Any,
        last: Any,
    ) -> int:
        shared_numbers, rows = numbers[:shared_size], numbers[shared_size:]
        cars, axle = actions.shape[0], actions.shape[1] - 1
        step_limit, steps_to_settle = shared_numbers[limit_at], shared_numbers[settle_at]

        # Before anything changes: are the actions good?
        taken = actions[first * length : last * length].reshape(-1)
        bad = 0
        for j in range(len(taken)):
            bad += not abs(taken[j]) <= largest
        if bad:
            for row in range(first * length, min(last * length, cars)):
                if not (np.isfinite(actions[row, 0]) and np.isfinite(actions[row, axle])):
                    block_start = row // length * block_size
                    if not car.is_over(rows[block_start : block_start + block_size], row % length, step_limit):
                        return BAD_ACTION

        shared = access.shared(shared_numbers)
        rules = shared.rules
        substeps, physics_timestep = int(rules.substeps), rules.control_timestep / rules.substeps
        scratch = np.zeros(size, rows.dtype)
        flat_observation = observation.reshape(-1)
        drawn = np.empty(uniforms)
        ended = 0
        for block in range(first, last):
            # A block of cars and their actions come into the scratch.
            row = block * length
            here = min(length, cars - row)
            stored = rows[block * block_size : (block + 1) * block_size]
            for k in range(block_size):
                scratch[k] = stored[k]
            given = actions[row : row + here].reshape(-1)
            if axle:  # both are steered; written apart, because constant distances vectorise
                for k in range(here):
                    keep_action(scratch, k, (given[2 * k], given[2 * k + 1]))
            else:
                for k in range(here):
                    keep_action(scratch, k, (given[k], given[k]))

            # The step, in the three parts of tasks/control_step.py.
            for k in range(length):
                action = read_action(scratch, k)
                front = limited(action.front, rules.steers_front)
                rear = limited(action.rear, rules.steers_rear)
                mine = access.world(scratch, k, shared)
                command, before = begin(access.state(scratch, k), access.episode(scratch, k), (front, rear), mine)
                keep_action(scratch, k, (front, rear))
                keep_command(scratch, k, command)
                scratch[k + before_column] = before
                scratch[k + waits_column] = xp.where(car.is_over(scratch, k, step_limit), 1.0, 0.0)
            waiting = np.uint64(0)  # bit k: car k
            for k in range(here):
                waiting |= np.uint64(scratch[k + waits_column] > 0.0) << np.uint64(k)
            left = waiting
            while left:  # their generators may be far away in memory: on their way while the others drive
                fetch(generators[row + first_bit(left)])
                left &= left - one
            elapsed = 0.0 * physics_timestep
            for _ in range(substeps):
                for k in range(length):
                    beside(scratch, k, shared, elapsed)
                for k in range(length):
                    command = read_command(scratch, k)
                    mine = access.world(scratch, k, shared)
                    episode = access.episode(scratch, k)
                    state = advance(access.state(scratch, k), episode, (command.front, command.rear), elapsed, mine)
                    access.keep_state(scratch, k, state)
                elapsed += physics_timestep
            for k in range(length):
                action, command = read_action(scratch, k), read_command(scratch, k)
                episode, reward, code, cost = finish(
                    access.state(scratch, k),
                    access.episode(scratch, k),
                    (action.front, action.rear),
                    (command.front, command.rear),
                    scratch[k + before_column],
                    access.world(scratch, k, shared),
                )
                keep_after(scratch, k, episode)
                keep_result(scratch, k, (reward, cost))
                scratch[k + end_column] = code

            # Cars that have been waiting did not take that step: they start anew, or stay as they were.
            left = waiting
            while left:
                k = first_bit(left)
                left &= left - one
                if restarts:
                    car.begin(scratch, k, shared, drawn, generators[row + k])
                else:
                    for j in range(block_columns):
                        scratch[k + j * length] = stored[k + j * length]
                keep_result(scratch, k, (0.0, car.cost(scratch, k, shared)))
            for k in range(block_size):
                stored[k] = scratch[k]

            # What is seen: values, then scaled and clipped to float32, column by column.
            for k in range(length):
                seen_values = car.observe(scratch, k, shared)
                for j in range(len(seen_values)):
                    scratch[k + (seen_at + j) * length] = seen_values[j]
            for j in range(len(seen_values), entries):
                time = shared_numbers[times + j - len(seen_values)]
                for k in range(length):
                    scratch[k + (seen_at + j) * length] = car.preview(scratch, k, shared, time)
            shown = scratch[shown_column:].view(np.float32)
            for j in range(entries):
                per_scale, bound = access.scaling(shared_numbers, j)
                for k in range(length):
                    value = scratch[k + (seen_at + j) * length]
                    shown[k + j * length] = access.entry(value, scratch, k, per_scale, bound, j)

            # The results go out, through slices whose indices count from 0.
            rewards, costs = values[0, row : row + here], values[1, row : row + here]
            for k in range(here):
                rewards[k] = scratch[k + reward_column]
            for k in range(here):
                costs[k] = scratch[k + cost_column]
            ends = end[row : row + here]
            terminated, truncated = flags[0, row : row + here], flags[1, row : row + here]
            success = flags[2, row : row + here]
            for k in range(here):
                ends[k] = np.int8(scratch[k + end_column])
            for k in range(here):
                terminated[k] = scratch[k + end_column] > 0.0
            for k in range(here):
                truncated[k] = access.episode(scratch, k).steps >= step_limit
            for k in range(here):
                success[k] = (access.episode(scratch, k).settled_steps >= steps_to_settle) & (
                    scratch[k + end_column] == 0.0
                )
            for k in range(here):
                ended += terminated[k] | truncated[k]
            seen = flat_observation[row * entries : (row + here) * entries]
            for k in range(here):
                for j in range(entries):
                    seen[k * entries + j] = shown[k + j * length]
        return ended

    table, number = numba.float32[:, ::1], numba.int64
    results = (table, numba.float64[:, ::1], numba.boolean[:, ::1], numba.int8[::1])
    given = (number_type(kind)[::1], table, numba.uint64[::1])
    signature = number(*given, *results, numba.boolean, number, number)
    waits = kind.model.geometry == "exact" or not isinstance(kind.model.tire, Linear)
    return compiled.entry_point(step, signature, nogil=True, interleave=2 if waits and length >= LONG else 0)


@functools.cache
def beginning(kind: Kind) -> tuple[Any, Any]:
    """``start`` and ``look``, the same for every tire, geometry and reward."""
    length, access, car, uniforms = kind.length, blocks.access(kind), car_functions(kind), kind.task.uniforms
    block_size, shared_size = layout(kind).width * length, shared_layout(kind).whole

    def start(numbers: Any, mask: Any, generators: Any) -> None:
        shared_numbers, rows = numbers[:shared_size], numbers[shared_size:]
        shared = access.shared(shared_numbers)
        drawn = np.empty(uniforms)
        for row in range(len(mask)):
            if mask[row]:
                block, k = rows[row // length * block_size : (row // length + 1) * block_size], row % length
                car.begin(block, k, shared, drawn, generators[row])

    def look(numbers: Any, mask: Any, observation: Any, values: Any) -> None:
        shared_numbers, rows = numbers[:shared_size], numbers[shared_size:]
        shared = access.shared(shared_numbers)
        for row in range(len(mask)):
            if mask[row]:
                block, k = rows[row // length * block_size : (row // length + 1) * block_size], row % length
                car.show(block, k, shared, shared_numbers, observation[row])
                values[1, row] = car.cost(block, k, shared)

    flat, mask_type, table = number_type(kind)[::1], numba.boolean[::1], numba.float32[:, ::1]
    return (
        compiled.entry_point(start, numba.void(flat, mask_type, numba.uint64[::1]), nogil=True),
        compiled.entry_point(look, numba.void(flat, mask_type, table, numba.float64[:, ::1]), nogil=True),
    )


@functools.cache
def measuring(kind: Kind) -> Any:
    """``measure``."""
    xp, length, access = kind.xp, kind.length, blocks.access(kind)
    block_size, shared_size = layout(kind).width * length, shared_layout(kind).whole
    moment = xp.function(car_of_the_moment(xp, kind.task))
    axles_law = xp.function(kind.model.axles(xp, kind.task.conditions(xp) is not None))
    reference_law = xp.function(kind.task.reference(xp))
    keep_acting = writer(xp, len(Axles._fields), 0, 1)
    keep_reference = writer(xp, len(Reference._fields), len(Axles._fields), 1)
    keep_rest = writer(xp, 4, len(Axles._fields) + len(Reference._fields), 1)
    clearance_law = xp.function(clearance(xp, kind.task))

    def measure(numbers: Any, out: Any) -> None:
        shared_numbers, rows = numbers[:shared_size], numbers[shared_size:]
        shared = access.shared(shared_numbers)
        for row in range(len(out)):
            block, k = rows[row // length * block_size : (row // length + 1) * block_size], row % length
            state, mine = access.state(block, k), access.world(block, k, shared)
            episode = access.episode(block, k)
            now = moment(state, episode, 0.0 * episode.steps, mine)
            keep_acting(out[row], 0, axles_law(state, now))
            reference = reference_law(state, episode.task_state, mine)
            keep_reference(out[row], 0, reference)
            clear = clearance_law(state, reference, episode, mine)
            keep_rest(out[row], 0, (now.front_peak_force, now.rear_peak_force, now.speed, clear))

    with announcements.progress(label(kind)):
        return compiled.entry_point(measure, numba.void(number_type(kind)[::1], numba.float64[:, ::1]), nogil=True)


def _named(task: Task) -> str:
    return f"{type(task).__name__} of {_named(task.task)}" if isinstance(task, AlteredTask) else task.name


def label(kind: Kind) -> str:
    """What is being compiled, in words."""
    many = " for many cars" if kind.length > 1 else ""
    blocks_of = f", {kind.dtype}, in blocks of {kind.length}" if many else ""
    own = ", each car with its own numbers" if kind.varied else ""
    return f"{_named(kind.task)}{many} with {kind.model}{blocks_of}{own}"


def kernels(kind: Kind, reward: Reward, step_of: Callable[[Kind, Reward], Any] = _step) -> Kernels:
    """Compile the functions of a combination, or load them from the cache on disk."""

    def measure(numbers: Any, out: Any) -> None:
        measuring(kind)(numbers, out)

    with announcements.progress(label(kind)):
        start, look = beginning(kind)
        return Kernels(step_of(kind, reward), start, look, measure)
