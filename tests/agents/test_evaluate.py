"""The evaluation command: a table, a file, and one line for a mistake."""

from __future__ import annotations

import io
import itertools
import json
import math
import runpy
import signal
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from combinations import only_all, some_of
from rich.console import Console

import bicycle_env  # noqa: F401
from agents import episodes, scores, stopping
from agents.episodes import PURPOSES, drive, evaluate, start_seeds, summarise
from agents.evaluate import COLUMNS, columns_of, main, named, print_table
from agents.messages import UserError
from bicycle_env import control

ROOT = Path(__file__).parents[2]


def command(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *words], cwd=ROOT, capture_output=True, text=True, check=False, env=None
    )


def test_the_command_prints_a_table_and_writes_a_file(tmp_path, monkeypatch, capsys):
    out = tmp_path / "figures.json"
    words = ["--episodes", "5", "--policy", "lqr", "preview+sano", "--json", str(out)]
    monkeypatch.setattr(sys, "argv", ["evaluate", *words])
    main()
    printed = capsys.readouterr().out
    for word in ("lqr", "preview+sano", "success", "return", "sideslip", "steering", "[deg]", "95 % interval"):
        assert word in printed
    content = json.loads(out.read_text())
    assert content["policies"]["lqr"]["episodes"] == 5
    assert "--episodes 5" in content["command"]
    assert set(content["policies"]) == {"lqr", "preview+sano"}


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--policy", "lrq"], "did you mean 'lqr'? There is no folder 'lrq' of a trained policy either."),
        only_all(["--policy", "sano"], "needs a driver at the front: 'preview+sano'"),
        only_all(["--policy", "preview", "--env-keywords", '{"steer": "rear"}'], "steer must be"),
        only_all(["--env-id", "BicycleStab-v9"], "Ids of this package"),
        only_all(["--env-keywords", '{"speed": -1}'], "speed must be"),
        only_all(["--episodes", "0"], "--episodes"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(words, text):
    done = command("agents.evaluate", *words)
    assert done.returncode == 2
    assert text in done.stderr
    assert "Traceback" not in done.stderr


HELPED = ["train", "ppo", "policy_search", "evaluate", "benchmark", "seeds", "demo", "tune", "headroom", "publishing"]
HELPED += [
    "benchmark_picture",
    "collect",
    "jobs",
    "ppo_jax",
    "train_rllib",
    "mpc_headroom",
    "robustness",
    "moving_picture",
]


def help_of(module, monkeypatch, capsys):
    """What ``python -m agents.MODULE --help`` prints, run as Python would run it, but in this process."""
    before = {number: signal.getsignal(number) for number in stopping.SIGNALS}
    monkeypatch.setattr(sys, "argv", ["", "--help"])
    try:
        with pytest.raises(SystemExit) as left:
            runpy.run_module(f"agents.{module}", run_name="__main__", alter_sys=True)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert not left.value.code
    return capsys.readouterr().out


@pytest.mark.filterwarnings("ignore:'agents.* found in sys.modules:RuntimeWarning")
@pytest.mark.parametrize("module", some_of(HELPED, []))
def test_help_teaches(module, monkeypatch, capsys):
    assert f"python -m agents.{module}" in help_of(module, monkeypatch, capsys)


@pytest.mark.filterwarnings("ignore:'agents.* found in sys.modules:RuntimeWarning")
def test_help_lists_every_controller(monkeypatch, capsys):
    printed = help_of("evaluate", monkeypatch, capsys)
    for name, text in control.descriptions().items():
        (line,) = [line for line in printed.splitlines() if line.split()[:1] == [name]]
        assert line.endswith(text)
    assert "preview+sano" in printed


def test_all_policies_drive_from_the_same_starts():
    env = gym.make("BicycleStab-v0", telemetry=True)
    states = []
    for _ in range(2):
        for seed in start_seeds(3, 7):
            env.reset(seed=seed)
            states.append(env.unwrapped.state)
    assert states[:3] == states[3:]
    assert start_seeds(3, 7) != start_seeds(3, 8)


def test_starts_of_different_purposes_are_different():
    many = {purpose: set(start_seeds(1000, 1, purpose)) for purpose in PURPOSES}
    assert start_seeds(1000, 1) == start_seeds(1000, 1, "report")
    assert start_seeds(2, 1) == [1835504127, 1731038949]  # those of every table so far
    for one, other in itertools.combinations(PURPOSES, 2):
        assert not many[one] & many[other]
    # They are different for any two seeds: the purpose stands above the random bits.
    assert {seed >> 32 for purpose in PURPOSES for seed in many[purpose]} == {0, 1, 2, 3}


def policy_file(env):
    """A network that steers against what it sees, a little."""
    names = env.unwrapped.observation_names
    weight = np.random.default_rng(0).normal(size=(env.action_space.shape[0], len(names))).astype(np.float32)
    layer = 0.3 * weight, np.zeros(len(weight), np.float32)
    return control.Network([layer], "tanh", "tanh", {"observation_names": list(names), "hold": 2, "history": 1})


@pytest.mark.parametrize(
    ("env_id", "keywords", "names"),
    [
        ("BicycleStab-v0", {"max_episode_steps": 150}, ("lqr", "stanley+zero-sideslip", None)),
        only_all("BicycleLaneChange-v0", {"level": "hard"}, ("lqg", "lqr", "preview", None)),
        only_all("BicycleActiveSteer-v0", {"action_repeat": 2}, ("rear-switched", None)),
        only_all("BicycleEvade-v0", {"level": "hard", "reward": "quadratic"}, ("evade-path", None)),
    ],
)
def test_many_at_once_are_one_after_the_other(env_id, keywords, names, monkeypatch):
    """Every figure of every episode, to the bit; in groups, the last one not full."""
    monkeypatch.setattr(episodes, "FEW", 0)
    env, ends = gym.make(env_id, telemetry=True, **keywords), set()
    for name in names:
        policy = policy_file(env) if name is None else control.make(name, env)
        told = []
        monkeypatch.setattr(episodes, "CAR_STEPS", 8 * env.spec.max_episode_steps)
        many = evaluate(env, policy, 15, 1, told.append)
        monkeypatch.setattr(episodes, "CAR_STEPS", 1)
        alone = evaluate(env, policy, 15, 1)
        assert told == [8, 15]
        assert many == alone
        assert json.dumps(summarise(many)) == json.dumps(summarise(alone))
        ends |= {episode.end for episode in alone}
    assert "" in ends
    assert len(ends) > 1


def test_who_may_not_drive_many_drives_one_after_the_other(monkeypatch):
    env = gym.make("BicycleStab-v0", telemetry=True, max_episode_steps=30)
    mine = type("Mine", (control.LQR,), {})(env.unwrapped)
    monkeypatch.setattr(episodes, "_drive_many", lambda *_: pytest.fail("driven at once"))
    assert len(evaluate(env, mine, 21, 1)) == 21
    flipped = gym.wrappers.TransformObservation(env, np.negative, env.observation_space)
    assert len(evaluate(flipped, control.make("lqr", env), 21, 1)) == 21
    with pytest.raises(pytest.fail.Exception, match="driven at once"):
        evaluate(env, control.make("lqr", env), 21, 1)


def test_on_the_road_is_not_success():
    """With a time limit shorter than a car takes to settle, nobody succeeds, and some are still on the road."""
    env = gym.make("BicycleStab-v0", telemetry=True, max_episode_steps=40)
    driven = evaluate(env, control.make("lqr", env), 10, 1)
    on_road = [episode.on_road for episode in driven]
    assert not any(episode.success for episode in driven)
    assert on_road == [episode.end == "" for episode in driven]
    assert 0 < sum(on_road) < 10
    assert summarise(driven)["on_road_rate"]["value"] == sum(on_road) / 10
    assert any(key == "on_road_rate" for key, *_ in COLUMNS)


def test_figures_of_an_episode_by_hand():
    env = gym.make("BicycleStab-v0", telemetry=True)
    episode = drive(env, control.make("zero", env.unwrapped), start_seeds(1, 0)[0])
    assert episode.metrics["steering_effort"] == 0.0
    assert not episode.success
    assert episode.end in ("spun", "left_lane")
    assert "overshoot" not in episode.metrics
    assert episode.metrics["seconds"] < 8.0
    again = drive(env, control.make("zero", env.unwrapped), start_seeds(1, 0)[0])
    assert again == episode


def test_lane_change_metrics():
    env = gym.make("BicycleLaneChange-v0", telemetry=True)
    driven = evaluate(env, control.make("lqr", env.unwrapped), 3, 5)
    for episode in driven:
        assert episode.success
        assert 0.0 <= episode.metrics["overshoot"] < 0.5
        assert 1.0 < episode.metrics["settling_time"] < 4.0
        assert episode.metrics["peak_lateral_acceleration"] < 9.81
    stays = drive(env, control.make("zero", env.unwrapped), start_seeds(1, 5)[0])
    assert stays.metrics["settling_time"] is None
    summary = summarise(driven)
    assert summary["settling_time"]["of"] == 3
    assert summary["success_rate"]["value"] == 1.0
    assert math.isclose(
        summary["episode_return"]["value"], sum(episode.episode_return for episode in driven) / 3, rel_tol=1e-12
    )


def test_a_policy_for_another_environment_is_refused(tmp_path):
    from agents.evaluate import find_policy

    names = ["lateral_position"]
    control.Network(
        [(np.zeros((2, 1), np.float32), np.zeros(2, np.float32))],
        "tanh",
        "clip",
        {"env_id": "Other-v0", "observation_names": names},
    ).save(tmp_path)
    with pytest.raises(UserError, match="trained for Other-v0"):
        find_policy(str(tmp_path), gym.make("BicycleStab-v0"))


def test_an_action_of_ones_own_of_another_shape_is_one_line(tmp_path, monkeypatch):
    (tmp_path / "scalar_law.py").write_text("def steer(observation):\n    return 0.1\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UserError, match=r"scalar_law:steer: an action must have shape \(2,\), got \(\)"):
        named(("scalar_law:steer",), gym.make("BicycleStab-v0"))


@pytest.mark.parametrize(("width", "terminal", "whole"), [(100, True, False), (300, True, True), (100, False, True)])
def test_a_table_too_wide_for_a_terminal_shows_what_every_task_has(width, terminal, whole):
    task = gym.make("BicycleActiveSteer-v0").unwrapped.task
    row = {key: {"value": 0.5, "interval": [0.4, 0.6]} for key, *_ in columns_of(task)}
    out = io.StringIO()
    console = Console(file=out, force_terminal=terminal, width=width, no_color=True, highlight=False, markup=False)
    print_table(console, "figures", {"a-policy": row}, task)
    text = out.getvalue()
    assert "a-policy" in text
    assert "…" not in text
    assert ("also: peak sideslip" in text) == (not whole)
    assert (text.count("0.50") > 5) == whole


def test_classical_is_the_controller_tuned_for_the_level():
    env = gym.make("BicycleEvade-v0", level="hard")
    found = named(("classical", "evade-path"), env)
    assert list(found) == ["evade-path, tuned", "evade-path"]
    expected = scores.tuned("BicycleEvade-v0", "hard", "evade-path")
    tuned, shipped = (set(found[name].values) for name in found)
    assert tuned <= set(expected.values())
    assert not shipped <= set(expected.values())
    with pytest.raises(UserError, match=r"--policy classical: .*headroom.json knows no controller"):
        named(("classical",), gym.make("BicycleStab-v0", speed_ratio=1.37))
    with pytest.raises(UserError, match="at least one policy"):
        named((), env)
