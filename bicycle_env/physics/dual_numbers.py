"""Derivatives of the laws, exact to rounding: forward-mode differentiation with dual numbers.

A law written in a namespace ``xp`` also runs on dual numbers, value + slope e with e^2 = 0, and returns its value and
its derivative at once. So the linearisation of the nonlinear car comes from the one source of physics, without a
difference step.

    law = Fiala().law(dual_namespace(NUMPY))
    force = law(Dual(slip_angle, 1.0), stiffness, peak_force)     # force.value, force.slope = dY / d alpha

Where a law is defined by pieces, e is a small positive number: comparisons ask for the value first and then for the
slope, so that at a seam the derivative is the one in the direction of the argument's slope.
"""

from __future__ import annotations

import functools
from typing import Any

from bicycle_env.physics.elementary import Namespace, namespace


class Dual:
    """A value and its derivative with respect to one parameter; both scalars, or arrays that broadcast."""

    __array_ufunc__ = None  # numpy leaves `array * dual` to us
    __slots__ = ("slope", "value")

    def __init__(self, value: Any, slope: Any = 0.0) -> None:
        self.value, self.slope = value, slope

    def __repr__(self) -> str:
        return f"Dual({self.value!r}, {self.slope!r})"

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __add__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.slope + other.slope)
        return Dual(self.value + other, self.slope)

    def __sub__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value - other.value, self.slope - other.slope)
        return Dual(self.value - other, self.slope)

    def __rsub__(self, other: Any) -> Dual:
        return Dual(other - self.value, -self.slope)

    def __mul__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value * other.value, self.slope * other.value + self.value * other.slope)
        return Dual(self.value * other, self.slope * other)

    def __truediv__(self, other: Any) -> Dual:
        other = lifted(other)
        ratio = self.value / other.value
        return Dual(ratio, (self.slope - ratio * other.slope) / other.value)

    def __rtruediv__(self, other: Any) -> Dual:
        return lifted(other) / self

    def __pow__(self, exponent: float) -> Dual:
        return Dual(self.value**exponent, exponent * self.value ** (exponent - 1) * self.slope)

    __radd__, __rmul__ = __add__, __mul__

    def __lt__(self, other: Any) -> Any:
        difference = self - other
        return (difference.value < 0.0) | ((difference.value == 0.0) & (difference.slope < 0.0))

    def __gt__(self, other: Any) -> Any:
        return -self < -lifted(other)

    def __le__(self, other: Any) -> Any:
        difference = self - other
        return (difference.value < 0.0) | ((difference.value == 0.0) & (difference.slope <= 0.0))

    def __ge__(self, other: Any) -> Any:
        return -self <= -lifted(other)

    def __abs__(self) -> Dual:
        sign = 1.0 - 2.0 * (self < 0.0)
        return Dual(abs(self.value), self.slope * sign)


def lifted(x: Any) -> Dual:
    """A dual number from itself or from a constant."""
    return x if isinstance(x, Dual) else Dual(x)


def dual_namespace(xp: Namespace) -> Namespace:
    """The namespace of dual numbers whose values and slopes belong to another namespace: PYTHON or NUMPY."""
    module: Any = xp
    dual: Namespace = _dual_namespace(module)
    return dual


@functools.cache
def _dual_namespace(xp: Any) -> Any:
    def where(condition: Any, then: Any, otherwise: Any) -> Dual:
        then, otherwise = lifted(then), lifted(otherwise)
        return Dual(xp.where(condition, then.value, otherwise.value), xp.where(condition, then.slope, otherwise.slope))

    def floor(x: Any) -> Any:
        return xp.floor(lifted(x).value)

    def sqrt(x: Any) -> Dual:
        root = xp.sqrt(lifted(x).value)
        return Dual(root, 0.5 * lifted(x).slope / root)

    return namespace("dual", where, floor, sqrt=sqrt)
