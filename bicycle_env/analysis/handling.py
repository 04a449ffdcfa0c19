"""The handling diagram and steady-state steering: what the driver must steer as the lateral acceleration rises.

In a steady turn both axles use the same share of their load, |Yf| / Fzf = |Yr| / Fzr = ay / g, whatever the speed.
Small angles then give, with the slip angles' sign of (6.20) (negative in a left turn),

    df - dr = L / R + (alpha_r - alpha_f)        L = a + b, R = U / r

so the difference of the slip angles against ay is one curve for all speeds: the handling curve (H. B. Pacejka, Tire
and Vehicle Dynamics, 2012, ch. 1, where slip angles have the other sign and it is written alpha_1 - alpha_2). Its slope
is the understeer gradient. At a speed U, df - dr is the curve plus the speed line L / R = L ay / U^2.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bicycle_env.analysis.axle_curve import AxleCurve, axle_curve
from bicycle_env.analysis.equilibria import RearBalance, root
from bicycle_env.analysis.nonlinear_model import NonlinearModel
from bicycle_env.physics.dual_numbers import Dual, dual_namespace
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.tires import Linear, Tire, resolve
from bicycle_env.physics.validation import in_range, number, positive, whole
from bicycle_env.physics.vehicle import GRAVITY, Vehicle

Array = NDArray[np.float64]

WIDEST_SLIP = 1.0
"""Largest slip angle of a diagram, rad."""

ALMOST = 0.999
"""The curve of a law that has no peak ends at this share of its friction."""


class HandlingCurve(NamedTuple):
    """A handling curve of left turns; arrays of n points by lateral acceleration. Right turns are its mirror image."""

    front_side: str
    """"below peak" or "beyond peak": on which side of its largest force the front axle works."""
    rear_side: str
    lateral_acceleration: Array
    """(n,) U r, m/s^2, ascending."""
    front_slip_angle: Array
    """(n,) rad, negative."""
    rear_slip_angle: Array
    """(n,) rad, negative."""
    slip_difference: Array
    """(n,) rear - front slip angle = front - rear steer angle - L / R, rad: positive = understeer."""
    understeer_gradient: Array
    """(n,) slope of the slip difference, rad per m/s^2; NaN at a peak, where it is endless."""
    critical_speed: Array
    """(n,) m/s: where L / U^2 + gradient = 0; infinite where the gradient is not negative, NaN at a peak. With both
    axles below their peaks a turn of that lateral acceleration is stable below that speed and a saddle above it."""


class HandlingDiagram(NamedTuple):
    """What :func:`handling_diagram` returns. The methods are about ``curves[0]``."""

    curves: tuple[HandlingCurve, ...]
    """First the one with both axles below their peaks; then, for a law that falls beyond its peak, the others."""
    largest_lateral_acceleration: float
    """m/s^2: what the weaker axle can carry; infinite for the linear law."""
    limit: str
    """What the car does at that limit: "plows" (the front axle slips away), "spins" (the rear axle), or "neutral"."""
    wheelbase: float
    """a + b, m."""

    def speed_line(self, speed: float) -> Array:
        """(n,) L / R = L ay / U^2 at a speed [m/s]."""
        return self.wheelbase * self.curves[0].lateral_acceleration / positive("speed", speed) ** 2

    def steer_at_speed(self, speed: float) -> Array:
        """(n,) front - rear steer angle, rad, at a constant speed [m/s]."""
        return self.speed_line(speed) + self.curves[0].slip_difference

    def steer_on_radius(self, radius: float) -> Array:
        """(n,) front - rear steer angle, rad, on a circle of constant radius U / r [m]."""
        return self.wheelbase / positive("radius", radius) + self.curves[0].slip_difference


def handling_diagram(
    vehicle: str | Vehicle, tire: str | Tire = "fiala", friction: float = 1.0, points: int = 201
) -> HandlingDiagram:
    """Pacejka's handling diagram of a car, for small angles; see the module.

    Args:
        vehicle: a preset's name or a Vehicle.
        tire: a name in ``bicycle_env.tires.LAWS`` or a tire object.
        friction: road friction coefficient.
        points: per curve, 3 to 100000; they are closer together near the largest lateral acceleration.

    Returns:
        The curve from zero lateral acceleration to the tires' peak or, for a law without one, to 99.9 % of
        friction x g; with slip angles up to 1 rad.

    Raises:
        ValueError, TypeError: a bad value, named with its allowed range.
    """
    vehicle, tire = resolve_vehicle(vehicle), resolve(tire)
    friction, points = in_range("friction", friction), whole("points", points, 3, 100_000)
    front, rear = _axles(vehicle, tire, friction)
    sides = [(False, False)]
    if front.falls and rear.falls:
        sides += [(False, True), (True, False), (True, True)]
    curves = tuple(_curve(vehicle, friction, (front, rear), beyond, points) for beyond in sides)
    neutral, slope = vehicle.yaw_stiffness == 0.0, curves[0].understeer_gradient[-2]
    return HandlingDiagram(
        curves,
        math.inf if isinstance(tire, Linear) else friction * GRAVITY * min(map(_largest_share, (front, rear))),
        "neutral" if neutral else "plows" if slope > 0.0 else "spins",
        vehicle.wheelbase,
    )


def _axles(vehicle: Vehicle, tire: Tire, friction: float) -> tuple[AxleCurve, AxleCurve]:
    front = axle_curve(tire, vehicle.front_cornering_stiffness, friction * vehicle.front_axle_load, WIDEST_SLIP)
    rear = axle_curve(tire, vehicle.rear_cornering_stiffness, friction * vehicle.rear_axle_load, WIDEST_SLIP)
    return front, rear


def _largest_share(axle: AxleCurve) -> float:
    """Of mu Fz; a law without a peak comes nearest to it at an endless slip angle."""
    return max(axle.share(axle.peak), axle.share(1e6))


def _curve(
    vehicle: Vehicle, friction: float, axles: tuple[AxleCurve, AxleCurve], beyond: tuple[bool, bool], points: int
) -> HandlingCurve:
    both = list(zip(axles, beyond, strict=True))
    at_peak = [axle.share(axle.peak) if axle.has_peak else min(axle.share(axle.widest), ALMOST) for axle in axles]
    lowest = max(axle.share(axle.widest) if side else 0.0 for axle, side in both)
    # Equal steps of an angle: short ones of the force at its peak.
    shares = lowest + (min(at_peak) - lowest) * np.sin(np.linspace(0.0, 0.5 * np.pi, points))
    slips = [axle.slip(shares * axle.friction_force, side) for axle, side in both]
    loads = vehicle.front_axle_load, vehicle.rear_axle_load
    # d slip / d ay is the axle's mass over the slope of its force.
    slopes = [axle.slope(slip) for axle, slip in zip(axles, slips, strict=True)]
    at_a_peak = [(slip == axle.peak) & axle.has_peak for axle, slip in zip(axles, slips, strict=True)]
    slopes = [np.where(there | (slope == 0.0), np.nan, slope) for slope, there in zip(slopes, at_a_peak, strict=True)]
    front, rear = (load / GRAVITY / slope for load, slope in zip(loads, slopes, strict=True))
    # Both axles of a neutral car are one, scaled: on like sides of their peaks they slip alike, but for rounding.
    alike = vehicle.yaw_stiffness == 0.0 and beyond[0] == beyond[1]
    gradient = (0.0 if alike else 1.0) * (front - rear)
    with np.errstate(divide="ignore", invalid="ignore"):
        critical = np.where(gradient < 0.0, np.sqrt(vehicle.wheelbase / -gradient), np.inf)
    critical[np.isnan(gradient)] = np.nan
    return HandlingCurve(
        "beyond peak" if beyond[0] else "below peak",
        "beyond peak" if beyond[1] else "below peak",
        shares * friction * GRAVITY,
        -slips[0],
        -slips[1],
        slips[0] - slips[1],
        gradient,
        critical,
    )


def steer_for_turn(
    vehicle: str | Vehicle,
    lateral_acceleration: ArrayLike,
    speed: float | None = None,
    radius: float | None = None,
    rear_steer: float = 0.0,
    tire: str | Tire = "fiala",
    friction: float = 1.0,
    geometry: str | None = None,
) -> Any:
    """The front steer angle of steady turns, solved from the equations of motion, in either geometry.

    Args:
        vehicle: a preset's name or a Vehicle.
        lateral_acceleration: U r, m/s^2; a number or an array, of either sign: positive is a left turn.
        speed: U, m/s, for a test at constant speed; or
        radius: U / r, m, positive, for a test on a constant circle: the speed is sqrt(|ay| radius).
        rear_steer: rad, constant.
        tire: a name in ``bicycle_env.tires.LAWS`` or a tire object.
        friction: road friction coefficient.
        geometry: "small_angle" or "exact"; by default small_angle for the linear tire and exact for the others.

    Returns:
        The road-wheel angle in rad, of the shape of the lateral acceleration, both axles below the peak of their force;
        NaN where the tires cannot carry the turn.

    Raises:
        ValueError, TypeError: a bad value, named with its allowed range; not exactly one of speed and radius; on a
            circle a lateral acceleration that needs a speed outside [0.1, 1000] m/s (but 0 is rolling without slip).
    """
    if (speed is None) == (radius is None):
        raise ValueError(f"give exactly one of speed and radius, got speed={speed!r} and radius={radius!r}")
    wanted = np.asarray(lateral_acceleration, dtype=np.float64)
    if not np.all(np.isfinite(wanted)):
        raise ValueError(f"lateral_acceleration must be finite, got {lateral_acceleration!r}")
    rear_steer = number("rear_steer", rear_steer, -1.5, 1.5)
    if speed is not None:
        models = [NonlinearModel(vehicle, speed, tire, friction, geometry)] * wanted.size
    else:
        speeds = np.sqrt(np.abs(wanted.ravel()) * positive("radius", radius))
        models = [NonlinearModel(vehicle, u, tire, friction, geometry) for u in np.where(speeds == 0.0, 1.0, speeds)]
    if not models:
        return wanted.copy()
    axles = _axles(models[0].vehicle, models[0].single_track.tire, models[0].friction)
    angles = [
        _front_steer(model, axles, float(ay), rear_steer, radius) for model, ay in zip(models, wanted.flat, strict=True)
    ]
    return angles[0] if wanted.ndim == 0 else np.reshape(angles, wanted.shape)


def _front_steer(
    model: NonlinearModel, axles: tuple[AxleCurve, AxleCurve], ay: float, rear_steer: float, radius: float | None
) -> float:
    exact, car = model.single_track.geometry == "exact", model.car
    wheelbase = model.vehicle.wheelbase
    if ay == 0.0:
        slope = (math.tan(rear_steer) if exact else rear_steer) + (0.0 if radius is None else wheelbase / radius)
        return math.atan(slope) if exact else slope
    side, (front, rear) = math.copysign(1.0, ay), axles
    rear_force = car.mass * abs(ay) * car.cg_to_front / wheelbase / (math.cos(rear_steer) if exact else 1.0)
    rear_slip = -side * float(rear.slip(np.array([rear_force]))[0])
    lateral_velocity, yaw_rate = RearBalance(model).state(rear_slip, rear_steer)
    straight = float(model.slip_angles(lateral_velocity, yaw_rate, 0.0, rear_steer)[0])

    # From a free-rolling front axle to its largest sideways force, the yaw acceleration rises through zero.
    def surplus(steer: Any, xp: Any = PYTHON) -> Any:
        return side * model.rates(lateral_velocity, yaw_rate, steer, rear_steer, xp=xp)[1]

    def rise(steer: float) -> float:
        return float(side * surplus(Dual(steer, 1.0), dual_namespace(PYTHON)).slope)

    strongest = min(max(straight + side * front.peak, -1.5), 1.5)
    if rise(strongest) < 0.0:  # the cosine of the steer angle falls before the force stops to rise
        strongest = root(rise, straight, strongest)
    return root(surplus, straight, strongest) if surplus(straight) < 0.0 <= surplus(strongest) else math.nan
