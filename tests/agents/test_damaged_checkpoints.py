"""Whatever lies in a run's folder, --resume answers in one line and executes nothing."""

from __future__ import annotations

import hashlib
import io
import json
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from combinations import some_of
from short_runs import CONFIG, old_checkpoint, start

from agents import stopping
from agents.messages import UserError
from bicycle_env.files import pack_arrays, read_arrays

UNPICKLED = Path(tempfile.gettempdir()) / "unpickled_by_a_test_of_bicycle_env"
HUGE = 3_000_000_000  # bytes; sparse, so they take no place


class Bomb:
    """Unpickling it makes a file."""

    def __reduce__(self):
        return (Path.touch, (UNPICKLED,))


def stopped(algo, folder):
    with pytest.raises(stopping.Stopped):
        start(algo, folder, stop_at=300)
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A stopped PPO and SAC, each with a checkpoint of this revision and one of an earlier one."""
    place = tmp_path_factory.mktemp("runs")
    for algo in ("ppo", "sac"):
        shutil.copytree(stopped(algo, place / algo), place / f"old-{algo}")
        old_checkpoint(place / f"old-{algo}")
    return place


# What is done to a folder: a function of its path.


def state_path(folder):
    (path,) = (folder / "checkpoint").glob("state-*")
    return path


def with_content(folder, content):
    """Other arrays, under their right name and digest: a forgery, no accident."""
    digest = hashlib.sha256(content).hexdigest()
    state_path(folder).unlink()
    (folder / "checkpoint" / f"state-{digest[:16]}.safetensors").write_bytes(content)
    in_json("checkpoint/progress.json", digest=digest)(folder)


def in_arrays(**changes):
    """Arrays by name (a double underscore is a dot): None takes one away, a function changes one."""

    def damage(folder):
        arrays = read_arrays(state_path(folder))
        for name, change in changes.items():
            key = name.replace("__", ".")
            if change is None:
                del arrays[key]
            else:
                arrays[key] = change(arrays.get(key))
        with_content(folder, pack_arrays(arrays))

    return damage


def in_json(file, **changes):
    def damage(folder):
        content = json.loads((folder / file).read_text())
        for key, value in changes.items():
            if value is None:
                del content[key]
            else:
                content[key] = value
        (folder / file).write_text(json.dumps(content))

    return damage


def in_settings(part=None, **changes):
    def damage(folder):
        content = json.loads((folder / "run.json").read_text())
        (content["settings"][part] if part else content["settings"]).update(changes)
        (folder / "run.json").write_text(json.dumps(content))

    return damage


def text(file, content):
    return lambda folder: (folder / file).write_bytes(content)


def cut(file, share=0.5):
    def damage(folder):
        path = state_path(folder) if file == "state" else folder / file
        path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])

    return damage


def other_kind(file, kind):
    def damage(folder):
        path = state_path(folder) if file == "state" else folder / file
        path.unlink()
        if kind == "folder":
            path.mkdir()
        elif kind == "fifo":
            os.mkfifo(path)
        elif kind == "loop":
            path.symlink_to(path)
        elif kind == "device":
            path.symlink_to("/dev/zero")
        elif kind == "sparse":
            with path.open("wb") as content:
                content.truncate(HUGE)

    return damage


def flipped(folder):
    path = state_path(folder)
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    path.write_bytes(content)


def saved(file, content):
    def damage(folder):
        buffer = io.BytesIO()
        torch.save(content, buffer)
        (folder / "checkpoint" / file).write_bytes(buffer.getvalue())

    return damage


def in_model(change):
    def damage(folder):
        content = torch.load(folder / "checkpoint" / "model.pt", weights_only=True)
        saved("model.pt", change(content))(folder)

    return damage


def compressed(file):
    def damage(folder):
        path = folder / "checkpoint" / file
        content = io.BytesIO()
        with zipfile.ZipFile(path) as source, zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as target:
            for entry in source.infolist():
                target.writestr(entry.filename, source.read(entry))
        path.write_bytes(content.getvalue())

    return damage


def in_buffer(**changes):
    def damage(folder):
        path = folder / "checkpoint" / "replay_buffer.npz"
        with np.load(path) as arrays:
            content = {**arrays, **changes}
        np.savez(path, **{name: array for name, array in content.items() if array is not None})

    return damage


def less(array):
    return array[:-1]


def twice(array):
    return np.concatenate((array, array))


def bad(value):
    def change(array):
        array = array.copy()
        array.flat[0] = value
        return array

    return change


DEEP = b'{"a":' * 100_000 + b"1" + b"}" * 100_000
DAMAGES = {
    # the record
    "record cut": ("ppo", cut("run.json")),
    "record is a list": ("ppo", text("run.json", b"[]")),
    "record is a number": ("ppo", text("run.json", b"1")),
    "record not unicode": ("ppo", text("run.json", b"\xff\xfe\x00")),
    "record deep": ("ppo", text("run.json", DEEP)),
    "record sparse": ("ppo", other_kind("run.json", "sparse")),
    "record a folder": ("ppo", other_kind("run.json", "folder")),
    "record a fifo": ("ppo", other_kind("run.json", "fifo")),
    "record a loop": ("ppo", other_kind("run.json", "loop")),
    "record a device": ("ppo", other_kind("run.json", "device")),
    "record gone": ("ppo", lambda folder: (folder / "run.json").unlink()),
    "record empty": ("ppo", text("run.json", b"")),
    "no settings": ("ppo", in_json("run.json", settings=None)),
    "settings a text": ("ppo", in_json("run.json", settings="many")),
    "finished a text": ("ppo", in_json("run.json", finished="yes")),
    "resumed a number": ("ppo", in_json("run.json", resumed=1)),
    "another environment": ("ppo", in_json("run.json", env_id="\x1b[2J[red]Mine\n")),
    "no such algorithm": ("ppo", in_json("run.json", algo="a2c")),
    "another algorithm": ("ppo", in_json("run.json", algo="sac")),
    "too many cars": ("ppo", in_settings(n_envs=10**12)),
    "other cars": ("ppo", in_settings(n_envs=8)),
    "a huge buffer": ("sac", in_settings("model", buffer_size=10**12)),
    "a negative rate": ("ppo", in_settings("model", learning_rate=-1.0)),
    "rate a text": ("ppo", in_settings("model", learning_rate="fast")),
    "an unknown setting": ("ppo", in_settings("model", policy_kwargs={})),
    "no such activation": ("ppo", in_settings("network", activation="os.system")),
    "another network": ("ppo", in_settings("network", net_arch=[17])),
    "a huge network": ("ppo", in_settings("network", net_arch=[10**9])),
    # progress
    "progress cut": ("ppo", cut("checkpoint/progress.json")),
    "progress empty": ("ppo", text("checkpoint/progress.json", b"")),
    "progress a list": ("ppo", text("checkpoint/progress.json", b"[1]")),
    "progress null": ("ppo", text("checkpoint/progress.json", b"null")),
    "progress deep": ("ppo", text("checkpoint/progress.json", DEEP)),
    "progress NaN": ("ppo", in_json("checkpoint/progress.json", seconds=float("nan"))),
    "progress a folder": ("ppo", other_kind("checkpoint/progress.json", "folder")),
    "progress a fifo": ("ppo", other_kind("checkpoint/progress.json", "fifo")),
    "progress sparse": ("ppo", other_kind("checkpoint/progress.json", "sparse")),
    "steps a text": ("ppo", in_json("checkpoint/progress.json", timesteps="512")),
    "steps negative": ("ppo", in_json("checkpoint/progress.json", timesteps=-1)),
    "other steps": ("ppo", in_json("checkpoint/progress.json", timesteps=1)),
    "no curve": ("ppo", in_json("checkpoint/progress.json", curve=None)),
    "curve of numbers": ("ppo", in_json("checkpoint/progress.json", curve=[1])),
    "curve of commands": ("ppo", in_json("checkpoint/progress.json", curve=["=cmd|' /C calc'!A0"])),
    "versions a list": ("ppo", in_json("checkpoint/progress.json", versions=[])),
    "digest a path": ("ppo", in_json("checkpoint/progress.json", digest="../" * 21 + "x")),
    "no digest": ("ppo", in_json("checkpoint/progress.json", digest=None)),
    # arrays: accidents
    "arrays gone": ("ppo", lambda folder: state_path(folder).unlink()),
    "arrays cut": ("ppo", cut("state")),
    "arrays empty": ("ppo", cut("state", 0.0)),
    "arrays flipped": ("sac", flipped),
    "arrays sparse": ("ppo", other_kind("state", "sparse")),
    "arrays a folder": ("ppo", other_kind("state", "folder")),
    "arrays a fifo": ("ppo", other_kind("state", "fifo")),
    "arrays a device": ("ppo", other_kind("state", "device")),
    # arrays: forgeries
    "a pickle": ("ppo", lambda folder: with_content(folder, pickle.dumps(Bomb()))),
    "garbage": ("ppo", lambda folder: with_content(folder, b"garbage" * 100)),
    "weights missing": ("ppo", in_arrays(policy__action_net__weight=None)),
    "weights of another shape": ("ppo", in_arrays(policy__action_net__weight=less)),
    "weights of another type": ("ppo", in_arrays(policy__log_std=lambda a: a.astype(np.float64))),
    "weights NaN": ("ppo", in_arrays(policy__log_std=bad(np.nan))),
    "weights too many": ("ppo", in_arrays(policy__mine=lambda _: np.zeros(3))),
    "moments missing": ("ppo", in_arrays(**{"optimizer__policy__optimizer__0__exp_avg": None})),
    "moments negative": ("ppo", in_arrays(**{"optimizer__policy__optimizer__0__exp_avg_sq": bad(-1.0)})),
    "counters negative": ("ppo", in_arrays(counters=lambda a: a - np.array([0, 10**6, 0]))),
    "python's generator": ("ppo", in_arrays(process__python=lambda a: np.full_like(a, 2**32 - 1))),
    "numpy's generator": ("ppo", in_arrays(process__numpy_place=bad(-5))),
    "torch's generator": ("ppo", in_arrays(process__torch=lambda a: np.zeros_like(a))),
    "the cars' generators": ("ppo", in_arrays(env__generators=lambda a: a * np.uint64(0))),
    "cars missing": ("ppo", in_arrays(env__generators=None)),
    "cars elsewhere": ("ppo", in_arrays(env__rows=lambda a: a + 1.0)),
    "fewer cars": ("ppo", in_arrays(env__rows=lambda a: a[..., :3])),
    "lengths negative": ("ppo", in_arrays(monitor__lengths=bad(-1))),
    "too many episodes": ("ppo", in_arrays(episodes__success=lambda _: np.ones(5000, bool))),
    "buffer cut": ("sac", in_arrays(buffer__rewards=less)),
    "buffer's place": ("sac", in_arrays(buffer__place=lambda _: np.array([10**6, 0]))),
    "entropy NaN": ("sac", in_arrays(log_ent_coef=bad(np.inf))),
    "best of another width": ("ppo", in_arrays(best__layer0__weight=lambda a: a[:, :-1])),
    "best with more actions": ("sac", in_arrays(best__layer1__weight=twice, best__layer1__bias=twice)),
    "best without a bias": ("ppo", in_arrays(best__layer1__bias=None)),
    "best a text": ("ppo", in_arrays(best=lambda a: a.astype(np.uint8))),
    # checkpoints of earlier revisions
    "old: empty": ("old-ppo", text("checkpoint/model.pt", b"")),
    "old: garbage": ("old-ppo", text("checkpoint/model.pt", b"PK\3\4" + b"x" * 1000)),
    "old: cut": ("old-ppo", cut("checkpoint/model.pt")),
    "old: cut short": ("old-ppo", cut("checkpoint/model.pt", 0.98)),
    "old: sparse": ("old-ppo", other_kind("checkpoint/model.pt", "sparse")),
    "old: a folder": ("old-ppo", other_kind("checkpoint/model.pt", "folder")),
    "old: a pickle": ("old-ppo", text("checkpoint/model.pt", pickle.dumps(Bomb()))),
    "old: a bomb": ("old-ppo", saved("model.pt", Bomb())),
    "old: a text": ("old-ppo", saved("model.pt", "/etc/passwd")),
    "old: a list": ("old-ppo", saved("model.pt", [1, 2])),
    "old: a tensor": ("old-ppo", saved("model.pt", torch.zeros(3))),
    "old: numbers for keys": ("old-ppo", saved("model.pt", {1: {}})),
    "old: texts for weights": ("old-ppo", saved("model.pt", {"policy": "weights"})),
    "old: sparse tensors": ("old-ppo", saved("model.pt", {"policy": {"log_std": torch.zeros(2).to_sparse()}})),
    "old: no optimizer": ("old-ppo", in_model(lambda state: {"policy": state["policy"], "policy.optimizer": {}})),
    "old: weights missing": ("old-ppo", in_model(lambda state: state | {"policy": {"a": torch.zeros(1)}})),
    "old: NaN": ("old-ppo", in_model(lambda s: s | {"policy": s["policy"] | {"log_std": torch.full((2,), torch.nan)}})),
    "old: compressed": ("old-ppo", compressed("model.pt")),
    "old: buffer compressed": ("old-sac", compressed("replay_buffer.npz")),
    "old: buffer gone": ("old-sac", lambda folder: (folder / "checkpoint" / "replay_buffer.npz").unlink()),
    "old: buffer of objects": ("old-sac", in_buffer(rewards=np.array([Bomb()], object))),
    "old: buffer lacks": ("old-sac", in_buffer(dones=None)),
    "old: buffer of another shape": ("old-sac", in_buffer(actions=np.zeros((2, 2), np.float32))),
    "old: buffer's place": ("old-sac", in_buffer(place=np.array(10**9))),
    "old: buffer's place a text": ("old-sac", in_buffer(place=np.array("here"))),
    "old: buffer cut": ("old-sac", cut("checkpoint/replay_buffer.npz")),
}


@pytest.mark.parametrize("name", some_of(DAMAGES, list(DAMAGES)[::3]))
def test_damage_is_one_line(runs, tmp_path, name):
    run, damage = DAMAGES[name]
    folder = tmp_path / "run"
    shutil.copytree(runs / run, folder)
    damage(folder)
    UNPICKLED.unlink(missing_ok=True)
    with pytest.raises(UserError, match="--resume: ") as caught:
        start(run.removeprefix("old-"), folder, resume=True)
    words = str(caught.value)
    assert words.isprintable(), "one line, and nothing that acts on a terminal"
    assert len(words) < 800
    assert not UNPICKLED.exists()


def test_the_folders_are_sound_without_damage(runs, tmp_path):
    """So what the others see is their damage."""
    for run in ("ppo", "sac", "old-ppo", "old-sac"):
        shutil.copytree(runs / run, tmp_path / run)
        start(run.removeprefix("old-"), tmp_path / run, resume=True)
        assert json.loads((tmp_path / run / "run.json").read_text())["finished"] is True


@pytest.mark.exhaustive
def test_a_command_on_a_damaged_folder(runs, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(runs / "ppo", folder)
    in_json("run.json", env_id="\x1b[2J[red]Mine\n")(folder)
    command = [sys.executable, "-m", "agents.train", "--algo", "ppo", "--seed", "3", "--out", str(folder), "--resume"]
    done = subprocess.run([*command, "--config", str(CONFIG)], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: --resume: ")
    assert done.stderr.count("\n") == 1


@pytest.mark.exhaustive
def test_a_command_that_is_stopped_and_goes_on(tmp_path):
    """The whole way: a signal in the middle of learning, one line, and --resume to the end."""
    script = (
        "import signal, sys\nfrom agents import messages, train\n"
        "def stop(record): return record.num_timesteps != 480 or not signal.raise_signal(signal.SIGTERM)\n"
        "train.Record._on_step = stop\n"
        "messages.run(train.main)\n"
    )
    command = [sys.executable, "-c", script, "--seed", "3", "--out", str(tmp_path / "run"), "--config", str(CONFIG)]
    done = subprocess.run([*command, "--quiet"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (143, "")
    assert done.stderr == "stopped at 512 steps; go on with the same command and --resume\n"
    start("ppo", tmp_path / "run", resume=True)
