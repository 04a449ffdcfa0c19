"""Simulate a car without Gymnasium."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import numba
import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import ArrayLike, NDArray

from bicycle_env.backends import announcements, compiled
from bicycle_env.physics import tires
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarParameters, CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.integrators import check_timestep, rk4
from bicycle_env.physics.linear_single_track import fastest_rate
from bicycle_env.physics.model import Model
from bicycle_env.physics.presets import resolve_tired
from bicycle_env.physics.relaxed_single_track import RelaxedSingleTrack
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.physics.validation import checked_speed, in_range, known_keys, number, positive
from bicycle_env.physics.vehicle import Vehicle

Steer = ArrayLike | Callable[[float], tuple[float, float]]


def simulate(
    vehicle: str | Vehicle,
    speed: float,
    steer: Steer,
    duration: float,
    tire: str | tires.Tire = "fiala",
    friction: float = 1.0,
    geometry: str | None = None,
    initial_state: Mapping[str, float] | None = None,
    timestep: float = 1e-3,
    relaxation_length: float | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Integrate the single-track equations (6.18)-(6.21) with prescribed road-wheel angles; no actuator.

    Args:
        vehicle: a preset's name or a Vehicle.
        speed: U, m/s, constant.
        steer: road-wheel angles (front, rear) in rad: a constant pair; an array (steps, 2), each row held for one
            timestep; or a callable of time [s], evaluated where RK4 needs it.
        duration: s.
        tire: a name in ``bicycle_env.tires.LAWS`` or a tire object.
        friction: road friction coefficient; a saturating axle's largest force is friction x static load.
        geometry: "small_angle" or "exact"; by default small_angle for the linear tire and exact for the others.
        initial_state: any of longitudinal_position, lateral_position, heading, lateral_velocity, yaw_rate; the
            others are 0.
        timestep: s; shortened a little if it does not divide the duration.
        relaxation_length: of the tires, m: their forces lag. Before the start the wheels were straight, in a steady
            motion. None: tires that answer at once.

    Returns:
        A mapping of arrays (steps + 1,), both ends included: time, the state by its names (longitudinal_position,
        lateral_position, heading, lateral_velocity, yaw_rate, front_steer, rear_steer), and front_slip_angle,
        rear_slip_angle, front_lateral_force, rear_lateral_force, lateral_acceleration (V' + U r), yaw_acceleration,
        sideslip (V / U); with a relaxation length front_transient_slip_angle, rear_transient_slip_angle, too.

    Raises:
        ValueError, TypeError: a bad value, named with its allowed range; a timestep too long for RK4.
    """
    vehicle, tire = resolve_tired(vehicle, tire)
    model: Model = (SingleTrack if relaxation_length is None else RelaxedSingleTrack).of(tire, geometry)
    speed = checked_speed(speed)
    duration = positive("duration", duration)
    timestep = in_range("timestep", timestep)
    friction = in_range("friction", friction)
    length = None if relaxation_length is None else in_range("relaxation_length", relaxation_length)
    check_timestep("timestep", timestep, fastest_rate(vehicle, speed, length))
    steps = max(1, int(np.ceil(duration / timestep - 1e-9)))
    time = np.linspace(0.0, duration, steps + 1)
    inputs = _steer_inputs(steer, time)
    start = np.zeros(len(CarState._fields))
    if initial_state is not None:
        if not isinstance(initial_state, Mapping):
            raise TypeError(f"initial_state must be a mapping of state names to numbers, got {initial_state!r}")
        known_keys("state name", initial_state, CarState._fields[:5])
        for name, value in initial_state.items():
            start[CarState._fields.index(name)] = number(f"initial_state[{name!r}]", value)

    car = car_on_road(vehicle, speed, friction, FRONT, REAR, length or 0.0)
    start = np.array(model.complete(NUMPY)(CarState(*start), car))
    states = np.empty((len(model.State._fields), steps + 1))
    _integrator(model)(start, np.array(car), inputs, duration / steps, states)

    steers = slice(CarState._fields.index("front_steer"), len(CarState._fields))
    states[steers, :-1], states[steers, -1] = inputs[:, 0].T, inputs[-1, 2]  # what acts from each time on
    history = model.State(*states)
    acting = model.axles(NUMPY)(history, CarParameters(*(np.float64(value) for value in car)))
    return {
        "time": time,
        **{name: values.copy() for name, values in history._asdict().items()},
        **acting._asdict(),
        "sideslip": history.lateral_velocity / speed,
    }


def _steer_inputs(steer: Steer, time: NDArray[np.float64]) -> NDArray[np.float64]:
    """(steps, 3, 2): both road-wheel angles at the start, the middle and the end of each step."""
    steps = len(time) - 1
    inputs = np.empty((steps, 3, 2))
    if callable(steer):
        middle = 0.5 * (time[1:] + time[:-1])
        at_nodes = np.array([_pair(steer(float(t)), t) for t in time])
        inputs[:, 0], inputs[:, 2] = at_nodes[:-1], at_nodes[1:]
        inputs[:, 1] = [_pair(steer(float(t)), t) for t in middle]
    else:
        try:
            angles = np.asarray(steer, dtype=np.float64)
        except (TypeError, ValueError):
            angles = np.empty(0)
        if angles.shape not in ((2,), (steps, 2)):
            raise ValueError(
                "steer must be a pair (front, rear) in rad, an array of shape (steps, 2) "
                f"with steps = duration / timestep = {steps}, or a callable of time; "
                + (f"got shape {angles.shape}" if angles.size else f"got {steer!r}")
            )
        inputs[:] = np.broadcast_to(angles, (steps, 2))[:, None, :]
    if not np.all(np.abs(inputs) < np.pi / 2):
        raise ValueError("steer must be finite angles in (-pi/2, pi/2) rad")
    return inputs


def _pair(value: Any, time: float) -> NDArray[np.float64]:
    try:
        pair = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        pair = np.empty(0)
    if pair.shape != (2,):
        raise ValueError(f"steer(time) must return a pair (front, rear) in rad, got {value!r} at time {time:g} s")
    return pair


@functools.cache
def _integrator(model: Model) -> Callable[..., None]:
    """The compiled loop over all steps."""
    advance = compiled.inlined(rk4(compiled.NUMBA, model.State, model.rates(compiled.NUMBA)))
    State = model.State
    fields, numbers = len(State._fields), len(CarParameters._fields)

    def integrate(start: Any, car_numbers: Any, inputs: Any, timestep: Any, states: Any) -> None:
        car = CarParameters(*to_fixed_tuple(car_numbers, numbers))
        state = State(*to_fixed_tuple(start, fields))
        for k in range(len(inputs)):
            for j in range(fields):
                states[j, k] = state[j]
            now = (inputs[k, 0, 0], inputs[k, 0, 1])
            middle = (inputs[k, 1, 0], inputs[k, 1, 1])
            end = (inputs[k, 2, 0], inputs[k, 2, 1])
            state = advance(state, now, middle, end, car, timestep)
        for j in range(fields):
            states[j, len(inputs)] = state[j]

    row = numba.float64[::1]
    with announcements.progress(f"simulate for {model}"):
        return compiled.entry_point(
            integrate, numba.void(row, row, numba.float64[:, :, ::1], numba.float64, numba.float64[:, ::1])
        )
