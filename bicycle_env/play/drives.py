"""One policy in an environment of its own, step by step, so that several drive side by side from the same start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bicycle_env.control import Policy

SAVED = "saved"


class Drive:
    """A policy and its environment; `name` stands above its picture.

    Attributes, of the episode that is driven: ``over``; ``words``: "" while it runs, then why it ended, "saved", or
    what was missed; ``states`` (steps + 1 tuples), ``observations`` (as many), ``actions`` and ``rewards`` (steps).
    """

    def __init__(self, name: str, env: Any, policy: Policy) -> None:
        self.name, self.env, self.policy = name, env, policy
        self.plant: Any = env.unwrapped
        self.over, self.words = True, ""
        self.states: list[Any] = []
        self.observations: list[Any] = []
        self.actions: list[Any] = []
        self.rewards: list[float] = []

    def start(self, seed: int) -> None:
        """Begin an episode."""
        observation, _ = self.env.reset(seed=seed)
        self.policy.reset()
        self.over, self.words = False, ""
        self.states, self.observations, self.actions, self.rewards = [self.plant.state], [observation], [], []

    def step(self) -> None:
        """One step; none once the episode is over."""
        if self.over:
            return
        action = self.policy.act(self.observations[-1])
        observation, reward, terminated, truncated, _ = self.env.step(action)
        self.states.append(self.plant.state)
        self.observations.append(observation)
        self.actions.append(np.array(action))
        self.rewards.append(float(reward))
        self.over = terminated or truncated
        if self.over:
            self.words = self._outcome(terminated)

    @property
    def saved(self) -> bool:
        """Whether the episode is over and was a success."""
        return self.words == SAVED

    def _outcome(self, terminated: bool) -> str:
        plant = self.plant
        if terminated:
            from bicycle_env.rendering.told import in_words

            return in_words(plant.end)
        missed = [name.replace("_", " ") for name in plant.task.forfeits if getattr(plant.state, name) > 0.5]
        return SAVED if plant.is_success else ", ".join(["failed", *missed])


def together(drives: Sequence[Drive], seed: int, show: Callable[[int, bool], bool]) -> bool:
    """One episode of all from the start that the seed gives, as long as the longest; one that has ended stands still.

    ``show(step, over)`` after each step, and at the start: whether to go on. False where it did not.
    """
    for one in drives:
        one.start(seed)
    step = 0
    while show(step, over := all(one.over for one in drives)):
        if over:
            return True
        for one in drives:
            one.step()
        step += 1
    return False


def panels_of(drives: Sequence[Drive]) -> list[Any]:
    """The present picture of each: all of it where there is one, else the road alone."""
    from bicycle_env.rendering.moving import Panel, top_view

    cut = top_view if len(drives) > 1 else np.asarray
    return [
        Panel(
            f"{one.name}: {one.words}" if one.words else one.name,
            cut(one.env.render()),
            bool(one.words and not one.saved),
        )
        for one in drives
    ]


def caption_of(drives: Sequence[Drive]) -> tuple[str, ...]:
    """What the start of several has drawn, which is the same for all of them; () for one, whose picture says it."""
    from bicycle_env.rendering.told import drawn_in_words

    if len(drives) == 1:
        return ()
    words = drawn_in_words(drives[0].plant.task, drives[0].plant.state)
    return ("the same start for all:", *words) if words else ("the same start for all",)
