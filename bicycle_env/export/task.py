"""A whole task written out: start, observation, and one step of the environment with its reward and end."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import load_env_creator

from bicycle_env.backends.trace import TraceError
from bicycle_env.envs.configuration import Configuration, configure
from bicycle_env.envs.origin import origin_of
from bicycle_env.export import bodies
from bicycle_env.export.routines import Argument, Library, Routine
from bicycle_env.physics.car import CarParameters
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.records import record_of
from bicycle_env.tasks.control_step import parts, transition
from bicycle_env.tasks.episode import EpisodeState, Rules, World
from bicycle_env.tasks.task import Task

STARTS, STEPS = 4, 6
"""Of the test vectors: episodes, and steps of each at which a vector is taken."""
BETWEEN = 5
"""Steps from one vector to the next."""


class Action(NamedTuple):
    """In [-1, 1]; of an axle that is not steered it does not matter."""

    front: Any
    rear: Any


class Begun(NamedTuple):
    """What stays the same during a control step."""

    front_steer_command: Any
    rear_steer_command: Any
    before: Any
    """What the reward takes from before the step."""


class Episode(NamedTuple):
    """As EpisodeState, without the task's own."""

    front_steer_command: Any
    rear_steer_command: Any
    steps: Any
    settled_steps: Any


class Outcome(NamedTuple):
    """Of a step."""

    reward: Any
    end: Any
    cost: Any


def configuration_of(env_id: str, task: Task | None = None, **keywords: Any) -> Configuration:
    """What ``gym.make(env_id, **keywords)`` would be made of; nothing is compiled. `task`: in place of the id's own.

    Raises:
        ValueError, TypeError: an unknown id, or one of another package; a bad keyword.
    """
    try:
        spec = gym.spec(env_id)
    except gym.error.Error as error:
        raise ValueError(f"env_id: {error}") from None
    made: Any = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    if not hasattr(made, "default_task"):
        raise ValueError(f"env_id must be an environment of this package, got {env_id!r}")
    origin = origin_of(task or made.default_task, {**spec.kwargs, **keywords})
    return configure(origin.task, origin.setup, spec.max_episode_steps)


def routines(configuration: Configuration) -> tuple[Routine, ...]:
    """All that an episode needs; each is given the world as its car, rules and settings.

    Raises:
        TraceError: a law that cannot be written out: sensors' noise.
    """
    task, model, reward = configuration.task, configuration.model, configuration.reward
    Own, State = task.TaskState, model.State
    Observation = record_of("Observation", tuple(re.sub(r"\W", "_", e.name) for e in configuration.observation_entries))
    Uniforms = record_of("Uniforms", tuple(f"u{k}" for k in range(task.uniforms)))
    world = (Argument("car", CarParameters), Argument("rules", Rules), Argument("settings", task.Settings))
    state, episode = Argument("state", State), Argument("episode", Episode)
    own, action, begun = Argument("task_state", Own), Argument("action", Action), Argument("begun", Begun)
    now, elapsed = (state, episode, own), Argument("elapsed")
    next_state, next_episode = Argument("next", State, "state"), Argument("next_episode", Episode, "episode")
    next_own, outcome = Argument("next_task_state", Own, "task_state"), Argument("outcome", Outcome)

    def start(xp: Any) -> Any:
        law, complete = task.start(xp), model.complete(xp)

        def started(uniforms: Any, *these: Any) -> Any:
            state, own = law(uniforms, World(*these))
            return complete(state, these[0]), Episode(*(0.0 * uniforms[0],) * 4), own

        return started

    def steered(xp: Any) -> Any:
        def steered(action: Action, rules: Rules) -> Action:
            return Action(
                xp.minimum(xp.maximum(action.front, -1.0), 1.0) * rules.steers_front,
                xp.minimum(xp.maximum(action.rear, -1.0), 1.0) * rules.steers_rear,
            )

        return steered

    def begin(xp: Any) -> Any:
        law = parts(xp, task, model, reward).begin

        def begin(state: Any, episode: Episode, own: Any, action: Action, *these: Any) -> Begun:
            (front, rear), before = law(state, EpisodeState(*episode, own), tuple(action), World(*these))
            return Begun(front, rear, before)

        return begin

    def advance(xp: Any) -> Any:
        law = parts(xp, task, model, reward).advance

        def advance(state: Any, episode: Episode, own: Any, begun: Begun, elapsed: Any, *these: Any) -> Any:
            return law(state, EpisodeState(*episode, own), tuple(begun[:2]), elapsed, World(*these))

        return advance

    def accompany(xp: Any) -> Any:
        law: Any = parts(xp, task, model, reward).accompany

        def accompany(state: Any, episode: Episode, own: Any, elapsed: Any, *these: Any) -> Any:
            return law(state, EpisodeState(*episode, own), elapsed, World(*these))

        return accompany

    def finish(xp: Any) -> Any:
        law = parts(xp, task, model, reward).finish

        def finish(
            state: Any, episode: Episode, own: Any, action: Action, begun: Begun, *these: Any
        ) -> tuple[Episode, Any, Outcome]:
            before = EpisodeState(*episode, own)
            after, *told = law(state, before, tuple(action), tuple(begun[:2]), begun.before, World(*these))
            return Episode(*after[:4]), after.task_state, Outcome(*told)

        return finish

    def scaled(xp: Any) -> Any:
        law, preview = task.observe(xp), task.preview(xp)

        def scaled(state: Any, episode: Episode, own: Any, scale: Any, *these: Any) -> Any:
            there = World(*these)
            ahead = [preview(state, own, there, time) for time in task.preview_times]
            values = [*law(state, EpisodeState(*episode, own), there), *ahead]
            return Observation(*(value * factor for value, factor in zip(values, scale, strict=True)))

        return scaled

    def observe(xp: Any) -> Any:
        law, bounds = scaled(xp), configuration.observation_bound

        def observe(*arguments: Any) -> Any:
            return Observation(*np.clip(np.array(law(*arguments), np.float32), -bounds, bounds).tolist())

        return observe

    def step(xp: Any) -> Any:
        law, masked = transition(xp, task, model, reward), steered(xp)

        def step(state: Any, episode: Episode, own: Any, action: Action, *these: Any) -> Any:
            there = World(*these)
            acting = tuple(masked(action, there.rules))
            after, changed, *told = law(state, EpisodeState(*episode, own), acting, there, int(there.rules.substeps))
            return after, Episode(*changed[:4]), changed.task_state, Outcome(*told)

        return step

    def scales(_xp: Any) -> Any:
        def scales(car: CarParameters) -> Any:
            entries = task.entries(car.speed, car.front_angle_limit, car.rear_angle_limit)
            return Observation(*(1.0 / entry.scale for entry in entries))

        return scales

    scale = Argument("scale", Observation, "observation")
    observation = Argument("observation", Observation)
    uniforms = Argument("uniforms", Uniforms)
    with_companions = task.accompany(PYTHON, model) is not None
    found = [
        Routine(
            "start",
            "The start of an episode, of uniform numbers in [0, 1).",
            (uniforms, *world),
            (next_state, next_episode, next_own),
            start,
        ),
        Routine(
            "steered",
            "The action as it acts: clipped, 0 for an axle that is not steered.",
            (action, world[1]),
            (Argument("acting", Action, "action"),),
            steered,
        ),
        Routine(
            "begin",
            "The commands of a control step, and what its reward takes from before it; action: as acts.",
            (*now, action, *world),
            (begun,),
            begin,
        ),
        Routine(
            "advance",
            "One RK4 substep, elapsed [s] after the control step has begun.",
            (*now, begun, elapsed, *world),
            (next_state,),
            advance,
        ),
        Routine(
            "finish",
            "What a control step comes to, from the state after its substeps and the episode before it.",
            (*now, action, begun, *world),
            (next_episode, next_own, outcome),
            finish,
        ),
        Routine(
            "scaled",
            "The observation in double precision and not clipped, times scale.",
            (*now, scale, *world),
            (observation,),
            scaled,
        ),
    ]
    if with_companions:
        found.append(
            Routine(
                "accompany",
                "What moves beside the car, in a substep; from the state before it.",
                (*now, elapsed, *world),
                (next_own,),
                accompany,
            )
        )
    found += _as_far_as_traced(
        Routine("scales", "What observations are multiplied by, at the speed of a car.", (world[0],), (scale,), scales),
        Routine(
            "settings_at",
            "The task's numbers at the speed of a car.",
            (world[0],),
            (world[2],),
            lambda _: lambda car: task.settings(car.speed),
        ),
    )
    has = (bool(Own._fields), bool(task.Settings._fields))
    bounds = dict(zip(Observation._fields, configuration.observation_bound.tolist(), strict=True))
    steps = [bodies.step(c, with_companions, *has) for c in (True, False)]
    looks = [bodies.observe(c, bounds, *has) for c in (True, False)]
    found += [
        Routine(
            "step",
            "A step of the environment: a control step; the episode is over where outcome.end is not 0.",
            (*now, action, *world),
            (next_state, next_episode, next_own, outcome),
            step,
            *steps,
        ),
        Routine(
            "observe",
            "The observation as the environment gives it: single precision, clipped.",
            (*now, scale, *world),
            (observation,),
            observe,
            *looks,
        ),
    ]
    return tuple(found)


def _as_far_as_traced(*wanted: Routine) -> list[Routine]:
    """Those that are laws: of a task of one's own they may be plain Python."""
    found = []
    for routine in wanted:
        try:
            routine.program()
        except TraceError:
            continue
        if any(result.fields for result in routine.results):
            found.append(routine)
    return found


def library(configuration: Configuration, what: str, name: str = "bicycle_task") -> Library:
    """The task as functions, with the numbers of its environment and the inputs of its test vectors."""
    found = routines(configuration)
    task, car, rules = configuration.task, configuration.car, configuration.rules
    settings = configuration.settings
    Observation = next(routine for routine in found if routine.name == "scaled").results[0].record
    scale = Observation(*(1.0 / value for value in configuration.observation_scale.tolist()))
    constants: dict[str, Any] = {"exported_car": car, "exported_rules": rules}
    types = {"exported_car": "car", "exported_rules": "rules", "exported_settings": "settings"}
    if settings:
        constants["exported_settings"] = settings
    constants |= {
        "exported_scale": scale,
        "step_limit": float(task.episode_steps),
        "steps_to_settle": float(configuration.steps_to_settle),
        "end_words": configuration.end_names,
    }
    words = (
        f"{what}: {configuration.vehicle.name or 'car'} at {configuration.speed:.6g} m/s; {configuration.model}.",
        "An episode: start, then step and observe until outcome.end is not 0 (end_words says why), or",
        "episode.steps reaches step_limit: then it was a success if settled_steps is at least steps_to_settle.",
    )
    return Library(
        name,
        words,
        found,
        constants,
        {**types, "exported_scale": "observation"},
        _cases(found, car, rules, settings, scale),
    )


def _cases(found: Sequence[Routine], car: Any, rules: Any, settings: Any, scale: Any) -> dict[str, Any]:
    """Inputs of every routine along a few episodes that are steered at random."""
    laws = {routine.name: routine.law(PYTHON) for routine in found}
    cases: dict[str, list[list[float]]] = {routine.name: [] for routine in found}
    world, draws = (car, rules, settings), np.random.default_rng(14)

    def take(name: str, *arguments: Any) -> Any:
        if name in laws:
            cases[name].append(
                [float(number) for one in arguments for number in (one if isinstance(one, tuple) else (one,))]
            )
        return laws[name](*arguments) if name in laws else None

    uniforms = next(routine for routine in found if routine.name == "start").arguments[0].record
    for _ in range(STARTS):
        now = take("start", uniforms(*draws.random(len(uniforms._fields)).tolist()), *world)
        for k in range(STEPS * BETWEEN):
            action = Action(*draws.uniform(-1.2, 1.2, 2).tolist())
            if k % BETWEEN:
                *now, outcome = laws["step"](*now, action, *world)
            else:
                elapsed = float(draws.uniform(0.0, rules.control_timestep))
                acting = take("steered", action, rules)
                begun = take("begin", *now, acting, *world)
                take("advance", *now, begun, elapsed, *world)
                take("accompany", *now, elapsed, *world)
                take("finish", *now, acting, begun, *world)
                take("scaled", *now, scale, *world)
                take("observe", *now, scale, *world)
                *now, outcome = take("step", *now, action, *world)
            if outcome.end:
                break
    for factor in (0.8, 1.0, 1.3):
        take("scales", car._replace(speed=factor * car.speed))
        take("settings_at", car._replace(speed=factor * car.speed))
    return cases
