"""The linear model of one control step: what the environments integrate, linearised at straight running."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.physics.actuators import Actuator
from bicycle_env.physics.linear_single_track import input_matrix, relaxed_matrices, state_matrix
from bicycle_env.physics.vehicle import Vehicle

STATE_NAMES = ("lateral_position", "heading", "lateral_velocity", "yaw_rate", "front_steer", "rear_steer")
RELAXED_NAMES = (*STATE_NAMES, "front_transient_slip_angle", "rear_transient_slip_angle")


class LinearModel(NamedTuple):
    """x_{k+1} = A x_k + B u_k with stage cost x'Qx + u'Ru; u is the ACTION, in [-1, 1].

    n = 6 states, or 8 on tires that relax.
    """

    A: NDArray[np.float64]
    """(n, n)."""
    B: NDArray[np.float64]
    """(n, number of steered axles)."""
    Q: NDArray[np.float64]
    """(n, n), diagonal."""
    R: NDArray[np.float64]
    """(steered axles, steered axles), diagonal."""
    timestep: float
    """Control timestep, s; 0 where the model is x' = A x + B u, in continuous time."""
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    input_scale: NDArray[np.float64]
    """Commanded road-wheel angle per unit of action, rad: divide the columns of B by it for inputs in rad."""


def continuous_model(
    vehicle: Vehicle,
    speed: float,
    actuators: tuple[Actuator, Actuator],
    relaxation_length: float | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A (6, 6) and B (6, 2) of x' = A x + B u for the states ``STATE_NAMES``; u: commanded angles (front, rear), rad.

    Lateral position by y' = V + U psi, steer angles by their first-order lags; no limits. With a relaxation length [m]
    (8, 8) and (8, 2) for ``RELAXED_NAMES``.
    """
    size = len(STATE_NAMES if relaxation_length is None else RELAXED_NAMES)
    a, b = np.zeros((size, size)), np.zeros((size, 2))
    a[0, 1], a[0, 2], a[1, 3] = speed, 1.0, 1.0
    if relaxation_length is None:
        a[2:4, 2:4], a[2:4, 4:6] = state_matrix(vehicle, speed), input_matrix(vehicle)
    else:
        body = [2, 3, 6, 7]
        a[np.ix_(body, body)], a[np.ix_(body, [4, 5])] = relaxed_matrices(vehicle, speed, relaxation_length)
    for k, actuator in enumerate(actuators):
        a[4 + k, 4 + k] = -1.0 / actuator.time_constant
        b[4 + k, k] = 1.0 / actuator.time_constant
    return a, b


def rk4_map(
    a: NDArray[np.float64], b: NDArray[np.float64], timestep: float, substeps: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(A, B) of the map that `substeps` RK4 steps make of x' = a x + b u with u held: exact, not the exponential."""
    n, inputs = b.shape
    z = np.zeros((n + inputs, n + inputs))
    z[:n, :n], z[:n, n:] = a, b
    z *= timestep / substeps
    one_step = np.eye(n + inputs) + z @ (
        np.eye(n + inputs) + z / 2 @ (np.eye(n + inputs) + z / 3 @ (np.eye(n + inputs) + z / 4))
    )
    whole: Any = np.linalg.matrix_power(one_step, substeps)
    return whole[:n, :n], whole[:n, n:]
