"""What is measured is not what is: noise and resolution of the observation's entries."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from bicycle_env.physics.car import CarState
from bicycle_env.physics.random_bits import COLUMN, KEY_COLUMNS, normal
from bicycle_env.physics.records import sequence
from bicycle_env.physics.validation import choice, explain_keywords, from_fields, number
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.task import Law

Numbers = Mapping[str, float] | tuple[tuple[str, float], ...]
KEY = tuple(f"noise_key_{k}" for k in range(KEY_COLUMNS))


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Sensors:
    """Noise and resolution of what is observed, by the names of the observation's entries, in their SI units.

    The noise is normal, new in every control step, and a pure function of the episode's key and the step: an episode
    that is restored has the same again. The preview of the road ahead is exact.
    """

    name: str = dataclasses.field(default="sensors", init=False, repr=False, compare=False)
    noise: Numbers = ()
    """Standard deviations: ``{"yaw_rate": 0.01, "lateral_position": 0.05}``."""
    resolution: Numbers = ()
    """Steps in which a value is told, after the noise: ``{"front_steer": 0.002}``."""

    def __post_init__(self) -> None:
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
        known = [entry.name for entry in self._entries]
        for field in ("noise", "resolution"):
            for name, _ in self._pairs(field):
                choice(f"sensors: {field}: entry", name, known)

    @property
    def _entries(self) -> tuple[Any, ...]:
        entries = self.task.entries(30.0, 0.1, 0.1)  # names and mirror images do not depend on these
        return entries[: len(entries) - len(self.task.preview_times)]

    def _pairs(self, field: str) -> tuple[tuple[str, float], ...]:
        pairs: tuple[tuple[str, float], ...] = getattr(self.sensors, field)
        return pairs

    @property
    def kept(self) -> tuple[str, ...]:
        return (*KEY, "noise_side")

    @property
    def kept_flipped(self) -> tuple[str, ...]:
        return ("noise_side",)

    @property
    def numbers(self) -> Mapping[str, float]:
        fields = ("noise", "resolution")
        return {f"{name}_{field}": value for field in fields for name, value in self._pairs(field)}

    @property
    def draws(self) -> int:
        return KEY_COLUMNS

    def draw(self, xp: Any) -> Law:
        first, Kept = self.task.uniforms, self.Kept

        def draw(uniforms: Any, state: CarState, own: Any, world: World) -> Any:
            return Kept(
                xp.floor(COLUMN * uniforms[first]),
                xp.floor(COLUMN * uniforms[first + 1]),
                xp.floor(COLUMN * uniforms[first + 2]),
                xp.floor(COLUMN * uniforms[first + 3]),
                0.0 * uniforms[first] + 1.0,  # -1 in the mirror image
            )

        return draw

    def observe(self, xp: Any) -> Law:
        inner = xp.function(self.task.observe(xp))
        noise = xp.function(_noise(xp))
        rounded = xp.function(_rounded(xp))
        noisy, coarse = dict(self._pairs("noise")), dict(self._pairs("resolution"))
        values = []
        for j, entry in enumerate(self._entries):
            value = f"values[{j}]"
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
        raise TypeError(f"sensors must be None, Sensors(noise=, resolution=) or a dict of these, got {sensors!r}")
    return from_fields("sensors", Sensors, {key: value for key, value in sensors.items() if key != "name"})
