"""Controllers with parameters that a search may set: what these are, those that come with the package, many at once."""

from __future__ import annotations

import abc
import contextlib
import dataclasses
import functools
import json
from collections.abc import Mapping
from importlib import resources
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control.policy import Array, Plant, Policy
from bicycle_env.physics.validation import known_keys, number

Matrix = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A number of a controller: what it may be, and where a search for it begins."""

    name: str
    least: float
    greatest: float
    start: float | None = None
    """The middle of the places where a search begins; None for anywhere in the range."""
    spread: float = 0.0
    """Their standard deviation about `start`; of a logarithm in decades."""
    scale: str = "linear"
    """"linear", or "log": the search is over the parameter's decimal logarithm."""
    axle: str = ""
    """"front" or "rear": it counts only where that axle is steered."""


class TunablePolicy(Policy):
    """A controller that declares its ``parameters``, in the order in which ``of`` takes their values."""

    parameters: ClassVar[tuple[Parameter, ...]]
    tuned_for: ClassVar[str] = ""
    """The task whose tuned parameters it has by default; "" for those of the plant's own task."""
    planned: ClassVar[tuple[str, ...] | None] = None
    """Names of the parameters that may be planned anew for every start; None: all."""
    values: Matrix
    """Those that it was made of, (parameters,) as ``searched`` lists them."""

    @classmethod
    @abc.abstractmethod
    def of(cls, plant: Plant, values: Matrix) -> Self:
        """The controller with these values, (parameters,) as ``searched`` lists them."""

    @classmethod
    def usual(cls, plant: Plant) -> Mapping[str, float] | None:
        """What it has by default, by name; None where nothing was tuned for the plant's task."""
        return shipped(cls.name, cls.tuned_for or plant.task.name, plant.steer)


class ArgumentPolicy(TunablePolicy):
    """One whose parameters are arguments of its class, each by default the parameter's ``start``."""

    @classmethod
    def of(cls, plant: Plant, values: Matrix) -> Self:
        made: Any = cls
        policy: Self = made(plant, **{one.name: value for one, value in zip(searched(cls, plant), values, strict=True)})
        return policy

    @classmethod
    def usual(cls, plant: Plant) -> Mapping[str, float] | None:
        return {one.name: one.start for one in searched(cls, plant) if one.start is not None}


class TunableLaw(TunablePolicy):
    """One whose parameters are mere numbers of its law, so that each car of a batch may have its own."""

    @abc.abstractmethod
    def vary(self, values: Matrix) -> None:
        """Let each car have values of its own, (cars, parameters)."""


def searched(controller: type[TunablePolicy], plant: Plant) -> tuple[Parameter, ...]:
    """The parameters that count for a plant: not those of an axle that is not steered."""
    return tuple(one for one in controller.parameters if one.axle in ("", plant.steer) or plant.steer == "both")


def values_of(controller: type[TunablePolicy], plant: Plant, parameters: Mapping[str, object]) -> Matrix:
    """(parameters,) from a mapping of names to numbers; those of an axle that is not steered may be missing.

    Raises:
        ValueError, TypeError: an unknown name (the message proposes the nearest), a missing one, a number out of range.
    """
    known_keys(f"parameter of {controller.name!r}", parameters, [one.name for one in controller.parameters])
    wanted = searched(controller, plant)
    missing = [one.name for one in wanted if one.name not in parameters]
    if missing:
        raise ValueError(f"parameters of {controller.name!r}: missing {', '.join(map(repr, missing))}")
    return np.array([number(one.name, parameters[one.name], one.least, one.greatest) for one in wanted])


class Candidates(Policy):
    """One controller with many sets of values, each driving as many cars; the cars of a set stand together.

    Args:
        controller: its class.
        plant: what it is designed for.
        values: (sets, parameters).
        starts: cars of each set.

    Attributes: ``valid`` (sets,), False where the values give no controller to working precision: actions 0.
    """

    def __init__(self, controller: type[TunablePolicy], plant: Plant, values: Matrix, starts: int) -> None:
        self.name, self._starts, self._axles = controller.name, starts, plant.action_space.shape[-1]
        self.valid = np.ones(len(values), np.bool_)
        self._law: TunableLaw | None = None
        self._policies: list[Policy | None] = []
        if issubclass(controller, TunableLaw):
            with contextlib.suppress(np.linalg.LinAlgError):  # of one set; then one by one
                law = controller.of(plant, values[0])
                law.vary(np.repeat(values, starts, axis=0))
                self._law = law
                return
        for k, row in enumerate(values):
            try:
                self._policies.append(controller.of(plant, row))
            except np.linalg.LinAlgError:
                self._policies.append(None)
                self.valid[k] = False

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        if self._law is not None:
            self._law.reset(rows)
        for k, policy in enumerate(self._policies):
            if policy is not None:
                policy.reset(None if rows is None else rows[k * self._starts : (k + 1) * self._starts])

    def act(self, observation: Array) -> NDArray[np.float32]:
        if self._law is not None:
            return self._law.act(observation)
        actions = np.zeros((len(observation), self._axles), np.float32)
        for k, policy in enumerate(self._policies):
            if policy is not None:
                rows = slice(k * self._starts, (k + 1) * self._starts)
                actions[rows] = policy.act(observation[rows])
        return actions


@functools.cache
def shipped_rows() -> tuple[dict[str, Any], ...]:
    """The rows of the tuned parameters that come with the package, each with the command that found it."""
    content = resources.files("bicycle_env.control").joinpath("tuned_parameters.json").read_text("utf-8")
    return tuple(json.loads(content)["rows"])


def shipped(controller: str, task: str, steer: str) -> dict[str, float] | None:
    """The parameters that come with the package for a controller, a task and a steer mode; None without any."""
    for row in shipped_rows():
        if (row["controller"], row["task"]) == (controller, task) and steer in row["steer"]:
            found: dict[str, float] = row["parameters"]
            return dict(found)
    return None
