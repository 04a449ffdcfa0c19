"""A law that plans: what it may plan anew for every start is an affine function of what the start shows, searched.

Between a law with one set of parameters for all starts (:mod:`tuning`) and one with parameters of its own for each
(:mod:`parameter_search`): the start is looked at, the plan is made, and nothing else is searched while it drives. So it
is a policy, and a teacher for others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env import control
from bicycle_env.control import Policy, TunableLaw
from bicycle_env.optimum.outcomes import Cars, by, drive
from bicycle_env.optimum.tuning import Space
from bicycle_env.physics.validation import whole

Matrix = NDArray[np.float64]

ELITE = 0.2
"""Of the samples."""
STEP = 0.7
"""Of the way to the elite: one iteration's starts are not all starts."""
BEGINNING, LEAST = 0.33, 0.017
"""Deviations at first and at least, per those of a tuning that begins anywhere."""
OF_WEIGHTS = 0.2
"""The same, of what is no part of the plan, per those of the plan: it was tuned before."""
SAME = 1e-6
"""Standard deviation of a direction in which starts count as all alike."""


class Planned(Policy):
    """A law whose parameters are chosen for each car by what it shows first.

    Args:
        law: of parameters; it drives.
        space: of its parameters.
        center, directions: (entries,) and (entries, features): features are ``(observation - center) @ directions``.
        affine: (1 + features, parameters): places in `space` are ``[1, features] @ affine``, within its bounds; (cars,
            1 + features, parameters) where each car has its own.
    """

    def __init__(self, law: TunableLaw, space: Space, center: Matrix, directions: Matrix, affine: Matrix) -> None:
        self.name = f"planned {law.name}"
        self._law, self._space = law, space
        self._center, self._directions, self._affine = center, directions, affine
        self._values: Matrix | None = None
        self._new: NDArray[np.bool_] | None = None

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self._law.reset(rows)
        if rows is None:
            self._values = None
        elif self._new is not None:
            self._new = self._new | rows

    def act(self, observation: Any) -> NDArray[np.float32]:
        cars = np.atleast_2d(observation)
        if self._values is None or self._new is None:
            self._values, self._new = np.zeros((len(cars), self._affine.shape[-1])), np.ones(len(cars), np.bool_)
        if np.any(self._new):
            self._values = np.where(self._new[:, None], self.plan(cars), self._values)
            self._new = np.zeros(len(cars), np.bool_)
            self._law.vary(self._values)
        return self._law.act(observation)

    def plan(self, observation: Any) -> Matrix:
        """(cars, parameters) for what cars show at the start, (cars, entries)."""
        shown = (np.asarray(observation, np.float64) - self._center) @ self._directions
        features = np.hstack((np.ones((len(shown), 1)), shown))
        places = np.einsum("...f,...fp->...p", features, self._affine)
        return self._space.values(self._space.clipped(places))


def search_plan(
    env_id: str,
    keywords: Mapping[str, Any],
    law: TunableLaw,
    starts: Callable[[int], Sequence[int]],
    *,
    samples: int = 48,
    iterations: int = 60,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Planned:
    """Search for the plan of a law by the cross-entropy method, about the parameters that the law has.

    A sample's score is its success rate plus its mean reward per step of a full episode. The features are those
    entries of the first observation that a mirror image leaves as they are, along the directions in which the first
    iteration's starts differ, each of standard deviation 1.

    Args:
        env_id, keywords: of the environment.
        law: of this environment; it stays as it is. What it may plan is ``TunablePolicy.planned``, or all; of what it
            may not plan, one number for all starts is searched.
        starts: the seeds that an iteration's samples all drive; other ones each time, so that none is learned by heart.
        samples: plans per iteration, at least 10.
        iterations: how many.
        seed: of the random numbers.
        progress: called with how many iterations are done, and of how many.

    Raises:
        ValueError: too few samples or iterations.
    """
    whole("samples", samples, 10)
    whole("iterations", iterations, 1)
    cars, kind = Cars(env_id, keywords), type(law)
    parameters = control.searched(kind, cars.plant)
    space = Space(parameters)
    plannable = np.array([kind.planned is None or one.name in kind.planned for one in parameters])
    center, directions = shown_at_the_start(cars, starts(0))
    features = directions.shape[1]

    mean = np.zeros((1 + features, len(parameters)))
    mean[0] = space.places(law.values)
    counts = np.vstack((np.ones(len(parameters), np.bool_), np.tile(plannable, (features, 1))))
    scale = np.where(plannable, 1.0, OF_WEIGHTS) * space.deviation * counts
    deviation, least = BEGINNING * scale, LEAST * scale
    random = np.random.default_rng(seed)
    for iteration in range(iterations):
        seeds = list(starts(iteration))
        drawn = mean + deviation * random.standard_normal((samples, *mean.shape))
        drawn[0] = mean
        fleet = cars.of(samples * len(seeds))
        tried = Planned(kind.of(cars.plant, law.values), space, center, directions, np.repeat(drawn, len(seeds), 0))
        outcomes = drive(fleet, by(tried), seeds * samples)
        scores = outcomes.success + outcomes.episode_return / cars.episode_steps
        order = np.argsort(-scores.reshape(samples, -1).mean(axis=1), kind="stable")
        elite = drawn[order[: round(ELITE * samples)]]
        mean = mean + STEP * (elite.mean(axis=0) - mean)
        deviation = np.maximum(deviation + STEP * (elite.std(axis=0) - deviation), least)
        if progress is not None:
            progress(iteration + 1, iterations)
    return Planned(kind.of(cars.plant, law.values), space, center, directions, mean)


def shown_at_the_start(cars: Cars, seeds: Sequence[int]) -> tuple[Matrix, Matrix]:
    """``center`` (entries,) and ``directions`` (entries, features) of what differs from start to start."""
    observation, _ = cars.of(len(seeds)).reset(seed=list(seeds))
    even = cars.plant.observation_mirror > 0.0
    center = np.where(even, observation.mean(axis=0, dtype=np.float64), 0.0)
    spread, axes = np.linalg.eigh(np.cov((observation - center)[:, even], rowvar=False))
    varied = spread > SAME**2
    directions = np.zeros((len(even), np.count_nonzero(varied)))
    directions[even] = axes[:, varied] / np.sqrt(spread[varied])
    return center, directions
