"""Laws for the rear wheels while someone else has the steering wheel: BicycleActiveSteer-v0's classical controllers.

They know the nominal car and what the observation shows: with ``observed="state"`` the sideslip, else an observer's.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control.policy import Array, Plant
from bicycle_env.control.remembered import Remembered
from bicycle_env.control.tunable import Parameter, TunableLaw, values_of
from bicycle_env.physics.car import car_on_road
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.tasks.steadiness import reference_yaw_rate

Matrix = NDArray[np.float64]

NEEDED = ("yaw_rate", "lateral_acceleration", "front_steer", "driver_command", "speed", "driver_finished")
SEARCH = {
    "yaw_rate": (0.1, 0.1),
    "sideslip": (0.0, 0.3),
    "front_steer": (0.0, 0.5),
    "driver_command": (0.0, 0.5),
    "reference_yaw_rate": (-0.1, 0.1),
}
"""Of the gains, signal by signal: where a search begins, and how far around it."""
SIGNALS = tuple(SEARCH)
"""What a gain is for; rad, and rad/s with gains in s."""
PHASES = ("first half", "second half", "after")
"""Of the driver's manoeuvre; before it, the first."""
LEAST_SPEED = 1.0
"""m/s."""
FORGETTING = 3.0
"""s in which the observer forgets: what it integrates drifts."""


class SideslipObserver:
    """Integrates V' = (V' + U r) - U r from accelerometer and yaw rate; no tire is in it, saturated or not."""

    def __init__(self, timestep: float) -> None:
        self._timestep = timestep

    def update(self, lateral_velocity: Matrix, acceleration: Matrix, yaw_rate: Matrix, speed: Matrix) -> Matrix:
        """The lateral velocity [m/s] a step later; (cars,) each."""
        rate = acceleration - speed * yaw_rate - lateral_velocity / FORGETTING
        after: Matrix = lateral_velocity + self._timestep * rate
        return after


class RearSteering(TunableLaw):
    """Base: rear steer = gains' signals, clipped; the gains may be others in each phase of the driver's manoeuvre.

    Args:
        plant: an environment that shows ``NEEDED`` and steers its rear wheels; ValueError otherwise.
        gains: (parameters,), see ``matrix``; by default those that come with the package.
    """

    tuned_for: ClassVar[str] = "active_steer"

    def __init__(self, plant: Plant, gains: Any = None) -> None:
        names = list(plant.observation_names)
        missing = [name for name in NEEDED if name not in names]
        if missing:
            raise ValueError(
                f"{self.name!r} needs {', '.join(missing)} in the observation, which has {', '.join(names)}"
            )
        if plant.steer == "front":
            raise ValueError(f"steer must be 'rear' or 'both' for {self.name!r}, got 'front'")
        self.model = plant.linear_model(quasi_static=True)
        self.gains = np.array(
            values_of(type(self), plant, self.usual(plant) or {}) if gains is None else gains, dtype=np.float64
        )
        if self.gains.shape != (len(self.parameters),):
            raise ValueError(f"gains must be {len(self.parameters)} numbers, got shape {self.gains.shape}")
        self.values, self._matrix = self.gains, self.matrix(self.gains)
        self._places = {name: names.index(name) for name in (*NEEDED, "sideslip") if name in names}
        self._scale = plant.observation_scale
        self._axles, self._limit = plant.action_space.shape[-1], plant.rear_actuator.angle_limit
        actuators = plant.front_actuator, plant.rear_actuator
        self._car = car_on_road(plant.vehicle, plant.speed, plant.friction, *actuators)
        self._observer = SideslipObserver(plant.action_timestep)
        self._remembered = Remembered(3)  # the first side, whether the driver has gone to the other, lateral velocity

    @abc.abstractmethod
    def matrix(self, gains: Matrix) -> Matrix:
        """(3, 5): by phase and signal."""

    @classmethod
    def of(cls, plant: Plant, values: Matrix) -> Self:
        return cls(plant, values)

    def vary(self, values: Matrix) -> None:
        self._matrix = np.array([self.matrix(row) for row in values])

    @property
    def memory(self) -> Remembered:
        return self._remembered

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self._remembered.reset(rows)

    def act(self, observation: Array) -> NDArray[np.float32]:
        cars = np.atleast_2d(np.asarray(observation, np.float64)) * self._scale
        seen = SimpleNamespace(**{name: cars[:, place] for name, place in self._places.items()})
        seen.speed = np.maximum(seen.speed, LEAST_SPEED)
        remembered = self._remembered.of(len(cars))
        phase = self._phase(remembered, seen)
        signals = np.stack([seen.yaw_rate, self._sideslip(remembered, seen), *self._known(seen)], axis=1)
        matrix = self._matrix[phase] if self._matrix.ndim == 2 else self._matrix[np.arange(len(cars)), phase]
        rear = np.einsum("cs,cs->c", matrix, signals)
        action = np.zeros((len(cars), self._axles), np.float32)
        action[:, -1] = np.clip(rear / self._limit, -1.0, 1.0)
        return action.reshape(*np.shape(observation)[:-1], self._axles)

    def _phase(self, remembered: Matrix, seen: Any) -> NDArray[np.int64]:
        side, command = remembered[:, 0], np.sign(seen.driver_command)
        side[:] = np.where(side == 0.0, command, side)
        remembered[:, 1] = np.maximum(remembered[:, 1], side * command < 0.0)
        return np.where(seen.driver_finished > 0.5, 2, remembered[:, 1].astype(np.int64))

    def _sideslip(self, remembered: Matrix, seen: Any) -> Matrix:
        if "sideslip" in self._places:
            known: Matrix = seen.sideslip
            return known
        velocity = remembered[:, 2]
        velocity[:] = self._observer.update(velocity, seen.lateral_acceleration, seen.yaw_rate, seen.speed)
        found: Matrix = velocity / seen.speed
        return found

    def _known(self, seen: Any) -> tuple[Matrix, Matrix, Matrix]:
        own = SimpleNamespace(speed=seen.speed, twin_front_steer=seen.front_steer, relative_friction=1.0)
        return seen.front_steer, seen.driver_command, reference_yaw_rate(NUMPY)(own, self._car)


def gains_on(signals: Sequence[str], prefix: str = "") -> tuple[Parameter, ...]:
    """The gains of a linear law as parameters."""
    return tuple(Parameter(prefix + name, -100.0, 100.0, *SEARCH[name]) for name in signals)


class YawRateFeedback(RearSteering):
    """Rear wheels by the yaw rate's error, one gain [s]: what simple active rear steering does."""

    name = "rear-yaw-rate"
    parameters = (Parameter("yaw_rate_error", -100.0, 100.0, *SEARCH["yaw_rate"]),)

    def matrix(self, gains: Matrix) -> Matrix:
        return np.tile([gains[0], 0.0, 0.0, 0.0, -gains[0]], (len(PHASES), 1))


class LinearFeedforward(RearSteering):
    """Linear feedback of yaw rate and sideslip with a feedforward of what the driver does, five gains."""

    name = "rear-linear"
    parameters = gains_on(SIGNALS)

    def matrix(self, gains: Matrix) -> Matrix:
        return np.tile(gains, (len(PHASES), 1))


class Switched(RearSteering):
    """The linear law with gains of its own in each phase of the driver's manoeuvre, fifteen; odd as the others."""

    name = "rear-switched"
    parameters = tuple(one for phase in PHASES for one in gains_on(SIGNALS, phase.replace(" ", "_") + "_"))

    def matrix(self, gains: Matrix) -> Matrix:
        return gains.reshape(len(PHASES), len(SIGNALS))


REAR_STEERINGS: dict[str, type[RearSteering]] = {
    law.name: law for law in (YawRateFeedback, LinearFeedforward, Switched)
}
