"""The classical fourth-order Runge-Kutta method on a CarState."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bicycle_env.physics.single_track import Car, CarState

STABILITY_LIMIT = 2.5
"""Largest timestep x |eigenvalue| accepted. RK4's own limit: 2.785 on the negative real axis, 2.83 on the imaginary."""

Rates = Callable[[CarState, Any, Car], CarState]


def rk4(xp: Any, rates: Rates) -> Callable[[CarState, Any, Any, Any, Car, Any], CarState]:
    """``advance(state, at_start, at_middle, at_end, car, timestep)``: one step, the input given at its three times."""
    rates = xp.function(rates)
    along: Callable[[CarState, CarState, Any], CarState] = xp.function(moved(xp))
    weigh: Callable[[CarState, CarState, CarState, CarState], CarState] = xp.function(six_times_mean(xp))

    def advance(state: CarState, at_start: Any, at_middle: Any, at_end: Any, car: Car, timestep: Any) -> CarState:
        half = 0.5 * timestep
        k1 = rates(state, at_start, car)
        k2 = rates(along(state, k1, half), at_middle, car)
        k3 = rates(along(state, k2, half), at_middle, car)
        k4 = rates(along(state, k3, timestep), at_end, car)
        return along(state, weigh(k1, k2, k3, k4), timestep / 6.0)

    return advance


def moved(xp: Any) -> Callable[[CarState, CarState, Any], CarState]:
    """``moved(state, rate, time)``: state + time x rate."""
    add = xp.multiply_add

    def moved(state: CarState, rate: CarState, time: Any) -> CarState:
        return CarState(
            add(time, rate.longitudinal_position, state.longitudinal_position),
            add(time, rate.lateral_position, state.lateral_position),
            add(time, rate.heading, state.heading),
            add(time, rate.lateral_velocity, state.lateral_velocity),
            add(time, rate.yaw_rate, state.yaw_rate),
            add(time, rate.front_steer, state.front_steer),
            add(time, rate.rear_steer, state.rear_steer),
        )

    return moved


def six_times_mean(xp: Any) -> Callable[[CarState, CarState, CarState, CarState], CarState]:
    """``six_times_mean(k1, k2, k3, k4)``: k1 + 2 (k2 + k3) + k4, additions beside which others can be done."""

    def sum_of(k1: Any, k2: Any, k3: Any, k4: Any) -> Any:
        return xp.multiply_add(2.0, k2 + k3, k1) + k4

    total = xp.function(sum_of)

    def six_times_mean(k1: CarState, k2: CarState, k3: CarState, k4: CarState) -> CarState:
        return CarState(
            total(
                k1.longitudinal_position, k2.longitudinal_position, k3.longitudinal_position, k4.longitudinal_position
            ),
            total(k1.lateral_position, k2.lateral_position, k3.lateral_position, k4.lateral_position),
            total(k1.heading, k2.heading, k3.heading, k4.heading),
            total(k1.lateral_velocity, k2.lateral_velocity, k3.lateral_velocity, k4.lateral_velocity),
            total(k1.yaw_rate, k2.yaw_rate, k3.yaw_rate, k4.yaw_rate),
            total(k1.front_steer, k2.front_steer, k3.front_steer, k4.front_steer),
            total(k1.rear_steer, k2.rear_steer, k3.rear_steer, k4.rear_steer),
        )

    return six_times_mean


def check_timestep(name: str, timestep: float, fastest: float) -> None:
    """Refuse a step too long for the fastest mode: ValueError if timestep x fastest [1/s] exceeds 2.5."""
    if timestep * fastest > STABILITY_LIMIT:
        raise ValueError(
            f"{name} must be <= {STABILITY_LIMIT / fastest:.3g} s here, got {timestep:g}: the fastest mode has "
            f"{fastest:.4g} 1/s, and their product must not exceed {STABILITY_LIMIT} for RK4 to be stable"
        )
