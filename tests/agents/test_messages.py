"""What the commands print, on consoles that lack characters, and bars that take text as text."""

import importlib
import io
import re
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


@pytest.mark.parametrize(
    ("module", "words", "text"),
    [
        ("seeds", ["--episodes", "0"], "--episodes must be at least 1, got 0"),
        ("seeds", ["--evaluation-seed", "-1"], "--evaluation-seed must be at least 0, got -1"),
        ("seeds", ["--total-timesteps", "0"], "--total-timesteps must be at least 1, got 0"),
        ("seeds", ["--seeds", "0"], "--seeds must be at least 1, got 0"),
        ("benchmark", ["--jobs", "0"], "--jobs must be at least 1, got 0"),
        ("moving_picture", ["--starts", "0"], "--starts must be at least 1, got 0"),
        ("benchmark", ["--seeds", "0"], "--seeds must be at least 1, got 0"),
        ("demo", ["--episodes", "-1"], "--episodes must be at least 1, got -1"),
        ("evaluate", ["--policy"], "--policy must name at least one policy"),
        ("evaluate", ["--env-keywords", '{"max_episode_steps": -1}'], "max_episode_steps must be at least 1"),
        ("train", ["--env-keywords", '{"num_envs": 3}'], "num_envs is chosen by the training itself"),
        ("train", ["--out", ""], "--out must name a folder of its own, not the one you are in"),
        ("headroom", ["--search-seed", "-1"], "--search-seed must be at least 0, got -1"),
        ("tune", ["--restarts", "0"], "--restarts must be at least 1, got 0"),
    ],
)
def test_a_mistake_is_found_before_any_work(module, words, text, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", [module, *words])
    with pytest.raises(messages.UserError, match=re.escape(text)):
        importlib.import_module(f"agents.{module}").main()
    assert [path.name for path in tmp_path.iterdir()] == []
