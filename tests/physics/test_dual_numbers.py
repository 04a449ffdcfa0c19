"""Derivatives by dual numbers against derivatives by hand."""

import numpy as np
import pytest

from bicycle_env import tires
from bicycle_env.physics.dual_numbers import Dual, dual_namespace, lifted
from bicycle_env.physics.elementary import NUMPY, PYTHON

ON_ARRAYS, ON_FLOATS = dual_namespace(NUMPY), dual_namespace(PYTHON)
STIFFNESS, PEAK = 1e5, 7e3


def test_arithmetic_by_hand():
    x, y = Dual(3.0, 1.0), Dual(2.0, 10.0)
    results = {
        "x + y": (x + y, 5.0, 11.0),
        "x - y": (x - y, 1.0, -9.0),
        "x y": (x * y, 6.0, 32.0),  # 1 * 2 + 3 * 10
        "x / y": (x / y, 1.5, -7.0),  # (1 * 2 - 3 * 10) / 4
        "-x": (-x, -3.0, -1.0),
        "1 - x": (1.0 - x, -2.0, -1.0),
        "x - 1": (x - 1.0, 2.0, 1.0),
        "1 + x": (1.0 + x, 4.0, 1.0),
        "2 x": (2.0 * x, 6.0, 2.0),
        "x 2": (x * 2.0, 6.0, 2.0),
        "6 / x": (6.0 / x, 2.0, -2.0 / 3.0),
        "x / 2": (x / 2.0, 1.5, 0.5),
        "x^3": (x**3, 27.0, 27.0),
        "|-x|": (abs(-x), 3.0, 1.0),
    }
    for name, (result, value, slope) in results.items():
        assert (result.value, result.slope) == pytest.approx((value, slope), rel=1e-15), name
    assert lifted(4.0).slope == 0.0
    assert lifted(x) is x
    assert "Dual(3.0, 1.0)" in repr(x)


def test_an_array_leaves_the_multiplication_to_the_dual_number():
    product = np.array([1.0, 2.0]) * Dual(np.array([3.0, 4.0]), np.array([1.0, 1.0]))
    assert isinstance(product, Dual)
    np.testing.assert_array_equal(product.value, [3.0, 8.0])
    np.testing.assert_array_equal(product.slope, [1.0, 2.0])


def test_a_comparison_asks_for_the_slope_where_the_values_are_equal():
    """x + e > x for a small positive e."""
    assert Dual(0.0, 1.0) > 0.0
    assert not Dual(0.0, 1.0) < 0.0
    assert Dual(0.0, -1.0) < 0.0
    assert not Dual(0.0, 0.0) > 0.0
    assert Dual(0.0, 0.0) >= 0.0
    assert Dual(0.0, 0.0) <= 0.0
    assert not Dual(0.0, 1.0) <= 0.0
    assert not Dual(0.0, -1.0) >= 0.0
    assert Dual(-1.0, 9.0) <= 0.0
    assert Dual(1.0, 5.0) > Dual(1.0, 4.0)
    assert abs(Dual(0.0, -2.0)).slope == 2.0


@pytest.mark.parametrize(
    ("name", "derivative"),
    [
        ("sin", np.cos),
        ("cos", lambda x: -np.sin(x)),
        ("tan", lambda x: 1.0 + np.tan(x) ** 2),
        ("atan", lambda x: 1.0 / (1.0 + x * x)),
        ("tanh", lambda x: 1.0 / np.cosh(x) ** 2),
        ("near_sin", np.cos),
        ("near_cos", lambda x: -np.sin(x)),
        ("sqrt", lambda x: 0.5 / np.sqrt(x)),
    ],
)
def test_elementary_functions(name, derivative):
    x = np.linspace(-1.4, 1.4, 20_001) if "near" in name or name == "tan" else np.linspace(-6.0, 6.0, 20_001)
    x = abs(x) + 0.1 if name == "sqrt" else x
    result = getattr(ON_ARRAYS, name)(Dual(x, np.ones_like(x)))
    np.testing.assert_allclose(result.slope, derivative(x), rtol=2e-13, atol=1e-14)
    np.testing.assert_array_equal(result.value, getattr(NUMPY, name)(x))


def slope_of(law, slip, xp=ON_ARRAYS):
    return law.law(xp)(Dual(slip, 1.0 + 0.0 * slip), STIFFNESS, PEAK).slope


def test_slopes_of_the_tire_laws():
    slip = np.linspace(-0.6, 0.6, 4001)
    x, z = STIFFNESS * slip / PEAK, STIFFNESS * np.tan(np.abs(slip)) / (3.0 * PEAK)
    by_hand = {
        tires.Linear(): -STIFFNESS * np.ones_like(slip),
        tires.Tanh(): -STIFFNESS / np.cosh(x) ** 2,
        tires.Fiala(): np.where(z < 1.0, -STIFFNESS * (1.0 - z) ** 2 / np.cos(slip) ** 2, 0.0),
    }
    for law, expected in by_hand.items():
        np.testing.assert_allclose(slope_of(law, slip), expected, rtol=0.0, atol=1e-14 * STIFFNESS)
    step = 1e-5
    for name, law in tires.LAWS.items():
        force = law().law(NUMPY)
        difference = (force(slip + step, STIFFNESS, PEAK) - force(slip - step, STIFFNESS, PEAK)) / (2.0 * step)
        # Fiala's slope has a kink at zero slip: half a step off there
        np.testing.assert_allclose(slope_of(law(), slip), difference, atol=2e-4 * STIFFNESS, err_msg=name)


@pytest.mark.parametrize("law", tires.LAWS.values())
def test_the_slope_at_zero_slip_is_the_stiffness_from_either_side(law):
    for zero in (0.0, -0.0):
        for side in (1.0, -1.0):
            for xp, slip in ((ON_ARRAYS, np.array([zero])), (ON_FLOATS, zero)):
                assert law().law(xp)(Dual(slip, side), STIFFNESS, PEAK).slope == pytest.approx(-side * STIFFNESS)


@pytest.mark.parametrize("law", tires.LAWS.values())
def test_floats_and_arrays_agree_to_the_bit(law):
    slips = np.linspace(-0.5, 0.5, 41)
    assert [slope_of(law(), slip, ON_FLOATS) for slip in slips.tolist()] == list(slope_of(law(), slips) + 0.0 * slips)
