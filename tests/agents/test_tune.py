"""Tuning by command: a file of parameters that a controller drives with."""

from __future__ import annotations

import json

import gymnasium as gym
import pytest

import bicycle_env  # noqa: F401
from agents import tune
from agents.evaluate import find_policy
from agents.messages import UserError
from bicycle_env import control


def run(monkeypatch, *words):
    monkeypatch.setattr("sys.argv", ["tune", *words])
    monkeypatch.setattr(tune, "TUNING_STARTS", 4)
    monkeypatch.setattr(tune, "SELECTION_STARTS", 8)
    tune.main()


@pytest.mark.parametrize(
    ("controller", "env_id", "keywords", "parameter"),
    [
        ("lqr", "BicycleStab-v0", {"friction": 0.4}, "yaw rate"),
        ("rear-linear", "BicycleActiveSteer-v0", {"observed": "state"}, "driver command"),
    ],
)
def test_the_file_is_a_policy(controller, env_id, keywords, parameter, tmp_path, monkeypatch, capsys):
    out, given = tmp_path / "tuned.json", json.dumps(keywords)
    words = ["--env-id", env_id, "--env-keywords", given, "--controller", controller, "--restarts", "2"]
    run(monkeypatch, *words, "--iterations", "1", "--seed", "3", "--out", str(out))
    shown = capsys.readouterr().out
    for word in ("restart 1", "shipped", "success of the 2 restarts:", parameter, f"--policy {out} --env-keywords"):
        assert word in " ".join(shown.split())
    content = json.loads(out.read_text())
    assert content["env_keywords"] == keywords
    assert (
        f"--env-id {env_id} --controller {controller} --restarts 2 --iterations 1 --seed 3 --env-keywords '{given}'"
        in content["command"]
    )
    assert {"date", "machine", "versions", "git", "seconds", "tuning_starts", "selection_starts"} <= set(content)
    assert len(content["on_selection_starts"]["restarts"]) == 2
    env = gym.make(env_id, **keywords)
    policy, observation = find_policy(str(out), env), env.reset(seed=0)[0]
    expected = control.make(controller, env, parameters=content["parameters"])
    assert type(policy) is type(expected)
    assert (policy.act(observation) == expected.act(observation)).all()
    assert (policy.act(observation) != control.make(controller, env).act(observation)).any() or content[
        "parameters"
    ] == (content["on_selection_starts"]["shipped"]["parameters"])


def test_an_old_file_of_weights_is_a_policy(tmp_path):
    path, env = tmp_path / "weights.json", gym.make("BicycleStab-v0")
    weights = {**control.tuned_weights("stabilise")._asdict(), "lateral_position": 2.0}
    path.write_text(json.dumps({"command": "python -m agents.tune", "weights": weights}))
    assert (find_policy(str(path), env).gain == control.LQR(env.unwrapped, control.Weights(**weights)).gain).all()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--restarts", "0"], "--restarts must be at least 1, got 0"),
        (["--iterations", "0"], "--iterations must be at least 1, got 0"),
        (["--seed", "-1"], "--seed must be at least 0, got -1"),
        (["--env-keywords", '{"speed": -1}'], "speed must be"),
        (["--controller", "lqrr"], "--controller: .*did you mean 'lqr'"),
        (["--controller", "evade-path"], "'evade-path' needs side"),
        (["--env-id", "BicycleStab-v9"], "Ids of this package"),
    ],
)
def test_a_mistake_is_said_before_any_work(words, text, monkeypatch):
    with pytest.raises(UserError, match=text):
        run(monkeypatch, *words)
