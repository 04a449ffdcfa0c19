"""What the vector environment gives back: spaces, types, and memory that belongs to the caller."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from vector_cases import COMBINATIONS, IDS, MODES, STAB, actions_for, compiled, drive, make_many, record

from bicycle_env.envs.many.blocks import ROW_COST, Kind
from bicycle_env.envs.many.rows import Rows
from bicycle_env.envs.registered_fleet import registered_fleet

KINDS = {"end": np.int8, "cost": np.float64, "is_success": np.bool_}
BYTES_PER_ROW = {False: 248, True: 624}
"""The numbers of a car in float64, without and with numbers of its own, as docs/performance.md says."""


def make(env_id=STAB, num_envs=6, **keywords):
    return gym.make_vec(env_id, num_envs=num_envs, max_episode_steps=40, **compiled(env_id, num_envs), **keywords)


def arrays_in(item):
    """All arrays at any depth."""
    if isinstance(item, np.ndarray):
        return [item]
    if isinstance(item, dict):
        return [array for value in item.values() for array in arrays_in(value)]
    if isinstance(item, (tuple, list)):
        return [array for value in item for array in arrays_in(value)]
    return []


def internals(env):
    """The arrays that the environment lives on, at any depth."""
    return arrays_in([vars(env), vars(env._rows)])


# Spaces and types


@pytest.mark.parametrize("steer", ["front", "both"])
@pytest.mark.parametrize("env_id", IDS)
def test_the_spaces_are_the_single_environments_many_times(env_id, steer):
    env, alone = make(env_id, steer=steer), gym.make(env_id, steer=steer, **compiled(env_id))
    assert env.single_observation_space == alone.observation_space
    assert env.single_action_space == alone.action_space
    assert env.action_space == spaces.Box(-1.0, 1.0, (6, 2 if steer == "both" else 1), np.float32)
    assert env.observation_space.shape == (6, *alone.observation_space.shape)
    assert env.observation_space.contains(np.zeros(env.observation_space.shape, np.float32))  # TorchRL fills with 0


@pytest.mark.parametrize("telemetry", [False, True])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", IDS)
def test_types_shapes_and_bounds(env_id, mode, telemetry):
    env = make(env_id, autoreset_mode=mode, telemetry=telemetry)
    observation, info = env.reset(seed=0)
    names = list(info)
    assert set(names) >= {"end", "cost", "_end", "_cost"}
    assert ("lateral_acceleration" in names) is telemetry
    ended = 0
    for actions in actions_for(env, 90):
        assert_arrays(env, observation, info)
        observation, reward, terminated, truncated, info = env.step(actions)
        for array, dtype in ((reward, np.float64), (terminated, np.bool_), (truncated, np.bool_)):
            assert array.dtype == dtype
            assert array.shape == (6,)
            assert array.flags.carray
        assert np.isfinite(reward).all()
        assert [name for name in info if "final" not in name] == names, "keys of reset and step differ"
        over = (terminated | truncated).any()
        ended += over
        assert ("final_obs" in info) == (over and mode == "SameStep")
        if "final_obs" in info:
            assert_arrays(env, info["final_obs"], info["final_info"])
            assert np.array_equal(info["_final_obs"], terminated | truncated)
            assert list(info["final_info"])[:2] == ["end", "cost"]
    assert ended


def assert_arrays(env, observation, info):
    assert type(observation) is np.ndarray
    assert observation.flags.carray
    assert env.observation_space.contains(observation)
    for name, values in info.items():
        if "final" in name:
            continue
        assert values.dtype == (np.bool_ if name.startswith("_") else KINDS.get(name, np.float64)), name
        assert values.shape == (env.num_envs,)
        assert values.flags.carray


# Memory


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("telemetry", [False, True])
def test_what_comes_back_belongs_to_the_caller(mode, telemetry):
    """No memory is shared with the environment or with what it gave before; overwriting it changes nothing."""
    env, twin = (make(autoreset_mode=mode, telemetry=telemetry) for _ in range(2))
    results, expected = env.reset(seed=1), twin.reset(seed=1)
    earlier = []
    for actions in actions_for(env, 90):
        assert record(results) == record(expected)
        mine, inside = arrays_in(results), internals(env)
        for array in mine:
            assert array.flags.writeable
            assert not any(np.shares_memory(array, other) for other in inside)
            assert not any(np.shares_memory(array, other) for other in earlier)
        earlier = mine
        for array in mine:
            array[...] = 1 if array.dtype == np.bool_ else 77
        given = actions.copy()
        results = env.step(actions)
        assert np.array_equal(actions, given), "the caller's actions were changed"
        assert not any(np.shares_memory(actions, array) for array in (*arrays_in(results), *internals(env)))
        actions[...] = 0.77
        expected = twin.step(given)


def test_state_and_measurements_are_copies():
    env, twin = make(), make()
    for each in (env, twin):
        each.reset(seed=1)
    snapshot = env.snapshot()
    asked = [*env.state, *env.measure().values(), env.is_success, snapshot.rows]
    for array in asked:
        assert not any(np.shares_memory(array, other) for other in internals(env))
        array[...] = 1
    actions = actions_for(env, 60)
    assert drive(env, actions) == drive(twin, actions)
    env.restore(twin.snapshot())
    observation = env.restore(kept := twin.snapshot())
    kept.rows[...] = 1
    observation[...] = 1
    assert drive(env, actions) == drive(twin, actions)


def test_what_reset_was_given_stays_the_callers():
    env, twin = make(), make()
    given = {"state": {"yaw_rate": np.linspace(0.0, 0.2, 6)}, "reset_mask": np.ones(6, bool)}
    env.reset(seed=1)
    twin.reset(seed=1)
    assert record(env.reset(options=given)) == record(twin.reset(options={"state": given["state"]}))
    assert list(given) == ["state", "reset_mask"]
    assert np.array_equal(given["state"]["yaw_rate"], np.linspace(0.0, 0.2, 6))
    given["state"]["yaw_rate"][:] = 9.0
    given["reset_mask"][:] = False
    actions = actions_for(env, 20)
    assert drive(env, actions) == drive(twin, actions)


def test_keywords_per_row_are_copied():
    friction = np.linspace(0.5, 1.0, 11)
    combination = COMBINATIONS[3]
    env, twin = make_many(combination, friction=friction), make_many(combination, friction=friction.copy())
    friction[:] = 0.1
    for each in (env, twin):
        each.reset(seed=0)
    assert drive(env, actions_for(env, 10)) == drive(twin, actions_for(env, 10))
    assert env.friction[0] == 0.5


@pytest.mark.parametrize("varied", BYTES_PER_ROW)
def test_the_memory_of_a_row_is_what_is_documented(varied):
    """Of the task that needs most; without its random generator, and without what all rows share."""
    largest = max(memory_of(env_id, varied) for env_id in IDS)
    assert 0.95 * BYTES_PER_ROW[varied] < largest <= BYTES_PER_ROW[varied]
    page = (Path(__file__).parents[2] / "docs" / "performance.md").read_text()
    assert f"{BYTES_PER_ROW[False]} bytes" in page
    assert f"{BYTES_PER_ROW[True]} where" in page


def memory_of(env_id, varied):
    many = 64 * 100
    fleet = registered_fleet(gym.spec(env_id), many, {"friction": np.ones(many)} if varied else {})
    sizes = {}
    for dtype in ("float64", "float32"):
        one = fleet.configuration
        entries = len(one.observation_entries)
        kind = Kind(one.task, one.model, entries, max(ROW_COST), varied, dtype)
        sizes[dtype] = Rows(kind, fleet, many, 400).numbers.nbytes // many
    assert sizes["float32"] == sizes["float64"] // 2
    return sizes["float64"]
