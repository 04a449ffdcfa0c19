"""The study of the headroom: its figures, its files, and one line for a mistake."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from agents import headroom, tune
from agents.episodes import start_seeds
from agents.messages import UserError
from agents.statistics import wilson
from bicycle_env import Actuator, control

RESULTS = Path(__file__).parents[2] / "results"


class Everywhere:
    """A recoverable set that takes seconds less than the true one."""

    def contains(self, *columns):
        return np.ones(len(columns[0]), bool)


@pytest.mark.exhaustive
def test_a_small_study(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(headroom, "bound", lambda env: Everywhere())
    monkeypatch.setattr(tune, "TUNING_STARTS", 4)
    monkeypatch.setattr(tune, "SELECTION_STARTS", 8)
    out = tmp_path / "headroom.json"
    words = ["headroom", "--only", "shipped", "--episodes", "12", "--json", str(out)]
    monkeypatch.setattr("sys.argv", words)
    headroom.main()
    text = capsys.readouterr().out
    for word in ("as shipped", "nobody", "LQR tuned for it", "found by search", "upper bound", "on road %"):
        assert word in text
    content = json.loads(out.read_text())
    assert content["command"] == "python -m agents.headroom --episodes 12 --seed 1 --search-seed 0 --only 'shipped'"
    assert {"date", "machine", "versions", "git"} <= set(content)
    (row,) = content["conditions"].values()
    rates = {name: row[name]["success_rate"]["value"] for name in headroom.DRIVERS}
    assert rates["uncontrolled"] == 0.0
    assert rates["search"] >= rates["tuned"] > 0.5
    assert row["search"]["success_rate"]["interval"] == list(wilson(round(12 * rates["search"]), 12))
    assert row["search"]["episode_return"]["value"] >= row["tuned"]["episode_return"]["value"]
    assert list(row["tuning"]["parameters"]) == [one.name for one in control.LQR.parameters]
    assert len(row["tuning"]["on_selection_starts"]["restarts"]) == 5
    assert out.with_suffix(".png").stat().st_size > 10_000
    (sequences,) = json.loads(out.with_suffix(".steering.json").read_text())["sequences"].values()
    assert len(sequences) == headroom.KEPT_SEQUENCES
    assert all(one["start"] in start_seeds(12, 1) for one in sequences)


def test_lqr_as_shipped_saves_what_the_table_of_controllers_says():
    """The vector environment and a batch's products make no difference that a table could show."""
    conditions = json.loads((RESULTS / "headroom.json").read_text())["conditions"]
    controllers = json.loads((RESULTS / "controllers_stab.json").read_text())["policies"]
    for ours, name in (("shipped", "lqr"), ("uncontrolled", "zero")):
        row = conditions["as shipped"][ours]
        assert row["success_rate"]["value"] == controllers[name]["success_rate"]["value"]
        assert row["episode_return"]["value"] == pytest.approx(controllers[name]["episode_return"]["value"], rel=1e-6)


def test_keywords_become_plain():
    given = {"steer": "rear", "front_actuator": Actuator(0.1, math.inf, 0.005), "rear_actuator": Actuator(0.1, 2.0)}
    assert headroom.plain(given) == {
        "steer": "rear",
        "front_actuator": {"angle_limit": 0.1, "time_constant": 0.005},
        "rear_actuator": {"angle_limit": 0.1, "rate_limit": 2.0, "time_constant": 0.05},
    }


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--episodes", "0"], "--episodes must be at least 1, got 0"),
        (["--seed", "-1"], "--seed must be at least 0, got -1"),
        (["--search-seed", "-1"], "--search-seed must be at least 0, got -1"),
        (["--only", "ice"], "--only must be a part of one of: instant actuators, as shipped"),
    ],
)
def test_a_mistake_is_said_before_any_work(words, text, monkeypatch):
    monkeypatch.setattr("sys.argv", ["headroom", *words])
    with pytest.raises(UserError, match=text):
        headroom.main()
