"""The two rewards that every task has."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bicycle_env.physics.single_track import Car, CarState
from bicycle_env.tasks.task import Memory, Reference, World

REWARDS = ("default", "quadratic")


def bounded_reward(xp: Any) -> Callable[..., Any]:
    """1 / (1 + c) in (0, 1], c a weighted sum of squares: regulation of the new state, effort, smoothness.

    Effort is the squared action, smoothness the squared change of the action since the last step; both per axle.
    """

    def bounded_reward(
        state: CarState, reference: Reference, action: tuple[Any, Any], memory: Memory, world: World
    ) -> Any:
        rules, car = world.rules, world.car
        lateral = state.lateral_position - reference.lateral_position
        heading = state.heading - reference.heading
        # Reciprocals of what stays the same during an episode: the compiler moves them out of a loop over cars.
        per_speed, per_front, per_rear = 1.0 / car.speed, 1.0 / car.front_angle_limit, 1.0 / car.rear_angle_limit
        sideslip = state.lateral_velocity * per_speed
        front, rear = action
        front_change = front - memory.front_steer_command * per_front
        rear_change = rear - memory.rear_steer_command * per_rear
        # One chain that starts from a number: in a sum of two products the compiler may fuse either with the addition,
        # and one car would not have the bits of many.
        return 1.0 / (
            1.0
            + rules.lateral_weight * (lateral * lateral)
            + rules.heading_weight * (heading * heading)
            + rules.sideslip_weight * (sideslip * sideslip)
            + rules.yaw_rate_weight * (state.yaw_rate * state.yaw_rate)
            + rules.effort_weight * (front * front)
            + rules.effort_weight * (rear * rear)
            + rules.smoothness_weight * (front_change * front_change)
            + rules.smoothness_weight * (rear_change * rear_change)
        )

    return bounded_reward


def quadratic_reward(xp: Any) -> Callable[..., Any]:
    """-(x'Qx + u'Ru), diagonal Q and R, from the state before the step, its reference there, and the action."""

    def quadratic_reward(state: CarState, reference: Reference, action: tuple[Any, Any], world: World) -> Any:
        rules = world.rules
        lateral = state.lateral_position - reference.lateral_position
        heading = state.heading - reference.heading
        front, rear = action
        return -(
            rules.lateral_cost * (lateral * lateral)
            + rules.heading_cost * (heading * heading)
            + rules.lateral_velocity_cost * (state.lateral_velocity * state.lateral_velocity)
            + rules.yaw_rate_cost * (state.yaw_rate * state.yaw_rate)
            + rules.front_steer_cost * (state.front_steer * state.front_steer)
            + rules.rear_steer_cost * (state.rear_steer * state.rear_steer)
            + rules.front_command_cost * (front * front)
            + rules.rear_command_cost * (rear * rear)
        )

    return quadratic_reward


def worst_stage_cost(xp: Any) -> Callable[[Car, Any], Any]:
    """The largest x'Qx + u'Ru of any state in which an episode is still running.

    The lateral error is at most the width of the corridor plus half a body: the reference, too, lies within it.
    """

    def worst_stage_cost(car: Car, rules: Any) -> Any:
        lateral = 2.0 * rules.road_half_width + 0.5 * car.body_width
        heading = 2.0 * rules.heading_limit
        lateral_velocity = rules.sideslip_limit * car.speed
        return (
            rules.lateral_cost * (lateral * lateral)
            + rules.heading_cost * (heading * heading)
            + rules.lateral_velocity_cost * (lateral_velocity * lateral_velocity)
            + rules.yaw_rate_cost * (rules.yaw_rate_limit * rules.yaw_rate_limit)
            + rules.front_steer_cost * (car.front_angle_limit * car.front_angle_limit)
            + rules.rear_steer_cost * (car.rear_angle_limit * car.rear_angle_limit)
            + rules.front_command_cost
            + rules.rear_command_cost
        )

    return worst_stage_cost


def failure_cost(xp: Any) -> Callable[[Any, Car, Any], Any]:
    """What an early end after a number of steps costs: the worst stage cost for every step that is left."""
    worst = xp.function(worst_stage_cost(xp))

    def failure_cost(steps: Any, car: Car, rules: Any) -> Any:
        return xp.maximum(rules.horizon - steps, 0.0) * worst(car, rules)

    return failure_cost
