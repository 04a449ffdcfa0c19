"""The inertial (fourth-order) formulation of straight running, Karnopp, Vehicle Stability, (6.1)-(6.12)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.validation import positive
from bicycle_env.physics.vehicle import Vehicle


class InertialMatrices(NamedTuple):
    """M q'' + C q' + K q = 0 with q = (lateral_position, heading), each (2, 2)."""

    mass: NDArray[np.float64]
    damping: NDArray[np.float64]
    stiffness: NDArray[np.float64]


def inertial_matrices(vehicle: str | Vehicle, speed: float) -> InertialMatrices:
    """Mass, damping and stiffness matrices of (6.9). Raises ValueError or TypeError for a bad vehicle or speed."""
    vehicle = resolve_vehicle(vehicle)
    speed = positive("speed", speed)
    a, b = vehicle.cg_to_front, vehicle.cg_to_rear
    front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
    total, coupling = front + rear, a * front - b * rear
    return InertialMatrices(
        np.diag([vehicle.mass, vehicle.yaw_inertia]),
        np.array([[total, coupling], [coupling, a * a * front + b * b * rear]]) / speed,
        np.array([[0.0, -total], [0.0, -coupling]]),
    )


def inertial_state_matrix(vehicle: str | Vehicle, speed: float) -> NDArray[np.float64]:
    """(4, 4): first-order form of (6.9) for (lateral_position, heading) and their rates in the inertial frame."""
    matrices = inertial_matrices(vehicle, speed)
    state = np.zeros((4, 4))
    state[:2, 2:] = np.eye(2)
    state[2:, :2] = -np.linalg.solve(matrices.mass, matrices.stiffness)
    state[2:, 2:] = -np.linalg.solve(matrices.mass, matrices.damping)
    return state


class WheelSlips(NamedTuple):
    """Slip angles of the four wheels, rad; arrays of the inputs' common shape."""

    front_left: Any
    front_right: Any
    rear_left: Any
    rear_right: Any


def wheel_slip_angles(
    vehicle: str | Vehicle, speed: float, lateral_rate: Any, heading: Any, yaw_rate: Any
) -> WheelSlips:
    """Slip angles of four unsteered wheels in inertial coordinates, not linearised: (6.1)-(6.5) with half-tracks.

    Args:
        vehicle: a preset's name or a Vehicle; gives the axle distances and half-tracks.
        speed: U, m/s, along the road; it is the speed in the INERTIAL x direction here, as in (6.1).
        lateral_rate: y', m/s, inertial frame. This and the next two broadcast.
        heading: psi, rad.
        yaw_rate: psi', rad/s.

    Returns:
        Arctangent of lateral over rolling velocity of each wheel. To first order the half-tracks drop out: left and
        right share the slip angle of (6.3) in front and of (6.5), (6.5a) at the rear. What remains is, to second order,
        ``half_track yaw_rate / speed`` times that slip angle, added on the left and subtracted on the right; the mean
        of the two, which is the axle's force, differs from the book's in third order only.
    """
    vehicle = resolve_vehicle(vehicle)
    speed = positive("speed", speed)
    sine, cosine = np.sin(heading), np.cos(heading)
    rolling = speed * cosine + lateral_rate * sine
    sideways = lateral_rate * cosine - speed * sine

    def slip(arm: float, half_track: float) -> Any:
        return np.arctan2(sideways + arm * yaw_rate, rolling - half_track * yaw_rate)

    return WheelSlips(
        slip(vehicle.cg_to_front, vehicle.front_half_track),
        slip(vehicle.cg_to_front, -vehicle.front_half_track),
        slip(-vehicle.cg_to_rear, vehicle.rear_half_track),
        slip(-vehicle.cg_to_rear, -vehicle.rear_half_track),
    )
