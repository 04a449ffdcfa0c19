"""Laws are tried before they are used: on several cars at once, in numbers that know nothing but what a law may do.

What would otherwise be sixty lines of compiler, a riddle of torch, or a result of its own in one backend is one line
here, which names the law.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from bicycle_env.physics.elementary import NUMPY, Namespace, namespace

FUNCTIONS = tuple(name for name in vars(Namespace) if not name.startswith("_"))
"""What xp has."""
OPERATORS = {
    *(np.add, np.subtract, np.multiply, np.divide, np.floor_divide, np.remainder, np.power),
    *(np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal),
    *(np.bitwise_and, np.bitwise_or, np.bitwise_xor, np.left_shift, np.right_shift),
}
"""By which numpy calculates `a + b` and the others."""
OTHER_NAMES = {"absolute": "abs", "arctan": "xp.atan", "clip": "xp.minimum and xp.maximum", "square": "x * x"}


class NotOfALawError(TypeError):
    """A law does what it may not; the words say what it may."""


class Number(NDArrayOperatorsMixin):
    """A number of each car: has the operators of floats, and the functions of ``TRIAL``."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, values: Any) -> None:
        self.values = values

    def __repr__(self) -> str:
        return repr(self.values)

    def __neg__(self) -> Number:
        return Number(-self.values)

    def __pos__(self) -> Number:
        return self

    def __abs__(self) -> Number:
        return Number(abs(self.values))

    def __invert__(self) -> Number:
        return Number(~self.values)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = None, **_: Any) -> Number:
        if method != "__call__" or ufunc not in OPERATORS:
            raise NotOfALawError(_numpys(ufunc.__name__))
        values = ufunc(*map(plain, inputs), out=None if out is None else tuple(map(plain, out)))
        return Number(values) if out is None else out[0]

    def __array_function__(self, function: Any, *_: Any) -> Any:
        raise NotOfALawError(_numpys(function.__name__))

    def __bool__(self) -> bool:
        raise NotOfALawError("it branches on data: use xp.where")

    def __float__(self) -> float:
        raise NotOfALawError(f"it asks for one float, as the functions of math do: use those of xp, {_listed()}")

    __int__ = __index__ = __float__

    def __getitem__(self, *_: Any) -> Any:
        raise NotOfALawError("it looks into a number as if it were an array: a law is of single numbers")

    __iter__ = __len__ = __getitem__


def _listed() -> str:
    return ", ".join(FUNCTIONS)


def _numpys(name: str) -> str:
    known = f"xp.{name}" if name in FUNCTIONS else OTHER_NAMES.get(name)
    return f"it calls numpy's {name}: " + (f"use {known}" if known else f"a law may use xp's {_listed()}")


def plain(value: Any) -> Any:
    """Arrays in place of numbers, in tuples and records, too."""
    if isinstance(value, Number):
        return value.values
    return _of_the_same_kind(value, plain) if isinstance(value, tuple) else value


def _numbers(value: Any) -> Any:
    """Numbers, on copies, in place of arrays; of an array of several rows a tuple of them."""
    if isinstance(value, tuple):
        return _of_the_same_kind(value, _numbers)
    if np.ndim(value) > 1:
        return tuple(map(_numbers, value))
    return Number(value.copy()) if np.ndim(value) else value


def _of_the_same_kind(value: Any, change: Callable[[Any], Any]) -> Any:
    parts = map(change, value)
    return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)


def _lifted(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *arguments: Number(function(*map(plain, arguments)))


TRIAL: Namespace = namespace(
    "trial",
    _lifted(np.where),
    _lifted(np.floor),
    integer=_lifted(lambda x: np.asarray(x, dtype=np.int64)),
    real=_lifted(lambda i: np.asarray(i, dtype=np.float64)),
    table=lambda values: _lifted(lambda i: np.asarray(values, dtype=np.float64)[i]),
    sqrt=_lifted(NUMPY.sqrt),
)


def tried(
    label: str, make: Callable[[Any], Any], constants: bool = False, of: tuple[str, str] = ("car", "two cars")
) -> Any:
    """The law that ``make(xp)`` makes, to be called with arrays; None where it makes none.

    ValueError with the label, in one line, unless it gives one finite number for each car, or, if `constants`, one for
    all. `of`: what it is tried on, one and all.
    """
    each, together = of
    try:
        law = make(TRIAL)
    except Exception as error:
        raise ValueError(f"{label} cannot be made ({words(error)})") from error
    if law is None:
        return None

    def run(*arguments: Any) -> Any:
        given = _numbers(arguments)
        try:
            value = plain(law(*given))
        except Exception as error:
            raise ValueError(f"{label} fails on {together} at once ({words(error)})") from error
        if value is None:
            raise ValueError(f"{label} gives None: is its `return` missing?")
        before, after = leaves(plain(_numbers(arguments))), leaves(plain(given))
        if not all(map(np.array_equal, before, after)):
            raise ValueError(f"{label} changes what it is given: write x = x + 1.0 in place of x += 1.0")
        shape = next((np.shape(leaf) for leaf in before if np.ndim(leaf)), None)
        for name, leaf in zip(names(value), leaves(value), strict=True):
            if constants and np.ndim(leaf) == 0 and np.isfinite(leaf):
                continue
            if np.shape(leaf) != shape or not np.all(np.isfinite(leaf)):
                raise ValueError(f"{label} must give one finite number per {each}, got {name}{leaf!r} for {together}")
        return value

    return run


def words(error: Exception) -> str:
    """What a law did, in one line."""
    if isinstance(error, NotOfALawError):
        return str(error)
    if isinstance(error, AttributeError) and error.obj is TRIAL:
        return f"xp has no {error.name!r}; it has {_listed()}"
    return f"{type(error).__name__}: {error}".splitlines()[0]


def leaves(value: Any) -> list[Any]:
    """All that is in a tuple and the tuples in it."""
    return [leaf for part in value for leaf in leaves(part)] if isinstance(value, tuple) else [value]


def names(value: Any) -> list[str]:
    """Of the leaves: "field = " where there is one."""
    if not isinstance(value, tuple):
        return [""]
    fields = getattr(value, "_fields", [f"[{k}]" for k in range(len(value))])
    return [inner or f"{field} = " for field, part in zip(fields, value, strict=True) for inner in names(part)]
