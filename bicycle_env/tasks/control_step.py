"""One control step of any task: commands, RK4 substeps, reference, end, cost, reward."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.model import Model
from bicycle_env.physics.records import merged, replaced
from bicycle_env.tasks.episode import EpisodeState, Reference, World
from bicycle_env.tasks.rewards import Reward
from bicycle_env.tasks.task import Task

Law = Callable[..., Any]
Axles = tuple[Any, Any]
"""(front, rear)."""


GRIP = ("front_cornering_stiffness", "rear_cornering_stiffness", "front_peak_force", "rear_peak_force")
NO_GRIP = 1e-20
"""N/rad, N: in place of 0, by which tire laws divide."""


class Parts(NamedTuple):
    """The three parts of a control step, apart because a compiler vectorises each over many cars, not the whole.

    ``action`` is the pair (front, rear) in [-1, 1], already clipped, 0 for an axle that is not steered; ``command`` is
    what the task's ``command`` sends to the actuators.
    """

    begin: Law
    """``begin(state, episode, action, world) -> (command, before)``; before: what the reward takes from before."""
    advance: Law
    """``advance(state, episode, command, elapsed, world) -> state``: one substep, `elapsed` s into the control step."""
    finish: Law
    """``finish(state, episode, action, command, before, world) -> (episode, reward, end, cost)``."""
    accompany: Law | None
    """``accompany(state, episode, elapsed, world) -> TaskState``: beside `advance`, from the same state, what the task
    has of companions; None where it has none."""


def parts(xp: Any, task: Task, model: Model, reward: Reward) -> Parts:
    """The parts of :func:`transition`."""
    pushed = task.conditions(xp) is not None
    substep = xp.function(rk4(xp, model.State, model.actuated_rates(xp, pushed)))
    command_law = xp.function(command_of(xp, task))
    moment = xp.function(car_of_the_moment(xp, task))
    reference_law = xp.function(task.reference(xp))
    end_law, success_law, cost_law = (xp.function(law(xp)) for law in (task.end, task.success, task.cost))
    reward_law = xp.function(_with_forfeit(xp, task, reward))
    before_law = xp.function(_before(xp, task, reward))
    remember_law = xp.function(_remember(xp, task))

    def begin(state: CarState, episode: EpisodeState, action: Axles, world: World) -> tuple[Axles, Any]:
        return command_law(state, episode, action, world), before_law(state, episode, action, world)

    def advance(state: CarState, episode: EpisodeState, command: Axles, elapsed: Any, world: World) -> CarState:
        physics_timestep = world.rules.control_timestep / world.rules.substeps
        car = moment(state, episode, elapsed, world)
        moved: CarState = substep(state, command, command, command, car, physics_timestep)
        return moved

    def finish(
        state: CarState, episode: EpisodeState, action: Axles, command: Axles, before: Any, world: World
    ) -> tuple[EpisodeState, Any, Any, Any]:
        own, steps = remember_law(state, episode, action, world), episode.steps + 1.0
        now = EpisodeState(command[0], command[1], steps, episode.settled_steps, own)
        reference = reference_law(state, own, world)
        end = end_law(state, reference, now, world)
        cost = cost_law(state, reference, now, world)
        gained = reward_law(state, reference, action, episode, before, end, world)
        settled = xp.where(success_law(state, reference, now, world), episode.settled_steps + 1.0, 0.0)
        return EpisodeState(command[0], command[1], steps, settled, own), gained, end, cost

    return Parts(begin, advance, finish, _accompany(xp, task, model))


def command_of(xp: Any, task: Task) -> Law:
    """``command(state, episode, action, world) -> (front, rear)`` [rad], within the actuators' angle limits."""
    own = task.command(xp)

    def scaled(state: CarState, episode: EpisodeState, action: Axles, world: World) -> Axles:
        return action[0] * world.car.front_angle_limit, action[1] * world.car.rear_angle_limit

    if own is None:
        return scaled
    law = xp.function(own)

    def clipped(state: CarState, episode: EpisodeState, action: Axles, world: World) -> Axles:
        front, rear = law(state, episode, action, world)
        most_front, most_rear = world.car.front_angle_limit, world.car.rear_angle_limit
        return (
            xp.maximum(xp.minimum(front, most_front), -most_front),
            xp.maximum(xp.minimum(rear, most_rear), -most_rear),
        )

    return clipped


def car_of_the_moment(xp: Any, task: Task) -> Law:
    """``moment(state, episode, elapsed, world) -> CarParameters``: under the task's conditions, or the world's car."""
    conditions = task.conditions(xp)
    if conditions is None:

        def always(state: CarState, episode: EpisodeState, elapsed: Any, world: World) -> CarParameters:
            return world.car

        return always
    law, gripping = xp.function(conditions), replaced(xp, CarParameters, GRIP)

    def moment(state: CarState, episode: EpisodeState, elapsed: Any, world: World) -> CarParameters:
        time = xp.multiply_add(episode.steps, world.rules.control_timestep, elapsed)
        car = law(state, episode, time, world)
        held: CarParameters = gripping(
            car,
            xp.maximum(car.front_cornering_stiffness, NO_GRIP),
            xp.maximum(car.rear_cornering_stiffness, NO_GRIP),
            xp.maximum(car.front_peak_force, NO_GRIP),
            xp.maximum(car.rear_peak_force, NO_GRIP),
        )
        return held

    return moment


def _before(xp: Any, task: Task, reward: Reward) -> Law:
    law = reward.before(xp)
    if law is None:

        def nothing(state: CarState, episode: EpisodeState, action: Axles, world: World) -> Any:
            return 0.0 * action[0]

        return nothing
    before_law, reference_law = xp.function(law), xp.function(task.reference(xp))

    def before(state: CarState, episode: EpisodeState, action: Axles, world: World) -> Any:
        return before_law(state, reference_law(state, episode.task_state, world), action, world)

    return before


def _with_forfeit(xp: Any, task: Task, reward: Reward) -> Law:
    own, forfeit = reward.law(xp), reward.forfeit(xp, task)
    if forfeit is None:
        return own
    law, forfeit_law = xp.function(own), xp.function(forfeit)

    def paid(
        state: CarState, reference: Reference, action: Axles, episode: EpisodeState, before: Any, end: Any, world: World
    ) -> Any:
        gained = law(state, reference, action, episode, before, end, world)
        return gained + xp.where(end > 0, forfeit_law(episode.steps + 1.0, world.car, world.rules), 0.0)

    return paid


def _remember(xp: Any, task: Task) -> Law:
    law = task.remember(xp)
    if law is not None:
        return law

    def the_same(state: CarState, episode: EpisodeState, action: Axles, world: World) -> Any:
        return episode.task_state

    return the_same


def _accompany(xp: Any, task: Task, model: Model) -> Law | None:
    own = task.accompany(xp, model)
    if own is None:
        return None
    law, moment = xp.function(own), xp.function(car_of_the_moment(xp, task))
    join = merged(xp, task.TaskState, task.companions)

    def accompany(state: CarState, episode: EpisodeState, elapsed: Any, world: World) -> Any:
        physics_timestep = world.rules.control_timestep / world.rules.substeps
        car = moment(state, episode, elapsed, world)
        return join(episode.task_state, law(state, episode, car, physics_timestep, world))

    return accompany


def _beside(xp: Any, accompany: Law | None) -> Law:
    """``beside(state, episode, elapsed, world) -> EpisodeState`` after a substep."""

    def alone(state: CarState, episode: EpisodeState, elapsed: Any, world: World) -> EpisodeState:
        return episode

    def beside(state: CarState, episode: EpisodeState, elapsed: Any, world: World) -> EpisodeState:
        own = law(state, episode, elapsed, world)
        front, rear = episode.front_steer_command, episode.rear_steer_command
        return EpisodeState(front, rear, episode.steps, episode.settled_steps, own)

    if accompany is None:
        return alone
    law = xp.function(accompany)
    return beside


def transition(xp: Any, task: Task, model: Model, reward: Reward) -> Law:
    """``step(state, episode, action, world, substeps) -> (state, episode, reward, end, cost)``: a control step.

    `substeps` is a whole number; see :class:`Parts` for the rest.
    """
    made = parts(xp, task, model, reward)
    begin, advance, finish = (xp.function(law) for law in made[:3])
    beside = xp.function(_beside(xp, made.accompany))

    def step(
        state: CarState, episode: EpisodeState, action: Axles, world: World, substeps: int
    ) -> tuple[CarState, EpisodeState, Any, Any, Any]:
        command, before = begin(state, episode, action, world)
        physics_timestep = world.rules.control_timestep / world.rules.substeps
        elapsed = 0.0 * physics_timestep
        for _ in range(substeps):
            moved = advance(state, episode, command, elapsed, world)
            episode = beside(state, episode, elapsed, world)
            state, elapsed = moved, elapsed + physics_timestep
        after, gained, end, cost = finish(state, episode, action, command, before, world)
        return state, after, gained, end, cost

    return step
