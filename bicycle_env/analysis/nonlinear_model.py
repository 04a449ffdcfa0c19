"""The nonlinear single-track car at one speed on one road, as the analysis sees it: rates of V and r, and derivatives.

    U  speed             V  lateral_velocity     r  yaw_rate       m  mass      Iz  yaw_inertia
    a  cg_to_front       b  cg_to_rear           df, dr  steer angles

The equations are those of :mod:`bicycle_env.physics.lateral`, here on numpy arrays and on dual numbers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import car_on_road
from bicycle_env.physics.dual_numbers import Dual, dual_namespace
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.lateral import body_rates, steady_axles
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.physics.tires import Law, Tire
from bicycle_env.physics.validation import checked_speed, in_range, number
from bicycle_env.physics.vehicle import Vehicle


class Jacobians(NamedTuple):
    """x' = state x + input u for small deviations from one state (V, r) and one pair of steer angles."""

    state: NDArray[np.float64]
    """(2, 2): derivatives of (V', r') with respect to (lateral_velocity, yaw_rate); 1/s, mixed units."""
    input: NDArray[np.float64]
    """(2, 2): derivatives of (V', r') with respect to (front_steer, rear_steer), per rad."""


class NonlinearModel:
    """One car, speed, tire law, friction and geometry. Steer angles and states are arguments, and broadcast.

    Raises ValueError or TypeError for a bad value, named with its allowed range.
    """

    def __init__(
        self,
        vehicle: str | Vehicle,
        speed: float,
        tire: str | Tire = "fiala",
        friction: float = 1.0,
        geometry: str | None = None,
    ) -> None:
        self.vehicle = resolve_vehicle(vehicle)
        self.speed = checked_speed(speed)
        self.friction = in_range("friction", friction)
        self.single_track = SingleTrack.of(tire, geometry)
        self.car = car_on_road(self.vehicle, self.speed, self.friction, FRONT, REAR)
        self.front_slip_scale = self.car.front_peak_force / self.car.front_cornering_stiffness
        """mu Fzf / Cf, rad: the slip angle on which the front axle's law bends."""
        self.rear_slip_scale = self.car.rear_peak_force / self.car.rear_cornering_stiffness

    def rates(
        self, lateral_velocity: Any, yaw_rate: Any, front_steer: Any, rear_steer: Any, *, xp: Any = NUMPY
    ) -> tuple[Any, Any]:
        """(V', r'), (6.18) and (6.19): m/s^2 and rad/s^2."""
        laws = _equations(xp, self.single_track)
        acting = laws.axles(lateral_velocity, yaw_rate, front_steer, rear_steer, self.car)
        rates: tuple[Any, Any] = laws.body(acting, yaw_rate, self.car)
        return rates

    def slip_angles(
        self, lateral_velocity: Any, yaw_rate: Any, front_steer: Any, rear_steer: Any, *, xp: Any = NUMPY
    ) -> tuple[Any, Any]:
        """(front, rear), (6.20), rad."""
        acting = _equations(xp, self.single_track).axles(lateral_velocity, yaw_rate, front_steer, rear_steer, self.car)
        return acting.front_slip_angle, acting.rear_slip_angle

    def law(self, xp: Any) -> Law:
        """The tire law (slip_angle, cornering_stiffness, peak_force) -> lateral force."""
        return _equations(xp, self.single_track).law

    def stiffness_left(self, front_slip: Any, rear_slip: Any, *, xp: Any = NUMPY) -> tuple[Any, Any]:
        """(front, rear): slope of the force at a slip angle over the slope at zero: 1, 0 when sliding, < 0 beyond."""
        car, law = self.car, self.law(dual_namespace(xp))
        front, rear = (Dual(slip, 1.0 + 0.0 * slip) for slip in (front_slip, rear_slip))
        front = law(front, car.front_cornering_stiffness, car.front_peak_force)
        rear = law(rear, car.rear_cornering_stiffness, car.rear_peak_force)
        return -front.slope / car.front_cornering_stiffness, -rear.slope / car.rear_cornering_stiffness

    def jacobians(self, lateral_velocity: Any, yaw_rate: Any, front_steer: Any, rear_steer: Any) -> Jacobians:
        """Both Jacobians, each (..., 2, 2) with the common shape of the arguments in front."""
        arguments = (lateral_velocity, yaw_rate, front_steer, rear_steer)
        point = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in arguments))
        columns, dual = [], dual_namespace(NUMPY)
        for varied in range(4):
            v, r, df, dr = (Dual(x, np.full(x.shape, float(k == varied))) for k, x in enumerate(point))
            columns.append(np.stack([rate.slope for rate in self.rates(v, r, df, dr, xp=dual)], axis=-1))
        matrix = np.stack(columns, axis=-1)
        return Jacobians(matrix[..., :2], matrix[..., 2:])


class _Equations(NamedTuple):
    axles: Callable[..., Any]
    body: Callable[..., Any]
    law: Law


@functools.cache
def _equations(xp: Any, model: SingleTrack) -> _Equations:
    return _Equations(steady_axles(xp, model.tire, model.geometry), body_rates(xp), model.tire.law(xp))


def checked_steer(steer: ArrayLike) -> tuple[float, float]:
    """A pair of road-wheel angles (front, rear) in (-pi/2, pi/2) rad; ValueError otherwise."""
    try:
        pair = np.asarray(steer, dtype=np.float64)
    except (TypeError, ValueError):
        pair = np.empty(0)
    if pair.shape != (2,) or not np.all(np.abs(pair) < np.pi / 2):
        raise ValueError(f"steer must be a pair (front, rear) of finite angles in (-pi/2, pi/2) rad, got {steer!r}")
    return float(pair[0]), float(pair[1])


def jacobians(
    vehicle: str | Vehicle,
    speed: float,
    lateral_velocity: float = 0.0,
    yaw_rate: float = 0.0,
    steer: ArrayLike = (0.0, 0.0),
    tire: str | Tire = "fiala",
    friction: float = 1.0,
    geometry: str | None = None,
) -> Jacobians:
    """Linearise the nonlinear car about any state, by dual numbers: exact to rounding, about 1e-14 of the entries.

    In straight running, steered straight, they are ``state_matrix`` and ``input_matrix`` for every tire and geometry.

    Args:
        vehicle: a preset's name or a Vehicle.
        speed: U, m/s.
        lateral_velocity: V, m/s.
        yaw_rate: r, rad/s.
        steer: road-wheel angles (front, rear), rad.
        tire: a name in ``bicycle_env.tires.LAWS`` or a tire object.
        friction: road friction coefficient.
        geometry: "small_angle" or "exact"; by default small_angle for the linear tire and exact for the others.

    Raises:
        ValueError, TypeError: a bad value, named with its allowed range.
    """
    model = NonlinearModel(vehicle, speed, tire, friction, geometry)
    state = number("lateral_velocity", lateral_velocity), number("yaw_rate", yaw_rate)
    return model.jacobians(*state, *checked_steer(steer))
