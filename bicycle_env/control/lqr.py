"""Linear-quadratic regulators: gains from scipy's Riccati solvers, and a policy for tasks with and without preview."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
import scipy.interpolate
import scipy.linalg
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.control.policy import Array, Plant, Policy

Matrix = NDArray[np.float64]


def continuous_gain(A: Matrix, B: Matrix, Q: Matrix, R: Matrix) -> Matrix:
    """K (inputs, states) of u = -K x that minimises the integral of x'Qx + u'Ru along x' = A x + B u."""
    P = scipy.linalg.solve_continuous_are(A, B, Q, R)
    return np.linalg.solve(np.atleast_2d(R), B.T @ P)


def discrete_gain(A: Matrix, B: Matrix, Q: Matrix, R: Matrix) -> tuple[Matrix, Matrix]:
    """K of u = -K x that minimises the sum of x'Qx + u'Ru along x+ = A x + B u, and P: the least cost is x'Px."""
    P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    K: Any = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    return K, P


def preview_gain(A: Matrix, B: Matrix, Q: Matrix, R: Matrix, reference: Matrix, horizon: int) -> tuple[Matrix, Matrix]:
    """Gains of u = -K x - G w for the cost (x - M w)'Q(x - M w) + u'Ru with a previewed signal w.

    Discrete-time optimal preview control (M. Tomizuka, J. Dyn. Syst. Meas. Control 97, 1975; for cars R. S. Sharp and
    V. Valtetsiotis, Vehicle System Dynamics Suppl. 35, 2001). w holds the signal now and in the next `horizon` steps;
    it moves up one place a step and its last value is held.

    Args:
        reference: M, (states, horizon + 1), the wanted state as a linear function of w.
        horizon: how many future values are known.

    Returns:
        K (inputs, states) and G (inputs, horizon + 1).
    """
    K, P = discrete_gain(A, B, Q, R)
    shift = np.eye(horizon + 1, k=1)
    shift[-1, -1] = 1.0
    closed = (A - B @ K).T
    # S of the cross term 2 x'Sw in the cost to go: S = (A - BK)' S D - Q M. The loop is a contraction.
    S = np.zeros((len(A), horizon + 1))
    for _ in range(100_000):
        new = closed @ S @ shift - Q @ reference
        if np.max(np.abs(new - S)) <= 1e-12 * np.max(np.abs(new)):
            break
        S = new
    G: Any = np.linalg.solve(R + B.T @ P @ B, B.T @ S @ shift)
    return K, G


class Weights(NamedTuple):
    """Diagonal weights of the design, each the inverse square of a size that matters as much as the others."""

    lateral_position: float
    heading: float
    sideslip: float
    yaw_rate: float
    front_command: float
    rear_command: float


def tuned_weights(task_name: str) -> Weights:
    """The weights that agents/tune_lqr.py found for a task."""
    text = resources.files("bicycle_env.control").joinpath("lqr_weights.json").read_text()
    return Weights(**json.loads(text)[task_name]["weights"])


class LQR(Policy):
    """Discrete LQR on the full state, with optimal preview where the task shows the path ahead.

    It is designed for the environment that it is given (its vehicle, speed, actuators, control timestep), linearised
    at straight running, without any limit; its action is clipped. ``weights`` defaults to the tuned ones of the task.
    Attributes: ``gain`` (axles, 6) on the states ``STATE_NAMES``, ``preview`` (axles, points) on the lateral
    distances to the path, now and at the preview times, and the ``model`` that it was designed for.
    """

    name = "lqr"

    def __init__(self, plant: Plant, weights: Weights | None = None) -> None:
        weights = tuned_weights(plant.task.name) if weights is None else weights
        self.model = plant.linear_model()
        speed, timestep = plant.speed, self.model.timestep
        Q = np.diag(
            [weights.lateral_position, weights.heading, weights.sideslip / speed**2, weights.yaw_rate, 0.0, 0.0]
        )
        commands = {"front_steer_command": weights.front_command, "rear_steer_command": weights.rear_command}
        R = np.diag([commands[name] for name in self.model.input_names])

        times = np.array([0.0, *plant.task.preview_times])
        horizon = max(2, round(times[-1] / timestep))
        self.gain, gain = preview_gain(
            self.model.A, self.model.B, Q, R, _wanted(speed * timestep, timestep, horizon), horizon
        )
        self.preview = gain @ _spline(times, np.arange(horizon + 1) * timestep)

        # One matrix from the scaled observation to the action: distances are relative, so y itself drops out.
        names, scale = plant.observation_names, plant.observation_scale
        self._matrix = np.zeros((len(names), len(self.model.input_names)))
        for j, state in enumerate(STATE_NAMES[1:], start=1):
            self._matrix[names.index(state)] -= self.gain[:, j]
        error = "lateral_error" if "lateral_error" in names else "lateral_position"
        self._matrix[names.index(error)] += self.preview[:, 0]
        if len(times) > 1:
            self._matrix[-(len(times) - 1) :] -= self.preview[:, 1:].T
        self._matrix *= scale[:, None]

    def act(self, observation: Array) -> NDArray[np.float32]:
        action: Any = np.clip(observation @ self._matrix, -1.0, 1.0)
        return np.asarray(action, np.float32)


def _wanted(step_length: float, timestep: float, horizon: int) -> Matrix:
    """M (6, horizon + 1): lateral position, heading and yaw rate of the path, by differences of its positions."""
    wanted = np.zeros((len(STATE_NAMES), horizon + 1))
    wanted[0, 0] = 1.0
    wanted[1, :2] = np.array([-1.0, 1.0]) / step_length
    wanted[3, :3] = np.array([1.0, -2.0, 1.0]) / (step_length * timestep)
    return wanted


def _spline(times: Matrix, grid: Matrix) -> Matrix:
    """(grid, times): interpolation as a matrix, the last value held."""
    if len(times) == 1:
        return np.ones((len(grid), 1))
    if len(times) == 2:
        share = np.clip(grid / times[1], 0.0, 1.0)
        return np.stack([1.0 - share, share], axis=1)
    spline = scipy.interpolate.CubicSpline(times, np.eye(len(times)), bc_type="natural")
    matrix: Matrix = spline(np.minimum(grid, times[-1]))
    return matrix
