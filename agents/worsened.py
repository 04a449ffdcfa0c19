"""Policies from bad to good: a tuned controller that is made worse in six ways, each to many degrees."""

from __future__ import annotations

import itertools
import json
import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.episodes import start_seeds
from agents.evaluate import make_env
from agents.messages import UserError
from bicycle_env import control, optimum

Array = NDArray[Any]

SPREAD = (0.05, 0.95)
"""Of the success of the policies that are ranked."""
POLICIES = 24
RAYS = {"parameters": 4, "signals": 4}
"""Random directions of the families that have any; of the others one."""
DEGREES, ROUNDS, BATCH = 8, 4, 24
"""Of each ray, at first; then in each round a batch more, where success changes most from one to the next."""
FAMILIES = {
    "parameters": (0.1, 10.0, "parameters moved"),
    "signals": (0.03, 3.0, "observation scaled wrongly"),
    "weaker": (0.02, 1.0, "action smaller"),
    "harsher": (0.1, 100.0, "action larger"),
    "noise": (0.1, 10.0, "action noisy"),
    "late": (1.0, 60.0, "action late"),
}
"""Least and greatest degree, and what is worse. A degree is how far parameters are moved, in deviations of a search for
them; the standard deviation of random factors or noise; the share by which the action changes; or steps."""
HELD = 10
"""Steps that an added random number is held, so that the actuators feel it."""
ONCE_MORE = 0.01
"""How much farther from an even spread a policy may be, for each policy that its family has less."""
SELECTING = 128
"""Starts by which policies are chosen."""


class Variant(NamedTuple):
    """A policy: the controller with what is wrong with it."""

    family: str
    degree: float
    values: Array
    """(parameters,)."""
    factors: Array
    """(entries,) of the observation."""
    gain: float = 1.0
    noise: float = 0.0
    late: int = 0


class Bench:
    """Drives variants of one controller in one environment."""

    def __init__(self, env_id: str, keywords: dict[str, Any], controller: str) -> None:
        self.env_id, self.keywords = env_id, keywords
        self.plant: Any = make_env(env_id, keywords).unwrapped
        self.controller = control.tunable(controller)
        usual = self.controller.usual(self.plant)
        if usual is None:
            raise UserError(f"{self.controller.name} was not tuned for {env_id} with {json.dumps(keywords)}")
        self.values = control.values_of(self.controller, self.plant, usual)
        names = [one.name for one in control.searched(self.controller, self.plant)]
        self.tuned = dict(zip(names, self.values.tolist(), strict=True))
        self._cars = optimum.Cars(env_id, keywords)

    def rays(self, seed: int) -> list[tuple[str, Array]]:
        """Families with a direction, (parameters,) or (entries,), where they have one."""
        random, found = np.random.default_rng(seed), []
        for family in FAMILIES:
            count = len(self.values) if family == "parameters" else len(self.plant.observation_names)
            found += [(family, random.standard_normal(count)) for _ in range(RAYS.get(family, 1))]
        return found

    def variant(self, family: str, direction: Array, degree: float) -> Variant:
        """The controller made worse."""
        one = Variant(family, degree, self.values, np.ones(len(self.plant.observation_names)))
        if family == "parameters":
            space = optimum.Space(control.searched(self.controller, self.plant))
            moved = space.places(self.values) + degree * space.deviation * direction
            return one._replace(values=space.values(space.clipped(moved[None]))[0])
        if family == "signals":
            return one._replace(factors=one.factors + degree * direction)
        if family in ("weaker", "harsher"):
            return one._replace(gain=1.0 - degree if family == "weaker" else 1.0 + degree)
        return one._replace(noise=degree) if family == "noise" else one._replace(late=round(degree))

    def drive(self, variants: Sequence[Variant], seeds: Sequence[int], random: np.random.Generator) -> Array:
        """(2, variants, starts): success and return, every variant from the same starts."""
        each = len(seeds)
        count = len(variants) * each
        cars = self._cars.of(count)
        policy = control.Candidates(self.controller, self.plant, np.array([one.values for one in variants]), each)
        factors = np.repeat([one.factors for one in variants], each, axis=0)
        gain, noise = np.repeat([(one.gain, one.noise) for one in variants], each, axis=0).T[:, :, None]
        late, rows = np.repeat([one.late for one in variants], each), np.arange(count)
        sent = np.zeros((late.max() + 1, *cars.action_space.shape), np.float32)
        added = np.zeros(cars.action_space.shape)

        def act(observation: Array, step: int) -> Array:
            if step % HELD == 0 and noise.any():
                added[:] = noise * random.standard_normal(added.shape)
            sent[step % len(sent)] = np.clip(gain * policy.act(observation * factors) + added, -1.0, 1.0)
            found: Array = sent[(step - late) % len(sent), rows]
            return found

        driven = optimum.drive(cars, act, [*seeds] * len(variants))
        return np.array([driven.success, driven.episode_return]).reshape(2, len(variants), each)


def pool(bench: Bench, seed: int, done: Callable[[], None]) -> tuple[list[Variant], list[float]]:
    """Policies to choose from, and their success on the starts that select."""
    seeds, rays = start_seeds(SELECTING, seed, "select"), bench.rays(seed)
    found: dict[tuple[int, float], float] = {}
    variants: dict[tuple[int, float], Variant] = {}
    pending = [(k, degree) for k, ray in enumerate(rays) for degree in degrees(ray[0])]
    for turn in range(1 + ROUNDS):
        for first in range(0, len(pending), BATCH):
            places = pending[first : first + BATCH]
            driven = [bench.variant(*rays[k], degree) for k, degree in places]
            random = np.random.default_rng([seed, turn, first])
            variants |= zip(places, driven, strict=True)
            found |= zip(places, bench.drive(driven, seeds, random)[0].mean(axis=1).tolist(), strict=True)
            done()
        pending = between(found, {k for k, ray in enumerate(rays) if ray[0] == "late"})
    return [variants[place] for place in found], list(found.values())


def degrees(family: str) -> list[float]:
    """Those that a ray begins with."""
    least, most, _ = FAMILIES[family]
    found = np.geomspace(least, most, DEGREES)
    return sorted(set(np.round(found).tolist())) if family == "late" else found.tolist()


def between(found: dict[tuple[int, float], float], whole: set[int]) -> list[tuple[int, float]]:
    """Rays and degrees of the next round: the middles of the largest changes of success that the spread sees."""
    gaps = []
    for (ray, low), (other, high) in itertools.pairwise(sorted(found)):
        middle = math.sqrt(low * high)
        middle = float(round(middle)) if ray in whole else middle
        if ray == other and low < middle < high:
            seen = np.clip([found[ray, low], found[ray, high]], *SPREAD)
            gaps.append((-abs(seen[1] - seen[0]), ray, middle))
    return [gap[1:] for gap in sorted(gaps)[:BATCH] if gap[0] < 0.0]


def evenly(success: Array, families: Sequence[str]) -> list[int]:
    """Which policies to rank: for each of ``POLICIES`` aims one with about that success, of the families alike many."""
    low, high = SPREAD
    left = {k for k in range(len(success)) if low <= success[k] <= high}
    chosen: list[int] = []
    taken: Counter[str] = Counter()
    for aim in np.linspace(low, max((success[k] for k in left), default=high), POLICIES):
        if left:
            best = min(left, key=lambda k: (abs(success[k] - aim) + ONCE_MORE * taken[families[k]], k))
            chosen.append(best)
            taken[families[best]] += 1
            left.remove(best)
    return chosen
