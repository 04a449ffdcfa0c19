"""Tuning by command: a file of weights that LQR drives with."""

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


def test_the_file_is_a_policy(tmp_path, monkeypatch, capsys):
    out = tmp_path / "weights.json"
    words = ["--env-keywords", '{"friction": 0.4}', "--restarts", "2", "--iterations", "1", "--seed", "3"]
    run(monkeypatch, *words, "--out", str(out))
    shown = capsys.readouterr().out
    for word in ("restart 1", "shipped", "success of the 2 restarts:", "yaw rate"):
        assert word in shown
    content = json.loads(out.read_text())
    assert content["env_keywords"] == {"friction": 0.4}
    assert "--restarts 2 --iterations 1 --seed 3 --env-keywords '{\"friction\": 0.4}'" in content["command"]
    assert {"date", "machine", "versions", "git", "seconds"} <= set(content)
    env = gym.make("BicycleStab-v0", friction=0.4)
    policy = find_policy(str(out), env)
    assert isinstance(policy, control.LQR)
    expected = control.LQR(env.unwrapped, control.Weights(**content["weights"]))
    assert (policy.gain == expected.gain).all()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--restarts", "0"], "--restarts must be at least 1, got 0"),
        (["--iterations", "0"], "--iterations must be at least 1, got 0"),
        (["--seed", "-1"], "--seed must be at least 0, got -1"),
        (["--env-keywords", '{"speed": -1}'], "speed must be"),
        (["--env-id", "BicycleStab-v9"], "Ids of this package"),
    ],
)
def test_a_mistake_is_said_before_any_work(words, text, monkeypatch):
    with pytest.raises(UserError, match=text):
        run(monkeypatch, *words)
