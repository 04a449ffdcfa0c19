"""One setting of the headroom study: everyone who drives it, from the same starts."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.episodes import start_seeds
from agents.headroom_figures import of_driver, of_sequences, plain, side
from agents.statistics import bootstrap, share
from bicycle_env import analysis, control, optimum
from bicycle_env.optimum import Cars, Outcomes, by
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.randomised import RandomisedTask

CONTROLLERS = {
    "BicycleStab-v0": ("lqr",),
    "BicycleLaneChange-v0": ("preview", "lqr"),
    "BicycleDoubleLaneChange-v0": ("preview", "lqr"),
    "BicycleActiveSteer-v0": ("rear-yaw-rate", "rear-linear", "rear-switched"),
    "BicycleEvade-v0": ("evade-path",),
}
"""That are tuned for a setting; the last one is where the searches begin."""
FULL_STATE = {"BicycleActiveSteer-v0": {"observed": "state"}}
"""Keywords with which a controller sees what the id does not show: the row of the last one stands twice."""
LONGER = {"BicycleEvade-v0": {"iterations": 20, "planned_alone": False}}
"""How to search without knowing where more finds more: twice the iterations, over the weights beside the path."""
POLISHED = {"rear-switched": 2, "lqr": 2}
"""More restarts, about the best of those before: where one restart does not end."""
BOUNDED = ("BicycleStab-v0",)
"""Ids for which the recoverable set bounds what any steering saves."""
FRICTIONS = 3
"""Intervals of a hidden friction; one that knows it has parameters for each."""
KEPT_SEQUENCES = 2
"""Of each setting, steering sequences of the search that are written down."""

UNCONTROLLED, BLIND, BEST, BOUND = "uncontrolled", "best found without knowing", "best found", "upper bound"
LEARNED = "pretrained policy"


class Setting(NamedTuple):
    """An environment and its level; None for a variant that is no level."""

    env_id: str
    level: str | None
    keywords: dict[str, Any]


class Extent(NamedTuple):
    """How much is driven and searched."""

    reported: int
    """Starts of the controllers' rows."""
    searched: int
    """The first of them, which the search for steering drives, too."""
    unknowing: int
    """The first of these: of the search without knowing what is hidden."""
    tuning: int
    selection: int
    """Starts on which parameters are tuned, and on which the best of the restarts is chosen."""
    restarts: int
    """Of a tuning; where the friction is known, one for each interval, about what was tuned without knowing it."""
    iterations: int
    """Of a tuning, at most."""
    draws: int
    """Of what is hidden, for one start."""
    samples: int
    """Sequences per start and iteration."""
    lane_grid: tuple[int, int, int, int]
    """Nodes of the bound."""


FULL = Extent(2000, 200, 64, 128, 1000, 5, 16, 32, 192, (61, 61, 33, 25))
QUICK = Extent(200, 16, 5, 64, 200, 1, 3, 6, 64, (31, 31, 17, 13))

Tell = Callable[[str, float, float], None]
"""``tell(what, done, total)``."""


class Row(NamedTuple):
    """How a driver did."""

    outcomes: Outcomes
    figures: dict[str, Any]


def study(setting: Setting, extent: Extent, seed: int, search_seed: int, tell: Tell) -> dict[str, Any]:
    """The rows of one setting, and some steering sequences of the search, as JSON holds them."""
    return _Study(setting, extent, seed, search_seed, tell).result()


class _Study:
    def __init__(self, setting: Setting, extent: Extent, seed: int, search_seed: int, tell: Tell) -> None:
        self.setting, self.extent, self.search_seed, self.tell = setting, extent, search_seed, tell
        self.seeds = start_seeds(extent.reported, seed)
        self.searched = self.seeds[: extent.searched]
        self.tuning_seeds = start_seeds(extent.tuning, search_seed, "tune")
        self.selection_seeds = start_seeds(extent.selection, search_seed, "select")
        self.cars = Cars(setting.env_id, setting.keywords)
        self.rows: dict[str, Row] = {}
        self.classical_redrawn: Outcomes | None = None
        self.clock = time.perf_counter()

    @property
    def plant(self) -> Any:
        return self.cars.plant

    def result(self) -> dict[str, Any]:
        self.row(UNCONTROLLED, self.driven(control.Zero(self.plant)), "nothing")
        names = CONTROLLERS[self.setting.env_id]
        usual = {name: control.tunable(name).usual(self.plant) for name in names}
        for name in names:
            if usual[name] is not None:
                policy = control.make(name, self.plant, parameters=usual[name])
                self.row(f"{name}, as shipped", self.driven(policy), "observation", controller=name)
        tuned = {name: self.tuned(f"{name}, tuned", name, {}) for name in names}
        best = max(names, key=lambda name: tuned[name].best.success_rate)
        if self.setting.level in control.published().get(self.setting.env_id, ()):
            policy = control.load_policy(self.setting.env_id, self.setting.level)
            self.row(LEARNED, self.driven(policy), "observation")
        if self.setting.env_id in FULL_STATE:
            name = names[-1]
            self.tuned(f"{name}, tuned, sees the state", name, FULL_STATE[self.setting.env_id])
        friction = hidden_friction(self.plant.task)
        if friction is not None:
            self.knowing(names[-1], tuned[names[-1]].best.parameters, *friction)
        law = control.make(names[-1], self.plant, parameters=tuned[names[-1]].best.parameters)
        if self.hidden:
            self.without_knowing(law, control.make(best, self.plant, parameters=tuned[best].best.parameters))
        sequences = self.best_found(law)
        if self.setting.env_id in BOUNDED:
            self.bound()
        return {
            "env_id": self.setting.env_id,
            "level": self.setting.level,
            "keywords": plain(self.setting.keywords),
            "hidden": self.hidden,
            "drivers": {name: row.figures for name, row in self.rows.items()},
            **self.verdict(f"{best}, tuned"),
            "sequences": sequences,
        }

    def lap(self) -> float:
        before, self.clock = self.clock, time.perf_counter()
        return round(self.clock - before, 1)

    def driven(self, policy: control.Policy, keywords: Mapping[str, Any] | None = None) -> Outcomes:
        """From all reported starts."""
        cars = Cars(self.setting.env_id, {**self.setting.keywords, **keywords}) if keywords else self.cars
        return optimum.drive(cars.of(len(self.seeds)), by(policy), self.seeds)

    def row(self, name: str, outcomes: Outcomes, sees: str, **more: Any) -> None:
        self.rows[name] = Row(outcomes, {**of_driver(outcomes, sees, len(self.searched), self.lap()), **more})

    def tuning(
        self,
        name: str,
        keywords: Mapping[str, Any],
        restarts: int,
        what: str,
        begin: Mapping[str, float] | None = None,
    ) -> optimum.Tuning:
        law = control.tunable(name)
        enough = 6 if len(law.parameters) == 1 else optimum.budget(law).iterations  # a line is searched sooner
        iterations = min(self.extent.iterations, enough)
        return optimum.tune(
            self.setting.env_id,
            {**self.setting.keywords, **keywords},
            name,
            self.tuning_seeds,
            self.selection_seeds,
            restarts=restarts,
            iterations=iterations,
            begin=begin,
            seed=self.search_seed,
            progress=lambda done, total: self.tell(what, done, total),
        )

    def tuned(self, label: str, name: str, keywords: Mapping[str, Any]) -> optimum.Tuning:
        found = self.tuning(name, keywords, self.extent.restarts, f"tuning {name}")
        if name in POLISHED:
            restarts = min(POLISHED[name], self.extent.restarts)
            more = self.tuning(name, keywords, restarts, f"polishing {name}", found.best.parameters)
            found = found._replace(best=max(found.best, more.best, key=lambda one: one.success_rate))
        cars = Cars(self.setting.env_id, {**self.setting.keywords, **keywords})
        policy = control.make(name, cars.plant, parameters=found.best.parameters)
        rates = [one.success_rate for one in found.restarts]
        outcomes = self.driven(policy, keywords)
        sees = "state" if keywords else "observation"
        spread = {"on_selection_starts": found.best.success_rate, "of_restarts": [min(rates), max(rates)]}
        self.row(label, outcomes, sees, controller=name, parameters=found.best.parameters, **spread)
        return found

    def knowing(
        self,
        name: str,
        begin: Mapping[str, float],
        low: float,
        high: float,
        keywords_of: Callable[[float, float], dict[str, Any]],
    ) -> None:
        """The same law with parameters for intervals of the friction, each start driven with those of its own."""
        edges = np.linspace(low, high, FRICTIONS + 1)
        found = [
            self.tuning(name, keywords_of(*ends), 1, f"tuning {name}, friction known", begin)
            for ends in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        ]
        frictions = self.frictions()
        place = np.clip(np.searchsorted(edges, frictions, side="right") - 1, 0, FRICTIONS - 1)
        each = [self.driven(control.make(name, self.plant, parameters=one.best.parameters)) for one in found]
        chosen = Outcomes(*(np.choose(place, columns) for columns in zip(*each, strict=True)))
        parameters = {"frictions": edges.tolist(), "parameters": [one.best.parameters for one in found]}
        self.row(f"{name}, tuned, knows the friction", chosen, "friction", controller=name, **parameters)

    @functools.cached_property
    def starts(self) -> Any:
        """The states in which all reported starts begin."""
        many = self.cars.of(len(self.seeds))
        many.reset(seed=self.seeds)
        return many.unwrapped.state

    @property
    def hidden(self) -> list[str]:
        """Names of what is drawn and not told; what is the same in every episode could be known."""
        return [name for name in self.plant.task.hidden if np.ptp(getattr(self.starts, name)) > 0.0]

    def frictions(self) -> NDArray[np.float64]:
        """That each start has hidden."""
        state = self.starts
        found: NDArray[np.float64] = np.array(getattr(state, "relative_friction", getattr(state, "friction", None)))
        return found

    def without_knowing(self, law: Any, classical: control.Policy) -> None:
        """One set of parameters for each start; then it, and the law as it was, drive other draws of what is hidden."""
        found = optimum.search_parameters(
            self.setting.env_id,
            self.setting.keywords,
            law,
            self.searched[: self.extent.unknowing],
            draws=self.extent.draws,
            **LONGER.get(self.setting.env_id, {}),
            seed=self.search_seed,
            progress=lambda done: self.tell(BLIND, done, self.extent.unknowing),
        )
        own = np.array([one.parameters for one in found])
        laws = control.Candidates(type(law), self.plant, own, self.extent.draws)
        draws_saved = float(np.mean([one.draws_saved for one in found]))
        self.row(BLIND, self.redrawn(laws), "observation", draws=self.extent.draws, saved_of_those_searched=draws_saved)
        self.classical_redrawn = self.redrawn(classical)

    def redrawn(self, policy: control.Policy) -> Outcomes:
        """Of each searched start the means over other draws of what is hidden than those that were searched."""
        count = self.extent.draws
        starts = self.searched[: self.extent.unknowing]
        seeds = np.repeat(starts, count).tolist()
        draws = [one for start in starts for one in optimum.draws_of(start, 3 * count, self.search_seed)[2 * count :]]
        driven = optimum.drive(self.cars.of(len(seeds)), by(policy), seeds, draws)
        return Outcomes(*(np.reshape(column, (-1, count)).mean(axis=1) for column in driven))

    def best_found(self, law: control.Policy) -> list[dict[str, Any]]:
        found = optimum.search_steering(
            self.setting.env_id,
            self.setting.keywords,
            law,
            self.searched,
            samples=self.extent.samples,
            seed=self.search_seed,
            progress=lambda done: self.tell(BEST, done, len(self.searched)),
        )
        # Whoever saved a start has found it, too; the return is the best that anyone had there.
        n = len(self.searched)
        others = [row.outcomes for name, row in self.rows.items() if name != BLIND]
        own = (np.array([getattr(one, name) for one in found]) for name in ("success", "on_road", "episode_return"))
        columns = [
            np.max([mine, *(getattr(one, name)[:n] for one in others)], axis=0)
            for name, mine in zip(Outcomes._fields[:3], own, strict=True)
        ]
        outcomes = Outcomes(*columns, np.array([len(one.actions) for one in found]))
        saved = [k for k in range(n) if found[k].success]
        self.row(
            BEST,
            outcomes,
            "everything",
            search_alone=len(saved) / n,
            of_saved=of_sequences(
                self.setting.env_id, self.setting.keywords, {self.searched[k]: found[k].actions for k in saved}
            ),
        )
        # Those that only the search over sequences saves come first.
        kept = sorted(saved, key=lambda k: found[k].iterations == 0)[:KEPT_SEQUENCES]
        return [
            {
                "env_id": self.setting.env_id,
                "keywords": plain(self.setting.keywords),
                "start": self.searched[k],
                "iterations": found[k].iterations,
                "actions": found[k].actions.tolist(),
            }
            for k in kept
        ]

    def bound(self) -> None:
        plant = self.plant
        self.tell(BOUND, 0, 1)
        inside = recoverable(plant, self.extent.lane_grid)
        state = self.starts
        within = inside.contains(state.lateral_velocity, state.yaw_rate, state.heading, state.lateral_position)
        outside = {
            name: int(np.sum(row.outcomes.success & ~within[: len(row.outcomes.success)]))
            for name, row in self.rows.items()
        }
        searched = float(np.mean(within[: len(self.searched)]))
        figures = {"success_rate": share(within), "starts": len(within), "seconds": self.lap()}
        self.rows[BOUND] = Row(
            Outcomes(within, within, np.full(len(within), np.nan), np.zeros(len(within), np.int64)),
            {"sees": "everything", **figures, "success_rate_of_searched": searched, "saved outside of it": outside},
        )

    def verdict(self, classical: str) -> dict[str, Any]:
        """What scores are made of: the best classical controller, and what stands above it, on the starts of both.

        Above it stands the best found; where something is hidden, the best of those that do not know it: the search,
        or a policy, which learns on the way what it needs.
        """
        tuned = self.rows[classical].outcomes
        pairs = {BEST: (tuned, self.rows[BEST].outcomes)}
        if self.classical_redrawn is not None:
            pairs = {BLIND: (self.classical_redrawn, self.rows[BLIND].outcomes)}
            pairs |= {LEARNED: (tuned, self.rows[LEARNED].outcomes)} if LEARNED in self.rows else {}
        differences = {
            name: above.success.astype(float) - mine.success[: len(above.success)].astype(float)
            for name, (mine, above) in pairs.items()
        }
        reference = max(differences, key=lambda name: float(np.mean(differences[name])))
        room, (mine, above) = differences[reference], pairs[reference]
        return {
            "classical": side(classical, mine, len(room)),
            "reference": side(reference, above, len(room)),
            "room": {"value": float(np.mean(room)), "interval": bootstrap(room)},
            "best_return": float(np.mean(self.rows[BEST].outcomes.episode_return)),
        }


def recoverable(plant: Any, lane_grid: tuple[int, int, int, int] = FULL.lane_grid) -> analysis.RecoverableSet:
    """What some steering could save in the environment; beyond half a body outside the lane it has ended."""
    return analysis.recoverable_set(
        plant.vehicle,
        plant.speed,
        plant.tire,
        steer=plant.steer,
        friction=plant.friction,
        steer_limits=(plant.front_actuator.angle_limit, plant.rear_actuator.angle_limit),
        horizon=plant.task.episode_steps * plant.control_timestep,
        lane=plant.task.road_half_width + 0.5 * plant.vehicle.body_width,
        lane_grid=lane_grid,
        progress=False,
    )


def hidden_friction(task: Any) -> tuple[float, float, Callable[[float, float], dict[str, Any]]] | None:
    """The range from which a task draws a friction that it hides, and the keywords of another range; None without."""
    while isinstance(task, AlteredTask):
        if isinstance(task, RandomisedTask):
            drawn = dict(task.drawn)
            if "friction" in drawn:
                low, high = drawn["friction"].bounds
                return low, high, lambda least, most: {"randomise": {"friction": (least, most)}}
        task = task.task
    low, high = getattr(task, "relative_friction", (1.0, 1.0))
    return (low, high, lambda least, most: {"relative_friction": (least, most)}) if low < high else None
