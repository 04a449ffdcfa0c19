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
from agents.statistics import iqm
from bicycle_env import control
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


def networks(folder, number):
    """Trained policies that steer straight on, in folders as agents.jobs makes them."""
    names = list(gym.make(entry_speed.ENV_ID, steer="front").unwrapped.observation_names)
    layers = [(np.zeros((1, len(names)), np.float32), np.zeros(1, np.float32))]
    description = {"env_id": entry_speed.ENV_ID, "observation_names": names}
    for seed in range(number):
        control.Network(layers, "tanh", "clip", description).save(folder / str(seed))
        run = {"seed": seed, "algo": "native-ppo", "git": "abc", "timesteps": 5}
        (folder / str(seed) / "run.json").write_text(json.dumps(run))


def test_a_row_is_called_as_asked_and_its_policy_may_depend_on_the_course():
    assert entry_speed.named("lqr", "iso3888-1", "front") == ("lqr", "lqr")
    assert entry_speed.named("mine=runs/{course}/{steer}", "iso3888-1", "front") == ("mine", "runs/iso3888-1/front")


def test_a_folder_of_seeds_is_one_row(tmp_path, monkeypatch):
    networks(tmp_path / "seeds", 3)
    found = {0: [1.0, 1.0, 0.0], 1: [1.0, 0.0, 0.0], 2: [1.0, 1.0, 1.0]}

    def shares(keywords, speeds, make, seeds):
        return np.array(found[asked.pop(0)])

    asked = [0, 1, 2]
    monkeypatch.setattr(entry_speed, "shares", shares)
    row = entry_speed.row_of(str(tmp_path / "seeds"), {"steer": "front"}, SPEEDS, entry_speed.Args(starts=2))
    assert [one["highest"] for one in row["seeds"]] == [15.0, 10.0, 30.0]
    assert row["highest"] == iqm([15.0, 10.0, 30.0])
    assert [one["training"]["git"] for one in row["seeds"]] == ["abc"] * 3
    assert entry_speed.range_of(row, "highest") == f"{row['highest']:.2f} [10.00, 30.00]"
    assert entry_speed.seeds_of(str(tmp_path / "seeds" / "0")) == entry_speed.seeds_of("lqr") == []


def test_rows_that_are_not_driven_now_stay(tmp_path, monkeypatch):
    """A policy that steers straight on passes at no speed."""
    networks(tmp_path / "straight", 2)
    out, words = tmp_path / "entry.json", ["--course", "iso3888-1", "--steer", "front", "--starts", "2"]
    monkeypatch.setattr(entry_speed, "LADDER", (1.0, 1.01))
    for more in (["--policy", "stanley"], ["--policy", f"learned={tmp_path / 'straight'}", "--keep"]):
        monkeypatch.setattr("sys.argv", ["entry_speed", *words, *more, "--json", str(out)])
        entry_speed.main()
    content = json.loads(out.read_text())
    rows = content["courses"]["iso3888-1"]["front"]
    assert list(rows) == ["stanley", "learned"]
    assert "--policy stanley" in content["command"], "what is said of the file stays"
    assert "made_by" not in rows["stanley"]
    assert rows["stanley"]["highest"] > rows["learned"]["highest"] == 0.0
    assert "--policy learned=" in rows["learned"]["made_by"]["command"]
    assert {"date", "git", "machine", "versions", "seconds"} <= set(rows["learned"]["made_by"])

    monkeypatch.setattr("sys.argv", ["entry_speed", *words, "--seed", "2", "--keep", "--json", str(out)])
    with pytest.raises(UserError, match="has seed 1, asked for is 2"):
        entry_speed.main()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--keep"], "--keep: --json must name the file"),
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
                for one in row.get("seeds", [row]):
                    speeds, share = np.array(one["speeds"]), np.array(one["shares"])
                    assert one["highest"] == entry_speed.highest(speeds, share)
                    assert one["unbroken"] == entry_speed.unbroken(speeds, share)
