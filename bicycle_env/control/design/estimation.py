"""Sideslip is not measured in a car: a Kalman filter finds it from the yaw rate and the lateral acceleration.

    x = (V, r)      z = (r, V' + U r) = C x + D delta + noise      (6.22), (6.23)

The accelerometer feels the steer angles at once (D), and whatever pushes the car sideways beside the linear tires:
the disturbance is in the measurement too, so its correlation with the process noise enters the Riccati equation.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.analysis.stability import input_matrix, state_matrix
from bicycle_env.control.design.gains import zero_order_hold
from bicycle_env.control.policy import Plant
from bicycle_env.control.rows import product
from bicycle_env.physics.car import CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY

Matrix = NDArray[np.float64]

MEASURED = ("yaw_rate", "lateral_acceleration")


class Noise(NamedTuple):
    """Standard deviations of the two sensors, per sample.

    0.1 deg/s: the resolution of the Bosch MM7.10 (data sheet), and what the chip of the Bosch CISS (0.014 deg/s per
    root Hz, manual) makes of a bandwidth of 50 Hz. That chip's accelerometer, 120 ug per root Hz, would be good for
    0.008 m/s^2; what a car's body shakes by itself is more, and 0.1 m/s^2 is assumed.
    """

    yaw_rate: float = math.radians(0.1)
    """rad/s."""
    lateral_acceleration: float = 0.1
    """m/s^2."""


class Disturbance(NamedTuple):
    """Standard deviations of what pushes the car beside its tires, constant for a control step and then drawn anew.

    0.1 m/s^2 is a gust of 150 N on a car of 1500 kg. Saturated tires miss the linear ones by far more and for long in
    one direction, which no white disturbance describes: a larger value does not make the filter better there, it makes
    it integrate the accelerometer and keep a wrong start for seconds.
    """

    lateral_acceleration: float = 0.1
    """m/s^2."""
    yaw_acceleration: float = 0.1
    """rad/s^2."""


class KalmanFilter:
    """The steady-state filter of x+ = A x + B u + w, z = C x + D u + v, with E ww' = Q, vv' = R, wv' = S.

    ``gain`` M of the update x + M (z - C x - D u); ``predictor_gain`` L of x+ = A x + B u + L (z - C x - D u), whose
    error goes with A - L C; ``covariance`` P of the prediction's error; ``innovation_covariance`` C P C' + R.
    All arrays of states, inputs and measurements are (..., n).

    Raises:
        numpy.linalg.LinAlgError: there is no stabilising solution, e.g. where an unstable state is not measured.
    """

    def __init__(
        self, A: Matrix, B: Matrix, C: Matrix, D: Matrix, Q: Matrix, R: Matrix, S: Matrix | None = None
    ) -> None:
        self.A, self.B, self.C, self.D = A, B, C, D
        cross = np.zeros((len(A), len(C))) if S is None else S
        self.covariance: Matrix = scipy.linalg.solve_discrete_are(A.T, C.T, Q, R, s=cross)
        self.innovation_covariance: Matrix = C @ self.covariance @ C.T + R
        inverse = np.linalg.inv(self.innovation_covariance)
        self.gain: Matrix = self.covariance @ C.T @ inverse
        self._correction: Matrix = cross @ inverse  # the disturbance that the innovation tells of, in the next state
        self.predictor_gain: Matrix = A @ self.gain + self._correction

    def innovation(self, state: Matrix, known: Matrix, measured: Matrix) -> Matrix:
        """What a measurement tells that the predicted state did not: z - C x - D u."""
        difference: Matrix = measured - product(state, self.C.T) - product(known, self.D.T)
        return difference

    def update(self, state: Matrix, innovation: Matrix) -> Matrix:
        """The estimate now, from the predicted state and the innovation."""
        estimate: Matrix = state + product(innovation, self.gain.T)
        return estimate

    def predict(self, estimate: Matrix, innovation: Matrix, known: Matrix) -> Matrix:
        """The state predicted for the next step, from the estimate, its innovation and the inputs."""
        state: Matrix = product(estimate, self.A.T) + product(known, self.B.T) + product(innovation, self._correction.T)
        return state

    def first(self, known: Matrix, measured: Matrix) -> Matrix:
        """The state that a first measurement alone tells of, least squares: where nothing is known before."""
        state: Matrix = product(measured - product(known, self.D.T), np.linalg.pinv(self.C).T)
        return state


def sideslip_filter(plant: Plant, noise: Noise | None = None, disturbance: Disturbance | None = None) -> KalmanFilter:
    """The filter of (lateral_velocity, yaw_rate) from ``MEASURED``.

    Its known inputs are (front_steer, rear_steer) as sensors give them, and the actions of the steered axles, which
    move the steer angles within the step.
    """
    noise = Noise() if noise is None else noise
    disturbance = Disturbance() if disturbance is None else disturbance
    model, body = plant.linear_model(quasi_static=True), slice(2, 4)
    A = model.A[body, body]
    B = np.hstack([model.A[body, 4:6], model.B[body]])
    # z: the yaw rate, and V' + U r of (6.22) with what disturbs it
    continuous, steering = state_matrix(plant.vehicle, plant.speed), input_matrix(plant.vehicle, plant.speed)
    C = np.array([[0.0, 1.0], continuous[0] + [0.0, plant.speed]])
    D = np.zeros((2, B.shape[1]))
    D[1, :2] = steering[0]
    pushes = np.diag(np.square(disturbance))
    _, into_state = zero_order_hold(continuous, np.eye(2), model.timestep)
    into_sensors = np.array([[0.0, 0.0], [1.0, 0.0]])
    return KalmanFilter(
        A,
        B,
        C,
        D,
        Q=into_state @ pushes @ into_state.T,
        R=into_sensors @ pushes @ into_sensors.T + np.diag(np.square(noise)),
        S=into_state @ pushes @ into_sensors.T,
    )


class MeasuredSignals:
    """Plays the yaw-rate sensor and the accelerometer of a simulated car, by the package's own tires and geometry.

    Args:
        plant: the car.
        noise: standard deviations; none by default.
        seed: of the noise.
    """

    def __init__(self, plant: Plant, noise: Noise | None = None, seed: int = 0) -> None:
        self._model = plant.model.quasi_static
        self._axles = self._model.axles(NUMPY)
        actuators = plant.front_actuator, plant.rear_actuator
        self._car = car_on_road(plant.vehicle, plant.speed, plant.friction, *actuators)
        self._noise = None if noise is None else np.array(noise)
        self._generator = np.random.default_rng(seed)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_axles"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._axles = self._model.axles(NUMPY)

    def read(self, states: Matrix) -> Matrix:
        """(cars, 2), ``MEASURED``, from true states (cars, 6) in the order of ``STATE_NAMES``."""
        named: dict[str, Any] = dict(zip(STATE_NAMES, states.T, strict=True))
        state = CarState(longitudinal_position=np.zeros(len(states)), **named)
        exact = np.stack([state.yaw_rate, self._axles(state, self._car).lateral_acceleration], axis=1)
        if self._noise is None:
            return exact
        noisy: Matrix = exact + self._noise * self._generator.standard_normal(exact.shape)
        return noisy
