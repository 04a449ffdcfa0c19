"""What a law saves whose parameters may be other ones for each start: searched knowing the future, or not knowing it.

Knowing it, each start is driven as it will be. Not knowing it, a start's parameters are those that do best over many
draws of what is hidden, everything that is seen at the start being the same, and then drive the start's own episode,
which was not among the draws: what is drawn of friction, of a driver, of noise cannot be exploited, only allowed for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bicycle_env.control.tunable import Candidates, TunablePolicy, searched
from bicycle_env.optimum.cross_entropy import LEAST_SAMPLES, Array, StartSearch, search_each
from bicycle_env.optimum.outcomes import Cars, by, drive
from bicycle_env.optimum.tuning import Space
from bicycle_env.physics.validation import whole

MOST_CARS = 16384
"""At a time."""
SHARE_OF_SPREAD = 0.33
"""The deviation at first, per that of a tuning that knows nothing."""
SUCCESS = 1e6
"""A rank is the share of the draws that is saved times this, then the mean of return and steps: these stay below."""


class OwnParameters(NamedTuple):
    """The parameters that were found for one start, and the start's own episode with them."""

    success: bool
    on_road: bool
    episode_return: float
    parameters: tuple[float, ...]
    """In the order of ``control.tunable.searched``."""
    draws_saved: float
    """Share of the draws that chose them which they save."""
    draws_saved_before: float
    """Share of the same draws that the law's usual parameters save."""
    iterations: int
    """Until the best on the draws of the search was found; 0 where the usual parameters were."""


def search_parameters(
    env_id: str,
    keywords: Mapping[str, Any],
    law: TunablePolicy,
    seeds: Sequence[int],
    *,
    draws: int | None = 32,
    samples: int = 32,
    iterations: int = 10,
    planned_alone: bool = True,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> list[OwnParameters]:
    """Search for a law's parameters, start by start, around those that it has.

    Better is: more of the draws saved, then the larger mean of return and steps. A start is done where all are saved.
    Where the future is hidden, as many other draws choose among the usual parameters, the best and the last mean.
    Its result depends on its own seed only, so that many starts may be searched block by block.

    Args:
        env_id, keywords: of the environment.
        law: of this environment, made of parameters: ``control.make(name, env, parameters=...)``; it stays as it is.
        seeds: of the starts, as for ``reset``.
        draws: of what is hidden (the task's ``hidden``), the same for all samples of a start; see ``drive``. None: the
            start's own future is known, and the only one.
        samples: sets of parameters per iteration, at least 8, the first of which is the mean of the others.
        iterations: at most so many.
        planned_alone: search only what the law may plan anew (``TunablePolicy.planned``); False: all its parameters.
        seed: of the random numbers; each start has its own stream, and its draws come from that.
        progress: called with how many starts are done.

    Raises:
        ValueError: draws of a task that hides nothing; too few samples or draws.
    """
    whole("samples", samples, LEAST_SAMPLES)
    whole("draws", 1 if draws is None else draws, 1)
    cars = Cars(env_id, keywords)
    if draws is not None and not cars.plant.task.hidden:
        raise ValueError(
            f"draws must be None where the task hides nothing, got {draws}: {env_id} with {dict(keywords)}"
        )
    space = _Planned(law, cars.plant, planned_alone)
    best = dict.fromkeys(range(len(seeds)), space.usual)
    last = dict(best)
    per = draws or 1
    futures = [[start] if draws is None else draws_of(start, 2 * per, seed) for start in seeds]

    def driven(starts: Sequence[int], values: Array, those: slice = slice(per)) -> Array:
        """(starts, samples, 2): share saved, and mean of return and steps, of values (starts, samples, parameters)."""
        tried = values.shape[1]
        laws = Candidates(type(law), cars.plant, values.reshape(-1, values.shape[-1]), per)
        own = np.repeat([seeds[k] for k in starts], tried * per).tolist()
        drawn = None if draws is None else [one for k in starts for one in futures[k][those] * tried]
        outcomes = drive(cars.of(len(own)), by(laws), own, drawn)
        gained = np.stack([outcomes.success, outcomes.episode_return + outcomes.steps], axis=-1)
        mean: Array = gained.reshape(len(starts), tried, per, 2).mean(axis=2)
        return mean

    batch = max(MOST_CARS // (samples * per), 1)

    def compared(values: Array, those: slice = slice(per)) -> Array:
        """As `driven`, of all starts."""
        most = max(MOST_CARS // (per * values.shape[1]), 1)
        some = [range(first, min(first + most, len(seeds))) for first in range(0, len(seeds), most)]
        return np.concatenate([driven(starts, values[starts], those) for starts in some])

    usual = compared(np.tile(space.usual, (len(seeds), 1, 1)))[:, 0]
    found = {k: tuple(usual[k]) for k in range(len(seeds))}
    iterations_of = dict.fromkeys(found, 0)
    lost = [k for k in found if found[k][0] < 1.0]
    done = len(seeds) - len(lost)

    def begin(k: int) -> StartSearch:
        random = np.random.default_rng([seed, seeds[k], 1])
        return _AroundMean(random, *space.distribution, samples, iterations)

    def iterate(running: dict[int, StartSearch]) -> None:
        nonlocal done
        starts = list(running)
        values = space.values(np.stack([search.draw() for search in running.values()]))
        for k, own, gained in zip(starts, values, driven(starts, values), strict=True):
            search = running[k]
            top = search.learn(SUCCESS * gained[:, 0] + gained[:, 1])
            if tuple(gained[top]) > found[k]:
                found[k], best[k], iterations_of[k] = tuple(gained[top]), own[top], search.iteration
            search.done = found[k][0] == 1.0
            last[k] = space.values(search.mean)
        done += sum(search.over for search in running.values())
        if progress is not None:
            progress(done)

    search_each(lost if iterations else [], begin, iterate, batch)
    chosen, saved = np.array([best[k] for k in found]), np.array([found[k][0] for k in found])
    saved_before = usual[:, 0]
    if draws is not None:  # what fits the draws best fits their accidents, too
        finalists = np.stack(
            [np.tile(space.usual, (len(seeds), 1)), chosen, np.array([last[k] for k in found])], axis=1
        )
        gained = compared(finalists, slice(per, None))
        top = np.argmax(SUCCESS * gained[..., 0] + gained[..., 1], axis=1)
        rows = np.arange(len(seeds))
        chosen, saved, saved_before = finalists[rows, top], gained[rows, top, 0], gained[:, 0, 0]
    laws = Candidates(type(law), cars.plant, chosen, 1)
    outcomes = drive(cars.of(len(seeds)), by(laws), list(seeds))
    return [
        OwnParameters(
            *outcomes.one(k)[:3],
            tuple(chosen[k].tolist()),
            float(saved[k]),
            float(saved_before[k]),
            iterations_of[k],
        )
        for k in found
    ]


def draws_of(start: int, draws: int, seed: int) -> list[int]:
    """Seeds of what is hidden, for a start: 64 random bits each."""
    bits = np.random.SeedSequence([seed, start, 2]).generate_state(draws, np.uint64)
    return [int(one) for one in bits]


class _Planned:
    """The parameters that are searched among a law's: those that may be others for each start."""

    def __init__(self, law: TunablePolicy, plant: Any, alone: bool) -> None:
        """``usual``: all those of the law; ``distribution``: what ``StartSearch`` takes."""
        self.usual = np.array(law.values)
        parameters = searched(type(law), plant)
        chosen = law.planned if alone else None
        self._places = [k for k, one in enumerate(parameters) if chosen is None or one.name in chosen]
        self._space = Space([parameters[k] for k in self._places])
        mean, deviation = self._space.places(self.usual[self._places]), SHARE_OF_SPREAD * self._space.deviation
        self.distribution = mean, deviation, self._space.least_deviation, self._space.bounds

    def values(self, drawn: Array) -> Array:
        """(..., parameters) of what is drawn."""
        found = np.tile(self.usual, (*drawn.shape[:-1], 1))
        found[..., self._places] = self._space.values(drawn.reshape(-1, drawn.shape[-1])).reshape(drawn.shape)
        return found


class _AroundMean(StartSearch):
    """The first sample is the mean: at first the law as it is."""

    def draw(self) -> Array:
        super().draw()[0] = self.mean
        return self.drawn
