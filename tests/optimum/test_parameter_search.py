"""Parameters of a law for each start, with the future known or hidden; from an untuned law as from the tuned one."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env  # noqa: F401
from bicycle_env import control
from bicycle_env.control import EvadePath, Parameter, TunableLaw
from bicycle_env.optimum import drive, make_cars, replay, search_parameters, search_steering
from bicycle_env.optimum.parameter_search import draws_of

ACTIVE, EVADE = "BicycleActiveSteer-v0", "BicycleEvade-v0"
STARTS = list(range(100, 108))


class Damping(TunableLaw):
    """Rear wheels against yaw rate and heading."""

    name = "damping"
    parameters = (Parameter("yaw_rate", 0.0, 10.0, 1.0, 0.5), Parameter("heading", 0.01, 10.0, 1.0, 0.3, "log"))

    def __init__(self, plant, values=(1.0, 0.3)):
        self.values = np.array(values)
        self._gains, self._places = (
            self.values[None],
            [plant.observation_names.index(one.name) for one in self.parameters],
        )
        self._side = np.array([0.5, 1.0])

    @classmethod
    def of(cls, plant, values):
        return cls(plant, values)

    def vary(self, values):
        self._gains = values

    def act(self, observation):
        rear = np.sum(self._gains * np.atleast_2d(observation)[:, self._places], axis=1)
        return np.clip(rear[:, None] * self._side, -1.0, 1.0).astype(np.float32).reshape(*np.shape(observation)[:-1], 2)


def stab():
    return gym.make("BicycleStab-v0").unwrapped


def test_it_keeps_the_law_and_finds_nothing_worse():
    law = Damping(stab())
    found = search_parameters("BicycleStab-v0", {}, law, STARTS, draws=None, samples=8, iterations=3)
    usual = drive(make_cars("BicycleStab-v0", {}, 8), lambda seen, _: law.act(seen), STARTS)
    assert law.values.tolist() == [1.0, 0.3]
    for k, one in enumerate(found):
        gained = one.episode_return - usual.episode_return[k]
        assert (one.draws_saved, one.draws_saved_before) == (one.success, usual.success[k])
        assert one.success >= usual.success[k]
        assert (one.iterations == 0) == (one.parameters == (1.0, 0.3))
        assert one.iterations or gained == 0.0
    assert any(one.iterations for one in found)


def test_what_cannot_be_searched_is_refused():
    law = Damping(stab())
    with pytest.raises(ValueError, match=r"draws must be None where the task hides nothing, got 32: BicycleStab-v0"):
        search_parameters("BicycleStab-v0", {}, law, STARTS)
    with pytest.raises(ValueError, match=r"samples.*8.*got 7"):
        search_parameters("BicycleStab-v0", {}, law, STARTS, samples=7, draws=None)
    with pytest.raises(ValueError, match=r"draws.*1.*got 0"):
        search_parameters("BicycleStab-v0", {}, law, STARTS, draws=0)


def test_the_draws_of_a_start_are_its_own():
    mine, other, reseeded = draws_of(100, 32, 0), draws_of(101, 32, 0), draws_of(100, 32, 1)
    assert len({100, 101, *mine, *other, *reseeded}) == 2 + 3 * 32
    assert draws_of(100, 8, 0) == mine[:8]


def laws(env_id):
    """The tuned law, and an untuned one: straight rear wheels; a path of round numbers, followed at unit weights."""
    plant = gym.make(env_id).unwrapped
    if env_id == ACTIVE:
        return control.make("rear-switched", plant), control.REAR_STEERINGS["rear-switched"](plant, np.zeros(15))
    path = control.PathRound(**{one.name: one.start for one in EvadePath.parameters if one.name in EvadePath.planned})
    return control.make("evade-path", plant), EvadePath(plant, path, control.Weights(*[1.0] * 6))


@pytest.mark.parametrize("env_id", [ACTIVE, EVADE])
def test_from_an_untuned_law_all_is_found_that_the_tuned_one_saves(env_id):
    tuned, untuned = laws(env_id)
    search = {"samples": 192, "iterations": 15}
    saved = [one.success for one in search_steering(env_id, {}, tuned, STARTS, iterations=0, parameter_iterations=0)]
    alone = [one.success for one in search_steering(env_id, {}, untuned, STARTS, iterations=0, parameter_iterations=0)]
    assert sum(saved) > sum(alone)
    found = search_steering(env_id, {}, untuned, STARTS, **search)
    assert all(one.success for one, was in zip(found, saved, strict=True) if was)
    for seed, one in zip(STARTS, found, strict=True):
        assert replay(env_id, {}, seed, one.actions) == (*one[:3], len(one.actions))


@pytest.mark.parametrize("env_id", [EVADE])
def test_ten_times_the_samples_find_no_more(env_id):
    tuned, _ = laws(env_id)
    search = {"iterations": 8, "parameter_iterations": 6}
    usual = search_steering(env_id, {}, tuned, STARTS, **search)
    lost = [seed for seed, one in zip(STARTS, usual, strict=True) if not one.success]
    assert 0 < len(lost) < len(STARTS)
    more = search_steering(env_id, {}, tuned, lost, **search, samples=1920)
    assert not any(one.success for one in more)


@pytest.mark.parametrize("env_id", [ACTIVE])
@pytest.mark.parametrize("keywords", [{}, {"action_repeat": 5, "sensors": {"noise": {"yaw_rate": 0.01}}}])
def test_a_law_that_remembers_drives_as_alone(env_id, keywords):
    """The observer's memory, the noise and what is hidden are those of the single environment."""
    env = gym.make(env_id, **keywords)
    law = type(control.make("rear-linear", env))
    untuned = law(env.unwrapped, np.zeros(5))
    found = search_steering(env_id, keywords, untuned, STARTS[:3], samples=64, iterations=2)
    assert any(one.parameters and not one.iterations for one in found)
    for seed, one in zip(STARTS, found, strict=False):
        assert replay(env_id, keywords, seed, one.actions) == (*one[:3], len(one.actions))
        if one.parameters and not one.iterations:
            own = law(env.unwrapped, np.array(one.parameters))
            observation, _ = env.reset(seed=seed)
            for action in one.actions:
                assert np.array_equal(own.act(observation), action)
                observation, *_ = env.step(action)


@pytest.mark.parametrize("env_id", [ACTIVE, EVADE])
def test_without_the_future_a_start_depends_on_its_seed_alone(env_id):
    tuned, untuned = laws(env_id)
    search = {"draws": 8, "samples": 16, "iterations": 3}
    together = search_parameters(env_id, {}, untuned, STARTS[:3], **search)
    assert [search_parameters(env_id, {}, untuned, [seed], **search)[0] for seed in STARTS[:3]] == together
    assert search_parameters(env_id, {}, untuned, STARTS[:3], **search, seed=1) != together
    assert np.mean([one.draws_saved - one.draws_saved_before for one in together]) > 0.0
    env = gym.make(env_id)
    for seed, one in zip(STARTS, together, strict=False):
        own = type(tuned).of(env.unwrapped, np.array(one.parameters))
        observation, _ = env.reset(seed=seed)
        total, over = 0.0, False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(own.act(observation))
            total, over = total + reward, terminated or truncated
        assert (env.unwrapped.is_success, total) == (one.success, one.episode_return)
