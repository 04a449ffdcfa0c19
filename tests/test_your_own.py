"""docs/your_own.md: its tables are the code's, its examples exist, and no law is missing."""

import inspect
import re
from pathlib import Path

import pytest

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import PYTHON, Namespace
from bicycle_env.tasks.episode import EpisodeState, Reference, Rules
from bicycle_env.tasks.rewards import Reward
from bicycle_env.tasks.task import Task

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "your_own.md"
TEXT = PAGE.read_text(encoding="utf-8")
NOT_LAWS = ("settings", "entries", "marks", "task_state_with", "option_numbers", "check_options")


def rows_of(title):
    """The cells of the table with this first column."""
    lines = TEXT.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith(f"| {title} |"))
    rows = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            return rows
        rows.append([cell.strip() for cell in line.split("|")[1:-1]])
    return rows


@pytest.mark.parametrize("record", [CarState, CarParameters, EpisodeState, Reference, Rules])
def test_the_fields_of_the_records(record):
    (fields,) = (row[1] for row in rows_of("record") if row[0] == f"`{record.__name__}`")
    assert tuple(re.findall(r"`(\w+)`", fields)) == record._fields


def test_the_functions_of_the_namespace():
    told = {name for row in rows_of("of `xp`") for name in re.findall(r"`(\w+)", row[0])}
    known = {name for name, _ in inspect.getmembers(Namespace, inspect.isfunction) if not name.startswith("_")}
    assert told == known
    assert all(hasattr(PYTHON, name) for name in told)


def test_the_laws_of_a_task_and_their_signatures():
    told = dict(re.fullmatch(r"`(\w+)\((.*)\)`", row[0]).groups() for row in rows_of("law"))
    laws = {name for name, _ in inspect.getmembers(Task, inspect.isfunction) if not name.startswith("_")}
    assert set(told) == laws - set(NOT_LAWS)
    for name, arguments in told.items():
        assert f"``{name}({arguments})" in inspect.getdoc(getattr(Task, name)), name


def test_the_laws_of_a_reward():
    for name in ("law", "before"):
        arguments = re.search(rf"`{name}\(([^)]*)\)`", TEXT[TEXT.index("## Rewards") :]).group(1)
        assert f"``{name}({arguments})" in inspect.getdoc(getattr(Reward, name))


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\(((?!http)[^)#]+)\)", TEXT))))
def test_links_exist(link):
    assert (PAGE.parent / link).is_file()
