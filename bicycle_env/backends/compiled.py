"""The numba backend: one namespace of inlined functions, and entry points that are compiled once per machine.

numba's own cache keys a compiled function by its bytecode and the pickled contents of its closure. The first misses
changes in the functions that it calls, the second never matches in a new process. Here the key is a digest of every
function, constant and record that goes into an entry point: editing a tire law recompiles what uses it, and nothing
else does.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding
import numba
import numpy as np
from llvmlite import ir
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.extending import intrinsic

from bicycle_env.backends.code_digest import digest
from bicycle_env.backends.compile_cache import ContentCache
from bicycle_env.backends.part import Part, PartCompiler, bind_environments
from bicycle_env.physics import elementary

# The compiler has no licence to round otherwise than the source says: `contract` fuses what suits the processor,
# `reassoc` makes a row depend on its neighbours, `nnan` deletes the NaN checks.
COMMON = {"error_model": "numpy", "fastmath": False, "no_cfunc_wrapper": True}


class CompilerDisabledError(RuntimeError):
    """The user has switched numba's compiler off."""


class LawError(TypeError):
    """A law does what numba cannot compile. ``details``: numba's own words, many lines of them."""

    details: str


PARTS: dict[str, Part] = {}
"""Of this process, by content: numba looks at a law once, however many combinations take it in."""


def inlined(law: Callable[..., Any]) -> Any:
    """A law as a part of a larger compiled function."""
    if isinstance(law, Dispatcher) or numba.config.DISABLE_JIT:  # then entry_point says what is wrong
        return law
    content = digest(law, COMMON)
    if content not in PARTS:
        part: Any = numba.njit(law, forceinline=True, no_cpython_wrapper=True, pipeline_class=PartCompiler, **COMMON)
        part.__class__ = Part
        part.content = content
        PARTS[content] = part
    return PARTS[content]


@inlined
def choose(condition: Any, then: Any, otherwise: Any) -> Any:
    return then if condition else otherwise


@intrinsic  # type: ignore[untyped-decorator]
def multiply_add(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c, rounded once: LLVM's fma. A processor without one takes the mathematics library's: exact, and slow."""
    kind = typing.unify_types(a, b, c)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = context.get_value_type(signature.return_type)
        fused = builder.module.declare_intrinsic("llvm.fma", [number], ir.FunctionType(number, [number] * 3))
        return builder.call(fused, arguments)

    return kind(kind, kind, kind), generate


@inlined
def integer(x: Any) -> Any:
    """A whole float as an integer."""
    return np.int64(x)


@inlined
def _double(i: Any) -> Any:
    return np.float64(i)


def tables(dtype: Any) -> Callable[[tuple[float, ...]], Any]:
    """``table(values)`` of constants of a type."""

    def table(values: tuple[float, ...]) -> Any:
        constants = np.array(values, dtype=dtype)

        def lookup(i: Any) -> Any:
            return constants[i]

        return lookup

    return table


NUMBA: elementary.Namespace = elementary.namespace(
    "numba",
    choose,
    np.floor,
    inlined,
    multiply_add=multiply_add,
    integer=integer,
    real=_double,
    table=tables(np.float64),
    sqrt=np.sqrt,
)


@intrinsic  # type: ignore[untyped-decorator]
def first_bit(_typing: Any, _bits: Any) -> Any:
    """``first_bit(bits) -> int64`` of a uint64: the place of the lowest bit that is set; there must be one."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return numba.int64(numba.uint64), generate


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
    what = f"{digest(function, COMMON)} {signature} {nogil} {interleave} {llvmlite.__version__}"
    content = hashlib.sha256(what.encode()).hexdigest()
    if content in ENTRY_POINTS:
        return ENTRY_POINTS[content]
    # The linker looks for code by name: what is loaded must not be taken for another content's.
    function.__qualname__ = f"{function.__name__}-{content[:20]}"
    dispatcher: Any = numba.njit(function, nogil=nogil, **COMMON)
    dispatcher._cache = ContentCache(function, content)
    with _interleaved(interleave), _without_collecting():
        try:
            dispatcher.compile(signature)
        except NumbaError as error:
            raise _in_one_line(error) from None
    bind_environments(*dispatcher.overloads.values())
    dispatcher.disable_compile()
    ENTRY_POINTS[content] = dispatcher
    return ENTRY_POINTS[content]


@contextlib.contextmanager
def _without_collecting() -> Iterator[None]:
    """The compiler makes millions of objects, and looking for rings among them takes a tenth of its time."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


REMEDIES = {
    r"Untyped global name '(\w+)'.*<class 'function'>": r"Call what xp.function(\1) gives, where the law is made",
    r"Untyped global name '(\w+)'": r"Take the numbers that the law needs from \1 before it, where the law is made",
    r"Unknown attribute '_replace' of type (\w+)": (
        r"bicycle_env.physics.records has it for laws: replaced(xp, \1, names), made where the law is"
    ),
}
"""By what numba says; the first that fits."""


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
    first = reasons[0].rstrip(":") if reasons else type(error).__name__
    reason = " ".join([first, *(line for line in told[:1] if line != first)])
    remedy = next(
        (match.expand(words) for pattern, words in REMEDIES.items() if (match := re.search(pattern, text))),
        "A law may use its arguments, floats, tuples and the functions of xp",
    )
    found = LawError(f"{where}this law cannot be compiled ({reason}). {remedy}")
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
