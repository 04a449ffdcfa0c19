"""Compiled functions of one car: a block of one row, whose step has an entry point of its own.

Handing over ten arrays and numbers takes as long as a fifth of a step: here are four.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

from bicycle_env.backends import announcements, compiled
from bicycle_env.envs.many import block_kernels, blocks
from bicycle_env.envs.many.block_kernels import BAD_ACTION
from bicycle_env.envs.many.blocks import Kind, shared_layout
from bicycle_env.envs.many.car_functions import car_functions
from bicycle_env.tasks.control_step import transition
from bicycle_env.tasks.rewards import Reward


class Kernels(NamedTuple):
    """The compiled functions of one combination; all but ``step`` are those of many cars."""

    start: Callable[..., None]
    look: Callable[..., None]
    step: Callable[[Any, Any, float, float], tuple[float, int, float, bool]]
    """``step(numbers, observation, front, rear) -> (reward, end, cost, success)``; front and rear are actions."""
    measure: Callable[..., None]


@functools.cache
def _step(kind: Kind, reward: Reward) -> Any:
    xp, access, car, place = kind.xp, blocks.access(kind), car_functions(kind), shared_layout(kind)
    step_law = xp.function(transition(xp, kind.task, kind.model, reward))
    keep_after = blocks.keeper(kind)
    size, times, entries, settle_at = place.whole, place.times, kind.entries, place.steps_to_settle

    def step(numbers: Any, observation: Any, front: float, rear: float) -> tuple[float, int, float, bool]:
        if not (np.isfinite(front) and np.isfinite(rear)):
            return 0.0, BAD_ACTION, 0.0, False
        shared_numbers, block = numbers[:size], numbers[size:]
        shared = access.shared(shared_numbers)
        front = min(max(front, -1.0), 1.0) * shared.rules.steers_front
        rear = min(max(rear, -1.0), 1.0) * shared.rules.steers_rear
        state, episode, gained, end, cost = step_law(
            access.state(block, 0), access.episode(block, 0), (front, rear), shared, int(shared.rules.substeps)
        )
        access.keep_state(block, 0, state)
        keep_after(block, 0, episode)
        values = car.observe(block, 0, shared)
        fixed = len(values)
        for j in range(fixed):
            per_scale, bound = access.scaling(shared_numbers, j)
            observation[j] = access.entry(values[j], block, 0, per_scale, bound, j)
        for j in range(fixed, entries):
            per_scale, bound = access.scaling(shared_numbers, j)
            ahead = car.preview(block, 0, shared, shared_numbers[times + j - fixed])
            observation[j] = access.entry(ahead, block, 0, per_scale, bound, j)
        return gained, end, cost, end == 0.0 and episode.settled_steps >= shared_numbers[settle_at]

    result = numba.types.Tuple((numba.float64, numba.int64, numba.float64, numba.boolean))
    row = numba.float64[::1]
    return compiled.entry_point(step, result(row, numba.float32[::1], numba.float64, numba.float64))


def kernels(kind: Kind, reward: Reward) -> Kernels:
    """Compiled functions, shared by all environments of the same combination in this process."""

    def measure(numbers: Any, out: Any) -> None:
        block_kernels.measuring(kind)(numbers, out)

    with announcements.progress(block_kernels.label(kind)):
        start, look = block_kernels.beginning(kind)
        return Kernels(start, look, _step(kind, reward), measure)
