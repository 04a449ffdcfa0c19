"""What makes a car turn: the slip angles and forces of its two axles; V' and r' of Karnopp, Vehicle Stability, ch. 6.

Two geometries: "small_angle" is the book's; "exact" keeps the arctangent of the slip angles, the cosine of the steer
angles and the sine and cosine of the heading. Letters and axes as in :mod:`bicycle_env.physics.car`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.records import replaced
from bicycle_env.physics.tires import Linear, Tire
from bicycle_env.physics.validation import choice

GEOMETRIES = ("small_angle", "exact")


class Axles(NamedTuple):
    """Slip angles [rad] and lateral forces [N] of the two axles, and the accelerations that they cause."""

    front_slip_angle: Any
    rear_slip_angle: Any
    front_lateral_force: Any
    rear_lateral_force: Any
    lateral_acceleration: Any
    """V' + U r, m/s^2."""
    yaw_acceleration: Any
    """r', rad/s^2."""


def resolve_geometry(geometry: str | None, tire: Tire) -> str:
    """The named geometry, or the default: the book's small angles for the linear tire, exact for the others."""
    if geometry is None:
        return "small_angle" if isinstance(tire, Linear) else "exact"
    return choice("geometry", geometry, GEOMETRIES)


def slip_angles(xp: Any, geometry: str) -> Callable[..., tuple[Any, Any]]:
    """``slip_angles(V, r, df, dr, car) -> (front, rear)`` [rad], (6.20)."""
    slip_angle = xp.function(slip_angle_of(xp, geometry))

    def slip_angles(
        lateral_velocity: Any, yaw_rate: Any, front_steer: Any, rear_steer: Any, car: CarParameters
    ) -> tuple[Any, Any]:
        # A reciprocal of what stays the same: the compiler may move it out of the loop, and may not make it itself.
        per_speed = 1.0 / car.speed
        front_velocity = xp.multiply_add(car.cg_to_front, yaw_rate, lateral_velocity)
        rear_velocity = xp.multiply_add(-car.cg_to_rear, yaw_rate, lateral_velocity)
        return slip_angle(front_velocity, per_speed, front_steer), slip_angle(rear_velocity, per_speed, rear_steer)

    return slip_angles


def axle_forces(xp: Any, tire: Tire, geometry: str, pushed: bool = False) -> Callable[..., Axles]:
    """``axle_forces(slips, df, dr, car)``: of slip angles (front, rear); `pushed`: the car's side force acts, too."""
    cosine = xp.near_cos if geometry == "exact" else xp.function(one)  # steer angles are below pi/2
    lateral_force = xp.function(tire.law(xp))
    push = xp.function(side_force(xp, pushed))

    def axle_forces(slips: tuple[Any, Any], front_steer: Any, rear_steer: Any, car: CarParameters) -> Axles:
        per_mass, per_inertia = 1.0 / car.mass, 1.0 / car.yaw_inertia
        front_slip, rear_slip = slips
        front_force = lateral_force(front_slip, car.front_cornering_stiffness, car.front_peak_force)
        rear_force = lateral_force(rear_slip, car.rear_cornering_stiffness, car.rear_peak_force)
        front_sideways = front_force * cosine(front_steer)
        rear_sideways = rear_force * cosine(rear_steer)
        by_tires = Axles(
            front_slip,
            rear_slip,
            front_force,
            rear_force,
            (front_sideways + rear_sideways) * per_mass,  # 6.18
            xp.multiply_add(  # 6.19
                front_sideways, car.cg_to_front * per_inertia, -rear_sideways * (car.cg_to_rear * per_inertia)
            ),
        )
        acting: Axles = push(by_tires, car, per_mass, per_inertia)
        return acting

    return axle_forces


def steady_axles(xp: Any, tire: Tire, geometry: str, pushed: bool = False) -> Callable[..., Axles]:
    """``steady_axles(V, r, df, dr, car)``: the forces of tires that answer at once."""
    slips = xp.function(slip_angles(xp, geometry))
    forces = xp.function(axle_forces(xp, tire, geometry, pushed))

    def steady_axles(
        lateral_velocity: Any, yaw_rate: Any, front_steer: Any, rear_steer: Any, car: CarParameters
    ) -> Axles:
        slip = slips(lateral_velocity, yaw_rate, front_steer, rear_steer, car)
        acting: Axles = forces(slip, front_steer, rear_steer, car)
        return acting

    return steady_axles


def body_rates(xp: Any) -> Callable[[Axles, Any, CarParameters], tuple[Any, Any]]:
    """``body_rates(acting, r, car) -> (V', r')``."""

    def body_rates(acting: Axles, yaw_rate: Any, car: CarParameters) -> tuple[Any, Any]:
        return xp.multiply_add(-yaw_rate, car.speed, acting.lateral_acceleration), acting.yaw_acceleration

    return body_rates


def side_force(xp: Any, pushed: bool) -> Any:
    """``push(acting, car, 1 / mass, 1 / inertia) -> Axles``: the accelerations with the side force and its moment."""
    accelerated = replaced(xp, Axles, ("lateral_acceleration", "yaw_acceleration"))

    def nothing(acting: Axles, _car: CarParameters, _per_mass: Any, _per_inertia: Any) -> Axles:
        return acting

    def push(acting: Axles, car: CarParameters, per_mass: Any, per_inertia: Any) -> Axles:
        more: Axles = accelerated(
            acting,
            xp.multiply_add(car.side_force, per_mass, acting.lateral_acceleration),
            xp.multiply_add(car.yaw_moment, per_inertia, acting.yaw_acceleration),
        )
        return more

    return push if pushed else nothing


def slip_angle_of(xp: Any, geometry: str) -> Callable[[Any, Any, Any], Any]:
    """``slip_angle(velocity, per_speed, steer)``: lateral velocity at the axle, 1 / speed, road-wheel angle (6.20)."""

    def small_angle(velocity: Any, per_speed: Any, steer: Any) -> Any:
        return xp.multiply_add(velocity, per_speed, -steer)

    def exact(velocity: Any, per_speed: Any, steer: Any) -> Any:
        return xp.atan(velocity * per_speed) - steer

    return exact if geometry == "exact" else small_angle


def unchanged(x: Any) -> Any:
    """The small-angle tangent and arctangent."""
    return x


def one(_: Any) -> Any:
    """The small-angle cosine."""
    return 1.0


def path_rates(xp: Any, geometry: str) -> Callable[[CarState, CarParameters], tuple[Any, Any]]:
    """``(x', y')`` of the centre of mass on the road."""

    def small_angle(state: CarState, car: CarParameters) -> tuple[Any, Any]:
        return car.speed, xp.multiply_add(car.speed, state.heading, state.lateral_velocity)

    def exact(state: CarState, car: CarParameters) -> tuple[Any, Any]:
        sine = xp.sin(state.heading)
        cosine = xp.cos(state.heading)
        return (
            xp.multiply_add(car.speed, cosine, -state.lateral_velocity * sine),
            xp.multiply_add(car.speed, sine, state.lateral_velocity * cosine),
        )

    return exact if geometry == "exact" else small_angle
