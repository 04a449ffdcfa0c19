"""Least time to recovery on a grid: the minimum-time problem as dynamic programming, compiled.

Unknown is Kruzhkov's transform v = 1 - exp(-T / horizon) of the least time T: bounded, 0 at the goal, 1 where there is
no rescue (M. Bardi and I. Capuzzo-Dolcetta, Optimal Control and Viscosity Solutions of Hamilton-Jacobi-Bellman
Equations, 1997). It is the fixed point of

    v(z) = min over the steer angles of 1 - exp(-dt / horizon) (1 - v(z after dt)),

a semi-Lagrangian scheme with multilinear interpolation (M. Falcone and R. Ferretti, Semi-Lagrangian Approximation
Schemes, SIAM 2013), reached by Gauss-Seidel sweeps in alternating directions. Interpolation smears the jump at the
edge of the set over a cell or two; with the horizon as the time scale, "T <= horizon" is v <= 1 - 1/e, about the
middle of that jump, so the edge is displaced neither outwards nor inwards.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from bicycle_env.backends import announcements, compiled
from bicycle_env.backends.compiled import NUMBA
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.integrators import STABILITY_LIMIT, rk4
from bicycle_env.physics.linear_single_track import fastest_rate
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.physics.vehicle import Vehicle

Array = NDArray[np.float64]

CELLS = 2.5
"""How far one step of the scheme moves, in cells: few interpolations, and still a local step."""
LONGEST_STEP = 0.05
"""s; where the car's state moves slowly."""
TOLERANCE = 1e-6
"""Sweeps end when no value changes by more."""
MOST_SWEEPS = 10_000

_NUMBERS = len(CarParameters._fields)
_matrix = numba.float64[:, ::1]
_row = numba.float64[::1]


class IntractableError(RuntimeError):
    """The time scales of a car's motion lie so far apart that no grid of a usual size holds them."""


def longest_step(vehicle: Vehicle, speed: float) -> float:
    """LONGEST_STEP, s, or what RK4 needs for the fastest mode of a car at a speed [m/s], if that is less."""
    return min(LONGEST_STEP, STABILITY_LIMIT / fastest_rate(vehicle, speed))


class Steps(NamedTuple):
    """Where each steer angle takes the car from each node: arrays (lateral velocities, yaw rates, steer angles)."""

    lateral_velocity: Array
    """m/s, after the step."""
    yaw_rate: Array
    """rad/s, after the step."""
    time: Array
    """Duration of the step, s."""
    turn: Array
    """Change of the heading, rad."""
    forward: Array
    """Displacement along the heading at the start, m."""
    sideways: Array
    """Displacement to the left of the heading at the start, m."""


def steps(
    model: SingleTrack,
    car: CarParameters,
    lateral_velocity: Array,
    yaw_rate: Array,
    steer: Array,
    longest: float,
) -> Steps:
    """One RK4 step from each node for each pair (front, rear) of `steer` (angles, 2), about ``CELLS`` cells long."""
    out = np.empty((6, len(lateral_velocity), len(yaw_rate), len(steer)))
    with announcements.progress(f"recoverable set for {model}"):
        fill = _stepper(model)
    fill(np.array(car), lateral_velocity, yaw_rate, np.ascontiguousarray(steer), longest, out)
    return Steps(*out)


@functools.cache
def _stepper(model: SingleTrack) -> Callable[..., None]:
    law = model.rates(NUMBA)
    rates = NUMBA.function(law)
    advance = NUMBA.function(rk4(NUMBA, model.State, law))

    def fill(car_numbers: Any, lateral_velocity: Any, yaw_rate: Any, steer: Any, longest: Any, out: Any) -> None:
        car = CarParameters(*to_fixed_tuple(car_numbers, _NUMBERS))
        cell = (lateral_velocity[1] - lateral_velocity[0], yaw_rate[1] - yaw_rate[0])
        for i in range(len(lateral_velocity)):
            for j in range(len(yaw_rate)):
                for k in range(len(steer)):
                    state = CarState(0.0, 0.0, 0.0, lateral_velocity[i], yaw_rate[j], 0.0, 0.0)
                    angles = (steer[k, 0], steer[k, 1])
                    rate = rates(state, angles, car)
                    cells = max(abs(rate.lateral_velocity) / cell[0], abs(rate.yaw_rate) / cell[1])
                    time = min(longest, CELLS / max(cells, 1e-9))
                    state = advance(state, angles, angles, angles, car, time)
                    out[0, i, j, k] = state.lateral_velocity
                    out[1, i, j, k] = state.yaw_rate
                    out[2, i, j, k] = time
                    out[3, i, j, k] = state.heading
                    out[4, i, j, k] = state.longitudinal_position
                    out[5, i, j, k] = state.lateral_position

    signature = numba.void(_row, _row, _row, _matrix, numba.float64, numba.float64[:, :, :, ::1])
    return compiled.entry_point(fill, signature)


class Places(NamedTuple):
    """Where points lie on a grid axis: the cell to the left and the share of it that has been crossed."""

    cell: NDArray[np.int64]
    share: Array


def place(axis: Array, points: Array) -> Places:
    """Cells of points on an evenly spaced axis; -1 for points beyond its ends."""
    position = (points - axis[0]) / (axis[1] - axis[0])
    # A hair beyond the end is rounding, not a departure.
    inside = (position >= -1e-9) & (position <= len(axis) - 1 + 1e-9)
    cell = np.clip(np.floor(position), 0, len(axis) - 2)
    return Places(np.where(inside, cell, -1).astype(np.int64), np.clip(position - cell, 0.0, 1.0))


Progress = Callable[[float], None]


def solve_plane(value: Array, steps: Steps, axes: tuple[Array, Array], horizon: float, progress: Progress) -> None:
    """Sweep `value` (lateral velocities, yaw rates), in place, down to the fixed point; its zeros are the goal."""
    first, second = place(axes[0], steps.lateral_velocity), place(axes[1], steps.yaw_rate)
    cell = np.where((first.cell < 0) | (second.cell < 0), -1, first.cell * len(axes[1]) + second.cell)
    kept = np.exp(-steps.time / horizon)
    sweep = _plane_sweep()
    _sweep_down(lambda k: sweep(value, cell, first.share, second.share, kept, k), 4, progress)


def solve_lane(
    value: Array,
    floor: Array,
    steps: Steps,
    axes: tuple[Array, Array, Array, Array],
    speed: float,
    exact: bool,
    horizon: float,
    progress: Progress,
) -> None:
    """Sweep `value` (lateral velocities, yaw rates, courses, lateral positions) down to the fixed point, in place.

    `floor` (lateral velocities, yaw rates) is the value without a lane: nothing is below it. The course is
    heading + V / U: beside the lane's edge it is what counts, and it stays small while the heading need not.
    """
    first, second = place(axes[0], steps.lateral_velocity), place(axes[1], steps.yaw_rate)
    cell = np.where((first.cell < 0) | (second.cell < 0), -1, first.cell * len(axes[1]) + second.cell)
    kept = np.exp(-steps.time / horizon)
    turn = steps.turn + (steps.lateral_velocity - axes[0][:, None, None]) / speed
    heading = axes[2][None, :] - axes[0][:, None] / speed
    sine, cosine = (np.sin(heading), np.cos(heading)) if exact else (heading, np.ones_like(heading))
    sweep = _lane_sweep()
    flat = value.reshape(-1, *value.shape[2:])
    _sweep_down(
        lambda k: sweep(
            flat,
            floor,
            cell,
            first.share,
            second.share,
            kept,
            turn,
            steps.forward,
            steps.sideways,
            sine,
            cosine,
            axes[2],
            axes[3],
            k,
        ),
        4,
        progress,
    )


def _sweep_down(sweep: Callable[[int], float], directions: int, progress: Progress) -> None:
    """Repeat sweeps in all directions until none changes anything; `progress` hears a share of the way, 0 to 1."""
    for _ in range(MOST_SWEEPS):
        change = max(sweep(direction) for direction in range(directions))
        progress(min(1.0, math.log(max(change, TOLERANCE)) / math.log(TOLERANCE)))
        if change <= TOLERANCE:
            return
    raise IntractableError(f"the least time did not converge in {MOST_SWEEPS} sweeps")


@functools.cache
def _plane_sweep() -> Callable[..., float]:
    def sweep(value: Any, cell: Any, first: Any, second: Any, kept: Any, direction: Any) -> float:
        n, m, angles = cell.shape
        flat = value.reshape(-1)
        change = 0.0
        for row in range(n):
            i = row if direction % 2 == 0 else n - 1 - row
            for column in range(m):
                j = column if direction < 2 else m - 1 - column
                best = value[i, j]
                for k in range(angles):
                    at = cell[i, j, k]
                    if at >= 0:
                        x, y = first[i, j, k], second[i, j, k]
                        low = flat[at] + y * (flat[at + 1] - flat[at])
                        high = flat[at + m] + y * (flat[at + m + 1] - flat[at + m])
                        best = min(best, 1.0 - kept[i, j, k] * (1.0 - (low + x * (high - low))))
                change = max(change, value[i, j] - best)
                value[i, j] = best
        return change

    cube = numba.float64[:, :, ::1]
    with announcements.progress("recoverable set"):
        return compiled.entry_point(
            sweep, numba.float64(_matrix, numba.int64[:, :, ::1], cube, cube, cube, numba.int64)
        )


@functools.cache
def _lane_sweep() -> Callable[..., float]:
    def sweep(
        value: Any,
        floor: Any,
        cell: Any,
        first: Any,
        second: Any,
        kept: Any,
        turn: Any,
        forward: Any,
        sideways: Any,
        sine: Any,
        cosine: Any,
        course: Any,
        position: Any,
        direction: Any,
    ) -> float:
        n, m, angles = cell.shape
        courses, positions = len(course), len(position)
        per_course, per_position = 1.0 / (course[1] - course[0]), 1.0 / (position[1] - position[0])
        change = 0.0
        for row in range(n):
            i = row if direction % 2 == 0 else n - 1 - row
            for column in range(m):
                j = column if direction < 2 else m - 1 - column
                if floor[i, j] >= 1.0 - 1e-9:
                    continue
                here = value[i * m + j]
                for k in range(angles):
                    at = cell[i, j, k]
                    if at < 0:
                        continue
                    x, y, keep = first[i, j, k], second[i, j, k], kept[i, j, k]
                    a, b = value[at], value[at + 1]
                    c, d = value[at + m], value[at + m + 1]
                    wa, wb, wc, wd = (1.0 - x) * (1.0 - y), (1.0 - x) * y, x * (1.0 - y), x * y
                    for p in range(courses):
                        place = (course[p] + turn[i, j, k] - course[0]) * per_course
                        if not 0.0 <= place <= courses - 1.0:
                            continue
                        s = min(int(place), courses - 2)
                        u = place - s
                        shift = forward[i, j, k] * sine[i, p] + sideways[i, j, k] * cosine[i, p]
                        for q in range(positions):
                            old = here[p, q]
                            if old <= floor[i, j]:
                                continue
                            place = (position[q] + shift - position[0]) * per_position
                            if not 0.0 <= place <= positions - 1.0:
                                continue
                            t = min(int(place), positions - 2)
                            w = place - t
                            near = (
                                wa * (a[s, t] + w * (a[s, t + 1] - a[s, t]))
                                + wb * (b[s, t] + w * (b[s, t + 1] - b[s, t]))
                                + wc * (c[s, t] + w * (c[s, t + 1] - c[s, t]))
                                + wd * (d[s, t] + w * (d[s, t + 1] - d[s, t]))
                            )
                            s1 = s + 1
                            far = (
                                wa * (a[s1, t] + w * (a[s1, t + 1] - a[s1, t]))
                                + wb * (b[s1, t] + w * (b[s1, t + 1] - b[s1, t]))
                                + wc * (c[s1, t] + w * (c[s1, t + 1] - c[s1, t]))
                                + wd * (d[s1, t] + w * (d[s1, t + 1] - d[s1, t]))
                            )
                            new = max(1.0 - keep * (1.0 - (near + u * (far - near))), floor[i, j])
                            if new < old:
                                change = max(change, old - new)
                                here[p, q] = new
        return change

    cube = numba.float64[:, :, ::1]
    with announcements.progress("recoverable set in a lane"):
        return compiled.entry_point(
            sweep,
            numba.float64(
                cube,
                _matrix,
                numba.int64[:, :, ::1],
                *[cube] * 6,
                *[_matrix] * 2,
                *[_row] * 2,
                numba.int64,
            ),
        )
