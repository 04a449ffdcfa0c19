"""The classical fourth-order Runge-Kutta method on named tuples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bicycle_env.physics.records import fieldwise

STABILITY_LIMIT = 2.5
"""Largest timestep x |eigenvalue| accepted. RK4's own limit: 2.785 on the negative real axis, 2.83 on the imaginary."""


def rk4(xp: Any, State: Any, rates: Callable[..., Any]) -> Callable[..., Any]:
    """``advance(state, at_start, at_middle, at_end, car, timestep)``: one step, the input given at its three times.

    ``rates(state, input, car)`` gives a State, the rate of change.
    """
    rates = xp.function(rates)

    def moved(value: Any, rate: Any, time: Any) -> Any:
        return xp.multiply_add(time, rate, value)

    def six_times_mean(k1: Any, k2: Any, k3: Any, k4: Any) -> Any:
        """Of additions beside which others can be done."""
        return xp.multiply_add(2.0, k2 + k3, k1) + k4

    along = fieldwise(xp, State, xp.function(moved), 2, 1)
    weigh = fieldwise(xp, State, xp.function(six_times_mean), 4)

    def advance(state: Any, at_start: Any, at_middle: Any, at_end: Any, car: Any, timestep: Any) -> Any:
        half = 0.5 * timestep
        k1 = rates(state, at_start, car)
        k2 = rates(along(state, k1, half), at_middle, car)
        k3 = rates(along(state, k2, half), at_middle, car)
        k4 = rates(along(state, k3, timestep), at_end, car)
        return along(state, weigh(k1, k2, k3, k4), timestep / 6.0)

    return advance


def check_timestep(name: str, timestep: float, fastest: float) -> None:
    """Refuse a step too long for the fastest mode: ValueError if timestep x fastest [1/s] exceeds 2.5."""
    if timestep * fastest > STABILITY_LIMIT:
        raise ValueError(
            f"{name} must be <= {STABILITY_LIMIT / fastest:.3g} s here, got {timestep:g}: the fastest mode has "
            f"{fastest:.4g} 1/s, and their product must not exceed {STABILITY_LIMIT} for RK4 to be stable"
        )
