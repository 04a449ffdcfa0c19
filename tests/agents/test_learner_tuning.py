"""agents.tune --algo: what a study remembers, what it gives up, how it goes on; trainings here are one line."""

from __future__ import annotations

import json
import os
import shlex
import sys
import types
from dataclasses import dataclass
from pathlib import Path

import pytest
from combinations import some_of
from rich.console import Console

from agents import learner_tuning, messages, policy_search, ppo, settings, train, training, tune
from agents.learner_spaces import SPACES
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
        for k in range(1, 11):  # after updates whose length is each trial's own
            watch(args.total_timesteps * k // 10 + len(calls), success * k / 10, 10.0 * success)
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
    assert found["trials"]["pruned"] > 0, "trials are compared at the same share of their steps"
    assert learner_tuning.POINTS == training.ASSESSMENTS
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


def drawn(algo):
    """Settings from the spaces, by chance."""
    optuna = pytest.importorskip("optuna")
    for seed in range(5):
        study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=seed))
        yield {name: suggest(study.ask()) for name, suggest in SPACES[algo].items()}


@pytest.mark.parametrize("algo", settings.OWN)
def test_the_spaces_name_options_that_the_settings_allow(algo):
    for chosen in drawn(algo):
        for name, value in chosen.items():
            settings.OWN[algo][name](name, list(value) if isinstance(value, tuple) else value)


def search_of(algo, folder, env_id=ID):
    return learner_tuning.Search(env_id, "{}", algo, 1, None, 0, None, "mine", folder, folder / "found.toml")


@pytest.mark.parametrize("algo", settings.ALGORITHMS)
def test_what_the_spaces_draw_is_a_settings_file(algo, tmp_path):
    trainer, shipped = learner_tuning.trainer_of(search_of(algo, tmp_path)), settings.read(ID, algo)
    for chosen in drawn(algo):
        trainer.write(chosen, "a command\nof two lines")
        read = settings.read(ID, algo, tmp_path / "found.toml")
        assert {**read.model, **read.network} == {**shipped.model, **shipped.network, **chosen}
        assert (read.total_timesteps, read.n_envs) == (shipped.total_timesteps, shipped.n_envs)
    if algo == "ppo":
        for env_id in settings.CONFIGS.glob("*.toml"):  # or SB3 has a batch that is smaller than the others
            assert settings.read(env_id.stem, algo).n_envs * 8 % 4096 == 0


# PPO's 512 cars make more steps in a rollout than the others in a training.
@pytest.mark.parametrize(("algo", "steps"), some_of([("ppo", 33_000), ("sac", 1200), ("td3", 1200)], [("sac", 1200)]))
def test_the_settings_that_were_found_give_the_policy_that_was_found(algo, steps, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(training, "SELECTED", 16)
    monkeypatch.setattr(os, "fsync", lambda _: None)
    words = ["--trials", "2", "--total-timesteps", str(steps), "--out", "found.json"]
    monkeypatch.setattr(sys, "argv", ["tune", "--algo", algo, *words])
    tune.main()
    found = json.loads(Path("found.json").read_text())
    command = f"python -m agents.train --env-id {ID} --algo {algo} --config found.toml"
    assert found["train"] == command
    assert f"{command} --seed 0" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["train", *shlex.split(command)[3:], "--seed", str(found["seed"]), "--quiet"])
    monkeypatch.setattr(messages, "console", lambda: Console(quiet=True))
    train.main()
    again = Path(f"runs/{ID}-{algo}-{found['seed']}")
    trial = Path(f"runs/{ID}-medium-{algo}/trial-{found['seed'] - learner_tuning.FIRST_SEED}")
    assert (again / "policy.safetensors").read_bytes() == (trial / "policy.safetensors").read_bytes()
    best = json.loads((again / "run.json").read_text())["best"]
    assert best["success_rate"] == found["success_rate_on_selection_starts"]
    assert best["starts"] == 16


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--trials", "0"], "--trials must be at least 1, got 0"),
        (["--storage", "nonsense"], "--storage: "),
        (["--total-timesteps", "0"], "--total-timesteps must be at least 1, got 0"),
        (
            ["--algo", "sac", "--total-timesteps", "1", "--out", "found.toml"],
            "--out must not end in .toml",
        ),
    ],
)
def test_a_mistake_is_one_line(words, text, trained, monkeypatch):
    with pytest.raises(UserError, match=text):
        run(monkeypatch, *words)


@pytest.mark.parametrize("env_id", ["BicycleStab-v0", "BicycleActiveSteer-v0", "BicycleEvade-v0"])
def test_what_is_shipped_is_tried_first_as_far_as_the_spaces_hold_it(env_id):
    optuna = pytest.importorskip("optuna")
    usual = settings.usual(ppo.Args, "native-ppo", ["--env-id", env_id])
    found = learner_tuning._enqueued(optuna, vars(usual), "native-ppo")
    assert found["hold"] == usual.hold
    assert found["history"] == usual.history
    beyond = learner_tuning._enqueued(optuna, vars(usual) | {"width": 77, "hold": 99}, "native-ppo")
    assert not {"width", "hold"} & set(beyond)


@pytest.mark.parametrize("algo", settings.ALGORITHMS)
@pytest.mark.parametrize("env_id", [path.stem for path in settings.CONFIGS.glob("*.toml")])
def test_the_first_trial_is_what_is_shipped(algo, env_id, tmp_path):
    """What the file does not say, with the library's default; no weight of the entropy with the least that is tried."""
    optuna = pytest.importorskip("optuna")
    shipped = learner_tuning.trainer_of(search_of(algo, tmp_path, env_id)).shipped
    found = optuna.trial.FixedTrial(learner_tuning._enqueued(optuna, shipped, algo))
    for name, suggest in SPACES[algo].items():
        assert suggest(found) == (1e-6 if name == "ent_coef" else pytest.approx(shipped[name], abs=1e-5))
