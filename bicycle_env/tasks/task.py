"""What a task is: a few pure functions of state, episode and world, written in a namespace ``xp`` like the physics.

A task is a frozen object, compared by value, like a tire: the environments and their compiled code are given the object
itself and do not know which task they run. It says how an episode starts, which reference the car should follow and how
wide the corridor is in which it must stay. What ends an episode, what is a success and what costs has a default in the
modules beside this one, written against that reference; a task may have its own.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Self

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.model import Model
from bicycle_env.physics.validation import choice, known_keys, number
from bicycle_env.tasks.ends import Limits, Tolerances, corner_outside, end_code, settled
from bicycle_env.tasks.episode import EpisodeState, World, state_record
from bicycle_env.tasks.marks import Mark
from bicycle_env.tasks.metrics import SHARED, Metric
from bicycle_env.tasks.rewards import Reward


class Entry(NamedTuple):
    """One entry of the observation: value / scale, clipped to [-bound, bound]."""

    name: str
    unit: str
    scale: float
    bound: float
    meaning: str
    mirror: float = -1.0
    """What the entry is multiplied by in the mirror image: -1, or +1 for what has no side."""


Law = Callable[..., Any]


class History(NamedTuple):
    """What a figure draws over the time beside a quantity of the car."""

    quantity: str
    """A name in the state, such as "yaw_rate"."""
    label: str
    """For the legend; "" for none."""
    law: Callable[[Any, Any, Any], Any]
    """``law(task_state, time, car)``, of arrays; nan where there is nothing to draw."""
    line: str = ":"
    """matplotlib's style."""


Allowed = Mapping[str, float] | tuple[float, float]
"""What an option may be: one of some words, each of which stands for a number; or a number in a range."""


def allowed_number(name: str, value: Any, allowed: Allowed) -> float:
    """The number that a word stands for, itself too, or a number in a range; ValueError or TypeError otherwise."""
    if not isinstance(allowed, Mapping):
        return number(name, value, *allowed)
    if isinstance(value, str) or value not in allowed.values():
        return allowed[choice(name, value, allowed)]
    return number(name, value)


NEEDED = ("name", "episode_steps", "TaskState", "Settings", "uniforms", "ends", "rewards")
"""What a task must say beside its abstract laws."""


class Task(abc.ABC):
    """Base of the tasks: frozen dataclasses whose fields are the task's own keywords, checked in ``__post_init__``.

    What a law takes from a field becomes a constant of the compiled code; what depends on the car or the speed, or
    should change without compiling anew, goes into ``settings``. What is a property here may be a constant of a
    subclass, ``limits = Limits(heading=0.5)``, or a field, which is a keyword then.
    """

    name: ClassVar[str]
    episode_steps: ClassVar[int]
    TaskState: ClassVar[Any]
    """Named-tuple class of what an episode has of its own: drawn at its start, changed by :meth:`remember`."""
    Settings: ClassVar[Any]
    """Named-tuple class of the task's numbers."""
    uniforms: ClassVar[int]
    """How many uniform numbers in [0, 1) a start takes."""
    ends: ClassVar[tuple[str, ...]]
    """The words in ``info["end"]`` for the codes 1, 2, 4, 5, ... of :meth:`end`; 3 is the environments' own."""
    options: ClassVar[Mapping[str, Allowed]] = {}
    """Reset options of the task beside ``state``."""
    defaults: ClassVar[Mapping[str, Any]] = {}
    """Keywords of the environments whose default is another one for this task, such as ``{"vehicle": "tsx"}``."""
    levels: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """By the names that ``level=`` takes: keywords of the environments and fields of the task. That without any is what
    the task is without ``level=``."""

    rewards: ClassVar[Mapping[str, Reward]]
    """By the names that ``reward=`` takes: "default", "quadratic", and others if there are. The quadratic one is also
    the cost that controllers get for a task without tuned weights."""
    settled_seconds: ClassVar[float] = 1.0
    """How long :meth:`success` must have held when the time is over; 0: at that moment."""
    uniform_corridor: ClassVar[bool] = True
    """Whether the corridor of :meth:`reference` is the same beside the whole body; if not, each corner is judged at
    its own place on the road."""
    judged_points: ClassVar[int] = 2
    """How many points along each side of the body are judged then: the two corners, and others between them."""
    flipped: ClassVar[tuple[str, ...] | None] = ()
    """Names in ``TaskState`` that change sign in the mirror image; None for a task that has no mirror image."""
    hidden: ClassVar[tuple[str, ...]] = ()
    """Names in ``TaskState`` that are drawn for an episode and that its first observation does not tell."""
    forfeits: ClassVar[tuple[str, ...]] = ()
    """Names in ``TaskState`` of what is 1 once success can no longer come, though the episode goes on, else 0."""

    def __new__(cls, *_: Any, **__: Any) -> Self:
        """TypeError that names all that the task must say and does not."""
        missing = [name for name in NEEDED if not hasattr(cls, name)]
        missing += sorted(cls.__abstractmethods__)
        if cls.success is Task.success and cls.tolerances is Task.tolerances:
            missing.append("tolerances (or a success of its own)")
        if missing:
            raise TypeError(
                f"task {cls.__name__} must have {', '.join(missing)} (docs/your_own.md lists what is needed)"
            )
        return super().__new__(cls)

    @property
    def State(self) -> Any:
        """Named-tuple class of ``env.unwrapped.state``: CarState, both commands, time, then the task's own state."""
        return state_record(f"{type(self).__name__}State", self.TaskState)

    @property
    def limits(self) -> Limits:
        """Of :meth:`end` and of the quadratic reward."""
        return Limits()

    @property
    def tolerances(self) -> Tolerances:
        """Of the default :meth:`success`; AttributeError where the task has none."""
        raise AttributeError(f"task {type(self).__name__} has no tolerances")

    @property
    @abc.abstractmethod
    def road_half_width(self) -> float:
        """From the middle of the corridor to its edge, m, at its widest place: the one of :meth:`reference`."""

    @property
    def preview_times(self) -> tuple[float, ...]:
        """Look-ahead times of the preview in the observation, s."""
        return ()

    @property
    def usual_speed(self) -> float | None:
        """m/s, where neither speed nor speed_ratio is given; None: what the environments say."""
        return None

    @property
    def told(self) -> tuple[str, ...]:
        """Names of the task's own state that ``info`` tells, too."""
        return ()

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """The figures of an episode beside success, end and return."""
        return SHARED

    @property
    def histories(self) -> tuple[History, ...]:
        """What figures of an episode draw beside the car's own."""
        return ()

    @property
    def undriven(self) -> Task:
        """The task without a driver of its own: what ``driver=`` is added to."""
        return self

    @property
    def end_names(self) -> tuple[str, ...]:
        """The words of the end codes 0, 1, 2, ..."""
        return ("", *self.ends[:2], "invalid_action", *self.ends[2:])

    @abc.abstractmethod
    def settings(self, speed: float) -> Any:
        """The task's numbers at a speed, as ``Settings``."""

    def seconds_to_pass(self, car: CarParameters) -> float:
        """What a success takes at least, s: a time limit below it is remarked on."""
        return 0.0

    @abc.abstractmethod
    def start(self, xp: Any) -> Law:
        """``start(uniforms, world) -> (CarState, TaskState)``, a pure function of the uniforms."""

    @abc.abstractmethod
    def reference(self, xp: Any) -> Law:
        """``reference(state, task_state, world) -> Reference``."""

    @abc.abstractmethod
    def observe(self, xp: Any) -> Law:
        """``observe(state, episode, world) -> tuple``, SI values of ``entries`` without the preview."""

    def preview(self, xp: Any) -> Law:
        """``preview(state, task_state, world, time) -> m``: lateral distance to the reference `time` seconds ahead."""

        def preview(state: CarState, task_state: Any, world: World, time: Any) -> Any:
            return 0.0 * state.lateral_position

        return preview

    def command(self, xp: Any) -> Law | None:
        """``command(state, episode, action, world) -> (front, rear)`` [rad], once per control step: who steers.

        What is sent to the two actuators, which clip it to their angle limits. By default, None, the action, a pair in
        [-1, 1], times these limits.
        """
        return None

    def conditions(self, xp: Any) -> Law | None:
        """``conditions(state, episode, time, world) -> CarParameters``, or None where the car stays what it is.

        The car of this moment, anew in every substep of the physics: another friction, stiffness or mass, a gust as
        ``side_force``. The other laws go on seeing the nominal car in ``world``. What ``randomise=`` draws and
        ``disturbances=`` do comes after: it changes the car that is given here, as a factor of its peak forces.
        """
        return None

    def remember(self, xp: Any) -> Law | None:
        """``remember(state, episode, action, world) -> TaskState`` after a control step, or None where it stays.

        ``state`` is the one after the step, ``episode`` the one before it. The other laws of the step see the result;
        the reward sees the episode as it was before the step, and the result one step later.
        """
        return None

    @property
    def companions(self) -> tuple[str, ...]:
        """Names in ``TaskState`` that :meth:`accompany` moves."""
        return ()

    def accompany(self, xp: Any, model: Model) -> Law | None:
        """``accompany(state, episode, car, timestep, world) -> record`` of the companions; None: there are none.

        What moves beside the car, such as a second one that is steered otherwise: anew in every substep of the physics,
        with the car of that moment, from the state before it.
        """
        return None

    def refilled(self, xp: Any) -> Law | None:
        """``refilled(state, episode, world) -> TaskState`` where a start was given by options; None: it is as drawn.

        For what depends on the place: a car that is put behind the last cone has not passed it.
        """
        return None

    def end(self, xp: Any) -> Law:
        """``end(state, reference, episode, world) -> code``: 0 while running; ``ends`` has the others' words.

        ``episode`` is as the control step has left it, as for the two laws that follow.
        """
        return end_code(xp, self.limits)

    def success(self, xp: Any) -> Law:
        """``success(state, reference, episode, world) -> bool``: what must hold when the time is over.

        And for ``settled_seconds`` before it. An episode that :meth:`end` ends is no success.
        """
        return settled(xp, self.tolerances)

    def cost(self, xp: Any) -> Law:
        """``cost(state, reference, episode, world)``: the safety cost of a step, beside the reward."""
        return corner_outside(xp, self)

    def marks(self, task_state: Any, world: World) -> tuple[Mark, ...]:
        """What else is drawn on the road: cones, patches of ice. Floats and plain Python, unlike a law."""
        return ()

    @abc.abstractmethod
    def entries(self, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
        """The observation, entry by entry."""

    def task_state_with(self, task_state: Any, numbers: Mapping[str, Any], speed: Any) -> Any:
        """The task's state changed by what :meth:`option_numbers` gives; by default the numbers of the same names."""
        return task_state._replace(**{name: numbers[name] for name in task_state._fields if name in numbers})

    def option_numbers(
        self, options: Mapping[str, Any], read: Callable[[str, Any, Allowed], Any] = allowed_number
    ) -> dict[str, Any]:
        """The task's own options as numbers; ValueError or TypeError if one is bad.

        `read(label, value, allowed)`: gives the number; that of an environment with many cars also takes columns.
        """
        return {
            name: read(f"options[{name!r}]", options[name], allowed)
            for name, allowed in self.options.items()
            if name in options
        }

    def check_options(self, options: object, more: tuple[str, ...] = ()) -> Mapping[str, Any]:
        """Refuse reset options that the task does not know; `more`: what else its environment takes."""
        if options is None:
            return {}
        if not isinstance(options, Mapping):
            raise TypeError(f"options must be a mapping, got {options!r}")
        known_keys("reset option", options, ("state", *self.options, *more))
        return options


STATE_RANGES = {
    "longitudinal_position": (-1e5, 1e5),
    "lateral_position": (-1e3, 1e3),
    "heading": (-3.15, 3.15),
    "lateral_velocity": (-100.0, 100.0),
    "yaw_rate": (-10.0, 10.0),
}


def checked_state(
    given: object,
    front_limit: float,
    rear_limit: float,
    label: str = "options['state']",
    own: tuple[str, ...] = (),
) -> dict[str, float]:
    """Values of all settable state names, 0 where not given; ValueError or TypeError if one is bad.

    Settable are the fields of CarState and the two last commands; steer angles lie within the actuators' limits. What
    the model has of its `own`, all of them angles, is among the values only where given.
    """
    ranges = {
        **STATE_RANGES,
        "front_steer": (-front_limit, front_limit),
        "rear_steer": (-rear_limit, rear_limit),
        "front_steer_command": (-front_limit, front_limit),
        "rear_steer_command": (-rear_limit, rear_limit),
    }
    if not isinstance(given, Mapping):
        raise TypeError(f"{label} must be a mapping of state names to numbers, got {given!r}")
    values = dict.fromkeys(ranges, 0.0)
    ranges |= dict.fromkeys(own, (-math.pi / 2, math.pi / 2))
    known_keys("state name", given, ranges)
    for name, value in given.items():
        values[name] = number(f"{label}[{name!r}]", value, *ranges[name])
    return values


def fixed_entries(speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
    """The entries that every task's observation starts with, in the order of :func:`observed_car`."""
    return (
        Entry("lateral_position", "m", 1.0, 10.0, "to the left of the middle of the starting lane"),
        Entry("heading", "rad", 0.2, 10.0, "of the body against the road"),
        Entry("lateral_velocity", "m/s", 0.2 * speed, 10.0, "of the centre of mass, body frame; scale 0.2 x speed"),
        Entry("yaw_rate", "rad/s", 0.5, 10.0, ""),
        Entry("front_steer", "rad", front_limit, 1.0, "road-wheel angle; scale: the actuator's angle limit"),
        Entry("rear_steer", "rad", rear_limit, 1.0, "road-wheel angle; scale: the actuator's angle limit"),
        Entry("front_steer_command", "rad", front_limit, 1.0, "last command; scale: the actuator's angle limit"),
        Entry("rear_steer_command", "rad", rear_limit, 1.0, "last command; scale: the actuator's angle limit"),
    )


def observed_car(xp: Any) -> Law:
    """``observed_car(state, episode)``: the values of :func:`fixed_entries`."""

    def observed_car(state: CarState, episode: EpisodeState) -> tuple[Any, ...]:
        return (
            state.lateral_position,
            state.heading,
            state.lateral_velocity,
            state.yaw_rate,
            state.front_steer,
            state.rear_steer,
            episode.front_steer_command,
            episode.rear_steer_command,
        )

    return observed_car
