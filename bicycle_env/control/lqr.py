"""Linear-quadratic regulators with optimal preview: discrete, continuous, and scheduled over the speed."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES, LinearModel, continuous_model, rk4_map
from bicycle_env.control.design.gains import continuous_preview_gain, preview_gain, zero_order_hold
from bicycle_env.control.design.observation_map import Reading, interpolation, look_ahead_times
from bicycle_env.control.policy import Array, Plant, Policy
from bicycle_env.control.rows import product
from bicycle_env.control.tunable import Parameter, TunablePolicy, searched, shipped_rows
from bicycle_env.files import number_in, read_json, table
from bicycle_env.physics.validation import checked_speed, choice, number

Matrix = NDArray[np.float64]

DISCRETISATIONS = ("rk4", "zoh")
WEIGHT_RANGE = (1e-9, 1e9)
"""Of the weights in a file."""


class Weights(NamedTuple):
    """Diagonal weights of the design, each the inverse square of a size that matters as much as the others."""

    lateral_position: float
    heading: float
    sideslip: float
    yaw_rate: float
    front_command: float
    rear_command: float

    def matrices(self, speed: float, input_names: Iterable[str]) -> tuple[Matrix, Matrix]:
        """Q (6, 6) on ``STATE_NAMES`` and R on the actions; sideslip is V/U."""
        states = [self.lateral_position, self.heading, self.sideslip / speed**2, self.yaw_rate, 0.0, 0.0]
        commands = {"front_steer_command": self.front_command, "rear_steer_command": self.rear_command}
        return np.diag(states), np.diag([commands[name] for name in input_names])


def tuned_weights(task_name: str) -> Weights:
    """The weights that come with the package for a task; the file says how they were found. ValueError without any."""
    tuned = _tuned()
    return tuned[choice("task with tuned weights", task_name, tuned)]


def _tuned() -> dict[str, Weights]:
    """Task -> weights."""
    return {row["task"]: Weights(1.0, **row["parameters"]) for row in shipped_rows() if row["controller"] == LQR.name}


def cost_matrices(plant: Plant, weights: Weights | None, speed: float) -> tuple[Matrix, Matrix]:
    """Q (6, 6) and R (axles, axles) of a design at a speed [m/s].

    Args:
        weights: None for the tuned ones of the task; a task without these gives its own cost, with a UserWarning.
    """
    model, tuned = plant.linear_model(quasi_static=True), _tuned()
    if weights is None and plant.task.name not in tuned:
        warnings.warn(
            f"no weights were tuned for the task {plant.task.name!r}: the controller has the task's own quadratic cost",
            stacklevel=2,
        )
        return model.Q, model.R
    return (weights or tuned[plant.task.name]).matrices(speed, model.input_names)


def read_weights(path: str | Path) -> Weights:
    """The weights in a file that agents/tune.py wrote; nothing in it is executed.

    Raises:
        ValueError: a damaged file, or one whose "weights" are not the fields of ``Weights`` with positive numbers.
        OSError: the file cannot be read.
    """
    weights = table(dict.fromkeys(Weights._fields, number_in(*WEIGHT_RANGE)))
    content = read_json(path, table({"weights": weights}, others=True))
    return Weights(**content["weights"])


def continuous_design_model(plant: Plant, speed: float | None = None) -> LinearModel:
    """x' = A x + B u of a plant with its actuators, u the action, at its own or at another speed [m/s]; timestep 0."""
    model = plant.linear_model(quasi_static=True)
    speed = plant.speed if speed is None else checked_speed(speed)
    A, B = continuous_model(plant.vehicle, speed, (plant.front_actuator, plant.rear_actuator))
    columns = [("front_steer_command", "rear_steer_command").index(name) for name in model.input_names]
    return model._replace(A=A, B=B[:, columns] * model.input_scale, timestep=0.0)


def design_model(plant: Plant, speed: float | None = None, discretisation: str = "rk4") -> LinearModel:
    """x+ = A x + B u of one control step, u the action, at the plant's own or at another speed [m/s].

    "rk4" is what the environment integrates, "zoh" the exact zero-order hold. ValueError for another word.
    """
    choice("discretisation", discretisation, DISCRETISATIONS)
    model = plant.linear_model(quasi_static=True)
    if speed is None and discretisation == "rk4":
        return model
    continuous = continuous_design_model(plant, speed)
    if discretisation == "zoh":
        A, B = zero_order_hold(continuous.A, continuous.B, model.timestep)
    else:
        A, B = rk4_map(continuous.A, continuous.B, model.timestep, plant.substeps * plant.action_repeat)
    return model._replace(A=A, B=B)


class WeightedPolicy(TunablePolicy):
    """Base of those designed with ``weights``, as parameters relative to that of the lateral position."""

    parameters = (
        Parameter("heading", 1.0, 10.0**3.5, scale="log"),
        Parameter("sideslip", 0.1, 10.0**3.5, scale="log"),
        Parameter("yaw_rate", 0.01, 10.0**2.5, scale="log"),
        Parameter("front_command", 0.01, 10.0**1.5, scale="log", axle="front"),
        Parameter("rear_command", 0.01, 10.0**1.5, scale="log", axle="rear"),
    )

    @classmethod
    def of(cls, plant: Plant, values: Matrix) -> Self:
        made: Any = cls
        policy: Self = made(plant, weights=weights_of(searched(cls, plant), values))
        policy.values = np.array(values)
        return policy

    @classmethod
    def usual(cls, plant: Plant) -> dict[str, float] | None:
        tuned = _tuned().get(plant.task.name)
        return tuned and {one.name: getattr(tuned, one.name) for one in cls.parameters}


def weights_of(parameters: Iterable[Parameter], values: Matrix) -> Weights:
    """Weights with these values; those that are not among the parameters are 1."""
    found = {one.name: float(value) for one, value in zip(parameters, values, strict=True)}
    return Weights(**{**dict.fromkeys(Weights._fields, 1.0), **found})


class StateFeedback(Policy):
    """Base of the linear controllers: action = -gain x + feedforward' observation, clipped.

    x are the states ``STATE_NAMES``, lateral positions counted from the car, so that the first is 0 and the path comes
    in by the feedforward. Attributes: ``gain`` (axles, 6), the ``model`` that it was designed for, and ``matrix``
    (entries, axles), by which the observation is multiplied.
    """

    model: LinearModel
    gain: Matrix

    def __init__(self, plant: Plant, model: LinearModel, gain: Matrix, feedforward: Matrix) -> None:
        self.model, self.gain = model, gain
        self.matrix = feedforward - Reading(plant).state_feedback(gain)

    def act(self, observation: Array) -> NDArray[np.float32]:
        action: Any = np.clip(product(observation, self.matrix), -1.0, 1.0)
        return np.asarray(action, np.float32)


class LQR(StateFeedback, WeightedPolicy):
    """Discrete LQR on the full state, with optimal preview where the task shows the path ahead.

    It is designed for the environment that it is given (its vehicle, speed, actuators, control timestep), linearised
    at straight running, without any limit; its action is clipped. ``weights`` defaults to the tuned ones of the task,
    ``discretisation`` to "rk4", the map that the environment integrates; "zoh" is the exact zero-order hold.

    Attributes: ``gain`` (axles, 6) on the states ``STATE_NAMES``, ``preview`` (axles, points) on the lateral
    distances to the path, now and at the preview times, and the ``model`` that they were designed for.
    """

    name = "lqr"

    def __init__(self, plant: Plant, weights: Weights | None = None, discretisation: str = "rk4") -> None:
        model = design_model(plant, None, discretisation)
        gain, self.preview = discrete_design(plant, model, plant.speed, weights)
        super().__init__(plant, model, gain, -Reading(plant).path_feedback(self.preview))


class ContinuousLQR(StateFeedback, WeightedPolicy):
    """LQR designed in continuous time, with the actuators' lags as states; the control step's hold is not in it.

    Attributes as those of :class:`LQR`; the model's timestep is 0.
    """

    name = "lqr-continuous"

    def __init__(self, plant: Plant, weights: Weights | None = None) -> None:
        model = continuous_design_model(plant)
        Q, R = cost_matrices(plant, weights, plant.speed)
        times = look_ahead_times(plant)
        intervals = 4 * max(1, round(times[-1] / plant.action_timestep)) if len(times) > 1 else 0
        grid = np.linspace(0.0, times[-1], intervals + 1)
        wanted = np.zeros((len(grid), len(STATE_NAMES), len(times)))
        wanted[:, 0] = interpolation(times, grid)
        wanted[:, 1] = interpolation(times, grid, 1) / plant.speed  # heading = y' / U
        wanted[:, 3] = interpolation(times, grid, 2) / plant.speed
        step = times[-1] / max(intervals, 1)
        gain, self.preview = continuous_preview_gain(model.A, model.B, Q, R, wanted, step)
        super().__init__(plant, model, gain, -Reading(plant).path_feedback(self.preview))


class ScheduledLQR(WeightedPolicy):
    """Discrete LQR with its gains scheduled over the speed: designed at the nodes, interpolated linearly between them.

    It acts with the gain at ``speed``, at first the plant's; assign the car's present speed [m/s] to it, or one per
    car, where that is not the speed of the design. Attributes: ``speeds`` (nodes,), ``model`` at the plant's speed.

    Args:
        speeds: nodes, rising; the plant's speed within them. By default nine from 0.6 to 1.4 times the plant's speed.
        weights: by default the tuned ones of the task.

    Raises:
        ValueError, TypeError: nodes that do not rise or do not enclose the plant's speed, a speed outside of them.
    """

    name = "scheduled-lqr"

    def __init__(self, plant: Plant, speeds: Iterable[float] | None = None, weights: Weights | None = None) -> None:
        self.model = plant.linear_model(quasi_static=True)  # before all else: cars that differ are refused here
        nodes = plant.speed * np.linspace(0.6, 1.4, 9) if speeds is None else speeds
        self.speeds = np.array([checked_speed(node, "speeds") for node in nodes])
        if len(self.speeds) < 2 or np.any(np.diff(self.speeds) <= 0.0):
            raise ValueError(f"speeds must be at least two rising values, got {self.speeds.tolist()}")
        designs = [discrete_design(plant, design_model(plant, node), node, weights) for node in self.speeds]
        self._gains = np.array([gain for gain, _ in designs])
        self._previews = np.array([preview for _, preview in designs])
        self._reading = Reading(plant)
        self.speed = plant.speed

    @property
    def speed(self) -> Any:
        """The speed [m/s] that it acts for: one value, or (cars,)."""
        return self._speed

    @speed.setter
    def speed(self, speed: Any) -> None:
        values = [self._checked(value) for value in np.atleast_1d(speed)]
        matrices = [
            -self._reading.state_feedback(self.gain_at(value)) - self._reading.path_feedback(self.preview_at(value))
            for value in values
        ]
        self._speed = values[0] if np.ndim(speed) == 0 else np.array(values)
        self._matrix = matrices[0] if np.ndim(speed) == 0 else np.array(matrices)

    def gain_at(self, speed: float) -> Matrix:
        """K (axles, 6) at a speed [m/s] within the nodes; ValueError or TypeError otherwise."""
        return self._between(self._gains, self._checked(speed))

    def preview_at(self, speed: float) -> Matrix:
        """G (axles, points) at a speed [m/s] within the nodes; ValueError or TypeError otherwise."""
        return self._between(self._previews, self._checked(speed))

    def act(self, observation: Array) -> NDArray[np.float32]:
        shared = self._matrix.ndim == 2
        action: Any = product(observation, self._matrix) if shared else self._per_car(np.asarray(observation))
        return np.asarray(np.clip(action, -1.0, 1.0), np.float32)

    def _per_car(self, observation: Array) -> Any:
        if observation.shape[:-1] != (len(self._matrix),):
            raise ValueError(f"observation must be of {len(self._matrix)} cars, one per speed; got {observation.shape}")
        return np.einsum("ce,cea->ca", observation, self._matrix)

    def _checked(self, speed: object) -> float:
        return number("speed", speed, float(self.speeds[0]), float(self.speeds[-1]))

    def _between(self, tables: Matrix, speed: float) -> Matrix:
        upper = min(max(int(np.searchsorted(self.speeds, speed)), 1), len(self.speeds) - 1)
        low, high = self.speeds[upper - 1], self.speeds[upper]
        share = (speed - low) / (high - low)
        table: Matrix = (1.0 - share) * tables[upper - 1] + share * tables[upper]
        return table


def discrete_design(plant: Plant, model: LinearModel, speed: float, weights: Weights | None) -> tuple[Matrix, Matrix]:
    """Gain (axles, 6) and preview (axles, points) of the discrete LQR for a model at a speed [m/s]."""
    Q, R = cost_matrices(plant, weights, speed)
    times = look_ahead_times(plant)
    horizon = preview_steps(times, model.timestep)
    wanted = wanted_states(speed * model.timestep, model.timestep, horizon)
    gain, per_step = preview_gain(model.A, model.B, Q, R, wanted, horizon)
    steps = np.linspace(0.0, horizon * model.timestep, horizon + 1)
    return gain, per_step @ interpolation(times, steps)


def preview_steps(times: Matrix, timestep: float) -> int:
    """How many control steps the preview reaches; at least two, from which a curvature can be made."""
    return max(2, round(float(times[-1]) / timestep))


def wanted_states(step_length: float, timestep: float, horizon: int) -> Matrix:
    """M (6, horizon + 1): lateral position, heading and yaw rate of the path, by differences of its positions."""
    wanted = np.zeros((len(STATE_NAMES), horizon + 1))
    wanted[0, 0] = 1.0
    wanted[1, :2] = np.array([-1.0, 1.0]) / step_length
    wanted[3, :3] = np.array([1.0, -2.0, 1.0]) / (step_length * timestep)
    return wanted
