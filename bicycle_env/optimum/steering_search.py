"""What some steering saves: for each start a search over steering sequences in the true simulator.

A sequence is added to the actions of a feedback, which does the fine work; the search decides what the feedback cannot
know. It is the cross-entropy method (R. Y. Rubinstein, D. P. Kroese, The Cross-Entropy Method, Springer 2004) on the
values of the sequence at knots. It finds a lower bound of what can be saved: what it does not save may be savable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control import Policy
from bicycle_env.optimum.outcomes import Outcomes, drive, make_cars

Array = NDArray[np.float64]

KNOTS, STEPS_PER_KNOT = 40, 6
"""The first 240 control steps; after the last knot the feedback drives alone."""
FIRST_DEVIATION, LEAST_DEVIATION = 0.7, 0.05
"""Of the values at the knots, in actions: 1 is the full angle."""
STROKE = 2.0
"""Largest value of the piecewise constant samples: it turns a full angle of the feedback round."""
PIECE = (3, 12)
"""Knots that such a sample keeps its value."""
BATCH = 48
"""Starts at a time."""


class Rescue(NamedTuple):
    """The best that was found for one start."""

    success: bool
    on_road: bool
    episode_return: float
    iterations: int
    """Iterations used; 0 where the feedback alone succeeds."""
    actions: NDArray[np.float32]
    """(steps, axles), what was sent to the environment until the episode's end."""


def search_steering(
    env_id: str,
    keywords: Mapping[str, Any],
    feedback: Policy,
    seeds: Sequence[int],
    *,
    samples: int = 192,
    iterations: int = 40,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> list[Rescue]:
    """Search for steering that saves the car, start by start; a start is done at its first success.

    Better is: success, then the larger sum of the return and the steps driven.

    Args:
        env_id: a registered id of this package.
        keywords: of the environment.
        feedback: a policy without memory, which is given many observations at a time.
        seeds: of the starts, as for ``reset``.
        samples: sequences per start and iteration, at least 8.
        iterations: at most so many.
        seed: of the random numbers; each start has its own stream.
        progress: called with how many starts are done.

    Returns:
        For each start the best that was found. Its actions, sent to the single environment from the same seed, repeat
        the episode to the bit.
    """
    if samples < 8:
        raise ValueError(f"samples must be at least 8, got {samples}")
    alone = _tried(env_id, keywords, feedback, seeds, None)
    found = {k: alone.rescue(k, 0) for k in range(len(seeds))}
    failed = [k for k in found if not found[k].success]
    for first in range(0, len(failed), BATCH):
        if progress is not None:
            progress(len(seeds) - len(failed) + first)
        searches = {k: _Search(seeds[k], samples, alone.axles, seed) for k in failed[first : first + BATCH]}
        for iteration in range(1, iterations + 1):
            if not searches:
                break
            knots = np.concatenate([search.draw() for search in searches.values()])
            tried = _tried(
                env_id, keywords, feedback, [s.seed for s in searches.values() for _ in range(samples)], knots
            )
            for place, (k, search) in enumerate(list(searches.items())):
                rows = slice(place * samples, (place + 1) * samples)
                best = rows.start + search.learn(tried.ranks[rows])
                rescue = tried.rescue(best, iteration)
                if _rank(rescue) > _rank(found[k]):
                    found[k] = rescue
                if rescue.success:
                    del searches[k]
    if progress is not None:
        progress(len(seeds))
    return [found[k] for k in range(len(seeds))]


class _Search:
    """The distribution of one start's sequences."""

    def __init__(self, start: int, samples: int, axles: int, seed: int) -> None:
        self.seed = start
        self._random = np.random.default_rng([seed, start])
        self._mean = np.zeros((KNOTS, axles))
        self._deviation = np.full((KNOTS, axles), FIRST_DEVIATION)
        self._samples, self._first = samples, True
        self._drawn = np.zeros((samples, KNOTS, axles))

    def draw(self) -> Array:
        """(samples, knots, axles): values to be added to the feedback's actions."""
        noise = self._random.standard_normal(self._drawn.shape)
        self._drawn = np.clip(self._mean + self._deviation * noise, -STROKE, STROKE)
        if self._first:  # half of them hold their value for a while, as a driver's wide strokes do
            for sequence in self._drawn[::2]:
                place = 0
                while place < KNOTS:
                    length = int(self._random.integers(*PIECE, endpoint=True))
                    sequence[place : place + length] = self._random.uniform(-STROKE, STROKE, sequence.shape[1])
                    place += length
            self._first = False
        return self._drawn

    def learn(self, ranks: Array) -> int:
        """Move to the elite, an eighth of the samples; gives the best sample's index."""
        order = np.argsort(-ranks, kind="stable")
        elite = self._drawn[order[: self._samples // 8]]
        self._mean = elite.mean(axis=0)
        self._deviation = np.maximum(elite.std(axis=0), LEAST_DEVIATION)
        return int(order[0])


class _Tried(NamedTuple):
    """Episodes with added steering, one per row."""

    outcomes: Outcomes
    actions: NDArray[np.float32]
    """(steps, rows, axles)."""
    ranks: Array
    axles: int

    def rescue(self, row: int, iteration: int) -> Rescue:
        success, on_road, episode_return, steps = (values[row] for values in self.outcomes)
        return Rescue(bool(success), bool(on_road), float(episode_return), iteration, self.actions[:steps, row].copy())


def _rank(rescue: Rescue) -> tuple[bool, float]:
    return rescue.success, rescue.episode_return + len(rescue.actions)


def _tried(
    env_id: str, keywords: Mapping[str, Any], feedback: Policy, seeds: Sequence[int], knots: Array | None
) -> _Tried:
    """One episode from each seed with the feedback and, after it, the steering of these knots (rows, knots, axles)."""
    cars = make_cars(env_id, keywords, len(seeds))
    sent: list[NDArray[np.float32]] = []
    values = None if knots is None else np.ascontiguousarray(knots.transpose(1, 0, 2))

    def act(observation: NDArray[Any], step: int) -> NDArray[Any]:
        actions = feedback.act(observation)
        knot, between = divmod(step, STEPS_PER_KNOT)
        if values is not None and knot < KNOTS:
            share = between / STEPS_PER_KNOT
            following = values[knot + 1] if knot + 1 < KNOTS else 0.0
            added = (1.0 - share) * values[knot] + share * following
            actions = np.clip(actions + added, -1.0, 1.0).astype(np.float32)
        sent.append(actions)
        return actions

    outcomes = drive(cars, act, seeds)
    cars.close()
    # Any success stands before any failure: no sum of a return and of steps reaches that far.
    ranks = np.where(outcomes.success, 1e300, outcomes.episode_return + outcomes.steps)
    return _Tried(outcomes, np.array(sent), ranks, cars.single_action_space.shape[0])
