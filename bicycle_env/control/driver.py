"""Driver models: they look at the path ahead and steer the front axle."""

from __future__ import annotations

import abc
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES, LinearModel
from bicycle_env.control.design.observation_map import Matrix, Reading
from bicycle_env.control.design.path import path_ahead
from bicycle_env.control.policy import Array, Plant
from bicycle_env.control.remembered import Remembered
from bicycle_env.control.tunable import ArgumentPolicy, Parameter
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.validation import number, positive
from bicycle_env.tasks import drivers
from bicycle_env.tasks.disturbances import SIDES


class Driver(ArgumentPolicy):
    """Someone at the front wheels. Where the rear axle is steered too, its action is 0: see ``DriverAndLaw``.

    Args:
        plant: the environment; ValueError if its front wheels are not steered.
        model: the car that the driver knows, its first input the front command; by default the plant's own, where
            the rear wheels are left alone. An attribute, too.
    """

    def __init__(self, plant: Plant, model: LinearModel | None = None) -> None:
        if plant.steer == "rear":
            raise ValueError(f"steer must be 'front' or 'both' for the driver {self.name!r}, got 'rear'")
        self.model = plant.linear_model(quasi_static=True) if model is None else model
        self._axles = 2 if plant.steer == "both" else 1
        self._entries = len(plant.observation_names)
        self._limit = plant.front_actuator.angle_limit

    def act(self, observation: Array) -> NDArray[np.float32]:
        cars = np.atleast_2d(np.asarray(observation, np.float64))
        if cars.shape[1:] != (self._entries,):
            shape = np.shape(observation)
            raise ValueError(f"observation must have shape ({self._entries},) or (cars, {self._entries}), got {shape}")
        action = np.zeros((len(cars), self._axles), np.float32)
        action[:, 0] = np.clip(self.front_steer(cars) / self._limit, -1.0, 1.0)
        return action.reshape(*np.shape(observation)[:-1], self._axles)

    @abc.abstractmethod
    def front_steer(self, observation: Matrix) -> Matrix:
        """(cars,) the wanted road-wheel angle, rad, from (cars, entries); it may exceed the actuator's limit."""


def held_control(A: Matrix, b: Matrix, steps: int) -> tuple[Matrix, Matrix]:
    """MacAdam's optimal control of the first state of x+ = A x + b u: one u, held over the whole preview.

    It minimises the integral of (f - y)^2 over `steps` timesteps (trapezoidal rule), y the first state and f its
    wanted future. With ``y_k = F_k x + g_k u`` and the rule's weights w_k,

        u = sum over k of w_k g_k (f_k - F_k x) / sum over k of w_k g_k^2

    Args:
        A: (states, states).
        b: (states,).
        steps: of the preview, >= 1.

    Returns:
        h (steps,) and F (steps, states) of ``u = h @ (f - F @ x)``; f (steps,) are the values after each step.
    """
    F, g = np.empty((steps, len(A))), np.empty(steps)
    row, response = np.eye(len(A))[0], 0.0
    for k in range(steps):
        response += row @ b
        row = row @ A
        F[k], g[k] = row, response
    weighted = g.copy()
    weighted[-1] *= 0.5
    return weighted / (weighted @ g), F


class Preview(Driver):
    """MacAdam's driver: the one steer angle that, if held, keeps the car nearest to the path over the preview.

    C. C. MacAdam, "An optimal preview control for linear systems", J. Dyn. Syst. Meas. Control 102 (1980) 188-190;
    "Application of an optimal preview control for simulation of closed-loop automobile driving", IEEE Trans. Syst.
    Man Cybern. 11 (1981) 393-399. The driver predicts the lateral position with a linear model of the car, weighs
    nothing but its distance from the path, and acts after a transport delay (perception, muscles) which he does not
    foresee. Here the model is that of a control step, steering actuators included; the papers have none.

    On a straight path the slowest mode of his loop is well damped with a car that understeers (damping ratio 0.54 with
    the preset ``understeer`` at 22 m/s), and ever less with one that oversteers: 0.28 at 0.8 and 0.12 at 1.2 times the
    critical speed of ``oversteer``, 0 at 1.83 times. At 1.2 times he fails in the lane change; with the yaw-rate law
    at the rear wheels (damping ratio 0.61) he succeeds.

    Args:
        plant: the environment.
        preview_time: how far the driver looks ahead, s; 1.3 s and a delay of 0.2 s are of the size that the second
            paper finds in lane changes. What the observation does not show is taken to run straight on.
        delay: transport delay, s, rounded to control steps.
        model: the car that the driver predicts with, see :class:`Driver`.

    Attributes: ``model``, ``preview`` (steps,) and ``gain`` (6,) of ``action = preview @ f - gain @ x``, f the lateral
    distances of the path after 1, 2, ... control steps; ``weights`` (entries,), rad per entry of the observation, of
    the angle that is wanted ``delay_steps`` control steps later.

    Raises:
        ValueError, TypeError: a steer mode without front wheels; a bad time.
    """

    name = "preview"
    parameters = (
        Parameter("preview_time", 0.1, 5.0, 1.3, 0.2, scale="log"),
        Parameter("delay", 0.0, 1.0, 0.2, 0.1),
    )

    def __init__(
        self, plant: Plant, preview_time: float = 1.3, delay: float = 0.2, model: LinearModel | None = None
    ) -> None:
        super().__init__(plant, model)
        timestep = self.model.timestep
        steps = max(1, round(positive("preview_time", preview_time) / timestep))
        waiting = round(number("delay", delay, low=0.0) / timestep)
        self.preview, free = held_control(self.model.A, self.model.B[:, 0], steps)
        self.gain: Matrix = self.preview @ free
        ahead = path_ahead(plant, timestep * np.arange(1.0, steps + 1.0)) @ self.preview
        self.weights = self._limit * (ahead - Reading(plant).state_feedback(self.gain[None, :])[:, 0])
        self.delay_steps = waiting
        self._waiting = Remembered(waiting)

    @property
    def memory(self) -> Remembered:
        return self._waiting

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self._waiting.reset(rows)

    def front_steer(self, observation: Matrix) -> Matrix:
        waiting = self._waiting.of(len(observation))
        line = np.column_stack([waiting, weighted_sum(observation, self.weights)])
        waiting[:] = line[:, 1:]
        return line[:, 0]


class Stanley(Driver):
    """The steering law of the car that won the DARPA Grand Challenge 2005; it looks at the path under its front axle.

    G. M. Hoffmann, C. J. Tomlin, M. Montemerlo, S. Thrun, "Autonomous automobile trajectory tracking for off-road
    driving: controller design, experimental validation and racing", American Control Conference 2007, 2296-2301:

        delta_f = -(psi - psi_path - k_ag U r_path) - atan(k e / (k_soft + U)) - k_yaw (r - r_path)

    e is the front axle's distance to the left of the path, psi_path the path's heading there and r_path the rate at
    which it turns at the speed U; positive steer is to the left. k_ag U r_path, ``k_ag = m / (Cf (1 + a/b))``, is the
    front tires' slip in a steady turn, by which the wheels point further in than they roll: the paper's C_y is here
    the front axle's stiffness. The paper's last term, against the overshoot of its steering servo, is left out.

    Without tire slip a small e falls as exp(-k t). The paper tunes the gains on the car; these give the linear model,
    with the default actuator and at a straight path, modes with damping ratios above 0.4 from 10 m/s up to 1.5 times
    the critical speed of the oversteering preset. Without k_yaw that car oscillates unstably from its critical speed
    on.

    Args:
        plant: the environment.
        gain: k, 1/s.
        softening: k_soft, m/s, which keeps the law gentle at walking speed.
        yaw_damping: k_yaw, s.
        model: see :class:`Driver`; the law itself needs no more of the car than k_ag, which rear steer does not change.

    Raises:
        ValueError, TypeError: a steer mode without front wheels; a gain that is negative or not finite.
    """

    name = "stanley"
    parameters = (
        Parameter("gain", 0.01, 100.0, 1.0, 0.3, scale="log"),
        Parameter("softening", 0.0, 10.0, 1.0, 0.5),
        Parameter("yaw_damping", 0.0, 10.0, 0.2, 0.1),
    )

    def __init__(
        self,
        plant: Plant,
        gain: float = 1.0,
        softening: float = 1.0,
        yaw_damping: float = 0.2,
        model: LinearModel | None = None,
    ) -> None:
        super().__init__(plant, model)
        vehicle, speed = plant.vehicle, plant.speed
        a, b = vehicle.cg_to_front, vehicle.cg_to_rear
        damping = number("yaw_damping", yaw_damping, low=0.0)
        self._stiffness = number("gain", gain, low=0.0) / (number("softening", softening, low=0.0) + speed)

        state = Reading(plant).state_feedback(np.eye(len(STATE_NAMES)))
        heading, yaw_rate = (state[:, STATE_NAMES.index(name)] for name in ("heading", "yaw_rate"))
        axle = np.array([a / speed])
        distance, drift, turn = (path_ahead(plant, axle, derivative)[:, 0] for derivative in range(3))
        path_yaw_rate = turn / speed
        slip = vehicle.mass / (vehicle.front_cornering_stiffness * (1.0 + a / b)) * speed * path_yaw_rate
        self._error = a * heading - distance
        self._linear = -(heading - drift / speed - slip) - damping * (yaw_rate - path_yaw_rate)

    def front_steer(self, observation: Matrix) -> Matrix:
        error = weighted_sum(observation, self._error)
        return weighted_sum(observation, self._linear) - np.arctan(self._stiffness * error)


class Scripted(Driver):
    """A manoeuvre of ``bicycle_env.drivers``, whatever the car does: a step, a sine with dwell, what was recorded.

    Args:
        plant: the environment.
        manoeuvre: as the keyword ``driver`` of the environments takes it, with a side that is not drawn. An attribute,
            too: the driver of ``bicycle_env.drivers``.
        model: see :class:`Driver`.

    Raises:
        ValueError, TypeError: a steer mode without front wheels; a driver that looks where to go; a random side.
    """

    def __init__(self, plant: Plant, manoeuvre: Any, model: LinearModel | None = None) -> None:
        found = drivers.resolve(manoeuvre)
        if found is None or not found.sided:
            raise ValueError(f"manoeuvre must be one that needs no eyes, got {manoeuvre!r}")
        if found.side == "random":
            raise ValueError(f"manoeuvre: side must be 'left' or 'right', got {found.side!r}")
        self.name = found.name.replace("_", "-")
        super().__init__(plant, model)
        self.manoeuvre, self._sign, self._timestep = found, SIDES[found.side][0], plant.action_timestep
        self._steps = Remembered(1)

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self._steps.reset(rows)

    def front_steer(self, observation: Matrix) -> Matrix:
        steps = self._steps.of(len(observation))[:, 0]
        law = self.manoeuvre.law(NUMPY, lambda *_: None)  # without eyes it needs no reference
        numbers = SimpleNamespace(**self.manoeuvre.numbers())
        angle: Matrix = self._sign * law(None, None, steps * self._timestep, numbers, None)
        steps += 1.0
        return angle


def weighted_sum(observation: Matrix, weights: Matrix) -> Matrix:
    """(cars,) from (cars, entries) and (entries,), entry by entry.

    A product by BLAS would make a car's action depend on how many others are computed with it.
    """
    total = np.zeros(len(observation))
    for entry, weight in zip(observation.T, weights, strict=True):
        total = total + weight * entry
    return total


DRIVERS: dict[str, type[Driver]] = {driver.name: driver for driver in (Preview, Stanley)}
"""The driver models by name."""
