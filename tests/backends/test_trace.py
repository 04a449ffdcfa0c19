"""The laws on symbols: the list of operations, done one after the other, gives what the laws give, to the bit."""

import math
import operator

import numpy as np
import pytest

from bicycle_env import tires
from bicycle_env.backends.trace import TRACE, TRACE_FLOAT32, TraceError, named, program
from bicycle_env.physics.elementary import PYTHON

DOES = {
    "negative": operator.neg,
    "size": abs,
    "floor": np.floor,
    "root": math.sqrt,
    "multiply_add": lambda a, b, c: a * b + c,
    "choose": lambda condition, then, otherwise: then if condition else otherwise,
    "and": operator.and_,
    "or": operator.or_,
    "not": operator.not_,
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}


def done(found, inputs):
    """The results of a program, in plain Python."""
    values = []
    for step in found.steps:
        operands = [values[k] for k in step.operands]
        if step.operation == "input":
            values.append(inputs[step.value])
        elif step.operation == "constant":
            values.append(step.value)
        elif step.operation == "lookup":
            values.append(step.value[int(operands[0])])
        else:
            values.append(DOES[step.operation](*operands))
    return [values[k] for k in found.results]


def traced(law, *names):
    return program([law(TRACE)(*map(named, names))])


@pytest.mark.parametrize("name", ["sin", "cos", "tan", "atan", "tanh", "near_sin", "near_cos", "sqrt", "floor"])
def test_elementary_functions(name):
    found = traced(lambda xp: getattr(xp, name), "x")
    for x in [-0.0, 0.0, 0.3, 1.0, 1.5707, *([-0.3, -1.5] if name != "sqrt" else [])]:
        (value,), wanted = done(found, {"x": x}), float(getattr(PYTHON, name)(x))
        assert np.float64(value).tobytes() == np.float64(wanted).tobytes(), x


def test_numbers_stand_on_either_side():
    found = traced(lambda xp: lambda x: (1.0 - x) / (3.0 / x - (x - 2.0)) - (x / 5.0 + (1.5 * x + 2)), "x")
    x = 0.7
    assert done(found, {"x": x}) == [(1.0 - x) / (3.0 / x - (x - 2.0)) - (x / 5.0 + (1.5 * x + 2))]


def test_single_precision_takes_shorter_polynomials():
    short, long = program([TRACE_FLOAT32.tanh(named("x"))]), program([TRACE.tanh(named("x"))])
    assert short.operations < long.operations
    for x in (-3.0, 0.2, 1.0, 19.0):
        assert done(short, {"x": x})[0] == pytest.approx(math.tanh(x), rel=1e-7)


def test_an_operation_on_the_same_numbers_is_done_once():
    found = traced(lambda xp: lambda x, y: (x * y + 1.0) / (x * y + 1.0) + xp.tanh(x) * xp.tanh(x), "x", "y")
    alone = traced(lambda xp: xp.tanh, "x")
    assert found.operations == 3 + 2 + alone.operations  # the product, its sum, their quotient; tanh once


def test_minus_zero_is_another_constant_than_zero():
    found = traced(lambda xp: lambda x: xp.where(x > 0.0, 0.0, -0.0), "x")
    assert math.copysign(1.0, done(found, {"x": -1.0})[0]) == -1.0
    assert math.copysign(1.0, done(found, {"x": 1.0})[0]) == 1.0


def test_nothing_is_computed_ahead_or_reordered():
    found = traced(lambda xp: lambda x: (x + 1e16) - 1e16 + 0.0 * x, "x")
    assert done(found, {"x": 1.0}) == [0.0]
    assert found.operations == 4


def test_a_table_and_conditions():
    def law(xp):
        lookup = xp.table((1.5, 2.5, 4.5))
        return lambda x, y: xp.where((x > y) & ~(y < 0.0) | (x == 7.0), lookup(xp.integer(xp.floor(x))), -1.0)

    found = traced(law, "x", "y")
    for x, y, wanted in [(2.3, 1.0, 4.5), (1.2, 1.0, 2.5), (1.2, -1.0, -1.0), (0.5, 0.7, -1.0)]:
        assert done(found, {"x": x, "y": y}) == [wanted]


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (lambda x: 1.0 if x > 0.0 else 2.0, "no `if`"),
        (lambda x: max(x, 0.0), "no `if`"),
        (lambda x: x & 3, "bits of integers"),
        (lambda x: ~x, "bits of integers"),
        (lambda x: x << 3, "bits of integers"),
        (lambda x: float(x), "plain number"),
        (lambda x: x + "1", "numbers and symbols only"),
    ],
)
def test_what_cannot_be_written_out_is_named(law, words):
    with pytest.raises(TraceError, match=words):
        program([law(named("x"))])


def test_a_tire_that_the_user_wrote():
    class Sine(tires.Tire):
        def law(self, xp):
            return lambda slip_angle, stiffness, peak: -peak * xp.sin(stiffness * slip_angle / peak)

    found = traced(Sine().law, "slip", "stiffness", "peak")
    inputs = {"slip": 0.05, "stiffness": 8e4, "peak": 6e3}
    assert done(found, inputs) == [float(Sine().law(PYTHON)(*inputs.values()))]
