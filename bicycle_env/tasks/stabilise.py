"""The stabilisation task: catch a car that has begun to spin, and bring it back to straight running in its lane."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarState
from bicycle_env.tasks import rewards
from bicycle_env.tasks.ends import Tolerances
from bicycle_env.tasks.episode import EpisodeState, Reference, World
from bicycle_env.tasks.task import Entry, Task, fixed_entries, observed_car


class Nothing(NamedTuple):
    """The task draws nothing beside the car's state."""


class StartBox(NamedTuple):
    """Half-widths of the uniform start."""

    lateral_position: Any
    course: Any
    sideslip: Any
    yaw_rate: Any


@dataclasses.dataclass(frozen=True)
class Stabilise(Task):
    """The car still travels along its lane (its course is small) but its body is turned and turning.

    Lateral position, course (heading + sideslip), sideslip and yaw rate are uniform in a box; the heading follows.
    """

    name = "stabilise"
    episode_steps = 400
    TaskState = Nothing
    Settings = StartBox
    uniforms = 4
    ends = ("spun", "left_lane")
    road_half_width = 1.75
    tolerances = Tolerances(lateral=0.5)
    rewards = {  # noqa: RUF012 (a constant)
        "default": rewards.Bounded(
            lateral_weight=1.0,
            heading_weight=20.0,
            sideslip_weight=20.0,
            yaw_rate_weight=2.0,
            effort_weight=0.2,
            smoothness_weight=0.2,
        ),
        "quadratic": rewards.Quadratic(lateral_cost=0.25, heading_cost=10.0, yaw_rate_cost=4.0),
    }
    levels = {  # noqa: RUF012 (a constant)
        "easy": {"speed_ratio": 1.05},
        "medium": {},
        "hard": {
            "speed_ratio": 1.5,
            "front_actuator": dataclasses.replace(FRONT, rate_limit=math.radians(15.0)),
            "rear_actuator": dataclasses.replace(REAR, rate_limit=math.radians(5.0)),
        },
    }

    def settings(self, speed: float) -> StartBox:
        return StartBox(lateral_position=0.3, course=0.01, sideslip=0.3, yaw_rate=0.8)

    def start(self, xp: Any) -> Any:
        def start(uniforms: Any, world: World) -> tuple[CarState, Nothing]:
            box = world.settings
            lateral_position = box.lateral_position * (2.0 * uniforms[0] - 1.0)
            course = box.course * (2.0 * uniforms[1] - 1.0)
            sideslip = box.sideslip * (2.0 * uniforms[2] - 1.0)
            yaw_rate = box.yaw_rate * (2.0 * uniforms[3] - 1.0)
            zero = 0.0 * uniforms[0]
            state = CarState(
                zero, lateral_position, course - sideslip, sideslip * world.car.speed, yaw_rate, zero, zero
            )
            return state, Nothing()

        return start

    def reference(self, xp: Any) -> Any:
        half_width = float(self.road_half_width)

        def reference(state: CarState, task_state: Nothing, world: World) -> Reference:
            zero = 0.0 * state.lateral_position
            return Reference(zero, zero, zero, zero, half_width)

        return reference

    def observe(self, xp: Any) -> Any:
        car = xp.function(observed_car(xp))

        def observe(state: CarState, episode: EpisodeState, world: World) -> Any:
            return car(state, episode)

        return observe

    def entries(self, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
        return fixed_entries(speed, front_limit, rear_limit)
