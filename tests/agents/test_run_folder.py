"""A kill at any moment, and a second one after it, lose no checkpoint: each call that changes a name is tried."""

from __future__ import annotations

import contextlib
import os
import re
import shutil

import numpy as np
import pytest

from agents import run_folder
from agents.messages import UserError

PROGRESS = {
    "timesteps": 10,
    "total_timesteps": 100,
    "seconds": 1.0,
    "curve": ["10,1.0,0.5000,12.500,40.0"],
    "versions": {},
    "machine": "",
    "git": "",
}
CALLS = ("open", "replace", "unlink", "rename", "rmdir", "mkdir", "fsync")


class KilledError(BaseException):
    """Stands for SIGKILL: nothing after it changes a file any more."""


@pytest.fixture(autouse=True)
def _no_disk(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda _: None)  # hundreds of them take long


def killed_at(patch, moment):
    """Every call that changes the folder counts; the one at `moment` and all later ones are refused."""
    count = [0]

    def counted(call):
        def checked(*arguments, **keywords):
            if call is real_open and not arguments[1] & os.O_CREAT:
                return call(*arguments, **keywords)
            count[0] += 1
            if count[0] > moment:
                raise KilledError
            return call(*arguments, **keywords)

        return checked

    real_open = os.open
    for name in CALLS:
        patch.setattr(os, name, counted(getattr(os, name)))
    return count


def save(folder, timesteps):
    folder.save({**PROGRESS, "timesteps": timesteps}, {"a": np.full(100, timesteps)})


def saved(folder):
    place = folder.checkpoint()
    progress = folder.progress(place)
    (value,) = set(folder.arrays(place, progress["digest"], 10_000)["a"].tolist())
    assert value == progress["timesteps"]
    return value


def changes(tmp_path):
    """How many calls one save makes on top of an earlier one."""
    with run_folder.held(tmp_path / "counted") as folder:
        save(folder, 1)
        with pytest.MonkeyPatch.context() as patch:
            count = killed_at(patch, 10**9)
            save(folder, 2)
    return count[0]


def contents(path):
    """Each file's name, without the random part, and bytes."""
    files = [file for file in path.rglob("*") if file.is_file()]
    return tuple(
        sorted((re.sub(r"[0-9a-f]{16}", "", str(file.relative_to(path))), file.read_bytes()) for file in files)
    )


def test_two_kills_anywhere_lose_nothing(tmp_path):
    total = changes(tmp_path)
    assert total >= 8
    seen, left = set(), {}

    def kill(path, moment, least, steps):
        with run_folder.held(path) as folder, pytest.MonkeyPatch.context() as patch:
            killed_at(patch, moment)
            with pytest.raises(KilledError):
                save(folder, steps)
        before = contents(path)
        with run_folder.held(path) as folder:
            found = saved(folder)
        assert found in (least, steps)
        seen.add((steps, found))
        return found, before

    for first in range(total):
        path = tmp_path / str(first)
        with run_folder.held(path) as folder:
            save(folder, 1)
        found, state = kill(path, first, 1, 2)
        left.setdefault(state, (path, found))  # of two kills that leave the same files one goes on
    for one, begun in left.values():
        for second in range(total):
            path = tmp_path / f"{one.name}-{second}"
            shutil.copytree(one, path)
            least, _ = kill(path, second, begun, 3)
            with run_folder.held(path) as folder:
                assert saved(folder) == least
                assert not list(path.rglob("*.partial"))
                save(folder, 4)
                assert saved(folder) == 4
            assert len(list((path / "checkpoint").iterdir())) == 2
    assert {(2, 1), (2, 2), (3, 1), (3, 2), (3, 3)} <= seen


def test_the_first_checkpoint_is_there_or_not(tmp_path):
    for moment in range(changes(tmp_path)):
        path = tmp_path / str(moment)
        with run_folder.held(path) as folder:
            with pytest.MonkeyPatch.context() as patch:
                killed_at(patch, moment)
                with contextlib.suppress(KilledError):
                    save(folder, 1)
            if run_folder.has_run(path):
                assert saved(folder) == 1
            save(folder, 2)
            assert saved(folder) == 2


def test_the_lock_is_one_process_s_and_ends_with_it(tmp_path):
    with run_folder.held(tmp_path), pytest.raises(UserError, match="another training"), run_folder.held(tmp_path):
        pass
    with run_folder.held(tmp_path):
        pass


def test_a_user_s_own_files_stay(tmp_path):
    with run_folder.held(tmp_path) as folder:
        save(folder, 1)
        mine = [
            tmp_path / "notes.txt",
            tmp_path / "checkpoint" / "notes.txt",
            tmp_path / "checkpoint.old" / "notes.txt",
        ]
        for path in mine:
            path.parent.mkdir(exist_ok=True)
            path.write_text("mine")
        save(folder, 2)
    assert all(path.read_text() == "mine" for path in mine)
