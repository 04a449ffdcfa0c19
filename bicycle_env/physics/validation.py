"""Checks of what a user passes in: each error names the parameter, the value and the allowed range."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import numbers
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

RANGES: dict[str, tuple[float, float]] = {
    "mass": (1e-2, 1e6),  # kg
    "yaw_inertia": (1e-6, 1e8),  # kg m^2
    "length": (1e-3, 100.0),  # m: each length of a Vehicle
    "cornering_stiffness": (1e-2, 1e8),  # N/rad
    "friction": (1e-3, 10.0),
    "shape": (0.1, 3.129),  # of the Magic Formula; below 2 unless its curvature is exactly 1
    "curvature": (-1000.0, 1.0),
    "relaxation_length": (1e-3, 10.0),  # m
    "speed": (0.1, 1000.0),  # m/s
    "angle_limit": (1e-6, 1.57),  # rad
    "rate_limit": (1e-6, 1e6),  # rad/s; or infinity
    "time_constant": (1e-4, 100.0),  # s
    "timestep": (1e-6, 10.0),  # s
}
"""What a car, its tires, its road and its clock may be, both ends included: from a model at a tenth of the size to the
heaviest truck, and orders of magnitude beyond both. Further out, what is legal arithmetic ends in infinity and NaN."""

Class = TypeVar("Class", bound=type)
Value = TypeVar("Value")


def number(
    name: str, value: object, low: float = -math.inf, high: float = math.inf, *, above: float | None = None
) -> float:
    """A finite float in [low, high], and greater than `above` if given; TypeError or ValueError otherwise."""
    bound = f"> {above:g}" if above is not None else f">= {low:g}" if low > -math.inf else ""
    if high < math.inf:
        bound = f"in [{low:g}, {high:g}]" if low > -math.inf else f"{bound} and <= {high:g}".removeprefix(" and ")
    allowed = f"a finite number {bound}".rstrip()
    real = _scalar(value)
    if isinstance(real, bool) or not isinstance(real, numbers.Real):
        raise TypeError(f"{name} must be {allowed}, got {value!r} ({type(value).__name__})")
    try:
        result = float(real)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result) or result < low or result > high or (above is not None and result <= above):
        raise ValueError(f"{name} must be {allowed}, got {result!r}")
    return result


def positive(name: str, value: object) -> float:
    """A finite float > 0."""
    return number(name, value, above=0.0)


def in_range(name: str, value: object, quantity: str | None = None) -> float:
    """A finite float in the range of a quantity of ``RANGES``, by default the one of that name."""
    return number(name, value, *RANGES[quantity or name])


def in_range_or_infinite(name: str, value: object) -> float:
    """As :func:`in_range`; infinity means "no limit"."""
    return math.inf if _is_infinite(value) else in_range(name, value)


def _is_infinite(value: object) -> bool:
    real = _scalar(value)
    return isinstance(real, numbers.Real) and real == math.inf


def _scalar(value: Any) -> Any:
    """A zero-dimensional array is a number to numpy's users."""
    return value.item() if getattr(value, "shape", None) == () else value


def checked_speed(value: object, name: str = "speed") -> float:
    """A forward speed that the equations can be integrated at: in [0.1, 1000] m/s."""
    return in_range(name, value, "speed")


def whole(name: str, value: object, low: int = 1, high: float = 10**9) -> int:
    """A whole number in [low, high]; `high` may be infinite."""
    allowed = f"a whole number >= {low}" if high == math.inf else f"a whole number in [{low}, {high}]"
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise TypeError(f"{name} must be {allowed}, got {value!r}")
    if not low <= int(value) <= high:
        raise ValueError(f"{name} must be {allowed}, got {str(value)[:30]}")
    return int(value)


def choice(name: str, value: object, allowed: Iterable[str]) -> str:
    """One of the allowed words; the error proposes the nearest."""
    words = list(allowed)
    if not isinstance(value, str):
        raise TypeError(f"{name} must be one of {_listed(words)}, got {value!r}")
    if value not in words:
        raise ValueError(f"{name} must be one of {_listed(words)}, got {value!r}{_nearest(value, words)}")
    return value


def pair(name: str, value: object, low: float, high: float) -> tuple[float, float]:
    """Two numbers in [low, high], the second not less than the first."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise TypeError(f"{name} must be a pair (low, high), got {value!r}")
    least = number(f"{name}[0]", value[0], low, high)
    return least, number(f"{name}[1]", value[1], least, high)


def check_fields(value: object, check: Callable[..., object] = number, /, **allowed: tuple[Any, ...]) -> None:
    """Of a frozen dataclass, in its ``__post_init__``: each field becomes ``check(name, value, *allowed)``."""
    for name, more in allowed.items():
        object.__setattr__(value, name, check(name, getattr(value, name), *more))


def flag(name: str, value: object) -> bool:
    """True or False and nothing else."""
    if not isinstance(value, bool):
        raise TypeError(f"{name} must be True or False, got {value!r}")
    return value


def known_keys(what: str, given: Iterable[Any], allowed: Iterable[str], error: type[Exception] = ValueError) -> None:
    """Refuse a key that is not allowed, with the nearest that is."""
    words = list(allowed)
    for key in given:
        if key not in words:
            raise error(f"unknown {what} {key!r}{_nearest(str(key), words)} Allowed: {_listed(words)}")


def from_fields(what: str, cls: type[Value], given: Mapping[str, Any]) -> Value:
    """The plain form of a dataclass, its fields by their names, made into the object.

    Raises:
        ValueError: an unknown field, with the nearest known one; a missing field; a bad value.
        TypeError: a value of the wrong type.
    """
    fields = [field for field in dataclasses.fields(cls) if field.init]  # type: ignore[arg-type]
    known_keys(f"field of {what}", given, [field.name for field in fields])
    missing = [field.name for field in fields if field.default is dataclasses.MISSING and field.name not in given]
    if missing:
        raise ValueError(f"{what}: missing field{'s' * (len(missing) > 1)} {', '.join(map(repr, missing))}")
    try:
        return cls(**given)
    except (TypeError, ValueError) as error:
        raise type(error)(f"{what}: {error}") from None


def _nearest(word: str, words: list[str]) -> str:
    close = difflib.get_close_matches(word, words, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else "."


def _listed(words: list[str]) -> str:
    return ", ".join(repr(word) for word in words) if words else "none"


def explain_keywords(cls: Class) -> Class:
    """Decorate a dataclass so that an unknown keyword is answered with the nearest allowed one."""
    original: Callable[..., None] = cls.__init__  # type: ignore[misc]
    names = [field.name for field in dataclasses.fields(cls) if field.init]

    @functools.wraps(original)
    def explained(self: Any, *values: Any, **keywords: Any) -> None:
        known_keys(f"keyword of {cls.__name__}", keywords, names, TypeError)
        original(self, *values, **keywords)

    cls.__init__ = explained  # type: ignore[misc]
    return cls


def check_frozen(label: str, value: object) -> None:
    """TypeError unless a value is a frozen dataclass: what compiled code is made of must not change."""
    parameters = getattr(type(value), "__dataclass_params__", None)
    if parameters is None or not parameters.frozen:
        name = type(value).__name__
        raise TypeError(
            f"{label} {name} must be a frozen dataclass: write @dataclasses.dataclass(frozen=True) above it"
        )


def check_value(kind: str, value: object) -> None:
    """TypeError unless a value is a frozen dataclass whose fields are values, too: it is compared, and looked up."""
    check_frozen(kind, value)
    try:
        hash(value)
    except TypeError as error:
        name = type(value).__name__
        raise TypeError(f"{kind} {name}: its fields must be hashable, a tuple in place of a list ({error})") from None
