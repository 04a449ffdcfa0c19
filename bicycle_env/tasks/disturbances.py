"""What happens to the car on its way: gusts, slippery road, a tire that loses stiffness. Frozen objects, like tires."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.records import composed, field, record_of, replaced
from bicycle_env.physics.validation import (
    check_fields,
    check_frozen,
    choice,
    explain_keywords,
    from_fields,
    number,
    pair,
)
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.marks import Mark
from bicycle_env.tasks.randomised import nominal
from bicycle_env.tasks.task import Law

Amount = float | tuple[float, float]
"""A number, or two between which it is drawn at the start of each episode."""
SIDES = {"left": (1.0, 1.0), "right": (-1.0, -1.0), "random": (-1.0, 1.0)}
"""The least and the greatest sign."""
AXLES = ("front", "rear", "both")
SIGHT = 100.0
"""m to the sides, as far as ice without an end is drawn."""


class Disturbance(abc.ABC):
    """Base of the disturbances: what is drawn for an episode, and how it changes the car of a moment."""

    name: str
    """A word: what it draws stands in the state as NAME_AMOUNT."""
    flips: ClassVar[tuple[str, ...]] = ()
    """Names of :meth:`amounts` that change sign in the mirror image. What lies at one side of the road has an amount
    ``{"side": 1.0}`` among them, times which its law takes what is across."""
    side: str = "left"
    """Which sign they have: "left" for +, "right" for -, "random" for one that is drawn."""

    @abc.abstractmethod
    def amounts(self) -> dict[str, Amount]:
        """What stands in the state of an episode, by name: numbers, or pairs between which they are drawn."""

    def constants(self) -> dict[str, float]:
        """Its other numbers, by name."""
        return {}

    @abc.abstractmethod
    def law(self, xp: Any) -> Law:
        """``law(car, own, fixed, time, state) -> CarParameters``: its amounts `own` and constants `fixed`, by name.

        ``time`` since the start, s; ``state`` of the car, for what lies at a place of the road.
        """

    def marks(self, own: Any, fixed: Any) -> tuple[Mark, ...]:
        """What of it is drawn on the road."""
        return ()


def _amount(name: str, amount: Any, low: float, high: float) -> Amount:
    if not isinstance(amount, (tuple, list)):
        return number(name, amount, low, high)
    if len(amount) != 2:
        raise ValueError(f"{name} must be a number or (low, high), got {amount!r}")
    return pair(name, amount, low, high)


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Gust(Disturbance):
    """A side wind: a constant force for a while, at a lever arm before the centre of mass."""

    flips = ("force",)

    name: str = dataclasses.field(default="gust", init=False, repr=False, compare=False)
    force: Amount = 1000.0
    """N, >= 0; a 20 m/s side wind on a car gives about 1000."""
    duration: float = 0.5
    """s."""
    start: Amount = 1.0
    """s after the start of the episode."""
    arm: float = 0.3
    """m before the centre of mass; in [-10, 10]."""
    side: str = "random"
    """To which side it pushes: "left", "right" or "random"."""

    def __post_init__(self) -> None:
        check_fields(self, _amount, force=(0.0, 1e6), duration=(0.0, 1e6), start=(0.0, 1e6), arm=(-10.0, 10.0))
        choice("side", self.side, SIDES)

    def amounts(self) -> dict[str, Amount]:
        return {"start": self.start, "force": self.force}

    def constants(self) -> dict[str, float]:
        return {"duration": self.duration, "arm": self.arm}

    def law(self, xp: Any) -> Law:
        pushed = replaced(xp, CarParameters, ("side_force", "yaw_moment"))

        def gust(car: CarParameters, own: Any, fixed: Any, time: Any, state: CarState) -> Any:
            blows = (time >= own.start) & (time < own.start + fixed.duration)
            force = xp.where(blows, own.force, 0.0)
            return pushed(car, car.side_force + force, xp.multiply_add(force, fixed.arm, car.yaw_moment))

        return gust


@explain_keywords
@dataclasses.dataclass(frozen=True)
class FrictionStep(Disturbance):
    """From a moment on the road is slippery: the axles' peak forces are so many times the car's."""

    name: str = dataclasses.field(default="friction_step", init=False, repr=False, compare=False)
    at: Amount = 1.0
    """s after the start of the episode."""
    front: Amount = 0.5
    """Factor of the front axle's peak force, in [0.01, 10]."""
    rear: Amount = 0.5

    def __post_init__(self) -> None:
        check_fields(self, _amount, at=(0.0, 1e6), front=(0.01, 10.0), rear=(0.01, 10.0))

    def amounts(self) -> dict[str, Amount]:
        return {"at": self.at, "front": self.front, "rear": self.rear}

    def law(self, xp: Any) -> Law:
        slippery = replaced(xp, CarParameters, ("front_peak_force", "rear_peak_force"))

        def friction_step(car: CarParameters, own: Any, fixed: Any, time: Any, state: CarState) -> Any:
            begun = time >= own.at
            front, rear = xp.where(begun, own.front, 1.0), xp.where(begun, own.rear, 1.0)
            return slippery(car, front * car.front_peak_force, rear * car.rear_peak_force)

        return friction_step


@explain_keywords
@dataclasses.dataclass(frozen=True)
class StiffnessLoss(Disturbance):
    """From a moment on an axle has less cornering stiffness, as with a tire that loses its air."""

    name: str = dataclasses.field(default="stiffness_loss", init=False, repr=False, compare=False)
    axle: str = "rear"
    """"front", "rear" or "both"."""
    at: Amount = 1.0
    """s after the start of the episode."""
    factor: Amount = 0.5
    """In [0.01, 1]."""

    def __post_init__(self) -> None:
        choice("axle", self.axle, AXLES)
        check_fields(self, _amount, at=(0.0, 1e6), factor=(0.01, 1.0))

    def amounts(self) -> dict[str, Amount]:
        return {"at": self.at, "factor": self.factor}

    def constants(self) -> dict[str, float]:
        return {"front_part": float(self.axle != "rear"), "rear_part": float(self.axle != "front")}

    def law(self, xp: Any) -> Law:
        soft = replaced(xp, CarParameters, ("front_cornering_stiffness", "rear_cornering_stiffness"))

        def stiffness_loss(car: CarParameters, own: Any, fixed: Any, time: Any, state: CarState) -> Any:
            lost = xp.where(time >= own.at, own.factor - 1.0, 0.0)
            front, rear = 1.0 + fixed.front_part * lost, 1.0 + fixed.rear_part * lost
            return soft(car, front * car.front_cornering_stiffness, rear * car.rear_cornering_stiffness)

        return stiffness_loss


@explain_keywords
@dataclasses.dataclass(frozen=True)
class IcePatch(Disturbance):
    """A slippery part of the road: an axle that stands in it has so many times its peak force."""

    flips = ("side",)

    name: str = dataclasses.field(default="ice_patch", init=False, repr=False, compare=False)
    begin: Amount = 40.0
    """m along the road."""
    length: float = 20.0
    """m."""
    factor: Amount = 0.3
    """Of the axle's peak force, in [0.01, 10]."""
    edge: float | None = 0.0
    """m from the middle of the starting lane towards the side where the ice lies, all beyond; None: on both sides."""
    side: str = "random"
    """Where it lies: "left", "right" or "random"."""

    def __post_init__(self) -> None:
        check_fields(self, _amount, begin=(0.0, 1e6), length=(0.0, 1e6), factor=(0.01, 10.0))
        if self.edge is not None:
            check_fields(self, _amount, edge=(-1e3, 1e3))
        choice("side", self.side, SIDES)

    def amounts(self) -> dict[str, Amount]:
        return {"begin": self.begin, "factor": self.factor, "side": 1.0}

    def constants(self) -> dict[str, float]:
        return {"length": self.length, "edge": -1e6 if self.edge is None else self.edge}

    def law(self, xp: Any) -> Law:
        slippery = replaced(xp, CarParameters, ("front_peak_force", "rear_peak_force"))
        part = xp.function(_part_on_ice(xp))

        def ice_patch(car: CarParameters, own: Any, fixed: Any, time: Any, state: CarState) -> Any:
            front, rear = part(own, fixed, state, car.cg_to_front), part(own, fixed, state, -car.cg_to_rear)
            return slippery(car, front * car.front_peak_force, rear * car.rear_peak_force)

        return ice_patch

    def marks(self, own: Any, fixed: Any) -> tuple[Mark, ...]:
        begin, end = own.begin, own.begin + fixed.length
        near, far = own.side * max(fixed.edge, -SIGHT), own.side * SIGHT
        return (Mark("ice", ((begin, near), (end, near), (end, far), (begin, far))),)


def _part_on_ice(xp: Any) -> Law:
    """``part(own, fixed, state, ahead)``: of the peak force, of an axle so far before the centre of mass."""

    def part(own: Any, fixed: Any, state: CarState, ahead: Any) -> Any:
        along = xp.multiply_add(ahead, xp.cos(state.heading), state.longitudinal_position)
        across = own.side * xp.multiply_add(ahead, xp.sin(state.heading), state.lateral_position)
        on = (along >= own.begin) & (along < own.begin + fixed.length) & (across >= fixed.edge)
        return xp.where(on, own.factor, 1.0 + 0.0 * along)

    return part


LAWS: dict[str, Any] = {
    "gust": Gust,
    "friction_step": FrictionStep,
    "stiffness_loss": StiffnessLoss,
    "ice_patch": IcePatch,
}
"""The disturbances that have a plain form."""


@dataclasses.dataclass(frozen=True)
class DisturbedTask(AlteredTask):
    """Disturbances act on the car, one after the other; their amounts stand in the state."""

    disturbances: tuple[Disturbance, ...]

    @property
    def _labels(self) -> tuple[str, ...]:
        """A name for each: its own, the second of a kind with a 2."""
        names = [one.name for one in self.disturbances]
        counts = [names[: k + 1].count(name) for k, name in enumerate(names)]
        return tuple(name if count == 1 else f"{name}_{count}" for name, count in zip(names, counts, strict=True))

    @property
    def _amounts(self) -> tuple[tuple[str, Amount, tuple[float, float]], ...]:
        """(name in the state, amount, the signs it may have)."""
        found = []
        for one, label in zip(self.disturbances, self._labels, strict=True):
            side = SIDES[one.side]
            for name, amount in one.amounts().items():
                found.append((f"{label}_{name}", amount, side if name in one.flips else SIDES["left"]))
        return tuple(found)

    @property
    def kept(self) -> tuple[str, ...]:
        return tuple(name for name, *_ in self._amounts)

    @property
    def kept_hidden(self) -> tuple[str, ...]:
        return self.kept

    @property
    def kept_flipped(self) -> tuple[str, ...]:
        pairs = zip(self.disturbances, self._labels, strict=True)
        return tuple(f"{label}_{name}" for one, label in pairs for name in one.flips)

    @property
    def numbers(self) -> Mapping[str, float]:
        found: dict[str, float] = {}
        for name, amount, (least, greatest) in self._amounts:
            low, high = amount if isinstance(amount, tuple) else (amount, amount)
            found |= {f"{name}_low": low, f"{name}_width": high - low}
            found |= {f"{name}_least_sign": least, f"{name}_greatest_sign": greatest}
        for one, label in zip(self.disturbances, self._labels, strict=True):
            found |= {f"{label}_{name}": value for name, value in one.constants().items()}
        return found

    @property
    def draws(self) -> int:
        return 2 * len(self._amounts)  # of each: the amount and the side, fixed or not, so that starts stay alike

    def draw(self, xp: Any) -> Law:
        first = self.task.uniforms
        laws = {f"draw{k}": _drawn(xp, name, first + 2 * k) for k, name in enumerate(self.kept)}
        draws = composed(xp, self.Kept, [f"{law}(uniforms, settings)" for law in laws], "uniforms, settings", **laws)

        def draw(uniforms: Any, state: CarState, own: Any, world: World) -> Any:
            return draws(uniforms, world.settings)

        return draw

    def conditions(self, xp: Any) -> Law:
        chain = xp.function(self.task.conditions(xp) or nominal)
        for one, label in zip(self.disturbances, self._labels, strict=True):
            own, fixed = _named(xp, label, tuple(one.amounts())), _named(xp, label, tuple(one.constants()))
            chain = xp.function(_after(chain, xp.function(one.law(xp)), own, fixed))
        return chain  # type: ignore[no-any-return]

    def marks(self, task_state: Any, world: World) -> tuple[Mark, ...]:
        found = [*self.task.marks(task_state, world)]
        for one, label in zip(self.disturbances, self._labels, strict=True):
            own, fixed = (_named(PYTHON, label, tuple(names)) for names in (one.amounts(), one.constants()))
            found += one.marks(own(task_state), fixed(world.settings))
        return tuple(found)


def _named(xp: Any, label: str, names: tuple[str, ...]) -> Any:
    """``f(record)``: the numbers of a disturbance by its own names for them."""
    return composed(xp, record_of("Numbers", names), [f"a.{label}_{name}" for name in names], "a")


def _after(before: Law, law: Law, own: Law, fixed: Law) -> Law:
    def conditions(state: CarState, episode: EpisodeState, time: Any, world: World) -> Any:
        car = before(state, episode, time, world)
        return law(car, own(episode.task_state), fixed(world.settings), time, state)

    return conditions


def _drawn(xp: Any, name: str, place: int) -> Law:
    """``drawn(uniforms, settings)`` of two uniform numbers: the amount, then its side."""
    low, width = field(xp, f"{name}_low"), field(xp, f"{name}_width")
    least, greatest = field(xp, f"{name}_least_sign"), field(xp, f"{name}_greatest_sign")

    def drawn(uniforms: Any, settings: Any) -> Any:
        size = xp.multiply_add(width(settings), uniforms[place], low(settings))
        return xp.where(uniforms[place + 1] < 0.5, least(settings) * size, greatest(settings) * size)

    return drawn


def resolve(disturbances: Any) -> tuple[Disturbance, ...]:
    """What ``disturbances=`` takes: an iterable of disturbances or of their plain forms.

    Raises:
        ValueError, TypeError: an unknown name or field, with the nearest known one; a bad value.
    """
    if disturbances is None:
        return ()
    if isinstance(disturbances, (str, Mapping, Disturbance)) or not isinstance(disturbances, Iterable):
        raise TypeError(f"disturbances must be a tuple of disturbances, for example (Gust(),), got {disturbances!r}")
    found = []
    for k, given in enumerate(disturbances):
        label = f"disturbances[{k}]"
        if isinstance(given, Mapping):
            kind = choice(f"{label}: name", given.get("name"), LAWS)
            given = from_fields(label, LAWS[kind], {key: value for key, value in given.items() if key != "name"})
        if not isinstance(given, Disturbance):
            raise TypeError(f"{label} must be a Disturbance or a dict with a 'name', got {given!r}")
        check_frozen(label, given)
        name = getattr(given, "name", None)
        if not (isinstance(name, str) and name.isidentifier()):
            raise TypeError(f"{label}: {type(given).__name__} must have a name that is a word, such as name = 'mine'")
        choice(f"{label}: side", given.side, SIDES)
        found.append(given)
    return tuple(found)
