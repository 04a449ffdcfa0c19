"""Stability, understeer and oversteer: closed forms of Karnopp, Vehicle Stability, (6.9)-(6.17) and (6.22)-(6.27).

Every function takes a Vehicle or a preset's name; ValueError or TypeError for anything else.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis import linear_laws
from bicycle_env.physics import linear_single_track
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.validation import checked_speed, choice, in_range, positive
from bicycle_env.physics.vehicle import Vehicle

COORDINATES = ("body", "inertial")


def critical_speed(vehicle: str | Vehicle) -> float:
    """U_crit of (6.17), m/s; infinite for a car that does not oversteer."""
    return resolve_vehicle(vehicle).critical_speed


def characteristic_speed(vehicle: str | Vehicle) -> float:
    """U_ch, m/s, at which an understeering car's yaw-rate gain is half of a neutral one's; infinite otherwise."""
    vehicle = resolve_vehicle(vehicle)
    gradient = understeer_gradient(vehicle)
    return math.sqrt(vehicle.wheelbase / gradient) if gradient > 0.0 else math.inf


def understeer_gradient(vehicle: str | Vehicle) -> float:
    """K = m (b Cr - a Cf) / ((a+b) Cf Cr), rad per m/s^2 at the road wheels; positive = understeer."""
    vehicle = resolve_vehicle(vehicle)
    front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
    return vehicle.mass * vehicle.yaw_stiffness / (vehicle.wheelbase * front * rear)


def static_margin(vehicle: str | Vehicle) -> float:
    """(a Cf - b Cr) / ((a+b)(Cf + Cr)), dimensionless; negative = understeer.

    SAE J670 gives the static margin the opposite sign: positive = understeer.
    """
    vehicle = resolve_vehicle(vehicle)
    total = vehicle.front_cornering_stiffness + vehicle.rear_cornering_stiffness
    return (0.0 - vehicle.yaw_stiffness) / (vehicle.wheelbase * total)  # not -0 for a neutral car


def tangent_speed(vehicle: str | Vehicle) -> float:
    """The speed at which the steady sideslip of a turn changes sign, sqrt(b (a+b) Cr / (a m)), m/s."""
    vehicle = resolve_vehicle(vehicle)
    b_over_a = vehicle.cg_to_rear / vehicle.cg_to_front
    return math.sqrt(b_over_a * vehicle.wheelbase * vehicle.rear_cornering_stiffness / vehicle.mass)


def stability_criterion(vehicle: str | Vehicle, speed: float) -> float:
    """Left side of (6.14), (a+b)^2 Cf Cr / U^2 + m (b Cr - a Cf), N^2 m^2 s^2/m^2: positive = stable.

    Raises ValueError or TypeError for a speed that is not positive and finite.
    """
    vehicle = resolve_vehicle(vehicle)
    speed = positive("speed", speed)
    return float(linear_laws.criterion(vehicle, speed, vehicle.yaw_stiffness))


def is_stable(vehicle: str | Vehicle, speed: float) -> bool:
    """Whether straight running at a speed [m/s] is asymptotically stable; False exactly at the limit."""
    return stability_criterion(vehicle, speed) > 0.0


def state_matrix(vehicle: str | Vehicle, speed: float) -> NDArray[np.float64]:
    """A (2, 2), body-fixed (6.22)-(6.24), state (lateral_velocity, yaw_rate). Raises as :func:`stability_criterion`."""
    return linear_single_track.state_matrix(resolve_vehicle(vehicle), positive("speed", speed))


def input_matrix(vehicle: str | Vehicle, speed: float) -> NDArray[np.float64]:
    """B (2, 2), body-fixed (6.22)-(6.24), inputs (front_steer, rear_steer). Raises as :func:`stability_criterion`."""
    positive("speed", speed)
    return linear_single_track.input_matrix(resolve_vehicle(vehicle))


def characteristic_polynomial(vehicle: str | Vehicle, speed: float, coordinates: str = "body") -> NDArray[np.float64]:
    """Coefficients, highest power first, leading m Iz: Delta(s) of (6.27), or s^2 Delta(s) of (6.10)-(6.12).

    Raises ValueError or TypeError for a bad speed or coordinates other than "body" and "inertial".
    """
    choice("coordinates", coordinates, COORDINATES)
    vehicle = resolve_vehicle(vehicle)
    body = np.array(linear_laws.characteristic(vehicle, positive("speed", speed), vehicle.yaw_stiffness))
    return body if coordinates == "body" else np.append(body, [0.0, 0.0])


def eigenvalues(vehicle: str | Vehicle, speed: float, coordinates: str = "body") -> NDArray[np.complex128]:
    """Eigenvalues of straight running, 1/s: 2 in body-fixed coordinates; with two zeros added in inertial ones.

    Raises as :func:`characteristic_polynomial`.
    """
    choice("coordinates", coordinates, COORDINATES)
    body = np.linalg.eigvals(state_matrix(vehicle, speed)).astype(np.complex128)
    return body if coordinates == "body" else np.append(body, [0.0, 0.0])


def steady_state_gain(
    vehicle: str | Vehicle, speed: float, input: str = "front_steer", output: str = "yaw_rate"
) -> float:
    """Steady response to a constant steer angle, per rad: lateral_velocity, yaw_rate, lateral_acceleration, sideslip.

    Above the critical speed it is the (unstable) equilibrium's value. Raises ValueError or TypeError for an unknown
    input or output, a bad speed, or a car exactly at its critical speed, where there is no such equilibrium.
    """
    column = ("front_steer", "rear_steer").index(choice("input", input, ("front_steer", "rear_steer")))
    choice("output", output, ("lateral_velocity", "yaw_rate", "lateral_acceleration", "sideslip"))
    if stability_criterion(vehicle, speed) == 0.0:
        raise ValueError(f"speed must differ from the critical speed {critical_speed(vehicle):g} m/s, got {speed:g}")
    state = -np.linalg.solve(state_matrix(vehicle, speed), input_matrix(vehicle, speed)[:, column])
    gains = {
        "lateral_velocity": state[0],
        "yaw_rate": state[1],
        "lateral_acceleration": state[1] * speed,
        "sideslip": state[0] / speed,
    }
    return float(gains[output])


class Modes(NamedTuple):
    """The two modes of straight running as one second-order system; see :func:`modes`."""

    natural_frequency: float
    """rad/s; NaN for an unstable car, whose modes do not oscillate."""
    damping_ratio: float
    """Dimensionless; above 1 the modes do not oscillate. NaN for an unstable car."""
    time_to_double: float
    """s; infinite for a stable car."""


def modes(vehicle: str | Vehicle, speed: float) -> Modes:
    """Natural frequency and damping from Delta(s) of (6.27). Raises as :func:`stability_criterion`."""
    leading, damping, constant = characteristic_polynomial(vehicle, speed)
    frequency = math.sqrt(constant / leading) if constant > 0.0 else math.nan
    ratio = damping / (2.0 * leading * frequency) if constant > 0.0 else math.nan
    return Modes(frequency, float(ratio), stability(vehicle, speed).time_to_double)


def classification(vehicle: str | Vehicle) -> str:
    """The words "understeer" (6.15), "oversteer" (6.16) or "neutral", by ``Vehicle.yaw_stiffness``."""
    balance = resolve_vehicle(vehicle).yaw_stiffness
    return "understeer" if balance > 0.0 else "oversteer" if balance < 0.0 else "neutral"


class Stability(NamedTuple):
    """``env.unwrapped.stability``: straight running without steering."""

    critical_speed: float
    """m/s, infinite if there is none."""
    speed_ratio: float
    """speed / critical_speed; 0 if there is none."""
    eigenvalues: Any
    """(2,) complex, 1/s; (4,) on tires that relax."""
    time_to_double: float
    """s in which the fastest growing deviation doubles; infinite for a stable car."""


def stability(vehicle: str | Vehicle, speed: float, relaxation_length: float | None = None) -> Stability:
    """Gather the open-loop figures, on tires that relax over a length [m] if given. Raises as the ones above.

    The critical speed does not depend on the relaxation: there a steady turn needs no steering.
    """
    if relaxation_length is None:
        values, stable = eigenvalues(vehicle, speed), is_stable(vehicle, speed)
    else:
        checked = resolve_vehicle(vehicle), checked_speed(speed), in_range("relaxation_length", relaxation_length)
        values = np.asarray(np.linalg.eigvals(linear_single_track.straight_running(*checked)), np.complex128)
        stable = bool(np.max(values.real) < 0.0)
    growth = 0.0 if stable else float(np.max(values.real))
    critical = critical_speed(vehicle)
    return Stability(critical, speed / critical, values, math.log(2.0) / growth if growth > 0.0 else math.inf)
