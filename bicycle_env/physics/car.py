"""The car in numbers: how it is placed and moves, and what it is made of. One legend for the letters of all models.

Axes: x forward, y to the LEFT, z up; positive steer, yaw rate and lateral position are to the left.

    U  speed             V  lateral_velocity     r  yaw_rate       psi  heading
    m  mass              Iz yaw_inertia          a  cg_to_front    b    cg_to_rear
    Yf, Yr  lateral axle forces in the wheel's frame               df, dr  steer angles
"""

from __future__ import annotations

from typing import Any, NamedTuple

from bicycle_env.physics.actuators import Actuator
from bicycle_env.physics.vehicle import Vehicle


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
    relaxation_length: Any
    """Of both axles' tires, m; 0 for a model whose tires answer at once."""
    side_force: Any
    """A gust, N to the left; acts only where a task has conditions."""
    yaw_moment: Any
    """N m: its force times its lever arm before the centre of mass."""


def car_on_road(
    vehicle: Vehicle, speed: float, friction: float, front: Actuator, rear: Actuator, relaxation_length: float = 0.0
) -> CarParameters:
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
        relaxation_length=relaxation_length,
        side_force=0.0,
        yaw_moment=0.0,
    )
