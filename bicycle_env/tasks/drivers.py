"""Drivers at the front wheels: scripted manoeuvres, and one who looks ahead. Frozen objects, like tires.

With a driver the action is the rear axle's, or, where both axles are steered, at the front a correction that is added
to what the driver does.
"""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from bicycle_env.physics.car import CarState
from bicycle_env.physics.records import composed, record_of, replaced
from bicycle_env.physics.validation import check_fields, check_frozen, choice, explain_keywords, from_fields, number
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.control_step import command_of
from bicycle_env.tasks.disturbances import SIDES
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.task import Law

MOST_ANGLE = 1.57  # rad
MOST_SAMPLES = 100_000


class Driver(abc.ABC):
    """Base of the drivers."""

    name: str
    side: str = "left"
    """To which side a manoeuvre goes first: "left", "right" or "random"."""
    sided: ClassVar[bool] = True
    """Whether the angle is that of a manoeuvre to the left, turned to the side; False for one who looks where to go."""

    def numbers(self) -> dict[str, float]:
        """Its numbers, by the names of its fields."""
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return {field.name: getattr(self, field.name) for field in fields if field.name not in ("name", "side")}

    @abc.abstractmethod
    def law(self, xp: Any, reference: Law) -> Law:
        """``law(state, task_state, time, own, world) -> rad``: the road-wheel angle that is wanted, first to the left.

        ``own``: its numbers, by name; ``reference``: the law of the task.
        """


def _check(driver: Driver, **ranges: tuple[float, float]) -> None:
    check_fields(driver, **ranges)
    choice("side", driver.side, SIDES)


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Step(Driver):
    """The wheels are turned at once, and held: ISO 7401's step input."""

    name: str = dataclasses.field(default="step", init=False, repr=False, compare=False)
    angle: float = 0.02
    """rad, of the road wheels."""
    start: float = 0.5
    """s after the start of the episode."""
    side: str = "random"

    def __post_init__(self) -> None:
        _check(self, angle=(0.0, MOST_ANGLE), start=(0.0, 1e6))

    def law(self, xp: Any, reference: Law) -> Law:
        def step(state: CarState, task_state: Any, time: Any, own: Any, world: World) -> Any:
            return xp.where(time >= own.start, own.angle + 0.0 * time, 0.0)

        return step


@explain_keywords
@dataclasses.dataclass(frozen=True)
class SineSweep(Driver):
    """A sine whose frequency rises linearly from `first` to `last` Hz, then straight wheels."""

    name: str = dataclasses.field(default="sine_sweep", init=False, repr=False, compare=False)
    amplitude: float = 0.01
    """rad."""
    first: float = 0.2
    """Hz."""
    last: float = 3.0
    duration: float = 5.0
    """s."""
    start: float = 0.5
    """s after the start of the episode."""
    side: str = "random"

    def __post_init__(self) -> None:
        ranges = {"amplitude": (0.0, MOST_ANGLE), "first": (0.0, 100.0), "last": (0.0, 100.0)}
        _check(self, **ranges, duration=(0.01, 1e6), start=(0.0, 1e6))

    def law(self, xp: Any, reference: Law) -> Law:
        half_turn = math.pi

        def sine_sweep(state: CarState, task_state: Any, time: Any, own: Any, world: World) -> Any:
            since = xp.minimum(xp.maximum(time - own.start, 0.0), own.duration)
            rise = (own.last - own.first) / own.duration
            half_turns = since * xp.multiply_add(rise, since, 2.0 * own.first)
            return xp.where(time - own.start < own.duration, own.amplitude * xp.sin(half_turn * half_turns), 0.0)

        return sine_sweep


@explain_keywords
@dataclasses.dataclass(frozen=True)
class SineWithDwell(Driver):
    """One period of a sine, held for a while at its second peak: FMVSS 126, S7.9.

    The road-wheel angle, as if the steering were stiff; the standard's amplitude is the steering wheel's.
    """

    name: str = dataclasses.field(default="sine_with_dwell", init=False, repr=False, compare=False)
    amplitude: float = 0.03
    """rad."""
    frequency: float = 0.7
    """Hz."""
    dwell: float = 0.5
    """s at the second peak."""
    start: float = 0.5
    """s after the start of the episode."""
    side: str = "random"

    def __post_init__(self) -> None:
        _check(self, amplitude=(0.0, MOST_ANGLE), frequency=(0.01, 100.0), dwell=(0.0, 1e6), start=(0.0, 1e6))

    def law(self, xp: Any, reference: Law) -> Law:
        turn = 2.0 * math.pi

        def sine_with_dwell(state: CarState, task_state: Any, time: Any, own: Any, world: World) -> Any:
            since = xp.maximum(time - own.start, 0.0)
            period = 1.0 / own.frequency
            peak = 0.75 * period
            phase = xp.where(since < peak, since, xp.maximum(since - own.dwell, peak))
            return xp.where(phase < period, own.amplitude * xp.sin(turn * own.frequency * phase), 0.0)

        return sine_with_dwell


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Preview(Driver):
    """Aims at the task's path some time ahead: the arc that leads there, and more by the car's understeer.

    The arc is that of pure pursuit, curvature 2 e / d^2 for a lateral distance e at d ahead (R. C. Coulter, CMU-RI-TR-
    92-01, 1992); the wheels are turned by (wheelbase + K U^2) times it, K from the nominal car (Karnopp 6.31).
    """

    sided = False

    name: str = dataclasses.field(default="preview", init=False, repr=False, compare=False)
    preview_time: float = 0.8
    """s."""
    gain: float = 1.0

    def __post_init__(self) -> None:
        _check(self, preview_time=(0.05, 100.0), gain=(0.0, 100.0))

    def law(self, xp: Any, reference: Law) -> Law:
        path = xp.function(reference)
        moved = replaced(xp, CarState, ("longitudinal_position",))

        def preview(state: CarState, task_state: Any, time: Any, own: Any, world: World) -> Any:
            car, ahead = world.car, own.preview_time
            distance = car.speed * ahead
            aim = path(moved(state, state.longitudinal_position + distance), task_state, world).lateral_position
            error = (
                aim - state.lateral_position - xp.multiply_add(distance, state.heading, ahead * state.lateral_velocity)
            )
            length = car.cg_to_front + car.cg_to_rear
            understeer = (car.mass / length) * (
                car.cg_to_rear / car.front_cornering_stiffness - car.cg_to_front / car.rear_cornering_stiffness
            )
            per_curvature = xp.multiply_add(understeer, car.speed * car.speed, length)
            return own.gain * per_curvature * (2.0 * error / (distance * distance))

        return preview


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Recorded(Driver):
    """What someone did: road-wheel angles at equal times, straight lines between them, the last one held.

    The angles are constants of the compiled code: another recording compiles anew.
    """

    name: str = dataclasses.field(default="recorded", init=False, repr=False, compare=False)
    angles: tuple[float, ...] = (0.0,)
    """rad, at the times 0, timestep, 2 timestep, ...: any sequence of at most 100,000 numbers."""
    timestep: float = 0.02
    """s."""
    start: float = 0.0
    """s after the start of the episode: the time of the first angle; before it the wheels are straight."""
    side: str = "left"

    def __post_init__(self) -> None:
        given = np.array(self.angles, dtype=object).reshape(-1)
        if not 1 <= len(given) <= MOST_SAMPLES:
            raise ValueError(f"angles must be 1 to {MOST_SAMPLES} numbers, got {len(given)}")
        angles = tuple(number(f"angles[{k}]", value, -MOST_ANGLE, MOST_ANGLE) for k, value in enumerate(given))
        object.__setattr__(self, "angles", angles)
        _check(self, timestep=(1e-6, 1e6), start=(0.0, 1e6))

    def numbers(self) -> dict[str, float]:
        return {"timestep": self.timestep, "start": self.start}

    def law(self, xp: Any, reference: Law) -> Law:
        last = float(len(self.angles) - 1)
        lookup = xp.table((*self.angles, self.angles[-1]))
        integer = xp.integer

        def recorded(state: CarState, task_state: Any, time: Any, own: Any, world: World) -> Any:
            since = (time - own.start) / own.timestep
            place = xp.minimum(xp.maximum(since, 0.0), last)
            whole = xp.floor(place)
            here, next_one = lookup(integer(whole)), lookup(integer(whole) + 1)
            return xp.where(since >= 0.0, xp.multiply_add(place - whole, next_one - here, here), 0.0)

        return recorded


LAWS: dict[str, Any] = {
    "step": Step,
    "sine_sweep": SineSweep,
    "sine_with_dwell": SineWithDwell,
    "recorded": Recorded,
    "preview": Preview,
}


@dataclasses.dataclass(frozen=True)
class DrivenTask(AlteredTask):
    """Someone else at the front wheels: what the task's own command sends there is added to what the driver does."""

    driver: Driver

    @property
    def kept(self) -> tuple[str, ...]:
        return ("driver_side",)

    @property
    def kept_hidden(self) -> tuple[str, ...]:
        return self.kept

    @property
    def kept_flipped(self) -> tuple[str, ...]:
        return self.kept

    @property
    def numbers(self) -> Mapping[str, float]:
        least, greatest = SIDES[self.driver.side]
        own = {f"driver_{name}": value for name, value in self.driver.numbers().items()}
        return {"driver_least_sign": least, "driver_greatest_sign": greatest, **own}

    @property
    def draws(self) -> int:
        return 1

    def draw(self, xp: Any) -> Law:
        Kept, place = self.Kept, self.task.uniforms

        def draw(uniforms: Any, state: CarState, own: Any, world: World) -> Any:
            zero, settings = 0.0 * uniforms[place], world.settings
            sides = (settings.driver_least_sign + zero, settings.driver_greatest_sign + zero)
            return Kept(xp.where(uniforms[place] < 0.5, sides[0], sides[1]))

        return draw

    def command(self, xp: Any) -> Law:
        inner = xp.function(command_of(xp, self.task))
        driver = xp.function(self.driver.law(xp, self.task.reference(xp)))
        names = tuple(self.driver.numbers())
        own_numbers = composed(xp, record_of("Numbers", names), [f"a.driver_{name}" for name in names], "a")

        def side_of(task_state: Any) -> Any:
            return task_state.driver_side

        def none(task_state: Any) -> Any:
            return 1.0

        side = xp.function(side_of if self.driver.sided else none)

        def command(state: CarState, episode: EpisodeState, action: Any, world: World) -> tuple[Any, Any]:
            front, rear = inner(state, episode, action, world)
            time = episode.steps * world.rules.control_timestep
            own = own_numbers(world.settings)
            wanted = driver(state, episode.task_state, time, own, world)
            return xp.multiply_add(side(episode.task_state), wanted, front), rear

        return command


def resolve(driver: Any) -> Driver | None:
    """What ``driver=`` takes: None, a name, a driver or its plain form, a dict with a "name".

    Raises:
        ValueError, TypeError: an unknown name or field, with the nearest known one; a bad value.
    """
    if isinstance(driver, Driver):
        check_frozen("driver", driver)
    if driver is None or isinstance(driver, Driver):
        return driver
    if isinstance(driver, str):
        return LAWS[choice("driver", driver, LAWS)]()  # type: ignore[no-any-return]
    if not isinstance(driver, Mapping):
        raise TypeError(f"driver must be None, one of {', '.join(map(repr, LAWS))}, a Driver or a dict, got {driver!r}")
    law = LAWS[choice("driver: name", driver.get("name"), LAWS)]
    made: Driver = from_fields("driver", law, {key: value for key, value in driver.items() if key != "name"})
    return made
