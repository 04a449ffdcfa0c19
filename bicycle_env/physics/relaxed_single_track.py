"""The single-track model on tires that take a way to answer: H. B. Pacejka, Tire and Vehicle Dynamics, ch. 7.

The force is that of the transient slip angle beta, which lags behind the slip angle alpha by the time in which the
tire rolls its relaxation length sigma:  beta' = U / sigma (alpha - beta).  In a steady turn, and for sigma -> 0, the
car is that of :mod:`bicycle_env.physics.single_track`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.lateral import Axles, axle_forces, body_rates, path_rates, slip_angles
from bicycle_env.physics.model import Model, Rates
from bicycle_env.physics.records import joined, record_of, replaced
from bicycle_env.physics.single_track import SingleTrack


class TransientSlip(NamedTuple):
    """What the model has beside a CarState, rad."""

    front_transient_slip_angle: Any
    rear_transient_slip_angle: Any


@dataclasses.dataclass(frozen=True)
class RelaxedSingleTrack(Model):
    """A CarState and the transient slip angle of each axle."""

    State = record_of("RelaxedCarState", (*CarState._fields, *TransientSlip._fields))

    def __str__(self) -> str:
        return f"{super().__str__()}, relaxing"

    @property
    def quasi_static(self) -> SingleTrack:
        return SingleTrack(self.tire, self.geometry)

    def complete(self, xp: Any) -> Callable[[CarState, CarParameters], Any]:
        """The transient slip angles are those of a long steady motion like this one."""
        slips = xp.function(slip_angles(xp, self.geometry))
        join = joined(xp, self.State, CarState, TransientSlip)

        def complete(state: CarState, car: CarParameters) -> Any:
            front, rear = slips(state.lateral_velocity, state.yaw_rate, state.front_steer, state.rear_steer, car)
            return join(state, TransientSlip(front, rear))

        return complete

    def axles(self, xp: Any, pushed: bool = False) -> Callable[[Any, CarParameters], Axles]:
        """The slip angles are the tires' own, (6.20); the forces those of the transient ones."""
        slips = xp.function(slip_angles(xp, self.geometry))
        forces = xp.function(axle_forces(xp, self.tire, self.geometry, pushed))
        slipping = replaced(xp, Axles, ("front_slip_angle", "rear_slip_angle"))

        def axles(state: Any, car: CarParameters) -> Axles:
            transient = (state.front_transient_slip_angle, state.rear_transient_slip_angle)
            front, rear = slips(state.lateral_velocity, state.yaw_rate, state.front_steer, state.rear_steer, car)
            found: Axles = slipping(forces(transient, state.front_steer, state.rear_steer, car), front, rear)
            return found

        return axles

    def rates(self, xp: Any, pushed: bool = False) -> Rates:
        acting = xp.function(self.axles(xp, pushed))
        body = xp.function(body_rates(xp))
        path = xp.function(path_rates(xp, self.geometry))
        steered = replaced(xp, self.State, ("front_steer", "rear_steer"))
        join = joined(xp, self.State, CarState, TransientSlip)

        def rates(state: Any, steer: tuple[Any, Any], car: CarParameters) -> Any:
            front_steer, rear_steer = steer
            axles = acting(steered(state, front_steer, rear_steer), car)
            sideways, turning = body(axles, state.yaw_rate, car)
            forward, across = path(state, car)
            still, per_lag = 0.0 * state.front_steer, car.speed / car.relaxation_length
            return join(
                CarState(forward, across, state.yaw_rate, sideways, turning, still, still),
                TransientSlip(
                    per_lag * (axles.front_slip_angle - state.front_transient_slip_angle),
                    per_lag * (axles.rear_slip_angle - state.rear_transient_slip_angle),
                ),
            )

        return rates
