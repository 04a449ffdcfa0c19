"""The lock files hold what constraints.txt says, each line with its hashes, and are installed where they fit."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
LOCKS = ROOT / "locks"
ENTRY = re.compile(r"([a-z0-9-]+)==([^ ]+)((?: \\\n    --hash=sha256:[0-9a-f]{64})+)\n")
spec = importlib.util.spec_from_file_location("lock", ROOT / "tools" / "lock.py")
lock = importlib.util.module_from_spec(spec)
spec.loader.exec_module(lock)


def locked(name):
    """Versions by package name; every character of the file belongs to an entry with a hash or to a comment."""
    content = re.sub(r"^#.*\n", "", (LOCKS / name).read_text(), flags=re.MULTILINE)
    assert ENTRY.sub("", content) == "", "a line without a hash"
    return {package: version for package, version, _ in ENTRY.findall(content)}


def constrained():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    return dict(line.split("==") for line in lines if line and not line.startswith("#"))


@pytest.mark.parametrize("name", ["demo.txt", "test.txt", "torch-cpu.txt", "torch-cuda.txt"])
def test_every_line_has_a_hash_and_the_version_of_the_constraints(name):
    pins = constrained()
    versions = locked(name)
    assert versions
    for package, version in versions.items():
        assert pins.get(package, version) == version, package


@pytest.mark.parametrize("extra", lock.EXTRAS)
def test_what_an_extra_needs_is_locked(extra):
    versions = locked(f"{extra}.txt") | locked("torch-cpu.txt")
    for requirement in lock.requirements(extra):
        assert lock.normal(re.split(r"[<>=!~ ;\[]", requirement)[0]) in versions, requirement
    assert "setuptools" in versions, "what builds the package without build isolation"
    assert not [package for package in locked(f"{extra}.txt") if lock.CUDA.fullmatch(package)]


def test_every_constraint_of_demo_and_test_is_locked():
    everything = locked("demo.txt") | locked("test.txt") | locked("torch-cuda.txt")
    only_in_docs = set(lock.requirements("docs")) - set(lock.requirements("demo"))
    of_others = {"envpool", "highway-env"}  # of `bench`, which has no lock; nor has `docs`
    of_others |= {lock.normal(re.split(r"[<>=!~ ;\[]", line)[0]) for line in only_in_docs}
    assert set(constrained()) - of_others <= set(everything)


@pytest.mark.parametrize("extra", lock.EXTRAS)
@pytest.mark.parametrize("build", ["torch-cpu.txt", "torch-cuda.txt"])
def test_where_the_locks_fit_only_hashed_files_are_installed(monkeypatch, extra, build):
    """torch is the build that pip finds here; a build that is in no lock is refused by its hash."""
    (digest,) = re.findall(r"\ntorch==.*\n.*sha256:(.*)", (LOCKS / build).read_text())
    monkeypatch.setattr(lock, "fits", lambda: True)
    monkeypatch.setattr(lock, "resolved", lambda *_, **__: {"torch": (f"{constrained()['torch']}+any", digest)})
    *hashed, last = lock.commands(extra)
    assert hashed == [["--require-hashes", "--no-deps", "-r", str(LOCKS / file)] for file in (f"{extra}.txt", build)]
    assert last == ["--no-deps", "--no-build-isolation", "-e", str(ROOT)]


def test_elsewhere_and_for_other_extras_the_constraints_are_taken(monkeypatch):
    plain = [["-c", str(ROOT / "constraints.txt"), "-e", f"{ROOT}[bench]"]]
    monkeypatch.setattr(lock, "fits", lambda: True)
    assert lock.commands("bench") == plain
    monkeypatch.setattr(lock, "fits", lambda: False)
    assert lock.commands("bench") == plain
    assert lock.commands("test")[0][-1].endswith("[test]")


def test_a_lock_is_written_in_order():
    text = lock.lock({"b": ("1", "x"), "a": ("2", "y")})
    assert text == lock.HEADER + "a==2 \\\n    --hash=sha256:y\nb==1 \\\n    --hash=sha256:x\n"


def test_torch_loads_data_only():
    """Releases before 2.10 have known ways around weights_only."""
    assert "torch>=2.10" in lock.requirements("demo")
