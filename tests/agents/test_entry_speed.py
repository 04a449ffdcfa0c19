"""The ladder of entry speeds: its figures, its file, and one line for a mistake."""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from agents import entry_speed
from agents.episodes import drive, start_seeds
from agents.evaluate import find_policy
from agents.messages import UserError
from bicycle_env.tasks.double_lane_change import COURSES

RESULTS = Path(__file__).parents[2] / "results"
SPEEDS = np.array([10.0, 15.0, 30.0])


def test_the_highest_speed_is_one_at_which_every_start_passes():
    for shares, highest, unbroken in (
        ([1.0, 1.0, 0.98], 15.0, 15.0),
        ([1.0, 0.5, 1.0], 30.0, 10.0),
        ([0.0, 1.0, 0.0], 15.0, 0.0),
        ([0.0, 0.0, 0.9], 0.0, 0.0),
        ([1.0, 1.0, 1.0], 30.0, 30.0),
    ):
        share = np.array(shares)
        assert (entry_speed.highest(SPEEDS, share), entry_speed.unbroken(SPEEDS, share)) == (highest, unbroken)


@pytest.mark.exhaustive
def test_the_shares_are_those_of_single_environments():
    seeds, keywords = start_seeds(2, 7), {"course": "iso3888-2", "steer": "front"}
    speeds = np.array([7.0, 15.0, 17.0, 25.0])

    for name in ("lqr", "preview"):  # the second one remembers: each speed has a driver of its own
        found = entry_speed.shares(keywords, speeds, lambda env, name=name: find_policy(name, env), seeds)
        for speed, share in zip(speeds, found, strict=True):
            env = gym.make(entry_speed.ENV_ID, **keywords, speed=speed, telemetry=True, max_episode_steps=600)
            policy = find_policy(name, env)
            assert share == np.mean([drive(env, policy, seed).success for seed in seeds])


@pytest.mark.exhaustive
def test_a_small_study(tmp_path, monkeypatch, capsys):
    out = tmp_path / "entry.json"
    words = ["--course", "iso3888-2", "--steer", "front", "both", "--policy", "lqr", "preview-tuned", "--starts", "2"]
    monkeypatch.setattr(entry_speed, "LADDER", (0.9, 1.2))
    monkeypatch.setattr(entry_speed, "PREVIEW_TIMES", (0.6, 1.1))
    monkeypatch.setattr("sys.argv", ["entry_speed", *words, "--env-keywords", '{"friction": 0.9}', "--json", str(out)])
    entry_speed.main()
    assert "highest entry speed that passes" in capsys.readouterr().out
    content = json.loads(out.read_text())
    assert content["command"].endswith("--starts 2 --seed 1 --env-keywords '{\"friction\": 0.9}'")
    assert {"date", "machine", "versions", "git", "seconds"} <= set(content)
    modes = content["courses"]["iso3888-2"]
    assert {steer: list(rows) for steer, rows in modes.items()} == {"front": ["lqr", "preview-tuned"], "both": ["lqr"]}
    driver = modes["front"]["preview-tuned"]
    assert driver["preview_time"] == 0.6
    assert np.diff(driver["speeds"]) == pytest.approx(entry_speed.RUNG)
    assert driver["highest"] in driver["speeds"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--starts", "0"], "--starts must be at least 1, got 0"),
        (["--env-keywords", '{"speed": 20.0}'], "--env-keywords: course and steer"),
        (["--course", "iso3888-3"], "course must be"),
        (["--policy", "lqrr"], "did you mean 'lqr'"),
    ],
)
def test_a_mistake_is_one_line(words, text, monkeypatch):
    monkeypatch.setattr("sys.argv", ["entry_speed", *words])
    with pytest.raises(UserError, match=text) as caught:
        entry_speed.main()
    assert "\n" not in str(caught.value)


def test_the_committed_figures_are_of_both_courses_and_say_what_made_them():
    content = json.loads((RESULTS / "entry_speed.json").read_text())
    assert {"command", "date", "machine", "versions", "git", "seed", "starts"} <= set(content)
    assert list(content["courses"]) == list(COURSES)
    for modes in content["courses"].values():
        assert list(modes) == ["front", "both"]
        for rows in modes.values():
            for row in rows.values():
                speeds, share = np.array(row["speeds"]), np.array(row["shares"])
                assert row["highest"] == entry_speed.highest(speeds, share)
                assert row["unbroken"] == entry_speed.unbroken(speeds, share)
