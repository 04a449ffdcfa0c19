"""Operations as expressions: brackets, signs, infinities, conditions, tables."""

import math

import numpy as np
import pytest

from bicycle_env.backends.trace import TRACE, named, program
from bicycle_env.export.c_source import C_FUSED, C
from bicycle_env.export.javascript import JAVASCRIPT
from bicycle_env.export.policy import C_FLOAT
from bicycle_env.export.source import bare, lines

X, Y = named("x"), named("y")


def written(*results, language=C):
    return lines(program(results), language, {"x": "x", "y": "y"}, "f")


def test_what_is_used_once_stands_where_it_is_used():
    found = written((X + 1.0) * (Y - -2.0))
    assert found.body == []
    assert found.results == ["(x + 1.0) * (y - (-2.0))"]


def test_what_is_used_twice_has_a_name():
    both = X * Y
    assert written(both + both).body == ["const double v1 = x * y;"]
    assert written(both + both, language=JAVASCRIPT).body == ["const v1 = x * y;"]


def test_long_expressions_are_broken():
    total = X
    for _ in range(60):
        total = total * Y + 1.0
    found = written(total)
    assert len(found.body) > 5
    assert max(map(len, found.body)) < 130


def test_a_condition_as_a_result_is_a_number():
    assert written((X > 1.0) & (Y < 2.0)).results == ["((x > 1.0) && (y < 2.0)) ? 1.0 : 0.0"]


def test_multiply_add():
    total = TRACE.multiply_add(X, Y, 1.0)
    assert written(total).results == ["x * y + 1.0"]
    assert written(total, language=C_FUSED).results == ["fma(x, y, 1.0)"]


def test_a_table_stands_before_the_function():
    lookup = TRACE.table((1.0, -2.0))
    found = written(lookup(X) + lookup(Y))
    assert found.tables == ["static const double f_table1[] = {1.0, (-2.0)};"]
    assert found.results == ["f_table1[(int)(x)] + f_table1[(int)(y)]"]


@pytest.mark.parametrize("value", [0.1, -0.0, 1e-300, 5e-324, 1.7976931348623157e308, 2.0 / 3.0, -1e22])
def test_digits_give_back_the_bits(value):
    assert np.float64(C.number(value).strip("()")).tobytes() == np.float64(value).tobytes()
    single = np.float32(value) if abs(value) < 1e38 else np.float32(0.1)
    assert np.float32(C_FLOAT.number(single).strip("()f")).tobytes() == single.tobytes()


def test_numbers_without_digits():
    assert (C.number(math.inf), C.number(-math.inf)) == ("INFINITY", "(-INFINITY)")
    assert JAVASCRIPT.number(math.inf) == "Infinity"
    with pytest.raises(ValueError, match="not a number"):
        C.number(math.nan)


@pytest.mark.parametrize(("text", "wanted"), [("(a + b)", "a + b"), ("(a) + (b)", "(a) + (b)"), ("a", "a")])
def test_brackets_around_all_of_it_are_left_out(text, wanted):
    assert bare(text) == wanted
