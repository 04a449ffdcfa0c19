"""Random numbers as a pure function of a key and a counter: the same in every backend, in any order, again and again.

Threefry-2x32 with 20 rounds (J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, Parallel random numbers: as easy as
1, 2, 3, SC 2011), on whole numbers below 2^32 that are kept in 64 bits. A key stands in four columns of 16 bits, which
single precision holds exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bicycle_env.physics.elementary import polynomial

MASK = 0xFFFFFFFF
PARITY = 0x1BD11BDA
KEY_COLUMNS = 4
COLUMN = 65536.0
"""A column of the key is below it."""
NORMAL = (
    1.6699198897313938,
    0.010881679914704078,
    0.14781370731642057,
    -0.17304713614308798,
    0.09982186093987072,
    -0.02645922169807863,
    0.0027648651094941876,
)
"""Of the odd powers of s, the sum of four uniform numbers less 2, that make it normal: Phi^-1(F(s)), F the distribution
of s (Irwin and Hall), by least squares weighted with its density. Variance 1 to 2e-6, kurtosis 3 to 1e-4, distribution
function to 3e-5, no number beyond 5.6."""

QUANTILE = (
    (6.981938006e-09, 4.582936143e-05, 0.02135354699, 0.9595183214, 4.392820219, 1.252214572),
    (7.933422475e-10, 6.244986427e-06, 0.003538013384, 0.2073680147, 1.431942403, 1.0),
)
"""Two polynomials in v = 4 p (1 - p), whose ratio is Phi^-1(p) / (p - 1/2) within `MOST_DEVIATIONS`: right to 2e-5 in
p, to 6e-4 in the deviation, by least squares weighted with the density. No coefficient is negative: nothing cancels."""
MOST_DEVIATIONS = 4.0


def threefry(xp: Any) -> Callable[..., Any]:
    """``threefry(key_0, key_1, counter_0, counter_1) -> (bits, bits)``, all whole numbers below 2^32."""

    def turned(x: Any, by: int) -> Any:
        return ((x << by) | (x >> (32 - by))) & MASK

    turn = xp.function(turned)

    def four_rounds(a: Any, b: Any, r0: int, r1: int, r2: int, r3: int) -> tuple[Any, Any]:
        a = (a + b) & MASK
        b = turn(b, r0) ^ a
        a = (a + b) & MASK
        b = turn(b, r1) ^ a
        a = (a + b) & MASK
        b = turn(b, r2) ^ a
        a = (a + b) & MASK
        b = turn(b, r3) ^ a
        return a, b

    rounds = xp.function(four_rounds)

    def threefry(key_0: Any, key_1: Any, counter_0: Any, counter_1: Any) -> tuple[Any, Any]:
        key_2 = key_0 ^ key_1 ^ PARITY
        a, b = rounds((counter_0 + key_0) & MASK, (counter_1 + key_1) & MASK, 13, 15, 26, 6)
        a, b = rounds((a + key_1) & MASK, (b + key_2 + 1) & MASK, 17, 29, 16, 24)
        a, b = rounds((a + key_2) & MASK, (b + key_0 + 2) & MASK, 13, 15, 26, 6)
        a, b = rounds((a + key_0) & MASK, (b + key_1 + 3) & MASK, 17, 29, 16, 24)
        a, b = rounds((a + key_1) & MASK, (b + key_2 + 4) & MASK, 13, 15, 26, 6)
        return (a + key_2) & MASK, (b + key_0 + 5) & MASK

    return threefry


def random_bits(xp: Any) -> Callable[..., Any]:
    """``random_bits(key, step, channel) -> (bits, bits)``: four columns, a whole float, a whole number."""
    cipher = xp.function(threefry(xp))

    def random_bits(key: tuple[Any, Any, Any, Any], step: Any, channel: int) -> tuple[Any, Any]:
        low = xp.integer(key[0]) | (xp.integer(key[1]) << 16)
        high = xp.integer(key[2]) | (xp.integer(key[3]) << 16)
        bits: tuple[Any, Any] = cipher(low, high, xp.integer(step), xp.integer(0.0 * step) + channel)
        return bits

    return random_bits


def normal(xp: Any) -> Callable[..., Any]:
    """``normal(key, step, channel)``: a number of the standard normal distribution."""
    bits = xp.function(random_bits(xp))
    c0, c1, c2, c3, c4, c5, c6 = NORMAL

    def normal(key: tuple[Any, Any, Any, Any], step: Any, channel: int) -> Any:
        a, b = bits(key, step, channel)
        # Four uniform numbers of 16 bits, (h + 1/2) / 65536; their sum less 2, exact in single precision, too.
        total = xp.real((a & 65535) + (a >> 16) + (b & 65535) + (b >> 16))
        s = (total - 131070.0) / COLUMN
        z = s * s
        low = xp.multiply_add(z, xp.multiply_add(z, c2, c1), c0)
        high = xp.multiply_add(z, xp.multiply_add(z, xp.multiply_add(z, c6, c5), c4), c3)
        return s * xp.multiply_add(z * z * z, high, low)

    return normal


def normal_quantile(xp: Any) -> Callable[[Any], Any]:
    """``normal_quantile(p)``: below which the share p of the standard normal distribution lies."""
    above, below = (xp.function(polynomial(xp, coefficients)) for coefficients in QUANTILE)

    def normal_quantile(p: Any) -> Any:
        v = 4.0 * p * (1.0 - p)
        return (p - 0.5) * (above(v) / below(v))

    return normal_quantile
