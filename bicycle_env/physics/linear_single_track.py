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


def relaxed_matrices(vehicle: Vehicle, speed: float, relaxation_length: float) -> tuple[Matrix, Matrix]:
    """A (4, 4) and B (4, 2) for (lateral_velocity, yaw_rate, front and rear transient slip angle), same inputs.

    The forces are -C beta, and beta' = U / sigma (alpha - beta): :mod:`bicycle_env.physics.relaxed_single_track`.
    """
    a, b = vehicle.cg_to_front, vehicle.cg_to_rear
    matrix, inputs, lag = np.zeros((4, 4)), np.zeros((4, 2)), speed / relaxation_length
    matrix[0, 1] = -speed
    matrix[:2, 2:] = -input_matrix(vehicle)
    matrix[2:, :2] = np.array([[1.0, a], [1.0, -b]]) / relaxation_length
    matrix[2:, 2:], inputs[2:] = -lag * np.eye(2), -lag * np.eye(2)
    return matrix, inputs


def straight_running(vehicle: Vehicle, speed: float, relaxation_length: float | None = None) -> Matrix:
    """The state matrix of small deviations: (2, 2), or (4, 4) on tires that relax over a length [m]."""
    if relaxation_length is None:
        return state_matrix(vehicle, speed)
    return relaxed_matrices(vehicle, speed, relaxation_length)[0]


def fastest_rate(vehicle: Vehicle, speed: float, relaxation_length: float | None = None) -> float:
    """Largest |eigenvalue| of :func:`straight_running`, 1/s."""
    return float(np.max(np.abs(np.linalg.eigvals(straight_running(vehicle, speed, relaxation_length)))))
