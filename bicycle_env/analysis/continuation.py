"""Pseudo-arclength continuation of steady turns in the plane of (rear slip angle, one steer angle).

The curve is g(x) = 0 with g the yaw acceleration on the curve of :class:`bicycle_env.analysis.equilibria.RearBalance`
and x = (rear slip, steer), both over one slip scale, mu Fz / C. In a plane the tangent needs no linear algebra.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.equilibria import RearBalance, root
from bicycle_env.physics.dual_numbers import Dual, dual_namespace
from bicycle_env.physics.elementary import NUMPY, PYTHON

Array = NDArray[np.float64]

# Steps in slip scales, the largest in rad.
FIRST_STEP, SMALLEST_STEP, STEP_NEAR_A_FOLD, LARGEST_STEP = 0.02, 1e-7, 0.02, 0.02
LARGEST_TURN = 0.1
"""Largest angle between the tangents at both ends of a step, rad."""
ROUNDING = 1e-15
"""Of r', as a share of the largest that the tires can cause: where both axles nearly slide, no solution is closer."""


class SteerPlane:
    """One car with one steer angle free: points x (2,) = (rear slip, steer) / scale, and the limits of both."""

    def __init__(
        self, balance: RearBalance, front: bool, other_steer: float, steer_limit: float, sideslip_limit: float
    ) -> None:
        self.balance, self.front, self.other_steer = balance, front, other_steer
        self.steer_limit, self.sideslip_limit = steer_limit, sideslip_limit
        self.scale = min(balance.model.front_slip_scale, balance.model.rear_slip_scale)
        car = balance.model.car
        strongest = car.cg_to_front * car.front_peak_force + car.cg_to_rear * car.rear_peak_force
        self.rounding = ROUNDING * strongest / car.yaw_inertia

    def pair(self, steer: Any) -> tuple[Any, Any]:
        """(front, rear) steer angles, rad, from the free one."""
        return (steer, self.other_steer) if self.front else (self.other_steer, steer)

    def value(self, x: Array) -> float:
        """g at x."""
        slip, steer = (x * self.scale).tolist()
        return float(self.balance.residual(slip, *self.pair(steer), xp=PYTHON))

    def gradient(self, x: Array) -> Array:
        """(2,) of g at x."""
        slip, steer = (x * self.scale).tolist()
        dual = dual_namespace(PYTHON)
        by_slip = self.balance.residual(Dual(slip, 1.0), *self.pair(Dual(steer, 0.0)), xp=dual)
        by_steer = self.balance.residual(Dual(slip, 0.0), *self.pair(Dual(steer, 1.0)), xp=dual)
        return np.array([by_slip.slope * self.scale, by_steer.slope * self.scale])

    def determinant(self, slip: Any, steer: Any, *, xp: Any) -> Any:
        """dg/d(rear slip), a positive multiple of det J: 0 at a fold. Angles in rad; floats or arrays, as xp."""
        return self.balance.slope(slip, *self.pair(steer), xp=xp)

    def divergence(self, slip: Any, steer: Any, *, xp: Any) -> Any:
        """Trace of the Jacobian of (V', r'), 1/s: 0 at a Hopf bifurcation. Angles in rad; floats or arrays, as xp."""
        v, r = self.balance.state(slip, self.pair(steer)[1], xp=xp)
        rates, dual, one = self.balance.model.rates, dual_namespace(xp), 1.0 + 0.0 * v
        by_velocity, _ = rates(Dual(v, one), Dual(r, 0.0 * one), *self.pair(steer), xp=dual)
        _, by_yaw_rate = rates(Dual(v, 0.0 * one), Dual(r, one), *self.pair(steer), xp=dual)
        return by_velocity.slope + by_yaw_rate.slope

    def corrected(self, guess: Array, direction: Array, gradient: Array) -> Array | None:
        """The point of the curve on the line through the guess at a right angle to the direction; None if not found.

        The gradient (2,) of a point nearby gives Newton's first step; secants follow.
        """
        across = np.array([-direction[1], direction[0]])
        distance, value, rate = 0.0, self.value(guess), float(gradient @ across)
        for _ in range(12):
            change = -value / rate if rate != 0.0 else math.inf
            if not abs(distance + change) < 1.0:
                return None
            distance += change
            before, value = value, self.value(guess + distance * across)
            if abs(change) < 1e-11 or abs(value) <= self.rounding:
                return guess + distance * across
            rate = (value - before) / change
        return None

    def outside(self, x: Array) -> float:
        """Positive beyond a limit, 0 at the first that is reached."""
        return max(self.limits(x)) - 1.0

    def limits(self, x: Array) -> tuple[float, float]:
        """Shares of the steer limit and of the sideslip limit."""
        slip, steer = (x * self.scale).tolist()
        lateral_velocity, _ = self.balance.state(slip, self.pair(steer)[1], xp=PYTHON)
        sideslip = float(lateral_velocity) / self.balance.model.speed
        return abs(steer) / self.steer_limit, abs(sideslip) / self.sideslip_limit

    def is_sliding(self, x: Array) -> bool:
        slip, steer = (x * self.scale).tolist()
        return bool(self.balance.is_sliding(slip, *self.pair(steer), xp=PYTHON))


def branch_through(plane: SteerPlane, start: Array) -> tuple[Array, tuple[str, str]]:
    """The whole branch through a point: its points (n, 2) and the two reasons why it ends."""
    ahead, last = _trace(plane, start, 1.0)
    if last == "closed":
        return np.array([start, *ahead]), ("closed", "closed")
    behind, first = _trace(plane, start, -1.0)
    return np.array([*behind[::-1], start, *ahead]), (first, last)


def _trace(plane: SteerPlane, start: Array, sense: float) -> tuple[list[Array], str]:
    """Points after the start up to the end of the branch, and why it ends there."""
    rows: list[Array] = []
    x, gradient, step = start, plane.gradient(start), FIRST_STEP
    tangent = beginning = sense * _tangent(gradient)
    while step > SMALLEST_STEP:
        following = plane.corrected(x + step * tangent, tangent, gradient)
        if following is None or plane.is_sliding(following):
            step *= 0.5
            continue
        there = plane.gradient(following)
        turned = sense * _tangent(there)
        turn, length = math.hypot(*(turned - tangent)), math.hypot(*(following - x))
        if turn > LARGEST_TURN or length > 1.2 * step:
            step *= 0.5
            continue
        if plane.outside(following) >= 0.0:
            end = _located(plane, x, following, plane.outside)
            if math.hypot(*(end - x)) > SMALLEST_STEP:
                rows.append(end)
            steer, sideslip = plane.limits(following)
            return rows, "steer limit" if steer >= sideslip else "sideslip limit"
        ahead = start - x
        if len(rows) > 2 and 0.0 < ahead @ tangent <= step >= math.hypot(*ahead) and beginning @ tangent > 0.9:
            return [*rows, start], "closed"
        rows.append(following)
        step = min(1.5 * step if turn < 0.5 * LARGEST_TURN else step, LARGEST_STEP / plane.scale)
        # A fold may be ahead where the second component goes to zero: go near it slowly, for there may be two.
        bending = abs(turned[1] - tangent[1]) / length
        if 3.0 * bending * step > abs(turned[1]):
            step = max(abs(turned[1]) / (3.0 * bending), min(step, STEP_NEAR_A_FOLD))
        x, tangent, gradient = following, turned, there
    return rows, "full sliding"


def _tangent(gradient: Array) -> Array:
    """(2,) of length 1; its second component has the sign of dg/d(rear slip), and is 0 at a fold."""
    return np.array([-gradient[1], gradient[0]]) / math.hypot(*gradient)


def passes(plane: SteerPlane, rows: Array, point: Array) -> bool:
    """Whether a branch goes through a solution: whether the continuation from the row before gives it again."""
    along = np.diff(rows, axis=0)
    lengths = np.hypot(*along.T)
    directions = along / lengths[:, None]
    offset = point - rows[:-1]
    ahead = np.sum(offset * directions, axis=1)
    aside = np.hypot(*(offset - ahead[:, None] * directions).T)
    for k in np.flatnonzero((ahead > -1e-3) & (ahead < lengths + 1e-3) & (aside < 0.5 * lengths + 1e-3)):
        again = plane.corrected(rows[k] + ahead[k] * directions[k], directions[k], plane.gradient(rows[k]))
        if again is not None and math.hypot(*(again - point)) < 1e-3:
            return True
    return False


def changes(plane: SteerPlane, rows: Array, indicator: Callable[..., Any]) -> list[tuple[int, Array]]:
    """Where an indicator(slip, steer, xp=...) changes sign along a branch: (k, x), x between rows k and k + 1."""

    def at(x: Array) -> float:
        return float(indicator(*(x * plane.scale).tolist(), xp=PYTHON))

    values = indicator(*(rows.T * plane.scale), xp=NUMPY)
    found = np.flatnonzero(np.diff(np.sign(values)) != 0.0).tolist()
    return [(k, _located(plane, rows[k], rows[k + 1], at)) for k in found]


def _located(plane: SteerPlane, x: Array, following: Array, indicator: Callable[[Array], float]) -> Array:
    """The point between two rows at which an indicator is zero: the curve's equation inside, one variable outside."""
    length = math.hypot(*(following - x))
    direction, gradient = (following - x) / length, plane.gradient(x)

    def at(distance: float) -> Array:
        point = plane.corrected(x + distance * direction, direction, gradient)
        if point is None:
            raise RuntimeError(f"the continuation lost a branch of steady turns near (slip, steer) = {x * plane.scale}")
        return point

    first, last = indicator(at(0.0)), indicator(at(length))
    if first * last >= 0.0:  # zero to rounding at one of them
        return at(0.0 if abs(first) < abs(last) else length)
    return at(root(lambda distance: indicator(at(distance)), 0.0, length))
