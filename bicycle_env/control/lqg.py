"""LQG: the regulator's gain on an estimate, where the sideslip is not measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.control.design.estimation import MEASURED, Disturbance, MeasuredSignals, Noise, sideslip_filter
from bicycle_env.control.design.observation_map import Reading
from bicycle_env.control.lqr import WeightedPolicy, Weights, design_model, discrete_design
from bicycle_env.control.policy import Array, Plant
from bicycle_env.control.remembered import Remembered
from bicycle_env.control.rows import product

Matrix = NDArray[np.float64]

BODY, STEER = slice(2, 4), slice(4, 6)
WITHOUT_SIDESLIP = tuple(name for name in STATE_NAMES[1:] if name != "lateral_velocity")


class LQG(WeightedPolicy):
    """LQR on what a car can measure: a Kalman filter finds the sideslip from yaw rate and lateral acceleration.

    Lateral position, heading and the path ahead are a lane camera's, the road-wheel angles the steering's own sensors';
    they are taken as they are. The lateral velocity of the observation never reaches the estimate: it only serves to
    compute what an accelerometer in the simulated car would read (``control.design.estimation.MeasuredSignals``).
    Where the observation itself has a lateral acceleration (``sensors=Sensors(signals=...)``) that one is taken, and no
    lateral velocity is needed: so gusts and another road are in the measurement.
    The filter is linear as the LQR is, and starts from what the first measurement says. It remembers: call ``reset``
    when an episode starts.

    Attributes: ``model``, ``gain``, ``preview`` of the LQR, and ``filter``.

    Args:
        weights: of the LQR, by default the tuned ones of the task.
        noise: what the filter expects of the sensors.
        disturbance: what the filter expects of the road, the wind and the tires' saturation.
        sensor_noise: what the simulated sensors have; none by default.
        seed: of the sensors' noise.
    """

    name = "lqg"

    def __init__(
        self,
        plant: Plant,
        weights: Weights | None = None,
        noise: Noise | None = None,
        disturbance: Disturbance | None = None,
        sensor_noise: Noise | None = None,
        seed: int = 0,
    ) -> None:
        self.model = design_model(plant, None)
        self.gain, self.preview = discrete_design(plant, self.model, plant.speed, weights)
        self.filter = sideslip_filter(plant, noise, disturbance)
        names = list(plant.observation_names)
        self._measured = [names.index(name) for name in MEASURED] if set(MEASURED) <= set(names) else None
        self._reading = Reading(plant, STATE_NAMES[1:] if self._measured is None else WITHOUT_SIDESLIP)
        self.sensor_noise = sensor_noise
        self._sensors = MeasuredSignals(getattr(plant, "driven", plant), sensor_noise, seed)
        self._remembered = Remembered(3)  # predicted lateral velocity and yaw rate; 1 once there is a prediction

    @property
    def memory(self) -> Remembered:
        return self._remembered

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self._remembered.reset(rows)

    def act(self, observation: Array) -> NDArray[np.float32]:
        cars = np.atleast_2d(np.asarray(observation, np.float64)) * self._reading.scale
        remembered = self._remembered.of(len(cars))
        states = product(cars, self._reading.state)
        steer, measured = states[:, STEER], self._measure(cars, states)
        at_rest = np.concatenate([steer, np.zeros((len(cars), len(self.gain)))], axis=1)  # D knows no action
        predicted = np.where(remembered[:, 2:] > 0.0, remembered[:, :2], self.filter.first(at_rest, measured))
        innovation = self.filter.innovation(predicted, at_rest, measured)
        estimate = self.filter.update(predicted, innovation)

        known = states.copy()
        known[:, BODY] = estimate
        ahead = product(cars, self._reading.path)
        action = np.clip(-product(known, self.gain.T) - product(ahead, self.preview.T), -1.0, 1.0)
        remembered[:, :2] = self.filter.predict(estimate, innovation, np.concatenate([steer, action], axis=1))
        remembered[:, 2] = 1.0
        return np.asarray(action, np.float32).reshape(*np.shape(observation)[:-1], len(self.gain))

    def _measure(self, cars: Matrix, states: Matrix) -> Matrix:
        """(cars, 2), ``MEASURED``."""
        return self._sensors.read(states) if self._measured is None else cars[:, self._measured]
