"""The torch environment as a vector environment: how episodes end and begin, what may be asked, what is refused."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from torch_cases import IDS, LANE, MODES, STAB, STILL, assert_same_bits, quick, zeros

from bicycle_env.envs import TorchVectorEnv
from bicycle_env.registration import ENVIRONMENTS

# The ends of episodes


def spinning(envs, row):
    """One car beyond the yaw-rate limit, the others straight."""
    state = STILL
    state["yaw_rate"] = np.where(np.arange(envs.num_envs) == row, 5.0, 0.0)
    return envs.set_state({**state, "time": 0.0})


def test_same_step():
    envs = quick(autoreset_mode="SameStep", max_episode_steps=3)
    envs.reset(seed=0)
    spinning(envs, 1)
    observation, reward, terminated, truncated, info = envs.step(zeros(envs))
    alone = quick(autoreset_mode="Disabled")
    alone.reset(seed=0)
    spinning(alone, 1)
    last, gained, *_, told = alone.step(zeros(envs))
    assert (terminated.tolist(), truncated.tolist()) == ([False, True, False, False], [False] * 4)
    assert torch.equal(reward, gained)
    assert torch.equal(info["final_obs"], last)
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == [False, True, False, False]
    assert_same_bits(
        info["final_info"], told | {f"_{name}": info["_final_obs"] for name in ("end", "cost", "is_success")}
    )
    assert [envs.end_names[code] for code in info["final_info"]["end"]] == ["", "spun", "", ""]
    assert info["end"].tolist() == [0, 0, 0, 0]
    assert [torch.equal(*pair) for pair in zip(observation, last, strict=True)] == [True, False, True, True]
    assert abs(envs.state.yaw_rate[1]) <= 0.8, "a start of the task"
    assert np.allclose(envs.state.time, [0.02, 0.0, 0.02, 0.02])
    envs.step(zeros(envs))
    *_, truncated, info = envs.step(zeros(envs))
    assert truncated.tolist() == info["_final_obs"].tolist() == [True, False, True, True]
    *_, truncated, info = envs.step(zeros(envs))
    assert truncated.tolist() == [False, True, False, False]
    assert info["final_info"]["end"].tolist() == [0, 0, 0, 0], "a time-out shows in truncated only"


def test_next_step():
    envs = quick(autoreset_mode="NextStep", max_episode_steps=3)
    envs.reset(seed=0)
    spinning(envs, 1)
    _, _, terminated, _, info = envs.step(zeros(envs))
    assert terminated.tolist() == [False, True, False, False]
    assert info["end"].tolist() == [0, 1, 0, 0]
    assert not {"final_obs", "final_info"} & info.keys()
    observation, reward, terminated, truncated, info = envs.step(torch.ones(4, 2))
    assert not terminated.any()
    assert not truncated.any()
    assert reward[1] == 0.0
    assert (reward[[0, 2, 3]] > 0.0).all()
    assert info["end"].tolist() == [0, 0, 0, 0]
    assert np.allclose(envs.state.time, [0.04, 0.0, 0.04, 0.04])
    assert envs.state.front_steer_command[1] == 0.0, "the action of the step that starts anew is ignored"
    assert torch.equal(observation, envs._look()[0])
    _, _, _, truncated, _ = envs.step(zeros(envs))
    assert truncated.tolist() == [True, False, True, True]
    _, reward, _, truncated, _ = envs.step(zeros(envs))
    assert not truncated.any()
    assert (reward == 0.0).tolist() == [True, False, True, True]


def test_disabled():
    envs = quick(autoreset_mode="Disabled", max_episode_steps=3)
    envs.reset(seed=0)
    spinning(envs, 1)
    first, *_ = envs.step(zeros(envs))
    for step in (2, 3, 4):
        observation, reward, terminated, truncated, info = envs.step(torch.ones(4, 2))
        assert torch.equal(observation[1], first[1])
        assert (reward == 0.0).tolist() == ([False, True, False, False] if step < 4 else [True] * 4)
        assert terminated.tolist() == [False, True, False, False]
        assert truncated.tolist() == ([False] * 4 if step < 3 else [True, False, True, True])
        assert info["end"].tolist() == [0, 1, 0, 0]
    state = envs.state
    mask = np.array([False, True, True, False])
    options = {"reset_mask": mask, "state": {"heading": [0.1, 0.2, 0.3, 0.4]}}
    envs.reset(options=options)
    assert options.keys() == {"reset_mask", "state"}
    np.testing.assert_allclose(envs.state.heading, [state.heading[0], 0.2, 0.3, state.heading[3]], rtol=1e-15)
    _, reward, terminated, truncated, _ = envs.step(zeros(envs))
    assert (reward == 0.0).tolist() == truncated.tolist() == [True, False, False, True]
    assert not terminated.any()


def test_a_time_out_and_an_end_in_one_step_are_both_told():
    envs = quick(max_episode_steps=1, autoreset_mode="Disabled")
    envs.reset(seed=0)
    spinning(envs, 1)
    _, _, terminated, truncated, _ = envs.step(zeros(envs))
    assert (terminated.tolist(), truncated.tolist()) == ([False, True, False, False], [True] * 4)


def test_no_time_limit():
    envs = quick(max_episode_steps=-1)
    assert envs.max_episode_steps is None
    envs.reset(seed=0)
    envs.set_state({**STILL, "time": 1e6})
    assert not envs.step(zeros(envs))[3].any()
    assert [TorchVectorEnv(row.id, 1).max_episode_steps for row in ENVIRONMENTS] == [400, 300, 340]


# Actions that are not finite


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_bad_action_ends_its_own_row_only(mode, bad):
    envs, twin = (quick(autoreset_mode=mode, on_invalid="terminate") for _ in range(2))
    for each in (envs, twin):
        each.reset(seed=2)
    actions = torch.full((4, 2), 0.3)
    spoiled = actions.clone()
    spoiled[2, 1] = bad
    state = envs.state
    observation, reward, terminated, truncated, info = envs.step(spoiled)
    expected = twin.step(actions)
    others = [0, 1, 3]
    assert torch.equal(observation[others], expected[0][others])
    assert torch.equal(reward[others], expected[1][others])
    assert reward[2] == 0.0
    assert terminated.tolist() == [False, False, True, False]
    assert not truncated.any()
    last = info["final_info"] if mode == "SameStep" else info
    assert [envs.end_names[code] for code in last["end"]] == ["", "", "invalid_action", ""]
    if mode != "SameStep":
        assert [column[2].item() for column in envs.state] == [column[2].item() for column in state]
    assert all(column.isfinite().all() for column in envs.state)
    observation, reward, *_ = envs.step(actions)
    assert observation.isfinite().all()
    assert torch.equal(observation[others], twin.step(actions)[0][others])


def test_a_bad_action_never_pays():
    envs = quick(reward="quadratic", autoreset_mode="Disabled", on_invalid="terminate")
    single = gym.make(STAB, tire="linear", reward="quadratic").unwrapped
    envs.reset(seed=2)
    envs.step(zeros(envs))
    spoiled = zeros(envs)
    spoiled[0] = np.nan
    _, reward, *_ = envs.step(spoiled)
    single.reset(options={"state": {"yaw_rate": 5.0}})
    _, failed, *_ = single.step(np.zeros(2, np.float32))
    worst = (failed + 4.0 * 5.0**2) / 399.0  # this start's own stage cost is 4 r^2
    assert reward[0].item() == pytest.approx(399.0 * worst)
    assert (reward[1:] > -100.0).all()


def test_a_bad_action_can_raise_and_then_nothing_has_changed():
    envs, twin = quick(on_invalid="raise"), quick(on_invalid="raise")
    for each in (envs, twin):
        each.reset(seed=2)
    spoiled = zeros(envs)
    spoiled[3, 0] = np.nan
    with pytest.raises(ValueError, match=r"actions must be finite, .*; row 3 has \[nan, 0.0\]"):
        envs.step(spoiled)
    assert_same_bits(envs.step(zeros(envs)), twin.step(zeros(envs)))


def test_a_row_that_waits_for_its_start_may_be_given_anything():
    for mode in ("NextStep", "Disabled"):
        envs = quick(autoreset_mode=mode, on_invalid="raise")
        envs.reset(seed=0)
        spinning(envs, 1)
        envs.step(zeros(envs))
        spoiled = zeros(envs)
        spoiled[1] = np.nan
        *_, info = envs.step(spoiled)
        assert info["end"].tolist() == ([0, 0, 0, 0] if mode == "NextStep" else [0, 1, 0, 0])


# States given and taken


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("env_id", IDS)
def test_a_state_returns_as_it_was_given(env_id, dtype):
    envs, twin = quick(env_id=env_id, dtype=dtype), quick(env_id=env_id, dtype=dtype)
    envs.reset(seed=0)
    twin.reset(seed=1)
    for _ in range(30):  # to the steering limits
        envs.step(torch.ones(4, 2))
    state = envs.state
    observation, info = twin.set_state(state._asdict())
    assert_same_bits(twin.state, state)
    assert_same_bits(observation, envs._look()[0])
    assert info.keys() == envs.reset()[1].keys()
    twin.set_state({name: column.tolist() for name, column in state._asdict().items()})
    assert_same_bits(twin.state, state)
    twin.set_state({"heading": 0.25})
    assert_same_bits(twin.state, state._replace(heading=torch.full((4,), 0.25, dtype=getattr(torch, dtype))))


def test_options_give_numbers_or_columns_and_zero_elsewhere():
    envs = quick(env_id=LANE)
    options = {"state": {"heading": 0.1, "yaw_rate": [0.1, 0.2, 0.3, 0.4]}, "direction": "right", "change_start": 2.0}
    envs.reset(seed=3, options=options)
    state = envs.state
    assert state.heading.tolist() == [0.1] * 4
    assert state.yaw_rate.tolist() == [0.1, 0.2, 0.3, 0.4]
    assert state.lateral_position.tolist() == [0.0] * 4
    assert state.direction.tolist() == [-1.0] * 4
    np.testing.assert_allclose(state.change_start, 2.0 * envs.speed, rtol=1e-15)
    plain = quick(env_id=LANE)
    plain.reset(seed=3)
    assert_same_bits(envs.reset()[0], plain.reset()[0])


def test_a_snapshot_continues_to_the_bit():
    envs, twin = (quick(6, max_episode_steps=5) for _ in range(2))
    envs.reset(seed=4)
    actions = torch.rand(12, 6, 2, generator=torch.Generator().manual_seed(1)) * 2.0 - 1.0
    for action in actions[:3]:
        envs.step(action)
    snapshot = envs.snapshot()
    seen, _ = envs._look()
    first = [envs.step(action) for action in actions]
    assert_same_bits(envs.restore(snapshot), seen)
    assert_same_bits([envs.step(action) for action in actions], first)
    twin.restore(snapshot)
    assert_same_bits([twin.step(action) for action in actions], first)
    with pytest.raises(TypeError, match=r"snapshot must come from snapshot\(\), got <class 'tuple'>"):
        envs.restore(tuple(snapshot))
    for other in (quick(4), quick(6, dtype="float32"), quick(6, env_id=LANE)):
        with pytest.raises(ValueError, match=r"snapshot must be of \d cars in .* got one of 6 in torch.float64"):
            other.restore(snapshot)


@pytest.mark.parametrize("mode", MODES)
def test_what_is_returned_belongs_to_the_caller(mode):
    envs, twin = (quick(env_id=LANE, autoreset_mode=mode, telemetry=True) for _ in range(2))
    for each in (envs, twin):
        each.reset(seed=0)
    actions = torch.full((4, 2), 0.4, dtype=torch.float64)
    results = envs.step(actions)
    expected = twin.step(actions)
    everything = [*results[:4], *results[4].values(), *envs.state, *envs.measure().values(), envs.is_success, actions]
    everything += [column for part in envs.snapshot().episodes[:2] for column in part if not isinstance(column, tuple)]
    for value in everything:
        for tensor in value.values() if isinstance(value, dict) else [value]:
            tensor.fill_(1)
    envs._checked_actions(actions, envs._episodes).add_(1.0)
    assert_same_bits(envs.step(torch.ones(4, 2)), twin.step(torch.ones(4, 2)))
    assert expected[1].all()


# Bad input


BAD_KEYWORDS = [
    ({"num_envs": 0}, ValueError, r"num_envs must be a whole number in \[1, "),
    ({"num_envs": 2.5}, TypeError, "num_envs must be a whole number"),
    ({"env_id": "BicyclStab-v0"}, gym.error.NameNotFound, "BicycleStab"),
    ({"env_id": "CartPole-v1"}, ValueError, "env_id must be of a single-track environment, got 'CartPole-v1'"),
    ({"env_id": 3}, TypeError, "env_id must be the id of a registered environment, got 3"),
    ({"device": "gpu"}, ValueError, "device must be one that torch can use here, got 'gpu'"),
    ({"device": "xla"}, ValueError, "device must be one that torch can use here, got 'xla'"),
    ({"device": 1.5}, ValueError, "device must be one that torch can use here, got 1.5"),
    ({"dtype": "float16"}, ValueError, "dtype must be one of 'float64', 'float32', got 'float16'"),
    ({"dtype": torch.int64}, ValueError, "dtype must be one of 'float64', 'float32', got 'int64'"),
    ({"autoreset_mode": "nextstep"}, ValueError, "autoreset_mode must be one of .*did you mean 'NextStep'"),
    ({"autoreset_mode": 1}, TypeError, "autoreset_mode must be one of"),
    ({"max_episode_steps": 0}, ValueError, "max_episode_steps must be a whole number"),
    ({"on_invalid": "ignore"}, ValueError, "on_invalid must be one of 'raise', 'terminate', got 'ignore'"),
    ({"compile": 1}, TypeError, "compile must be True or False, got 1"),
    ({"staggered_start": "no"}, TypeError, "staggered_start must be True or False"),
    ({"tyre": "fiala"}, TypeError, "unknown keyword 'tyre'; did you mean 'tire'"),
    ({"render_mode": "human"}, TypeError, "unknown keyword 'render_mode'"),
    ({"direction": "left"}, TypeError, "unknown keyword 'direction'"),
    ({"friction": [1.0, 1.0, -1.0, 1.0]}, ValueError, "car 2: friction must be .*, got -1"),
    ({"friction": torch.ones(3)}, ValueError, "friction must be one number or num_envs = 4 of them"),
    ({"speed_ratio": [1.0, 1.0, np.nan, 1.0]}, ValueError, "car 2: speed_ratio must be"),
]  # fmt: skip


@pytest.mark.parametrize(("keywords", "error", "match"), BAD_KEYWORDS)
def test_bad_keywords_are_named(keywords, error, match):
    with pytest.raises(error, match=match):
        TorchVectorEnv(**{"env_id": STAB, "num_envs": 4, **keywords})


BAD_OPTIONS = [
    ({"state": {"yaw_rate": [0.1, 0.2]}}, ValueError, r"\['yaw_rate'\] must be one .* got shape \(2,\)"),
    ({"state": {"yaw_rate": [0.1, 0.2, 11.0, 0.1]}}, ValueError, r"\['yaw_rate'\] must .* in \[-10, 10\], got 11"),
    ({"state": {"yaw_rate": [0.1, -10.5, 1.0, 0.1]}}, ValueError, "yaw_rate.* got -10.5"),
    ({"state": {"yaw_rate": torch.tensor([0.1, 0.2, np.nan, 0.1])}}, ValueError, "yaw_rate.* got nan"),
    ({"state": {"yaw_rate": torch.zeros(4, dtype=torch.bool)}}, TypeError, "yaw_rate"),
    ({"state": {"yaw_rate": ["a"] * 4}}, TypeError, "yaw_rate"),
    ({"state": {"yaw_rate": "fast"}}, TypeError, "yaw_rate"),
    ({"state": {"yaw_rate": [[1.0], 2.0, 3.0, 4.0]}}, TypeError, "yaw_rate"),
    ({"state": {"front_steer": 0.2}}, ValueError, "front_steer"),
    ({"state": {"time": 0.2}}, ValueError, "unknown state name 'time'"),
    ({"state": {"yawrate": np.zeros(4)}}, ValueError, "unknown state name 'yawrate'; did you mean 'yaw_rate'"),
    ({"state": [0.0] * 4}, TypeError, r"options\['state'\] must be a mapping"),
    ({"direction": "left"}, ValueError, "unknown reset option 'direction'"),
    ({"reset_mask": [True] * 4}, TypeError, r"\['reset_mask'\] must be a tensor or array of bool, got \[True, "),
    ({"reset_mask": torch.ones(4)}, TypeError, "reset_mask"),
    ({"reset_mask": np.array([True, False])}, ValueError, r"\['reset_mask'\] must have shape \(4,\), got array"),
    (["state"], TypeError, "options must be a mapping"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "error", "match"), BAD_OPTIONS)
def test_bad_options_are_named_and_nothing_changes(options, error, match):
    envs, twin = quick(), quick()
    for each in (envs, twin):
        each.reset(seed=0)
    with pytest.raises(error, match=match):
        envs.reset(seed=77, options=options)
    assert_same_bits(envs.step(zeros(envs)), twin.step(zeros(envs)))


@pytest.mark.parametrize(
    ("state", "error", "match"),
    [
        ({"yaw_rat": 0.1}, ValueError, "unknown state name 'yaw_rat'; did you mean 'yaw_rate'"),
        ({"yaw_rate": 20.0}, ValueError, r"state\['yaw_rate'\] must be a finite number in \[-10, 10\], got 20.0"),
        ({"time": -0.1}, ValueError, r"state\['time'\] must be a finite number >= 0, got -0.1"),
        ({"time": [0.0, 1.0, np.inf, 0.0]}, ValueError, r"state\['time'\].* got inf"),
        ({"direction": 1.0}, ValueError, "unknown state name 'direction'"),
        ([1.0], TypeError, "state must be a mapping"),
    ],
)
def test_bad_states_are_named_and_nothing_changes(state, error, match):
    envs, twin = quick(), quick()
    for each in (envs, twin):
        each.reset(seed=0)
    with pytest.raises(error, match=match):
        envs.set_state(state)
    assert_same_bits(envs.step(zeros(envs)), twin.step(zeros(envs)))


@pytest.mark.parametrize(
    ("action", "error", "match"),
    [
        (np.zeros((4, 2), np.float32), TypeError, r"tensor of \(4, 2\) real numbers on cpu, got ndarray"),
        (torch.zeros(4, 2, dtype=torch.bool), TypeError, "got torch.bool"),
        (torch.zeros(4, 2, dtype=torch.complex64), TypeError, "got torch.complex64"),
        (torch.zeros(4, 1), ValueError, r"actions must have shape \(4, 2\) \(steer='both'\), got \(4, 1\)"),
        (torch.zeros(2), ValueError, "actions must have shape"),
        (torch.zeros(4, 2, device="meta"), ValueError, "actions must be on cpu, got some on meta"),
    ],
)  # fmt: skip
def test_bad_actions_are_named_and_nothing_changes(action, error, match):
    envs, twin = quick(), quick()
    for each in (envs, twin):
        each.reset(seed=0)
    with pytest.raises(error, match=match):
        envs.step(action)
    assert_same_bits(envs.step(zeros(envs)), twin.step(zeros(envs)))


def test_whole_numbers_are_actions_too():
    envs, twin = quick(), quick()
    for each in (envs, twin):
        each.reset(seed=0)
    assert_same_bits(envs.step(torch.ones(4, 2, dtype=torch.int64)), twin.step(torch.ones(4, 2)))


@pytest.mark.parametrize("seed", [-1, 1.5, "a", True])
def test_bad_seeds_are_named(seed):
    with pytest.raises((ValueError, TypeError), match="seed must be a whole number"):
        quick().reset(seed=seed)


def test_what_needs_a_reset_says_so():
    envs = quick()
    for ask in (
        lambda: envs.step(zeros(envs)),
        lambda: envs.state,
        lambda: envs.is_success,
        lambda: envs.snapshot(),
        lambda: envs.measure(),
        lambda: envs.set_state({}),
        lambda: envs.detach(),
    ):
        with pytest.raises(gym.error.ResetNeeded, match=r"call reset\(\) before"):
            ask()


# As a Gymnasium vector environment


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", IDS)
def test_it_looks_like_a_vector_environment(env_id, mode):
    envs = TorchVectorEnv(env_id, 3, steer="rear", autoreset_mode=gym.vector.AutoresetMode(mode))
    single = gym.make(env_id, steer="rear")
    assert isinstance(envs, gym.vector.VectorEnv)
    assert envs.single_observation_space == single.observation_space
    assert envs.single_action_space == single.action_space
    assert envs.observation_space == gym.vector.utils.batch_space(single.observation_space, 3)
    assert envs.action_space == gym.vector.utils.batch_space(single.action_space, 3)
    assert envs.autoreset_mode is envs.metadata["autoreset_mode"] is gym.vector.AutoresetMode(mode)
    assert envs.num_envs == 3
    assert envs.spec.id == env_id
    assert envs.observation_names == single.unwrapped.observation_names
    np.testing.assert_array_equal(envs.observation_scale, single.unwrapped.observation_scale)
    np.testing.assert_array_equal(envs.observation_mirror, single.unwrapped.observation_mirror)
    assert envs.stability.speed_ratio == pytest.approx(1.2)
    np.testing.assert_array_equal(envs.linear_model().A, single.unwrapped.linear_model().A)
    envs.action_space.seed(0)
    observation, info = envs.reset(seed=0)
    assert observation.numpy() in envs.observation_space
    assert info.keys() == {"end", "cost", "is_success", "_end", "_cost", "_is_success"}
    observation, reward, *_ = envs.step(torch.from_numpy(envs.action_space.sample()))
    assert observation.numpy() in envs.observation_space
    assert reward.shape == (3,)
    envs.close()


def test_an_unknown_keyword_proposes_one_of_its_own():
    with pytest.raises(TypeError, match=r"'devise'; did you mean 'device'.*'max_episode_steps'.*'friction'"):
        TorchVectorEnv(STAB, 2, devise="cpu")


def test_an_unknown_option_names_the_mask():
    envs = quick()
    with pytest.raises(ValueError, match=r"'foo'.*'reset_mask'"):
        envs.reset(options={"foo": 1})
