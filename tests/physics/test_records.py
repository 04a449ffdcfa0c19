"""Named tuples, field by field."""

from typing import NamedTuple

import numpy as np
import pytest

from bicycle_env.backends.compiled import NUMBA, PARTS, inlined
from bicycle_env.physics import records
from bicycle_env.physics.elementary import PYTHON


class Pair(NamedTuple):
    left: float
    right: float


class Name(NamedTuple):
    """One field more; named like another."""

    left: float
    right: float
    middle: float


def test_each_helper_by_hand():
    weigh = records.fieldwise(PYTHON, Pair, lambda a, b, x: a + x * b, 2, 1)
    assert weigh(Pair(1.0, 2.0), Pair(3.0, 4.0), 10.0) == Pair(31.0, 42.0)
    assert records.replaced(PYTHON, Name, ("middle", "left"))(Name(1.0, 2.0, 3.0), 8.0, 9.0) == Name(9.0, 2.0, 8.0)
    assert records.field(PYTHON, "right")(Pair(1.0, 2.0)) == 2.0
    assert records.merged(PYTHON, Name, ("right",))(Name(1.0, 2.0, 3.0), Pair(8.0, 9.0)) == Name(1.0, 9.0, 3.0)
    larger = records.record_of("Larger", ("left", "right", "more"))
    assert records.joined(PYTHON, larger, Pair, records.record_of("More", ("more",)))(
        Pair(1.0, 2.0), records.record_of("More", ("more",))(3.0)
    ) == larger(1.0, 2.0, 3.0)
    assert records.part(PYTHON, Pair)(Name(1.0, 2.0, 3.0)) == Pair(1.0, 2.0)
    assert records.composed(PYTHON, Pair, ["twice(x)", "x"], "x", twice=lambda x: 2.0 * x)(3.0) == Pair(6.0, 3.0)
    assert records.sequence(PYTHON, ["x", "-x"], "x")(3.0) == (3.0, -3.0)
    assert records.sequence(PYTHON, [], "x")(3.0) == ()


@pytest.mark.parametrize("helper", [records.replaced, records.merged])
def test_a_field_that_is_not_there_is_refused(helper):
    """A misspelt one was left out: the ice of a task did not act."""
    with pytest.raises(ValueError, match="unknown field of Name 'midle'; did you mean 'middle'"):
        helper(PYTHON, Name, ("left", "midle"))
    with pytest.raises(ValueError, match="fields of Name must be named once each, got left, left"):
        helper(PYTHON, Name, ("left", "left"))


@pytest.mark.parametrize("stride", [1, 4])
def test_what_is_written_is_read(stride):
    numbers = np.zeros(40)
    write, read = records.writer(PYTHON, 2, 3, stride), records.reader(PYTHON, Pair, 3, stride)
    write(numbers, 1, (5.0, 6.0))
    assert read(numbers, 1) == Pair(5.0, 6.0)
    assert np.flatnonzero(numbers).tolist() == [1 + 3 * stride, 1 + 4 * stride]
    records.writer(PYTHON, 0, 3, stride)(numbers, 1, ())


def test_the_same_name_and_fields_are_the_same_class():
    assert records.record_of("Kept", ("a", "b")) is records.record_of("Kept", ("a", "b"))
    assert records.record_of("Kept", ("a", "b")) is not records.record_of("Kept", ("b", "a"))


def test_numba_looks_at_equal_laws_once():
    first, second = (records.replaced(NUMBA, Pair, ("left",)) for _ in range(2))
    assert first is second
    assert records.replaced(NUMBA, Pair, ("right",)) is not first

    def law_of(number):
        return inlined(lambda x: number * x)

    assert law_of(2.0) is law_of(2.0)
    assert law_of(2.0) is not law_of(3.0)
    assert law_of(2.0).content in PARTS
