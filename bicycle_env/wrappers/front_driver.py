"""A driver at the front wheels, so that the action is the rear axle alone: active rear steering."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs


class FrontDriver(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """A policy steers the front wheels; the action, Box(-1, 1, (1,)), is what the rear axle does.

    The observation stays as it is: it holds the front angle and its last command. The driver acts on the observation
    of the step before, once per step, and is reset with the environment. The wrapper owns it: give each environment
    a driver of its own.

    Deprecated: ``gym.make(..., driver=..., steer="rear")`` does this for one car, many and on tensors, with the drivers
    of ``bicycle_env.drivers``. This wrapper remains for policies that are none of these, and will go.

    Args:
        env: an environment that steers both axles, ``steer="both"``.
        driver: a policy with ``act(observation)`` and ``reset()``, for example a driver model of
            ``bicycle_env.control``. The first entry of its action steers the front wheels, the others are not used.

    Raises:
        ValueError: the environment does not steer both axles.
        TypeError: the driver is no policy.
    """

    def __init__(self, env: gym.Env[Any, Any], driver: Any) -> None:
        warnings.warn(
            "FrontDriver is deprecated: give gym.make, gym.make_vec or TorchVectorEnv driver= and steer='rear'",
            DeprecationWarning,
            stacklevel=2,
        )
        RecordConstructorArgs.__init__(self, driver=driver)
        super().__init__(env)
        if not isinstance(env.action_space, spaces.Box) or env.action_space.shape != (2,):
            raise ValueError(f"env must steer both axles, with a Box(-1, 1, (2,)) as action; got {env.action_space}")
        is_policy = callable(getattr(driver, "act", None)) and callable(getattr(driver, "reset", None))
        if isinstance(driver, type) or not is_policy:
            raise TypeError(f"driver must be a policy with act(observation) and reset(), got {driver!r}")
        self.driver = driver
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self._observation: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self._observation, info = self.env.reset(seed=seed, options=options)
        self.driver.reset()
        return self._observation.copy(), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Hold a rear action for one control step; ValueError or TypeError for one that is not one finite number."""
        if self._observation is None:
            raise gym.error.ResetNeeded("call reset() before step()")
        rear = np.asarray(action)
        if rear.dtype.kind not in "fiu":
            raise TypeError(f"action must be one real number in [-1, 1], got {action!r}")
        if rear.shape != (1,) or not np.isfinite(rear[0]):
            raise ValueError(f"action must be one finite number in [-1, 1], shape (1,), got {action!r}")
        both = np.array([self.driver.act(self._observation)[0], rear[0]], np.float32)
        self._observation, reward, terminated, truncated, info = self.env.step(both)
        return self._observation.copy(), reward, terminated, truncated, info
