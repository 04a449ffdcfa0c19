"""What some steering saves: for each start a search over steering sequences in the true simulator.

A sequence is added to the actions of a feedback, which does the fine work; the search decides what the feedback cannot
know. Where the feedback is a law whose cars may have parameters of their own, these are searched first, and a sequence
only for the starts that they lose. It finds a lower bound of what can be saved: what it does not save may be savable.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control import Policy
from bicycle_env.control.tunable import TunableLaw
from bicycle_env.optimum.cross_entropy import LEAST_SAMPLES, Array, StartSearch, search_each
from bicycle_env.optimum.outcomes import Cars, Outcomes, by, drive
from bicycle_env.optimum.parameter_search import search_parameters
from bicycle_env.physics.validation import whole

STEPS_PER_KNOT = 6
"""Control steps; more where an episode would have more than MOST_KNOTS."""
MOST_KNOTS = 50
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
    """Iterations of the search over sequences; 0 where it was not needed or found nothing better."""
    actions: NDArray[np.float32]
    """(steps, axles), what was sent to the environment until the episode's end."""
    parameters: tuple[float, ...] = ()
    """Of the law that the actions come from, those found for this start; () where they are the feedback's own."""


def search_steering(
    env_id: str,
    keywords: Mapping[str, Any],
    feedback: Policy,
    seeds: Sequence[int],
    *,
    samples: int = 192,
    iterations: int = 40,
    parameter_iterations: int = 10,
    span: int | None = None,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> list[Rescue]:
    """Search for steering that saves the car, start by start; a start is done at its first success.

    Better is: success, then the larger sum of the return and the steps driven. A start's result depends on its own seed
    only, so that many starts may be searched block by block, on another day or machine.

    Args:
        env_id: a registered id of this package.
        keywords: of the environment.
        feedback: a policy of this environment; it may remember, and stays as it is.
        seeds: of the starts, as for ``reset``; what is hidden in them is as it will be.
        samples: sequences, or parameters, per start and iteration, at least 8.
        iterations: at most so many over sequences.
        parameter_iterations: at most so many before, over the parameters of a feedback that is a ``TunableLaw``.
        span: control steps from the start that a sequence covers, after which the feedback drives alone; None: the
            whole episode.
        seed: of the random numbers; each start has its own stream.
        progress: called with how many starts are done.

    Returns:
        For each start the best that was found. Its actions, sent to the single environment from the same seed, repeat
        the episode to the bit: ``replay``.

    Raises:
        ValueError, TypeError: a keyword that the environment refuses; too few samples.
    """
    whole("samples", samples, LEAST_SAMPLES)
    cars, feedback = Cars(env_id, keywords), copy.copy(feedback)
    found = dict(enumerate(_tried(cars, feedback, seeds).rescues()))
    failed = [k for k in found if not found[k].success]
    done = len(seeds) - len(failed)

    def tell(more: int) -> None:
        nonlocal done
        done += more
        if progress is not None:
            progress(done)

    tell(0)
    values: dict[int, Array] = {}
    if failed and parameter_iterations and isinstance(feedback, TunableLaw):
        lost = [seeds[k] for k in failed]
        own = search_parameters(
            env_id, keywords, feedback, lost, draws=None, samples=samples, iterations=parameter_iterations, seed=seed
        )
        values = {k: np.array(one.parameters) for k, one in zip(failed, own, strict=True)}
        found |= zip(failed, _tried(cars, feedback, lost, values.values()).rescues(), strict=True)
        tell(sum(one.success for one in own))
        failed = [k for k in failed if not found[k].success]

    knots = Knots.over(cars.episode_steps if span is None else span, cars.plant.action_repeat)

    def begin(k: int) -> StartSearch:
        random, shape = np.random.default_rng([seed, seeds[k]]), (knots.number, cars.plant.action_space.shape[0])
        mean, deviation = np.zeros(shape), np.full(shape, FIRST_DEVIATION)
        return _Sequences(random, mean, deviation, LEAST_DEVIATION, (-STROKE, STROKE), samples, iterations)

    def iterate(running: dict[int, StartSearch]) -> None:
        starts = np.repeat(list(running), samples)
        added = np.concatenate([search.draw() for search in running.values()])
        laws = [values[k] for k in starts] if values else None
        tried = _tried(cars, feedback, [seeds[k] for k in starts], laws, knots.between(added))
        for place, (k, search) in enumerate(running.items()):
            first = place * samples
            best = tried.rescue(first + search.learn(tried.ranks[first : first + samples]), search.iteration)
            if _rank(best) > _rank(found[k]):
                found[k] = best
            search.done = best.success
        tell(sum(search.over for search in running.values()))

    search_each(failed if iterations else [], begin, iterate, BATCH)
    tell(len(seeds) - done)
    return [found[k] for k in range(len(seeds))]


class Knots(NamedTuple):
    """At equal times from the start; between two the values change linearly, and after the last one to none."""

    number: int
    actions: int
    """From one to the next."""

    @classmethod
    def over(cls, span: int, action_repeat: int) -> Self:
        """For so many control steps."""
        actions = max(-(-STEPS_PER_KNOT // action_repeat), -(-span // (MOST_KNOTS * action_repeat)))
        return cls(-(-span // (actions * action_repeat)), actions)

    def between(self, values: Array) -> Callable[[int], Array | float]:
        """``f(step)``: what is added to the actions, (rows, axles), of values (rows, knots, axles)."""
        at = np.ascontiguousarray(values.transpose(1, 0, 2))

        def added(step: int) -> Array | float:
            knot, between = divmod(step, self.actions)
            if knot >= self.number:
                return 0.0
            share = between / self.actions
            following = at[knot + 1] if knot + 1 < self.number else 0.0
            found: Array = (1.0 - share) * at[knot] + share * following
            return found

        return added


class _Sequences(StartSearch):
    """Half of the first samples hold their values for a while, as a driver's wide strokes do."""

    def draw(self) -> Array:
        drawn = super().draw()
        if self.iteration == 0:
            for sequence in drawn[::2]:
                place = 0
                while place < len(sequence):
                    length = int(self.random.integers(*PIECE, endpoint=True))
                    sequence[place : place + length] = self.random.uniform(-STROKE, STROKE, sequence.shape[1])
                    place += length
        return drawn


class _Tried(NamedTuple):
    """Episodes of many cars."""

    outcomes: Outcomes
    actions: NDArray[np.float32]
    """(steps, rows, axles)."""
    parameters: list[Array] | None

    @property
    def ranks(self) -> Array:
        # Any success stands before any failure: no sum of a return and of steps reaches that far.
        return np.where(self.outcomes.success, 1e300, self.outcomes.episode_return + self.outcomes.steps)

    def rescue(self, row: int, iteration: int = 0) -> Rescue:
        success, on_road, episode_return, steps = self.outcomes.one(row)
        own = () if self.parameters is None else tuple(map(float, self.parameters[row]))
        return Rescue(success, on_road, episode_return, iteration, self.actions[:steps, row].copy(), own)

    def rescues(self) -> list[Rescue]:
        return [self.rescue(row) for row in range(len(self.outcomes.steps))]


def _rank(rescue: Rescue) -> tuple[bool, float]:
    return rescue.success, rescue.episode_return + len(rescue.actions)


def _tried(
    cars: Cars,
    feedback: Any,
    seeds: Sequence[int],
    parameters: Iterable[Array] | None = None,
    added: Callable[[int], Array | float] | None = None,
) -> _Tried:
    """One episode from each seed with the feedback, with each car's own parameters, and with what is added to it."""
    own = None if parameters is None else list(parameters)
    if own is not None:
        feedback.vary(np.array(own))
    alone, sent = by(feedback), []

    def act(observation: NDArray[Any], step: int) -> NDArray[Any]:
        actions = alone(observation, step)
        if added is not None:
            actions = np.clip(actions + added(step), -1.0, 1.0).astype(np.float32)
        sent.append(actions)
        return actions

    return _Tried(drive(cars.of(len(seeds)), act, seeds), np.array(sent), own)
