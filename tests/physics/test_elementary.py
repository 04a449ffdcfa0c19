"""The package's own sin, cos, tan, atan and tanh: accuracy, symmetry, NaN, and agreement of the backends."""

import functools
import math

import mpmath
import numba
import numpy as np
import pytest
import torch

from bicycle_env.backends import compiled, single_precision
from bicycle_env.physics import elementary
from bicycle_env.physics.elementary import NUMPY, PYTHON

TORCH = elementary.array_namespace(torch)
ALL = ("sin", "cos", "tan", "atan", "tanh")
ODD = ("sin", "tan", "atan", "tanh")


def arguments(largest, count=4000):
    """Uniform, geometric, and next to every place where a function changes its formula."""
    rng = np.random.default_rng(7)
    seams = np.concatenate(
        [
            np.arange(20) * np.pi / 2,
            [elementary.TAN_PI_8, elementary.TAN_3PI_8, elementary.TANH_IS_ONE, 1.0, 0.0, 5e-324, 1e-300],
        ]
    )
    near = np.concatenate([seams, np.nextafter(seams, -np.inf), np.nextafter(seams, np.inf), seams + 1e-9])
    points = np.concatenate([rng.uniform(0.0, largest, count), 10.0 ** rng.uniform(-12.0, np.log10(largest), count)])
    return np.concatenate([points, near[(near >= 0.0) & (near <= largest)]])


def exact(name, x):
    with mpmath.workdps(40):
        return [getattr(mpmath, name)(mpmath.mpf(float(value))) for value in x]


@functools.cache
def errors_up_to(name, largest):
    return errors(name, arguments(largest))


def errors(name, x):
    """Absolute errors, and errors in units in the last place of the exact value."""
    with mpmath.workdps(40):
        truth = exact(name, x)
        absolute = [abs(mpmath.mpf(float(y)) - t) for y, t in zip(getattr(NUMPY, name)(x), truth, strict=True)]
        ulps = [float(e / np.spacing(abs(float(t)))) for e, t in zip(absolute, truth, strict=True) if t != 0]
        return np.array(absolute, dtype=float), np.array(ulps)


@pytest.fixture(scope="module")
def on_numba():
    """``on_numba(name, x)``: the compiled function on an array."""

    def bind(name):
        law = getattr(compiled.NUMBA, name)

        def apply(x, out):
            for k in range(len(x)):
                out[k] = law(x[k])

        return compiled.entry_point(apply, numba.void(numba.float64[::1], numba.float64[::1]))

    functions = {name: bind(name) for name in ALL}

    def on_numba(name, x):
        out = np.empty_like(x)
        functions[name](x, out)
        return out

    return on_numba


@pytest.mark.parametrize("name", ["sin", "cos", "atan", "tanh"])
def test_absolute_error_up_to_30(name):
    absolute, _ = errors_up_to(name, 30.0)
    assert absolute.max() <= 3e-15


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_the_reduction_holds_for_many_turns(name):
    x = np.concatenate([np.random.default_rng(1).uniform(30.0, 1e6, 2000), np.arange(1, 3000) * 97 * np.pi])
    absolute, _ = errors(name, x)
    assert absolute.max() <= 4e-16


# Measured over these arguments; 0.5 would be perfect rounding.
@pytest.mark.parametrize(
    ("name", "largest", "bound"),
    [
        ("sin", np.pi / 4, 1.0),
        ("cos", np.pi / 4, 1.5),
        ("tan", np.pi / 4, 2.75),
        ("atan", 30.0, 2.5),
        ("tanh", 30.0, 6.0),
    ],
)
def test_error_in_units_of_the_last_place(name, largest, bound):
    _, ulps = errors_up_to(name, largest)
    assert ulps.max() <= bound


def test_tan_loses_accuracy_as_the_cosine_vanishes_and_no_faster():
    x = arguments(1.57)
    absolute, _ = errors("tan", x)
    relative = absolute / np.maximum(np.abs(np.tan(x)), 1e-300)
    assert np.all((relative * np.cos(x))[x > 1e-300] <= 1e-15)


@pytest.mark.parametrize("name", ["near_sin", "near_cos"])
def test_without_reduction_up_to_a_quarter_turn(name):
    x = np.linspace(0.0, np.pi / 2, 5001)
    assert np.max(np.abs(getattr(NUMPY, name)(x) - getattr(np, name.removeprefix("near_"))(x))) <= 1e-15
    assert np.array_equal(getattr(NUMPY, name)(-x), getattr(NUMPY, name)(x) * (-1.0 if name == "near_sin" else 1.0))


@pytest.mark.parametrize("name", ALL)
def test_agrees_with_numpy_over_a_wide_range(name):
    x = np.random.default_rng(3).uniform(-30.0, 30.0, 20000)
    if name == "tan":
        x = x[np.abs(np.cos(x)) > 0.1]
    reference = getattr(np, {"atan": "arctan"}.get(name, name))(x)
    assert np.max(np.abs(getattr(NUMPY, name)(x) - reference) / np.maximum(1.0, np.abs(reference) ** 2)) <= 4e-15


@pytest.mark.parametrize("namespace", [NUMPY, PYTHON, TORCH, compiled.NUMBA], ids=lambda xp: xp.__name__.split(".")[-1])
@pytest.mark.parametrize("name", ALL)
def test_symmetry_to_the_bit(name, namespace, on_numba):
    x = arguments(1000.0, 1000)
    if namespace is compiled.NUMBA:
        right, left = on_numba(name, x), on_numba(name, -x)
    elif namespace is TORCH:
        right, left = (getattr(TORCH, name)(torch.from_numpy(z)).numpy() for z in (x, -x))
    elif namespace is PYTHON:
        right, left = (np.array([getattr(PYTHON, name)(float(v)) for v in z]) for z in (x, -x))
    else:
        right, left = (getattr(NUMPY, name)(z) for z in (x, -x))
    assert np.all(np.isfinite(right))
    assert np.array_equal(left, -right if name in ODD else right)


@pytest.mark.parametrize("name", ALL)
def test_nan_in_gives_nan(name, on_numba):
    nan = np.array([math.nan])
    assert math.isnan(getattr(PYTHON, name)(math.nan))
    assert np.isnan(getattr(NUMPY, name)(nan)).all()
    assert torch.isnan(getattr(TORCH, name)(torch.from_numpy(nan))).all()
    assert np.isnan(on_numba(name, nan)).all()


def test_limits_at_infinity():
    infinities = np.array([np.inf, -np.inf])
    np.testing.assert_array_equal(NUMPY.tanh(infinities), [1.0, -1.0])
    np.testing.assert_array_equal(NUMPY.atan(infinities), [np.pi / 2, -np.pi / 2])


@pytest.mark.parametrize("name", ALL)
def test_backends_agree(name, on_numba):
    x = np.random.default_rng(11).uniform(-30.0, 30.0, 3000)
    if name == "tan":
        x = x[np.abs(np.cos(x)) > 0.1]
    on_numpy = getattr(NUMPY, name)(x)
    scalars = np.array([getattr(PYTHON, name)(float(value)) for value in x])
    tensors = getattr(TORCH, name)(torch.from_numpy(x)).numpy()
    assert np.array_equal(scalars, on_numpy)
    tolerance = 4e-15 * np.maximum(1.0, on_numpy**2)  # numba and torch may contract a*b+c into one rounding
    assert np.all(np.abs(on_numba(name, x) - on_numpy) <= tolerance)
    assert np.all(np.abs(tensors - on_numpy) <= tolerance)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=str)
@pytest.mark.parametrize("shape", [(), (1,), (5,), (2, 3)], ids=str)
@pytest.mark.parametrize("name", [*ALL, "near_sin", "near_cos", "floor"])
def test_torch_keeps_type_and_shape(name, shape, dtype):
    x = torch.linspace(-2.5, 2.5, math.prod(shape), dtype=dtype).reshape(shape)
    y = getattr(TORCH, name)(x)
    assert y.dtype == dtype
    assert y.shape == x.shape


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", ALL)
def test_numpy_keeps_type(name, dtype):
    x = np.linspace(-2.5, 2.5, 7).astype(dtype)
    assert getattr(NUMPY, name)(x).dtype == dtype


@pytest.mark.parametrize("name", ["minimum", "maximum"])
def test_smaller_and_larger(name):
    pairs = [(-1.0, 2.0), (2.0, -1.0), (3.0, 3.0), (0.0, math.inf)]
    for a, b in pairs:
        expected = (min if name == "minimum" else max)(a, b)
        assert getattr(PYTHON, name)(a, b) == expected
        assert getattr(NUMPY, name)(np.array([a]), b)[0] == expected
        mixed = getattr(TORCH, name)(torch.tensor([a], dtype=torch.float64), b)
        assert mixed.dtype == torch.float64
        assert mixed.item() == expected


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=str)
def test_a_choice_between_two_constants_keeps_the_type(dtype):
    """``torch.where(c, 0.1, 0.0)`` is float32 and costs a float64 path nine digits."""
    assert torch.where(torch.tensor([True]), 0.1, 0.0).dtype == torch.float32
    chosen = elementary.array_namespace(torch, dtype).where(torch.tensor([True, False]), 0.1, 0.0)
    assert chosen.dtype == dtype
    assert torch.equal(chosen, torch.tensor([0.1, 0.0], dtype=dtype))


def test_the_square_root_is_rounded_correctly():
    """Against 40 digits, in double and in single precision; torch's is not with every set of instructions."""
    x = np.abs(np.random.default_rng(2).standard_normal(2000)) * 10.0 ** np.linspace(-30.0, 30.0, 2000)

    def applied(root):
        def apply(x, out):
            for k in range(len(x)):
                out[k] = root(x[k])

        return apply

    for values, xp, numbers in (
        (x, compiled.NUMBA, numba.float64),
        (x.astype(np.float32), single_precision.NUMBA_FLOAT32, numba.float32),
    ):
        with mpmath.workdps(40):
            roots = np.array([float(mpmath.sqrt(mpmath.mpf(float(value)))) for value in values]).astype(values.dtype)
        in_numba = np.empty_like(values)
        compiled.entry_point(applied(xp.sqrt), numba.void(numbers[::1], numbers[::1]))(values, in_numba)
        tensors = TORCH.sqrt(torch.from_numpy(values)).numpy()
        assert {found.dtype for found in (in_numba, NUMPY.sqrt(values), tensors)} == {values.dtype}
        assert np.array_equal(in_numba, roots)
        assert np.array_equal(NUMPY.sqrt(values), roots)
        assert np.all(abs(tensors - roots) <= np.spacing(roots))
    assert [PYTHON.sqrt(float(value)) for value in x] == NUMPY.sqrt(x).tolist()
    assert np.isnan(NUMPY.sqrt(np.array([-1.0])))
    assert NUMPY.where(np.array([-1.0]) > 0.0, NUMPY.sqrt(np.array([-1.0])), 0.0) == 0.0


def test_the_functions_do_not_rest_on_a_choice_between_two_constants():
    x = torch.tensor([-40.0, -3.0, -1.0, -0.1, 0.0, 0.1, 1.0, 3.0, 40.0], dtype=torch.float64)
    for name in ALL:
        mine, reference = getattr(TORCH, name)(x), getattr(torch, name)(x)
        assert torch.max(torch.abs(mine - reference) / torch.clamp(torch.abs(reference) ** 2, min=1.0)) <= 4e-15


def test_gradients_flow_and_are_finite():
    """torch.where differentiates both sides; a NaN in the side not taken would spoil the gradient."""
    x = torch.tensor([-25.0, -3.0, -1.0, -1e-9, 0.5, 1.0, 3.0, 25.0], dtype=torch.float64, requires_grad=True)
    slopes = {
        "sin": torch.cos,
        "cos": lambda z: -torch.sin(z),
        "atan": lambda z: 1.0 / (1.0 + z * z),
        "tanh": lambda z: 1.0 - torch.tanh(z) ** 2,
    }
    for name, slope in slopes.items():
        (gradient,) = torch.autograd.grad(getattr(TORCH, name)(x).sum(), x)
        assert torch.max(torch.abs(gradient - slope(x.detach()))) <= 1e-12


@pytest.mark.parametrize("name", ["near_sin", "near_cos", "atan", "tanh"])
def test_a_coarse_namespace_leaves_out_what_it_cannot_tell_apart(name):
    """Single precision computes fewer terms; computed in double precision, that shows."""
    coarse = elementary.namespace("coarse", np.where, np.floor, rounding=2.0**-24)
    x = np.linspace(0.0, 8.0 if name == "tanh" else np.pi / 2, 20001)
    error = np.max(abs(getattr(coarse, name)(x) - getattr(NUMPY, name)(x)))
    assert error < 2.0**-23
    assert (error > 1e-10) == (name != "tanh")  # which is 1 where its last terms count
