"""The single-track equations of motion: Karnopp, Vehicle Stability, (6.18)-(6.23), with the rear axle steered too.

Axes: x forward, y to the LEFT, z up; positive steer, yaw rate and lateral position are to the left.

    U  speed             V  lateral_velocity     r  yaw_rate       psi  heading
    m  mass              Iz yaw_inertia          a  cg_to_front    b    cg_to_rear
    Yf, Yr  lateral axle forces in the wheel's frame               df, dr  steer angles

Two geometries: "small_angle" is the book's; "exact" keeps the arctangent of the slip angles, the cosine of the steer
angles and the sine and cosine of the heading.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from bicycle_env.physics.actuators import Actuator, steer_rate
from bicycle_env.physics.records import replaced
from bicycle_env.physics.tires import Linear, Tire
from bicycle_env.physics.validation import choice
from bicycle_env.physics.vehicle import Vehicle

Rates = Callable[..., Any]
"""``rates(state, input, car) -> CarState``."""
GEOMETRIES = ("small_angle", "exact")
STEERS = ("front_steer", "rear_steer")


class CarState(NamedTuple):
    """Where the car is and how it moves; also used for its rate of change. Scalars, or arrays of one shape."""

    longitudinal_position: Any
    """x of the centre of mass along the road, m."""
    lateral_position: Any
    """y of the centre of mass, m, to the left."""
    heading: Any
    """psi, rad."""
    lateral_velocity: Any
    """V in the body frame, m/s."""
    yaw_rate: Any
    """r, rad/s."""
    front_steer: Any
    """Road-wheel angle of the front axle, rad."""
    rear_steer: Any
    """Road-wheel angle of the rear axle, rad."""


class CarParameters(NamedTuple):
    """The numbers that the equations need: one car, at one speed, on one road, with its two actuators."""

    speed: Any
    mass: Any
    yaw_inertia: Any
    cg_to_front: Any
    cg_to_rear: Any
    front_cornering_stiffness: Any
    rear_cornering_stiffness: Any
    front_peak_force: Any
    rear_peak_force: Any
    front_angle_limit: Any
    rear_angle_limit: Any
    front_rate_limit: Any
    rear_rate_limit: Any
    front_time_constant: Any
    rear_time_constant: Any
    front_extent: Any
    rear_extent: Any
    body_width: Any
    side_force: Any
    """A gust, N to the left; acts only where a task has conditions."""
    yaw_moment: Any
    """N m: its force times its lever arm before the centre of mass."""


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


def car_on_road(vehicle: Vehicle, speed: float, friction: float, front: Actuator, rear: Actuator) -> CarParameters:
    """Gather the numbers; the largest force of an axle is friction x its static load."""
    return CarParameters(
        speed=speed,
        mass=vehicle.mass,
        yaw_inertia=vehicle.yaw_inertia,
        cg_to_front=vehicle.cg_to_front,
        cg_to_rear=vehicle.cg_to_rear,
        front_cornering_stiffness=vehicle.front_cornering_stiffness,
        rear_cornering_stiffness=vehicle.rear_cornering_stiffness,
        front_peak_force=friction * vehicle.front_axle_load,
        rear_peak_force=friction * vehicle.rear_axle_load,
        front_angle_limit=front.angle_limit,
        rear_angle_limit=rear.angle_limit,
        front_rate_limit=front.rate_limit,
        rear_rate_limit=rear.rate_limit,
        front_time_constant=front.time_constant,
        rear_time_constant=rear.time_constant,
        front_extent=vehicle.front_extent,
        rear_extent=vehicle.rear_extent,
        body_width=vehicle.body_width,
        side_force=0.0,
        yaw_moment=0.0,
    )


def resolve_geometry(geometry: str | None, tire: Tire) -> str:
    """The named geometry, or the default: the book's small angles for the linear tire, exact for the others."""
    if geometry is None:
        return "small_angle" if isinstance(tire, Linear) else "exact"
    return choice("geometry", geometry, GEOMETRIES)


def axles(xp: Any, tire: Tire, geometry: str, pushed: bool = False) -> Callable[[CarState, CarParameters], Axles]:
    """``axles(state, car)``: what the two axles do in a state; `pushed`: the car's side force acts, too."""
    exact = geometry == "exact"
    slip_angle = xp.function(slip_angle_of(xp, geometry))
    cosine = xp.near_cos if exact else xp.function(one)  # steer angles are below pi/2
    lateral_force = xp.function(tire.law(xp))
    push = xp.function(side_force(xp, pushed))

    def axles(state: CarState, car: CarParameters) -> Axles:
        # Reciprocals of what stays the same: the compiler may move them out of the loop, and may not make them itself.
        per_speed, per_mass, per_inertia = 1.0 / car.speed, 1.0 / car.mass, 1.0 / car.yaw_inertia
        front_velocity = xp.multiply_add(car.cg_to_front, state.yaw_rate, state.lateral_velocity)
        rear_velocity = xp.multiply_add(-car.cg_to_rear, state.yaw_rate, state.lateral_velocity)
        front_slip = slip_angle(front_velocity, per_speed, state.front_steer)
        rear_slip = slip_angle(rear_velocity, per_speed, state.rear_steer)
        front_force = lateral_force(front_slip, car.front_cornering_stiffness, car.front_peak_force)
        rear_force = lateral_force(rear_slip, car.rear_cornering_stiffness, car.rear_peak_force)
        front_sideways = front_force * cosine(state.front_steer)
        rear_sideways = rear_force * cosine(state.rear_steer)
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

    return axles


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


def single_track(xp: Any, tire: Tire, geometry: str, pushed: bool = False) -> Rates:
    """``rates(state, steer, car)`` for prescribed road-wheel angles: the steer in the state follows its input."""
    forces = xp.function(axles(xp, tire, geometry, pushed))
    path = xp.function(path_rates(xp, geometry))
    steered = replaced(xp, CarState, STEERS)

    def rates(state: CarState, steer: tuple[Any, Any], car: CarParameters) -> CarState:
        front_steer, rear_steer = steer
        acting = forces(steered(state, front_steer, rear_steer), car)
        forward, sideways = path(state, car)
        still = 0.0 * state.front_steer
        return CarState(
            forward,
            sideways,
            state.yaw_rate,
            xp.multiply_add(-state.yaw_rate, car.speed, acting.lateral_acceleration),
            acting.yaw_acceleration,
            still,
            still,
        )

    return rates


def actuated_single_track(xp: Any, tire: Tire, geometry: str, pushed: bool = False) -> Rates:
    """``rates(state, command, car)``: the road wheels follow the two commands [rad] through their actuators."""
    body = xp.function(single_track(xp, tire, geometry, pushed))
    actuator = xp.function(steer_rate(xp))
    steered = replaced(xp, CarState, STEERS)

    def rates(state: CarState, command: tuple[Any, Any], car: CarParameters) -> CarState:
        front_command, rear_command = command
        turning: CarState = steered(
            body(state, (state.front_steer, state.rear_steer), car),
            actuator(state.front_steer, front_command, car.front_rate_limit, car.front_time_constant),
            actuator(state.rear_steer, rear_command, car.rear_rate_limit, car.rear_time_constant),
        )
        return turning

    return rates


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
