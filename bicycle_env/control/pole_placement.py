"""Pole placement on the full state, with wanted poles that follow from the car's own."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.analysis.stability import eigenvalues, input_matrix, state_matrix
from bicycle_env.control.design.gains import pole_placement_gain
from bicycle_env.control.design.path import path_ahead
from bicycle_env.control.lqr import StateFeedback
from bicycle_env.control.policy import Plant
from bicycle_env.control.tunable import ArgumentPolicy, Parameter
from bicycle_env.physics.validation import number, positive

Matrix = NDArray[np.float64]

PATH_FREQUENCY = 2.0
"""rad/s; how fast the car returns to its path, below the body's own modes."""
LEAST_DAMPING = 0.7


class PolePlacement(StateFeedback, ArgumentPolicy):
    """Pole placement: unstable modes reflected, badly damped ones damped, the actuators left as they are.

    The wanted poles come from the open loop (:func:`wanted_poles`) and are placed on the discrete model, at
    z = exp(s x control timestep). On a path the car is held in the steady turn of the path's curvature: its sideslip,
    yaw rate and steer angles there are the states that the feedback counts from, and the steer angles are commanded
    ahead by the actuators' lag.

    Attributes: ``poles`` (states that can be steered,), 1/s, and those of :class:`StateFeedback`.

    Args:
        path_frequency: natural frequency of the two poles that lateral position and heading get, rad/s.
        least_damping: of any pole pair, in (0, 1].

    Raises:
        ValueError, TypeError: an argument out of range.
    """

    name = "pole-placement"
    parameters = (
        Parameter("path_frequency", 0.1, 20.0, PATH_FREQUENCY, 0.2, scale="log"),
        Parameter("least_damping", 0.1, 1.0, LEAST_DAMPING, 0.15),
    )

    def __init__(
        self, plant: Plant, path_frequency: float = PATH_FREQUENCY, least_damping: float = LEAST_DAMPING
    ) -> None:
        model = plant.linear_model(quasi_static=True)
        self.poles = wanted_poles(plant, path_frequency, least_damping)
        # The actuator of an axle that is not steered stays where it is: no gain reaches it.
        steered = [f"{axle}_steer" for axle in ("front", "rear") if f"{axle}_steer_command" in model.input_names]
        states = [k for k, name in enumerate(STATE_NAMES) if not name.endswith("_steer") or name in steered]
        gain = np.zeros((len(model.input_names), len(STATE_NAMES)))
        # Two axles leave a choice of eigenvectors. scipy takes the best conditioned ones, so sizes must be comparable.
        size = np.array([plant.observation_scale[plant.observation_names.index(STATE_NAMES[k])] for k in states])
        A, B = model.A[np.ix_(states, states)] * size / size[:, None], model.B[states] / size[:, None]
        gain[:, states] = pole_placement_gain(A, B, np.exp(self.poles * model.timestep)) / size
        states_on_path, actions_on_path = steady_turn(plant)
        super().__init__(plant, model, gain, states_on_path @ gain.T + actions_on_path)


def wanted_poles(plant: Plant, path_frequency: float, least_damping: float) -> NDArray[np.complex128]:
    """The poles, 1/s: two of the path, two of the body, one of each steered actuator.

    The body's poles are the open loop's with the unstable ones reflected at the imaginary axis, where the LQR that
    spares its inputs would put them (Kwakernaak and Sivan, Linear Optimal Control Systems, 1972, section 3.8), none
    slower than the path's, and none less damped than asked for. Real poles that coincide are moved apart by 5 %.
    """
    path_frequency = positive("path_frequency", path_frequency)
    damping = number("least_damping", least_damping, high=1.0, above=0.0)
    body = []
    for pole in eigenvalues(plant.vehicle, plant.speed):
        frequency = max(abs(pole), path_frequency)
        ratio = max(abs(pole.real) / abs(pole), damping) if pole.imag else 1.0
        body.append(frequency * complex(-ratio, math.copysign(math.sqrt(1.0 - ratio**2), pole.imag)))
    pair = path_frequency * complex(-damping, math.sqrt(1.0 - damping**2))
    actuators = {"front": plant.front_actuator, "rear": plant.rear_actuator}
    lags = [-1.0 / actuator.time_constant for axle, actuator in actuators.items() if plant.steer in (axle, "both")]
    poles = np.array([pair, pair.conjugate(), *body, *lags])
    for k in range(1, len(poles)):
        while np.any(np.abs(poles[:k] - poles[k]) < 0.02 * abs(poles[k])):
            poles[k] *= 1.05
    return poles


def steady_turn(plant: Plant) -> tuple[Matrix, Matrix]:
    """The linear car on the path: maps from the observation to its states (entries, 6) and actions (entries, axles).

    Yaw rate and course follow from the path's derivatives; sideslip and steer angles are those of the steady turn
    with that yaw rate, with both axles steered the ones of least squares.
    """
    model, speed = plant.linear_model(quasi_static=True), plant.speed
    axles = [("front_steer_command", "rear_steer_command").index(name) for name in model.input_names]
    A, B = state_matrix(plant.vehicle, speed), input_matrix(plant.vehicle, speed)[:, axles]
    # 0 = A [V, r]' + B steer, for r = 1, in the unknowns sideslip V/U and steer
    turn: Any = np.linalg.lstsq(np.column_stack([A[:, 0] * speed, B]), -A[:, 1], rcond=None)[0]
    sideslip, steer = float(turn[0]), turn[1:]

    position, drift, acceleration = (path_ahead(plant, np.zeros(1), derivative)[:, 0] for derivative in range(3))
    yaw_rate = acceleration / speed
    states = np.zeros((len(position), len(STATE_NAMES)))
    states[:, 0] = position
    states[:, 1] = drift / speed - sideslip * yaw_rate  # y' = V + U psi
    states[:, 2] = speed * sideslip * yaw_rate
    states[:, 3] = yaw_rate
    actions = np.zeros((len(position), len(axles)))
    actuators = (plant.front_actuator, plant.rear_actuator)
    for column, axle in enumerate(axles):
        states[:, 4 + axle] = steer[column] * yaw_rate
        lead = np.array([actuators[axle].time_constant + 0.5 * model.timestep])
        actions[:, column] = steer[column] * path_ahead(plant, lead, 2)[:, 0] / speed / model.input_scale[column]
    return states, actions
