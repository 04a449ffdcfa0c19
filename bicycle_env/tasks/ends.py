"""When an episode ends, when the car counts as settled, and the safety cost."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from bicycle_env.physics.car import CarState
from bicycle_env.physics.records import replaced
from bicycle_env.physics.validation import check_fields, explain_keywords, positive
from bicycle_env.tasks.episode import EpisodeState, Reference, World

Law = Callable[..., Any]

RUNNING, SPUN, LEFT, INVALID_ACTION = 0, 1, 2, 3
"""End codes. The last is not the car's doing: its action was not finite, where many cars may not stop for one."""


@dataclasses.dataclass(frozen=True)
class _AboveZero:
    """Fields are finite numbers > 0."""

    def __post_init__(self) -> None:
        check_fields(self, positive, **{field.name: () for field in dataclasses.fields(self)})


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Limits(_AboveZero):
    """Beyond them nobody drives on: the episode ends."""

    sideslip: float = 0.8
    """Of |V / U|, rad."""
    yaw_rate: float = 2.0
    """rad/s."""
    heading: float = 1.2
    """rad."""


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Tolerances(_AboveZero):
    """Within them the car runs straight at its goal."""

    lateral: float
    """Distance from the goal, m."""
    heading: float = 0.02
    """rad."""
    sideslip: float = 0.02
    """Of |V / U|, rad."""
    yaw_rate: float = 0.05
    """rad/s."""


def spun(xp: Any, limits: Limits) -> Law:
    """``spun(state, speed)``: whether nobody drives on."""
    sideslip, yaw_rate, heading = limits.sideslip, limits.yaw_rate, limits.heading

    def spun(state: CarState, speed: Any) -> Any:
        return (
            (abs(state.lateral_velocity) > sideslip * speed)
            | (abs(state.yaw_rate) > yaw_rate)
            | (abs(state.heading) > heading)
        )

    return spun


def end_code(xp: Any, limits: Limits) -> Law:
    """0 while running, 1 if the car has spun, 2 if its whole body has left the corridor."""
    has_spun = xp.function(spun(xp, limits))

    def end_code(state: CarState, reference: Reference, episode: EpisodeState, world: World) -> Any:
        edge = xp.multiply_add(0.5, world.car.body_width, reference.road_half_width)
        left = abs(state.lateral_position - reference.road_centre) > edge
        return xp.where(has_spun(state, world.car.speed), SPUN, xp.where(left, LEFT, RUNNING))

    return end_code


def end_outside(xp: Any, task: Any, most: float) -> Law:
    """As :func:`end_code`, but 2 if a point of the body that is judged is more than `most` m outside."""
    has_spun, clearance_of = xp.function(spun(xp, task.limits)), xp.function(clearance(xp, task))

    def end_outside(state: CarState, reference: Reference, episode: EpisodeState, world: World) -> Any:
        left = clearance_of(state, reference, episode, world) < -most
        return xp.where(has_spun(state, world.car.speed), SPUN, xp.where(left, LEFT, RUNNING))

    return end_outside


def settled(xp: Any, tolerances: Tolerances) -> Law:
    """True where the car runs straight at its goal, within all four tolerances."""
    lateral, heading = tolerances.lateral, tolerances.heading
    sideslip, yaw_rate = tolerances.sideslip, tolerances.yaw_rate

    def settled(state: CarState, reference: Reference, episode: EpisodeState, world: World) -> Any:
        return (
            (abs(state.lateral_position - reference.goal) < lateral)
            & (abs(state.heading) < heading)
            & (abs(state.lateral_velocity) < sideslip * world.car.speed)
            & (abs(state.yaw_rate) < yaw_rate)
        )

    return settled


def body_reach(xp: Any) -> Callable[[CarState, Reference, World], Any]:
    """From the corridor's middle to the corner of the body that is farthest from it, m."""

    def body_reach(state: CarState, reference: Reference, world: World) -> Any:
        car = world.car
        sine = xp.sin(state.heading)
        middle = state.lateral_position - reference.road_centre
        front = abs(xp.multiply_add(car.front_extent, sine, middle))
        rear = abs(xp.multiply_add(-car.rear_extent, sine, middle))
        return xp.multiply_add(0.5 * car.body_width, abs(xp.cos(state.heading)), xp.maximum(front, rear))

    return body_reach


def clearance(xp: Any, task: Any) -> Law:
    """``clearance(state, reference, episode, world)``: from the corridor's edge to the nearest corner, < 0 outside, m.

    Where the corridor is not the same beside the whole body, each of the task's ``judged_points`` is judged, along
    both sides, at its own place on the road.
    """
    if task.uniform_corridor:
        reach_of = xp.function(body_reach(xp))

        def clearance(state: CarState, reference: Reference, episode: EpisodeState, world: World) -> Any:
            return reference.road_half_width - reach_of(state, reference, world)

        return clearance
    point_of, last = xp.function(_point(xp, task)), task.judged_points - 1
    least_of = xp.function(_pair(xp, point_of, 0.0))
    for k in range(1, last + 1):
        pair_of = xp.function(_pair(xp, point_of, k / last))
        least_of = xp.function(_least(xp, least_of, pair_of))

    def clearance_of_points(state: CarState, reference: Reference, episode: EpisodeState, world: World) -> Any:
        return least_of(state, episode, world, xp.sin(state.heading), xp.cos(state.heading))

    return clearance_of_points


def _point(xp: Any, task: Any) -> Law:
    """``point(state, episode, world, sine, cosine, forward, left)``: a point of the body, from the centre of mass."""
    reference_law = xp.function(task.reference(xp))
    moved = replaced(xp, CarState, ("longitudinal_position",))

    def point(
        state: CarState, episode: EpisodeState, world: World, sine: Any, cosine: Any, forward: Any, left: Any
    ) -> Any:
        along = state.longitudinal_position + xp.multiply_add(forward, cosine, -(left * sine))
        across = state.lateral_position + xp.multiply_add(forward, sine, left * cosine)
        there = reference_law(moved(state, along), episode.task_state, world)
        return there.road_half_width - abs(across - there.road_centre)

    return point


def _pair(xp: Any, point_of: Law, share: float) -> Law:
    """``pair(state, episode, world, sine, cosine)``: of a left and a right point, `share` of the way to the rear."""
    rest = 1.0 - share

    def pair(state: CarState, episode: EpisodeState, world: World, sine: Any, cosine: Any) -> Any:
        car, half = world.car, 0.5 * world.car.body_width
        forward = rest * car.front_extent - share * car.rear_extent
        left = point_of(state, episode, world, sine, cosine, forward, half)
        return xp.minimum(left, point_of(state, episode, world, sine, cosine, forward, -half))

    return pair


def _least(xp: Any, first: Law, second: Law) -> Law:
    def least(state: CarState, episode: EpisodeState, world: World, sine: Any, cosine: Any) -> Any:
        return xp.minimum(first(state, episode, world, sine, cosine), second(state, episode, world, sine, cosine))

    return least


def corner_outside(xp: Any, task: Any) -> Law:
    """``corner_outside(state, reference, episode, world)``: 1.0 where a corner of the body is outside, else 0.0."""
    clearance_of = xp.function(clearance(xp, task))

    def corner_outside(state: CarState, reference: Reference, episode: EpisodeState, world: World) -> Any:
        clear = clearance_of(state, reference, episode, world)
        return xp.where(clear < 0.0, 1.0 + 0.0 * clear, 0.0)

    return corner_outside
