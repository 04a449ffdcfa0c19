"""The elementary functions that the equations are written in, one namespace per backend.

The equations of motion, the tire laws and the tasks are written once, as functions of a namespace ``xp``. A namespace
holds ``where, floor, minimum, maximum`` of one backend and, built from those alone, ``sin, cos, tan, atan, tanh``.
Every backend evaluates the same polynomials, so plain Python, numba, numpy and torch agree to rounding, and a compiled
loop over many cars vectorises (library calls would stop it: SVML is not in the llvmlite wheel).

All functions are branch-free. The odd ones are computed on ``|x|`` and mirrored, which makes them odd to the bit, and
with them the mirror symmetry of the car. Absolute error for |x| <= 30: at most 3e-15 (tests/physics/test_elementary.py).
The coefficients come from tools/fit_elementary.py.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any, Protocol, TypeVar

import numpy as np

Function = TypeVar("Function", bound=Callable[..., Any])

PI_2 = np.pi / 2
PI_4 = np.pi / 4

# pi/2 in three parts; multiples up to 2^20 of the first two are exact (Cody and Waite's reduction).
PI_2_HIGH = 1.5707963267341256
PI_2_MIDDLE = 6.077100506303966e-11
PI_2_LOW = 2.0222662487959506e-21
# What a double misses of pi/4 and pi/2: sums below keep full precision with it.
PI_4_REST = 3.061616997868383e-17
PI_2_REST = 6.123233995736766e-17

TAN_PI_8 = 0.41421356237309503
TAN_3PI_8 = 2.414213562373095
TANH_IS_ONE = 20.0

SIN = (
    -0.16666666666666666,
    0.008333333333330925,
    -0.00019841269836722418,
    2.755731608381636e-06,
    -2.5051127944014188e-08,
    1.5917848524808262e-10,
)
COS = (
    0.041666666666666664,
    -0.0013888888888887382,
    2.480158729874307e-05,
    -2.7557317260008837e-07,
    2.0876143827993133e-09,
    -1.1382456778061306e-11,
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
    def sin(self, x: Any, /) -> Any: ...
    def cos(self, x: Any, /) -> Any: ...
    def tan(self, x: Any, /) -> Any: ...
    def atan(self, x: Any, /) -> Any: ...
    def tanh(self, x: Any, /) -> Any: ...


def minimum(xp: Any) -> Callable[[Any, Any], Any]:
    def minimum(a: Any, b: Any) -> Any:
        return xp.where(a < b, a, b)

    return minimum


def maximum(xp: Any) -> Callable[[Any, Any], Any]:
    def maximum(a: Any, b: Any) -> Any:
        return xp.where(a > b, a, b)

    return maximum


def sin_cos(xp: Any) -> Callable[[Any], tuple[Any, Any]]:
    """(sin |x|, cos x): the reduction to |r| <= pi/4 is shared."""

    def sin_cos(x: Any) -> tuple[Any, Any]:
        size = abs(x)
        turns = xp.floor(size * (1.0 / PI_2) + 0.5)
        r = ((size - turns * PI_2_HIGH) - turns * PI_2_MIDDLE) - turns * PI_2_LOW
        z = r * r
        s = SIN[4] + z * SIN[5]
        s = SIN[2] + z * (SIN[3] + z * s)
        s = r + r * z * (SIN[0] + z * (SIN[1] + z * s))
        c = COS[4] + z * COS[5]
        c = COS[2] + z * (COS[3] + z * c)
        c = (1.0 - 0.5 * z) + z * z * (COS[0] + z * (COS[1] + z * c))
        quadrant = turns - 4.0 * xp.floor(turns * 0.25)
        odd = (quadrant == 1.0) | (quadrant == 3.0)
        sine = xp.where(odd, c, s)
        cosine = xp.where(odd, s, c)
        sine = xp.where(quadrant >= 2.0, -sine, sine)
        cosine = xp.where((quadrant == 1.0) | (quadrant == 2.0), -cosine, cosine)
        return sine, cosine

    return sin_cos


def sin(xp: Any) -> Callable[[Any], Any]:
    def sin(x: Any) -> Any:
        sine, _ = xp.sin_cos(x)
        return xp.where(x < 0.0, -sine, sine)

    return sin


def cos(xp: Any) -> Callable[[Any], Any]:
    def cos(x: Any) -> Any:
        _, cosine = xp.sin_cos(x)
        return cosine

    return cos


def tan(xp: Any) -> Callable[[Any], Any]:
    def tan(x: Any) -> Any:
        sine, cosine = xp.sin_cos(x)
        tangent = sine / cosine
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
        p = ATAN[8] + z * (ATAN[9] + z * ATAN[10])
        p = ATAN[5] + z * (ATAN[6] + z * (ATAN[7] + z * p))
        p = ATAN[2] + z * (ATAN[3] + z * (ATAN[4] + z * p))
        p = t * z * (ATAN[0] + z * (ATAN[1] + z * p))
        offset = xp.where(steep, PI_2, xp.where(middle, PI_4, 0.0 * t))
        rest = xp.where(steep, PI_2_REST, xp.where(middle, PI_4_REST, 0.0 * t))
        angle = offset + (t + (p + rest))
        return xp.where(x < 0.0, -angle, angle)

    return atan


def tanh(xp: Any) -> Callable[[Any], Any]:
    def tanh(x: Any) -> Any:
        # tanh = (e - 1) / (e + 1) with e = exp 2|x|; expm1 of 2|x|/64 by polynomial, then doubled six times.
        y = xp.where(abs(x) > TANH_IS_ONE, TANH_IS_ONE, abs(x)) * 0.03125
        p = EXPM1[8] + y * (EXPM1[9] + y * EXPM1[10])
        p = EXPM1[5] + y * (EXPM1[6] + y * (EXPM1[7] + y * p))
        p = EXPM1[2] + y * (EXPM1[3] + y * (EXPM1[4] + y * p))
        e = y + y * y * (EXPM1[0] + y * (EXPM1[1] + y * p))
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
    xp.sin_cos = function(sin_cos(xp))
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
