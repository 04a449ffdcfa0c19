"""The one interface of everything that drives: an observation in, an action out."""

from __future__ import annotations

import abc
import copy
from collections.abc import Callable
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import LinearModel
from bicycle_env.control.remembered import Remembered
from bicycle_env.physics.actuators import Actuator
from bicycle_env.physics.model import Model
from bicycle_env.physics.vehicle import Vehicle
from bicycle_env.tasks.episode import Rules
from bicycle_env.tasks.task import Task

Array = NDArray[np.floating[Any]]


class Plant(Protocol):
    """What a controller may ask an environment (``env.unwrapped``) when it is designed."""

    task: Task
    vehicle: Vehicle
    model: Model
    speed: float
    friction: float
    steer: str
    front_actuator: Actuator
    rear_actuator: Actuator
    action_timestep: float
    """From one action to the next, s."""
    substeps: int
    """RK4 steps in a control step, of which there are ``action_repeat`` from one action to the next."""
    action_repeat: int
    rules: Rules
    observation_names: tuple[str, ...]
    observation_scale: NDArray[np.float64]
    action_space: Any

    def linear_model(self, quasi_static: bool = False) -> LinearModel:
        """The one-step linear model with its cost; quasi-static: without the states of tires that relax."""


class Policy(abc.ABC):
    """Maps observations to actions, one car's or many at a time."""

    name: str

    @property
    def memory(self) -> Remembered | None:
        """What it remembers of each car; None: nothing, or not as numbers per car."""
        return None

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:  # noqa: B027 (most policies remember nothing)
        """Forget the past: call it when an episode starts.

        Args:
            rows: (cars,) the cars that start anew; None for all.
        """

    def __copy__(self) -> Self:
        """As ``copy.deepcopy``: a copy remembers on its own, and goes on as the original does."""
        return copy.deepcopy(self)

    @abc.abstractmethod
    def act(self, observation: Array) -> NDArray[np.float32]:
        """Action in [-1, 1].

        Args:
            observation: (entries,) or (cars, entries), as the environment gives it.

        Returns:
            (axles,) or (cars, axles), float32.
        """


class Function(Policy):
    """A function of one's own, from one car's observation to its action.

    Args:
        name: what it is called.
        function: (entries,) to (axles,), in [-1, 1].
    """

    def __init__(self, name: str, function: Callable[[Array], Any]) -> None:
        self.name, self._function = name, function

    def act(self, observation: Array) -> NDArray[np.float32]:
        if np.ndim(observation) == 1:
            return np.asarray(self._function(observation), np.float32)
        return np.array([self.act(row) for row in observation], np.float32)


class Zero(Policy):
    """Leaves both axles straight: the uncontrolled car."""

    name = "zero"

    def __init__(self, plant: Plant) -> None:
        self._axles = plant.action_space.shape[-1]

    def act(self, observation: Array) -> NDArray[np.float32]:
        return np.zeros((*np.shape(observation)[:-1], self._axles), np.float32)
