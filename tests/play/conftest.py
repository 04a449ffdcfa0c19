"""No test here needs a display, or waits at the end of an episode."""

import pytest

from bicycle_env.play import window


@pytest.fixture(autouse=True)
def no_display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(window, "LINGER", 0.04)
