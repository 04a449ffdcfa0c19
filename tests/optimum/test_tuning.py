"""Controllers tuned for another car than the shipped one; small searches."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from combinations import only_all

import bicycle_env  # noqa: F401
from agents import tune as command
from agents.episodes import start_seeds
from bicycle_env import control
from bicycle_env.control import lqr, tuned_weights
from bicycle_env.optimum import Space, budget, tune
from bicycle_env.optimum import tuning as tuning_of_the_package
from bicycle_env.optimum.tuning import NEAR, SCORES, Budget

TUNE, SELECT = start_seeds(24, 0, "tune"), start_seeds(100, 0, "select")
SCORE = 1.0, 1.0 / 400
"""Of a success rate and of a return in BicycleStab-v0."""


@functools.cache
def tuning(seed):
    return tune("BicycleStab-v0", {"steer": "rear"}, "lqr", TUNE, SELECT, restarts=1, iterations=6, seed=seed)


def test_it_is_better_than_the_shipped_weights_where_these_are_not_meant_for():
    found = tuning(0)
    shipped = tuned_weights("stabilise")._asdict()
    assert found.shipped.parameters == {name: shipped[name] for name in found.best.parameters}
    assert found.shipped.success_rate < 0.25
    assert found.best.success_rate > found.shipped.success_rate + 0.15
    assert found.best in found.restarts
    assert found.best.on_road_rate >= found.best.success_rate


def test_the_weight_of_an_axle_that_is_not_steered_is_left_alone():
    assert list(tuning(0).best.parameters) == ["heading", "sideslip", "yaw_rate", "rear_command"]


@pytest.mark.exhaustive
def test_the_same_seed_gives_the_same_weights():
    tuning.cache_clear()
    first = tuning(0)
    tuning.cache_clear()
    assert tuning(0) == first
    assert tuning(1).best != first.best


def test_the_shipped_weights_stay_where_nothing_better_is_found():
    counts = []
    found = tune(
        "BicycleStab-v0",
        {},
        "lqr",
        TUNE[:2],
        SELECT,
        restarts=2,
        iterations=1,
        progress=lambda done, total: counts.append((done, total)),
    )
    assert counts == [(1, 2), (2, 2)]
    assert len(found.restarts) == 2
    best = max([found.shipped, *found.restarts], key=lambda one: np.dot(SCORE, (one.success_rate, one.mean_return)))
    assert found.best == best


def test_a_task_without_shipped_weights_can_be_tuned(monkeypatch):
    monkeypatch.setattr(lqr, "_tuned", dict)
    found = tune("BicycleStab-v0", {}, "lqr", TUNE[:2], SELECT[:8], restarts=2, iterations=1)
    assert found.shipped is None
    assert found.best in found.restarts
    assert "shipped" not in command.record("lqr", found)["on_selection_starts"]
    assert len(command.table(found).columns) == 4


def test_parameters_that_give_no_controller_are_an_error(monkeypatch):
    def none(*_):
        raise np.linalg.LinAlgError("no solution")

    monkeypatch.setattr(control.LQR, "of", none)
    with pytest.raises(np.linalg.LinAlgError, match="no parameters give a lqr for BicycleStab-v0"):
        tune("BicycleStab-v0", {}, "lqr", TUNE[:2], SELECT[:2], restarts=1, iterations=1)


@pytest.mark.parametrize(
    ("env_id", "keywords", "controller"),
    [
        ("BicycleStab-v0", {}, "pole-placement"),
        only_all("BicycleStab-v0", {"vehicle": "understeer"}, "preview"),
        ("BicycleActiveSteer-v0", {}, "rear-yaw-rate"),
        ("BicycleEvade-v0", {}, "evade-path"),
    ],
)
def test_every_kind_of_controller_is_tuned_alike(env_id, keywords, controller, monkeypatch):
    for name in ("LAW", "DESIGN"):
        monkeypatch.setattr(tuning_of_the_package, name, Budget(10, 2))
    found, again = (
        tune(env_id, keywords, controller, TUNE[:4], SELECT[:8], restarts=2, iterations=2, seed=0) for _ in range(2)
    )
    assert found == again
    assert found.best in (*found.restarts, found.shipped)
    assert found.restarts[0].parameters != found.restarts[1].parameters
    ranges = {one.name: (one.least, one.greatest) for one in control.TUNABLE[controller].parameters}
    for name, value in found.restarts[0].parameters.items():
        assert ranges[name][0] <= value <= ranges[name][1]
        assert value == float(f"{value:.4g}")


def test_where_a_search_begins():
    """Anywhere in a range on a logarithmic scale, or around a place; within three deviations of what may be."""
    weights, law = control.LQR.parameters, control.REAR_STEERINGS["rear-linear"].parameters
    means = np.array([Space(weights).beginning(np.random.default_rng(seed))[0] for seed in range(400)])
    assert np.allclose(means.min(axis=0), [0.0, -1.0, -2.0, -2.0, -2.0], atol=0.05)
    assert np.allclose(means.max(axis=0), [3.5, 3.5, 2.5, 1.5, 1.5], atol=0.05)
    means = np.array([Space(law).beginning(np.random.default_rng(seed))[0] for seed in range(400)])
    spread = np.array([one.spread for one in law])
    assert np.all(np.abs(means.mean(axis=0) - [one.start for one in law]) < 0.2 * spread)
    assert np.all(np.abs(means.std(axis=0) / spread - 1.0) < 0.15)
    assert Space(weights).values(np.array([[2.0, 0.0, 0.5, 1.0, -1.0]])).tolist() == [[100.0, 1.0, 3.162, 10.0, 0.1]]


def test_a_search_climbs_what_it_is_told_to_from_where_it_is_told_to():
    shipped = tuned_weights("stabilise")._asdict()
    begin = {name: shipped[name] for name in ("heading", "sideslip", "yaw_rate", "front_command", "rear_command")}
    given = {"restarts": 1, "iterations": 1, "begin": begin}
    found = {score: tune("BicycleStab-v0", {}, "lqr", TUNE, SELECT, score=score, **given) for score in SCORES}
    for score, (won, paid) in SCORES.items():
        one = found[score]
        scores = [
            won * row.success_rate + paid * row.mean_return / 400 for row in (one.best, one.shipped, *one.restarts)
        ]
        assert scores[0] == max(scores)
        for row in one.restarts:  # within three deviations of the search about a place, half a decade and less
            far = [abs(np.log10(row.parameters[name] / begin[name])) for name in begin]
            assert 0.0 < max(far) < 3.0 * NEAR * 3.5 / 3.0
    assert found["return"].restarts != found["success"].restarts


def test_a_law_has_more_iterations_than_a_design():
    assert budget(control.EvadePath) > budget(control.LQR)


@pytest.mark.parametrize(
    ("controller", "keywords", "words"),
    [
        ("rear-linaer", {}, "controller with parameters must be one of .*did you mean 'rear-linear'"),
        ("preview", {"steer": "rear"}, "steer must be 'front' or 'both' for the driver 'preview'"),
        ("evade-path", {}, "'evade-path' needs side"),
    ],
)
def test_what_cannot_be_tuned_is_refused(controller, keywords, words):
    with pytest.raises(ValueError, match=words):
        tune("BicycleStab-v0", keywords, controller, [0], [1])


def test_an_unknown_score_is_refused():
    with pytest.raises(ValueError, match=r"score must be one of .*did you mean 'return'"):
        tune("BicycleStab-v0", {}, "lqr", [0], [1], score="returns")
