"""What `make test` leaves out, `make test-all` takes; and it leaves out no pair."""

import itertools

import pytest
from combinations import pairs_of, pairwise, some_of

COLUMNS = ("ab", "cdef", "gh", "ij")
PLACES = list(itertools.combinations(range(4), 2))


def split(rows):
    """(what `make test` takes, what only `make test-all` takes)."""
    short = [row for row in rows if not isinstance(row, type(pytest.param()))]
    return short, [row.values for row in rows if isinstance(row, type(pytest.param()))]


def test_every_combination_stands_once_and_every_pair_in_the_short_half():
    short, rest = split(pairwise(*COLUMNS))
    product = list(itertools.product(*COLUMNS))
    assert sorted(short + rest) == sorted(product)
    assert set().union(*(pairs_of(row, PLACES) for row in short)) == set().union(
        *(pairs_of(row, PLACES) for row in product)
    )
    assert len(short) <= 9


def test_some_of_keeps_all_and_knows_its_rows():
    short, rest = split(some_of("abc", "b"))
    assert (short, rest) == (["b"], [("a",), ("c",)])
    with pytest.raises(ValueError, match="must be among"):
        some_of("abc", "d")
