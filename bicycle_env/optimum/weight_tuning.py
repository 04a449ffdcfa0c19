"""Weights of the LQR, tuned for an environment by driving thousands of cars at once."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from bicycle_env.control import LQR, Policy, Weights, tuned_weights
from bicycle_env.optimum.outcomes import Outcomes, drive, make_cars

LOGARITHMS = {
    "heading": (0.0, 3.5),
    "sideslip": (-1.0, 3.5),
    "yaw_rate": (-2.0, 2.5),
    "front_command": (-2.0, 1.5),
    "rear_command": (-2.0, 1.5),
}
"""log10 of each weight that is searched: least and greatest. One weight only scales the others: that of the lateral
position is 1."""
UNUSED = {"front": "rear_command", "rear": "front_command", "both": ""}
"""The weight that says nothing where an axle is not steered."""
POPULATION, ELITE = 24, 5
LEAST_DEVIATION = 0.03


class Candidate(NamedTuple):
    """Weights and how they did on the starts that select."""

    weights: Weights
    success_rate: float
    on_road_rate: float
    mean_return: float


class Tuning(NamedTuple):
    """What a tuning found."""

    best: Candidate
    """Of all restarts, and of the shipped weights, the best on the starts that select."""
    restarts: tuple[Candidate, ...]
    """The best of each restart: their spread tells how far the result depends on chance."""
    shipped: Candidate | None
    """The task's shipped weights on the same starts; None for a task that comes without."""


def tune_weights(
    env_id: str,
    keywords: Mapping[str, Any],
    tuning_seeds: Sequence[int],
    selection_seeds: Sequence[int],
    *,
    restarts: int = 5,
    iterations: int = 10,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Tuning:
    """Tune the LQR's weights for an environment.

    The cross-entropy method on the logarithms of the weights, several times from random places. A candidate's score is
    its success rate plus its mean reward per step of a full episode. Each restart's last mean and best candidate are
    compared once more on other starts, and so are the task's shipped weights.

    Args:
        env_id: a registered id of this package.
        keywords: of the environment.
        tuning_seeds: the starts that candidates are scored on.
        selection_seeds: other starts, on which the best is chosen.
        restarts: how many times.
        iterations: of each.
        seed: of the random numbers; the same seed gives the same weights on one machine.
        progress: called with how many iterations are done, and of how many.

    Raises:
        ValueError, TypeError: a keyword that the environment refuses.
        numpy.linalg.LinAlgError: no weights gave a regulator.
    """
    plant: Any = gym.make(env_id, **keywords).unwrapped
    names = [name for name in LOGARITHMS if name != UNUSED[plant.steer]]
    low, high = np.array([LOGARITHMS[name] for name in names]).T
    judge = _Judge(env_id, keywords, plant)
    shipped: list[Weights] = []
    with contextlib.suppress(ValueError):  # none come with the package for this task
        shipped.append(tuned_weights(plant.task.name))
    finalists: list[Weights] = []
    for restart in range(restarts):
        random = np.random.default_rng([seed, restart])
        mean, deviation = random.uniform(low, high), (high - low) / 3.0
        best, best_score = mean, -np.inf
        for iteration in range(iterations):
            places = np.clip(mean + deviation * random.standard_normal((POPULATION, len(names))), low, high)
            scores = judge.scores([_weights(names, place) for place in places], tuning_seeds)
            order = np.argsort(-scores, kind="stable")
            if scores[order[0]] > best_score:
                best, best_score = places[order[0]], scores[order[0]]
            elite = places[order[:ELITE]]
            mean, deviation = elite.mean(axis=0), np.maximum(elite.std(axis=0), LEAST_DEVIATION)
            if progress is not None:
                progress(restart * iterations + iteration + 1, restarts * iterations)
        finalists += [_weights(names, mean), _weights(names, best)]
    finalists += shipped
    outcomes = judge.outcomes(finalists, selection_seeds)
    ranks = [judge.score(outcome) for outcome in outcomes]
    if max(ranks) == -np.inf:
        raise np.linalg.LinAlgError(f"no weights give a regulator for {env_id} with {dict(keywords)}")
    candidates = [_candidate(*pair) for pair in zip(finalists, outcomes, strict=True)]
    winners = [max((2 * k, 2 * k + 1), key=ranks.__getitem__) for k in range(restarts)]
    best_of_all = max([*winners, *range(2 * restarts, len(candidates))], key=ranks.__getitem__)
    restarted = tuple(candidates[k] for k in winners)
    return Tuning(candidates[best_of_all], restarted, candidates[-1] if shipped else None)


class _Judge:
    """Drives every candidate from the same starts, all in one vector environment."""

    def __init__(self, env_id: str, keywords: Mapping[str, Any], plant: Any) -> None:
        self._env_id, self._keywords, self._plant = env_id, keywords, plant
        self._cars: dict[int, Any] = {}

    def outcomes(self, candidates: Sequence[Weights], seeds: Sequence[int]) -> list[Outcomes | None]:
        """Of each candidate, (starts,) each; None where its design has no solution to working precision."""
        policies: list[Policy | None] = []
        for weights in candidates:
            try:
                policies.append(LQR(self._plant, weights))
            except np.linalg.LinAlgError:
                policies.append(None)
        count, starts = len(candidates), len(seeds)
        if count * starts not in self._cars:
            self._cars[count * starts] = make_cars(self._env_id, self._keywords, count * starts)
        cars = self._cars[count * starts]
        actions = np.zeros(cars.action_space.shape, np.float32)

        def act(observation: NDArray[Any], _: int) -> NDArray[Any]:
            for k, policy in enumerate(policies):
                if policy is not None:
                    rows = slice(k * starts, (k + 1) * starts)
                    actions[rows] = policy.act(observation[rows])
            return actions

        driven = drive(cars, act, [*seeds] * count)
        return [
            None if policy is None else Outcomes._make(value[k * starts : (k + 1) * starts] for value in driven)
            for k, policy in enumerate(policies)
        ]

    def score(self, outcome: Outcomes | None) -> float:
        """Success rate plus mean reward per step of a full episode."""
        if outcome is None:
            return -np.inf
        return float(np.mean(outcome.success) + np.mean(outcome.episode_return) / self._plant.task.episode_steps)

    def scores(self, candidates: Sequence[Weights], seeds: Sequence[int]) -> NDArray[np.float64]:
        return np.array([self.score(outcome) for outcome in self.outcomes(candidates, seeds)])


def _weights(names: Sequence[str], logarithms: NDArray[np.float64]) -> Weights:
    """Weights of four significant digits, those that are not searched 1."""
    found = {name: float(f"{10.0**value:.4g}") for name, value in zip(names, logarithms.tolist(), strict=True)}
    return Weights(**{**dict.fromkeys(Weights._fields, 1.0), **found})


def _candidate(weights: Weights, outcome: Outcomes | None) -> Candidate:
    if outcome is None:
        return Candidate(weights, 0.0, 0.0, -np.inf)
    success, on_road, returns = (float(np.mean(value)) for value in outcome[:3])
    return Candidate(weights, success, on_road, returns)
