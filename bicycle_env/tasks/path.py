"""What tasks with a path to follow share: its observation, with a preview, and a smooth rise to build paths of."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.validation import check_fields, positive
from bicycle_env.tasks.checking import CONTROL_TIMESTEP, SPEED, world_of
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.task import Entry, Law, Task, fixed_entries, observed_car

SIDES = {"left": 1.0, "right": -1.0}
"""What the reset option of a side may be."""
DIRECTIONS = {**SIDES, "random": 0.0}
"""What the keyword of a side may be."""
PREVIEW_POINTS_LIMIT = 500


def quintic_rise(xp: Any) -> Any:
    """``(rise, its derivative)`` of 10 s^3 - 15 s^4 + 6 s^5: from 0 to 1 while s does, flat before and after."""

    def quintic_rise(s: Any) -> tuple[Any, Any]:
        s = xp.minimum(xp.maximum(s, 0.0), 1.0)
        rest = 1.0 - s
        return (
            s * s * s * xp.multiply_add(-s, xp.multiply_add(-6.0, s, 15.0), 10.0),
            30.0 * s * s * (rest * rest),
        )

    return quintic_rise


def chosen_side(xp: Any) -> Law:
    """``chosen_side(uniform, direction)``: +1 or -1; a direction of 0 leaves it to the uniform number."""

    def chosen_side(uniform: Any, direction: Any) -> Any:
        zero = 0.0 * uniform
        return xp.where(direction == 0.0, xp.where(uniform < 0.5, -1.0 + zero, 1.0), direction + zero)

    return chosen_side


def check_preview(task: Any) -> None:
    """The two keywords of a preview; ValueError or TypeError names a bad one."""
    check_fields(task, preview_length=(0.0,))
    check_fields(task, positive, preview_spacing=())
    points = task.preview_length / task.preview_spacing + 1e-9
    if points >= PREVIEW_POINTS_LIMIT + 1:
        raise ValueError(f"preview_length / preview_spacing must be <= {PREVIEW_POINTS_LIMIT}, got {points:g}")


def times_ahead(length: float, spacing: float) -> tuple[float, ...]:
    """The look-ahead times of a preview, s."""
    return tuple(spacing * (k + 1) for k in range(int(length / spacing + 1e-9)))


def observed_on_path(xp: Any, task: Task) -> Law:
    """``observe``: the car and its errors against the task's reference."""
    car = xp.function(observed_car(xp))
    reference_law = xp.function(task.reference(xp))

    def observe(state: CarState, episode: EpisodeState, world: World) -> tuple[Any, ...]:
        reference = reference_law(state, episode.task_state, world)
        seen: tuple[Any, ...] = car(state, episode)
        errors = (state.lateral_position - reference.lateral_position, state.heading - reference.heading)
        return seen + errors

    return observe


def path_ahead(xp: Any, path: Law) -> Law:
    """``preview``, from ``path(longitudinal_position, task_state, world) -> (lateral position, slope)``."""
    path = xp.function(path)

    def preview(state: CarState, task_state: Any, world: World, time: Any) -> Any:
        place = xp.multiply_add(world.car.speed, time, state.longitudinal_position)
        ahead, _ = path(place, task_state, world)
        return ahead - state.lateral_position

    return preview


@functools.cache
def follows_path(task: Task) -> bool:
    """Whether the task has a preview, or a reference that turns: controllers then need the error against it."""
    places = np.linspace(0.0, SPEED * CONTROL_TIMESTEP * task.episode_steps, 500)
    zero, world = 0.0 * places, world_of(task)
    _, drawn = task.start(NUMPY)(np.full((task.uniforms, len(places)), 0.5), world)
    reference = task.reference(NUMPY)(CarState(places, *(zero,) * 6), drawn, world)
    return bool(task.preview_times or np.any(reference.heading))


def path_entries(task: Task, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
    """``entries``: the car, both errors and the preview."""
    return (
        *fixed_entries(speed, front_limit, rear_limit),
        Entry("lateral_error", "m", 1.0, 10.0, "lateral position minus the path's"),
        Entry("heading_error", "rad", 0.2, 10.0, "heading minus the path's"),
        *(
            Entry(f"preview_{time:g}s", "m", 1.0, 10.0, f"path {time:g} s ahead minus lateral position")
            for time in task.preview_times
        ),
    )
