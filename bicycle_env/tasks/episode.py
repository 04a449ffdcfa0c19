"""What the laws of a task are functions of: what an episode remembers, its reference, and what stays the same."""

from __future__ import annotations

from typing import Any, NamedTuple

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.records import record_of


class EpisodeState(NamedTuple):
    """What an episode remembers beside the car's state."""

    front_steer_command: Any
    """Last command to the front actuator, rad."""
    rear_steer_command: Any
    """Last command to the rear actuator, rad."""
    steps: Any
    """Control steps since the start."""
    settled_steps: Any
    """Consecutive control steps, up to now, in which the car was within all tolerances."""
    task_state: Any
    """The task's own named tuple: drawn at the start, and what its law ``remember`` makes of it."""


COMMANDS = ("front_steer_command", "rear_steer_command")


def state_record(name: str, task_state: Any) -> Any:
    """The class of ``env.unwrapped.state`` of a task whose own state is of the class `task_state`; SI units."""
    return record_of(name, (*CarState._fields, *COMMANDS, "time", *task_state._fields))


class Reference(NamedTuple):
    """Where the car should be at its present place on the road."""

    lateral_position: Any
    """m."""
    heading: Any
    """rad."""
    goal: Any
    """Lateral position at which the task is done, m."""
    road_centre: Any
    """Middle of the corridor that must not be left, m."""
    road_half_width: Any
    """From there to its right and left edge, m."""


class Rules(NamedTuple):
    """What the environment decides."""

    control_timestep: Any
    """s."""
    substeps: Any
    horizon: Any
    """Control steps up to which a failure pays, where the reward says so."""
    steers_front: Any
    """1 where the action steers the front axle, else 0."""
    steers_rear: Any


class World(NamedTuple):
    """All that stays the same during an episode."""

    car: CarParameters
    rules: Rules
    settings: Any
    """The task's own numbers, a named tuple."""
