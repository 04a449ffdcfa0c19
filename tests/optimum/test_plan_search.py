"""A law that plans by what the start shows."""

import functools

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env  # noqa: F401  (registers the environments)
from agents.episodes import start_seeds
from bicycle_env import control, optimum
from bicycle_env.optimum.plan_search import shown_at_the_start
from bicycle_env.optimum.tuning import Space

EVADE = "BicycleEvade-v0"


@functools.cache
def plant():
    return gym.make(EVADE).unwrapped


@functools.cache
def cars():
    return optimum.Cars(EVADE, {})


def law():
    return control.make("evade-path", plant())


def starts(k):
    return start_seeds(16, 1000 * (k + 1), "tune")


def space():
    return Space(control.searched(control.EvadePath, plant()))


def planned(affine):
    return optimum.Planned(law(), space(), *shown_at_the_start(cars(), starts(0)), affine)


def affine_of_the_law(features=3):
    affine = np.zeros((1 + features, len(law().values)))
    affine[0] = space().places(law().values)
    return affine


def first_observations(seeds):
    return cars().of(len(seeds)).reset(seed=list(seeds))[0]


def later(seen):
    """The same a second before: what is steered there is no full steer."""
    gates = [name in control.evade_path.GATES for name in plant().observation_names]
    return seen + np.array(gates, np.float32)


def test_features_are_what_differs_and_has_no_side():
    center, directions = shown_at_the_start(cars(), starts(0))
    used = [name for name, row in zip(plant().observation_names, directions, strict=True) if np.any(row)]
    assert used == ["obstacle_begin", "obstacle_end", "last_gate"]  # the speed is the same for all, the side is odd
    features = (first_observations(starts(0)) - center) @ directions
    np.testing.assert_allclose(np.cov(features, rowvar=False), np.eye(3), atol=1e-9)


def test_without_features_it_is_the_law():
    seen = later(first_observations(starts(0)))
    wanted = law().act(seen)
    assert np.any(np.abs(wanted) < 1.0)
    np.testing.assert_allclose(planned(affine_of_the_law()).act(seen), wanted, atol=1e-4)


def test_each_car_drives_by_its_own_plan_from_its_own_start_on():
    affine = affine_of_the_law()
    affine[1:] = 0.05 * np.random.default_rng(0).standard_normal(affine[1:].shape)
    policy, seen = planned(affine), first_observations(starts(1))
    policy.act(seen)
    values, actions = policy.plan(seen), policy.act(later(seen))
    assert np.all(np.ptp(values[:, :3], axis=0) > 0.0)
    assert np.any(np.abs(actions) < 1.0)
    for row, own, action in zip(later(seen), values, actions, strict=True):
        np.testing.assert_allclose(control.EvadePath.of(plant(), own).act(row), action, atol=1e-6)
    others = later(first_observations(starts(2)))
    policy.reset(np.arange(16) < 8)  # the others go on, with the plan that they have
    mixed = policy.act(others)
    for k, (row, action) in enumerate(zip(others, mixed, strict=True)):
        own = policy.plan(others)[k] if k < 8 else values[k]
        np.testing.assert_allclose(control.EvadePath.of(plant(), own).act(row), action, atol=1e-6)


def test_the_same_seed_finds_the_same_plan_and_the_law_stays_as_it_is():
    given, told = law(), []
    before = given.values.copy()

    def search(seed):
        return optimum.search_plan(
            EVADE, {}, given, starts, samples=10, iterations=2, seed=seed, progress=lambda *done: told.append(done)
        )

    seen = first_observations(starts(3))
    first, again, other = (search(seed).plan(seen) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first, other)
    np.testing.assert_array_equal(given.values, before)
    assert told[:2] == [(1, 2), (2, 2)]


@pytest.mark.parametrize("bad", [{"samples": 9}, {"iterations": 0}])
def test_too_little_is_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        optimum.search_plan(EVADE, {}, law(), starts, **bad)


def test_a_plan_saves_more_than_one_path_for_all():
    found = optimum.search_plan(EVADE, {}, law(), lambda k: start_seeds(96, 1000 * (k + 1), "tune"), iterations=12)
    seeds = start_seeds(1000, 0, "select")
    saved = [np.mean(optimum.drive(cars().of(1000), optimum.by(policy), seeds).success) for policy in (law(), found)]
    assert saved[1] > saved[0] + 0.01
