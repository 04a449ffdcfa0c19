"""What is measured is not what is: which signals are observed, with what noise and resolution."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from bicycle_env.physics.car import CarState
from bicycle_env.physics.random_bits import COLUMN, KEY_COLUMNS, normal
from bicycle_env.physics.records import composed, sequence
from bicycle_env.physics.validation import choice, explain_keywords, from_fields, number
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.task import Entry, Law

Numbers = Mapping[str, float] | tuple[tuple[str, float], ...]
KEY = tuple(f"noise_key_{k}" for k in range(KEY_COLUMNS))
ACCELEROMETER = ("lateral_acceleration_measured", "lateral_velocity_before", "heading_before")
ACCELERATION = Entry("lateral_acceleration", "m/s^2", 10.0, 10.0, "V' + U r, the mean over the last control step")
PREVIEW = "preview"
CAR = (
    *("yaw_rate", "lateral_acceleration", "front_steer", "rear_steer", "front_steer_command", "rear_steer_command"),
    *("lateral_position", PREVIEW),
)
"""What a car's own sensors and a lane camera tell: no sideslip, no heading."""


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Sensors:
    """Which signals are observed, and their noise and resolution by name, in SI units.

    The noise is normal, new in every control step, and a pure function of the episode's key and the step: an episode
    that is restored has the same again. The preview of the road ahead is exact.
    """

    name: str = dataclasses.field(default="sensors", init=False, repr=False, compare=False)
    signals: str | tuple[str, ...] | None = None
    """None: the whole observation of the task. "car": what a car measures, ``CAR``. Or names of the observation's
    entries, in the order wanted, "lateral_acceleration" and "preview" among them."""
    noise: Numbers = ()
    """Standard deviations: ``{"yaw_rate": 0.01, "lateral_position": 0.05}``."""
    resolution: Numbers = ()
    """Steps in which a value is told, after the noise: ``{"front_steer": 0.002}``."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "signals", _signals(self.signals))
        for field in ("noise", "resolution"):
            given = getattr(self, field)
            try:
                pairs = dict(given.items() if isinstance(given, Mapping) else given)
            except (TypeError, ValueError):
                words = 'a mapping of the observation\'s entries to numbers, for example {"yaw_rate": 0.01}'
                raise TypeError(f"{field} must be {words}, got {given!r}") from None
            checked = ((name, number(f"{field}[{name!r}]", pairs[name], 0.0, 1e6)) for name in sorted(pairs))
            object.__setattr__(self, field, tuple(checked))


@dataclasses.dataclass(frozen=True)
class SensedTask(AlteredTask):
    """The observation as sensors tell it; rewards, ends and telemetry know the truth."""

    sensors: Sensors

    def __post_init__(self) -> None:
        super().__post_init__()
        offered = [entry.name for entry in (ACCELERATION, *self._split(self._any)[0])]
        if not isinstance(self.sensors.signals, str):
            for name in self.sensors.signals or ():
                choice("sensors: signals: name", name, (*offered, PREVIEW))
        known = [entry.name for entry in self._seen]
        for field in ("noise", "resolution"):
            for name, _ in self._pairs(field):
                choice(f"sensors: {field}: entry", name, known)

    @property
    def _any(self) -> tuple[Entry, ...]:
        return self.task.entries(30.0, 0.1, 0.1)  # names and mirror images do not depend on these

    def _split(self, entries: tuple[Entry, ...]) -> tuple[tuple[Entry, ...], tuple[Entry, ...]]:
        """Those of the car, and those of the preview."""
        seen = len(entries) - len(self.task.preview_times)
        return entries[:seen], entries[seen:]

    def _chosen(self, entries: tuple[Entry, ...]) -> tuple[Entry, ...]:
        """Those of the signals, in their order, without the preview."""
        signals, mine = self.sensors.signals, self._split(entries)[0]
        if signals is None:
            return mine
        offered = {entry.name: entry for entry in (ACCELERATION, *mine)}
        if signals == "car":
            return tuple(offered[name] for name in CAR if name in offered)
        return tuple(offered[name] for name in signals if name != PREVIEW)

    @property
    def _seen(self) -> tuple[Entry, ...]:
        return self._chosen(self._any)

    @property
    def _accelerometer(self) -> bool:
        return ACCELERATION in self._seen and ACCELERATION.name not in {entry.name for entry in self._any}

    @property
    def preview_times(self) -> tuple[float, ...]:
        signals = self.sensors.signals
        return self.task.preview_times if signals in (None, "car") or PREVIEW in (signals or ()) else ()

    def entries(self, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
        entries = self.task.entries(speed, front_limit, rear_limit)
        return (*self._chosen(entries), *(self._split(entries)[1] if self.preview_times else ()))

    def _pairs(self, field: str) -> tuple[tuple[str, float], ...]:
        pairs: tuple[tuple[str, float], ...] = getattr(self.sensors, field)
        return pairs

    @property
    def kept(self) -> tuple[str, ...]:
        return (*KEY, "noise_side", *(ACCELEROMETER if self._accelerometer else ()))

    @property
    def kept_hidden(self) -> tuple[str, ...]:
        return KEY

    @property
    def kept_flipped(self) -> tuple[str, ...]:
        return self.kept[len(KEY) :]

    @property
    def numbers(self) -> Mapping[str, float]:
        fields = ("noise", "resolution")
        return {f"{name}_{field}": value for field in fields for name, value in self._pairs(field)}

    @property
    def draws(self) -> int:
        return KEY_COLUMNS

    def draw(self, xp: Any) -> Law:
        def column(uniform: Any) -> Any:
            return xp.floor(COLUMN * uniform)

        first = self.task.uniforms
        key = [f"column(uniforms[{first + k}])" for k in range(KEY_COLUMNS)]
        side = f"0.0 * uniforms[{first}] + 1.0"  # -1 in the mirror image
        values = [*key, side, *(AT_REST if self._accelerometer else ())]
        fill = composed(xp, self.Kept, values, "uniforms, state, world", column=column)

        def draw(uniforms: Any, state: CarState, own: Any, world: World) -> Any:
            return fill(uniforms, state, world)

        return draw

    def refill(self, xp: Any) -> Law | None:
        if not self._accelerometer:
            return None
        same = [f"own.{name}" for name in self.kept[: -len(ACCELEROMETER)]]
        fill = composed(xp, self.Kept, same + AT_REST, "own, state, world")

        def refill(state: CarState, episode: EpisodeState, world: World) -> Any:
            return fill(episode.task_state, state, world)

        return refill

    def update(self, xp: Any) -> Law | None:
        if not self._accelerometer:
            return None
        same = [f"own.{name}" for name in self.kept[: -len(ACCELEROMETER)]]
        felt = xp.function(_mean_acceleration(xp))
        after = ["felt(own, state, world)", "state.lateral_velocity", "state.heading"]
        measure = composed(xp, self.Kept, same + after, "own, state, world", felt=felt)

        def update(state: CarState, episode: EpisodeState, action: Any, world: World) -> Any:
            return measure(episode.task_state, state, world)

        return update

    def observe(self, xp: Any) -> Law:
        inner = xp.function(self.task.observe(xp))
        noise = xp.function(_noise(xp))
        rounded = xp.function(_rounded(xp))
        noisy, coarse = dict(self._pairs("noise")), dict(self._pairs("resolution"))
        places = {entry.name: f"values[{j}]" for j, entry in enumerate(self._split(self._any)[0])}
        values = []
        for j, entry in enumerate(self._seen):
            value = places.get(entry.name, f"own.{ACCELEROMETER[0]}")
            if entry.name in noisy:
                side = "own.noise_side" if entry.mirror < 0.0 else "1.0"
                value = f"noise({value}, own, step, {j}, {side}, settings.{entry.name}_noise)"
            if entry.name in coarse:
                value = f"rounded({value}, settings.{entry.name}_resolution)"
            values.append(value)
        told = sequence(xp, values, "values, own, step, settings", noise=noise, rounded=rounded)

        def observe(state: CarState, episode: EpisodeState, world: World) -> tuple[Any, ...]:
            values: tuple[Any, ...] = told(
                inner(state, episode, world), episode.task_state, episode.steps, world.settings
            )
            return values

        return observe


AT_REST = ["world.car.speed * state.yaw_rate", "state.lateral_velocity", "state.heading"]
"""What the accelerometer has at a start: V' is not known."""


def _mean_acceleration(xp: Any) -> Law:
    """Over a control step, from what V and the heading were before it: gusts and other roads are in it."""

    def mean_acceleration(own: Any, state: CarState, world: World) -> Any:
        turned, faster = state.heading - own.heading_before, state.lateral_velocity - own.lateral_velocity_before
        return xp.multiply_add(world.car.speed, turned, faster) / world.rules.control_timestep

    return mean_acceleration


def _signals(signals: Any) -> Any:
    if signals is None or signals == "car":
        return signals
    if isinstance(signals, str) or not isinstance(signals, (tuple, list)):
        raise TypeError(f"signals must be None, 'car' or names of what is observed, got {signals!r}")
    names = tuple(signals)
    if not names or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise ValueError(f"signals must be names, each once, got {signals!r}")
    return names


def _noise(xp: Any) -> Law:
    number_of = xp.function(normal(xp))

    def noise(value: Any, own: Any, step: Any, channel: int, side: Any, deviation: Any) -> Any:
        key = (own.noise_key_0, own.noise_key_1, own.noise_key_2, own.noise_key_3)
        return xp.multiply_add(side * deviation, number_of(key, step, channel), value)

    return noise


def _rounded(xp: Any) -> Law:
    def rounded(value: Any, resolution: Any) -> Any:
        size = abs(value)
        steps = xp.where(resolution > 0.0, resolution * xp.floor(size / xp.maximum(resolution, 1e-12) + 0.5), size)
        return xp.where(value < 0.0, -steps, steps)

    return rounded


def resolve(sensors: Any) -> Sensors | None:
    """What ``sensors=`` takes: None, Sensors or its plain form, a dict.

    Raises:
        ValueError, TypeError: an unknown field, with the nearest known one; a bad value.
    """
    if sensors is None or isinstance(sensors, Sensors):
        return sensors
    if not isinstance(sensors, Mapping):
        raise TypeError(
            f"sensors must be None, Sensors(signals=, noise=, resolution=) or a dict of these, got {sensors!r}"
        )
    return from_fields("sensors", Sensors, {key: value for key, value in sensors.items() if key != "name"})
