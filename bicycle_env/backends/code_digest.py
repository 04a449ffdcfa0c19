"""What a function is made of, as a digest: its bytecode and everything that it refers to, at any depth."""

from __future__ import annotations

import functools
import hashlib
import sys
from collections.abc import Callable
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic


def digest(function: Any, options: object = "") -> str:
    """A hexadecimal digest of a function's bytecode and of everything that it refers to, at any depth."""
    hasher = hashlib.sha256(f"{numba.__version__} {np.__version__} {sys.version} {options}".encode())
    _feed(hasher.update, function, set())
    return hasher.hexdigest()


# Their versions are in every digest: what is inside them needs no look.
_VERSIONED = ("builtins", "math", "numba", "numpy", "operator")


def _feed(update: Callable[[bytes], None], item: Any, seen: set[int], names: tuple[str, ...] = ()) -> None:
    """Feed one thing; `names` are the attributes that the code around it may read from a module."""

    def word(*parts: object) -> None:
        update(repr(parts).encode())

    if isinstance(item, Dispatcher) and hasattr(item, "content"):  # a part, whose content is known
        word("part", item.content)
        return
    if isinstance(item, Dispatcher):
        item = item.py_func
    if isinstance(item, _Intrinsic) and item.__module__.partition(".")[0] not in _VERSIONED:
        item = item.__wrapped__
    if isinstance(item, FunctionType):
        word("function", item.__name__)
        if id(item) in seen:
            return
        seen.add(id(item))
        names = _names(item.__code__)
        _feed(update, item.__code__, seen)
        _feed(update, item.__defaults__, seen)
        _feed(update, tuple((item.__kwdefaults__ or {}).items()), seen)
        for cell in item.__closure__ or ():
            _feed(update, cell.cell_contents, seen, names)
        for name in names:
            if name in item.__globals__:
                word(name)
                _feed(update, item.__globals__[name], seen, names)
    elif isinstance(item, CodeType):
        word("code", item.co_code, item.co_names, item.co_varnames, item.co_freevars)
        _feed(update, item.co_consts, seen)
    elif isinstance(item, ModuleType):
        word("module", item.__name__)
        if item.__name__.partition(".")[0] not in _VERSIONED:
            for name in names:
                if hasattr(item, name):
                    word(name)
                    _feed(update, getattr(item, name), seen, names)
    elif isinstance(item, (tuple, frozenset)):
        word(type(item).__name__, len(item))
        for part in item if isinstance(item, tuple) else sorted(item, key=repr):
            _feed(update, part, seen, names)
    elif isinstance(item, type):
        word("type", item.__module__, item.__qualname__, getattr(item, "_fields", None))
    elif isinstance(item, (np.ndarray, np.generic)):
        word("numpy", item.dtype.str, item.shape, item.tobytes())
    elif isinstance(item, (int, float, complex, str, bytes, type(None))):
        word(type(item).__name__, item)
    else:
        # Built-in functions, numpy functions and numba's own intrinsics.
        word("other", getattr(item, "__module__", type(item).__module__), getattr(item, "__name__", str(type(item))))


@functools.cache
def _names(code: CodeType) -> tuple[str, ...]:
    inner = [name for const in code.co_consts if isinstance(const, CodeType) for name in _names(const)]
    return (*code.co_names, *inner)
