"""The native vector environment and the one on tensors: the same keywords, defaults, info, masks and words."""

import inspect
from collections.abc import Mapping

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import pairwise
from vector_cases import ACTIVE, IDS, LANE_CHANGE, MODES, STAB, compiled

from bicycle_env.envs import TorchVectorEnv
from bicycle_env.envs.many.vector_env import SingleTrackVectorEnv

NUMBER = 6
QUICK = {"tire": "linear", "geometry": "small_angle"}
SLOWLY = {"control_timestep": 0.04, "physics_timestep": 0.02}
"""Half as many steps until a car has settled, and few substeps."""
ENDS, OTHERS, ALL = 1, [0, 2, 3, 4, 5], list(range(NUMBER))
FINAL = {"final_obs", "_final_obs", "final_info", "_final_info"}


def both(env_id=STAB, **keywords):
    many = gym.make_vec(env_id, NUMBER, **keywords).unwrapped
    return many, TorchVectorEnv(env_id, NUMBER, **keywords)


def test_a_keyword_of_both_has_one_default():
    native, tensors = (inspect.signature(one).parameters for one in (SingleTrackVectorEnv, TorchVectorEnv))
    assert native.keys() - tensors.keys() == {"threads", "render_mode", "render_rows", "keywords"}
    assert tensors.keys() - native.keys() == {"env_id", "device", "compile", "env_keywords"}
    for name in native.keys() & tensors.keys():
        assert native[name].default == tensors[name].default, name
        assert native[name].kind == tensors[name].kind, name


def test_a_method_of_both_has_one_signature():
    names = [name for name in vars(SingleTrackVectorEnv) if name[0] != "_" and name in vars(TorchVectorEnv)]
    methods = [name for name in names if inspect.isfunction(vars(SingleTrackVectorEnv)[name])]
    assert {"reset", "step", "measure", "snapshot", "restore"} == set(methods)
    for name in methods:
        native, tensors = (inspect.signature(getattr(one, name)) for one in (SingleTrackVectorEnv, TorchVectorEnv))
        assert [(one.name, one.kind, one.default) for one in native.parameters.values()] == [
            (one.name, one.kind, one.default) for one in tensors.parameters.values()
        ], name


@pytest.mark.parametrize(("env_id", "mode", "telemetry"), pairwise(IDS, MODES, [False, True]))
def test_info_is_the_same(env_id, mode, telemetry):
    """Straight running at the goal until all have settled; then the episode of one car ends."""
    law = {**SLOWLY, **(compiled(env_id, NUMBER) or QUICK)}
    pair = both(env_id, autoreset_mode=mode, on_invalid="terminate", telemetry=telemetry, steer="both", **law)
    last_step = pair[0].configuration.steps_to_settle + 3
    allowed = pair[0].task.options.items()  # drawn alike in both, behind all gates
    drawn = {name: "left" if isinstance(range_, Mapping) else sum(range_) / 2.0 for name, range_ in allowed}
    drawn |= {"amplitude": 0.01} if env_id == ACTIVE else {}
    place = {"lateral_position": 3.5} if env_id == LANE_CHANGE else {}
    options = {"state": {"longitudinal_position": 900.0, **place} if drawn else {}, **drawn}
    native, tensors = (env.reset(options=options)[1] for env in pair)
    assert_alike(native, tensors)
    actions = np.zeros((NUMBER, 2), np.float32)
    for k in range(last_step + 1):
        if k == last_step:
            actions[ENDS, 1] = np.nan
        native, tensors = (
            env.step(given)[4] for env, given in zip(pair, (actions, torch.tensor(actions)), strict=True)
        )
        if mode == "SameStep" and k < last_step:
            assert not tensors["_final_obs"].any()
            assert tensors.pop("final_info").keys() == native.keys()
            tensors = {name: value for name, value in tensors.items() if "final" not in name}
        assert_alike(native, tensors, rows=OTHERS if mode == "SameStep" else ALL)  # torch draws other starts
    last = native["final_info"] if mode == "SameStep" else native
    wins = env_id != ACTIVE  # where it is judged at the end
    assert last["is_success"].tolist() == [wins and row != ENDS for row in ALL]
    assert last["_is_success"].tolist() == [row == ENDS or mode != "SameStep" for row in ALL]
    assert [set(env.reset()[1]) for env in pair] == [set(native) - FINAL] * 2


def assert_alike(native, tensors, rows=ALL):
    """Names in one order; types, and in some rows the values."""
    assert list(native) == list(tensors)
    for name, values in native.items():
        if isinstance(values, dict):
            assert_alike(values, tensors[name])
            continue
        assert str(values.dtype) == str(tensors[name].dtype).removeprefix("torch."), name
        assert values.shape == tensors[name].shape, name
        np.testing.assert_allclose(values[rows], tensors[name][rows], rtol=1e-6, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(
    "keywords",
    [
        {"num_envs": 0},
        {"max_episode_steps": 0},
        {"max_episode_steps": 2**24 + 1, "dtype": "float32"},
        {"autoreset_mode": "nextstep"},
        {"autoreset_mode": None},
        {"dtype": "float16"},
        {"staggered_start": 1},
        {"on_invalid": "ignore"},
        {"telemetry": "yes"},
    ],
    ids=str,
)
def test_bad_keywords_are_refused_in_the_same_words(keywords):
    given, said = {"num_envs": NUMBER, **keywords}, []
    for make in (lambda: gym.make_vec(STAB, **given), lambda: TorchVectorEnv(STAB, **given)):
        with pytest.raises((TypeError, ValueError)) as error:
            make()
        said.append((error.type, str(error.value)))
    assert said[0] == said[1]


def test_bad_actions_are_refused_in_the_same_words():
    actions, said = np.full((NUMBER, 2), np.float32(0.5)), []
    actions[2, 0] = np.inf
    for env, given in zip(both(), (actions, torch.tensor(actions)), strict=True):
        env.reset(seed=0)
        with pytest.raises(ValueError, match="actions must be finite, nominally in") as error:
            env.step(given)
        said.append(str(error.value).partition(" has ")[0])
    assert len(set(said)) == 1


def test_the_first_reset_starts_all():
    for env in both():
        with pytest.raises(gym.error.ResetNeeded, match=r"the first reset\(\) must start all .*it takes no reset_mask"):
            env.reset(options={"reset_mask": np.arange(NUMBER) < 3})
        env.reset(options={"reset_mask": np.ones(NUMBER, bool)})
        env.reset(options={"reset_mask": None})
