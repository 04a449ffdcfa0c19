"""The two rewards that every task has."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bicycle_env.physics.single_track import Car, CarState
from bicycle_env.tasks.episode import Memory, Reference, World

REWARDS = ("default", "quadratic")


def plus_square(xp: Any) -> Callable[[Any, Any, Any], Any]:
    """``plus_square(total, weight, value)``: total + weight x value^2, the one step of every sum here."""

    def plus_square(total: Any, weight: Any, value: Any) -> Any:
        return xp.multiply_add(weight, value * value, total)

    return plus_square


def bounded_reward(xp: Any) -> Callable[..., Any]:
    """1 / (1 + c) in (0, 1], c a weighted sum of squares: regulation of the new state, effort, smoothness.

    Effort is the squared action, smoothness the squared change of the action since the last step; both per axle.
    """
    plus = xp.function(plus_square(xp))

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
        front_change = xp.multiply_add(-memory.front_steer_command, per_front, front)
        rear_change = xp.multiply_add(-memory.rear_steer_command, per_rear, rear)
        total = plus(1.0, rules.lateral_weight, lateral)
        total = plus(total, rules.heading_weight, heading)
        total = plus(total, rules.sideslip_weight, sideslip)
        total = plus(total, rules.yaw_rate_weight, state.yaw_rate)
        total = plus(total, rules.effort_weight, front)
        total = plus(total, rules.effort_weight, rear)
        total = plus(total, rules.smoothness_weight, front_change)
        total = plus(total, rules.smoothness_weight, rear_change)
        return 1.0 / total

    return bounded_reward


def quadratic_reward(xp: Any) -> Callable[..., Any]:
    """-(x'Qx + u'Ru), diagonal Q and R, from the state before the step, its reference there, and the action."""
    plus = xp.function(plus_square(xp))

    def quadratic_reward(state: CarState, reference: Reference, action: tuple[Any, Any], world: World) -> Any:
        rules = world.rules
        lateral = state.lateral_position - reference.lateral_position
        heading = state.heading - reference.heading
        front, rear = action
        total = plus(0.0, rules.lateral_cost, lateral)
        total = plus(total, rules.heading_cost, heading)
        total = plus(total, rules.lateral_velocity_cost, state.lateral_velocity)
        total = plus(total, rules.yaw_rate_cost, state.yaw_rate)
        total = plus(total, rules.front_steer_cost, state.front_steer)
        total = plus(total, rules.rear_steer_cost, state.rear_steer)
        total = plus(total, rules.front_command_cost, front)
        return -plus(total, rules.rear_command_cost, rear)

    return quadratic_reward


def worst_stage_cost(xp: Any) -> Callable[[Car, Any], Any]:
    """The largest x'Qx + u'Ru of any state in which an episode is still running.

    The lateral error is at most the width of the corridor plus half a body: the reference, too, lies within it.
    """
    plus = xp.function(plus_square(xp))

    def worst_stage_cost(car: Car, rules: Any) -> Any:
        total = plus(
            rules.front_command_cost + rules.rear_command_cost,  # actions of 1
            rules.lateral_cost,
            xp.multiply_add(0.5, car.body_width, 2.0 * rules.road_half_width),
        )
        total = plus(total, rules.heading_cost, 2.0 * rules.heading_limit)
        total = plus(total, rules.lateral_velocity_cost, rules.sideslip_limit * car.speed)
        total = plus(total, rules.yaw_rate_cost, rules.yaw_rate_limit)
        total = plus(total, rules.front_steer_cost, car.front_angle_limit)
        return plus(total, rules.rear_steer_cost, car.rear_angle_limit)

    return worst_stage_cost


def failure_cost(xp: Any) -> Callable[[Any, Car, Any], Any]:
    """What an early end after a number of steps costs: the worst stage cost for every step that is left."""
    worst = xp.function(worst_stage_cost(xp))

    def failure_cost(steps: Any, car: Car, rules: Any) -> Any:
        return xp.maximum(rules.horizon - steps, 0.0) * worst(car, rules)

    return failure_cost
