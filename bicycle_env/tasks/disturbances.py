"""What happens to the car on its way: gusts, slippery road, a tire that loses stiffness. Frozen objects, like tires."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from bicycle_env.physics.records import composed, field, replaced
from bicycle_env.physics.single_track import CarParameters, CarState
from bicycle_env.physics.validation import choice, explain_keywords, from_fields, number
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.randomised import nominal
from bicycle_env.tasks.task import Law

Amount = float | tuple[float, float]
"""A number, or two between which it is drawn at the start of each episode."""
SIDES = {"left": (1.0, 1.0), "right": (-1.0, -1.0), "random": (-1.0, 1.0)}
"""The least and the greatest sign."""
AXLES = ("front", "rear", "both")


class Disturbance(abc.ABC):
    """Base of the disturbances: what is drawn for an episode, and how it changes the car of a moment."""

    name: str
    flips: ClassVar[tuple[str, ...]] = ()
    """Names of :meth:`amounts` that change sign in the mirror image."""

    @abc.abstractmethod
    def amounts(self) -> dict[str, Amount]:
        """What stands in the state of an episode, by name."""

    @abc.abstractmethod
    def law(self, xp: Any, names: Mapping[str, str]) -> Law:
        """``law(car, own, time) -> CarParameters``; `names`: those of the amounts in the task's state `own`."""


def _checked(name: str, amount: Any, low: float, high: float) -> Amount:
    if isinstance(amount, (tuple, list)):
        if len(amount) != 2:
            raise ValueError(f"{name} must be a number or (low, high), got {amount!r}")
        least = number(f"{name}[0]", amount[0], low, high)
        return (least, number(f"{name}[1]", amount[1], least, high))
    return number(name, amount, low, high)


def _check(disturbance: Disturbance, **ranges: tuple[float, float]) -> None:
    for name, (low, high) in ranges.items():
        object.__setattr__(disturbance, name, _checked(name, getattr(disturbance, name), low, high))


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
        _check(self, force=(0.0, 1e6), duration=(0.0, 1e6), start=(0.0, 1e6), arm=(-10.0, 10.0))
        choice("side", self.side, SIDES)

    def amounts(self) -> dict[str, Amount]:
        return {"start": self.start, "force": self.force}

    def law(self, xp: Any, names: Mapping[str, str]) -> Law:
        start_of, force_of = field(xp, names["start"]), field(xp, names["force"])
        pushed = replaced(xp, CarParameters, ("side_force", "yaw_moment"))
        duration, arm = self.duration, self.arm

        def gust(car: CarParameters, own: Any, time: Any) -> CarParameters:
            start = start_of(own)
            force = xp.where((time >= start) & (time < start + duration), force_of(own), 0.0)
            changed: CarParameters = pushed(car, car.side_force + force, xp.multiply_add(force, arm, car.yaw_moment))
            return changed

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
        _check(self, at=(0.0, 1e6), front=(0.01, 10.0), rear=(0.01, 10.0))

    def amounts(self) -> dict[str, Amount]:
        return {"at": self.at, "front": self.front, "rear": self.rear}

    def law(self, xp: Any, names: Mapping[str, str]) -> Law:
        at_of, front_of, rear_of = (field(xp, names[name]) for name in ("at", "front", "rear"))
        slippery = replaced(xp, CarParameters, ("front_peak_force", "rear_peak_force"))

        def friction_step(car: CarParameters, own: Any, time: Any) -> CarParameters:
            begun = time >= at_of(own)
            front, rear = xp.where(begun, front_of(own), 1.0), xp.where(begun, rear_of(own), 1.0)
            changed: CarParameters = slippery(car, front * car.front_peak_force, rear * car.rear_peak_force)
            return changed

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
        _check(self, at=(0.0, 1e6), factor=(0.01, 1.0))

    def amounts(self) -> dict[str, Amount]:
        return {"at": self.at, "factor": self.factor}

    def law(self, xp: Any, names: Mapping[str, str]) -> Law:
        at_of, factor_of = field(xp, names["at"]), field(xp, names["factor"])
        soft = replaced(xp, CarParameters, ("front_cornering_stiffness", "rear_cornering_stiffness"))
        front_part, rear_part = float(self.axle != "rear"), float(self.axle != "front")

        def stiffness_loss(car: CarParameters, own: Any, time: Any) -> CarParameters:
            lost = xp.where(time >= at_of(own), factor_of(own) - 1.0, 0.0)
            front, rear = 1.0 + front_part * lost, 1.0 + rear_part * lost
            changed: CarParameters = soft(
                car, front * car.front_cornering_stiffness, rear * car.rear_cornering_stiffness
            )
            return changed

        return stiffness_loss


LAWS: dict[str, Any] = {"gust": Gust, "friction_step": FrictionStep, "stiffness_loss": StiffnessLoss}
"""The disturbances that have a plain form."""


@dataclasses.dataclass(frozen=True)
class DisturbedTask(AlteredTask):
    """Disturbances act on the car, one after the other; their amounts stand in the state."""

    disturbances: tuple[Disturbance, ...]

    @property
    def _amounts(self) -> tuple[tuple[Disturbance, str, str, Amount], ...]:
        """(disturbance, its name, the name in the state, amount)."""
        kinds = [one.name for one in self.disturbances]
        found = []
        for k, one in enumerate(self.disturbances):
            number_of_kind = kinds[: k + 1].count(one.name)
            label = one.name if number_of_kind == 1 else f"{one.name}_{number_of_kind}"
            found += [(one, name, f"{label}_{name}", amount) for name, amount in one.amounts().items()]
        return tuple(found)

    @property
    def kept(self) -> tuple[str, ...]:
        return tuple(label for _, _, label, _ in self._amounts)

    @property
    def kept_flipped(self) -> tuple[str, ...]:
        return tuple(label for one, name, label, _ in self._amounts if name in one.flips)

    @property
    def draws(self) -> int:
        return 2 * len(self._amounts)  # of each: the amount and the side, fixed or not, so that starts stay alike

    def draw(self, xp: Any) -> Law:
        first = self.task.uniforms
        laws = {}
        for k, (one, name, _, amount) in enumerate(self._amounts):
            sides = SIDES[getattr(one, "side", "left")] if name in one.flips else SIDES["left"]
            laws[f"draw{k}"] = _drawn(xp, amount, sides, first + 2 * k)
        draws = composed(xp, self.Kept, [f"{law}(uniforms)" for law in laws], "uniforms", **laws)

        def draw(uniforms: Any, state: CarState, own: Any, world: World) -> Any:
            return draws(uniforms)

        return draw

    def conditions(self, xp: Any) -> Law:
        chain = xp.function(self.task.conditions(xp) or nominal)
        rows, step = self._amounts, 0
        for one in self.disturbances:
            names = {name: label for _, name, label, _ in rows[step : step + len(one.amounts())]}
            step += len(names)
            chain = xp.function(_after(chain, xp.function(one.law(xp, names))))
        return chain  # type: ignore[no-any-return]


def _after(before: Law, law: Law) -> Law:
    def conditions(state: CarState, episode: EpisodeState, time: Any, world: World) -> CarParameters:
        car: CarParameters = law(before(state, episode, time, world), episode.task_state, time)
        return car

    return conditions


def _drawn(xp: Any, amount: Amount, sides: tuple[float, float], place: int) -> Law:
    low, high = amount if isinstance(amount, tuple) else (amount, amount)
    width, (negative, positive) = high - low, sides

    def drawn(uniforms: Any) -> Any:
        size = xp.multiply_add(width, uniforms[place], low)
        return xp.where(uniforms[place + 1] < 0.5, negative * size, positive * size)

    return drawn


def resolve(disturbances: Any) -> tuple[Disturbance, ...]:
    """What ``disturbances=`` takes: an iterable of disturbances or of their plain forms.

    Raises:
        ValueError, TypeError: an unknown name or field, with the nearest known one; a bad value.
    """
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
        found.append(given)
    return tuple(found)
