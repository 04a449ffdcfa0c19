"""The linear car for the page: the closed forms of ``analysis``, of whatever car, as functions to be written out."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

from bicycle_env.analysis import linear_laws
from bicycle_env.export.routines import Argument, Library, Routine
from bicycle_env.physics.actuators import Actuator
from bicycle_env.physics.car import CarParameters, car_on_road
from bicycle_env.physics.records import record_of
from bicycle_env.physics.vehicle import Vehicle, critical_speed, yaw_stiffness

BODY = (
    *("mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "front_cornering_stiffness", "rear_cornering_stiffness"),
    *("front_overhang", "rear_overhang", "body_width"),
)
"""What of a vehicle the page has."""
DERIVED = ("wheelbase", "front_axle_load", "rear_axle_load", "front_extent", "rear_extent")
Body: Any = type("Body", (record_of("Body", BODY),), {name: getattr(Vehicle, name) for name in DERIVED})
"""A vehicle of numbers or symbols, with what a ``Vehicle`` derives from its fields without a choice."""
Wheels: Any = record_of("Wheels", tuple(field.name for field in dataclasses.fields(Actuator)))
"""An actuator of numbers or symbols."""
RESPONSES = tuple((axle, output) for axle in ("front", "rear") for output in ("lateral_acceleration", "yaw_rate"))


class Straight(NamedTuple):
    """Straight running: see ``analysis.Stability`` and ``Modes``."""

    first_real: Any
    first_imaginary: Any
    second_real: Any
    second_imaginary: Any
    time_to_double: Any
    criterion: Any
    critical_speed: Any
    yaw_stiffness: Any


class Eigenvalues(NamedTuple):
    """Both, 1/s."""

    first_real: Any
    first_imaginary: Any
    second_real: Any
    second_imaginary: Any


Response: Any = record_of(
    "Response", tuple(f"{axle}_{output}_{part}" for axle, output in RESPONSES for part in ("real", "imaginary"))
)
"""Of an output to a steer angle of an axle, per rad."""
Zeros: Any = record_of("Zeros", ("front", "rear"))
"""Of the lateral acceleration, the greatest real one, 1/s; 0 if none is positive."""


def library() -> Library:
    """``on_road``, ``straight``, ``fed_back``, ``respond`` and ``right_zeros`` of a vehicle."""
    vehicle, speed = Argument("vehicle", Body), Argument("speed")
    routines = (
        Routine(
            "on_road",
            "The car at a speed [m/s] on a road of this friction, its actuators, its tires' relaxation length [m].",
            (
                *(vehicle, speed, Argument("friction")),
                *(Argument("front", Wheels, "actuator"), Argument("rear", Wheels, "actuator")),
                Argument("relaxation_length"),
            ),
            (Argument("placed", CarParameters, "car"),),
            lambda _: car_on_road,
        ),
        Routine(
            "straight",
            "Straight running at a speed [m/s]: eigenvalues [1/s], the time in which a deviation doubles [s], ...",
            (vehicle, speed),
            (Argument("found", Straight, "straight_running"),),
            _straight,
        ),
        Routine(
            "fed_back",
            "The eigenvalues [1/s] where the rear wheels are steered by a gain [s] times the yaw rate.",
            (vehicle, speed, Argument("gain")),
            (Argument("eigenvalues", Eigenvalues),),
            _fed_back,
        ),
        Routine(
            "respond",
            "The frequency response at a frequency [rad/s].",
            (vehicle, speed, Argument("frequency")),
            (Argument("response", Response),),
            _respond,
        ),
        Routine(
            "right_zeros",
            "What makes the lateral acceleration start the wrong way: its zero in the right half-plane.",
            (vehicle, speed),
            (Argument("zeros", Zeros),),
            _right_zeros,
        ),
    )
    words = ("The linear car, as bicycle_env.analysis has it.",)
    return Library("linear", words, routines, {}, {}, {})


def _straight(xp: Any) -> Any:
    balance, critical, solve = yaw_stiffness(xp), critical_speed(xp), linear_laws.roots(xp)

    def straight(vehicle: Any, speed: Any) -> Straight:
        moment = balance(vehicle)
        polynomial = linear_laws.characteristic(vehicle, speed, moment)
        first, second = solve(*polynomial)
        grows = (polynomial[-1] < 0.0) & (second[0] > 0.0)
        doubling = xp.where(grows, math.log(2.0) / xp.where(grows, second[0], 1.0), math.inf)
        return Straight(*first, *second, doubling, polynomial[-1], critical(vehicle), moment)

    return straight


def _fed_back(xp: Any) -> Any:
    balance, solve = yaw_stiffness(xp), linear_laws.roots(xp)

    def fed_back(vehicle: Any, speed: Any, gain: Any) -> Eigenvalues:
        inertia, damping, stiffness = linear_laws.characteristic(vehicle, speed, balance(vehicle))
        more_damping, more_stiffness = linear_laws.yaw_rate_feedback(vehicle, speed)
        first, second = solve(inertia, damping + gain * more_damping, stiffness + gain * more_stiffness)
        return Eigenvalues(*first, *second)

    return fed_back


def _respond(xp: Any) -> Any:
    balance = yaw_stiffness(xp)

    def respond(vehicle: Any, speed: Any, frequency: Any) -> Any:
        bottom = linear_laws.characteristic(vehicle, speed, balance(vehicle))
        found: list[Any] = []
        for axle, output in RESPONSES:
            top = linear_laws.numerator(vehicle, speed, axle == "front", output)
            found += linear_laws.frequency_response(top, bottom, frequency)
        return Response(*found)

    return respond


def _right_zeros(xp: Any) -> Any:
    solve = linear_laws.roots(xp)

    def right_zeros(vehicle: Any, speed: Any) -> Any:
        found = []
        for axle in ("front", "rear"):
            top = linear_laws.numerator(vehicle, speed, axle == "front", "lateral_acceleration")
            _, (real, imaginary) = solve(*top)
            found.append(xp.where(imaginary == 0.0, xp.maximum(real, 0.0), 0.0))
        return Zeros(*found)

    return right_zeros
