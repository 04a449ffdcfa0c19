"""Which combinations `make test` takes, and which are left to `make test-all`: those marked `exhaustive`."""

import itertools

import pytest

ON_ROADS = ("BicycleStab-v0", "BicycleLaneChange-v0")
"""Ids whose car is the nominal one and whose task is a place on the road: what the linear controllers are for."""


def only_all(*values):
    """A row of parameters for `make test-all`."""
    return pytest.param(*values, marks=pytest.mark.exhaustive)


def some_of(rows, chosen):
    """Rows, tuples where there are several parameters: `make test` takes the chosen ones."""
    rows, chosen = list(rows), list(chosen)
    if not set(chosen) <= set(rows):
        raise ValueError(f"chosen must be among {rows}, got {chosen}")
    return [row if row in chosen else only_all(*row) if isinstance(row, tuple) else only_all(row) for row in rows]


def pairwise(*columns):
    """Rows of the whole product; `make test` takes so many that every pair of values of two columns stands in one."""
    product = list(itertools.product(*(list(column) for column in columns)))
    places = list(itertools.combinations(range(len(columns)), 2))
    missing = {(place, row[place[0]], row[place[1]]) for row in product for place in places}
    chosen = set()
    while missing:
        best = max(product, key=lambda row: len(pairs_of(row, places) & missing))  # the first of equals
        chosen.add(best)
        missing -= pairs_of(best, places)
    return [row if row in chosen else only_all(*row) for row in product]


def pairs_of(row, places):
    return {(place, row[place[0]], row[place[1]]) for place in places}
