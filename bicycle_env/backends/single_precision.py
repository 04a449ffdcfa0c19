"""The laws in single precision: the same source, with all its constants as float32."""

from __future__ import annotations

from collections.abc import Callable
from types import CellType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from bicycle_env.backends.compiled import choose, inlined, integer, multiply_add, tables
from bicycle_env.physics import elementary


def _single(value: Any, names: tuple[str, ...] = ()) -> Any:
    """A constant in single precision: numba would compute float32 x 0.5 in float64. `names`: read from modules."""
    if isinstance(value, float):
        return np.float32(value)
    if isinstance(value, tuple) and any(isinstance(part, float) for part in value):
        return tuple(_single(part) for part in value)
    if isinstance(value, ModuleType) and any(isinstance(getattr(value, name, None), float) for name in names):
        module = ModuleType(f"{value.__name__} in single precision")  # np.pi, math.pi
        vars(module).update({name: _single(getattr(value, name)) for name in names if hasattr(value, name)})
        return module
    return value


def in_single_precision(law: Callable[..., Any]) -> Any:
    """The same law with its floats, literal, global, enclosed, default and in modules, as float32; inlined."""
    if isinstance(law, Dispatcher):
        return law
    function: Any = law
    code = function.__code__
    known, names = function.__globals__, code.co_names
    scope = {**known, **{name: _single(known[name], names) for name in names if name in known}}
    cells = tuple(CellType(_single(cell.cell_contents, names)) for cell in function.__closure__ or ())
    code = code.replace(co_consts=tuple(_single(value) for value in code.co_consts))
    return inlined(FunctionType(code, scope, function.__name__, _single(function.__defaults__), cells or None))


@inlined
def _single_of(i: Any) -> Any:
    return np.float32(i)


NUMBA_FLOAT32: elementary.Namespace = elementary.namespace(
    "numba_float32",
    choose,
    np.floor,
    in_single_precision,
    rounding=2.0**-24,
    multiply_add=multiply_add,
    integer=integer,
    real=_single_of,
    table=tables(np.float32),
    sqrt=np.sqrt,
)
