"""What the commands print, on consoles that lack characters, and bars that take text as text."""

import io
import sys

import pytest

from agents import messages
from bicycle_env.streams import take_any_text


@pytest.mark.parametrize("encoding", ["gbk", "cp932", "ascii", "utf-8"])
def test_a_bar_is_drawn_on_every_console(monkeypatch, encoding):
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(written, encoding))
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    monkeypatch.setenv("TERM", "xterm")
    take_any_text()
    with messages.progress() as bar:
        job = bar.add_task("[/red] 5 \u00b0 \u00b2 \u8f66 \U0001f697", total=2)
        bar.update(job, completed=1)
        bar.refresh()
    sys.stderr.flush()
    assert "[/red] 5" in written.getvalue().decode(encoding)
    assert "50%" in written.getvalue().decode(encoding)
