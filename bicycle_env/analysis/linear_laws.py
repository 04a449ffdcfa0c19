"""The closed forms of the linear car as laws: of numbers or symbols, so that they can be written out (``export``).

A vehicle is whatever has the fields of a ``Vehicle`` and its ``wheelbase``. Polynomials have their highest power first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any


def criterion(vehicle: Any, speed: Any, yaw_stiffness: Any) -> Any:
    """Left side of (6.14); ``yaw_stiffness``: of ``Vehicle``."""
    front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
    return vehicle.wheelbase * vehicle.wheelbase * front * rear / speed / speed + vehicle.mass * yaw_stiffness


def characteristic(vehicle: Any, speed: Any, yaw_stiffness: Any) -> tuple[Any, Any, Any]:
    """Delta(s) of (6.27), leading m Iz."""
    m, inertia = vehicle.mass, vehicle.yaw_inertia
    a, b = vehicle.cg_to_front, vehicle.cg_to_rear
    front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
    damping = (m * (a * a * front + b * b * rear) + inertia * (front + rear)) / speed
    return m * inertia, damping, criterion(vehicle, speed, yaw_stiffness)


def yaw_rate_feedback(vehicle: Any, speed: Any) -> tuple[Any, Any]:
    """What of Delta(s) grows, per gain [s], where rear wheels are steered by gain x yaw rate: of s, and of 1."""
    front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
    return vehicle.mass * vehicle.cg_to_rear * rear, vehicle.wheelbase * front * rear / speed


def numerator(vehicle: Any, speed: Any, front: bool, output: str) -> tuple[Any, ...]:
    """Of a transfer function over Delta(s); see ``transfer_functions.numerator``. `front`: the axle that steers."""
    m, inertia, wheelbase = vehicle.mass, vehicle.yaw_inertia, vehicle.wheelbase
    both = vehicle.front_cornering_stiffness * vehicle.rear_cornering_stiffness
    # Seen from the steered axle: its stiffness, its arm, the other's arm. The rear axle turns the car the other way.
    stiffness = vehicle.front_cornering_stiffness if front else vehicle.rear_cornering_stiffness
    arm, other_arm = (vehicle.cg_to_front, vehicle.cg_to_rear) if front else (vehicle.cg_to_rear, vehicle.cg_to_front)
    side = 1.0 if front else -1.0
    if output in ("lateral_velocity", "sideslip"):
        constant = wheelbase * other_arm * both / speed - side * m * arm * speed * stiffness
        lateral = (stiffness * inertia, constant)
        return lateral if output == "lateral_velocity" else tuple(value / speed for value in lateral)
    if output in ("yaw_rate", "heading"):
        return side * (m * arm * stiffness), side * (wheelbase * both / speed)
    return stiffness * inertia, wheelbase * other_arm * both / speed, side * wheelbase * both


def roots(xp: Any) -> Callable[..., tuple[tuple[Any, Any], tuple[Any, Any]]]:
    """The law ``(a, b, c) -> ((real, imaginary), (real, imaginary))`` of a x^2 + b x + c, a > 0, the smaller first."""

    def roots(a: Any, b: Any, c: Any) -> Any:
        square = b * b - 4.0 * a * c
        swings = square < 0.0
        root = xp.sqrt(abs(square))
        # The sum that cancels nothing; the other root from the product of both.
        larger = -0.5 * (b + xp.where(b < 0.0, -root, root))
        one = larger / a
        other = xp.where(larger == 0.0, 0.0, c / xp.where(larger == 0.0, 1.0, larger))
        middle, half = -0.5 * b / a, 0.5 * root / a
        first, second = xp.minimum(one, other), xp.maximum(one, other)
        return (
            (xp.where(swings, middle, first), xp.where(swings, -half, 0.0 * half)),
            (xp.where(swings, middle, second), xp.where(swings, half, 0.0 * half)),
        )

    return roots


def frequency_response(top: Sequence[Any], bottom: Sequence[Any], frequency: Any) -> tuple[Any, Any]:
    """(real, imaginary) of top / bottom at s = i x frequency [rad/s]."""
    (x, y), (u, v) = _at(top, frequency), _at(bottom, frequency)
    size = u * u + v * v
    return (x * u + y * v) / size, (y * u - x * v) / size


def _at(polynomial: Sequence[Any], frequency: Any) -> tuple[Any, Any]:
    """By Horner's rule: i w (x + i y) = -w y + i w x."""
    x, y = polynomial[0], 0.0 * polynomial[0]
    for coefficient in polynomial[1:]:
        x, y = coefficient - frequency * y, frequency * x
    return x, y
