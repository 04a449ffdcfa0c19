"""The numbers on which laws are tried calculate as numpy does; what they refuse is in the tests of tires and tasks."""

import operator

import numpy as np
import pytest

from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.trial import FUNCTIONS, TRIAL, NotOfALawError, Number, plain

A, B = np.array([0.3, -1.7]), np.array([-0.9, 2.4])
ARGUMENTS = {
    "where": (A > 0.0, A, B),
    "multiply_add": (A, B, A),
    "minimum": (A, B),
    "maximum": (A, B),
    "sqrt": (abs(A),),
}
WHOLE = np.array([5, 2])
CALLS = {name: ARGUMENTS.get(name, (A,)) for name in FUNCTIONS if name not in ("function", "table")}


@pytest.mark.parametrize("name", CALLS)
def test_the_functions_are_those_of_numpy(name):
    found = getattr(TRIAL, name)(*map(Number, CALLS[name]))
    np.testing.assert_array_equal(plain(found), getattr(NUMPY, name)(*CALLS[name]))
    assert isinstance(found, Number)


def test_a_table_and_a_bound_law():
    assert plain(TRIAL.table((1.0, 2.0, 4.0))(Number(np.array([2, 0])))).tolist() == [4.0, 1.0]
    assert plain(TRIAL.function(lambda x: x + 1.0)(Number(A))).tolist() == (A + 1.0).tolist()


@pytest.mark.parametrize("one", [operator.add, operator.sub, operator.mul, operator.truediv, operator.lt, operator.ne])
@pytest.mark.parametrize("other", [2.0, np.float64(2.0), 3, B], ids=["float", "numpy's", "int", "number"])
def test_the_operators_are_those_of_arrays(one, other):
    lifted = Number(other) if isinstance(other, np.ndarray) else other
    np.testing.assert_array_equal(plain(one(Number(A), lifted)), one(A, other))
    np.testing.assert_array_equal(plain(one(lifted, Number(A))), one(other, A))


def test_the_operators_of_one_number_and_of_whole_ones():
    assert [plain(f(Number(A))).tolist() for f in (abs, operator.neg, operator.pos)] == [
        f(A).tolist() for f in (abs, operator.neg, operator.pos)
    ]
    assert plain(~(Number(A) > 0.0)).tolist() == [False, True]
    assert plain((Number(WHOLE) << 2) ^ 1).tolist() == [21, 9]
    assert plain(Number(A) ** 2).tolist() == (A**2).tolist()


@pytest.mark.parametrize("use", [bool, float, int, len, list, max, lambda x: x[0], np.sum, np.sqrt, lambda x: x @ x])
def test_nothing_else_is_known(use):
    with pytest.raises((NotOfALawError, TypeError)):
        use(Number(A))
