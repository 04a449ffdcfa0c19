"""Gains of the rear-steer laws of BicycleActiveSteer-v0, tuned by driving thousands of cars at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from bicycle_env.control import REAR_STEERINGS
from bicycle_env.optimum.outcomes import Outcomes, drive, make_cars
from bicycle_env.physics.validation import choice

POPULATION, ELITE = 32, 6
CENTRE = (0.1, 0.0, 0.0, 0.0, -0.1)
SIZE = (0.1, 0.3, 0.5, 0.5, 0.1)
"""Of the gains on ``SIGNALS``: where a search begins, and how far around it."""
LEAST_DEVIATION = 0.02
"""Per size."""


class GainCandidate(NamedTuple):
    """Gains and how they did on the starts that select."""

    gains: tuple[float, ...]
    success_rate: float
    on_road_rate: float
    mean_return: float


class GainTuning(NamedTuple):
    """What a tuning found."""

    best: GainCandidate
    restarts: tuple[GainCandidate, ...]
    """The best of each restart."""


def tune_gains(
    env_id: str,
    keywords: Mapping[str, Any],
    controller: str,
    tuning_seeds: Sequence[int],
    selection_seeds: Sequence[int],
    *,
    restarts: int = 5,
    iterations: int = 40,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> GainTuning:
    """Tune one of ``control.REAR_STEERINGS`` by the cross-entropy method, several times from random places.

    A candidate's score is its success rate plus its mean reward per step of a full episode. Each restart's last mean
    and best candidate are compared once more on other starts. Arguments as those of ``tune_weights``.

    Raises:
        ValueError, TypeError: an unknown controller; a keyword that the environment refuses.
    """
    law = REAR_STEERINGS[choice("controller", controller, REAR_STEERINGS)]
    plant: Any = gym.make(env_id, **keywords).unwrapped
    policy, cars = law(plant), dict[int, Any]()
    repeats = -(-len(law.parameters) // len(CENTRE)) if len(law.parameters) > 1 else 1
    centre, size = (np.tile(values, repeats)[: len(law.parameters)] for values in (CENTRE, SIZE))

    def outcomes(candidates: NDArray[Any], seeds: Sequence[int]) -> list[Outcomes]:
        count, starts = len(candidates), len(seeds)
        if count * starts not in cars:
            cars[count * starts] = make_cars(env_id, keywords, count * starts)
        policy.vary(np.repeat(candidates, starts, axis=0))
        policy.reset()
        driven = drive(cars[count * starts], lambda seen, _: policy.act(seen), [*seeds] * count)
        return [Outcomes._make(value[k * starts : (k + 1) * starts] for value in driven) for k in range(count)]

    def scores(driven: Sequence[Outcomes]) -> NDArray[np.float64]:
        steps = plant.task.episode_steps
        return np.array([np.mean(one.success) + np.mean(one.episode_return) / steps for one in driven])

    finalists: list[NDArray[np.float64]] = []
    for restart in range(restarts):
        random = np.random.default_rng([seed, restart])
        mean, deviation = centre + size * random.standard_normal(len(law.parameters)), 1.5 * size
        best, best_score = mean, -np.inf
        for iteration in range(iterations):
            candidates = mean + deviation * random.standard_normal((POPULATION, len(law.parameters)))
            found = scores(outcomes(candidates, tuning_seeds))
            order = np.argsort(-found, kind="stable")
            if found[order[0]] > best_score:
                best, best_score = candidates[order[0]], found[order[0]]
            elite = candidates[order[:ELITE]]
            mean, deviation = elite.mean(axis=0), np.maximum(elite.std(axis=0), LEAST_DEVIATION * size)
            if progress is not None:
                progress(restart * iterations + iteration + 1, restarts * iterations)
        finalists += [mean, best]
    rounded = [np.array([float(f"{gain:.4g}") for gain in one]) for one in finalists]
    driven = [outcomes(one[None], selection_seeds)[0] for one in rounded]
    ranks = scores(driven)
    found_all = [
        GainCandidate(tuple(one.tolist()), *(float(np.mean(value)) for value in outcome[:3]))
        for one, outcome in zip(rounded, driven, strict=True)
    ]
    winners = [max((2 * k, 2 * k + 1), key=ranks.__getitem__) for k in range(restarts)]
    best_of_all = max(winners, key=ranks.__getitem__)
    return GainTuning(found_all[best_of_all], tuple(found_all[k] for k in winners))
