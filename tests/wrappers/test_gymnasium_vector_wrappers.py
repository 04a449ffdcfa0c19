"""Gymnasium's vector wrappers around the native vector environment do what they do around single environments."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import ON_ROADS, some_of
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import TransformObservation as SingleTransformObservation
from gymnasium.wrappers.vector import (
    ClipAction,
    ClipReward,
    DictInfoToList,
    FlattenObservation,
    NormalizeObservation,
    NormalizeReward,
    NumpyToTorch,
    RecordEpisodeStatistics,
    RescaleAction,
    RescaleObservation,
    TransformAction,
    TransformObservation,
    TransformReward,
    VectorizeTransformObservation,
)

import bicycle_env  # noqa: F401
from bicycle_env.registration import ENVIRONMENTS

IDS = [row.id for row in ENVIRONMENTS]
ROWS, STEPS, LIMIT = 6, 130, 50
MODES = ["NextStep", "SameStep"]

TWO, ONE = np.float32(2.0), np.float32(1.0)

WRAPPERS = {
    "RecordEpisodeStatistics": RecordEpisodeStatistics,
    "NormalizeReward": NormalizeReward,
    "NormalizeReward(RecordEpisodeStatistics)": lambda envs: NormalizeReward(RecordEpisodeStatistics(envs)),
    "TransformReward": lambda envs: TransformReward(envs, lambda rewards: 2.0 * rewards),
    "ClipReward": lambda envs: ClipReward(envs, 0.2, 0.8),
    "ClipAction": ClipAction,
    "RescaleAction": lambda envs: RescaleAction(envs, -TWO, TWO),
    "TransformAction": lambda envs: TransformAction(envs, lambda actions: 0.5 * actions),
}
# Gymnasium refuses these in the mode SAME_STEP, around any environment.
OBSERVATION_WRAPPERS = {
    "NormalizeObservation": NormalizeObservation,
    "TransformObservation": lambda envs: TransformObservation(envs, np.tanh),
    "VectorizeTransformObservation": lambda envs: VectorizeTransformObservation(
        envs, SingleTransformObservation, func=lambda one: -one, observation_space=envs.single_observation_space
    ),
    "FlattenObservation": FlattenObservation,
    "RescaleObservation": lambda envs: RescaleObservation(envs, -ONE, ONE),
}
CASES = [
    *((wrap, mode) for wrap in WRAPPERS for mode in MODES),
    *((wrap, "NextStep") for wrap in OBSERVATION_WRAPPERS),
]


def native(env_id, mode, **keywords):
    own = {"friction": np.ones(ROWS)} if "tire" in keywords else {}  # compiled for tests/contracts, too
    return gym.make_vec(env_id, ROWS, autoreset_mode=mode, max_episode_steps=LIMIT, steer="both", **own, **keywords)


def one_by_one(env_id, mode, **keywords):
    given = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": AutoresetMode(mode)}}
    return gym.make_vec(env_id, ROWS, max_episode_steps=LIMIT, steer="both", **given, **keywords)


def actions():
    steps = np.random.default_rng(0).uniform(-0.4, 0.4, (STEPS, ROWS, 2))
    return np.clip(np.cumsum(steps, axis=0), -1.5, 1.5).astype(np.float32)


def assert_same(mine, theirs):
    assert mine.dtype == theirs.dtype
    np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize(("name", "mode"), CASES)
@pytest.mark.parametrize("env_id", some_of(IDS, ["BicycleStab-v0"]))
def test_a_wrapper_does_the_same_as_around_single_environments(env_id, name, mode):
    wrap = {**WRAPPERS, **OBSERVATION_WRAPPERS}[name]
    mine, theirs = wrap(native(env_id, mode)), wrap(one_by_one(env_id, mode))
    assert mine.single_observation_space == theirs.single_observation_space
    assert mine.single_action_space == theirs.single_action_space
    assert_same(mine.reset(seed=3)[0], theirs.reset(seed=3)[0])
    ends = 0
    for action in actions():
        *arrays, info = mine.step(action)
        *expected, wanted = theirs.step(action)
        for one, other in zip(arrays, expected, strict=True):
            assert_same(one, other)
        ends += np.sum(arrays[2] | arrays[3])
        assert ("final_obs" in info) == ("final_obs" in wanted)
        if "final_obs" in info:
            assert_same(info["_final_obs"], wanted["_final_obs"])
            for row in np.flatnonzero(info["_final_obs"]):
                assert_same(info["final_obs"][row], wanted["final_obs"][row])
        assert ("episode" in info) == ("episode" in wanted)
        if "episode" in info:
            assert_same(info["_episode"], wanted["_episode"])
            assert_same(info["episode"]["r"], wanted["episode"]["r"])
            assert_same(info["episode"]["l"], wanted["episode"]["l"])
    assert ends > ROWS


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", ON_ROADS)
def test_info_as_a_list_is_the_single_environments_info(env_id, mode):
    given = {"tire": "tanh"} if env_id == "BicycleLaneChange-v0" else {}
    mine, theirs = (DictInfoToList(make(env_id, mode, telemetry=True, **given)) for make in (native, one_by_one))
    names = mine.unwrapped.end_names

    def plain(info):
        told = {name: value for name, value in info.items() if not name.startswith("final")}
        return told | {"end": names[told["end"]] if isinstance(told["end"], np.integer) else told["end"]}

    *_, infos = mine.reset(seed=0)
    *_, expected = theirs.reset(seed=0)
    seen = set()
    for action in [None, *actions()]:
        if action is not None:
            *_, infos = mine.step(action)
            *_, expected = theirs.step(action)
        for info, want in zip(infos, expected, strict=True):
            assert plain(info) == plain(want)
            assert info.keys() == want.keys()
            if "final_info" in info:
                assert plain(info["final_info"]) == plain(want["final_info"])
                seen.add(plain(info["final_info"])["end"])
    assert mode == "NextStep" or len(seen) > 1


@pytest.mark.parametrize("mode", MODES)
def test_numpy_to_torch(mode):
    mine, plain = NumpyToTorch(native(IDS[0], mode)), native(IDS[0], mode)
    observation, _ = mine.reset(seed=0)
    assert_same(observation.numpy(), plain.reset(seed=0)[0])
    for action in actions():
        *tensors, info = mine.step(torch.as_tensor(action))
        *arrays, told = plain.step(action)
        for tensor, array in zip(tensors, arrays, strict=True):
            np.testing.assert_array_equal(tensor.numpy(), array)
        assert_same(info["cost"].numpy(), told["cost"])
        assert info.keys() == told.keys()


def test_normalised_observations_are_normal():
    envs = NormalizeObservation(native(IDS[0], "NextStep"))
    envs.reset(seed=0)
    seen = np.concatenate([envs.step(action)[0] for action in actions()])[ROWS * 30 :]
    assert np.all(np.abs(seen.mean(axis=0)) < 0.5)
    assert np.all(np.abs(seen.std(axis=0) - 1.0) < 0.5)
