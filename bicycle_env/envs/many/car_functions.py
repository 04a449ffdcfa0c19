"""Inlined functions on one car of a block: what begins an episode, how it looks, whether it is over."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

from bicycle_env.backends.compiled_random import next_double
from bicycle_env.envs.many import blocks
from bicycle_env.envs.many.blocks import Kind, layout, shared_layout


class CarFunctions(NamedTuple):
    """Inlined functions on car k of a block: what begins an episode and how it looks."""

    begin: Any
    """``begin(block, k, shared, drawn, generator)``: a random start; `drawn` is room for its uniform numbers."""
    cost: Any
    """``cost(block, k, shared)``."""
    is_over: Any
    """``is_over(block, k, step_limit)``."""
    observe: Any
    """``observe(block, k, shared) -> tuple``: the values of the observation that are not a preview."""
    preview: Any
    """``preview(block, k, shared, time)``: the value for a time ahead."""
    show: Any
    """``show(block, k, shared, numbers, observation)``: writes the observation; `numbers`: what all rows share."""


@functools.cache
def car_functions(kind: Kind) -> CarFunctions:
    xp, access, at = kind.xp, blocks.access(kind), layout(kind)
    task = kind.task
    uniforms, end_column = task.uniforms, at.end * kind.length
    start_law, reference = xp.function(task.start(xp)), xp.function(task.reference(xp))
    complete = xp.function(kind.model.complete(xp))
    outside = xp.function(task.cost(xp))
    observe_law, preview_law = xp.function(task.observe(xp)), xp.function(task.preview(xp))

    def begin(block: Any, k: Any, shared: Any, drawn: Any, generator: Any) -> None:
        for j in range(uniforms):
            drawn[j] = next_double(generator)
        mine = access.world(block, k, shared)
        state, task_state = start_law(drawn, mine)
        access.keep_state(block, k, complete(state, mine.car))
        access.keep_episode(block, k, (0.0, 0.0, 0.0, 0.0))
        access.keep_task_state(block, k, task_state)
        block[k + end_column] = 0.0

    def cost(block: Any, k: Any, shared: Any) -> Any:
        mine, state, episode = access.world(block, k, shared), access.state(block, k), access.episode(block, k)
        return outside(state, reference(state, episode.task_state, mine), episode, mine)

    def is_over(block: Any, k: Any, step_limit: Any) -> Any:
        return (block[k + end_column] > 0.0) | (access.episode(block, k).steps >= step_limit)

    def observe(block: Any, k: Any, shared: Any) -> Any:
        return observe_law(access.state(block, k), access.episode(block, k), access.world(block, k, shared))

    def preview(block: Any, k: Any, shared: Any, time: Any) -> Any:
        return preview_law(access.state(block, k), access.task_state(block, k), access.world(block, k, shared), time)

    def show(block: Any, k: Any, shared: Any, numbers: Any, observation: Any) -> None:
        values = seen(block, k, shared)
        fixed = len(values)
        for j in range(fixed):
            per_scale, bound = access.scaling(numbers, j)
            observation[j] = access.entry(values[j], block, k, per_scale, bound, j)
        for j in range(fixed, entries):
            per_scale, bound = access.scaling(numbers, j)
            value = ahead(block, k, shared, numbers[times + j - fixed])
            observation[j] = access.entry(value, block, k, per_scale, bound, j)

    seen, ahead = xp.function(observe), xp.function(preview)
    entries, times = kind.entries, shared_layout(kind).times
    return CarFunctions(*map(xp.function, (begin, cost, is_over, seen, ahead, show)))
