"""Parameters of the car that are drawn anew for every episode: domain randomisation."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any

from bicycle_env.physics.actuators import Actuator
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.records import composed, field, merged, record_of, replaced
from bicycle_env.physics.validation import choice
from bicycle_env.physics.vehicle import GRAVITY, Vehicle
from bicycle_env.tasks import distributions
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.distributions import LEAST, MOST, Distribution
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.task import Allowed, Law

OWN = (
    "mass",
    "yaw_inertia",
    "front_cornering_stiffness",
    "rear_cornering_stiffness",
    "front_time_constant",
    "rear_time_constant",
)
"""Parameters of the equations that may be drawn; ``friction`` beside them, which scales both peak forces."""
VEHICLES = OWN[:4]
"""Those of the vehicle; the others are the actuators'."""
PARAMETERS = ("friction", *OWN)
Drawn = tuple[tuple[str, Distribution], ...]
"""Parameters, and what each is drawn from."""


@dataclasses.dataclass(frozen=True)
class RandomisedTask(AlteredTask):
    """Numbers of the car are drawn at the start, in the order of `drawn`, after the task's own.

    They act in the equations of motion and stand in the state; observations, rewards, limits and controllers go on with
    the nominal car. With the mass the axle loads change, and so the peak forces.
    """

    drawn: Drawn

    @property
    def kept(self) -> tuple[str, ...]:
        return tuple(name for name, _ in self.drawn)

    @property
    def kept_hidden(self) -> tuple[str, ...]:
        return self.kept

    @property
    def numbers(self) -> Mapping[str, float]:
        return {f"{name}_{what}": value for name, chosen in self.drawn for what, value in chosen.numbers().items()}

    @property
    def draws(self) -> int:
        return len(self.drawn)

    @property
    def told(self) -> tuple[str, ...]:
        return (*self.task.told, *self.kept)

    @property
    def options(self) -> Mapping[str, Allowed]:  # type: ignore[override]
        return {**self.task.options, **dict.fromkeys(self.kept, (LEAST, MOST))}

    def task_state_with(self, task_state: Any, numbers: Mapping[str, Any], speed: Any) -> Any:
        own = {name: value for name, value in numbers.items() if name in self.kept}
        return self.task.task_state_with(task_state, numbers, speed)._replace(**own)

    def draw(self, xp: Any) -> Law:
        first = self.task.uniforms
        laws = {f"draw{k}": _drawn(xp, name, chosen, first + k) for k, (name, chosen) in enumerate(self.drawn)}
        draws = composed(xp, self.Kept, [f"{law}(uniforms, world)" for law in laws], "uniforms, world", **laws)

        def draw(uniforms: Any, state: CarState, own: Any, world: World) -> Any:
            return draws(uniforms, world)

        return draw

    def conditions(self, xp: Any) -> Law:
        before = xp.function(self.task.conditions(xp) or nominal)
        drawn = merged(xp, CarParameters, tuple(name for name in self.kept if name in OWN))
        peaks = xp.function(_peaks(xp, self.kept))
        loaded = replaced(xp, CarParameters, ("front_peak_force", "rear_peak_force"))

        def conditions(state: CarState, episode: EpisodeState, time: Any, world: World) -> CarParameters:
            own, car = episode.task_state, before(state, episode, time, world)
            grip = peaks(own, world.car)
            changed: CarParameters = loaded(drawn(car, own), grip * car.front_peak_force, grip * car.rear_peak_force)
            return changed

        return conditions


def nominal(state: CarState, episode: EpisodeState, time: Any, world: World) -> CarParameters:
    """The conditions of a task that has none."""
    return world.car


def nominal_friction(car: CarParameters) -> Any:
    """Peak force of the front axle per its static load, m g b / (a + b)."""
    load = car.mass * GRAVITY * car.cg_to_rear / (car.cg_to_front + car.cg_to_rear)
    return car.front_peak_force / load


def _drawn(xp: Any, name: str, chosen: Distribution, place: int) -> Law:
    """``drawn(uniforms, world)`` of the uniform number at a place."""
    whats = tuple(chosen.numbers())
    own_of = composed(xp, record_of("Numbers", whats), [f"settings.{name}_{what}" for what in whats], "settings")
    law = xp.function(chosen.law(xp))
    of = xp.function(nominal_friction) if name == "friction" else field(xp, name)
    value_of = of if chosen.relative else xp.function(_unit)

    def drawn(uniforms: Any, world: World) -> Any:
        return value_of(world.car) * law(uniforms[place], own_of(world.settings))

    return drawn


def _unit(_car: CarParameters) -> Any:
    return 1.0


def _peaks(xp: Any, kept: tuple[str, ...]) -> Law:
    """``peaks(own, car)``: how much larger the axles' peak forces are than the nominal car's."""
    friction = xp.function(nominal_friction)
    mass_of = field(xp, "mass")

    def by_friction(own: Any, car: CarParameters) -> Any:
        return own.friction / friction(car)

    def by_mass(own: Any, car: CarParameters) -> Any:
        return own.mass / mass_of(car)

    def one(own: Any, car: CarParameters) -> Any:
        return 1.0

    first = xp.function(by_friction if "friction" in kept else one)
    second = xp.function(by_mass if "mass" in kept else one)

    def peaks(own: Any, car: CarParameters) -> Any:
        return first(own, car) * second(own, car)

    return peaks


def resolve(randomise: Mapping[str, Any] | None) -> Drawn:
    """What ``randomise=`` takes, a mapping of parameters to what ``distributions.resolve`` takes, as sorted pairs.

    Raises:
        ValueError, TypeError: an unknown parameter, with the nearest known one; a distribution that is none.
    """
    if randomise is None:
        return ()
    if not isinstance(randomise, Mapping):
        raise TypeError(f"randomise must be a mapping of parameters to distributions, got {randomise!r}")
    for name in randomise:
        choice("randomise: parameter", name, PARAMETERS)
    return tuple(
        (name, distributions.resolve(f"randomise[{name!r}]", randomise[name]))
        for name in PARAMETERS
        if name in randomise
    )


def extremes(drawn: Drawn, vehicle: Vehicle) -> list[Vehicle]:
    """The vehicles at the corners of the drawn parameters; ValueError for one that cannot be."""
    own = [(name, chosen) for name, chosen in drawn if name in VEHICLES]
    corners = itertools.product(*(chosen.bounds for _, chosen in own))
    found = []
    for corner in corners:
        changes: dict[str, Any] = {
            name: value * (getattr(vehicle, name) if chosen.relative else 1.0)
            for (name, chosen), value in zip(own, corner, strict=True)
        }
        try:
            found.append(dataclasses.replace(vehicle, **changes))
        except ValueError as error:
            raise ValueError(f"randomise: {error}") from None
    return found


def least_time_constants(drawn: Drawn, front: Actuator, rear: Actuator) -> tuple[float, float]:
    """Of the two actuators, s."""
    chosen_of, found = dict(drawn), []
    for axle, actuator in (("front", front), ("rear", rear)):
        chosen, own = chosen_of.get(f"{axle}_time_constant"), actuator.time_constant
        found.append(own if chosen is None else chosen.bounds[0] * (own if chosen.relative else 1.0))
    return found[0], found[1]
