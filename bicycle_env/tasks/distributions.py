"""What is drawn at the start of an episode: laws of one uniform number. Frozen objects, like tires."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Mapping
from statistics import NormalDist
from typing import Any

from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.random_bits import MOST_DEVIATIONS, normal_quantile
from bicycle_env.physics.records import composed, record_of
from bicycle_env.physics.validation import check_frozen, choice, explain_keywords, from_fields, number
from bicycle_env.tasks.task import Law

LEAST, MOST = 1e-4, 1e8
MOST_VALUES = 32
FORMS = "(low, high) or (low, high, 'relative')"


class Distribution(abc.ABC):
    """Base of the distributions; `relative`: of a number per the nominal one, so that 1 is the nominal car's."""

    name: str
    relative: bool

    @property
    @abc.abstractmethod
    def bounds(self) -> tuple[float, float]:
        """Between which all values lie."""

    @abc.abstractmethod
    def numbers(self) -> dict[str, float]:
        """Its numbers by name; they stand in the settings, so that others compile nothing anew."""

    @abc.abstractmethod
    def law(self, xp: Any) -> Law:
        """``law(uniform, own) -> value``: of a number in [0, 1) and of its numbers `own`."""


class Between(Distribution):
    """Base of those between two fields, ``low`` and ``high``."""

    low: float
    high: float

    def __post_init__(self) -> None:
        low = number("low", self.low, LEAST, MOST)
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", number("high", self.high, low, MOST))

    @property
    def bounds(self) -> tuple[float, float]:
        return self.low, self.high


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Uniform(Between):
    """Uniform in [low, high]."""

    name: str = dataclasses.field(default="uniform", init=False, repr=False, compare=False)
    low: float
    high: float
    relative: bool = False

    def numbers(self) -> dict[str, float]:
        return {"low": self.low, "width": self.high - self.low}

    def law(self, xp: Any) -> Law:
        def uniform(uniform: Any, own: Any) -> Any:
            return xp.multiply_add(own.width, uniform, own.low)

        return uniform


@explain_keywords
@dataclasses.dataclass(frozen=True)
class LogUniform(Between):
    """Its logarithm is uniform: half the values are below the geometric mean of low and high."""

    name: str = dataclasses.field(default="log_uniform", init=False, repr=False, compare=False)
    low: float
    high: float
    relative: bool = False

    def numbers(self) -> dict[str, float]:
        reach = math.log(self.high / self.low) / 16.0
        return {"low": self.low, "high": self.high, "mean": math.sqrt(self.low * self.high), "reach": reach}

    def law(self, xp: Any) -> Law:
        def log_uniform(uniform: Any, own: Any) -> Any:
            t = xp.tanh(own.reach * (2.0 * uniform - 1.0))
            growth = (1.0 + t) / (1.0 - t)  # e^2x; its fourth power, so that 1 - t is never small
            square = growth * growth
            return xp.maximum(xp.minimum(own.mean * (square * square), own.high), own.low)

        return log_uniform


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Normal(Between):
    """Normal, given that it lies in [low, high], where its mean is, and within `MOST_DEVIATIONS` of it.

    The distribution function is right to 2e-4.
    """

    name: str = dataclasses.field(default="normal", init=False, repr=False, compare=False)
    mean: float
    deviation: float
    low: float
    high: float
    relative: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "mean", number("mean", self.mean, self.low, self.high))
        object.__setattr__(self, "deviation", number("deviation", self.deviation, LEAST, MOST))

    def numbers(self) -> dict[str, float]:
        furthest = MOST_DEVIATIONS * self.deviation
        ends = max(self.low, self.mean - furthest), min(self.high, self.mean + furthest)
        shares = [NormalDist(self.mean, self.deviation).cdf(end) for end in ends]
        first, last = map(normal_quantile(PYTHON), shares)
        scale = (ends[1] - ends[0]) / (last - first) if last > first else 0.0  # so that both ends are exact
        shape = {"scale": scale, "offset": ends[0] - scale * first}
        return {"low": self.low, "high": self.high, "share": shares[0], "width": shares[1] - shares[0], **shape}

    def law(self, xp: Any) -> Law:
        quantile = xp.function(normal_quantile(xp))

        def normal(uniform: Any, own: Any) -> Any:
            value = xp.multiply_add(own.scale, quantile(xp.multiply_add(own.width, uniform, own.share)), own.offset)
            return xp.maximum(xp.minimum(value, own.high), own.low)

        return normal


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Choice(Distribution):
    """One of some values, all equally likely; at most `MOST_VALUES` of them."""

    name: str = dataclasses.field(default="choice", init=False, repr=False, compare=False)
    values: tuple[float, ...]
    relative: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.values, (tuple, list)) or not 1 <= len(self.values) <= MOST_VALUES:
            raise TypeError(f"values must be a tuple of 1 to {MOST_VALUES} numbers, got {self.values!r}")
        checked = tuple(number(f"values[{k}]", value, LEAST, MOST) for k, value in enumerate(self.values))
        object.__setattr__(self, "values", checked)

    @property
    def bounds(self) -> tuple[float, float]:
        return min(self.values), max(self.values)

    def numbers(self) -> dict[str, float]:
        count = len(self.values)
        edges = {f"edge_{k}": k / count for k in range(1, count)}
        return {**{f"value_{k}": value for k, value in enumerate(self.values)}, **edges}

    def law(self, xp: Any) -> Law:
        def later(uniform: Any, edge: Any, value: Any, before: Any) -> Any:
            return xp.where(uniform >= edge, value, before)

        value = "(own.value_0 + 0.0 * uniform)"  # a number of the uniform's type: tensors need one
        for k in range(1, len(self.values)):
            value = f"later(uniform, own.edge_{k}, own.value_{k}, {value})"
        chosen = composed(xp, record_of("Chosen", ("value",)), [value], "uniform, own", later=later)

        def choice(uniform: Any, own: Any) -> Any:
            return chosen(uniform, own).value

        return choice


LAWS: dict[str, type[Distribution]] = {
    "uniform": Uniform,
    "log_uniform": LogUniform,
    "normal": Normal,
    "choice": Choice,
}


def resolve(label: str, given: Any) -> Distribution:
    """A distribution from itself, from ``(low, high)``, ``(low, high, "relative")`` or from its plain form, a dict.

    Raises:
        ValueError, TypeError: an unknown name or field, with the nearest known one; a bad value; something else.
    """
    if isinstance(given, Distribution):
        check_frozen(label, given)
        return given
    if isinstance(given, Mapping):
        kind = choice(f"{label}: name", given.get("name", "uniform"), LAWS)
        return from_fields(label, LAWS[kind], {key: value for key, value in given.items() if key != "name"})
    if not isinstance(given, (tuple, list)) or len(given) not in (2, 3) or (len(given) == 3 and given[2] != "relative"):
        raise TypeError(f"{label} must be {FORMS}, or one of bicycle_env.distributions, got {given!r}")
    return from_fields(label, Uniform, {"low": given[0], "high": given[1], "relative": len(given) == 3})
