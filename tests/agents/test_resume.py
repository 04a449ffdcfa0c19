"""A run that was stopped and goes on is, to the bit, the run that was not stopped; where it cannot be, it says so."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import stat

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import some_of
from rich.console import Console
from short_runs import arrays, old_checkpoint, start, without_selection
from stable_baselines3.common.vec_env import DummyVecEnv

from agents import run_folder, sb3_state, stopping, train, training
from agents.messages import UserError
from bicycle_env import control, provenance


def curve(folder):
    """The learning curve without its seconds."""
    rows = [row.split(",") for row in (folder / "curve.csv").read_text().splitlines()]
    return [[steps, *means] for steps, _, *means in rows]


def resumes(folder):
    return json.loads((folder / "run.json").read_text())["resumed"]


def learned_alike(one, other):
    """Whether all that a further rollout depends on is the same, whichever policies were the best."""
    a, b = ({name: v for name, v in arrays(run).items() if not name.startswith("best")} for run in (one, other))
    return list(a) == list(b) and all(np.array_equal(a[name], b[name]) for name in a)


def assert_equal(one, other):
    a, b = arrays(one), arrays(other)
    assert list(a) == list(b)
    assert [name for name in a if not np.array_equal(a[name], b[name])] == []
    assert curve(one) == curve(other)
    for name in ("policy.safetensors", "policy.json"):
        assert (one / name).read_bytes() == (other / name).read_bytes()
    first, second = (json.loads((run / "run.json").read_text())["best"] for run in (one, other))
    assert first == second


ALGORITHMS = ("ppo", "sac", "td3")
each = pytest.mark.parametrize("straight", ALGORITHMS, indirect=True, scope="module")
ppo_first = pytest.mark.parametrize("straight", some_of(ALGORITHMS, ["ppo"]), indirect=True, scope="module")


@pytest.fixture(scope="module")
def straight(request, tmp_path_factory):
    return request.param, start(request.param, tmp_path_factory.mktemp("straight") / request.param)


# Before the first rollout's end, in SAC's and TD3's warm-up, after it.
@pytest.mark.parametrize("share", [0.0, 0.3, 0.75])
@ppo_first
def test_a_stopped_run_gives_the_bits_of_a_straight_one(straight, tmp_path, share):
    algo, whole = straight
    total = json.loads((whole / "run.json").read_text())["total_timesteps"]
    folder = tmp_path / "run"
    with pytest.raises(stopping.Stopped, match=r"stopped at \d+ steps; go on with .* --resume") as caught:
        start(algo, folder, stop_at=share * total)
    assert caught.value.code == 143
    assert not (folder / "policy.json").exists()
    start(algo, folder, resume=True)
    assert_equal(folder, whole)
    (entry,) = resumes(folder)
    assert entry["exact"] is True
    assert share * total <= entry["at"] < total


@each
def test_a_run_stopped_twice_and_by_a_kill(straight, tmp_path, monkeypatch):
    algo, whole = straight
    folder = tmp_path / "run"
    saved = []

    class KilledError(BaseException):
        pass

    def save(record, model):
        original(record, model)
        saved.append(model.num_timesteps)
        if len(saved) == 3:
            raise KilledError

    original = train.Record.save
    monkeypatch.setattr(train.Record, "save", save)
    with pytest.raises(KilledError):
        start(algo, folder)
    with pytest.raises(stopping.Stopped):
        start(algo, folder, resume=True, stop_at=0, number=signal.SIGINT)
    start(algo, folder, resume=True)
    assert_equal(folder, whole)
    assert [entry["exact"] for entry in resumes(folder)] == [True, True]


@ppo_first
def test_a_signal_in_the_last_rollout_is_obeyed_and_nothing_is_lost(tmp_path, straight):
    algo, whole = straight
    total = json.loads((whole / "run.json").read_text())["total_timesteps"]
    with pytest.raises(stopping.Stopped):
        start(algo, tmp_path / "run", stop_at=total)
    start(algo, tmp_path / "run", resume=True)
    assert_equal(tmp_path / "run", whole)


@ppo_first
def test_a_signal_before_the_first_rollout(tmp_path, straight, monkeypatch):
    algo, whole = straight
    with monkeypatch.context() as patch:
        patch.setattr(train.Record, "_on_training_start", lambda _: signal.raise_signal(signal.SIGINT))
        with pytest.raises(stopping.Stopped, match="at 0 steps"):
            start(algo, tmp_path / "run")
    start(algo, tmp_path / "run", resume=True)
    assert_equal(tmp_path / "run", whole)


@ppo_first
def test_another_seed_gives_other_bits(straight, tmp_path):
    algo, whole = straight
    other = start(algo, tmp_path / "run", seed=4)
    assert (other / "policy.safetensors").read_bytes() != (whole / "policy.safetensors").read_bytes()


def test_a_longer_run_says_what_is_other_than_in_one_that_was_to_be_as_long(tmp_path):
    """Without a decaying rate the learner is the same to the bit, but other policies of it were to be chosen from."""
    said = io.StringIO()
    rate, chosen = "the decaying learning rate was", "the policies to choose from were those of a run"
    for algo, half, words in (("ppo", 512, rate), ("sac", 240, chosen)):
        folder, total = start(algo, tmp_path / algo, total_timesteps=half), 2 * half
        start(algo, folder, resume=True, total_timesteps=total, console=Console(file=said))
        whole = start(algo, tmp_path / f"{algo}-straight", total_timesteps=total)
        (entry,) = resumes(folder)
        assert entry == {"at": half, "exact": False, "reason": f"{words} to end at {half} steps"}
        assert learned_alike(folder, whole) is (algo == "sac")
    assert said.getvalue().count("note: the run goes on, but not to the bit") == 2


@ppo_first
def test_assessing_changes_nothing_of_what_is_learned(straight, tmp_path, monkeypatch):
    algo, whole = straight
    monkeypatch.setattr(training, "ASSESSMENTS", 1)
    folder = start(algo, tmp_path / "run")
    assert len(curve(folder)) <= 1 + 1 < len(curve(whole))
    assert learned_alike(folder, whole)


def test_the_best_policy_is_kept_and_not_the_last(tmp_path, monkeypatch):
    at_rollout = train.Record.at_rollout

    def spoil(record):
        if record.num_timesteps > 600:
            with torch.no_grad():
                record.model.policy.action_net.weight.fill_(100.0)
        return at_rollout(record)

    monkeypatch.setattr(train.Record, "at_rollout", spoil)
    with pytest.raises(stopping.Stopped):
        start("ppo", tmp_path / "run", stop_at=900)
    folder = start("ppo", tmp_path / "run", resume=True)
    best, (_, *rows) = json.loads((folder / "run.json").read_text())["best"], curve(folder)
    assert best["timesteps"] <= 600 < int(rows[-1][0])
    assert best["episode_return"] > max(float(row[2]) for row in rows if int(row[0]) > 600)
    assert np.max(np.abs(control.load(folder).arrays()["layer1.weight"])) < 1.0


def test_who_watches_sees_the_curve_and_may_end_the_run(tmp_path):
    class EnoughError(Exception):
        pass

    def watch(*point):
        seen.append(point)
        if len(seen) == 3:
            raise EnoughError

    seen = []
    with pytest.raises(EnoughError):
        start("ppo", tmp_path / "run", watch=watch)
    assert not (tmp_path / "run" / "policy.json").exists()
    folder = start("ppo", tmp_path / "whole", watch=lambda *point: seen.append(point))
    assert seen[:3] == seen[3:6]
    assert [f"{steps},{success:.4f},{gained:.3f}" for steps, success, gained in seen[3:]] == [
        ",".join(row[:3]) for row in curve(folder)[1:]
    ]


def test_an_environment_without_snapshot(tmp_path, monkeypatch):
    def one_by_one(env):
        return DummyVecEnv([lambda: gym.make("BicycleStab-v0")] * env.num_envs)

    monkeypatch.setattr(train, "SB3VecEnv", one_by_one)
    with pytest.raises(stopping.Stopped):
        start("ppo", tmp_path / "run", stop_at=500)
    said = io.StringIO()
    with pytest.raises(stopping.Stopped):
        start("ppo", tmp_path / "run", resume=True, stop_at=0, console=Console(file=said))
    assert resumes(tmp_path / "run")[0] == {"at": 512, "exact": False, "reason": sb3_state.NO_SNAPSHOT}
    assert sb3_state.NO_SNAPSHOT in said.getvalue()


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("versions", {"stable-baselines3": "2.4.0"}, "stable-baselines3 was 2.4.0 and is"),
        ("machine", "a slide rule", "the machine was a slide rule"),
        ("git", "0123", "the revision was 0123"),
    ],
)
def test_other_versions_and_machines_are_said(tmp_path, monkeypatch, key, value, words):
    made_by = provenance.collect()
    merged = {**made_by["versions"], **value} if key == "versions" else value
    with monkeypatch.context() as patch:
        patch.setattr(provenance, "collect", lambda: {**made_by, key: merged})
        with pytest.raises(stopping.Stopped):
            start("ppo", tmp_path / "run", stop_at=0)
    with pytest.raises(stopping.Stopped):
        start("ppo", tmp_path / "run", resume=True, stop_at=0)
    (entry,) = resumes(tmp_path / "run")
    assert entry["exact"] is False
    assert words in entry["reason"]


@pytest.mark.parametrize("algo", ["ppo", "sac"])
@pytest.mark.parametrize("place", ["checkpoint", "checkpoint.old"])
def test_a_checkpoint_of_an_earlier_revision_goes_on_with_a_remark(tmp_path, algo, place):
    folder = tmp_path / "run"
    with pytest.raises(stopping.Stopped):
        start(algo, folder, stop_at=300)
    old_checkpoint(folder)
    if place != "checkpoint":  # a kill between the two renames of that time
        (folder / "checkpoint").rename(folder / place)
        shutil.copytree(folder / place, folder / "checkpoint.new")
    weights = torch.load(folder / place / "model.pt", weights_only=True)["policy"]
    loaded = []
    with pytest.MonkeyPatch.context() as patch:
        learn = train._learn

        def look(model, *arguments, **keywords):
            loaded.append({name: tensor.clone() for name, tensor in model.policy.state_dict().items()})
            learn(model, *arguments, **keywords)

        patch.setattr(train, "_learn", look)
        with pytest.raises(stopping.Stopped):
            start(algo, folder, resume=True, stop_at=0)
    assert all(torch.equal(loaded[0][name], weights[name]) for name in weights)
    (entry,) = resumes(folder)
    assert entry["exact"] is False
    assert "earlier revision" in entry["reason"]
    names = sorted(path.name for path in (folder / "checkpoint").iterdir())
    assert names[0] == "progress.json"
    assert len(names) == 2
    assert not (folder / "checkpoint.old").exists()
    assert not (folder / "checkpoint.new").exists()


@ppo_first
def test_a_checkpoint_of_before_the_best_was_kept_goes_on_to_the_bit_and_chooses_from_there(straight, tmp_path):
    algo, whole = straight
    total, folder = json.loads((whole / "run.json").read_text())["total_timesteps"], tmp_path / "run"
    with pytest.raises(stopping.Stopped):
        start(algo, folder, stop_at=total // 2)
    without_selection(folder)
    start(algo, folder, resume=True)
    (entry,) = resumes(folder)
    assert entry["exact"] is False
    assert entry["reason"] == "the checkpoint is of an earlier revision, and the best policy is chosen from here on"
    assert learned_alike(folder, whole)
    header, *rows = curve(folder)
    assert [header, *rows[-3:]] == [curve(whole)[0], *curve(whole)[-3:]]
    assert int(rows[0][0]) >= entry["at"], "no point is of training episodes"
    assert json.loads((folder / "run.json").read_text())["best"]["timesteps"] >= entry["at"]


@ppo_first
@pytest.mark.parametrize("resume", [True, False])
@pytest.mark.parametrize("record", [None, "", "full"])
def test_a_folder_that_was_killed_before_its_first_checkpoint_starts_from_the_beginning(
    tmp_path, straight, record, resume
):
    algo, whole = straight
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / ".lock").touch()
    (folder / ".run.json.0123456789abcdef.partial").write_text("{")
    (folder / "checkpoint").mkdir()
    (folder / "checkpoint" / ".progress.json.0123456789abcdef.partial").write_text("{")
    if record is not None:
        content = json.loads((whole / "run.json").read_text()) | {"finished": False}
        (folder / "run.json").write_text(json.dumps(content) if record else "")
    start(algo, folder, resume=resume)
    assert (folder / "policy.safetensors").read_bytes() == (whole / "policy.safetensors").read_bytes()
    assert resumes(folder) == []
    assert not list(folder.rglob("*.partial"))


@pytest.mark.parametrize("resume", [True, False])
def test_a_second_training_in_the_folder_is_refused(tmp_path, resume):
    with run_folder.held(tmp_path / "run"):
        with pytest.raises(UserError, match="another training is at work") as caught:
            start("ppo", tmp_path / "run", resume=resume)
        assert "\n" not in str(caught.value)
    with pytest.raises(stopping.Stopped):  # now it begins
        start("ppo", tmp_path / "run", resume=resume, stop_at=0)


def test_files_have_the_modes_that_the_umask_leaves(tmp_path):
    before = os.umask(0o027)
    try:
        folder = start("ppo", tmp_path / "run")
    finally:
        os.umask(before)
    own = [path for path in folder.rglob("*") if path.is_file() and "tensorboard" not in path.parts]
    assert {stat.S_IMODE(path.stat().st_mode) for path in own} == {0o640}


@ppo_first
def test_nothing_to_do_is_one_line_and_changes_nothing(tmp_path, straight):
    algo, whole = straight
    before = (whole / "run.json").read_bytes()
    with pytest.raises(UserError, match="larger --total-timesteps"):
        start(algo, whole, resume=True, total_timesteps=100)
    assert (whole / "run.json").read_bytes() == before


def test_a_training_that_diverges_is_one_line_and_keeps_its_last_checkpoint(tmp_path, monkeypatch):
    at_rollout = train.Record.at_rollout

    def spoil(record):
        if record.num_timesteps == 1024:
            with torch.no_grad():
                record.model.policy.action_net.weight.fill_(np.nan)
        return at_rollout(record)

    monkeypatch.setattr(train.Record, "at_rollout", spoil)
    with pytest.raises(UserError, match=r"diverged: after 1024 steps .*, of (\d+) steps, is kept") as caught:
        start("ppo", tmp_path / "run")
    monkeypatch.undo()
    progress = json.loads((tmp_path / "run" / "checkpoint" / "progress.json").read_text())
    assert f"of {progress['timesteps']} steps, is kept" in str(caught.value)
    assert all(np.all(np.isfinite(array)) for array in arrays(tmp_path / "run").values())
    start("ppo", tmp_path / "run", resume=True)
