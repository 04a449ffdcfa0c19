"""Weights tuned for another car than the shipped one; small searches."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import bicycle_env  # noqa: F401
from agents import tune
from agents.episodes import start_seeds
from bicycle_env.control import Weights, tuned_weights
from bicycle_env.optimum import tune_weights

TUNE, SELECT = start_seeds(24, 0, "tune"), start_seeds(100, 0, "select")


@functools.cache
def tuning(seed):
    return tune_weights(
        "BicycleStab-v0", {"steer": "rear"}, TUNE, SELECT, restarts=1, iterations=6, seed=seed, progress=None
    )


def test_it_is_better_than_the_shipped_weights_where_these_are_not_meant_for():
    found = tuning(0)
    assert found.shipped.weights == tuned_weights("stabilise")
    assert found.shipped.success_rate < 0.25
    assert found.best.success_rate > found.shipped.success_rate + 0.15
    assert found.best in found.restarts
    assert found.best.on_road_rate >= found.best.success_rate


def test_the_weight_of_an_axle_that_is_not_steered_is_left_alone():
    assert tuning(0).best.weights.front_command == 1.0
    assert tuning(0).best.weights.rear_command != 1.0


def test_the_same_seed_gives_the_same_weights():
    tuning.cache_clear()
    first = tuning(0)
    tuning.cache_clear()
    assert tuning(0) == first
    assert tuning(1).best != first.best


def test_the_shipped_weights_stay_where_nothing_better_is_found():
    counts = []
    found = tune_weights(
        "BicycleStab-v0",
        {},
        TUNE[:2],
        SELECT,
        restarts=2,
        iterations=1,
        progress=lambda done, total: counts.append((done, total)),
    )
    assert counts == [(1, 2), (2, 2)]
    assert len(found.restarts) == 2
    best = max([found.shipped, *found.restarts], key=lambda one: one.success_rate + one.mean_return / 400)
    assert found.best == best


def test_a_task_without_shipped_weights_can_be_tuned(monkeypatch):
    def none(name):
        raise ValueError(f"no weights for {name}")

    monkeypatch.setattr("bicycle_env.optimum.weight_tuning.tuned_weights", none)
    found = tune_weights("BicycleStab-v0", {}, TUNE[:2], SELECT[:8], restarts=2, iterations=1)
    assert found.shipped is None
    assert found.best in found.restarts
    assert "shipped" not in tune.record(found)["on_selection_starts"]
    assert tune.table(found).row_count == 3


def test_weights_that_give_no_regulator_are_an_error(monkeypatch):
    def none(*_):
        raise np.linalg.LinAlgError("no solution")

    monkeypatch.setattr("bicycle_env.optimum.weight_tuning.LQR", none)
    with pytest.raises(np.linalg.LinAlgError, match="no weights give a regulator"):
        tune_weights("BicycleStab-v0", {}, TUNE[:2], SELECT[:2], restarts=1, iterations=1)


def test_weights_are_six():
    assert len(tuning(0).best.weights) == len(Weights._fields)
