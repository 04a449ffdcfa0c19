"""Environments without the compiler, for tests of what is around the laws."""

import pytest
from interpreted import interpret


@pytest.fixture
def interpreted(monkeypatch):
    interpret(monkeypatch)
