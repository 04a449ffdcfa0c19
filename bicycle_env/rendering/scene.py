"""What is to be seen, as pure geometry: no pygame here, and no pixels.

Points are (x, y) on the road in m, x along the road, y to the LEFT; angles in rad, forces in N. Nothing is exaggerated:
the car, its wheels and their steer angles are to scale. A mirrored state gives the mirrored scene, to the bit.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import NUMPY, PYTHON
from bicycle_env.physics.lateral import path_rates
from bicycle_env.physics.vehicle import Vehicle
from bicycle_env.rendering.corridor import Corridor, Point, Shape, corridor
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.marks import checked
from bicycle_env.tasks.task import Task

BEHIND = 0.30
"""Part of the picture's width that lies behind the car."""
AREA = 12.0
"""A corridor wider to each side than this, m, is an area: the picture shows so much of it on both sides of the car."""
GRIP_ARROW = 2.4
"""Length of a force arrow at friction x static axle load, m."""
LONGEST_ARROW = 2.0
"""Where a force arrow stops growing, as a multiple of GRIP_ARROW: the linear tire has no limit."""
SATURATED = 0.95
"""An axle counts as saturated from this part of friction x static axle load on."""
COURSE_ARROW = 2.2
"""How far the arrow of the direction of travel reaches beyond the front of the car, m."""
GUST_ARROW, LONGEST_GUST = 1.5e-3, 4.0
"""Length of a gust's arrow, m per N, and at most, m."""
TUFT, TUFT_PERIOD = (0.8, 0.12), 6.0
"""Of the marks on an area, which show that the car moves: length and width, and from one to the next, m."""
TIRE_LENGTH, TIRE_WIDTH = 0.66, 0.22
LINE_WIDTH = 0.15
DASH, DASH_PERIOD = 3.0, 9.0
STRIPE, POST_PERIOD, POST_LENGTH = 5.0, 10.0, 0.4
WIDENINGS = 4
"""How often a picture is widened, to hold the corridor that has come in sight with the last time."""
POST = (0.5, 0.7)
"""m beyond the edges."""
PATH_SPACING = 0.5
PATH_DASH = 3
"""Samples of PATH_SPACING in a dash of the path, and in a gap."""

# Half outlines in the body frame: (part of the way from the centre of mass to the front (+) or rear (-) end, part of
# the half body width).
_BODY = ((1.0, 0.36), (0.96, 0.68), (0.84, 0.90), (0.6, 1.0), (-0.80, 1.0), (-0.95, 0.94), (-1.0, 0.80))
_WINDSCREEN = ((0.40, 0.40), (0.34, 0.70), (0.28, 0.84), (0.02, 0.66))
_REAR_WINDOW = ((-0.56, 0.62), (-0.68, 0.70))
_HEADLIGHT = ((0.98, 0.44), (0.945, 0.70), (0.86, 0.74), (0.89, 0.42))
_TAILLIGHT = ((-0.985, 0.45), (-0.965, 0.80), (-0.91, 0.82), (-0.93, 0.45))


class Setup(NamedTuple):
    """What stays the same from picture to picture: one car at one speed on one road."""

    vehicle: Vehicle
    geometry: str
    task: Task
    world: World
    front_grip: float
    """Friction x static load of the front axle, N."""
    rear_grip: float
    aspect: float
    """Width / height of the picture of the road."""


class Arrow(NamedTuple):
    """From start to end; saturated arrows are painted in another colour."""

    start: Point
    end: Point
    saturated: bool = False


class Scene(NamedTuple):
    """All shapes of one moment, in m."""

    left: float
    """x at the left border of the picture."""
    right: float
    middle: float
    """y of the middle of the picture: of all of the corridor that is in sight."""
    half_height: float
    """From the middle to the upper border of the picture."""
    verge_stripes: tuple[Shape, ...]
    posts: tuple[Shape, ...]
    corridor: Shape
    target_lane: Shape
    """Empty unless the task is to change lanes."""
    road_edges: tuple[Shape, ...]
    lane_dashes: tuple[Shape, ...]
    tufts: tuple[Shape, ...]
    """On an area, which has no edges in sight."""
    ice: tuple[Shape, ...]
    obstacles: tuple[Shape, ...]
    cones: Shape
    """Those that stand."""
    struck: Shape
    """Those that the body has touched."""
    path_dashes: tuple[Shape, ...]
    """Open polylines along the reference path."""
    trail: Shape
    body: Shape
    outside: Shape
    """Of the points of the body that are judged, those outside of the corridor."""
    windscreen: Shape
    rear_window: Shape
    headlights: tuple[Shape, Shape]
    """Left, right."""
    taillights: tuple[Shape, Shape]
    wheels: dict[str, Shape]
    """By "front_left", "front_right", "rear_left", "rear_right"."""
    front_force: Arrow
    rear_force: Arrow
    travel: Arrow
    """From the centre of mass, in the direction in which it moves."""
    gust: Arrow
    """To the side of the body; without length where no wind blows."""
    centre_of_mass: Point


def build_scene(
    setup: Setup, state: Any, measured: dict[str, float], trail: Iterable[Point] = (), struck: Iterable[Point] = ()
) -> Scene:
    """The scene of one moment.

    Args:
        setup: what stays the same.
        state: ``env.unwrapped.state``, SI.
        measured: ``env.unwrapped.measure()``, SI.
        trail: earlier places of the centre of mass, oldest first, m.
        struck: cones that were hit before.
    """
    vehicle = setup.vehicle
    x, y = state.longitudinal_position, state.lateral_position
    road, left, right, middle, edge, half_height = _view(setup, state, measured)
    width = right - left
    goal = measured["reference_goal"]
    # Two lanes where the goal is the middle of one half.
    changes_lane = road.is_straight and abs(abs(goal - middle) - 0.5 * edge) < 1e-9 * edge
    side = 1.0 if goal > middle else -1.0
    frame = _Frame(x, y, state.heading)
    front = (vehicle.cg_to_front, vehicle.front_half_track, state.front_steer)
    rear = (-vehicle.cg_to_rear, vehicle.rear_half_track, state.rear_steer)

    marks = checked(setup.task.marks(task_state(setup.task, state), setup.world))
    cones = [point for mark in marks if mark.kind == "cones" for point in mark.points]
    hit = {*struck, *(cone for cone in cones if _touches(frame, vehicle, cone))}
    return Scene(
        left=left,
        right=right,
        middle=middle,
        half_height=half_height,
        verge_stripes=tuple(
            rectangle(begin, begin + STRIPE, middle - half_height, middle + half_height)
            for begin in _anchored(left, right, 2.0 * STRIPE, STRIPE)
        ),
        posts=tuple(post for begin in _anchored(left, right, POST_PERIOD, POST_LENGTH) for post in _posts(road, begin)),
        corridor=road.outline,
        target_lane=rectangle(left, right, middle, middle + side * edge) if changes_lane else (),
        road_edges=road.lines(LINE_WIDTH),
        lane_dashes=tuple(
            rectangle(begin, begin + DASH, middle - 0.5 * LINE_WIDTH, middle + 0.5 * LINE_WIDTH)
            for begin in _anchored(left, right, DASH_PERIOD, DASH)
        )
        if changes_lane
        else (),
        tufts=_tufts(left, right, middle, half_height) if measured["reference_road_half_width"] > AREA else (),
        ice=tuple(mark.points for mark in marks if mark.kind == "ice"),
        obstacles=tuple(mark.points for mark in marks if mark.kind == "obstacle"),
        cones=tuple(cone for cone in cones if cone not in hit),
        struck=tuple(cone for cone in cones if cone in hit),
        path_dashes=_path(setup, state, left, right),
        trail=tuple(point for point in trail if left - width <= point[0] <= right + width),
        body=frame.closed(_scaled(_BODY, vehicle)),
        outside=_outside(setup, state, frame),
        windscreen=frame.closed(_scaled(_WINDSCREEN, vehicle)),
        rear_window=frame.closed(_scaled(_REAR_WINDOW, vehicle)),
        headlights=frame.pair(_scaled(_HEADLIGHT, vehicle)),
        taillights=frame.pair(_scaled(_TAILLIGHT, vehicle)),
        wheels={
            f"{axle}_{name}": _wheel(frame, along, sign * half_track, steer)
            for axle, (along, half_track, steer) in (("front", front), ("rear", rear))
            for name, sign in (("left", 1.0), ("right", -1.0))
        },
        front_force=_force(frame, front[0], front[2], measured["front_lateral_force"], setup.front_grip),
        rear_force=_force(frame, rear[0], rear[2], measured["rear_lateral_force"], setup.rear_grip),
        travel=_travel(setup, state),
        gust=_gust(frame, vehicle, *side_wind(setup, state)),
        centre_of_mass=(x, y),
    )


def side_wind(setup: Setup, state: Any) -> tuple[float, float]:
    """Force to the left [N] and yaw moment [N m] of a gust at this moment."""
    law = _conditions(setup.task)
    if law is None:
        return 0.0, 0.0
    commands = state.front_steer_command, state.rear_steer_command
    step = setup.world.rules.control_timestep
    episode = EpisodeState(*commands, state.time / step, 0.0, task_state(setup.task, state))
    car: CarParameters = law(CarState(*state[: len(CarState._fields)]), episode, state.time, setup.world)
    return float(car.side_force), float(car.yaw_moment)


@functools.lru_cache(maxsize=8)
def _conditions(task: Task) -> Any:
    return task.conditions(PYTHON)


def rectangle(x0: float, x1: float, y0: float, y1: float) -> Shape:
    """The four corners."""
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))


def arrow_outline(arrow: Arrow, width: float) -> Shape:
    """Shaft of a width [m] and head; empty for an arrow too short to be seen."""
    (x0, y0), (x1, y1) = arrow.start, arrow.end
    length = math.hypot(x1 - x0, y1 - y0)
    if length < 0.05:
        return ()
    head = min(3.2 * width, length)
    neck, half, barb = length - head, 0.5 * width, 0.45 * head
    along, across = (x1 - x0) / length, (y1 - y0) / length
    outline = ((0.0, half), (neck, half), (neck, barb), (length, 0.0), (neck, -barb), (neck, -half), (0.0, -half))
    return tuple((x0 + along * u - across * v, y0 + across * u + along * v) for u, v in outline)


def is_saturated(force: float, grip: float) -> bool:
    """Whether an axle's lateral force is (nearly) all that friction allows; both in N."""
    return abs(force) >= SATURATED * grip


class _Frame(NamedTuple):
    """The car's body frame on the road."""

    x: float
    y: float
    heading: float

    def place(self, u: float, v: float) -> Point:
        cosine, sine = math.cos(self.heading), math.sin(self.heading)
        return (self.x + (cosine * u - sine * v), self.y + (sine * u + cosine * v))

    def seen(self, point: Point) -> Point:
        """A point of the road, ahead and to the left of the centre of mass."""
        cosine, sine, dx, dy = math.cos(self.heading), math.sin(self.heading), point[0] - self.x, point[1] - self.y
        return (cosine * dx + sine * dy, cosine * dy - sine * dx)

    def closed(self, half: Sequence[Point]) -> Shape:
        """A half outline and its mirror image."""
        return tuple(self.place(u, v) for u, v in half) + tuple(self.place(u, -v) for u, v in reversed(half))

    def pair(self, outline: Sequence[Point]) -> tuple[Shape, Shape]:
        return tuple(self.place(u, v) for u, v in outline), tuple(self.place(u, -v) for u, v in outline)


def _scaled(outline: Sequence[Point], vehicle: Vehicle) -> list[Point]:
    half = 0.5 * vehicle.body_width
    return [(along * (vehicle.front_extent if along > 0.0 else vehicle.rear_extent), w * half) for along, w in outline]


def _wheel(frame: _Frame, along: float, aside: float, steer: float) -> Shape:
    cosine, sine = math.cos(steer), math.sin(steer)
    corners = rectangle(-0.5 * TIRE_LENGTH, 0.5 * TIRE_LENGTH, -0.5 * TIRE_WIDTH, 0.5 * TIRE_WIDTH)
    return tuple(frame.place(along + (cosine * u - sine * v), aside + (sine * u + cosine * v)) for u, v in corners)


def _force(frame: _Frame, along: float, steer: float, force: float, grip: float) -> Arrow:
    """At the middle of the axle, at right angles to its wheels; positive forces point to the left."""
    length = GRIP_ARROW * min(max(force / grip, -LONGEST_ARROW), LONGEST_ARROW)
    end = frame.place(along - math.sin(steer) * length, math.cos(steer) * length)
    return Arrow(frame.place(along, 0.0), end, is_saturated(force, grip))


def _gust(frame: _Frame, vehicle: Vehicle, force: float, moment: float) -> Arrow:
    """Towards the side of the body, where the gust pushes; no length where there is none."""
    if force == 0.0:
        return Arrow(frame.place(0.0, 0.0), frame.place(0.0, 0.0))
    length = max(-LONGEST_GUST, min(force * GUST_ARROW, LONGEST_GUST))
    arm, side = moment / force, -math.copysign(0.5 * vehicle.body_width, force)
    return Arrow(frame.place(arm, side - length), frame.place(arm, side))


def _touches(frame: _Frame, vehicle: Vehicle, cone: Point) -> bool:
    """Whether the body is over the middle of a cone: the line through these is what tasks judge."""
    ahead, aside = frame.seen(cone)
    return -vehicle.rear_extent < ahead < vehicle.front_extent and abs(aside) < 0.5 * vehicle.body_width


def _outside(setup: Setup, state: Any, frame: _Frame) -> Shape:
    vehicle, task = setup.vehicle, setup.task
    half, count = 0.5 * vehicle.body_width, 2 if task.uniform_corridor else task.judged_points
    along = np.linspace(vehicle.front_extent, -vehicle.rear_extent, count).tolist()
    points = [frame.place(u, side) for u in along for side in (half, -half)]
    x, y = np.array(points).T
    there = _reference(setup, state, x)
    beyond = np.broadcast_to(abs(y - there.road_centre) > there.road_half_width, x.shape)
    return tuple(point for point, out in zip(points, beyond.tolist(), strict=True) if out)


def _tufts(left: float, right: float, middle: float, half_height: float) -> tuple[Shape, ...]:
    length, width = TUFT
    rows = range(math.ceil((middle - half_height) / TUFT_PERIOD), math.floor((middle + half_height) / TUFT_PERIOD) + 1)
    return tuple(
        rectangle(begin, begin + length, row * TUFT_PERIOD - 0.5 * width, row * TUFT_PERIOD + 0.5 * width)
        for begin in _anchored(left, right, TUFT_PERIOD, length)
        for row in rows
    )


def _travel(setup: Setup, state: Any) -> Arrow:
    rates = path_rates(NUMPY, setup.geometry)
    dx, dy = rates(CarState(*state[: len(CarState._fields)]), setup.world.car)
    start = (state.longitudinal_position, state.lateral_position)
    length = (setup.vehicle.front_extent + COURSE_ARROW) / math.hypot(dx, dy)
    return Arrow(start, (start[0] + float(dx) * length, start[1] + float(dy) * length))


class _View(NamedTuple):
    """What is in sight of the road, m."""

    road: Corridor
    left: float
    right: float
    middle: float
    edge: float
    """From the middle to the outermost place of the edges."""
    half_height: float


def _view(setup: Setup, state: Any, measured: dict[str, float]) -> _View:
    vehicle, x = setup.vehicle, state.longitudinal_position
    # The centre of mass may come half a body beyond the edge, and then the car may stand across the road.
    half_body = 0.5 * vehicle.body_width
    beyond = half_body + math.hypot(max(vehicle.front_extent, vehicle.rear_extent), half_body)
    middle, edge = measured["reference_road_centre"], measured["reference_road_half_width"]
    if edge > AREA:
        left, right = x - BEHIND * 2.0 * AREA * setup.aspect, x + (1.0 - BEHIND) * 2.0 * AREA * setup.aspect
        road = corridor(lambda places: _reference(setup, state, places), left, right)
        return _View(road, left, right, state.lateral_position, edge, AREA)
    for widening in range(WIDENINGS + 1):
        width = 2.0 * (edge + beyond) * setup.aspect
        left = x - BEHIND * width
        right = left + width
        road = corridor(lambda places: _reference(setup, state, places), left, right)
        lowest, highest = float(np.min(road.right)), float(np.max(road.left))
        if widening == WIDENINGS or (lowest > middle - edge - 1e-9 and highest < middle + edge + 1e-9):
            break
        middle, edge = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
    return _View(road, left, right, middle, edge, edge + beyond)


def _posts(road: Corridor, begin: float) -> tuple[Shape, Shape]:
    end, (near, far) = begin + POST_LENGTH, POST
    lowest, highest = road.beside(begin, end)
    return rectangle(begin, end, highest + near, highest + far), rectangle(begin, end, lowest - near, lowest - far)


def _reference(setup: Setup, state: Any, xs: NDArray[Any]) -> Any:
    """The task's reference at other places along the road."""
    car = CarState(*state[: len(CarState._fields)])._replace(longitudinal_position=xs)
    return setup.task.reference(NUMPY)(car, task_state(setup.task, state), setup.world)


def task_state(task: Task, state: Any) -> Any:
    """What of a state is the task's own."""
    record = task.TaskState
    return record(*state[len(state) - len(record._fields) :])


def _path(setup: Setup, state: Any, left: float, right: float) -> tuple[Shape, ...]:
    """The reference path in dashes that stay where they are on the road."""
    first = math.floor(left / PATH_SPACING) - 2 * PATH_DASH
    first -= first % (2 * PATH_DASH)
    samples = np.arange(first, math.ceil(right / PATH_SPACING) + 1)
    xs = samples * PATH_SPACING
    ys = np.broadcast_to(_reference(setup, state, xs).lateral_position, xs.shape)
    points = list(zip(xs.tolist(), ys.tolist(), strict=True))
    return tuple(tuple(points[k : k + PATH_DASH + 1]) for k in range(0, len(points) - PATH_DASH, 2 * PATH_DASH))


def _anchored(left: float, right: float, period: float, length: float) -> list[float]:
    """Starts of all pieces of a length at multiples of a period that reach into the picture."""
    first = math.floor((left - length) / period)
    return [k * period for k in range(first, math.floor(right / period) + 1) if k * period + length > left]
