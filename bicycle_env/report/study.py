"""Everything that a report says about one car at one speed, computed once."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env import analysis
from bicycle_env.control.design.gains import continuous_gain
from bicycle_env.envs.configuration import DEFAULT_SPEED, DEFAULT_SPEED_RATIO, resolve_speed
from bicycle_env.physics import tires
from bicycle_env.physics.presets import resolve_tired
from bicycle_env.physics.validation import in_range, number, whole
from bicycle_env.physics.vehicle import Vehicle

FASTEST_DEFAULT = 100.0
"""m/s: where the environments' default would be beyond it, the report takes DEFAULT_SPEED."""
SPEEDS = (0.1, 150.0)  # m/s: what a report is made for
STEER_LIMITS = (0.1, 0.05)  # rad, front and rear
BOX = (0.4, 1.0)  # |sideslip| [rad], |yaw rate| [rad/s]: whose share is given
LQR_SIZES = (0.05, 0.1)
"""Sideslip [rad] and yaw rate [rad/s] that weigh as much as full steer of an axle in LQR's cost."""
GRID, COARSEST, FINEST = 161, 31, 1001


@dataclasses.dataclass(frozen=True)
class Study:
    """One car, at one speed, on one road; what takes time is computed when first asked for, and then kept."""

    vehicle: Vehicle
    speed: float
    tire: tires.Tire
    friction: float
    grid: int
    """Nodes of the recoverable set in each of its two axes."""

    @property
    def name(self) -> str:
        """The car's."""
        return self.vehicle.name or "car"

    @property
    def is_at_critical_speed(self) -> bool:
        """Whether the speed is the critical speed to rounding: straight running is then on the limit."""
        return math.isclose(self.speed, self.vehicle.critical_speed, rel_tol=1e-9)

    @functools.cached_property
    def equilibria(self) -> tuple[analysis.Equilibrium, ...]:
        """Steady states with straight wheels."""
        return analysis.equilibria(self.vehicle, self.speed, tire=self.tire, friction=self.friction)

    @functools.cached_property
    def handling(self) -> analysis.HandlingDiagram:
        """The handling diagram of this tire on this road."""
        return analysis.handling_diagram(self.vehicle, tire=self.tire, friction=self.friction)

    @functools.cached_property
    def recoverable(self) -> analysis.RecoverableSet:
        """The states that some steering within STEER_LIMITS saves."""
        return analysis.recoverable_set(
            self.vehicle,
            self.speed,
            tire=self.tire,
            friction=self.friction,
            steer_limits=STEER_LIMITS,
            grid=(self.grid, self.grid),
            progress=False,
        )

    @functools.cached_property
    def why_unknown(self) -> str:
        """Why it could not be computed what can be saved; "" if it could."""
        try:
            _ = self.recoverable
        except analysis.IntractableError as error:
            return f"not computed: {error}"
        return ""

    @functools.cached_property
    def lqr_gain(self) -> NDArray[np.float64]:
        """K (2, 2) of steer = -K (lateral velocity, yaw rate): a linear regulator; it does not know the limits."""
        sideslip, yaw_rate = LQR_SIZES
        gain, _ = continuous_gain(
            analysis.state_matrix(self.vehicle, self.speed),
            analysis.input_matrix(self.vehicle, self.speed),
            np.diag([(sideslip * self.speed) ** -2, yaw_rate**-2]),
            np.diag([limit**-2 for limit in STEER_LIMITS]),
        )
        return gain

    @functools.cached_property
    def shares(self) -> dict[str, float]:
        """The share of BOX that is recoverable, that clipped LQR saves, that straight wheels save; NaN if unknown."""
        if self.why_unknown:
            return dict.fromkeys(("recoverable", "lqr", "straight"), math.nan)
        return {
            "recoverable": self.recoverable.share(*BOX),
            "lqr": self._saved(self.lqr_gain),
            "straight": self._saved(np.zeros((2, 2))),
        }

    def _saved(self, gain: NDArray[np.float64]) -> float:
        try:
            return self.recoverable.saved_share(gain, *BOX)
        except analysis.IntractableError:
            return math.nan


def study(
    vehicle: str | Vehicle | Mapping[str, Any],
    speed: float | None = None,
    speed_ratio: float | None = None,
    tire: str | tires.Tire | Mapping[str, Any] = "fiala",
    friction: float = 1.0,
    grid: int = GRID,
) -> Study:
    """Choose a car, a speed and a road.

    Args:
        vehicle: a preset's name, a car's file, a Vehicle or a dict of its fields.
        speed: m/s, in SPEEDS.
        speed_ratio: a multiple of the critical speed; at most one of the two. By default 1.2; for a car without a
            critical speed, or where that would be more than 100 m/s, 30 m/s.
        tire: a name in ``bicycle_env.tires.LAWS`` or a tire object.
        friction: road friction coefficient.
        grid: nodes of the recoverable set in each of its two axes, in [31, 1001].

    Raises:
        ValueError, TypeError: a bad value, named with its allowed range; a ratio for a car without critical speed; a
            linear car at exactly its critical speed.
    """
    vehicle, tire = resolve_tired(vehicle, tire)
    found = Study(
        vehicle=vehicle,
        speed=_speed(vehicle, speed, speed_ratio),
        tire=tire,
        friction=in_range("friction", friction),
        grid=whole("grid", grid, COARSEST, FINEST),
    )
    if found.is_at_critical_speed and isinstance(tire, tires.Linear):
        raise ValueError(
            f"speed must differ from the critical speed {vehicle.critical_speed:g} m/s with the linear tire, got "
            f"{found.speed:g}: its steady states are a line there"
        )
    return found


def _speed(vehicle: Vehicle, speed: float | None, speed_ratio: float | None) -> float:
    if speed is not None and speed_ratio is None:
        return number("speed", speed, *SPEEDS)
    if speed is None and speed_ratio is None:
        beyond = DEFAULT_SPEED_RATIO * vehicle.critical_speed
        return beyond if SPEEDS[0] <= beyond <= FASTEST_DEFAULT else DEFAULT_SPEED
    return number("speed_ratio x critical speed", resolve_speed(vehicle, speed, speed_ratio), *SPEEDS)


def compute(study: Study, progress: Callable[[str], None]) -> None:
    """Compute what takes long; `progress` is told in words."""
    progress(f"computing what can be saved, on {study.grid} x {study.grid} states")
    _ = study.shares
