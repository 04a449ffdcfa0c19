"""A run of this package's own trainers in its folder: stopped, killed, diverged, damaged; mistakes are one line."""

from __future__ import annotations

import io
import json
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from combinations import only_all, some_of
from rich.console import Console
from test_damaged_checkpoints import bad, cut, in_arrays, in_json, less
from tiny_ppo import MADE_BY, TINY, UPDATE, curve, start

from agents import ppo, run_folder, stopping, train, training
from agents.messages import UserError
from bicycle_env import control
from bicycle_env.files import read_arrays


def record(folder):
    return json.loads((folder / "run.json").read_text())


def checkpoint(folder):
    (path,) = (folder / "checkpoint").glob("state-*")
    return read_arrays(path)


def assert_equal(one, other):
    """The best policy, its file's words, the curve without its seconds, and all that a further update depends on."""
    for name in ("policy.safetensors", "policy.json"):
        assert (one / name).read_bytes() == (other / name).read_bytes()
    assert curve(one) == curve(other)
    assert record(one)["best"] == record(other)["best"]
    ours, theirs = checkpoint(one), checkpoint(other)
    assert list(ours) == list(theirs)
    assert [name for name in ours if not np.array_equal(ours[name], theirs[name])] == []


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    return start(tmp_path_factory.mktemp("straight") / "run")


# A stop loses nothing


# Long before the first point of a longer run's curve; in the middle; in the last update but one.
@pytest.mark.parametrize("stop_at", [only_all(0), 5 * UPDATE, only_all(10 * UPDATE)])
def test_a_stopped_run_gives_the_bits_of_a_straight_one(straight, tmp_path, stop_at):
    folder = tmp_path / "run"
    with pytest.raises(
        stopping.Stopped, match=rf"stopped at {stop_at + UPDATE} steps; go on with .* --resume"
    ) as caught:
        start(folder, stop_at=stop_at)
    assert caught.value.code == 143
    assert not (folder / "policy.json").exists()
    assert record(folder)["finished"] is False
    start(folder, resume=True)
    assert_equal(folder, straight)
    assert record(folder)["resumed"] == [{"at": stop_at + UPDATE, "exact": True}]


def test_a_run_stopped_before_anything_was_assessed(tmp_path):
    longer = 10 * TINY.total_timesteps
    with pytest.raises(stopping.Stopped):
        start(tmp_path / "run", stop_at=0, total_timesteps=longer)
    assert curve(tmp_path / "run") == [["timesteps", "success_rate", "mean_return", "mean_length"]]
    with pytest.raises(stopping.Stopped):
        start(tmp_path / "run", stop_at=0, total_timesteps=longer, resume=True)
    assert [entry["exact"] for entry in record(tmp_path / "run")["resumed"]] == [True]


def test_a_run_of_a_revision_with_fewer_settings_goes_on(straight, tmp_path):
    folder = tmp_path / "run"
    with pytest.raises(stopping.Stopped):
        start(folder, stop_at=0)
    before = record(folder)
    for name in run_folder.LATER:
        del before["settings"][name]
    (folder / "run.json").write_text(json.dumps(before))
    start(folder, resume=True)
    assert_equal(folder, straight)
    assert record(folder)["settings"] == record(straight)["settings"]


@pytest.mark.exhaustive
def test_a_kill_and_two_stops(straight, tmp_path, monkeypatch):
    class KilledError(BaseException):
        pass

    def save(folder, progress, state):
        original(folder, progress, state)
        if progress["timesteps"] > 5 * UPDATE:
            raise KilledError

    original, folder = run_folder.Folder.save, tmp_path / "run"
    monkeypatch.setattr(run_folder.Folder, "save", save)
    with pytest.raises(KilledError):
        start(folder)
    monkeypatch.undo()
    for _ in range(2):
        with pytest.raises(stopping.Stopped):
            start(folder, resume=True, stop_at=0, number=signal.SIGINT)
    start(folder, resume=True)
    assert_equal(folder, straight)
    assert [entry["at"] for entry in record(folder)["resumed"]] == [6 * UPDATE, 7 * UPDATE, 8 * UPDATE]


@pytest.mark.exhaustive
def test_a_kill_between_the_last_checkpoint_and_the_policy(straight, tmp_path, monkeypatch):
    class KilledError(BaseException):
        pass

    def killed(*_):
        raise KilledError

    monkeypatch.setattr(control.Network, "save", killed)
    with pytest.raises(KilledError):
        start(tmp_path / "run")
    monkeypatch.undo()
    start(tmp_path / "run", resume=True)
    assert_equal(tmp_path / "run", straight)


@pytest.mark.parametrize("resume", [True, False])
def test_a_folder_killed_before_its_first_checkpoint_starts_from_the_beginning(straight, tmp_path, resume):
    shutil.copytree(straight, tmp_path / "run", ignore=shutil.ignore_patterns("policy*", "checkpoint", "curve.csv"))
    in_json("run.json", finished=False)(tmp_path / "run")
    start(tmp_path / "run", resume=resume)
    assert_equal(tmp_path / "run", straight)
    assert record(tmp_path / "run")["resumed"] == []


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("versions", {"torch": "1.0"}, "torch was 1.0 and is"),
        ("machine", "a slide rule", "the machine was a slide rule"),
        ("git", "0123", "the revision was 0123"),
    ],
)
def test_other_versions_and_machines_are_said(tmp_path, key, value, words):
    merged, said = {**MADE_BY["versions"], **value} if key == "versions" else value, io.StringIO()
    with pytest.raises(stopping.Stopped):
        start(tmp_path / "run", stop_at=0, made_by={**MADE_BY, key: merged})
    with pytest.raises(stopping.Stopped):
        start(tmp_path / "run", stop_at=0, resume=True, console=Console(file=said, width=1000))
    (entry,) = record(tmp_path / "run")["resumed"]
    assert entry["exact"] is False
    assert words in entry["reason"]
    assert said.getvalue() == f"note: the run goes on, but not to the bit as without the stop: {entry['reason']}\n"


def test_the_best_policy_is_kept_and_not_the_last(tmp_path):
    def spoil(learner, update):
        if update > 6:
            with torch.no_grad():
                learner.policy.layers[-1].weight.fill_(100.0)

    folder = start(tmp_path / "run", spoil=spoil)
    header, *rows = curve(folder)
    assert header == ["timesteps", "success_rate", "mean_return", "mean_length"]
    best = max(range(len(rows)), key=lambda k: (float(rows[k][1]), float(rows[k][2])))
    found = record(folder)["best"]
    assert best < 6
    assert [found["timesteps"], round(found["episode_return"], 3)] == [int(rows[best][0]), float(rows[best][2])]
    assert found["starts"] == 16
    policy = control.load(folder)
    assert policy.description["timesteps"] == found["timesteps"]
    assert np.max(np.abs(policy.arrays()["layer2.weight"])) < 1.0


# Training that diverges


def test_a_training_that_diverges_keeps_its_last_good_checkpoint(straight, tmp_path):
    def spoil(learner, update):
        if update == 8:
            with torch.no_grad():
                learner.critic.layers[0].bias[0] = np.nan

    folder, last = tmp_path / "run", 6 * UPDATE
    with pytest.raises(UserError, match=rf"diverged: after {8 * UPDATE} steps .* of {last} steps, is kept") as caught:
        start(folder, spoil=spoil)
    assert "\n" not in str(caught.value)
    assert json.loads((folder / "checkpoint" / "progress.json").read_text())["timesteps"] == last
    assert all(np.all(np.isfinite(array)) for array in checkpoint(folder).values())
    start(folder, resume=True)
    assert_equal(folder, straight)


def test_a_training_that_diverges_at_once_has_no_checkpoint(tmp_path):
    def spoil(learner, _):
        learner.log_deviation.data.fill_(np.nan)

    with pytest.raises(UserError, match="there is none yet"):
        start(tmp_path / "run", spoil=spoil)
    assert not (tmp_path / "run" / "checkpoint").exists()


# What lies in a folder


def test_a_folder_of_other_files_is_no_place_for_a_run(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(UserError, match="holds other files; choose a new or an empty folder"):
        start(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_log_file_tells_how_far_a_run_is(tmp_path, capsys):
    start(tmp_path / "run", quiet=False)
    lines = [line for line in capsys.readouterr().err.splitlines() if " steps in " in line]
    assert 9 <= len(lines) <= 11
    assert f"{TINY.total_timesteps:,} of {TINY.total_timesteps:,} steps" in lines[-1]
    assert "best saves" in lines[-1]


def test_an_existing_run_is_not_overwritten_and_a_finished_one_does_not_go_on(straight, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(straight, folder, ignore=shutil.ignore_patterns(".lock"))
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(UserError, match="holds a run already"):
        start(folder)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    with pytest.raises(UserError, match=f"the run has finished: {TINY.total_timesteps} steps"):
        start(folder, resume=True)
    (folder / ".lock").unlink()
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def of_an_earlier_revision(folder):
    path = folder / "checkpoint" / "progress.json"
    progress = json.loads(path.read_text())
    path.write_text(json.dumps({key: progress[key] for key in ("timesteps", "seconds", "curve")}))
    (folder / "checkpoint" / "model.pt").touch()


DAMAGES = {
    "another kind": of_an_earlier_revision,
    "progress cut": cut("checkpoint/progress.json"),
    "no curve": in_json("checkpoint/progress.json", curve=None),
    "no digest": in_json("checkpoint/progress.json", digest=None),
    "arrays cut": cut("state"),
    "weights missing": in_arrays(policy__layers__0__weight=None),
    "weights of another shape": in_arrays(critic__layers__0__weight=less),
    "weights NaN": in_arrays(log_deviation=bad(np.nan)),
    "too many": in_arrays(mine=lambda _: np.zeros(3)),
    "moments missing": in_arrays(adam__0__exp_avg=None),
    "moments negative": in_arrays(adam__0__exp_avg_sq=bad(-1.0)),
    "fewer cars": in_arrays(env__rows=lambda a: a[..., :3]),
    "the cars' generators": in_arrays(env__generators=less),
    "seen cut": in_arrays(seen=less),
    "over numbers": in_arrays(over=lambda a: a.astype(np.float32)),
    "forfeited missing": in_arrays(forfeited=None),
    "torch's generator": in_arrays(process__torch=lambda a: np.zeros_like(a)),
    "best missing": in_arrays(best=None),
    "best of another width": in_arrays(best__layer0__weight=lambda a: a[:, :-1]),
    "best without a bias": in_arrays(best__layer1__bias=None),
    "record of another form": in_json("run.json", resumed=1),
    "another algorithm": in_json("run.json", algo="ppo"),
    "no settings": in_json("run.json", settings={}),
    "settings a text": in_json("run.json", settings="\x1b[2J[red]\n"),
}


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stopped") / "run"
    with pytest.raises(stopping.Stopped):
        start(folder, stop_at=2 * UPDATE)
    return folder


SOME = ["another kind", "progress cut", "arrays cut", "weights NaN", "seen cut", "best missing", "another algorithm"]


@pytest.mark.parametrize("name", some_of(DAMAGES, SOME))
def test_damage_is_one_line(stopped, tmp_path, name):
    shutil.copytree(stopped, tmp_path / "run")
    DAMAGES[name](tmp_path / "run")
    with pytest.raises(UserError, match="--resume: ") as caught:
        start(tmp_path / "run", resume=True)
    words = str(caught.value)
    assert words.isprintable(), "one line, and nothing that acts on a terminal"
    assert len(words) < 800


def test_the_folder_is_sound_without_damage(stopped, straight, tmp_path):
    shutil.copytree(stopped, tmp_path / "run")
    start(tmp_path / "run", resume=True)
    assert_equal(tmp_path / "run", straight)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"seed": 4}, "has seed = 3, not 4"),
        ({"learning_rate": 0.002}, r"has --learning-rate = 0\.001, not 0\.002"),
        ({"gamma": (0.98, 0.99)}, r"has --gamma = \[0\.98, 0\.995\], not \[0\.98, 0\.99\]"),
        ({"total_timesteps": 10**4}, r"has --total-timesteps = 3072, not 10000"),
        ({"env_keywords": '{"friction": 0.9}'}, r"has env_keywords\.friction = None, not 0\.9"),
    ],
)
def test_a_run_goes_on_as_it_began(stopped, changes, text):
    before = (stopped / "run.json").read_bytes()
    with pytest.raises(UserError, match=f"^--resume: the run in .* {text}$"):
        start(stopped, resume=True, **changes)
    assert (stopped / "run.json").read_bytes() == before


def test_the_folder_of_another_trainer_is_one_line(stopped):
    with pytest.raises(UserError, match="has algo = 'native-ppo', not 'ppo'"):
        train.train(train.Args(out=stopped, seed=3, resume=True, quiet=True), Console(quiet=True))


def test_a_second_training_in_the_folder_is_refused(tmp_path):
    with run_folder.held(tmp_path / "run"), pytest.raises(UserError, match="another training is at work"):
        start(tmp_path / "run")


# Mistakes


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"resume": True}, "--resume: .* holds no run"),
        ({"seed": -1}, "--seed must be at least 0 and less than 2.32, got -1"),
        ({"seed": 2**32}, "--seed must be at least 0"),
        ({"cars": 1}, r"--cars must be a whole number in \[2, 100000\], got 1"),
        ({"total_timesteps": 0}, "--total-timesteps must be a whole number in"),
        ({"gamma": (0.9, 1.5)}, r"--gamma\[1\] must be .* in \[0, 1\], got 1\.5"),
        ({"deviation": 0.0}, "--deviation must be"),
        ({"learning_rate": float("nan")}, "--learning-rate must be"),
        ({"env_id": "BicycleStb-v0"}, "BicycleStab-v0"),
        ({"env_id": "CartPole-v1"}, "must be an environment of this package"),
        ({"env_keywords": "{"}, "--env-keywords"),
        ({"env_keywords": '{"vehicel": 1}'}, "vehicle"),
        ({"env_keywords": '{"render_mode": "human"}'}, "render_mode is chosen by the training itself"),
        ({"env_keywords": '{"num_envs": 3}'}, "num_envs"),
        ({"env_keywords": '{"action_repeat": "x"}'}, "action_repeat must be a whole number"),
        ({"env_keywords": '{"max_episode_steps": -1}'}, "max_episode_steps must be at least 1"),
        ({"out": Path()}, "--out must name a folder of its own"),
    ],
)
def test_mistakes_are_one_line_and_nothing_is_written(tmp_path, monkeypatch, changes, text):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=text) as caught:
        ppo.train(ppo.Args(**{"out": Path("run"), "quiet": True, **changes}), Console(quiet=True))
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_task_without_a_mirror_image_is_learned_without_it():
    plant = SimpleNamespace(task=SimpleNamespace(flipped=None, name="one-sided"))
    with pytest.raises(UserError, match=r"^--mirrored: the task one-sided has no mirror image; give --no-mirrored$"):
        training.manner(TINY, plant)
    assert training.manner(replace(TINY, mirrored=False), plant) == {"hold": 2, "history": 2}


def test_a_file_in_the_place_of_the_folder(tmp_path):
    (tmp_path / "run").write_text("mine")
    with pytest.raises(UserError, match="is a file"):
        start(tmp_path / "run")
    assert (tmp_path / "run").read_text() == "mine"
