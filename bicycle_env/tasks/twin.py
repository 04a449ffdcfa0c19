"""The same car with straight rear wheels, steered by the driver alone: it goes beside the car, in the task's state."""

from __future__ import annotations

from typing import Any

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.model import Model
from bicycle_env.physics.records import composed, record_of
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.task import Law

FIELDS = ("lateral_position", "heading", "lateral_velocity", "yaw_rate", "front_steer")
"""Of a CarState: where it is along the road matters to nobody."""
NAMES = tuple(f"twin_{name}" for name in FIELDS)
"""In the task's state."""
Twin = record_of("Twin", NAMES)


def placed(xp: Any) -> Law:
    """``placed(state) -> Twin``: at the car's own place."""
    return composed(xp, Twin, [f"state.{name}" for name in FIELDS], "state")  # type: ignore[no-any-return]


def advance(xp: Any, model: Model, until: float) -> Law:
    """``advance(state, episode, car, timestep, world) -> Twin``: a substep; its tires answer at once.

    `until`: s after the start, from which on only its front wheels go on turning.
    """
    substep = xp.function(rk4(xp, CarState, model.quasi_static.actuated_rates(xp, pushed=True)))

    def advance(state: CarState, episode: EpisodeState, car: CarParameters, timestep: Any, world: World) -> Any:
        own = episode.task_state
        zero = 0.0 * own.twin_heading
        now = CarState(
            zero,
            own.twin_lateral_position,
            own.twin_heading,
            own.twin_lateral_velocity,
            own.twin_yaw_rate,
            own.twin_front_steer,
            zero,
        )
        command = (own.driver_command, zero)
        then = substep(now, command, command, command, car, timestep)
        drives = episode.steps * world.rules.control_timestep < until
        return Twin(
            xp.where(drives, then.lateral_position, now.lateral_position),
            xp.where(drives, then.heading, now.heading),
            xp.where(drives, then.lateral_velocity, now.lateral_velocity),
            xp.where(drives, then.yaw_rate, now.yaw_rate),
            then.front_steer,
        )

    return advance
