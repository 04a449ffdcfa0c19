"""Controllers and policies: one interface, an observation in and an action out."""

from __future__ import annotations

from bicycle_env.control.lqr import LQR, Weights
from bicycle_env.control.network import Network, load
from bicycle_env.control.policy import Plant, Policy, Zero
from bicycle_env.physics.validation import choice

POLICIES: dict[str, type[Zero] | type[LQR]] = {"zero": Zero, "lqr": LQR}
"""The controllers that ``make`` knows by name."""

__all__ = ["LQR", "POLICIES", "Network", "Plant", "Policy", "Weights", "Zero", "load", "make"]


def make(name: str, env: Plant) -> Policy:
    """A controller by name, designed for an environment (``env.unwrapped``); ValueError for an unknown name."""
    return POLICIES[choice("policy", name, POLICIES)](env)
