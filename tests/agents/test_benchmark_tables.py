"""The benchmark's tables and picture, of cells that are made up: who stands where, what is said, what is drawn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from benchmark_cells import cell, share

from agents import benchmark, benchmark_picture, scores
from agents import benchmark_tables as tables

STAB, EVADE, STEER = "BicycleStab-v0", "BicycleEvade-v0", "BicycleActiveSteer-v0"
CELLS = (
    cell(EVADE, "hard", "native-ppo", [0.75, 0.8, 0.85, 0.8]),
    cell(STEER, "hard", "native-ppo", [0.70, 0.71, 0.72]),
    cell(STAB, "hard", "sb3-sac", [0.4, 0.5, 0.6]),
    cell(STAB, "hard", "native-ppo", [0.6, 0.65, 0.65]),
    cell(EVADE, "hard", "sb3-ppo", [0.5, 0.5, 0.5]),
)


def driver(success, episode_return=50.0, starts=2000, **more):
    return {"success_rate": share(success), "on_road_rate": share(0.9), "episode_return": share(episode_return),
            "starts": starts, **more}  # fmt: skip


def part(classical, reference):
    """Of results/headroom.json."""
    return {
        "classical": {"driver": "lqr, tuned", "success_rate": classical, "episode_return": 70.0},
        "reference": {"driver": "best found", "success_rate": reference, "episode_return": 90.0},
        "room": {"value": reference - classical, "interval": [0.0, 1.0]},
        "best_return": 100.0,
        "drivers": {
            "best found": driver(reference, 95.0, 200),
            "lqr, tuned": driver(classical, 70.0),
            "lqr, as shipped": driver(0.6, 60.0),
            "uncontrolled": driver(0.02, 10.0),
        },
    }


STUDY = {f"{STAB} hard": part(0.7, 0.71), f"{EVADE} hard": part(0.7, 0.9), f"{STEER} hard": part(0.65, 0.9)}
PLANNED = {f"{EVADE} hard": {"mpc": {"nothing": {**driver(0.75, 60.0, 100), "better_than_classical": share(0.04)}}}}


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "headroom.json"
    path.write_text(json.dumps({"settings": STUDY}))
    return path


def rows(text):
    """Lines of tables, by their cells."""
    return [[one.strip() for one in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| ")]


def test_where_learning_loses_stands_first_and_says_so(study):
    text = tables.drivers(CELLS, STUDY, PLANNED, study)
    said = [line for line in text.splitlines() if line.startswith("**")]
    assert [line.partition("`")[2].partition("`")[0] for line in said] == [STAB, STEER, EVADE]
    assert said[0].startswith(f"**`{STAB}` hard: learning loses.** The best learner, PPO (`agents.ppo`), saves 5.8")
    assert "5.8 points less than `lqr`; no score" in said[0]
    assert "no learner is surely better" in said[1]
    assert "with parameters of then, which saved 70.0 %" in said[1]
    assert "learning wins.** The best learner, PPO (`agents.ppo`), saves 10.0 points more than `lqr`." in said[2]
    losing = [row[1] for row in rows(tables.trainings(CELLS, study)) if "loses" in row[4]]
    assert losing == ["SAC (Stable-Baselines3)", "PPO (`agents.ppo`)", "PPO (Stable-Baselines3)"]
    assert "loses" not in "".join(rows(tables.trainings(CELLS, study))[4])


def test_all_drivers_stand_beneath_each_other(study):
    last = tables.drivers(CELLS, STUDY, PLANNED, study).split("\n\n**")[-1]
    found = {row[0]: row[1:] for row in rows(last)}
    assert [*found][1:] == [
        *("uncontrolled", "`lqr`, as shipped", "`lqr`, tuned", "MPC, told nothing"),
        *("PPO (`agents.ppo`)", "PPO (Stable-Baselines3)", "best found"),
    ]
    assert found["MPC, told nothing"][0] == "100 starts"
    assert found["MPC, told nothing"][4:] == ["-", "-", "4.0 [2.0, 6.0]"]
    assert found["`lqr`, tuned"] == [
        *("2000 starts", "70.0 [68.0, 72.0]", "90.0 [88.0, 92.0]", "70.0 [70.0, 70.0]"),
        *("0.00 [-0.10, 0.10]", "30.0 [30.0, 30.0]", "-"),
    ]
    assert found["best found"][0] == "200 starts"
    assert found["best found"][4:] == ["1", "-", "-"]
    assert found["PPO (Stable-Baselines3)"][-1].endswith("**loses**")


def test_a_learner_s_score_and_regret_are_the_interquartile_means_of_the_seeds(study):
    (row,) = (one for one in rows(tables.drivers(CELLS[:1], STUDY, {}, study)) if one[0] == "PPO (`agents.ppo`)")
    known = scores.known_of(EVADE, "hard", study)
    ones = CELLS[0]["trainings"]
    score = benchmark.over_seeds([known.score(one["success_rate"]["value"]) for one in ones])
    regret = benchmark.over_seeds([known.regret(one["episode_return"]["value"]) for one in ones])
    assert row[1] == "4 seeds"
    assert row[5:7] == [tables.figure(score, form=".2f"), tables.figure(regret)]


def test_the_time_to_the_best_found_and_how_many_came_there(study):
    one = cell(EVADE, "hard", "native-ppo", [0.89, 0.9, 0.5], seconds=100.0)
    row = rows(tables.trainings([one], study))[1]
    assert row[2:4] == ["3", "50.0 to 90.0"]
    assert row[5:7] == ["3", "101, 100 to 102"]
    assert row[7] == "50, 2 of 3 seeds"
    assert rows(tables.trainings([cell(EVADE, "hard", "native-ppo", [0.5])], study))[1][7] == "0 of 1 seeds"
    assert rows(tables.trainings([cell(EVADE, "easy", "native-ppo", [0.5])], study))[1][7] == "-"


def test_a_level_without_a_study_has_a_block_all_the_same(study):
    text = tables.drivers([cell(EVADE, "easy", "someone-s-own", [0.8, 0.9])], STUDY, PLANNED, study)
    assert [row[0] for row in rows(text)] == ["driver", "`someone-s-own`"]


def test_a_curve_is_the_seeds_at_the_same_steps():
    slow = {"curve": [[100, 10.0, 0.0], [300, 30.0, 0.4], [500, 50.0, 0.8]]}
    fast = {"curve": [[200, 10.0, 0.2], [400, 20.0, 0.4], [600, 30.0, 1.0]]}
    found = benchmark_picture.Curves([slow, fast])
    assert found.steps.tolist() == [300.0, 500.0]
    assert found.least == pytest.approx([0.3, 0.7])
    assert found.most == pytest.approx([0.4, 0.8])
    assert found.mean == pytest.approx([0.35, 0.75])
    assert found.seconds == pytest.approx([22.5, 37.5])


def test_the_picture_has_a_row_for_each_id_and_level(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(benchmark_picture, "save", lambda figure, path, _: drawn.append((figure, path)))
    path = tmp_path / "benchmark.json"
    far = cell(STAB, "hard", "policy-search", [0.6], steps=60e6)
    path.write_text(json.dumps({"cells": {str(k): one for k, one in enumerate((*CELLS, far))}}))
    monkeypatch.setattr("sys.argv", ["benchmark_picture", str(path)])
    benchmark_picture.main()
    ((figure, place),) = drawn
    assert Path(place).name == "benchmark.png"
    assert len(figure.axes) == 9
    assert [axis.get_ylabel().split()[0] for axis in figure.axes[::3]] == [EVADE, STEER, STAB]
    assert [axis.get_xscale() for axis in figure.axes[6:8]] == ["log", "linear"]
    said = [text.get_text() for text in figure.legends[0].get_texts()]
    assert said == ["PPO (agents.ppo)", "evolution strategy (agents.policy_search)", "PPO (Stable-Baselines3)",
                    "SAC (Stable-Baselines3)", "best classical controller, tuned"]  # fmt: skip
    ends = figure.axes[2].lines[0]
    np.testing.assert_allclose(ends.get_ydata()[[0, -1]], [85.0, 75.0])


def test_a_claim_stands_with_the_command_that_does_it_again():
    ids = [(STAB, "policy-search"), (STEER, "native-ppo"), (EVADE, "native-ppo")]
    cells = [cell(env_id, "medium", learner, [0.8, 0.81, 0.82]) for env_id, learner in ids]
    found = rows(tables.headlines([cell(STAB, "medium", "native-ppo", [0.7]), *cells]))[1:]
    assert [row[0].partition(":")[0] for row in found] == [f"`{env_id}` medium" for env_id, _ in ids]
    assert found[0][1:3] == ["81.0 [80.0, 82.0], 3 seeds", "11.0 [9.0, 13.0]"]
    assert found[0][3] == f"`python -m agents.benchmark --only {STAB} medium policy-search --seeds 3`"
    words = found[0][3].strip("`").split()[3:]
    args = benchmark.Args(only=tuple(words[1:4]), seeds=int(words[5]))
    assert [one.name for one in benchmark.chosen(args)] == [f"{STAB} medium policy-search"]
    assert found[0][4] == "2, A machine"
