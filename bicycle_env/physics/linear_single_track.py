"""The linear single-track model in body-fixed coordinates, (6.22)-(6.24): V' and r' from V, r and both steer angles.

It is also the linearisation of every tire law and geometry of the package at straight running.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bicycle_env.physics.vehicle import Vehicle

Matrix = NDArray[np.float64]


def state_matrix(vehicle: Vehicle, speed: float) -> Matrix:
    """A (2, 2) of (6.24) for the state (lateral_velocity [m/s], yaw_rate [rad/s]) at a speed [m/s]."""
    m, inertia = vehicle.mass, vehicle.yaw_inertia
    a, b = vehicle.cg_to_front, vehicle.cg_to_rear
    front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
    coupling = a * front - b * rear
    return np.array(
        [
            [-(front + rear) / (m * speed), -coupling / (m * speed) - speed],
            [-coupling / (inertia * speed), -(a * a * front + b * b * rear) / (inertia * speed)],
        ]
    )


def input_matrix(vehicle: Vehicle) -> Matrix:
    """B (2, 2) for the inputs (front_steer, rear_steer) [rad]; it does not depend on the speed."""
    m, inertia = vehicle.mass, vehicle.yaw_inertia
    a, b = vehicle.cg_to_front, vehicle.cg_to_rear
    front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
    return np.array([[front / m, rear / m], [a * front / inertia, -b * rear / inertia]])


def fastest_rate(vehicle: Vehicle, speed: float) -> float:
    """Largest |eigenvalue| of the state matrix, 1/s."""
    return float(np.max(np.abs(np.linalg.eigvals(state_matrix(vehicle, speed)))))
