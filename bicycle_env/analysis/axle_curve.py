"""One axle's force against its slip angle, read backwards: the peak, and the slip angles that a force needs."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.physics.dual_numbers import Dual, dual_namespace
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.tires import Tire

Array = NDArray[np.float64]


class AxleCurve(NamedTuple):
    """The size of an axle's lateral force for slip angles from 0 to `widest`."""

    tire: Tire
    stiffness: float
    """N/rad."""
    friction_force: float
    """mu Fz, N."""
    peak: float
    """Slip angle of the largest force, rad: where the force first stops to rise, or `widest`."""
    widest: float
    """rad."""
    falls: bool
    """Whether the force falls beyond the peak."""

    @property
    def has_peak(self) -> bool:
        """Whether the force stops to rise before `widest`."""
        return self.peak < self.widest

    def share(self, slip: float) -> float:
        """The force at a slip angle over mu Fz."""
        return float(self.force(np.array([slip]))[0]) / self.friction_force

    def force(self, slip: Array) -> Array:
        """(n,) N for slip angles (n,) >= 0."""
        force: Array = -self.tire.law(NUMPY)(slip, self.stiffness, self.friction_force)
        return force

    def slope(self, slip: Array) -> Array:
        """(n,) N/rad."""
        return _slope(self.tire, self.stiffness, self.friction_force, slip)

    def slip(self, force: Array, beyond_peak: bool = False) -> Array:
        """(n,) rad: the slip angles that forces (n,) >= 0 need, below or beyond the peak; NaN if not reached."""
        near, far = (self.peak, self.widest) if beyond_peak else (self.peak, 0.0)
        largest, smallest = self.force(np.array([near, far]))
        slips = boundary(lambda slip: self.force(slip) > force, near + 0.0 * force, far + 0.0 * force)
        slips = np.where(force == largest, near, np.where(force == smallest, far, slips))
        return np.where((force >= smallest) & (force <= largest), slips, np.nan)


def axle_curve(tire: Tire, stiffness: float, friction_force: float, widest: float) -> AxleCurve:
    """Find the peak of a law between 0 and the widest slip angle [rad]."""
    scale = friction_force / stiffness
    nodes = np.unique([*np.linspace(0.0, widest, 1001), *np.minimum(np.linspace(0.0, 10.0 * scale, 1001), widest)])
    rising = _slope(tire, stiffness, friction_force, nodes) > 0.0
    if np.all(rising):
        return AxleCurve(tire, stiffness, friction_force, widest, widest, False)
    first = int(np.argmin(rising))
    peak = boundary(
        lambda slip: _slope(tire, stiffness, friction_force, slip) > 0.0,
        nodes[first - 1 : first],
        nodes[first : first + 1],
    )
    falls = bool(np.any(_slope(tire, stiffness, friction_force, nodes[first:]) < 0.0))
    return AxleCurve(tire, stiffness, friction_force, float(peak[0]), widest, falls)


def boundary(holds: Callable[[Array], NDArray[np.bool_]], low: Array, high: Array) -> Array:
    """Where a condition that holds at `low` (n,) ends on the way to `high` (n,), by bisection to the last bits."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = holds(middle)
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


def _slope(tire: Tire, stiffness: float, friction_force: float, slip: Array) -> Array:
    law = tire.law(dual_namespace(NUMPY))
    slope: Array = -law(Dual(slip, np.ones_like(slip)), stiffness, friction_force).slope
    return slope
