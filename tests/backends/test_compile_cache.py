"""Compiled code on the disk: where it lies, and that nothing that can be wrong there is more than a compile."""

import errno
import os
import time

import numba
import numpy as np
import pytest

from bicycle_env.backends import announcements, compile_cache, compiled
from bicycle_env.backends.compiled import entry_point

NUMBER = numba.float64(numba.float64)


def law(x):
    return 3.0 * x


def compile_again():
    """What a new process does: it finds the same content. Whether something was compiled is in ``said``."""
    compiled.ENTRY_POINTS.clear()
    with announcements.progress("the law"):
        function = entry_point(law, NUMBER)
    assert function(2.0) == 6.0


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def file(folder, capfd):
    """The only file of a cache, with the compiled law."""
    compile_again()
    assert "compiling" in capfd.readouterr().err
    (path,) = (path for path in folder.rglob("*") if path.is_file())
    return path


def test_compiled_code_is_kept_in_one_file_and_found_there(file, capfd):
    name, content, processor = file.stem.split("-")
    assert (name, len(content), len(processor), file.suffix) == ("law", 20, 8, ".nbc")
    compile_again()
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("triple", "features", "has"),
    [
        ("x86_64-unknown-linux-gnu", "+avx2,+fma,-fma4", True),
        ("x86_64-unknown-linux-gnu", "+avx,-fma,+fma4", False),
        ("x86_64-pc-windows-msvc", "", False),
        ("aarch64-unknown-linux-gnu", "", True),
    ],
)
def test_who_has_a_multiply_add(triple, features, has):
    assert compile_cache.has_multiply_add(triple, "generic", features) == has


def test_a_processor_without_multiply_add_is_said_to_be_slow(folder, monkeypatch, capfd):
    monkeypatch.setattr(compile_cache, "has_multiply_add", lambda *_: False)
    compile_again()
    assert "no fused multiply-add: the same bits" in capfd.readouterr().err


@pytest.mark.parametrize(
    "change", [{"nogil": True}, {"interleave": 2}, {"signature": numba.int64(numba.int64)}], ids=str
)
def test_another_way_to_compile_has_another_file(file, change):
    compiled.ENTRY_POINTS.clear()
    entry_point(**{"function": law, "signature": NUMBER, **change})
    assert len({path.name for path in file.parent.iterdir()}) == 2


DAMAGES = {
    "empty": lambda content: b"",
    "cut": lambda content: content[:-1],
    "cut in the checksum": lambda content: content[:20],
    "one bit": lambda content: content[:-40] + bytes([content[-40] ^ 1]) + content[-39:],
    "noise": lambda content: np.random.default_rng(0).bytes(len(content)),
    "text": lambda content: b"not a cache",
    "numba's own": lambda content: content[compile_cache.CHECKSUM :],
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_costs_a_compile_and_is_whole_afterwards(file, damage, capfd):
    content = file.read_bytes()
    file.write_bytes(DAMAGES[damage](content))
    compile_again()
    assert "compiling the law, once for this machine" in capfd.readouterr().err
    compile_again()
    assert capfd.readouterr().err == ""


def test_a_whole_file_that_cannot_be_understood_costs_a_compile(file, monkeypatch, capfd):
    """Something that the digest does not know has changed: a class of the pickle is gone."""
    monkeypatch.setattr(compile_cache.pickle, "loads", lambda content: {}["gone"])
    compile_again()
    assert "compiling" in capfd.readouterr().err


def test_a_folder_where_the_file_should_be_costs_a_compile_each_time(file, capfd):
    file.unlink()
    file.mkdir()
    for _ in range(2):
        compile_again()
        assert capfd.readouterr().err.endswith("s, not kept: Is a directory\n")
    assert [path.name for path in file.parent.iterdir()] == [file.name]


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EROFS, errno.EACCES, errno.EDQUOT], ids=os.strerror)
def test_a_disk_that_takes_nothing_costs_a_compile_and_is_named(folder, error, monkeypatch, capfd):
    def refuse(path, content):
        raise OSError(error, os.strerror(error), str(path))

    monkeypatch.setattr(compile_cache, "write_bytes", refuse)
    compile_again()
    assert capfd.readouterr().err.endswith(f" s, not kept: {os.strerror(error)}\n")


def test_a_file_that_may_not_be_read_costs_a_compile(file, monkeypatch, capfd):
    """Somebody else's. Root may read everything, so the refusal is made here."""

    def refuse(path):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr(compile_cache.Path, "read_bytes", refuse)
    compile_again()
    assert "compiling" in capfd.readouterr().err


def test_without_a_folder_every_process_compiles_and_says_so(monkeypatch, capfd):
    def nowhere(function):
        raise RuntimeError(f"cannot cache function {function!r}: no locator available")

    monkeypatch.setattr(compile_cache, "CompileResultCacheImpl", nowhere)
    for _ in range(2):
        compile_again()
        assert "compiling the law, anew in every process: no folder" in capfd.readouterr().err


def test_what_killed_processes_left_goes_with_the_next_write(file):
    old, new, others = (file.with_name(f".{name}") for name in (f"{file.name}.old", f"{file.name}.new", "other.nbc.x"))
    for path in (old, new, others):
        path.write_bytes(b"half")
    hours = time.time() - 2 * compile_cache.ABANDONED
    for path in (old, others):
        os.utime(path, (hours, hours))
    file.unlink()
    compile_again()
    assert set(file.parent.iterdir()) == {file, new, others}  # `new` may be another process's that writes just now
