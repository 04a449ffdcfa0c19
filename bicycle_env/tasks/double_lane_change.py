"""The double-lane-change task: between cones into the next lane and back, after ISO 3888-1 and ISO 3888-2."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.validation import check_fields, choice
from bicycle_env.tasks.ends import Tolerances, end_outside
from bicycle_env.tasks.episode import EpisodeState, Reference, World
from bicycle_env.tasks.lane_change import LaneChange
from bicycle_env.tasks.marks import Mark
from bicycle_env.tasks.metrics import SHARED, Metric, largest, least
from bicycle_env.tasks.path import (
    DIRECTIONS,
    SIDES,
    check_preview,
    chosen_side,
    observed_on_path,
    path_ahead,
    path_entries,
    quintic_rise,
    times_ahead,
)
from bicycle_env.tasks.task import Entry, Law, Task

APPROACH = 1.0
"""s of free road before the first cones."""
CONES = 5
"""Drawn along each side of a lane; what is judged is the line through them."""


class Course(NamedTuple):
    """A course after one part of the standard, driven to the left; m."""

    lengths: tuple[float, ...]
    """Of the sections 1, 2, ...; the last lane is section 5 and what follows it."""
    widths: tuple[float, ...]
    """k and c of the lanes 1, 3 and 5: a lane is k times the body's width + c wide."""
    least_5: float
    """What lane 5 is at least wide."""
    offset: float
    """From an edge of lane 1 to the right edge of lane 3."""
    from_left: float
    """1 where that is the left edge of lane 1, 0 where it is the right one."""
    leads: tuple[float, float, float, float]
    """How far the path's two changes reach into the lanes 1, 3, 3 and 5: as gentle as a body on the path can have it
    that keeps 0.1 m from the cones."""
    speed: float
    """The default, m/s."""


COURSES = {
    "iso3888-1": Course(
        lengths=(15.0, 30.0, 25.0, 25.0, 15.0, 15.0),
        widths=(1.1, 0.25, 1.2, 0.25, 1.3, 0.25),
        least_5=0.0,
        offset=3.5,
        from_left=0.0,
        leads=(7.5, 9.5, 9.0, 10.5),
        speed=80.0 / 3.6,
    ),
    "iso3888-2": Course(
        lengths=(12.0, 13.5, 11.0, 12.5, 12.0),
        widths=(1.1, 0.25, 1.0, 1.0, 1.3, 0.25),
        least_5=3.0,
        offset=1.0,
        from_left=1.0,
        leads=(4.5, 6.5, 4.5, 7.0),
        speed=15.0,
    ),
}


class Side(NamedTuple):
    """Where the second lane lies in this episode."""

    direction: Any
    """+1 to the left, -1 to the right."""


class Cones(NamedTuple):
    """The task's numbers: m, along the road from where the car starts."""

    direction: Any
    """+1, -1, or 0 for random."""
    begin_1: Any
    end_1: Any
    begin_3: Any
    end_3: Any
    begin_5: Any
    end_5: Any
    change_begin: Any
    change_length: Any
    return_begin: Any
    return_length: Any
    per_width_1: Any
    more_1: Any
    per_width_3: Any
    more_3: Any
    per_width_5: Any
    more_5: Any
    least_5: Any
    offset: Any
    from_left: Any
    lateral_start: Any
    """Half-width of the uniform lateral start."""
    heading_start: Any
    """Half-width of the uniform start of the heading, rad."""


@dataclasses.dataclass(frozen=True)
class DoubleLaneChange(Task):
    """Through the cones of three lanes, the second one beside the others; see BicycleDoubleLaneChange-v0."""

    name = "double_lane_change"
    episode_steps = 400
    TaskState = Side
    Settings = Cones
    uniforms = 3
    ends = ("spun", "left_course")
    tolerances = Tolerances(lateral=0.3)
    road_half_width = 6.0
    rewards = LaneChange.rewards
    defaults = {"vehicle": "understeer"}  # noqa: RUF012 (a constant)
    levels = {  # noqa: RUF012 (a constant)
        "easy": {"speed": 20.0},
        "medium": {},
        "hard": {"speed": 28.0, "randomise": {"friction": (0.6, 1.0)}, "action_delay": 3},
    }
    settled_seconds = 0.0  # to have passed the cones is enough
    uniform_corridor = False
    flipped = ("direction",)
    options = {"direction": SIDES}  # noqa: RUF012 (a constant)

    course: str = "iso3888-1"
    direction: str = "random"
    preview_length: float = 1.2
    """s."""
    preview_spacing: float = 0.1
    """s."""

    def __post_init__(self) -> None:
        check_fields(self, choice, course=(COURSES,), direction=(DIRECTIONS,))
        check_preview(self)

    @property
    def usual_speed(self) -> float:
        return COURSES[self.course].speed

    @property
    def preview_times(self) -> tuple[float, ...]:
        return times_ahead(self.preview_length, self.preview_spacing)

    @property
    def metrics(self) -> tuple[Metric, ...]:
        return (
            *SHARED,
            Metric(
                "least_clearance",
                "m",
                "from the nearest cone, or the edge between the sections, to the nearest corner; < 0: beyond it",
                least("clearance"),
            ),
            Metric("peak_yaw_rate", "rad/s", "largest |yaw rate|", largest("yaw_rate")),
        )

    def settings(self, speed: float) -> Cones:
        course = COURSES[self.course]
        places = [speed * APPROACH]
        for length in (*course.lengths[:4], sum(course.lengths[4:])):
            places.append(places[-1] + length)
        _, end_1, begin_3, end_3, begin_5, _ = places
        into_1, into_3, out_of_3, into_5 = course.leads
        change = (end_1 - into_1, begin_3 - end_1 + into_1 + into_3)
        back = (end_3 - out_of_3, begin_5 - end_3 + out_of_3 + into_5)
        widths = (*course.widths, course.least_5)
        start = (0.1, 0.01)
        return Cones._make(
            (DIRECTIONS[self.direction], *places, *change, *back, *widths, course.offset, course.from_left, *start)
        )

    def seconds_to_pass(self, car: CarParameters) -> float:
        """Until a car that runs straight along the road has its whole body behind the last cones."""
        return float((self.settings(car.speed).end_5 + car.rear_extent) / car.speed)

    def start(self, xp: Any) -> Law:
        chosen = xp.function(chosen_side(xp))

        def start(uniforms: Any, world: World) -> tuple[CarState, Side]:
            cones = world.settings
            zero = 0.0 * uniforms[0]
            lateral_position = cones.lateral_start * (2.0 * uniforms[0] - 1.0)
            heading = cones.heading_start * (2.0 * uniforms[1] - 1.0)
            direction = chosen(uniforms[2], cones.direction)
            return CarState(zero, lateral_position, heading, zero, zero, zero, zero), Side(direction)

        return start

    def reference(self, xp: Any) -> Law:
        lanes_of, path_of = xp.function(lanes(xp)), xp.function(path(xp))
        between = float(self.road_half_width)

        def reference(state: CarState, side: Side, world: World) -> Reference:
            x, cones = state.longitudinal_position, world.settings
            lateral_position, slope = path_of(x, side, world)
            half_1, centre_3, half_3, centre_5, half_5 = lanes_of(world)
            zero = 0.0 * x
            in_1 = (x >= cones.begin_1) & (x <= cones.end_1)
            in_3 = (x >= cones.begin_3) & (x <= cones.end_3)
            in_5 = (x >= cones.begin_5) & (x <= cones.end_5)
            centre = xp.where(in_5, centre_5 + zero, 0.5 * centre_3 + zero)
            centre = xp.where(in_1, zero, xp.where(in_3, centre_3 + zero, centre))
            half = xp.where(in_3, half_3 + zero, xp.where(in_5, half_5 + zero, between + zero))
            half = xp.where(in_1, half_1 + zero, half)
            goal = side.direction * centre_5
            return Reference(lateral_position, xp.atan(slope), goal, side.direction * centre, half)

        return reference

    def observe(self, xp: Any) -> Law:
        return observed_on_path(xp, self)

    def preview(self, xp: Any) -> Law:
        return path_ahead(xp, path(xp))

    def entries(self, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
        return path_entries(self, speed, front_limit, rear_limit)

    def end(self, xp: Any) -> Law:
        return end_outside(xp, self, 0.0)

    def success(self, xp: Any) -> Law:
        def success(state: CarState, reference: Reference, episode: EpisodeState, world: World) -> Any:
            car, half = world.car, 0.5 * world.car.body_width
            sine, cosine = xp.sin(state.heading), xp.cos(state.heading)
            rearmost = xp.multiply_add(-car.rear_extent, cosine, state.longitudinal_position) - half * abs(sine)
            return rearmost > world.settings.end_5

        return success

    def marks(self, side: Any, world: World) -> tuple[Mark, ...]:
        """Cones along both sides of the lanes."""
        cones, (half_1, centre_3, half_3, centre_5, half_5) = world.settings, lanes(PYTHON)(world)
        rows = (
            (cones.begin_1, cones.end_1, 0.0, half_1),
            (cones.begin_3, cones.end_3, centre_3, half_3),
            (cones.begin_5, cones.end_5, centre_5, half_5),
        )
        places = [
            (float(x), float(side.direction * (centre + edge)))
            for begin, end, centre, half in rows
            for edge in (half, -half)
            for x in np.linspace(begin, end, CONES)
        ]
        return (Mark("cones", tuple(places)),)


def lanes(xp: Any) -> Law:
    """``lanes(world) -> (half width of 1, middle and half width of 3, of 5)``, m, driven to the left."""

    def lanes(world: World) -> tuple[Any, Any, Any, Any, Any]:
        cones, body = world.settings, world.car.body_width
        width_1 = xp.multiply_add(cones.per_width_1, body, cones.more_1)
        width_3 = xp.multiply_add(cones.per_width_3, body, cones.more_3)
        width_5 = xp.maximum(xp.multiply_add(cones.per_width_5, body, cones.more_5), cones.least_5)
        right_1 = -0.5 * width_1  # the right edge of lane 5, too
        right_3 = xp.multiply_add(cones.from_left, width_1, right_1) + cones.offset
        return (
            0.5 * width_1,
            xp.multiply_add(0.5, width_3, right_3),
            0.5 * width_3,
            xp.multiply_add(0.5, width_5, right_1),
            0.5 * width_5,
        )

    return lanes


def path(xp: Any) -> Law:
    """``path(longitudinal_position, side, world) -> (lateral position [m], slope dy/dx)`` of the reference path."""
    lanes_of, rise_of = xp.function(lanes(xp)), xp.function(quintic_rise(xp))

    def path(x: Any, side: Side, world: World) -> tuple[Any, Any]:
        cones = world.settings
        _, centre_3, _, centre_5, _ = lanes_of(world)
        over, slope_over = rise_of((x - cones.change_begin) / cones.change_length)
        back, slope_back = rise_of((x - cones.return_begin) / cones.return_length)
        way_back = centre_5 - centre_3
        y = xp.multiply_add(way_back, back, centre_3 * over)
        slope = centre_3 * slope_over / cones.change_length + way_back * slope_back / cones.return_length
        return side.direction * y, side.direction * slope

    return path
