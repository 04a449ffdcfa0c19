"""The numba backend: one namespace of inlined functions, and entry points that are compiled once per machine.

numba's own cache keys a compiled function by its bytecode and the pickled contents of its closure. The first misses
changes in the functions that it calls, the second never matches in a new process. Here the key is a digest of every
function, constant and record that goes into an entry point: editing a tire law recompiles what uses it, and nothing
else does.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import llvmlite.binding
import numba
import numpy as np
from llvmlite import ir
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.core.extending import _Intrinsic
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic

from bicycle_env.physics import elementary
from bicycle_env.physics.compile_cache import ContentCache

# The compiler has no licence to round otherwise than the source says: `contract` fuses what suits the processor,
# `reassoc` makes a row depend on its neighbours, `nnan` deletes the NaN checks.
COMMON = {"error_model": "numpy", "fastmath": False, "no_cfunc_wrapper": True}


class CompilerDisabledError(RuntimeError):
    """The user has switched numba's compiler off."""


class LawError(TypeError):
    """A law does what numba cannot compile. ``details``: numba's own words, many lines of them."""

    details: str


class Part(CPUDispatcher):  # type: ignore[misc]
    """A law that other compiled functions take in. No way in from Python: those took half of the compile time."""

    content: str

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Not from Python: TypeError."""
        raise TypeError(f"{self.py_func.__name__} is a part of compiled functions: call it from one, or without numba")


PARTS: dict[str, Part] = {}
"""Of this process, by content: numba looks at a law once, however many combinations take it in."""


def inlined(law: Callable[..., Any]) -> Any:
    """A law as a part of a larger compiled function."""
    if isinstance(law, Dispatcher) or numba.config.DISABLE_JIT:  # then entry_point says what is wrong
        return law
    content = digest(law)
    if content not in PARTS:
        part: Any = numba.njit(law, forceinline=True, no_cpython_wrapper=True, **COMMON)
        part.__class__ = Part
        part.content = content
        PARTS[content] = part
    return PARTS[content]


def digest(function: Any) -> str:
    """A hexadecimal digest of a function's bytecode and of everything that it refers to, at any depth."""
    hasher = hashlib.sha256(f"{numba.__version__} {np.__version__} {sys.version} {COMMON}".encode())
    _feed(hasher.update, function, set())
    return hasher.hexdigest()


# Their versions are in every digest: what is inside them needs no look.
_VERSIONED = ("builtins", "math", "numba", "numpy", "operator")


def _feed(update: Callable[[bytes], None], item: Any, seen: set[int], names: tuple[str, ...] = ()) -> None:
    """Feed one thing; `names` are the attributes that the code around it may read from a module."""

    def word(*parts: object) -> None:
        update(repr(parts).encode())

    if isinstance(item, Part):
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


@inlined
def _choose(condition: Any, then: Any, otherwise: Any) -> Any:
    return then if condition else otherwise


@intrinsic  # type: ignore[untyped-decorator]
def _multiply_add(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c, rounded once: LLVM's fma. A processor without one takes the mathematics library's: exact, and slow."""
    kind = typing.unify_types(a, b, c)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = context.get_value_type(signature.return_type)
        fused = builder.module.declare_intrinsic("llvm.fma", [number], ir.FunctionType(number, [number] * 3))
        return builder.call(fused, arguments)

    return kind(kind, kind, kind), generate


NUMBA: elementary.Namespace = elementary.namespace("numba", _choose, np.floor, inlined, multiply_add=_multiply_add)


@intrinsic  # type: ignore[untyped-decorator]
def first_bit(_typing: Any, _bits: Any) -> Any:
    """``first_bit(bits) -> int64`` of a uint64: the place of the lowest bit that is set; there must be one."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return numba.int64(numba.uint64), generate


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


NUMBA_FLOAT32: elementary.Namespace = elementary.namespace(
    "numba_float32", _choose, np.floor, in_single_precision, rounding=2.0**-24, multiply_add=_multiply_add
)


ENTRY_POINTS: dict[str, Callable[..., Any]] = {}
"""Of this process, by content: tasks whose laws are equal share their code, though they may differ in their numbers."""


def entry_point(
    function: Callable[..., Any], signature: Any, nogil: bool = False, interleave: int = 0
) -> Callable[..., Any]:
    """Compile a function for one signature, or load it from the cache on disk; see :mod:`announcements`.

    `nogil`: other threads may run beside it. `interleave`: how many vectors of rows its loops take at a time, which
    fills the waiting of one with the work of another; 0 leaves it to the compiler. Raises CompilerDisabledError where
    NUMBA_DISABLE_JIT is set: the entry points use what only compiled code can.
    """
    if numba.config.DISABLE_JIT:
        raise CompilerDisabledError("bicycle_env needs numba's compiler, and NUMBA_DISABLE_JIT is set: unset it")
    what = f"{digest(function)} {signature} {nogil} {interleave} {llvmlite.__version__}"
    content = hashlib.sha256(what.encode()).hexdigest()
    if content in ENTRY_POINTS:
        return ENTRY_POINTS[content]
    # The linker looks for code by name: what is loaded must not be taken for another content's.
    function.__qualname__ = f"{function.__name__}-{content[:20]}"
    dispatcher: Any = numba.njit(function, nogil=nogil, **COMMON)
    dispatcher._cache = ContentCache(function, content)
    with _interleaved(interleave):
        try:
            dispatcher.compile(signature)
        except NumbaError as error:
            raise _in_one_line(error) from None
    dispatcher.disable_compile()
    ENTRY_POINTS[content] = dispatcher
    return ENTRY_POINTS[content]


def _in_one_line(error: NumbaError) -> LawError:
    """Where the law is, and numba's reason."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    places = re.findall(r"(?:File \"|at |\()([^\s\"()]+\.py)\"?(?:, line |\s\(| \()(\d+)", text)
    package = str(Path(__file__).parents[1])
    own = [place for place in places if not str(Path(place[0]).absolute()).startswith(package)] or places
    where = f"{own[0][0]}, line {own[0][1]}: " if own else ""
    reasons = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("Failed in")]
    told = [
        line for line in reasons if line.startswith((">>>", "Use of unsupported", "Cannot", "Unknown", "NameError"))
    ]
    reason = " ".join([reasons[0].rstrip(":"), *told[:1]]) if reasons else type(error).__name__
    found = LawError(
        f"{where}this law cannot be compiled ({reason}). A law may use its arguments, floats, tuples and the functions "
        "of xp"
    )
    found.details = text
    return found


@contextlib.contextmanager
def _interleaved(count: int) -> Iterator[None]:
    """LLVM takes this wish for the whole process only: nobody else compiles meanwhile."""
    with global_compiler_lock:
        try:
            if count:
                llvmlite.binding.set_option("", f"-force-vector-interleave={count}")
            yield
        finally:
            if count:
                llvmlite.binding.set_option("", "-force-vector-interleave=0")
