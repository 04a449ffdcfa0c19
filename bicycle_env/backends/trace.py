"""The laws run once on symbols: what comes out is the list of floating-point operations that they do.

A law is a branch-free function of a namespace, so one run with symbols in place of numbers meets every operation that
it ever does. The list can be written out as source of another language. Nothing is reordered and nothing computed
ahead, so a language with IEEE doubles gives the same bits; equal operations on equal operands are done once.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any, NamedTuple, NoReturn

from bicycle_env.physics import elementary


class TraceError(TypeError):
    """A law does what cannot be written out, such as ``if`` on data, or noise drawn from the bits of integers."""


class Symbol:
    """A number, or the truth of a comparison, that is known only when the written source runs."""

    __slots__ = ("operands", "operation", "value")

    def __init__(self, operation: str, *operands: Any, value: Any = None) -> None:
        self.operation = operation
        self.operands = tuple(map(symbol, operands))
        self.value = value
        """Of an input its name, of a constant its number, of a table its numbers."""

    @property
    def is_condition(self) -> bool:
        return self.operation in CONDITIONS

    def __neg__(self) -> Symbol:
        return Symbol("negative", self)

    def __pos__(self) -> Symbol:
        return self

    def __abs__(self) -> Symbol:
        return Symbol("size", self)

    def _bits(self, *_: Any) -> NoReturn:
        raise TraceError("a law with the bits of integers, such as sensors' noise, cannot be written out")

    __lshift__ = __rshift__ = __xor__ = _bits

    def _logic(self, operation: str, other: Any) -> Symbol:
        other = symbol(other)
        if not (self.is_condition and other.is_condition):
            self._bits()
        return Symbol(operation, self, other)

    def __and__(self, other: Any) -> Symbol:
        return self._logic("and", other)

    def __or__(self, other: Any) -> Symbol:
        return self._logic("or", other)

    def __invert__(self) -> Symbol:
        if not self.is_condition:
            self._bits()
        return Symbol("not", self)

    def __bool__(self) -> NoReturn:
        raise TraceError("a law must have no `if`, `and`, `or`, `not`, min or max on data: use xp.where, &, | and ~")

    def __float__(self) -> NoReturn:
        raise TraceError("a law must not make a plain number of its arguments")

    __int__ = __index__ = __float__


CONDITIONS = ("<", "<=", ">", ">=", "==", "!=", "and", "or", "not")
ARITHMETIC = {"add": "+", "sub": "-", "mul": "*", "truediv": "/"}
COMPARISONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}


def _operator(operation: str, reflected: bool = False) -> Any:
    def apply(self: Symbol, other: Any) -> Symbol:
        return Symbol(operation, other, self) if reflected else Symbol(operation, self, other)

    return apply


for _name, _operation in {**ARITHMETIC, **COMPARISONS}.items():
    setattr(Symbol, f"__{_name}__", _operator(_operation))
for _name, _operation in ARITHMETIC.items():
    setattr(Symbol, f"__r{_name}__", _operator(_operation, reflected=True))


def symbol(value: Any) -> Symbol:
    """A symbol of itself or of a number."""
    if isinstance(value, Symbol):
        return value
    if not isinstance(value, Real):
        raise TraceError(f"a law can be written out with numbers and symbols only, got {value!r}")
    return Symbol("constant", value=float(value))


def named(name: tuple[str, ...]) -> Symbol:
    """An input of what is written out."""
    return Symbol("input", value=name)


def _function(operation: str) -> Callable[..., Symbol]:
    def apply(*operands: Any) -> Symbol:
        return Symbol(operation, *operands)

    return apply


def _table(values: tuple[float, ...]) -> Callable[[Any], Symbol]:
    numbers = tuple(map(float, values))

    def lookup(i: Any) -> Symbol:
        return Symbol("lookup", i, value=numbers)

    return lookup


def _whole(x: Any) -> Symbol:
    """A whole float stays one: as an index, and in sums, it is as good as the integer."""
    return symbol(x)


def _namespace(name: str, rounding: float) -> elementary.Namespace:
    xp: elementary.Namespace = elementary.namespace(
        name,
        _function("choose"),
        _function("floor"),
        rounding=rounding,
        multiply_add=_function("multiply_add"),
        integer=_whole,
        real=_whole,
        table=_table,
        sqrt=_function("root"),
    )
    return xp


TRACE = _namespace("trace", 2.0**-53)
TRACE_FLOAT32 = _namespace("trace_float32", 2.0**-24)
"""Of single precision: its polynomials are shorter."""


class Step(NamedTuple):
    """One operation."""

    operation: str
    operands: tuple[int, ...]
    """Steps before this one."""
    value: Any
    """As of a :class:`Symbol`."""


@dataclasses.dataclass(frozen=True)
class Program:
    """Straight-line code."""

    steps: tuple[Step, ...]
    results: tuple[int, ...]
    """The steps that give the results."""

    @property
    def operations(self) -> int:
        """How many floating-point operations, comparisons and choices there are."""
        return sum(step.operation not in ("input", "constant") for step in self.steps)


def program(results: Sequence[Any]) -> Program:
    """What must be done for these symbols, each operation once, in an order in which it can be done."""
    steps: dict[Any, int] = {}
    listed: list[Step] = []
    place: dict[int, int] = {}  # by identity: == of symbols is a symbol
    wanted = [symbol(result) for result in results]
    waiting = wanted[::-1]
    while waiting:  # not recursive: sums of an RK4 step are thousands of operations deep
        one = waiting[-1]
        missing = [operand for operand in one.operands if id(operand) not in place]
        if missing:
            waiting.extend(missing[::-1])
            continue
        waiting.pop()
        operands = tuple(place[id(operand)] for operand in one.operands)
        # -0.0 == 0.0, but they are not the same number.
        value = one.value.hex() if one.operation == "constant" else one.value
        key = (one.operation, operands, value)
        if key not in steps:
            steps[key] = len(listed)
            listed.append(Step(one.operation, operands, one.value))
        place[id(one)] = steps[key]
    return Program(tuple(listed), tuple(place[id(one)] for one in wanted))
