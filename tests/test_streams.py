"""What the commands print, where the terminal's encoding lacks some of it."""

import io
import sys

import pytest

from agents import messages
from bicycle_env import cli, report
from bicycle_env.backends import announcements
from bicycle_env.backends.compiled import CompilerDisabledError
from bicycle_env.streams import take_any_text


@pytest.fixture
def stream(monkeypatch):
    """Make standard output a stream of an encoding; gives a function that reads what was written."""

    def stream(encoding, errors="strict"):
        buffer = io.BytesIO()
        replaced = io.TextIOWrapper(buffer, encoding=encoding, errors=errors)
        monkeypatch.setattr(sys, "stdout", replaced)

        def written():
            replaced.flush()
            return buffer.getvalue().decode(encoding)

        return written

    return stream


@pytest.mark.parametrize("errors", ["strict", "surrogateescape"])
def test_what_an_encoding_lacks_is_written_plainly(stream, errors):
    written = stream("ascii", errors)
    take_any_text()
    sys.stdout.write("9.81 m/s², 3° ± 1, →\n")
    assert written() == "9.81 m/s^2, 3 deg +- 1, ?\n"


def test_what_an_encoding_has_stays(stream):
    written = stream("utf-8")
    take_any_text()
    sys.stdout.write("9.81 m/s², → \udcff")
    assert written() == "9.81 m/s², → ?"


def test_the_users_own_remedy_stays(stream):
    written = stream("ascii", "backslashreplace")
    take_any_text()
    sys.stdout.write("m²")
    assert written() == "m\\xb2"


@pytest.mark.parametrize("replacement", [None, io.StringIO()], ids=["none", "in memory"])
def test_streams_of_another_kind_are_left_alone(monkeypatch, replacement):
    monkeypatch.setattr(sys, "stdout", replacement)
    take_any_text()


@pytest.mark.parametrize("encoding", ["ascii", "cp932", "gbk", "cp1252", "utf-8"])
def test_the_list_of_cars_is_printed_in_every_encoding(stream, encoding):
    written = stream(encoding)
    assert cli.main(["vehicles"]) == 0
    assert "oversteer" in written()


def test_a_report_is_printed_in_every_encoding(stream, monkeypatch):
    study = report.study("civic", 30.0, grid=31)
    report.compute(study, lambda _: None)
    monkeypatch.setattr(cli.report, "study", lambda *_: study)  # what it computes, it keeps
    for encoding, unit in (("cp932", "m/s^2"), ("gbk", "m/s^2"), ("cp1252", "m/s²")):
        written = stream(encoding)
        assert cli.main(["report", "--quiet"]) == 0
        assert unit in written()


def test_the_scripts_print_in_every_encoding(stream):
    """All of them begin with agents.messages.run."""
    written = stream("gbk")
    with pytest.raises(SystemExit) as stopped:
        messages.run(lambda: sys.stdout.write("m²\n") and None)
    assert stopped.value.code == 0
    assert written() == "m^2\n"


def test_quiet_holds_for_what_compiles(monkeypatch, capsys):
    def compute(*_):
        with announcements.progress("a law"):
            announcements.compiling(kept=True)

    monkeypatch.setattr(cli.report, "compute", compute)
    monkeypatch.setattr(cli.report, "as_text", lambda study: "")
    for words, said in (([], True), (["--quiet"], False)):
        assert cli.main(["report", *words]) == 0
        assert ("compiling a law" in capsys.readouterr().err) == said


def test_without_the_compiler_one_line_says_why(monkeypatch, capsys):
    def compute(*_):
        raise CompilerDisabledError("unset it")

    monkeypatch.setattr(cli.report, "compute", compute)
    assert cli.main(["report", "--quiet"]) == 2
    assert capsys.readouterr().err == "bicycle-env: error: unset it\n"
    with pytest.raises(SystemExit) as stopped:
        messages.run(compute)
    assert stopped.value.code == 2
    assert capsys.readouterr().err == "error: unset it\n"
