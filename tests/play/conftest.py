"""No test here needs a display, or waits at the end of an episode."""

import pytest

from bicycle_env.play import window


@pytest.fixture(autouse=True)
def no_display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(window, "LINGER", 0.04)
    monkeypatch.setattr(window, "MOST_BEHIND", 0.0)  # however busy the machine is
