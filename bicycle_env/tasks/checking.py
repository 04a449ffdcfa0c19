"""What every task and every reward must hold, tried when it is first used: its laws are run on two cars at once.

A number written past the end of an array, or a result of its own in one environment alone, is one line here, which
names the task and the law; see :mod:`bicycle_env.physics.trial`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarParameters, CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY, PYTHON
from bicycle_env.physics.presets import vehicles
from bicycle_env.physics.trial import tried, words
from bicycle_env.physics.validation import check_value, number, positive, whole
from bicycle_env.tasks.control_step import GRIP
from bicycle_env.tasks.episode import COMMANDS, EpisodeState, Reference, Rules, World, state_record
from bicycle_env.tasks.marks import checked
from bicycle_env.tasks.rewards import Reward
from bicycle_env.tasks.task import Task

SPEED, CONTROL_TIMESTEP, SUBSTEPS = 30.0, 0.02, 5
MOST_POINTS = 100
"""Of the body that are judged, along each side."""
DIVISORS = ("speed", "mass", "yaw_inertia", "front_time_constant", "rear_time_constant")
"""Of the car of a moment."""
PLACES = (
    CarState(np.array([0.0, 40.0]), *(np.array([0.01, -0.02]) * size for size in (1.0, 1.0, 5.0, 2.0, 1.0, 1.0))),
    CarState(np.array([70.0, 9.0]), *(np.array([-1.5, 2.0]) * size for size in (2.0, 0.5, 9.0, 1.0, 0.02, 0.02))),
)
"""States of two cars each: near straight running, and far from it."""


def check(task: Task) -> None:
    """Refuse a task that the environments or the analysis would contradict: ValueError or TypeError names its law."""
    check_value("task", task)
    _check_task(task)


def check_reward(task: Task, reward: Reward) -> None:
    """Refuse a reward that fails for a task: ValueError or TypeError names its law."""
    check_value("reward", reward)
    _check_reward(task, reward)


@functools.cache
def _check_task(task: Task) -> None:
    name = type(task).__name__
    taken = set(task.TaskState._fields) & {*CarState._fields, *COMMANDS, "time"}
    if taken:
        raise ValueError(f"task {name}: TaskState must have other names than the car's, got {', '.join(sorted(taken))}")
    if task.State._fields != state_record(name, task.TaskState)._fields:
        raise ValueError(f"task {name}: State must be left out, it follows from TaskState; got {task.State._fields}")
    for what in ("flipped", "hidden", "forfeits"):
        names = getattr(task, what) or ()
        if not set(names) <= set(task.TaskState._fields):
            raise ValueError(f"task {name}: {what} must be names of TaskState, {task.TaskState._fields}, got {names}")
    if type(task).task_state_with is Task.task_state_with and not set(task.options) <= set(task.TaskState._fields):
        raise ValueError(
            f"task {name}: options must be names of TaskState, {task.TaskState._fields}, or have a task_state_with, "
            f"got {', '.join(task.options)}"
        )
    number(f"task {name}: settled_seconds", task.settled_seconds, 0.0)
    for reward in ("default", "quadratic"):
        if not isinstance(task.rewards.get(reward), Reward):
            raise ValueError(f"task {name}: rewards must hold a Reward for {reward!r}, got {task.rewards!r}")
    positive(f"task {name}: road_half_width", task.road_half_width)
    whole(f"task {name}: judged_points", task.judged_points, 2, MOST_POINTS)
    _check_laws(task, name, world_of(task))


def world_of(task: Task) -> World:
    """What the laws are tried in."""
    rules = Rules(CONTROL_TIMESTEP, SUBSTEPS, task.episode_steps, steers_front=1.0, steers_rear=1.0)
    return World(car_on_road(vehicles["me303"], SPEED, 1.0, FRONT, REAR), rules, task.settings(SPEED))


@functools.cache
def _check_reward(task: Task, reward: Reward) -> None:
    name, world = type(reward).__name__, world_of(task)
    law, before = (tried(f"reward {name}: its law {one!r}", getattr(reward, one)) for one in ("law", "before"))
    reference, way = task.reference(NUMPY), task.start(NUMPY)(np.full((task.uniforms, 2), 0.5), world)[1]
    for place in PLACES:
        zero = 0.0 * place.heading
        found = []
        for side in (1.0, -1.0) if task.flipped is not None else (1.0,):
            here, task_state = _mirrored(place, side, CarState._fields[1:]), _mirrored(way, side, task.flipped or ())
            action, episode = (
                (side * (zero + 0.3),) * 2,
                EpisodeState(*(side * (zero + 0.01),) * 2, zero + 3.0, zero, task_state),
            )
            wanted = reference(here, task_state, world)
            given = 0.0 * zero if before is None else before(here, wanted, action, world)
            found += [law(here, wanted, action, episode, given, code, world) for code in (0 * zero, 0 * zero + 1)]
        if task.flipped is not None and not np.array_equal(found[:2], found[2:]):
            raise ValueError(
                f"reward {name}: it is another one for the mirror image, {found[2:]} instead of {found[:2]}"
            )
    forfeit = tried(f"reward {name}: its law 'forfeit'", lambda xp: reward.forfeit(xp, task))
    if forfeit is not None:
        forfeit(np.array([0.0, 100.0]), world.car, world.rules)


def _check_laws(task: Task, name: str, world: World) -> None:
    entries = task.entries(SPEED, FRONT.angle_limit, REAR.angle_limit)
    names, mirror = [entry.name for entry in entries], [entry.mirror for entry in entries]
    if len(set(names)) < len(names):
        raise ValueError(f"task {name}: the names of its entries must differ, got {', '.join(names)}")
    seen = len(entries) - len(task.preview_times)

    def law_of(law: str) -> Callable[..., Any]:
        return tried(f"task {name}: its law {law!r}", getattr(task, law), law == "reference")  # type: ignore[no-any-return]

    start, reference, observe, preview = map(law_of, ("start", "reference", "observe", "preview"))
    end, success, cost = map(law_of, ("end", "success", "cost"))
    changes, changing = _changes(task, name, world)
    uniforms = np.random.default_rng(0).random((task.uniforms, 2))
    state, task_state = start(uniforms, world)
    _must_be(CarState, state, f"task {name}: its law 'start' must return (CarState, TaskState); the first")
    _must_be(task.TaskState, task_state, f"task {name}: its law 'start' must return (CarState, TaskState); the second")
    for place in (state, *PLACES):
        found = []
        for side in (1.0, -1.0) if task.flipped is not None else (1.0,):
            here, way = _mirrored(place, side, CarState._fields[1:]), _mirrored(task_state, side, task.flipped or ())
            zero = 0.0 * here.heading
            episode = EpisodeState(*(side * (zero + 0.01),) * 2, zero + 3.0, zero, way)
            wanted = reference(here, way, world)
            _must_be(Reference, wanted, f"task {name}: its law 'reference'")
            if not np.all(wanted.road_half_width <= task.road_half_width):
                raise ValueError(
                    f"task {name}: its road_half_width must be that of the widest place, got {task.road_half_width} "
                    f"where its law 'reference' says {wanted.road_half_width}"
                )
            values = observe(here, episode, world)
            if len(values) != seen:
                raise ValueError(
                    f"task {name}: its law 'observe' must return a value for each of the {seen} entries that are no "
                    f"preview ({', '.join(names[:seen])}), got {len(values)}"
                )
            ahead = [preview(here, way, world, time) for time in task.preview_times]
            _check_ends(name, task, end(here, wanted, episode, world))
            judged = tuple(law(here, wanted, episode, world) for law in (end, success, cost))
            signed = (
                np.array(value) * (sign if side < 0.0 else 1.0)
                for value, sign in zip((*values, *ahead), mirror, strict=True)
            )
            found.append([*signed, *map(np.array, (*judged, *changes(here, episode, side)))])
        labels = [*(f"entry {entry!r}" for entry in names), "law 'end'", "law 'success'", "law 'cost'", *changing]
        for label, left, right in zip(labels, found[0], found[-1], strict=True):
            if not np.array_equal(left, right):
                raise ValueError(
                    f"task {name}: its {label} is another one for the mirror image, {right} instead of {left}; give "
                    "the entry its `mirror`, name what changes sign in `flipped` (of a disturbance: `flips`), or set "
                    "`flipped` to None"
                )
    _, drawn = task.start(PYTHON)((0.5,) * task.uniforms, world)
    try:
        checked(task.marks(drawn, world))
    except Exception as error:
        raise ValueError(f"task {name}: its marks fail ({words(error)})") from error


def _changes(task: Task, name: str, world: World) -> tuple[Callable[..., Any], list[str]]:
    """What happens to the car and is remembered, as its mirror image would have it; and what each number is."""

    command, conditions, remember = (
        tried(f"task {name}: its law {law!r}", getattr(task, law), law != "command")
        for law in ("command", "conditions", "remember")
    )

    def changes(state: CarState, episode: EpisodeState, side: float) -> list[Any]:
        zero = 0.0 * state.heading
        action = (side * (zero + 0.3), side * (zero - 0.2))
        values = []
        if command is not None:
            sent = command(state, episode, action, world)
            if not isinstance(sent, tuple) or len(sent) != 2:
                raise ValueError(f"task {name}: its law 'command' must return (front, rear), got {sent!r}")
            values += [side * value for value in sent]
        if conditions is not None:
            car = conditions(state, episode, 0.06 + zero, world)
            _must_be(CarParameters, car, f"task {name}: its law 'conditions'")
            for field in (*DIVISORS, *GRIP):
                value, least = getattr(car, field), ">= 0" if field in GRIP else "> 0"
                if not np.all(value >= 0.0 if field in GRIP else value > 0.0):
                    raise ValueError(f"task {name}: its law 'conditions' must give a {field} {least}, got {value}")
            values += _mirrored(car, side, ("side_force", "yaw_moment"))
        if remember is not None:
            own = remember(state, episode, action, world)
            _must_be(task.TaskState, own, f"task {name}: its law 'remember'")
            values += _mirrored(own, side, task.flipped or ())
        return values

    labels = ["law 'command'"] * 2 if command is not None else []
    labels += ["law 'conditions'"] * len(CarParameters._fields) if conditions is not None else []
    labels += ["law 'remember'"] * len(task.TaskState._fields) if remember is not None else []
    return changes, labels


def _check_ends(name: str, task: Task, code: Any) -> None:
    known = {k for k, word in enumerate(task.end_names) if word != "invalid_action"}
    if not set(np.ravel(code).tolist()) <= known:
        raise ValueError(f"task {name}: its law 'end' must return codes among {sorted(known)}, got {np.ravel(code)}")


def _must_be(record: type, value: Any, label: str) -> None:
    if not isinstance(value, record):
        raise TypeError(f"{label} must be a {record.__name__}, got {type(value).__name__}")


def _mirrored(record: Any, side: float, names: tuple[str, ...]) -> Any:
    return record._replace(**{name: side * getattr(record, name) for name in names})
