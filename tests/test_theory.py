"""docs/theory.md: every equation is on the map, every function and test that it names exists, its session runs."""

from __future__ import annotations

import ast
import doctest
import functools
import importlib
import inspect
import re
from pathlib import Path
from typing import NamedTuple

import pytest

import bicycle_env
from bicycle_env import analysis, control

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "theory.md"
TEXT = PAGE.read_text(encoding="utf-8")

EQUATIONS = [*(f"6.{number}" for number in range(1, 6)), "6.5a", *(f"6.{number}" for number in range(6, 28))]
DERIVED = {
    "understeer gradient",
    "characteristic speed",
    "steady-state gains",
    "tangent speed",
    "transfer function",
    "zeros",
    "non-minimum phase",
    "exact geometry",
    "relaxation length",
    "tanh law",
    "Fiala law",
    "Magic Formula",
    "equilibria",
    "handling diagram",
    "LQR and Riccati equation",
    "Kalman filter",
    "MacAdam's preview",
    "recoverable set",
}


class Row(NamedTuple):
    """One row of a table that maps."""

    what: str
    functions: list[str]
    tests: list[str]


def equations_in(text):
    """The equation numbers that a text mentions, in order, ranges like (6.10)-(6.12) filled in."""
    found = []
    for first, last in re.findall(r"\b(6\.\d+a?)\b(?:\)?-\(?(6\.\d+a?)\b)?", text):
        if first in EQUATIONS:
            end = EQUATIONS.index(last) if last in EQUATIONS else EQUATIONS.index(first)
            found += EQUATIONS[EQUATIONS.index(first) : end + 1]
    return found


def table_rows(text):
    """Rows of all tables with the columns function and test."""
    rows, mapping = [], False
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        if not line.startswith("|"):
            mapping = False
        elif cells[1:] == ["what", "function", "test"]:
            mapping = True
        elif mapping and not set(line) <= set("|-: "):
            rows.append(Row(cells[0], *(re.findall(r"`([^`]+)`", cell) for cell in cells[2:])))
    return rows


ROWS = table_rows(TEXT)
FUNCTIONS = sorted({name for row in ROWS for name in row.functions})
TESTS = sorted({name for row in ROWS for name in row.tests})


def resolved(name):
    """The object that a dotted name stands for; a function goes before the module of its name."""
    parts = name.split(".")
    found = importlib.import_module(parts[0])
    for length, part in enumerate(parts[1:], start=2):
        if not hasattr(found, part):
            importlib.import_module(".".join(parts[:length]))
        found = getattr(found, part)
    return found


def where_it_speaks(thing):
    """Docstring and source of a function, class or property, and the docstring of its module."""
    function = thing.fget if isinstance(thing, property) else thing
    return "\n".join([inspect.getsource(function), inspect.getmodule(function).__doc__])


@functools.cache
def functions_of(path):
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_every_equation_is_on_the_map_once():
    listed = [number for row in ROWS for number in equations_in(row.what)]
    assert sorted(listed, key=EQUATIONS.index) == EQUATIONS


def test_derived_results_are_on_the_map():
    assert {row.what for row in ROWS} >= DERIVED


def test_a_row_has_a_function_and_a_test():
    assert [row.what for row in ROWS if not (row.functions and row.tests)] == []


def test_functions_exist():
    for name in FUNCTIONS:
        assert name.startswith("bicycle_env.")
        assert callable(resolved(name)) or isinstance(resolved(name), property), name


def test_tests_exist():
    for name in TESTS:
        path, function = name.split("::")
        assert function.startswith("test_"), name
        assert function in functions_of(path), name


def test_the_code_names_its_equation():
    for row in ROWS:
        for number in equations_in(row.what):
            for name in row.functions:
                assert number in equations_in(where_it_speaks(resolved(name))), name


def test_the_text_explains_every_equation():
    prose = "\n".join(line for line in TEXT.splitlines() if not line.startswith(("|", "#", ">>>")))
    assert set(equations_in(prose)) == set(EQUATIONS)


@pytest.mark.parametrize(
    "thing",
    [
        *(each for each in map(analysis.__getattribute__, analysis.__all__) if inspect.isroutine(each)),
        *bicycle_env.tires.LAWS.values(),
        *bicycle_env.disturbances.LAWS.values(),
        *bicycle_env.distributions.LAWS.values(),
        *bicycle_env.drivers.LAWS.values(),
        *(policy for name, policy in control.POLICIES.items() if name != "zero"),
        *control.REAR_LAWS.values(),
    ],
    ids=lambda thing: thing.__name__,
)
def test_nothing_is_missing(thing):
    assert thing in map(resolved, FUNCTIONS), f"give {thing.__name__} a row in docs/theory.md"


def test_the_session_gives_what_it_shows():
    blocks = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    session = doctest.DocTestParser().get_doctest("\n".join(blocks), {}, PAGE.name, str(PAGE), 0)
    assert len(session.examples) >= 6
    said = []
    result = doctest.DocTestRunner(verbose=False).run(session, out=said.append)
    assert result.failed == 0, "".join(said)


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\(((?!http)[^)#]+)\)", TEXT))))
def test_links_exist(link):
    assert (PAGE.parent / link).is_file()


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("(6.17)", ["6.17"]),
        ("(6.4), (6.5), (6.5a)", ["6.4", "6.5", "6.5a"]),
        ("(6.10)-(6.12)", ["6.10", "6.11", "6.12"]),
        ("equations 6.4-6.6", ["6.4", "6.5", "6.5a", "6.6"]),
        ("(6.28), 6.6 m", ["6.6"]),
        ("16.2 and 6.171", []),
    ],
)
def test_how_equation_numbers_are_read(text, numbers):
    assert equations_in(text) == numbers
