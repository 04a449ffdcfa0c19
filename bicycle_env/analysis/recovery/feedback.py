"""Which starts a clipped linear feedback brings back: closed-loop simulation of many cars, compiled."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from bicycle_env.analysis.recovery.least_time import IntractableError
from bicycle_env.backends import announcements, compiled
from bicycle_env.backends.compiled import NUMBA
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.single_track import SingleTrack

Array = NDArray[np.float64]

SHORTEST_STEP = 5e-4
"""s; RK4 then follows modes of 5000 1/s, of which no car has one."""

_NUMBERS = len(CarParameters._fields)
_matrix = numba.float64[:, ::1]
_row = numba.float64[::1]


def saved_by_feedback(
    model: SingleTrack,
    car: CarParameters,
    starts: CarState,
    gain: Array,
    timestep: float,
    horizon: float,
    limits: tuple[float, ...],
    goal: tuple[float, ...],
) -> NDArray[np.bool_]:
    """Which starts (arrays of one shape) the clipped feedback steer = -gain (V, r, psi, y) brings to the goal.

    The steer angles follow at once. `limits` and `goal`: sideslip, yaw rate, course, lateral position.
    """
    if timestep < SHORTEST_STEP:
        raise IntractableError(
            f"the fastest mode of this car needs steps of {timestep:.3g} s, below {SHORTEST_STEP:g} s"
        )
    table = np.stack([np.ravel(np.asarray(values, dtype=np.float64)) for values in starts])
    saved = np.zeros(table.shape[1], dtype=np.bool_)
    with announcements.progress(f"linear feedback on {model}"):
        drive = _feedback(model)
    numbers = np.array([*limits, *goal])
    drive(np.array(car), table, np.ascontiguousarray(gain), timestep, math.ceil(horizon / timestep), numbers, saved)
    return saved.reshape(np.shape(starts.lateral_velocity))


@functools.cache
def _feedback(model: SingleTrack) -> Callable[..., None]:
    advance = NUMBA.function(rk4(NUMBA, model.State, model.rates(NUMBA)))
    fields = len(CarState._fields)

    def drive(car_numbers: Any, starts: Any, gain: Any, timestep: Any, most: Any, bounds: Any, saved: Any) -> None:
        car = CarParameters(*to_fixed_tuple(car_numbers, _NUMBERS))
        for k in range(starts.shape[1]):
            state = CarState(*to_fixed_tuple(starts[:, k].copy(), fields))
            for _ in range(most):
                sideslip = state.lateral_velocity / car.speed
                seen = (
                    abs(sideslip),
                    abs(state.yaw_rate),
                    abs(state.heading + sideslip),
                    abs(state.lateral_position),
                )
                lost, there = False, True
                for j in range(4):
                    lost = lost or not (seen[j] <= bounds[j])
                    there = there and seen[j] < bounds[4 + j]
                if lost or there:
                    saved[k] = there and not lost
                    break
                x = (state.lateral_velocity, state.yaw_rate, state.heading, state.lateral_position)
                front = -(gain[0, 0] * x[0] + gain[0, 1] * x[1] + gain[0, 2] * x[2] + gain[0, 3] * x[3])
                rear = -(gain[1, 0] * x[0] + gain[1, 1] * x[1] + gain[1, 2] * x[2] + gain[1, 3] * x[3])
                angles = (
                    min(max(front, -car.front_angle_limit), car.front_angle_limit),
                    min(max(rear, -car.rear_angle_limit), car.rear_angle_limit),
                )
                state = advance(state, angles, angles, angles, car, timestep)

    signature = numba.void(_row, _matrix, _matrix, numba.float64, numba.int64, _row, numba.boolean[::1])
    return compiled.entry_point(drive, signature)
