"""Writing: the old content or the new, never half; modes by the umask; outputs refused before work."""

import json
import os

import pytest

from bicycle_env import files
from bicycle_env.files import checked_output, checked_output_folder, remove_partial_files


class KilledError(BaseException):
    """Stands for a signal in the middle of a write."""


@pytest.mark.parametrize("function", ["replace", "fsync"])
def test_a_kill_while_writing_leaves_the_old_file(tmp_path, monkeypatch, function):
    path = tmp_path / "file.json"
    files.write_json(path, {"old": 1})

    def killed(*_, **__):
        raise KilledError

    monkeypatch.setattr(os, function, killed)
    with pytest.raises(KilledError):
        files.write_json(path, {"new": 2})
    monkeypatch.undo()
    assert json.loads(path.read_text()) == {"old": 1}
    assert os.listdir(tmp_path) == ["file.json"], "the temporary file is left behind"


@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_writing_makes_the_folder_and_a_file_with_the_mode_that_the_umask_leaves(tmp_path, umask):
    path = tmp_path / "a" / "b" / "file.bin"
    before = os.umask(umask)
    try:
        files.write_bytes(path, b"one")
        files.write_bytes(str(path), b"two")
    finally:
        os.umask(before)
    assert path.read_bytes() == b"two"
    assert path.stat().st_mode & 0o777 == 0o666 & ~umask


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), [1.0, -float("inf")]])
def test_json_has_no_nan(tmp_path, bad):
    path = tmp_path / "file.json"
    files.write_json(path, 1)
    with pytest.raises(ValueError, match="JSON"):
        files.write_json(path, {"value": bad})
    assert json.loads(path.read_text()) == 1
    assert os.listdir(tmp_path) == ["file.json"]


def test_what_a_killed_writer_leaves_is_removed_and_nothing_else(tmp_path, monkeypatch):
    def killed(*_, **__):
        raise KilledError

    with monkeypatch.context() as patch:  # a kill runs no clean-up
        patch.setattr(os, "replace", killed)
        patch.setattr(os, "unlink", lambda _: None)
        for name in ("run.json", "a" * 250):
            with pytest.raises(KilledError):
                files.write_bytes(tmp_path / name, b"half")
    keep = ["run.json", ".hidden", ".x.partial", "notes.partial", ".run.json.0123456789abcdef.partial.txt"]
    for name in keep:
        (tmp_path / name).write_text("mine")
    (tmp_path / ".folder.0123456789abcdef.partial").mkdir()
    assert len(os.listdir(tmp_path)) == len(keep) + 3
    remove_partial_files(tmp_path)
    assert sorted(os.listdir(tmp_path)) == sorted([*keep, ".folder.0123456789abcdef.partial"])
    remove_partial_files(tmp_path / "nowhere")


def refused_places(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    return {
        "folder": IsADirectoryError,
        "file/x.json": (NotADirectoryError, FileExistsError),
        "file/deep/x.json": NotADirectoryError,
        "fifo": OSError,
        "loop": OSError,
        "a\0b": OSError,
        "x" * 300: OSError,
        "/dev/null": OSError,
        "": IsADirectoryError,
    }


def test_an_output_that_cannot_be_written_is_refused_before_and_nothing_is_made(tmp_path):
    cases = refused_places(tmp_path)
    before = sorted(os.listdir(tmp_path))
    for name, error in cases.items():
        path = tmp_path / name if name else ""
        for function in (checked_output, lambda path: files.write_bytes(path, b"")):
            with pytest.raises(error) as caught:
                function(path)
            assert caught.value.filename is not None, name
            assert caught.value.strerror, name
    assert sorted(os.listdir(tmp_path)) == before
    assert (tmp_path / "file").read_text() == "mine"


def test_an_output_that_can_be_written_is_let_through_and_nothing_is_made(tmp_path):
    (tmp_path / "there.json").write_text("old")
    (tmp_path / "dangling").symlink_to("nowhere")
    before = sorted(os.listdir(tmp_path))
    for name in ("there.json", "new.json", "new/deep/x.json", "dangling"):
        assert checked_output(tmp_path / name) == tmp_path / name
    assert checked_output_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert sorted(os.listdir(tmp_path)) == before


def test_a_folder_that_refuses_files(tmp_path, monkeypatch):
    """Mode bits do not stop a superuser, so the refusal is made here."""

    def refuse(path, *_):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(PermissionError) as caught:
        checked_output(tmp_path / "new" / "x.json")
    assert caught.value.filename == str(tmp_path / "new")
