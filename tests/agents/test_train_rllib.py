"""Ray RLlib has an environment of its own (`make rllib` trains there): without it, one line says so."""

from __future__ import annotations

import importlib.util

import pytest
from rich.console import Console

from agents import train_rllib
from agents.messages import UserError


@pytest.mark.skipif(importlib.util.find_spec("ray") is not None, reason="ray is installed")
def test_without_ray_one_line_says_where_it_is():
    with pytest.raises(UserError, match="needs ray, which has an environment of its own: make rllib"):
        train_rllib.train(train_rllib.Args(), Console(quiet=True))
