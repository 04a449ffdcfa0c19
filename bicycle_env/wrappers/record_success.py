"""Success in ``info``, where Stable-Baselines3 and others look for it."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs


class RecordSuccess(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Adds ``info["is_success"]``: at the end of an episode, whether the task is done.

    Deprecated: the environments of this package tell it by themselves. This wrapper will go.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        warnings.warn("RecordSuccess is deprecated: info has is_success without it", DeprecationWarning, stacklevel=2)
        RecordConstructorArgs.__init__(self)
        super().__init__(env)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, {**info, "is_success": False}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        plant: Any = self.env.unwrapped
        info["is_success"] = plant.is_success
        return observation, reward, terminated, truncated, info
