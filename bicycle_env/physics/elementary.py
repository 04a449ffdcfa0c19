"""The elementary functions that the equations are written in, one namespace per backend.

The equations of motion, the tire laws and the tasks are written once, as functions of a namespace ``xp``. A namespace
holds ``where, floor, minimum, maximum`` of one backend and, built from those alone, ``sin, cos, tan, atan, tanh``.
Every backend evaluates the same polynomials, so plain Python, numba, numpy and torch agree to rounding, and a compiled
loop over many cars vectorises (library calls would stop it: SVML is not in the llvmlite wheel).

All functions are branch-free. The odd ones are computed on ``|x|`` and mirrored, which makes them odd to the bit, and
with them the mirror symmetry of the car. Absolute error for |x| <= 30: at most 3e-15 (a test holds it).
The coefficients come from tools/fit_elementary.py; the sums are arranged in pairs (Estrin) because one car alone waits
for each result, and a chain of eleven multiply-adds is a long wait.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any, Protocol, TypeVar

import numpy as np

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
        """Elementwise choice; both sides are evaluated. At least one side must not be a bare constant."""

    def minimum(self, a: Any, b: Any, /) -> Any: ...
    def maximum(self, a: Any, b: Any, /) -> Any: ...
    def floor(self, x: Any, /) -> Any: ...
    def near_sin(self, r: Any, /) -> Any:
        """sin r for |r| <= pi/2, without the reduction."""

    def near_cos(self, r: Any, /) -> Any:
        """cos r for |r| <= pi/2, without the reduction."""

    def sin(self, x: Any, /) -> Any: ...
    def cos(self, x: Any, /) -> Any: ...
    def tan(self, x: Any, /) -> Any: ...
    def atan(self, x: Any, /) -> Any: ...
    def tanh(self, x: Any, /) -> Any: ...


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
        n = xp.floor(size * PER_PI + 0.5)
        return n, ((size - n * PI_HIGH) - n * PI_MIDDLE) - n * PI_LOW

    return half_turns


def sign_of(xp: Any) -> Callable[[Any], Any]:
    """(-1)^n, the sign of sine and cosine after n half turns."""

    def sign_of(n: Any) -> Any:
        return 1.0 - 2.0 * (n - 2.0 * xp.floor(0.5 * n))

    return sign_of


def near_sin(_: Any) -> Callable[[Any], Any]:
    """sin r for |r| <= pi/2."""

    def near_sin(r: Any) -> Any:
        z = r * r
        z2 = z * z
        low = (SIN[0] + z * SIN[1]) + z2 * (SIN[2] + z * SIN[3])
        high = (SIN[4] + z * SIN[5]) + z2 * (SIN[6] + z * SIN[7])
        return r + (r * z) * (low + (z2 * z2) * high)

    return near_sin


def near_cos(_: Any) -> Callable[[Any], Any]:
    """cos r for |r| <= pi/2."""

    def near_cos(r: Any) -> Any:
        z = r * r
        z2 = z * z
        low = (COS[0] + z * COS[1]) + z2 * (COS[2] + z * COS[3])
        high = (COS[4] + z * COS[5]) + z2 * COS[6]
        return (1.0 - 0.5 * z) + z2 * (low + (z2 * z2) * high)

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
    def atan(x: Any) -> Any:
        size = abs(x)
        middle = size > TAN_PI_8
        steep = size > TAN_3PI_8
        # atan s = pi/4 + atan((s-1)/(s+1)) = pi/2 - atan(1/s): one division serves all three ranges.
        above = xp.where(steep, -1.0, xp.where(middle, size - 1.0, size))
        below = xp.where(steep, size, xp.where(middle, size + 1.0, 1.0))
        t = above / below
        z = t * t
        z2 = z * z
        z4 = z2 * z2
        low = (ATAN[0] + z * ATAN[1]) + z2 * (ATAN[2] + z * ATAN[3])
        middle_part = (ATAN[4] + z * ATAN[5]) + z2 * (ATAN[6] + z * ATAN[7])
        high = (ATAN[8] + z * ATAN[9]) + z2 * ATAN[10]
        p = (t * z) * (low + z4 * (middle_part + z4 * high))
        offset = xp.where(steep, PI_2, xp.where(middle, PI_4, 0.0 * t))
        angle = offset + (t + p)
        return xp.where(x < 0.0, -angle, angle)

    return atan


def tanh(xp: Any) -> Callable[[Any], Any]:
    def tanh(x: Any) -> Any:
        # tanh = (e - 1) / (e + 1) with e = exp 2|x|; expm1 of 2|x|/64 by polynomial, then doubled six times.
        y = xp.where(abs(x) > TANH_IS_ONE, TANH_IS_ONE, abs(x)) * 0.03125
        y2 = y * y
        y4 = y2 * y2
        low = (EXPM1[0] + y * EXPM1[1]) + y2 * (EXPM1[2] + y * EXPM1[3])
        middle = (EXPM1[4] + y * EXPM1[5]) + y2 * (EXPM1[6] + y * EXPM1[7])
        high = (EXPM1[8] + y * EXPM1[9]) + y2 * EXPM1[10]
        e = y + y2 * (low + y4 * (middle + y4 * high))
        e = e * (e + 2.0)
        e = e * (e + 2.0)
        e = e * (e + 2.0)
        e = e * (e + 2.0)
        e = e * (e + 2.0)
        e = e * (e + 2.0)
        value = e / (e + 2.0)
        return xp.where(x < 0.0, -value, value)

    return tanh


def namespace(
    name: str,
    where: Callable[..., Any],
    floor: Callable[..., Any],
    function: Callable[[Any], Any] = lambda law: law,
) -> Any:
    """Build a :class:`Namespace` from a backend's elementwise choice and floor.

    It is a module object because numba reads attributes of modules, and of nothing else, while it compiles.
    """
    xp: Any = ModuleType(f"{__name__}.{name}")
    xp.function = function
    xp.where = where
    xp.floor = floor
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


def array_namespace(module: Any) -> Namespace:
    """The namespace of an array library: numpy, torch, or one with the same ``where`` and ``floor``."""
    xp: Namespace = namespace(module.__name__, module.where, module.floor)
    return xp


def _choose(condition: Any, then: Any, otherwise: Any) -> Any:
    return then if condition else otherwise


PYTHON: Namespace = namespace("python", _choose, np.floor)
NUMPY: Namespace = array_namespace(np)
