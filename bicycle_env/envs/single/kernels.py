"""The step of one car, a block of one row: it has an entry point of its own.

Handing over ten arrays and numbers takes as long as a fifth of a step: here are four.
"""

from __future__ import annotations

import functools
from typing import Any

import numba
import numpy as np

from bicycle_env.backends import compiled
from bicycle_env.envs.many import blocks
from bicycle_env.envs.many.block_kernels import BAD_ACTION
from bicycle_env.envs.many.blocks import Kind, shared_layout
from bicycle_env.envs.many.car_functions import car_functions
from bicycle_env.tasks.control_step import transition
from bicycle_env.tasks.rewards import Reward


@functools.cache
def step_of_one(kind: Kind, reward: Reward) -> Any:
    """``step(numbers, observation, front, rear) -> (reward, end, cost, success)``; front and rear are actions."""
    xp, access, car = kind.xp, blocks.access(kind), car_functions(kind)
    step_law = xp.function(transition(xp, kind.task, kind.model, reward))
    keep_after = blocks.keeper(kind)
    size, settle_at = shared_layout(kind).whole, shared_layout(kind).steps_to_settle

    def step(numbers: Any, observation: Any, front: float, rear: float) -> tuple[float, int, float, bool]:
        if not (np.isfinite(front) and np.isfinite(rear)):
            return 0.0, BAD_ACTION, 0.0, False
        shared_numbers, block, row = numbers[:size], numbers[size:], np.int64(0)  # a literal 0 compiles the laws again
        shared = access.shared(shared_numbers)
        front = min(max(front, -1.0), 1.0) * shared.rules.steers_front
        rear = min(max(rear, -1.0), 1.0) * shared.rules.steers_rear
        state, episode, gained, end, cost = step_law(
            access.state(block, row), access.episode(block, row), (front, rear), shared, int(shared.rules.substeps)
        )
        access.keep_state(block, row, state)
        keep_after(block, row, episode)
        car.show(block, row, shared, shared_numbers, observation)
        return gained, end, cost, end == 0.0 and episode.settled_steps >= shared_numbers[settle_at]

    result = numba.types.Tuple((numba.float64, numba.int64, numba.float64, numba.boolean))
    row = numba.float64[::1]
    return compiled.entry_point(step, result(row, numba.float32[::1], numba.float64, numba.float64))
