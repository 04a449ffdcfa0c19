"""A model of the car: a frozen object, like a tire. It has a state, and says how the state changes.

To write one, derive a frozen dataclass from :class:`Model`; the environments, their compiled code and ``simulate`` are
given the object itself and do not know which model they integrate.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self

from bicycle_env.physics.actuators import steer_rate
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.lateral import Axles, resolve_geometry
from bicycle_env.physics.records import replaced
from bicycle_env.physics.tires import Tire, resolve

Rates = Callable[..., Any]
"""``rates(state, input, car) -> state``: the state's rate of change."""
STEERS = ("front_steer", "rear_steer")


@dataclasses.dataclass(frozen=True)
class Model(abc.ABC):
    """Base of the models: hashable, compared by value. Laws are written in a namespace ``xp``, as those of the tires.

    ``pushed``: whether the car's ``side_force`` and ``yaw_moment`` act; a model without them spares their cost.
    """

    State: ClassVar[Any]
    """Named-tuple class of the state: the fields of CarState, then the model's own."""

    tire: Tire
    geometry: str
    """"small_angle" or "exact"."""

    @classmethod
    def of(cls, tire: str | Tire | Mapping[str, Any], geometry: str | None = None) -> Self:
        """From a tire in any of its forms and a geometry, None for the tire's usual one; ValueError or TypeError."""
        law = resolve(tire)
        return cls(law, resolve_geometry(geometry, law))

    def __str__(self) -> str:
        return f"the {type(self.tire).__name__} tire, {self.geometry} geometry"

    @property
    def own(self) -> tuple[str, ...]:
        """The names in State beside a CarState's."""
        return tuple(self.State._fields[len(CarState._fields) :])

    @property
    @abc.abstractmethod
    def quasi_static(self) -> Model:
        """The model whose state is a CarState alone: what controllers are designed on."""

    @abc.abstractmethod
    def complete(self, xp: Any) -> Callable[[Any, CarParameters], Any]:
        """``complete(car_state, car) -> State`` of a CarState: what the model has of its own is settled there."""

    @abc.abstractmethod
    def axles(self, xp: Any, pushed: bool = False) -> Callable[[Any, CarParameters], Axles]:
        """``axles(state, car)``: what the two axles do in a state."""

    @abc.abstractmethod
    def rates(self, xp: Any, pushed: bool = False) -> Rates:
        """``rates(state, steer, car)`` for prescribed road-wheel angles: the steer in the state follows its input."""

    def actuated_rates(self, xp: Any, pushed: bool = False) -> Rates:
        """``rates(state, command, car)``: the road wheels follow the two commands [rad] through their actuators."""
        body = xp.function(self.rates(xp, pushed))
        actuator = xp.function(steer_rate(xp))
        steered = replaced(xp, self.State, STEERS)

        def rates(state: Any, command: tuple[Any, Any], car: CarParameters) -> Any:
            front_command, rear_command = command
            return steered(
                body(state, (state.front_steer, state.rear_steer), car),
                actuator(state.front_steer, front_command, car.front_rate_limit, car.front_time_constant),
                actuator(state.rear_steer, rear_command, car.rear_rate_limit, car.rear_time_constant),
            )

        return rates
