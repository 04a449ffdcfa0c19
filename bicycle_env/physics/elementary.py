"""The elementary functions that the equations are written in, one namespace per backend.

The equations of motion, the tire laws and the tasks are written once, as functions of a namespace ``xp``. A namespace
holds ``where, floor, sqrt, multiply_add`` of one backend and, built from those, ``minimum, maximum, sin, cos, tan,
atan, tanh``.
Every backend evaluates the same polynomials, so plain Python, numba, numpy and torch agree to rounding, and a compiled
loop over many cars vectorises (library calls would stop it: SVML is not in the llvmlite wheel).

All functions are branch-free. The odd ones are computed on ``|x|`` and mirrored, which makes them odd to the bit, and
with them the mirror symmetry of the car. Absolute error for |x| <= 30: at most 3e-15 (a test holds it).
The coefficients come from tools/fit_elementary.py; single precision takes the first few of them. The sums are arranged
in pairs (Estrin) because one car alone waits for each result, and a chain of eleven multiply-adds is a long wait.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import ModuleType
from typing import Any, Protocol, TypeVar

import numpy as np

from bicycle_env.physics.records import written

Function = TypeVar("Function", bound=Callable[..., Any])

PI_2 = np.pi / 2
PI_4 = np.pi / 4
PER_PI = 1.0 / np.pi

# pi in three parts; multiples up to 2^20 of the first two are exact (Cody and Waite's reduction).
PI_HIGH = 3.1415926534682512
PI_MIDDLE = 1.2154201012607932e-10
PI_LOW = 4.044532497591901e-21

TAN_PI_8 = 0.41421356237309503
TAN_3PI_8 = 2.414213562373095
TANH_IS_ONE = 20.0

SIN = (
    -0.16666666666666666,
    0.008333333333333316,
    -0.00019841269841254795,
    2.7557319219115013e-06,
    -2.505210761086116e-08,
    1.6058976915095007e-10,
    -7.643957622560617e-13,
    2.7312868913092307e-15,
)
COS = (
    0.04166666666666666,
    -0.0013888888888884717,
    2.4801587298886815e-05,
    -2.755731856817136e-07,
    2.0876681108263528e-09,
    -1.1466234424282487e-11,
    4.646173408703228e-14,
)
ATAN = (
    -0.3333333333333333,
    0.19999999999995438,
    -0.14285714284649173,
    0.11111111013860688,
    -0.0909090452147169,
    0.07692181876036845,
    -0.06664492945806264,
    0.05857988350245762,
    -0.05084610357631765,
    0.03920743321261196,
    -0.019147248964611764,
)
EXPM1 = (
    0.5,
    0.16666666666666646,
    0.041666666666680466,
    0.008333333332989508,
    0.0013888888932781025,
    0.00019841266576799442,
    2.4801738388725833e-05,
    2.7552840872626277e-06,
    2.764219243074507e-07,
    2.406249149773821e-08,
    2.7248380161150616e-09,
)


class Namespace(Protocol):
    """What a law may use. Arguments are scalars of the scalar backends and arrays of the others, of any float type."""

    def function(self, function: Function, /) -> Function:
        """Bind a law to the backend: compiles it under numba, leaves it alone elsewhere."""

    def where(self, condition: Any, then: Any, otherwise: Any, /) -> Any:
        """Elementwise choice; both sides are evaluated."""

    def multiply_add(self, a: Any, b: Any, c: Any, /) -> Any:
        """a b + c. Compiled: rounded once, on every processor, and nothing else is: the source decides the bits."""

    def minimum(self, a: Any, b: Any, /) -> Any: ...
    def maximum(self, a: Any, b: Any, /) -> Any: ...
    def floor(self, x: Any, /) -> Any: ...
    def sqrt(self, x: Any, /) -> Any:
        """Rounded correctly, the same bits on every processor; torch's own may miss the last bit. NaN below 0."""

    def integer(self, x: Any, /) -> Any:
        """A whole float as an integer of 64 bits, on which + & | ^ << >> are what they are in Python."""

    def real(self, i: Any, /) -> Any:
        """An integer as a float."""

    def table(self, values: tuple[float, ...], /) -> Callable[[Any], Any]:
        """``lookup(i) -> values[i]`` for an integer of :meth:`integer` in the table; the values are constants."""

    def near_sin(self, r: Any, /) -> Any:
        """sin r for |r| <= pi/2, without the reduction."""

    def near_cos(self, r: Any, /) -> Any:
        """cos r for |r| <= pi/2, without the reduction."""

    def sin(self, x: Any, /) -> Any: ...
    def cos(self, x: Any, /) -> Any: ...
    def tan(self, x: Any, /) -> Any: ...
    def atan(self, x: Any, /) -> Any: ...
    def tanh(self, x: Any, /) -> Any: ...


def multiply_add(a: Any, b: Any, c: Any) -> Any:
    """a b + c, rounded twice."""
    return a * b + c


def minimum(xp: Any) -> Callable[[Any, Any], Any]:
    def minimum(a: Any, b: Any) -> Any:
        return xp.where(a > b, b, a)  # a NaN in a stays

    return minimum


def maximum(xp: Any) -> Callable[[Any, Any], Any]:
    def maximum(a: Any, b: Any) -> Any:
        return xp.where(a < b, b, a)  # a NaN in a stays

    return maximum


def half_turns(xp: Any) -> Callable[[Any], tuple[Any, Any]]:
    """``(n, r)`` with |x| = n pi + r, n whole and |r| <= pi/2."""

    def half_turns(x: Any) -> tuple[Any, Any]:
        size = abs(x)
        n = xp.floor(xp.multiply_add(size, PER_PI, 0.5))
        return n, xp.multiply_add(n, -PI_LOW, xp.multiply_add(n, -PI_MIDDLE, xp.multiply_add(n, -PI_HIGH, size)))

    return half_turns


def sign_of(xp: Any) -> Callable[[Any], Any]:
    """(-1)^n, the sign of sine and cosine after n half turns."""

    def sign_of(n: Any) -> Any:
        return xp.multiply_add(-2.0, xp.multiply_add(-2.0, xp.floor(0.5 * n), n), 1.0)

    return sign_of


def polynomial(xp: Any, coefficients: tuple[float, ...]) -> Callable[[Any], Any]:
    """``c0 + c1 z + c2 z^2 + ...``, in groups of four terms whose parts do not wait for each other (Estrin)."""
    names = tuple(f"c{k}" for k in range(len(coefficients)))
    body = f"z2 = z * z\n    return {_estrin(names)}"
    found: Callable[[Any], Any] = written(
        "polynomial", "z", body, multiply_add=xp.multiply_add, **dict(zip(names, coefficients, strict=True))
    )
    return found


def _estrin(names: tuple[str, ...]) -> str:
    """The sum as an expression of ``z`` and ``z2``."""
    if len(names) > 4:
        return f"multiply_add(z2 * z2, {_estrin(names[4:])}, {_estrin(names[:4])})"
    pairs = [names[k : k + 2] for k in range(0, len(names), 2)]
    first, *rest = [f"multiply_add(z, {pair[1]}, {pair[0]})" if len(pair) == 2 else pair[0] for pair in pairs]
    return f"multiply_add(z2, {rest[0]}, {first})" if rest else first


def needed(coefficients: tuple[float, ...], largest: float, rounding: float) -> tuple[float, ...]:
    """The first terms of a polynomial p; z p(z), |z| <= `largest`, stands beside 1, and the rest is rounding."""
    left_out = 0.0
    for power in reversed(range(len(coefficients))):
        left_out += abs(coefficients[power]) * largest ** (power + 1)
        if left_out > rounding:
            return coefficients[: power + 1]
    return coefficients[:1]


def near_sin(xp: Any) -> Callable[[Any], Any]:
    """sin r for |r| <= pi/2."""
    p = xp.function(polynomial(xp, needed(SIN, PI_2 * PI_2, xp.rounding)))

    def near_sin(r: Any) -> Any:
        z = r * r
        return xp.multiply_add(r * z, p(z), r)

    return near_sin


def near_cos(xp: Any) -> Callable[[Any], Any]:
    """cos r for |r| <= pi/2."""
    p = xp.function(polynomial(xp, needed((-0.5, *COS), PI_2 * PI_2, xp.rounding)[1:]))

    def near_cos(r: Any) -> Any:
        z = r * r
        return xp.multiply_add(z * z, p(z), xp.multiply_add(-0.5, z, 1.0))

    return near_cos


def sin(xp: Any) -> Callable[[Any], Any]:
    def sin(x: Any) -> Any:
        n, r = xp.half_turns(x)
        sine = xp.sign_of(n) * xp.near_sin(r)
        return xp.where(x < 0.0, -sine, sine)

    return sin


def cos(xp: Any) -> Callable[[Any], Any]:
    def cos(x: Any) -> Any:
        n, r = xp.half_turns(x)
        return xp.sign_of(n) * xp.near_cos(r)

    return cos


def tan(xp: Any) -> Callable[[Any], Any]:
    """The relative error grows as 1/|cos x|."""

    def tan(x: Any) -> Any:
        _, r = xp.half_turns(x)  # the signs cancel
        tangent = xp.near_sin(r) / xp.near_cos(r)
        return xp.where(x < 0.0, -tangent, tangent)

    return tan


def atan(xp: Any) -> Callable[[Any], Any]:
    p = xp.function(polynomial(xp, needed(ATAN, TAN_PI_8 * TAN_PI_8, xp.rounding)))

    def atan(x: Any) -> Any:
        size = abs(x)
        middle = size > TAN_PI_8
        steep = size > TAN_3PI_8
        # atan s = pi/4 + atan((s-1)/(s+1)) = pi/2 - atan(1/s): one division serves all three ranges.
        above = xp.where(steep, -1.0, xp.where(middle, size - 1.0, size))
        below = xp.where(steep, size, xp.where(middle, size + 1.0, 1.0))
        t = above / below
        z = t * t
        offset = xp.where(steep, PI_2, xp.where(middle, PI_4, 0.0 * t))
        angle = offset + xp.multiply_add(t * z, p(z), t)
        return xp.where(x < 0.0, -angle, angle)

    return atan


def tanh(xp: Any) -> Callable[[Any], Any]:
    p = xp.function(polynomial(xp, needed(EXPM1, TANH_IS_ONE / 32.0, xp.rounding)))

    def tanh(x: Any) -> Any:
        # tanh = (e - 1) / (e + 1) with e = exp 2|x|; expm1 of 2|x|/64 by polynomial, then doubled six times.
        y = xp.where(abs(x) > TANH_IS_ONE, TANH_IS_ONE, abs(x)) * 0.03125
        e = xp.multiply_add(y * y, p(y), y)
        e = e * (e + 2.0)
        e = e * (e + 2.0)
        e = e * (e + 2.0)
        e = e * (e + 2.0)
        e = e * (e + 2.0)
        e = e * (e + 2.0)
        value = e / (e + 2.0)
        return xp.where(x < 0.0, -value, value)

    return tanh


def _table(values: tuple[float, ...]) -> Callable[[Any], Any]:
    def lookup(i: Any) -> Any:
        return values[i]

    return lookup


def _sqrt(x: Any) -> Any:
    with np.errstate(invalid="ignore"):  # of the side of a choice that is not taken
        return np.sqrt(x)


def namespace(
    name: str,
    where: Callable[..., Any],
    floor: Callable[..., Any],
    function: Callable[[Any], Any] = lambda law: law,
    rounding: float = 2.0**-53,
    multiply_add: Callable[..., Any] = multiply_add,
    integer: Callable[..., Any] = int,
    real: Callable[..., Any] = float,
    table: Callable[[tuple[float, ...]], Any] = _table,
    sqrt: Callable[..., Any] = _sqrt,
) -> Any:
    """Build a :class:`Namespace` from a backend's elementwise choice and floor; `rounding`: the relative one.

    It is a module object because numba reads attributes of modules, and of nothing else, while it compiles.
    """
    xp: Any = ModuleType(f"{__name__}.{name}")
    xp.function, xp.rounding = function, rounding
    xp.where = where
    xp.floor, xp.sqrt = floor, sqrt
    xp.multiply_add = multiply_add
    xp.integer, xp.real = integer, real
    xp.table = lambda values: function(table(values))
    xp.minimum = function(minimum(xp))
    xp.maximum = function(maximum(xp))
    xp.half_turns = function(half_turns(xp))
    xp.sign_of = function(sign_of(xp))
    xp.near_sin = function(near_sin(xp))
    xp.near_cos = function(near_cos(xp))
    xp.sin = function(sin(xp))
    xp.cos = function(cos(xp))
    xp.tan = function(tan(xp))
    xp.atan = function(atan(xp))
    xp.tanh = function(tanh(xp))
    return xp


def array_namespace(module: Any, dtype: Any = None) -> Namespace:
    """The namespace of an array library: numpy, torch, or one with the same ``where``, ``floor`` and ``asarray``.

    `dtype`: of the floats that integers become, and two constants of a choice; by default the module's float64.
    """
    kind = module.float64 if dtype is None else dtype

    def where(condition: Any, then: Any, otherwise: Any) -> Any:
        if module is not np and isinstance(then, float) and isinstance(otherwise, float):
            then = module.full((), then, dtype=kind, device=condition.device)  # torch's own choice is float32
        return module.where(condition, then, otherwise)

    def integer(x: Any) -> Any:
        return module.asarray(x, dtype=module.int64)

    def real(i: Any) -> Any:
        return module.asarray(i, dtype=kind)

    def table(values: tuple[float, ...]) -> Any:
        @functools.cache
        def on(**device: Any) -> Any:
            return module.asarray(values, dtype=kind, **device)

        def lookup(i: Any) -> Any:
            return (on() if module is np else on(device=i.device))[i]

        return lookup

    own: dict[str, Any] = {
        "integer": integer,
        "real": real,
        "table": table,
        "sqrt": _sqrt if module is np else module.sqrt,
    }
    xp: Namespace = namespace(module.__name__, where, module.floor, **own)
    return xp


def _choose(condition: Any, then: Any, otherwise: Any) -> Any:
    return then if condition else otherwise


PYTHON: Namespace = namespace("python", _choose, np.floor)
NUMPY: Namespace = array_namespace(np)
