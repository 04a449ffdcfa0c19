"""docs/your_own.md: its tables are the code's, its examples exist, and no law is missing."""

import inspect
import re
from pathlib import Path

import pytest

from bicycle_env import tasks
from bicycle_env.envs.telemetry import columns
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import PYTHON, Namespace
from bicycle_env.tasks.episode import EpisodeState, Reference, Rules, World
from bicycle_env.tasks.rewards import Reward
from bicycle_env.tasks.stabilise import Stabilise
from bicycle_env.tasks.task import NEEDED, Task

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "your_own.md"
TEXT = PAGE.read_text(encoding="utf-8")
NOT_LAWS = (*("settings", "entries", "marks", "task_state_with", "option_numbers", "check_options", "seconds_to_pass"),)
NOT_OF_A_TASK = {"State", "end_names", "check_options"}
"""What follows from the rest, and what only environments call."""


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


@pytest.mark.parametrize("record", [CarState, CarParameters, EpisodeState, Reference, Rules, World])
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


def test_what_a_task_says_beside_its_laws():
    laws = {re.match(r"`(\w+)", row[0]).group(1) for row in rows_of("law")}
    told = {name: row for row in rows_of("of a task") for name in re.findall(r"`(\w+)", row[0])}
    known = {name for name in (*vars(Task), *Task.__annotations__) if not name.startswith("_")}
    assert set(told) == known - laws - NOT_OF_A_TASK
    needed = {name for name, row in told.items() if row[2] == "needed"}
    needed |= {re.match(r"`(\w+)", row[0]).group(1) for row in rows_of("law") if row[2] == "needed"}
    assert needed == {*NEEDED, *Task.__abstractmethods__}


def test_the_columns_of_a_metric():
    told = re.search(r"those of `env.unwrapped.state`,(.*?)\. `run.success`", TEXT, re.DOTALL).group(1)
    assert re.findall(r"`(\w+)`", told) == [
        name for name in columns(Stabilise()) if name not in Stabilise().State._fields
    ]


def test_the_helpers_of_a_path_can_be_imported():
    told = {name for row in rows_of("of `bicycle_env.tasks`") for name in re.findall(r"`(\w+)\(", row[0])}
    assert told - {"path"} <= set(tasks.__all__)
    assert {name for name in tasks.__all__ if name.startswith(("path_", "observed_", "times_"))} <= told
    assert all(hasattr(tasks, name) for name in tasks.__all__)


def test_the_laws_of_a_reward():
    for name in ("law", "before"):
        arguments = re.search(rf"`{name}\(([^)]*)\)`", TEXT[TEXT.index("## Rewards") :]).group(1)
        assert f"``{name}({arguments})" in inspect.getdoc(getattr(Reward, name))


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\(((?!http)[^)#]+)\)", TEXT))))
def test_links_exist(link):
    assert (PAGE.parent / link).is_file()
