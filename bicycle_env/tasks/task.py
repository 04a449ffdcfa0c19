"""What a task is: a few pure functions of state, memory and world, written in a namespace ``xp`` like the physics.

The environments do not know which task they run. A task says how an episode starts, which reference the car should
follow and how long the corridor is in which it must stay; the laws that all tasks share (observation, reward, end of
an episode) are in the modules beside this one and are written against that reference.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

from bicycle_env.physics.single_track import Car, CarState
from bicycle_env.physics.validation import choice, known_keys, number


class Memory(NamedTuple):
    """What an episode remembers beside the car's state."""

    front_steer_command: Any
    """Last command to the front actuator, rad."""
    rear_steer_command: Any
    """Last command to the rear actuator, rad."""
    steps: Any
    """Control steps since the start."""
    settled_steps: Any
    """Consecutive control steps, up to now, in which the car was within all tolerances."""
    route: Any
    """The task's own named tuple, fixed during an episode."""


class Reference(NamedTuple):
    """Where the car should be at its present place on the road."""

    lateral_position: Any
    """m."""
    heading: Any
    """rad."""
    goal: Any
    """Lateral position at which the task is done, m."""
    road_centre: Any
    """Middle of the corridor that must not be left, m."""


class Rules(NamedTuple):
    """Numbers that every task has."""

    control_timestep: Any
    substeps: Any
    horizon: Any
    """Control steps that a failure of the quadratic reward pays for."""
    steers_front: Any
    """1 where the action steers the front axle, else 0."""
    steers_rear: Any
    road_half_width: Any
    """From the middle of the corridor to its edge, m."""
    sideslip_limit: Any
    yaw_rate_limit: Any
    heading_limit: Any
    lateral_tolerance: Any
    heading_tolerance: Any
    sideslip_tolerance: Any
    yaw_rate_tolerance: Any
    lateral_weight: Any
    heading_weight: Any
    sideslip_weight: Any
    yaw_rate_weight: Any
    effort_weight: Any
    smoothness_weight: Any
    lateral_cost: Any
    heading_cost: Any
    lateral_velocity_cost: Any
    yaw_rate_cost: Any
    front_steer_cost: Any
    rear_steer_cost: Any
    front_command_cost: Any
    rear_command_cost: Any


class World(NamedTuple):
    """All that stays the same during an episode."""

    car: Car
    rules: Rules
    settings: Any
    """The task's own numbers, a named tuple."""


class Entry(NamedTuple):
    """One entry of the observation: value / scale, clipped to [-bound, bound]."""

    name: str
    unit: str
    scale: float
    bound: float
    meaning: str


Law = Callable[..., Any]
Allowed = Mapping[str, float] | tuple[float, float]
"""What an option may be: one of some words, each of which stands for a number; or a number in a range."""

SPUN = {"sideslip_limit": 0.8, "yaw_rate_limit": 2.0, "heading_limit": 1.2}
"""Limits of every task, rad and rad/s: beyond them nobody drives on."""
STRAIGHT = {"heading_tolerance": 0.02, "sideslip_tolerance": 0.02, "yaw_rate_tolerance": 0.05}
"""Tolerances of every task, rad and rad/s: within them the car runs straight."""
SETTLED_SECONDS = 1.0
"""How long the car must have been settled when the time is over, for a success."""


def allowed_number(name: str, value: Any, allowed: Allowed) -> float:
    """The number that a word stands for, or a number in a range; ValueError or TypeError otherwise."""
    return allowed[choice(name, value, allowed)] if isinstance(allowed, Mapping) else number(name, value, *allowed)


class Task(abc.ABC):
    """Base of the tasks. Constructors take the task's own keywords and validate them."""

    name: ClassVar[str]
    episode_steps: ClassVar[int]
    Route: ClassVar[Any]
    """Named-tuple class of what is drawn at the start of an episode and then stays."""
    Settings: ClassVar[Any]
    """Named-tuple class of the task's numbers."""
    State: ClassVar[Any]
    """Named-tuple class of ``env.unwrapped.state``: CarState, both commands, time, then the route."""
    uniforms: ClassVar[int]
    """How many uniform numbers in [0, 1) a start takes."""
    left_name: ClassVar[str]
    """The word in ``info["end"]`` for leaving the corridor."""
    options: ClassVar[Mapping[str, Allowed]] = {}
    """Reset options of the task beside ``state``."""

    preview_times: tuple[float, ...] = ()
    """Look-ahead times of the preview in the observation, s."""

    @abc.abstractmethod
    def settings(self, speed: float) -> Any:
        """The task's numbers at a speed, as ``Settings``."""

    @abc.abstractmethod
    def rules(self, **shared: float) -> Rules:
        """The shared rules with this task's numbers; `shared` are the fields that the environment decides."""

    @abc.abstractmethod
    def start(self, xp: Any) -> Law:
        """``start(uniforms, world) -> (CarState, route)``, a pure function of the uniforms."""

    @abc.abstractmethod
    def reference(self, xp: Any) -> Law:
        """``reference(state, route, world) -> Reference``."""

    @abc.abstractmethod
    def observe(self, xp: Any) -> Law:
        """``observe(state, memory, world) -> tuple``, SI values of ``entries`` without the preview."""

    def preview(self, xp: Any) -> Law:
        """``preview(state, route, world, time) -> m``: lateral distance to the reference `time` seconds ahead."""

        def preview(state: CarState, route: Any, world: World, time: Any) -> Any:
            return 0.0 * state.lateral_position

        return preview

    @abc.abstractmethod
    def entries(self, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
        """The observation, entry by entry."""

    def route_with(self, route: Any, numbers: Mapping[str, Any], speed: Any) -> Any:
        """The route changed by what :meth:`option_numbers` gives."""
        return route

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
    given: object, front_limit: float, rear_limit: float, label: str = "options['state']"
) -> dict[str, float]:
    """Values of all settable state names, 0 where not given; ValueError or TypeError if one is bad.

    Settable are the fields of CarState and the two last commands; steer angles lie within the actuators' limits.
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
    known_keys("state name", given, ranges)
    values = dict.fromkeys(ranges, 0.0)
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
    """``observed_car(state, memory)``: the values of :func:`fixed_entries`."""

    def observed_car(state: CarState, memory: Memory) -> tuple[Any, ...]:
        return (
            state.lateral_position,
            state.heading,
            state.lateral_velocity,
            state.yaw_rate,
            state.front_steer,
            state.rear_steer,
            memory.front_steer_command,
            memory.rear_steer_command,
        )

    return observed_car
