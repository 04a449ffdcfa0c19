"""Success in ``info``, where Stable-Baselines3 and others look for it."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs


class RecordSuccess(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Adds ``info["is_success"]``: at the end of an episode, whether the task is done.

    Put it outside of the time limit, as ``RecordSuccess(gym.make("BicycleStab-v0"))`` does.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
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
