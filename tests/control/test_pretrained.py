"""Trained policies that come with the package: all of them load, fit and say what they are."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env
from bicycle_env import control
from bicycle_env.control.pretrained import FOLDER, published

STAB = "BicycleStab-v0"
ALL = [(env_id, level) for env_id, levels in published().items() for level in levels]


def test_there_is_one_and_the_folder_holds_nothing_else():
    assert (STAB, "medium") in ALL
    names = {path.relative_to(FOLDER).as_posix() for path in FOLDER.rglob("*") if path.is_file()}
    files = {f"{env_id}-{level}/policy.{end}" for env_id, level in ALL for end in ("json", "safetensors")}
    assert names == {"leaderboard.json", *files}


@pytest.mark.parametrize(("env_id", "level"), ALL)
def test_it_drives_its_id_and_level(env_id, level):
    policy = bicycle_env.load_policy(env_id, level)
    said = policy.description
    assert (said["env_id"], said["level"], said["env_keywords"]) == (env_id, level, {"level": level})
    assert said["command"].startswith("python -m agents.publishing ")
    assert {"date", "machine", "versions", "git", "training"} <= set(said)
    assert said["score"]["starts"] == 2000
    low, high = said["score"]["success_rate"]["interval"]
    assert 0.0 <= low <= said["score"]["success_rate"]["value"] <= high <= 1.0

    env = gym.make(env_id, level=level)
    observation, _ = env.reset(seed=1)
    same = control.make("pretrained", env)
    action = policy.act(observation)
    assert env.action_space.contains(action)
    assert np.array_equal(action, same.act(observation))
    assert same.description == said


def test_without_a_level_it_is_the_one_without_a_level():
    assert bicycle_env.load_policy(STAB).description == bicycle_env.load_policy(STAB, "medium").description
    assert control.make("pretrained", gym.make(STAB)).description["level"] == "medium"


def test_many_cars_have_it_too():
    cars = gym.make_vec(STAB, 3, vectorization_mode="vector_entry_point")
    observations, _ = cars.reset(seed=0)
    assert control.make("pretrained", cars).act(observations).shape == (3, 2)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (("BicycleStap-v0",), "env_id with a policy must be one of .*'BicycleStab-v0'.*did you mean 'BicycleStab-v0'"),
        ((STAB, "mediun"), "level of BicycleStab-v0 with a policy must be one of .*'medium'.*did you mean 'medium'"),
        ((STAB, "none"), "must be one of .*'medium', got 'none'"),
        ((STAB, ""), "must be one of .*'medium', got ''"),
        (("../policies/BicycleStab-v0",), "must be one of"),
    ],
)
def test_who_has_none_is_told_who_has(arguments, match):
    with pytest.raises(ValueError, match=match):
        bicycle_env.load_policy(*arguments)


@pytest.mark.parametrize("arguments", [(None,), (STAB, 1), (3, "medium")])
def test_what_is_no_word_is_refused(arguments):
    with pytest.raises(TypeError, match="must be one of"):
        bicycle_env.load_policy(*arguments)


def test_an_environment_that_steers_something_else_is_refused():
    with pytest.raises(ValueError, match=r"the policy was trained for BicycleStab-v0 with 8 observations, 2 actions"):
        control.make("pretrained", gym.make(STAB, steer="rear"))


def test_an_environment_that_nobody_registered_is_refused():
    with pytest.raises(ValueError, match=r"needs an environment that gym\.make has made"):
        control.make("pretrained", type(gym.make(STAB).unwrapped)())
    with pytest.raises(ValueError, match="controller with parameters must be one of"):
        control.make("pretrained", gym.make(STAB), parameters={})
