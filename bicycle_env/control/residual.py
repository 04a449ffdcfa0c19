"""A residual policy: a network's action added to a controller's (T. Silver et al., arXiv:1812.06298)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control.network import Network
from bicycle_env.control.policy import Array, Policy


class Residual(Policy):
    """The sum of two actions, limited to [-1, 1]: the controller acts at every call, the network as its file says.

    Args:
        network: its ``description`` names the controller as its ``base``.
        base: this controller.
    """

    name = "residual"

    def __init__(self, network: Network, base: Policy) -> None:
        self.network, self.base = network, base

    @property
    def description(self) -> dict[str, Any]:
        """That of the network's file."""
        return self.network.description

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self.network.reset(rows)
        self.base.reset(rows)

    def act(self, observation: Array) -> NDArray[np.float32]:
        return added(self.base.act(observation), self.network.act(observation))


def added(base: Any, more: Any) -> NDArray[np.float32]:
    """What is driven: in training, too."""
    return np.asarray(np.clip(base + more, -1.0, 1.0), np.float32)
