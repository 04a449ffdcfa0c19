"""Named tuples, field by field: the one place that knows how many fields a record has.

numba makes no tuple of a varying number of elements, so what handles a record is written out as source here, once for
its fields; a law that is bound this way runs on floats, arrays, tensors and symbols as any other.
"""

from __future__ import annotations

import functools
from collections import namedtuple
from collections.abc import Callable, Sequence
from typing import Any

from bicycle_env.physics.validation import known_keys


def written(name: str, arguments: str, body: str, **scope: Any) -> Any:
    """A function from its source, with these names around it."""
    exec(f"def {name}({arguments}):\n    {body}", scope)
    return scope[name]


def _check_fields(record: Any, names: tuple[str, ...]) -> None:
    known_keys(f"field of {record.__name__}", names, record._fields)
    if len(set(names)) < len(names):
        raise ValueError(f"fields of {record.__name__} must be named once each, got {', '.join(names)}")


def fieldwise(xp: Any, record: Any, law: Callable[..., Any], records: int, shared: int = 0) -> Any:
    """``f(a, b, ..., x, ...) -> record``: `law` of each field's values.

    The first `records` arguments are records; `shared` more are the same for all fields.
    """
    these = [f"r{k}" for k in range(records)]
    more = [f"x{k}" for k in range(shared)]
    values = (", ".join([*(f"{one}.{field}" for one in these), *more]) for field in record._fields)
    result = ", ".join(f"law({each})" for each in values)
    return xp.function(
        written("fieldwise", ", ".join([*these, *more]), f"return record({result})", record=record, law=law)
    )


def replaced(xp: Any, record: Any, names: tuple[str, ...]) -> Any:
    """``f(a, x, ...) -> record``: the record with other values in the named fields, in their order.

    ValueError for a field that the record does not have.
    """
    _check_fields(record, names)
    values = (f"x{names.index(field)}" if field in names else f"a.{field}" for field in record._fields)
    arguments = ", ".join(["a", *(f"x{k}" for k in range(len(names)))])
    return xp.function(written("replaced", arguments, f"return record({', '.join(values)})", record=record))


def reader(xp: Any, record: Any, first: int, stride: int) -> Any:
    """``read(numbers, k) -> record``: of car k, each field `stride` numbers after the one before it."""
    values = ", ".join(f"numbers[k + {(first + j) * stride}]" for j in range(len(record._fields)))
    return xp.function(written("read", "numbers, k", f"return record({values})", record=record))


def writer(xp: Any, count: int, first: int, stride: int) -> Any:
    """``write(numbers, k, values)``: the first `count` values, to where :func:`reader` finds them."""
    lines = [f"numbers[k + {(first + j) * stride}] = values[{j}]" for j in range(count)]
    return xp.function(written("write", "numbers, k, values", "\n    ".join(lines or ["pass"])))


def field(xp: Any, name: str) -> Any:
    """``f(a) -> a.name``."""
    return xp.function(written("field", "a", f"return a.{name}"))


def merged(xp: Any, record: Any, names: tuple[str, ...]) -> Any:
    """``f(a, b) -> record``: the named fields from b, the others from a; ValueError as :func:`replaced`."""
    _check_fields(record, names)
    values = (f"{'b' if name in names else 'a'}.{name}" for name in record._fields)
    return xp.function(written("merged", "a, b", f"return record({', '.join(values)})", record=record))


@functools.cache
def record_of(name: str, fields: tuple[str, ...]) -> Any:
    """A named-tuple class with these fields; the same one for the same name and fields. Its objects pickle."""
    make: Any = namedtuple
    record = make("Record", fields)
    record.__name__ = record.__qualname__ = name

    def reduced(self: Any) -> Any:
        return _made, (name, fields, tuple(self))

    record.__reduce__ = reduced
    return record


def _made(name: str, fields: tuple[str, ...], values: tuple[Any, ...]) -> Any:
    return record_of(name, fields)(*values)


def joined(xp: Any, record: Any, first: Any, second: Any) -> Any:
    """``f(a, b) -> record``: the fields of a `first`, then those of a `second`."""
    values = [*(f"a.{name}" for name in first._fields), *(f"b.{name}" for name in second._fields)]
    return xp.function(written("joined", "a, b", f"return record({', '.join(values)})", record=record))


def part(xp: Any, record: Any) -> Any:
    """``f(a) -> record``: those fields of a larger record."""
    values = ", ".join(f"a.{name}" for name in record._fields)
    return xp.function(written("part", "a", f"return record({values})", record=record))


def expression(xp: Any, value: str, arguments: str, **laws: Any) -> Any:
    """``f(arguments)``: an expression of the arguments and of laws, by their names."""
    scope = {name: xp.function(law) for name, law in laws.items()}
    return xp.function(written("expression", arguments, f"return {value}", **scope))


def composed(xp: Any, record: Any, values: Sequence[str], arguments: str, **laws: Any) -> Any:
    """``f(arguments) -> record``: each field from an expression of the arguments and of laws, by their names."""
    scope = {name: xp.function(law) for name, law in laws.items()}
    return xp.function(written("composed", arguments, f"return record({', '.join(values)})", record=record, **scope))


def sequence(xp: Any, values: Sequence[str], arguments: str, **laws: Any) -> Any:
    """``f(arguments) -> tuple``, each value from an expression of the arguments and of laws, by their names."""
    return expression(xp, f"({''.join(f'{value}, ' for value in values)})", arguments, **laws)
