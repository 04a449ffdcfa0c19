"""Training writes a folder that tells what the run was, and goes on after a stop."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from rich.console import Console
from stable_baselines3.common.vec_env import DummyVecEnv

import bicycle_env  # noqa: F401
from agents import train, training
from agents.episodes import start_seeds
from agents.messages import UserError
from bicycle_env import control, optimum
from bicycle_env.envs.bicycle_stab import BicycleStabVectorEnv

CONFIG = Path(__file__).parent / "short_runs.toml"
STEPS = {"ppo": 1600, "sac": 400, "td3": 400}


def quick(algo: str, folder: Path, **changes: object) -> train.Args:
    values = {"algo": algo, "seed": 3, "total_timesteps": STEPS[algo], "out": folder, "quiet": True}
    values |= {"config": CONFIG, **changes}
    return train.Args(**values)


@pytest.fixture(autouse=True, scope="module")
def few_starts():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "SELECTED", 16)
        yield


@pytest.fixture(scope="module", params=["ppo", "sac", "td3"])
def run(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / request.param
    train.train(quick(request.param, folder), Console(quiet=True))
    return request.param, folder


def test_a_run_folder_tells_what_the_run_was(run):
    algo, folder = run
    content = json.loads((folder / "run.json").read_text())
    assert content["algo"] == algo
    assert content["seed"] == 3
    assert content["finished"] is True
    assert content["timesteps"] >= STEPS[algo]
    assert content["settings"]["model"]["gamma"] == 0.98
    assert {"python", "gymnasium", "torch", "stable-baselines3", "bicycle-env"} <= set(content["versions"])
    assert content["git"]
    header, *rows = (folder / "curve.csv").read_text().splitlines()
    assert header == train.CURVE_HEADER
    assert int(rows[-1].split(",")[0]) == content["timesteps"]
    assert 5 < len(rows) <= training.ASSESSMENTS + 1, "as many as there are, but where a rollout is longer"
    assert any((folder / "tensorboard").rglob("events.*"))


def test_the_policy_loads_without_unpickling_and_drives(run, monkeypatch):
    _, folder = run

    def refuse(*_, **__):
        raise AssertionError("unpickled")

    monkeypatch.setattr(pickle, "load", refuse)
    monkeypatch.setattr(pickle, "loads", refuse)
    policy = control.load(folder)
    env = gym.make("BicycleStab-v0")
    observation, _ = env.reset(seed=0)
    action = policy.act(observation)
    assert action.shape == (2,)
    assert action.dtype == np.float32
    assert env.action_space.contains(action)


def test_the_policy_is_the_best_of_the_curve_and_drives_as_the_record_says(run):
    _, folder = run
    best = json.loads((folder / "run.json").read_text())["best"]
    rows = [list(map(float, row.split(","))) for row in (folder / "curve.csv").read_text().splitlines()[1:]]
    steps, _, success, mean_return, _ = max(rows, key=lambda row: (row[2], row[3]))
    assert (best["timesteps"], round(best["episode_return"], 3), best["starts"]) == (steps, mean_return, 16)
    assert round(best["success_rate"], 4) == success
    policy = control.load(folder)
    assert policy.description["timesteps"] == steps
    cars = optimum.Cars("BicycleStab-v0", {})
    driven = optimum.drive(cars.of(16), optimum.by(policy), start_seeds(16, training.SELECTION_SEED, "select"))
    assert np.mean(driven.success) == best["success_rate"]
    assert np.mean(driven.episode_return) == best["episode_return"]


def test_keywords_of_many_cars_are_not_those_of_the_starts_that_select(tmp_path):
    folder = tmp_path / "run"
    train.train(quick("ppo", folder, env_keywords='{"threads": 1, "max_episode_steps": 50}'), Console(quiet=True))
    *_, length = (folder / "curve.csv").read_text().split(",")
    assert 0.0 < float(length) <= 50.0


def test_an_existing_run_is_not_overwritten(run):
    algo, folder = run
    before = (folder / "policy.safetensors").read_bytes()
    with pytest.raises(UserError, match="holds a run already"):
        train.train(quick(algo, folder), Console(quiet=True))
    assert (folder / "policy.safetensors").read_bytes() == before


def test_training_on_many_cars_at_once_is_training_on_single_ones(tmp_path, monkeypatch):
    def one_by_one(env):
        assert isinstance(env, BicycleStabVectorEnv)
        assert env.max_episode_steps == 50
        return DummyVecEnv([lambda: gym.make("BicycleStab-v0", max_episode_steps=50)] * env.num_envs)

    def files(folder):
        train.train(quick("ppo", folder, env_keywords='{"max_episode_steps": 50}'), Console(quiet=True))
        curve = [row.split(",") for row in (folder / "curve.csv").read_text().splitlines()]
        return (folder / "policy.safetensors").read_bytes(), [[steps, *means] for steps, _, *means in curve]

    together = files(tmp_path / "together")
    monkeypatch.setattr(train, "SB3VecEnv", one_by_one)
    assert files(tmp_path / "one_by_one") == together


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"resume": True}, "holds no run"),
        ({"total_timesteps": 0}, "total-timesteps"),
        ({"seed": -1}, "seed"),
        ({"env_id": "BicycleStb-v0"}, "BicycleStab-v0"),
        ({"config": Path("nowhere.toml")}, "no settings file"),
        ({"env_keywords": "{"}, "env-keywords"),
        ({"env_keywords": '{"vehicel": 1}'}, "vehicle"),
        ({"env_keywords": '{"render_mode": "human"}'}, "render_mode"),
    ],
)
def test_mistakes_are_one_line(tmp_path, changes, text):
    with pytest.raises(UserError, match=text) as caught:
        train.train(quick("ppo", tmp_path / "run", **changes), Console(quiet=True))
    assert "\n" not in str(caught.value)


def test_resume_refuses_another_seed(tmp_path):
    folder = tmp_path / "run"
    train.train(quick("ppo", folder), Console(quiet=True))
    with pytest.raises(UserError, match="seed"):
        train.train(quick("ppo", folder, seed=4, resume=True), Console(quiet=True))


def test_a_run_does_not_end_before_where_it_is(tmp_path):
    folder = tmp_path / "run"
    train.train(quick("ppo", folder), Console(quiet=True))
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps({**record, "finished": False}))  # as if killed at its end
    before = (folder / "run.json").read_bytes()
    with pytest.raises(UserError, match=r"--total-timesteps must be at least \d+, the steps of the run so far, got 8"):
        train.train(quick("ppo", folder, total_timesteps=8, resume=True), Console(quiet=True))
    assert (folder / "run.json").read_bytes() == before


def test_the_same_seed_gives_the_same_policy(tmp_path):
    for name in ("a", "b"):
        train.train(quick("ppo", tmp_path / name), Console(quiet=True))
    train.train(quick("ppo", tmp_path / "c", seed=4), Console(quiet=True))
    weights = {name: (tmp_path / name / "policy.safetensors").read_bytes() for name in "abc"}
    assert weights["a"] == weights["b"]
    assert weights["a"] != weights["c"]


def test_the_learning_rate_never_turns_negative(tmp_path):
    args = quick("ppo", tmp_path / "run", total_timesteps=1000)
    model = train.build(args, train.settings.read(args.env_id, "ppo"), {}, tmp_path / "tensorboard")
    assert model.lr_schedule(1.0) == 1e-3
    assert model.lr_schedule(0.25) == 2.5e-4
    assert model.lr_schedule(-1.048) == 0.0


def test_a_file_in_the_place_of_the_folder(tmp_path):
    (tmp_path / "run").write_text("mine")
    with pytest.raises(UserError, match="is a file"):
        train.train(quick("ppo", tmp_path / "run"), Console(quiet=True))
    assert (tmp_path / "run").read_text() == "mine"
