"""Environments without the compiler, for tests of what a task says."""

import pytest
from interpreted import interpret


@pytest.fixture
def interpreted(monkeypatch):
    interpret(monkeypatch)
