"""What is said while something compiles: once, with the right name, and not where silence was asked for."""

import threading

import pytest

from bicycle_env.backends import announcements
from bicycle_env.backends.announcements import compiling, not_kept, progress, silenced

START = "bicycle_env: compiling"


def test_nothing_is_said_outside_of_progress_or_where_nothing_compiles(capfd):
    compiling(kept=True)
    not_kept("No space left on device")
    with progress("a law"):
        pass
    assert capfd.readouterr() == ("", "")


def test_one_line_for_several_entry_points(capfd):
    with progress("two laws"):
        compiling(kept=True)
        compiling(kept=True)
    out, err = capfd.readouterr()
    assert out == ""
    assert err == f"{START} two laws, once for this machine ... 0 s\n"


def test_the_innermost_is_named_and_ends_first(capfd):
    with progress("outer"):
        with progress("inner"):
            compiling(kept=True)
        compiling(kept=True)
    assert [line.split()[2] for line in capfd.readouterr().err.splitlines()] == ["inner,", "outer,"]


def test_an_error_inside_ends_the_line(capfd):
    def fail():
        with progress("a law"):
            compiling(kept=True)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    compiling(kept=True)
    assert capfd.readouterr().err.endswith("0 s\n")


def test_what_is_not_kept_is_said_at_the_end(capfd):
    with progress("a law"):
        compiling(kept=True)
        not_kept("No space left on device")
    assert capfd.readouterr().err.endswith(" 0 s, not kept: No space left on device\n")


def test_without_a_cache_it_is_not_once_for_this_machine(capfd):
    with progress("a law"):
        compiling(kept=False)
    assert "a law, anew in every process" in capfd.readouterr().err


def test_silence_holds_for_all_threads_and_ends(capfd):
    def work(label):
        with progress(label):
            compiling(kept=True)

    with silenced():
        with silenced(False):
            work("nothing")
        thread = threading.Thread(target=work, args=("nothing",))
        thread.start()
        thread.join()
    assert capfd.readouterr().err == ""
    work("something")
    assert "something" in capfd.readouterr().err


def test_each_thread_names_its_own(capfd):
    """Two whose work overlaps in the worst order: each line names one, and none is broken."""
    began, both, said, ended, second_said = (threading.Event() for _ in range(5))

    def first():
        with progress("first"):
            began.set()
            both.wait(60)
            compiling(kept=True)
            said.set()
            second_said.wait(60)
        ended.set()

    def second():
        began.wait(60)
        with progress("second"):
            both.set()
            said.wait(60)
            compiling(kept=True)
            second_said.set()
            ended.wait(60)

    threads = [threading.Thread(target=one) for one in (first, second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert capfd.readouterr().err.splitlines() == [
        f"{START} first, {announcements.ONCE} ...",
        f"{START} second, {announcements.ONCE} ...",
        "bicycle_env: compiled first, 0 s",
        "bicycle_env: compiled second, 0 s",
    ]


def test_without_standard_error_nothing_is_said(monkeypatch):
    monkeypatch.setattr("sys.stderr", None)
    with progress("a law"):
        compiling(kept=True)
