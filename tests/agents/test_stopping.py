"""Ctrl-C and SIGTERM end a command with one line, from its first import on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest
from combinations import some_of

from agents import messages, stopping, train

SIGNALS = pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])


@SIGNALS
@pytest.mark.parametrize(
    "module", some_of(["numpy", "numba", "torch", "stable_baselines3"], ["numpy", "stable_baselines3"])
)
def test_a_signal_while_a_command_imports(tmp_path, number, code, module):
    # Found first on the path, the module sends the signal from inside its own import, as if it came at that moment.
    (tmp_path / f"{module}.py").write_text(f"import os\nos.kill(os.getpid(), {int(number)})")
    if module == "stable_baselines3":  # imported before it, and slow
        (tmp_path / "torch.py").write_text("")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-m", "agents.train", "--help"], env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "stopped\n")


@SIGNALS
def test_a_signal_in_main(number, code, capsys):
    before = {number: signal.getsignal(number) for number in stopping.SIGNALS}
    try:
        with pytest.raises(SystemExit) as caught:
            messages.run(lambda: signal.raise_signal(number))
        assert signal.getsignal(number) is stopping.leave_at_once, "the interpreter's end must not see exceptions"
    finally:
        for known, handler in before.items():
            signal.signal(known, handler)
    assert caught.value.code == code
    assert capsys.readouterr().err == "stopped\n"


def test_a_second_signal_leaves_at_once():
    text = (
        "import os, signal\nfrom agents import stopping\n"
        "with stopping.deferred() as request:\n"
        "    signal.raise_signal(signal.SIGTERM)\n    print(request.number, flush=True)\n"
        "    signal.raise_signal(signal.SIGINT)\n    print('never')\n"
    )
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, f"{int(signal.SIGTERM)}\n", "stopped\n")


def test_a_signal_that_is_ignored_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with stopping.deferred() as request:
            signal.raise_signal(signal.SIGINT)
        assert request.number is None
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_handlers_are_put_back():
    before = {number: signal.getsignal(number) for number in stopping.SIGNALS}
    with stopping.deferred() as request:
        signal.raise_signal(signal.SIGINT)
        assert request.number == signal.SIGINT
    assert {number: signal.getsignal(number) for number in stopping.SIGNALS} == before


def test_a_training_stops_where_an_exception_would_be_swallowed(tmp_path, monkeypatch):
    left = []

    class BeyondError(Exception):
        pass

    def build(*_):
        try:
            signal.raise_signal(signal.SIGTERM)
        except BaseException:
            left.append("swallowed")
        raise BeyondError  # the true leave_at_once, which other tests see at work, does not come back

    before = {number: signal.getsignal(number) for number in stopping.SIGNALS}
    monkeypatch.setattr(train, "build", build)
    monkeypatch.setattr(stopping, "leave_at_once", lambda number, _: left.append(number))
    monkeypatch.setattr("sys.argv", ["train", "--out", str(tmp_path / "run")])
    try:
        with pytest.raises(BeyondError):
            messages.run(train.main)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert left == [signal.SIGTERM]
