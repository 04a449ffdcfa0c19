"""The states from which some steering brings the car back: a viability question, answered on a grid."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.recovery import least_time
from bicycle_env.analysis.recovery.recoverable_set import (
    GOAL_COURSE,
    GOAL_SIDESLIP,
    GOAL_YAW_RATE,
    RecoverableSet,
    car_with_limits,
)
from bicycle_env.physics import tires
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.physics.validation import checked_speed, choice, in_range, number, positive, whole
from bicycle_env.physics.vehicle import Vehicle

Array = NDArray[np.float64]

COURSE_LIMIT = 0.4  # rad: the course axis of the grid with a lane
STEER_MODES = ("front", "rear", "both")
LEVELS, LANE_LEVELS = 5, 3
"""Steer angles per axle to choose from, evenly spaced over both limits. More change the shares by under 0.001."""


def recoverable_set(
    vehicle: str | Vehicle,
    speed: float,
    tire: str | tires.Tire = "fiala",
    steer: str = "both",
    friction: float = 1.0,
    steer_limits: tuple[float, float] = (0.1, 0.05),
    grid: tuple[int, int] = (161, 161),
    sideslip_limit: float = 0.8,
    yaw_rate_limit: float = 2.0,
    horizon: float = 5.0,
    lane: float | None = None,
    lane_grid: tuple[int, int, int, int] = (61, 61, 33, 25),
    geometry: str | None = None,
    progress: bool | Callable[[float], None] | None = None,
) -> RecoverableSet:
    """The states (lateral velocity, yaw rate) from which SOME admissible steering brings the car back.

    Recovered means: |sideslip| < 0.03 and |yaw rate| < 0.08 within the horizon, without crossing the limits. The road
    wheels follow at once, so the set is an upper bound for every controller, with whatever actuators. By dynamic
    programming, see ``bicycle_env.analysis.recovery.least_time``.

    Args:
        vehicle: a preset's name or a Vehicle.
        speed: m/s.
        tire: a name in ``bicycle_env.tires.LAWS`` or a tire object.
        steer: "front", "rear" or "both".
        friction: road friction coefficient.
        steer_limits: largest road-wheel angles (front, rear), rad.
        grid: nodes in lateral velocity and in yaw rate.
        sideslip_limit: |V / U| beyond which the car is lost, rad.
        yaw_rate_limit: rad/s.
        horizon: s.
        lane: half-width of a lane that the centre of mass must not leave, m; the set then has four states, and
            recovered means |course| < 0.05 too (course: heading + V / U).
        lane_grid: nodes in lateral velocity, yaw rate, course (within 0.4 rad) and lateral position, with a lane. The
            set without a lane, on `grid`, bounds it from outside.
        geometry: "small_angle" or "exact"; by default as in ``simulate``.
        progress: show a bar (needs tqdm); by default where standard error is a terminal. Or a function that hears the
            share that is done, 0 to 1, now and then; what it raises ends the search.

    Raises:
        ValueError, TypeError: a bad value, named with its allowed range.
        IntractableError: the time scales of this car's motion lie so far apart that the search does not converge.
    """
    vehicle = resolve_vehicle(vehicle)
    speed = checked_speed(speed)
    choice("steer", steer, STEER_MODES)
    friction = in_range("friction", friction)
    front, rear = _limits(steer_limits)
    front, rear = (front if steer != "rear" else 0.0), (rear if steer != "front" else 0.0)
    sideslip_limit = number("sideslip_limit", sideslip_limit, high=1.5, above=GOAL_SIDESLIP)
    yaw_rate_limit = number("yaw_rate_limit", yaw_rate_limit, high=10.0, above=GOAL_YAW_RATE)
    horizon = positive("horizon", horizon)
    lane = None if lane is None else positive("lane", lane)
    shape = _nodes("grid", grid, 2)
    lane_shape = _nodes("lane_grid", lane_grid, 4)
    model = SingleTrack.of(tire, geometry)

    car = car_with_limits(vehicle, speed, friction, (front, rear))
    longest = least_time.longest_step(vehicle, speed)
    angles = _pairs(front, rear, LEVELS)
    limits = (sideslip_limit * speed, yaw_rate_limit)
    plane = tuple(_axis(limit, n) for limit, n in zip(limits, shape, strict=True))
    found = RecoverableSet(
        vehicle,
        speed,
        model.tire,
        model.geometry,
        friction,
        (front, rear),
        sideslip_limit,
        yaw_rate_limit,
        horizon,
        None,
        plane[0],
        plane[1],
        None,
        None,
        np.empty(0),
        angles,
    )
    goal = _goal("grid", plane[0], plane[1], speed)
    with _bar("recoverable set", progress) as show:
        value = np.where(goal, 0.0, 1.0)
        steps = least_time.steps(model, car, plane[0], plane[1], angles, longest)
        least_time.solve_plane(value, steps, (plane[0], plane[1]), horizon, show)
    found = dataclasses.replace(found, value=value)
    if lane is None:
        return found

    v, r, course, y = (_axis(limit, n) for limit, n in zip((*limits, COURSE_LIMIT, lane), lane_shape, strict=True))
    floor = found.projected_value_at(np.stack(np.meshgrid(v, r, indexing="ij"), axis=-1))
    goal_in_lane = _goal("lane_grid", v, r, speed)[:, :, None, None] & (np.abs(course) < GOAL_COURSE)[:, None]
    lane_value = np.where(np.broadcast_to(goal_in_lane, lane_shape), 0.0, 1.0)
    with _bar("recoverable set in a lane", progress) as show:
        angles = _pairs(front, rear, LANE_LEVELS)
        steps = least_time.steps(model, car, v, r, angles, longest)
        axes = (v, r, course, y)
        least_time.solve_lane(lane_value, floor, steps, axes, speed, model.geometry == "exact", horizon, show)
    return dataclasses.replace(
        found,
        lane=lane,
        lateral_velocity=v,
        yaw_rate=r,
        course=course,
        lateral_position=y,
        value=lane_value,
        steer_angles=angles,
    )


def _axis(limit: float, nodes: int) -> Array:
    """Evenly spaced and symmetric to the bit, so that mirror images have the same least time."""
    axis = np.linspace(-limit, limit, nodes)
    return 0.5 * (axis - axis[::-1])


def _pairs(front: float, rear: float, levels: int) -> Array:
    """(k, 2): all pairs of angles; 0 alone for an axle that is not steered."""
    return np.array(
        [
            (f, r)
            for f in np.linspace(-front, front, levels if front else 1)
            for r in np.linspace(-rear, rear, levels if rear else 1)
        ]
    )


def _goal(name: str, lateral_velocity: Array, yaw_rate: Array, speed: float) -> NDArray[np.bool_]:
    goal = (np.abs(lateral_velocity)[:, None] < GOAL_SIDESLIP * speed) & (np.abs(yaw_rate)[None, :] < GOAL_YAW_RATE)
    if not np.any(goal):
        needed = [
            2 * axis[-1] / size + 1
            for axis, size in ((lateral_velocity / speed, 2 * GOAL_SIDESLIP), (yaw_rate, 2 * GOAL_YAW_RATE))
        ]
        raise ValueError(
            f"{name} is too coarse: no node has |sideslip| < {GOAL_SIDESLIP} and |yaw rate| < {GOAL_YAW_RATE}; use "
            f"odd numbers, or more than {needed[0]:.0f} and {needed[1]:.0f}; got {goal.shape}"
        )
    return goal


def _limits(steer_limits: Sequence[float]) -> tuple[float, float]:
    if not isinstance(steer_limits, Sequence) or len(steer_limits) != 2:
        raise TypeError(f"steer_limits must be a pair (front, rear) in rad, got {steer_limits!r}")
    front, rear = (number(f"steer_limits[{k}]", limit, 0.0, 1.5) for k, limit in enumerate(steer_limits))
    return front, rear


def _nodes(name: str, grid: Sequence[int], axes: int) -> tuple[int, ...]:
    if not isinstance(grid, Sequence) or len(grid) != axes:
        raise TypeError(f"{name} must be {axes} whole numbers of nodes, got {grid!r}")
    return tuple(whole(f"{name}[{k}]", n, 5, 5001) for k, n in enumerate(grid))


@contextmanager
def _bar(label: str, wanted: bool | Callable[[float], None] | None) -> Iterator[least_time.Progress]:
    """A progress bar from 0 to 1 on standard error, where tqdm is installed; or the caller's own."""
    if callable(wanted):
        yield wanted
        return
    if wanted is False or (wanted is None and not sys.stderr.isatty()):
        yield lambda _: None
        return
    try:
        from tqdm import tqdm
    except ImportError:
        yield lambda _: None
        return
    with tqdm(total=100, desc=label, unit="%", leave=False) as bar:
        yield lambda done: bar.update(max(0, round(100 * done) - bar.n))
