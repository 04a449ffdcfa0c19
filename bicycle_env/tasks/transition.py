"""One control step of any task: commands, RK4 substeps, reference, end, cost, reward."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.single_track import CarState, actuated_single_track
from bicycle_env.physics.tires import Tire
from bicycle_env.tasks.ends import corner_outside, end_code, settled
from bicycle_env.tasks.rewards import bounded_reward, quadratic_reward, worst_stage_cost
from bicycle_env.tasks.task import Memory, Task, World


def transition(xp: Any, task: Task, tire: Tire, geometry: str, reward: str) -> Callable[..., Any]:
    """``step(state, memory, action, world, substeps) -> (state, memory, reward, end, cost)``.

    ``action`` is the pair (front, rear) in [-1, 1] times the actuators' angle limits, already clipped; `substeps` a
    whole number.
    """
    advance = xp.function(rk4(xp, actuated_single_track(xp, tire, geometry)))
    reference_law = xp.function(task.reference(xp))
    end_law = xp.function(end_code(xp))
    settled_law = xp.function(settled(xp))
    cost_law = xp.function(corner_outside(xp))
    bounded = xp.function(bounded_reward(xp))
    quadratic = xp.function(quadratic_reward(xp))
    worst = xp.function(worst_stage_cost(xp))
    is_quadratic = reward == "quadratic"

    def step(
        state: CarState, memory: Memory, action: tuple[Any, Any], world: World, substeps: int
    ) -> tuple[CarState, Memory, Any, Any, Any]:
        car, rules = world.car, world.rules
        before, reference_before = state, reference_law(state, memory.route, world)
        command = (action[0] * car.front_angle_limit, action[1] * car.rear_angle_limit)
        physics_timestep = rules.control_timestep / rules.substeps
        for _ in range(substeps):
            state = advance(state, command, command, command, car, physics_timestep)
        reference = reference_law(state, memory.route, world)
        end = end_law(state, reference, world)
        cost = cost_law(state, reference, world)
        steps = memory.steps + 1.0
        if is_quadratic:
            remaining = xp.maximum(rules.horizon - steps, 0.0)
            failure = xp.where(end > 0, remaining * worst(car, rules), 0.0)
            gained = quadratic(before, reference_before, action, world) - failure
        else:
            gained = bounded(state, reference, action, memory, world)
        remembered = Memory(
            command[0],
            command[1],
            steps,
            xp.where(settled_law(state, reference, world), memory.settled_steps + 1.0, 0.0),
            memory.route,
        )
        return state, remembered, gained, end, cost

    return step
