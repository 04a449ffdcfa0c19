"""A human at the front wheels: arrow keys or the stick of a gamepad; any policy at the rear ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control import Policy
from bicycle_env.control.four_wheel_steer import RearLaw
from bicycle_env.control.policy import Array
from bicycle_env.rendering.painting import pygame

TURN = 2.0
"""Of the steering wheel while a key is held, full lock per s."""
RETURN = 4.0
"""Back to the middle, once it is let go."""
DEAD = 0.08
"""A stick within this share of its way is let go."""
KEYS = {pygame.K_LEFT: 1.0, pygame.K_a: 1.0, pygame.K_RIGHT: -1.0, pygame.K_d: -1.0}
"""To the left is positive."""


class Human(Policy):
    """Steers the front wheels by what :meth:`take` was told; `rear` the others.

    Args:
        plant: the environment.
        rear: what steers the rear wheels, a rear-steer law after the front ones; None where they are not steered.
    """

    name = "human"

    def __init__(self, plant: Any, rear: Policy | RearLaw | None = None) -> None:
        self._timestep, self._rear = float(plant.action_timestep), rear
        self._held: set[int] = set()
        self._stick = 0.0
        self.wheel = 0.0
        """In [-1, 1], of the angle limit; positive to the left."""

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self.wheel = 0.0
        if self._rear is not None:
            self._rear.reset(rows)

    def take(self, event: Any) -> None:
        """One event of pygame's queue."""
        if event.type == pygame.KEYDOWN and event.key in KEYS:
            self._held.add(event.key)
        elif event.type == pygame.KEYUP:
            self._held.discard(event.key)
        elif event.type == pygame.JOYAXISMOTION and event.axis == 0:
            self._stick = 0.0 if abs(event.value) < DEAD else -float(event.value)

    def act(self, observation: Array) -> NDArray[np.float32]:
        wanted = sum(KEYS[key] for key in self._held)
        if self._stick:
            self.wheel = self._stick
        elif wanted:
            self.wheel = min(max(self.wheel + wanted * TURN * self._timestep, -1.0), 1.0)
        else:
            way = RETURN * self._timestep
            self.wheel -= min(max(self.wheel, -way), way)
        if self._rear is None:
            return np.array([self.wheel], np.float32)
        if isinstance(self._rear, RearLaw):
            return np.array([self.wheel, self._rear.act(np.array(self.wheel), observation)], np.float32)
        return np.array([self.wheel, self._rear.act(observation)[-1]], np.float32)
