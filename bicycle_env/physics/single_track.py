"""The single-track model: Karnopp, Vehicle Stability, (6.18)-(6.23), with the rear axle steered too.

Its tires answer a slip angle at once. Letters and axes as in :mod:`bicycle_env.physics.car`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.lateral import Axles, body_rates, path_rates, steady_axles
from bicycle_env.physics.model import Model, Rates


def same(state: CarState, _car: CarParameters) -> CarState:
    """The state of a car is all there is."""
    return state


@dataclasses.dataclass(frozen=True)
class SingleTrack(Model):
    """Position, heading, lateral velocity, yaw rate and the two steer angles."""

    State = CarState

    @property
    def quasi_static(self) -> SingleTrack:
        return self

    def complete(self, xp: Any) -> Callable[[CarState, CarParameters], CarState]:
        found: Callable[[CarState, CarParameters], CarState] = xp.function(same)
        return found

    def axles(self, xp: Any, pushed: bool = False) -> Callable[[CarState, CarParameters], Axles]:
        acting = xp.function(steady_axles(xp, self.tire, self.geometry, pushed))

        def axles(state: CarState, car: CarParameters) -> Axles:
            found: Axles = acting(state.lateral_velocity, state.yaw_rate, state.front_steer, state.rear_steer, car)
            return found

        return axles

    def rates(self, xp: Any, pushed: bool = False) -> Rates:
        acting = xp.function(steady_axles(xp, self.tire, self.geometry, pushed))
        body = xp.function(body_rates(xp))
        path = xp.function(path_rates(xp, self.geometry))

        def rates(state: CarState, steer: tuple[Any, Any], car: CarParameters) -> CarState:
            front_steer, rear_steer = steer
            axles = acting(state.lateral_velocity, state.yaw_rate, front_steer, rear_steer, car)
            sideways, turning = body(axles, state.yaw_rate, car)
            forward, across = path(state, car)
            still = 0.0 * state.front_steer
            return CarState(forward, across, state.yaw_rate, sideways, turning, still, still)

        return rates
