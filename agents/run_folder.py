"""The folder of a training: one process at a time, and files of which a kill at any moment loses nothing.

    .lock           held by the training; the operating system releases it when the process ends, however it ends
    run.json        what the run is, and whether it has finished
    checkpoint/     progress.json and state-DIGEST.safetensors, the arrays that it names

A checkpoint's arrays are written first, under a name that follows from their content. One rename, that of
progress.json, makes them the checkpoint; only then are the last ones removed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from agents import settings
from agents.messages import UserError
from bicycle_env.files import (
    FileError,
    anything,
    listed,
    mapping,
    number_in,
    one_of,
    pack_arrays,
    read_bytes,
    read_json,
    remove_partial_files,
    shown,
    table,
    text,
    unpack_arrays,
    whole_in,
    write_bytes,
    write_json,
)
from bicycle_env.physics.validation import flag

LOCK, RECORD, CHECKPOINT, PROGRESS = ".lock", "run.json", "checkpoint", "progress.json"
CURVE, CURVE_HEADER = "curve.csv", "timesteps,seconds,success_rate,mean_return,mean_length"
CURVE_ROW = re.compile(r"\d{1,15},\d{1,12}\.\d,(\d\.\d{4}|nan),(-?\d{1,30}\.\d{3}|nan),(\d{1,15}\.\d|nan)")
ARRAYS = re.compile(r"state-[0-9a-f]{16}\.safetensors")
BEFORE = ("model.pt", "replay_buffer.npz")  # names in the checkpoints of earlier revisions
DIGEST = re.compile(r"[0-9a-f]{64}")
MOST_STEPS = 10**15
LARGEST_RECORD = 10_000_000  # bytes


def _matching(pattern: re.Pattern[str], words: str) -> Callable[[str, Any], str]:
    def check(name: str, value: Any) -> str:
        if not isinstance(value, str) or not pattern.fullmatch(value):
            raise ValueError(f"{name} must be {words}, got {value!r}")
        return value

    return check


MADE_BY = {"versions": mapping(text(100), 100), "machine": text(), "git": text()}
PROGRESS_CHECK = table(
    {
        "timesteps": whole_in(0, MOST_STEPS),
        "total_timesteps": whole_in(1, MOST_STEPS),
        "seconds": number_in(0.0, 1e12),
        "curve": listed(_matching(CURVE_ROW, f"a row of {CURVE_HEADER}")),
        "digest": _matching(DIGEST, "a SHA-256 in hexadecimal"),
        **MADE_BY,
    }
)
OLD_PROGRESS_CHECK = table(
    {
        "timesteps": whole_in(0, MOST_STEPS),
        "seconds": number_in(0.0, 1e12),
        "curve": listed(_matching(CURVE_ROW, f"a row of {CURVE_HEADER}")),
    }
)
RESUMED = table({"at": whole_in(0, MOST_STEPS), "exact": flag}, {"reason": text()})
RECORD_CHECK = table(
    {
        "env_id": text(200),
        "env_keywords": mapping(anything),
        "algo": one_of([*settings.ALGORITHMS, *settings.OWN, settings.RLLIB]),
        "seed": whole_in(0, 2**63),
        "settings": anything,  # checked with the algorithm known
        "finished": flag,
    },
    {"resumed": listed(RESUMED)},
    others=True,
)


class Folder:
    """A run's folder, held by this process: made by :func:`held`."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def record(self) -> dict[str, Any] | None:
        """What run.json says; None if it is missing or empty. FileError if it is damaged."""
        place = self.path / RECORD
        if not os.path.lexists(place) or (place.is_file() and place.stat().st_size == 0):
            return None
        found: dict[str, Any] = read_json(place, RECORD_CHECK, LARGEST_RECORD)
        return found

    def write_record(self, content: Mapping[str, Any]) -> None:
        write_json(self.path / RECORD, content)

    def checkpoint(self) -> Path | None:
        """Where the last checkpoint is; None if there is none yet.

        Earlier revisions renamed whole folders: a kill between two renames left the last one as checkpoint.old.
        """
        places = (self.path / CHECKPOINT, self.path / f"{CHECKPOINT}.old", self.path / f"{CHECKPOINT}.new")
        return next((place for place in places if os.path.lexists(place / PROGRESS)), None)

    def progress(self, place: Path) -> dict[str, Any]:
        """A checkpoint's progress.json, checked; without the key "digest" it is of an earlier revision."""
        found: dict[str, Any] = read_json(place / PROGRESS, largest=LARGEST_RECORD)
        old = isinstance(found, dict) and "digest" not in found and os.path.lexists(place / BEFORE[0])
        read_json(place / PROGRESS, OLD_PROGRESS_CHECK if old else PROGRESS_CHECK, LARGEST_RECORD)
        return found

    def arrays(self, place: Path, digest: str, largest: int) -> dict[str, NDArray[Any]]:
        """The arrays of a checkpoint; FileError if they are not those that were written."""
        path = place / _name(digest)
        content = read_bytes(path, largest)
        if hashlib.sha256(content).hexdigest() != digest:
            raise FileError(f"{path}: the content is not what was written: its SHA-256 differs from {PROGRESS}'s")
        return unpack_arrays(content, path)

    def save(self, progress: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Put a checkpoint in place of the last one, and the learning curve beside it."""
        place = self.path / CHECKPOINT
        content = pack_arrays(arrays)
        digest = hashlib.sha256(content).hexdigest()
        write_bytes(place / _name(digest), content)
        write_json(place / PROGRESS, {**progress, "digest": digest})
        for entry in list(os.scandir(place)):
            if (ARRAYS.fullmatch(entry.name) or entry.name in BEFORE) and entry.name != _name(digest):
                os.unlink(entry.path)
        for old in (self.path / f"{CHECKPOINT}.old", self.path / f"{CHECKPOINT}.new"):
            for name in (PROGRESS, *BEFORE):
                (old / name).unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # something of the user's is in it, or it is not there
                old.rmdir()
        self.write_curve(progress["curve"])

    def write_curve(self, rows: Sequence[str]) -> None:
        """The learning curve, below its heading."""
        write_bytes(self.path / CURVE, ("\n".join([CURVE_HEADER, *rows]) + "\n").encode())


def _name(digest: str) -> str:
    return f"state-{digest[:16]}.safetensors"


def begun(path: Path) -> bool:
    """Whether a training was ever started in a folder."""
    return os.path.lexists(path / RECORD) or os.path.lexists(path / LOCK)


def has_run(path: Path) -> bool:
    """Whether more than the beginning of a run is in a folder: a finished one, or a checkpoint."""
    folder = Folder(path)
    if folder.checkpoint() is not None or os.path.lexists(path / "policy.json"):
        return True
    try:
        record = folder.record()
    except (FileError, OSError):
        return True  # what cannot be read is not overwritten
    return record is not None and record["finished"]


def refuse_run(path: Path) -> None:
    """UserError if a folder holds more than the beginning of a run, or files of somebody else's and none of a run."""
    if has_run(path):
        raise UserError(f"{path} holds a run already; choose another --out, or go on with --resume")
    if not begun(path) and path.is_dir() and any(path.iterdir()):
        raise UserError(f"{path} holds other files; choose a new or an empty folder as --out")


LATER: dict[str, Any] = {"residual": "", "speeds": [], "plan": 0, "noise_hold": 1}
"""Settings of agents.ppo that runs of earlier revisions lack, and what these did."""


def earlier_record(
    folder: Folder, identity: Mapping[str, Any], check: Callable[[dict[str, Any]], object] = lambda _: None
) -> dict[str, Any] | None:
    """The record of the run in a folder; None if nothing was done yet.

    Raises:
        UserError: it is damaged, it is another run: one with another value of what `identity` names, or `check` raises
            an error of what else is in it.
    """
    try:
        before = folder.record()
        if before is None:
            if folder.checkpoint() is not None:
                raise FileError(f"{folder.path} has a checkpoint, but no run.json")
            return None
        settings, now = before.get("settings"), identity.get("settings", {})
        if isinstance(settings, dict):
            before["settings"] = {name: value for name, value in LATER.items() if name in now} | settings
        for name, value in identity.items():
            if before.get(name) != value:
                place, *values = _difference(name, before.get(name), value)
                had, given = (shown(repr(each)) for each in values)
                if place.startswith("settings."):  # the options of the command
                    place = f"--{place.removeprefix('settings.').replace('_', '-')}"
                raise UserError(f"--resume: the run in {folder.path} has {shown(place)} = {had}, not {given}")
        check(before)
    except (ValueError, TypeError, OSError) as error:
        raise UserError(f"--resume: the record of the run is damaged: {shown(error)}") from None
    return before


def _difference(name: str, before: Any, now: Any) -> tuple[str, Any, Any]:
    """Where two values begin to differ, inside of tables, too."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in {**now, **before}:
            if before.get(key) != now.get(key):
                return _difference(f"{name}.{key}", before.get(key), now.get(key))
    return name, before, now


def changes(progress: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What is no longer as it was when a checkpoint was written, so that a run may not go on to the bit."""
    versions = ((name, progress["versions"].get(name, "missing"), now["versions"][name]) for name in now["versions"])
    found = [f"{name} was {before} and is {version}" for name, before, version in versions if before != version]
    return found + [
        f"the {words} was {progress[key]} and is {now[key]}"
        for key, words in (("machine", "machine"), ("git", "revision"))
        if progress[key] != now[key]
    ]


@contextlib.contextmanager
def held(path: Path) -> Iterator[Folder]:
    """Hold the folder, made if needed, against other trainings, and remove what killed ones left half written.

    Raises:
        UserError: another process holds it, or a file has its name.
        OSError: it cannot be made or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise UserError(f"{path} is a file; choose another --out") from None
    handle = os.open(path / LOCK, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
    try:
        try:
            _lock(handle)
        except (BlockingIOError, PermissionError):
            raise UserError(
                f"another training is at work in {path}; wait for its end, or choose another --out"
            ) from None
        for place in (path, path / CHECKPOINT):
            if place.is_dir():
                remove_partial_files(place)
        yield Folder(path)
    finally:
        os.close(handle)  # and so released


def _lock(handle: int) -> None:
    """Lock a file for this process; BlockingIOError or PermissionError (Windows) if another one has it."""
    try:
        import fcntl
    except ModuleNotFoundError:
        import msvcrt

        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        return
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
