"""One control step of any task: commands, RK4 substeps, reference, end, cost, reward."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.single_track import CarState, actuated_single_track
from bicycle_env.physics.tires import Tire
from bicycle_env.tasks.episode import Memory, World
from bicycle_env.tasks.rewards import Reward
from bicycle_env.tasks.task import Task

Law = Callable[..., Any]


class Stages(NamedTuple):
    """The three parts of a control step, apart because a compiler vectorises each over many cars, not the whole.

    ``action`` is the pair (front, rear) in [-1, 1], already clipped, 0 for an axle that is not steered; ``command`` the
    same times the actuators' angle limits.
    """

    begin: Law
    """``begin(state, memory, action, world) -> (command, stage)``; stage: what the reward takes from before."""
    advance: Law
    """``advance(state, command, world) -> state``: one substep."""
    finish: Law
    """``finish(state, memory, action, stage, world) -> (memory, reward, end, cost)``."""


def stages(xp: Any, task: Task, tire: Tire, geometry: str, reward: Reward) -> Stages:
    """The parts of :func:`transition`."""
    substep = xp.function(rk4(xp, actuated_single_track(xp, tire, geometry)))
    reference_law = xp.function(task.reference(xp))
    end_law = xp.function(task.end(xp))
    success_law = xp.function(task.success(xp))
    cost_law = xp.function(task.cost(xp))
    reward_law, before_law = xp.function(reward.law(xp)), reward.before(xp)
    if before_law is None:

        def before(state: CarState, memory: Memory, action: tuple[Any, Any], world: World) -> Any:
            return 0.0 * action[0]
    else:
        given_law = xp.function(before_law)

        def before(state: CarState, memory: Memory, action: tuple[Any, Any], world: World) -> Any:
            return given_law(state, reference_law(state, memory.route, world), action, world)

    before = xp.function(before)

    def begin(state: CarState, memory: Memory, action: tuple[Any, Any], world: World) -> tuple[tuple[Any, Any], Any]:
        command = (action[0] * world.car.front_angle_limit, action[1] * world.car.rear_angle_limit)
        return command, before(state, memory, action, world)

    def advance(state: CarState, command: tuple[Any, Any], world: World) -> CarState:
        physics_timestep = world.rules.control_timestep / world.rules.substeps
        moved: CarState = substep(state, command, command, command, world.car, physics_timestep)
        return moved

    def finish(
        state: CarState, memory: Memory, action: tuple[Any, Any], stage: Any, world: World
    ) -> tuple[Memory, Any, Any, Any]:
        car = world.car
        reference = reference_law(state, memory.route, world)
        end = end_law(state, reference, world)
        cost = cost_law(state, reference, world)
        gained = reward_law(state, reference, action, memory, stage, end, world)
        remembered = Memory(
            action[0] * car.front_angle_limit,
            action[1] * car.rear_angle_limit,
            memory.steps + 1.0,
            xp.where(success_law(state, reference, world), memory.settled_steps + 1.0, 0.0),
            memory.route,
        )
        return remembered, gained, end, cost

    return Stages(begin, advance, finish)


def transition(xp: Any, task: Task, tire: Tire, geometry: str, reward: Reward) -> Law:
    """``step(state, memory, action, world, substeps) -> (state, memory, reward, end, cost)``: a control step.

    `substeps` is a whole number; see :class:`Stages` for the rest.
    """
    begin, advance, finish = (xp.function(law) for law in stages(xp, task, tire, geometry, reward))

    def step(
        state: CarState, memory: Memory, action: tuple[Any, Any], world: World, substeps: int
    ) -> tuple[CarState, Memory, Any, Any, Any]:
        command, stage = begin(state, memory, action, world)
        for _ in range(substeps):
            state = advance(state, command, world)
        remembered, gained, end, cost = finish(state, memory, action, stage, world)
        return state, remembered, gained, end, cost

    return step
