"""Parameters of a controller, tuned for an environment by driving thousands of cars at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from bicycle_env import control
from bicycle_env.control import Candidates, Parameter, TunableLaw, TunablePolicy
from bicycle_env.optimum.outcomes import Outcomes, drive, make_cars
from bicycle_env.physics.validation import choice

Matrix = NDArray[np.float64]

ELITE = 0.2
"""Of the population."""
SCORES = {"both": (1.0, 1.0), "success": (1.0, 0.0), "return": (0.0, 1.0)}
"""What the success rate and the mean reward per step count."""
NEAR = 1.0 / 3.0
"""Of the usual deviation, about parameters from which a search begins."""


class Budget(NamedTuple):
    """Of one restart."""

    population: int
    iterations: int


LAW, DESIGN = Budget(32, 40), Budget(24, 10)
"""Of a law, whose cars have parameters of their own; of a controller that must be designed for each candidate."""


class Candidate(NamedTuple):
    """Parameters and how they did on the starts that select."""

    parameters: dict[str, float]
    success_rate: float
    on_road_rate: float
    mean_return: float


class Tuning(NamedTuple):
    """What a tuning found."""

    best: Candidate
    """Of all restarts, and of the usual parameters, the best on the starts that select."""
    restarts: tuple[Candidate, ...]
    """The best of each restart: their spread tells how far the result depends on chance."""
    shipped: Candidate | None
    """Those that the controller has without tuning, on the same starts; None where it has none for the task."""


def tune(
    env_id: str,
    keywords: Mapping[str, Any],
    controller: str,
    tuning_seeds: Sequence[int],
    selection_seeds: Sequence[int],
    *,
    restarts: int = 5,
    iterations: int | None = None,
    seed: int = 0,
    score: str = "both",
    begin: Mapping[str, float] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Tuning:
    """Tune a controller's parameters for an environment.

    The cross-entropy method, several times from random places. A candidate's score is its success rate plus its mean
    reward per step of a full episode, or one of the two. Each restart's last mean and best candidate are compared once
    more on other starts, and so are the controller's usual parameters.

    Args:
        env_id: a registered id of this package.
        keywords: of the environment.
        controller: one of ``control.TUNABLE``, or "module:Class" of one's own.
        tuning_seeds: the starts that candidates are scored on.
        selection_seeds: other starts, on which the best is chosen.
        restarts: how many times.
        iterations: of each; by default ``budget``'s.
        seed: of the random numbers; the same seed gives the same parameters on one machine.
        score: "success", "return" or "both".
        begin: parameters about which every restart begins, closer than about a random place.
        progress: called with how many iterations are done, and of how many.

    Raises:
        ValueError, TypeError: an unknown controller or score, or one that cannot drive this environment; a keyword that
            the environment refuses.
        numpy.linalg.LinAlgError: no parameters gave a controller.
    """
    plant: Any = gym.make(env_id, **keywords).unwrapped
    law = control.tunable(controller)
    space = Space(control.searched(law, plant))
    population = budget(law).population
    iterations = iterations or budget(law).iterations
    judge = _Judge(env_id, keywords, law, plant, choice("score", score, SCORES))
    finalists: list[Matrix] = []
    for restart in range(restarts):
        random = np.random.default_rng([seed, restart])
        mean, deviation = space.beginning(random)
        if begin is not None:
            mean, deviation = space.places(control.values_of(law, plant, begin)), NEAR * space.deviation
        best, best_score = mean, -np.inf
        for iteration in range(iterations):
            places = space.clipped(mean + deviation * random.standard_normal((population, len(mean))))
            scores = judge.scores(judge.outcomes(space.values(places), tuning_seeds))
            order = np.argsort(-scores, kind="stable")
            if scores[order[0]] > best_score:
                best, best_score = places[order[0]], scores[order[0]]
            elite = places[order[: round(ELITE * population)]]
            mean, deviation = elite.mean(axis=0), np.maximum(elite.std(axis=0), space.least_deviation)
            if progress is not None:
                progress(restart * iterations + iteration + 1, restarts * iterations)
        finalists += list(rounded(space.values(np.array([mean, best]))))
    usual = law.usual(plant)
    if usual is not None:
        finalists.append(control.values_of(law, plant, usual))
    outcomes = judge.outcomes(np.array(finalists), selection_seeds)
    ranks = judge.scores(outcomes)
    if np.max(ranks) == -np.inf:
        raise np.linalg.LinAlgError(f"no parameters give a {controller} for {env_id} with {dict(keywords)}")
    found = [space.candidate(*pair) for pair in zip(finalists, outcomes, strict=True)]
    winners = [max((2 * k, 2 * k + 1), key=ranks.__getitem__) for k in range(restarts)]
    best_of_all = max([*winners, *range(2 * restarts, len(found))], key=ranks.__getitem__)
    return Tuning(found[best_of_all], tuple(found[k] for k in winners), None if usual is None else found[-1])


def budget(controller: type[TunablePolicy]) -> Budget:
    """What a restart takes, by default."""
    return LAW if issubclass(controller, TunableLaw) else DESIGN


def rounded(values: Matrix) -> Matrix:
    """To four significant digits."""
    found: Matrix = np.array([float(f"{value:.4g}") for value in values.ravel()]).reshape(values.shape)
    return found


class Space:
    """Where the search goes: the parameters themselves, or their decimal logarithms."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self._names = [one.name for one in parameters]
        self._logarithmic = np.array([one.scale == "log" for one in parameters])
        ends = np.array(
            [(one.least, one.greatest, one.least if one.start is None else one.start) for one in parameters]
        )
        ends[self._logarithmic] = np.log10(ends[self._logarithmic])
        low, high, self._start = ends.T
        self.bounds = low, high
        self._anywhere = np.array([one.start is None for one in parameters])
        self._spread = np.array([one.spread for one in parameters])
        self.deviation = np.where(self._anywhere, (high - low) / 3.0, 1.5 * self._spread)
        """At first."""
        self.least_deviation = np.where(self._logarithmic, 0.03, 0.02 * self._spread)

    def beginning(self, random: np.random.Generator) -> tuple[Matrix, Matrix]:
        """A restart's first mean and deviation."""
        mean, (low, high) = self._start.copy(), self.bounds
        free, known = self._anywhere, ~self._anywhere
        mean[free] = random.uniform(low[free], high[free])
        mean[known] += self._spread[known] * random.standard_normal(np.count_nonzero(known))
        return mean, self.deviation

    def clipped(self, places: Matrix) -> Matrix:
        found: Matrix = np.clip(places, *self.bounds)
        return found

    def values(self, places: Matrix) -> Matrix:
        """Of places (sets, parameters); four significant digits of what is searched by its logarithm."""
        values = places.copy()
        values[:, self._logarithmic] = rounded(10.0 ** places[:, self._logarithmic])
        return values

    def places(self, values: Matrix) -> Matrix:
        """Of one set of values, (parameters,)."""
        places = values.copy()
        places[self._logarithmic] = np.log10(values[self._logarithmic])
        return places

    def candidate(self, values: Matrix, outcome: Outcomes | None) -> Candidate:
        figures = (0.0, 0.0, -np.inf) if outcome is None else (float(np.mean(value)) for value in outcome[:3])
        return Candidate(dict(zip(self._names, values.tolist(), strict=True)), *figures)


class _Judge:
    """Drives every candidate from the same starts, all in one vector environment."""

    def __init__(
        self, env_id: str, keywords: Mapping[str, Any], law: type[TunablePolicy], plant: Any, score: str
    ) -> None:
        self._env_id, self._keywords, self._law, self._plant = env_id, keywords, law, plant
        self._score = SCORES[score]
        self._cars: dict[int, Any] = {}

    def outcomes(self, values: Matrix, seeds: Sequence[int]) -> list[Outcomes | None]:
        """Of each candidate, (starts,) each; None where its values give no controller to working precision."""
        sets, starts = len(values), len(seeds)
        policy = Candidates(self._law, self._plant, values, starts)
        if sets * starts not in self._cars:
            self._cars[sets * starts] = make_cars(self._env_id, self._keywords, sets * starts)
        policy.reset()
        driven = drive(self._cars[sets * starts], lambda seen, _: policy.act(seen), [*seeds] * sets)
        return [
            Outcomes._make(value[k * starts : (k + 1) * starts] for value in driven) if policy.valid[k] else None
            for k in range(sets)
        ]

    def scores(self, outcomes: Sequence[Outcomes | None]) -> Matrix:
        """Success rate plus mean reward per step of a full episode, or one of the two; -inf for None."""
        won, paid = self._score[0], self._score[1] / self._plant.task.episode_steps
        return np.array(
            [
                -np.inf if one is None else won * np.mean(one.success) + paid * np.mean(one.episode_return)
                for one in outcomes
            ]
        )
