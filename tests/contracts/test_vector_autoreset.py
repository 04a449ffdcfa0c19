"""When rows end and how they begin again: the three autoreset modes, reset masks, time limits, staggered starts."""

import gymnasium as gym
import numpy as np
import pytest
from combinations import ON_ROADS, only_all
from gymnasium.vector import AutoresetMode
from vector_cases import (
    DOUBLE_LANE_CHANGE,
    EVADE,
    IDS,
    LANE_CHANGE,
    MODES,
    STAB,
    Alone,
    actions_for,
    compiled,
    drive,
    record,
    row_of,
)

from bicycle_env.registration import ENVIRONMENTS

NUMBER = 6
TURNED = np.array([0.0, 1.0, 0.0, -1.0, 0.0, 0.0])
SPINNING = {"state": {"heading": 1.15 * TURNED, "yaw_rate": 1.9 * TURNED}}
"""Rows 1 and 3 spin in the second step; the others run straight."""


def make(env_id=STAB, num_envs=NUMBER, **keywords):
    return gym.make_vec(env_id, num_envs=num_envs, **{**compiled(env_id, num_envs), **keywords})


def still(env):
    return np.zeros(env.action_space.shape, np.float32)


def until_ended(env, rows, most=100):
    """Step with straight wheels until the rows have ended; what came back last, and the number of steps."""
    over = np.zeros(env.num_envs, bool)
    for count in range(1, most):
        results = env.step(still(env))
        over |= results[2] | results[3]
        if over[rows].all():
            return results, count
    raise AssertionError("the rows did not end")


# Modes


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("env_id", IDS)
def test_the_mode_is_a_word_or_the_enum(env_id, mode):
    for given in (mode, mode.value):
        env = make(env_id, autoreset_mode=given)
        assert env.autoreset_mode is mode
        assert env.metadata["autoreset_mode"] is mode
    assert make(env_id).metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert type(env).metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_it_answers_as_sync_vector_env_does(env_id, mode):
    """Also what belongs to no row: which keys there are, and what stands where a row has nothing to say."""
    env = make(env_id, autoreset_mode=mode, max_episode_steps=40)
    sync = gym.make_vec(env_id, NUMBER, "sync", {"autoreset_mode": mode}, max_episode_steps=40, **compiled(env_id))
    assert env.single_observation_space == sync.single_observation_space
    assert (env.observation_space, env.action_space) == (sync.observation_space, sync.action_space)
    results, expected = env.reset(seed=5), sync.reset(seed=5)
    ended = 0
    for actions in (*actions_for(env, 120), None):
        assert_alike(env, results, expected)
        ended += int(np.sum(expected[2] | expected[3])) if len(expected) == 5 else 0
        if actions is not None:
            results, expected = env.step(actions), sync.step(actions)
    assert ended > NUMBER


def assert_alike(env, results, expected):
    for mine, theirs in zip(results[:-1], expected[:-1], strict=True):
        assert mine.dtype == theirs.dtype
        assert np.array_equal(mine, theirs)
    assert set(results[-1]) == set(expected[-1])
    for row in range(NUMBER):
        assert row_of(env, row, *_reordered(results)) == row_of(env, row, *_reordered(_in_codes(env, expected)))


def _reordered(results):
    observation, *rest, info = results
    return observation, info, *rest


def _in_codes(env, results):
    """SyncVectorEnv's words as codes."""
    codes = {word: code for code, word in enumerate(env.end_names)}

    def translated(info):
        return {**info, "end": np.array([codes[word] if word is not None else 0 for word in info["end"]], np.int8)}

    info = translated(results[-1])
    if "final_info" in info:
        info["final_info"] = translated(info["final_info"])
    return *results[:-1], info


@pytest.mark.parametrize("env_id", ON_ROADS)
def test_same_step_tells_a_success(env_id):
    """Not the row beside its goal, or before it; the last observation of each is where it was."""
    env = make(env_id, autoreset_mode="SameStep", max_episode_steps=60)
    state = {"lateral_position": np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])}
    if env_id == LANE_CHANGE:  # at the goal, long after the change
        state = {name: values + 3.5 for name, values in state.items()} | {"longitudinal_position": 900.0}
    elif env_id == DOUBLE_LANE_CHANGE:
        state = {"lateral_position": np.zeros(NUMBER), "longitudinal_position": 900.0 * (np.arange(NUMBER) != 1)}
    elif env_id == EVADE:  # behind all gates; the other row is not wholly in its lane
        state |= {"longitudinal_position": 900.0}
    options = {"state": state} | ({"direction": "left"} if env_id == LANE_CHANGE else {})
    env.reset(seed=0, options=options)
    (_, _, terminated, truncated, info), count = until_ended(env, [0])
    assert count == 60
    assert truncated.all()
    assert not terminated.any()
    assert info["final_info"]["is_success"].tolist() == [True, False, True, True, True, True]
    assert np.array_equal(
        info["final_obs"][:, 0], (state["lateral_position"] / env.observation_scale[..., 0]).astype("f4")
    )
    assert not env.is_success.any()
    assert not info["is_success"].any()


@pytest.mark.parametrize("env_id", IDS)
def test_next_step_starts_anew_in_the_next_step_and_ignores_the_action(env_id):
    env, twin = make(env_id, steer="both"), make(env_id, steer="both")
    for each in (env, twin):
        each.reset(seed=3, options=SPINNING)
        until_ended(each, [1])
    actions = np.full(env.action_space.shape, 0.1, np.float32)
    expected = twin.step(actions)
    wild = actions.copy()
    wild[1], wild[3, -1] = np.nan, np.inf
    results = env.step(wild)
    assert record(results) == record(expected)
    observation, reward, terminated, truncated, info = results
    assert (reward[1], terminated[1], truncated[1], info["end"][1]) == (0.0, False, False, 0)
    assert reward[0] > 0.0
    assert observation[1].tobytes() == Alone.first(env_id, seeds=4, resets=2).tobytes()
    assert env.state.time[[0, 1]].tolist() == [twin.state.time[0], 0.0]


# Disabled


def held(env_id, **keywords):
    """An environment whose rows 1 and 3 have ended and were stepped twice since; what the last step gave."""
    env = make(env_id, autoreset_mode="Disabled", **keywords)
    env.reset(seed=3, options=SPINNING)
    ended, _ = until_ended(env, [1, 3])
    state = env.state
    env.step(actions_for(env, 1)[0])
    return env, ended, state, env.step(actions_for(env, 1)[0])


@pytest.mark.parametrize("env_id", IDS)
def test_a_row_that_has_ended_stays_where_it_is(env_id):
    env, ended, state, (observation, reward, terminated, truncated, info) = held(env_id)
    stays, runs = [1, 3], [0, 2, 4, 5]
    assert terminated[stays].all()
    assert not truncated.any()
    assert not terminated[runs].any()
    assert (reward[stays] == 0.0).all()
    assert (reward[runs] > 0.0).all()
    assert info["end"].tolist() == [0, 1, 0, 1, 0, 0]
    for before, now in zip(state, env.state, strict=True):
        assert np.array_equal(before[stays], now[stays])
    assert (env.state.time[runs] > state.time[runs]).all()
    assert np.array_equal(observation[stays], ended[0][stays])
    assert np.array_equal(info["cost"][stays], ended[4]["cost"][stays])
    assert not np.array_equal(observation[runs], ended[0][runs])


@pytest.mark.parametrize("env_id", IDS)
def test_a_mask_resets_its_rows_and_no_other(env_id):
    env, _, _, (observation, _, _, _, info) = held(env_id)
    generators = [generator.bit_generator.state for generator in env.np_random]
    state = env.state
    mask = np.array([True, True, False, False, False, False])
    options = {"reset_mask": mask}
    fresh, fresh_info = env.reset(options=options)
    assert options == {"reset_mask": mask}, "the mask was taken out of the caller's options"
    assert mask.tolist() == [True, True, False, False, False, False]
    for row, is_new in enumerate(mask):
        same_generator = env.np_random[row].bit_generator.state == generators[row]
        assert same_generator != is_new
        assert np.array_equal(fresh[row], observation[row]) != is_new
        assert (env.state.time[row] == 0.0) == is_new
    for before, now in zip(state, env.state, strict=True):
        assert np.array_equal(before[~mask], now[~mask])
    for row in (0, 1):  # the second start of that row's generator
        assert fresh[row].tobytes() == Alone.first(env_id, seeds=3 + row, resets=2).tobytes()
    assert fresh_info["end"].tolist() == [0, 0, 0, 1, 0, 0]
    assert np.array_equal(fresh_info["cost"][2:], info["cost"][2:])
    _, reward, terminated, _, info = env.step(still(env))
    assert (reward > 0.0).tolist() == [True, True, True, False, True, True]
    assert terminated.tolist() == [False, False, False, True, False, False]
    assert info["end"].tolist() == [0, 0, 0, 1, 0, 0]


def test_a_mask_with_state_and_seed_is_for_its_rows_only():
    env = make(autoreset_mode="Disabled")
    env.reset(seed=3)
    env.step(still(env))
    before, mask = env.state, np.array([False, False, True, False, False, True])
    env.reset(seed=50, options={"reset_mask": mask, "state": {"yaw_rate": np.linspace(0.0, 0.5, NUMBER)}})
    assert env.state.yaw_rate[mask].tolist() == [0.2, 0.5]
    assert (env.state.lateral_position[mask] == 0.0).all()
    for name in env.state._fields:
        assert np.array_equal(getattr(env.state, name)[~mask], getattr(before, name)[~mask])
    continued = env.reset()[0]
    for row in range(NUMBER):
        expected = Alone.first(STAB, seeds=(50 if mask[row] else 3) + row, resets=2)
        assert continued[row].tobytes() == expected.tobytes(), row


@pytest.mark.parametrize("mode", MODES)
def test_a_mask_in_every_mode_and_all_true_is_a_reset(mode):
    env, twin = make(autoreset_mode=mode), make(autoreset_mode=mode)
    actions = actions_for(env, 60)
    env.reset(seed=1)
    twin.reset(seed=1)
    assert drive(env, actions) == drive(twin, actions)
    assert record(env.reset(options={"reset_mask": np.ones(NUMBER, bool)})) == record(twin.reset())
    assert drive(env, actions) == drive(twin, actions)


# Time limits


@pytest.mark.parametrize("row", ENVIRONMENTS, ids=lambda row: row.id)
def test_the_time_limit_is_the_registered_one(row):
    env = make(row.id)
    assert env.max_episode_steps == row.max_episode_steps
    assert make(row.id, max_episode_steps=17).max_episode_steps == 17


@pytest.mark.parametrize("dtype", ["float64", only_all("float32")])
def test_minus_one_is_no_limit(dtype):
    env = make(max_episode_steps=-1, dtype=dtype)
    env.reset(seed=0, options={"state": {}})
    for _ in range(1000):
        _, _, terminated, truncated, _ = env.step(still(env))
        assert not (terminated | truncated).any()
    assert env.max_episode_steps is None


@pytest.mark.parametrize("mode", MODES)
def test_termination_and_time_out_in_one_step_are_both_said(mode):
    env = make(autoreset_mode=mode)
    env.reset(seed=3, options=SPINNING)
    _, count = until_ended(env, [1])
    for limit, expected in ((count, [True, True]), (count + 1, [True, False])):
        alone = gym.make(STAB, max_episode_steps=limit)
        alone.reset(seed=4, options={"state": {"heading": 1.15, "yaw_rate": 1.9}})
        env = make(autoreset_mode=mode, max_episode_steps=limit)
        env.reset(seed=3, options=SPINNING)
        for _ in range(count):
            _, _, terminated, truncated, info = env.step(still(env))
            flags = alone.step(still(env)[0])[2:4]
        assert [terminated[1], truncated[1]] == list(flags) == expected
        last = info["final_info"] if mode == "SameStep" else info
        assert env.end_names[last["end"][1]] == "spun"
        if mode == "Disabled":  # and as long as the row stays
            _, _, terminated, truncated, _ = env.step(still(env))
            assert [terminated[1], truncated[1]] == expected


def test_staggered_starts_spread_the_time_outs():
    env = make(num_envs=10, max_episode_steps=50, staggered_start=True, autoreset_mode="SameStep")
    for _ in range(2):  # with every reset of all rows
        env.reset(seed=0, options={"state": {}})
        assert np.allclose(env.state.time, np.arange(10) * 5 * 0.02)
        ends = {}
        for step in range(1, 51):
            truncated = env.step(still(env))[3]
            ends |= {int(row): step for row in np.flatnonzero(truncated)}
        assert ends == {row: 50 - 5 * row for row in range(10)}
    # A reset of some rows is for good: they begin at the beginning.
    env.reset(seed=0)
    env.reset(options={"reset_mask": np.arange(10) == 7})
    assert env.state.time[[6, 7, 8]] == pytest.approx([0.6, 0.0, 0.8])


def test_staggered_starts_are_nothing_without_a_limit_and_change_no_start():
    for limit in (-1, 400):
        env, plain = (make(max_episode_steps=limit, staggered_start=given) for given in (True, False))
        assert env.reset(seed=0)[0].tobytes() == plain.reset(seed=0)[0].tobytes()
        assert (env.state.time > 0.0).any() == (limit == 400)


# Made by Gymnasium


@pytest.mark.parametrize("env_id", IDS)
def test_the_spec_makes_the_environment_again(env_id):
    given = {"tire": "fiala", "friction": 0.9, "autoreset_mode": "SameStep"}
    if env_id == LANE_CHANGE:
        given |= {**compiled(env_id), "friction": [0.9] * NUMBER}
    env = gym.make_vec(f"bicycle_env:{env_id}", NUMBER, **given)
    again = gym.make_vec(env.spec)
    assert (again.num_envs, again.tire, again.autoreset_mode) == (NUMBER, env.tire, AutoresetMode.SAME_STEP)
    assert np.all(again.friction == np.array(given["friction"]))
    assert again.reset(seed=0)[0].tobytes() == env.reset(seed=0)[0].tobytes()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_episode_statistics_of_gymnasium(mode):
    """Gymnasium's own wrapper counts the same episodes as beside SyncVectorEnv."""
    statistics = []
    for env in (make(autoreset_mode=mode), gym.make_vec(STAB, NUMBER, "sync", {"autoreset_mode": mode})):
        wrapped, seen = gym.wrappers.vector.RecordEpisodeStatistics(env), []
        wrapped.reset(seed=2)
        for actions in actions_for(env, 150):
            info = wrapped.step(actions)[4]
            if "episode" in info:
                seen += [(row, info["episode"]["r"][row], info["episode"]["l"][row]) for row in range(NUMBER)]
        statistics.append(seen)
    assert statistics[0] == statistics[1] != []
