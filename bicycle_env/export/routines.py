"""What is exported: functions of records of numbers, each from a law, and the records that they take and give."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numba
import numpy as np

from bicycle_env.backends.compiled import entry_point, multiply_add
from bicycle_env.backends.trace import TRACE, Program, named, program
from bicycle_env.physics import elementary
from bicycle_env.physics.elementary import PYTHON

Law = Callable[[Any], Callable[..., Any]]


class Argument(NamedTuple):
    """What a routine takes or gives."""

    name: str
    record: Any = None
    """A named-tuple class; None for one number."""
    kind: str = ""
    """What the record is called in the other language, "" as the argument; of a number "count" if it is whole."""

    @property
    def type_name(self) -> str:
        return self.kind or self.name

    @property
    def fields(self) -> tuple[str, ...]:
        return ("",) if self.record is None else self.record._fields

    def made(self, numbers: Sequence[Any]) -> Any:
        """Of as many numbers as it has fields."""
        return numbers[0] if self.record is None else self.record(*numbers)


@dataclasses.dataclass(frozen=True)
class Routine:
    """One exported function."""

    name: str
    words: str
    """For its comment."""
    arguments: tuple[Argument, ...]
    results: tuple[Argument, ...]
    """Records; or one number."""
    law: Law
    """``law(xp)`` is a function of the arguments, whose result is a tuple of the results, or the only one."""
    c_body: str = ""
    """Where it only calls the others: its lines in C, ``{p}`` for the library's name. Its law serves to check them."""
    js_body: str = ""
    """Likewise in JavaScript."""

    @property
    def taken(self) -> list[Argument]:
        """The arguments, without empty records."""
        return [argument for argument in self.arguments if argument.fields]

    @property
    def given(self) -> list[Argument]:
        """The results, without empty records."""
        return [result for result in self.results if result.fields]

    def program(self) -> Program:
        """The operations, and the inputs as ``(argument, field)``."""
        inputs = [
            argument.made([named((argument.name, field)) for field in argument.fields]) for argument in self.arguments
        ]
        return program(self._flat(self.law(TRACE)(*inputs)))

    def bound(self, xp: Any) -> Callable[[Sequence[float]], list[float]]:
        """``run(numbers) -> numbers`` in a namespace: of all arguments, and of all results, in their order."""
        law = self.law(xp)

        def run(numbers: Sequence[float]) -> list[float]:
            left, inputs = list(numbers), []
            for argument in self.arguments:
                inputs.append(argument.made(left[: len(argument.fields)]))
                del left[: len(argument.fields)]
            return [float(value) for value in self._flat(law(*inputs))]

        return run

    def _flat(self, found: Any) -> list[Any]:
        several = found if len(self.results) > 1 else (found,)
        return [
            value
            for result, one in zip(self.results, several, strict=True)
            for value in ((one,) if result.record is None else one)
        ]


@dataclasses.dataclass(frozen=True)
class Library:
    """Functions that belong together: one file of source."""

    name: str
    """In snake_case; of the files and, in C, before every name."""
    words: tuple[str, ...]
    """Lines that say what it is."""
    routines: tuple[Routine, ...]
    constants: Mapping[str, Any]
    """By name: records' values (named tuples), numbers, or tuples of words."""
    constant_types: Mapping[str, str]
    """The records' names of the former."""
    cases: Mapping[str, Sequence[Sequence[float]]]
    """By routine: inputs of its test vectors."""

    @property
    def records(self) -> dict[str, Any]:
        """By name, in the order in which they are met."""
        return {
            argument.type_name: argument.record
            for routine in self.routines
            for argument in (*routine.taken, *routine.given)
            if argument.record is not None
        }

    def vectors(self, fma: bool) -> dict[str, list[tuple[list[float], list[float]]]]:
        """By routine: inputs and what the laws give for them; `fma`: a multiply-add rounds once."""
        xp = fused() if fma else PYTHON
        found = {}
        for routine in self.routines:
            run = routine.bound(xp)
            found[routine.name] = [(list(numbers), run(numbers)) for numbers in self.cases[routine.name]]
        return found


@functools.cache
def fused() -> Any:
    """The namespace of plain Python, but for its multiply-add: that of compiled code, rounded once."""
    number = numba.float64

    def fused_multiply_add(a: float, b: float, c: float) -> float:
        return multiply_add(a, b, c)  # type: ignore[no-any-return]

    def choose(condition: Any, then: Any, otherwise: Any) -> Any:
        return then if condition else otherwise

    compiled = entry_point(fused_multiply_add, number(number, number, number))
    return elementary.namespace("fused", choose, np.floor, multiply_add=compiled)


UNITS = {
    **dict.fromkeys(("longitudinal_position", "lateral_position", "relaxation_length"), "m"),
    **dict.fromkeys(("cg_to_front", "cg_to_rear", "front_extent", "rear_extent", "body_width"), "m"),
    **dict.fromkeys(("heading", "front_steer", "rear_steer", "front_angle_limit", "rear_angle_limit"), "rad"),
    **dict.fromkeys(("front_transient_slip_angle", "rear_transient_slip_angle"), "rad"),
    **dict.fromkeys(("front_steer_command", "rear_steer_command"), "rad"),
    **dict.fromkeys(("front_slip_angle", "rear_slip_angle"), "rad"),
    **dict.fromkeys(("lateral_velocity", "speed"), "m/s"),
    **dict.fromkeys(("yaw_rate", "front_rate_limit", "rear_rate_limit"), "rad/s"),
    **dict.fromkeys(("front_cornering_stiffness", "rear_cornering_stiffness"), "N/rad"),
    **dict.fromkeys(("front_peak_force", "rear_peak_force", "side_force"), "N"),
    **dict.fromkeys(("front_lateral_force", "rear_lateral_force"), "N"),
    **dict.fromkeys(("front_time_constant", "rear_time_constant", "control_timestep", "timestep"), "s"),
    **dict.fromkeys(("goal", "road_centre", "road_half_width"), "m"),
    "mass": "kg",
    "yaw_inertia": "kg m^2",
    "yaw_moment": "N m",
    "lateral_acceleration": "m/s^2",
    "yaw_acceleration": "rad/s^2",
    **dict.fromkeys(("substeps", "steps", "settled_steps", "horizon", "steers_front", "steers_rear"), "1"),
}
"""By the names of records' fields."""
