"""agents.tune --algo: what a study remembers, what it gives up, how it goes on; trainings here are one line."""

from __future__ import annotations

import dataclasses
import json
import sys
import types
from dataclasses import dataclass
from pathlib import Path

import pytest

from agents import learner_tuning, policy_search, ppo, settings, tune
from agents.messages import UserError

pytest.importorskip("optuna")

ID = "BicycleStab-v0"


@pytest.fixture
def trained(monkeypatch, tmp_path):
    """Success is 1 at a deviation of 0.1, and falls with its distance; gives what was trained."""
    calls = []

    @dataclass
    class Args(policy_search.Args):
        pass

    def train(args, console, watch):
        calls.append(args)
        success = max(0.0, 1.0 - 3.0 * abs(args.deviation - 0.1))
        if args.deviation > 0.25:
            raise UserError("diverged")
        args.out.mkdir(parents=True)
        for k in range(1, 11):
            watch(1000 * k, success * k / 10, 10.0 * success)
        best = {"success_rate": success, "episode_return": 10.0 * success}
        (args.out / "run.json").write_text(json.dumps({"best": best}))

    module = types.ModuleType("stand_in")
    module.Args, module.train = Args, train
    monkeypatch.setitem(sys.modules, "stand_in", module)
    monkeypatch.setitem(learner_tuning.TRAINERS, "policy-search", "stand_in")
    monkeypatch.chdir(tmp_path)
    return calls


def run(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["tune", "--algo", "policy-search", *words])
    tune.main()


@pytest.mark.exhaustive
def test_a_study_finds_the_better_goes_on_and_counts(trained, monkeypatch, capsys):
    run(monkeypatch, "--trials", "8")
    assert len(trained) == 8
    usual = settings.usual(policy_search.Args, "policy-search", [])
    assert trained[0].deviation == usual.deviation, "the shipped settings come first"
    assert [args.seed for args in trained] == [learner_tuning.FIRST_SEED + k for k in range(8)]
    run(monkeypatch, "--trials", "14")
    assert len(trained) == 14
    assert len({args.deviation for args in trained}) == 14, "no draw comes twice"
    found = json.loads(Path(f"runs/{ID}-medium-policy-search/tuning.json").read_text())
    best = max((args for args in trained if args.deviation <= 0.25), key=lambda args: -abs(args.deviation - 0.1))
    assert found["settings"]["deviation"] == best.deviation
    assert found["trials"]["complete"] + found["trials"]["pruned"] + found["trials"]["fail"] == 14
    assert found["trials"]["fail"] == sum(args.deviation > 0.25 for args in trained)
    assert found["trials"]["pruned"] > 0
    assert f"--deviation {best.deviation}" in found["train"]
    assert "train with them" in capsys.readouterr().out


@pytest.mark.exhaustive
def test_a_trial_that_was_stopped_does_not_count(trained, monkeypatch):
    kept = sys.modules["stand_in"].train

    def stopped(*arguments):
        raise KeyboardInterrupt

    sys.modules["stand_in"].train = stopped
    with pytest.raises(KeyboardInterrupt):
        run(monkeypatch, "--trials", "2")
    sys.modules["stand_in"].train = kept
    run(monkeypatch, "--trials", "2")
    assert len(trained) == 2


@pytest.mark.exhaustive
def test_a_study_is_of_one_setting(trained, monkeypatch):
    run(monkeypatch, "--trials", "1", "--study", "mine")
    with pytest.raises(UserError, match="--study 'mine' is of another env_id, 'BicycleStab-v0': give another name"):
        run(monkeypatch, "--trials", "2", "--study", "mine", "--env-id", "BicycleEvade-v0")


@pytest.mark.parametrize("algo", learner_tuning.SPACES)
def test_the_spaces_name_options_that_the_settings_allow(algo):
    optuna = pytest.importorskip("optuna")
    for seed in range(5):
        study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=seed))
        chosen = {name: suggest(study.ask()) for name, suggest in learner_tuning.SPACES[algo].items()}
        for name, value in chosen.items():
            settings.OWN[algo][name](name, list(value) if isinstance(value, tuple) else value)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--trials", "0"], "--trials must be at least 1, got 0"),
        (["--storage", "nonsense"], "--storage: "),
        (["--total-timesteps", "0"], "--total-timesteps must be at least 1, got 0"),
    ],
)
def test_a_mistake_is_one_line(words, text, trained, monkeypatch):
    with pytest.raises(UserError, match=text):
        run(monkeypatch, *words)


@pytest.mark.parametrize("env_id", ["BicycleStab-v0", "BicycleActiveSteer-v0", "BicycleEvade-v0"])
def test_what_is_shipped_is_tried_first_as_far_as_the_spaces_hold_it(env_id):
    optuna = pytest.importorskip("optuna")
    usual = settings.usual(ppo.Args, "native-ppo", ["--env-id", env_id])
    found = learner_tuning._enqueued(optuna, usual, "native-ppo")
    assert found["hold"] == usual.hold
    assert found["history"] == usual.history
    beyond = learner_tuning._enqueued(optuna, dataclasses.replace(usual, width=77, hold=99), "native-ppo")
    assert not {"width", "hold"} & set(beyond)
