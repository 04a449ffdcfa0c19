"""Publishing: the best by the starts that select, with what it reports; the leaderboard, made of committed files."""

from __future__ import annotations

import json
import sys

import gymnasium as gym
import numpy as np
import pytest

from agents import publishing, scores
from agents.episodes import evaluate, summarise
from agents.messages import UserError
from bicycle_env import control, leaderboard, optimum
from bicycle_env.control.pretrained import published

STAB, STARTS = "BicycleStab-v0", 8


def finished_run(folder, selection, push=0.0, env_id=STAB, **record):
    """A run of a policy that always steers the same."""
    names = list(gym.make(env_id).unwrapped.observation_names)
    layer = np.zeros((2, len(names)), np.float32), np.full(2, push, np.float32)
    description = {"env_id": env_id, "env_keywords": {}, "observation_names": names, "algo": "mine", "seed": 3}
    control.Network([layer], "tanh", "clip", description).save(folder)
    best = {"success_rate": selection, "episode_return": 1.0, "timesteps": 7, "starts": 500}
    content = {"env_id": env_id, "env_keywords": {}, "algo": "mine", "seed": 3, "git": "abc", "best": best, **record}
    (folder / "run.json").write_text(json.dumps(content))
    return folder


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """Two runs, of which the one that reports worse was selected."""
    folder = tmp_path_factory.mktemp("published")
    worse, better = finished_run(folder / "worse", 0.7, 1.0), finished_run(folder / "better", 0.6)
    publishing.publish([better, worse], "medium", folder / "out", STARTS, "the command")
    return folder / "out"


def test_the_best_is_chosen_by_the_starts_that_select(out):
    policy = control.load(out / "BicycleStab-v0-medium")
    assert np.array_equal(policy.act(np.zeros(8, np.float32)), [1.0, 1.0])
    said = policy.description
    returns = [run["episode_return"]["value"] for run in said["runs"]]
    assert returns[0] < returns[1]
    assert [run["selection"]["success_rate"] for run in said["runs"]] == [0.7, 0.6]
    assert (said["level"], said["env_keywords"], said["command"]) == ("medium", {"level": "medium"}, "the command")
    assert said["training"]["git"] == "abc" != said["git"]
    assert set(said["score"]) == {"starts", "seed", "success_rate", "episode_return", "score", "best_found"}


def test_a_worse_policy_does_not_take_the_place_of_a_better_one(out, tmp_path):
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with pytest.raises(UserError, match=r"has a better policy: 70\.0 % of the starts that select, .* 69\.0 %"):
        publishing.publish([finished_run(tmp_path / "run", 0.69)], "medium", out, STARTS)
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("keywords", [{}, {"level": "medium"}, {"friction": 0.5}])
def test_a_run_is_published_for_the_level_that_it_was_trained_at(tmp_path, keywords):
    run = finished_run(tmp_path / "run", 0.5, env_keywords=keywords)
    with pytest.raises(UserError, match=r"was trained and selected with .*, not at level hard"):
        publishing.publish([run], "hard", tmp_path / "out", STARTS)
    assert not (tmp_path / "out").exists()


def test_the_score_is_what_an_evaluation_reports(out):
    said = control.load(out / "BicycleStab-v0-medium").description["score"]
    env = gym.make(STAB, level="medium", telemetry=True)
    found = summarise(evaluate(env, control.load(out / "BicycleStab-v0-medium"), STARTS, publishing.SEED))
    for name in ("success_rate", "episode_return"):
        for part in ("value", "interval"):
            assert said[name][part] == json.loads(json.dumps(found[name][part]))
    known = scores.known(env)
    assert (said["score"], said["best_found"]) == (known.score(0.0), known.reference_success)


def test_the_leaderboard_has_it_among_the_classical(out):
    content = leaderboard.read(out / "leaderboard.json")
    rows = content["levels"]["BicycleStab-v0 medium"]["rows"]
    assert [(row["name"], row["kind"], row["starts"]) for row in rows[2:]] == [
        ("pretrained", "policy", STARTS),
        ("best found", "reference", 200),
    ]
    assert {(row["name"], row["kind"]) for row in rows[:2]} == {
        ("lqr, tuned", "classical"),
        ("lqr, as shipped", "classical"),
    }
    assert rows[0]["success_rate"]["value"] >= rows[1]["success_rate"]["value"]
    assert content["command"] == "the command"
    hard = {row["name"]: row for row in content["levels"]["BicycleEvade-v0 hard"]["rows"]}
    known = scores.known_of("BicycleEvade-v0", "hard")
    assert hard["evade-path, tuned"]["score"] == known.score(hard["evade-path, tuned"]["success_rate"]["value"])
    assert hard["best found without knowing"]["score"] == pytest.approx(1.0)
    assert not {name for name in hard if "knows" in name}
    assert "pretrained" in leaderboard.as_text(leaderboard.of_id(content["levels"], STAB))


def test_the_committed_leaderboard_is_that_of_the_committed_results():
    made = json.loads(json.dumps(publishing.levels()))
    assert made == leaderboard.read()["levels"], "run python -m agents.publishing"


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("env_id", "level"), [(env_id, level) for env_id, levels in published().items() for level in levels]
)
def test_a_committed_policy_does_what_it_says(env_id, level):
    network = control.load_policy(env_id, level)
    said = network.description["score"]
    cars = optimum.Cars(env_id, {"level": level})
    driven = publishing.figures(network, cars, env_id, level, said["starts"])
    assert driven["starts"] == said["starts"]
    for figure in (
        "success_rate",
        "on_road_rate",
        "episode_return",
    ):  # a matrix product is rounded as a machine likes it
        if figure in said:
            assert driven[figure]["value"] == pytest.approx(said[figure]["value"], rel=0.005, abs=0.005)


@pytest.mark.parametrize(
    ("change", "level", "match"),
    [
        ({"best": None}, "medium", "no finished run of a trainer that keeps its best policy: .*best must be a table"),
        ({}, "mediun", "--level: .*did you mean 'medium'"),
        ({"env_id": "BicycleEvade-v0"}, "medium", "the runs must be of one id, got BicycleEvade-v0, BicycleStab-v0"),
    ],
)
def test_what_cannot_be_published_is_one_line(tmp_path, change, level, match):
    runs = [finished_run(tmp_path / "a", 0.5), finished_run(tmp_path / "b", 0.5)]
    content = json.loads((runs[1] / "run.json").read_text())
    (runs[1] / "run.json").write_text(json.dumps({**content, **change}))
    with pytest.raises(UserError, match=match):
        publishing.publish(runs, level, tmp_path / "out", STARTS)
    assert not (tmp_path / "out").exists()


def test_a_policy_that_does_not_fit_the_level_is_refused(tmp_path):
    run = finished_run(tmp_path / "a", 0.5)
    (run / "run.json").write_text((run / "run.json").read_text().replace(STAB, "BicycleLaneChange-v0"))
    with pytest.raises(UserError, match="was trained for BicycleStab-v0 with 8 observations"):
        publishing.publish([run], "medium", tmp_path / "out", STARTS)


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--level", "medium"], "--level needs runs"),
        (["run"], "--level must say"),
        (["none", "--level", "easy"], "none"),
    ],
)
def test_the_command_asks_for_what_is_missing(tmp_path, monkeypatch, words, match):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["publishing", *words, "--out", "out"])
    with pytest.raises(UserError, match=match):
        publishing.main()


def test_the_command_without_runs_writes_the_leaderboard(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["publishing", "--out", str(tmp_path / "out")])
    publishing.main()
    assert "pretrained" not in (tmp_path / "out" / "leaderboard.json").read_text()
    assert leaderboard.read(tmp_path / "out" / "leaderboard.json")["command"].startswith("python -m agents.publishing")
    assert "leaderboard.json" in capsys.readouterr().out
