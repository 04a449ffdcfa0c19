"""Actions of many cars: their types, the ones that are refused, and rows that end for an action that is not finite."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all
from gymnasium.vector import AutoresetMode
from vector_cases import COMBINATIONS, IDS, MODES, STAB, actions_for, compiled, drive, everything, make_many, record

from bicycle_env.envs import TorchVectorEnv
from bicycle_env.tasks.ends import INVALID_ACTION

BIG = 1100
"""Rows enough for two threads."""


def make(env_id=STAB, num_envs=6, **keywords):
    return gym.make_vec(env_id, num_envs=num_envs, max_episode_steps=40, **compiled(env_id, num_envs), **keywords)


def twins(env_id=STAB, steps=10, **keywords):
    """Two environments in the same place, and the actions that follow."""
    pair = [make(env_id, **keywords) for _ in range(2)]
    actions = actions_for(pair[0], steps + 40, seed=5)
    for env in pair:
        env.reset(seed=14)
        drive(env, actions[:steps])
    return (*pair, actions[steps:])


# Types

GOOD = np.array([[0.25, -0.5], [1, 0], [0, 0], [-1, 1], [0.5, 0.75], [0, 0.125]])
STRIDED = np.zeros((12, 4))
STRIDED[::2, ::2] = GOOD
MANY_TYPES = {
    "float32": GOOD.astype(np.float32),
    "float64": GOOD,
    "float16": GOOD.astype(np.float16),
    "long double": GOOD.astype(np.longdouble),
    "other byte order": GOOD.astype(">f4"),
    "lists": GOOD.tolist(),
    "rows": [np.array(row) for row in GOOD],
    "strided": STRIDED[::2, ::2],
    "columns first": np.asfortranarray(GOOD, dtype=np.float32),
    "not aligned": np.frombuffer(b" " + GOOD.astype(np.float32).tobytes(), np.float32, offset=1).reshape(6, 2),
    "a subclass": GOOD.astype(np.float32).view(np.ma.MaskedArray),
    "a tensor": torch.tensor(GOOD),
}


@pytest.mark.parametrize("actions", MANY_TYPES.values(), ids=MANY_TYPES)
def test_one_action_in_many_types(actions):
    env, twin, _ = twins()
    assert record(env.step(actions)) == record(twin.step(GOOD.astype(np.float32)))


def test_actions_that_may_not_be_written_are_taken():
    """jax and broadcasting give such arrays."""
    env, twin, _ = twins()
    actions = np.broadcast_to(np.float32(0.3), (6, 2))
    frozen = np.full((6, 2), 0.3, np.float32)
    frozen.flags.writeable = False
    assert record(env.step(actions)) == record(twin.step(frozen))


@pytest.mark.parametrize("env_id", IDS)
def test_finite_actions_beyond_the_box_saturate(env_id):
    env, twin, actions = twins(env_id)
    for action in actions:
        wide = (np.sign(action) * np.float32(1.0)) * np.float32(1e30)
        assert record(env.step(wide)) == record(twin.step(np.sign(action)))
        assert record(env.step(wide.astype(np.float64) * 1e200)) == record(twin.step(np.sign(action)))


# Refused


def with_value(value, row=2, axle=-1, dtype=np.float32):
    actions = np.zeros((6, 2), dtype)
    actions[row, axle] = value
    return actions


BAD = {
    "nan": (with_value(np.nan), ValueError, "row 2 has"),
    "nan in the first place": (with_value(np.nan, row=5, axle=0), ValueError, "row 5 has"),
    "float64 nan": (with_value(np.nan, dtype=float), ValueError, "row 2 has"),
    "inf": (with_value(np.inf, row=0), ValueError, "row 0 has"),
    "-inf": (with_value(-np.inf, axle=0, dtype=float), ValueError, "row 2 has"),
    "list with nan": (with_value(np.nan).tolist(), ValueError, "row 2 has"),
    "two rows": (with_value(np.nan) + with_value(np.inf, row=4), ValueError, "row 2 has"),
    "one row less": (np.zeros((5, 2), np.float32), ValueError, r"shape \(6, 2\) .* got shape \(5, 2\)"),
    "one axle": (np.zeros((6, 1), np.float32), ValueError, r"steer='both'"),
    "flat": (np.zeros(12, np.float32), ValueError, "shape"),
    "transposed": (np.zeros((2, 6), np.float32), ValueError, "shape"),
    "one row": (np.zeros(2, np.float32), ValueError, "shape"),
    "scalar": (0.1, ValueError, "shape"),
    "three-dimensional": (np.zeros((6, 2, 1)), ValueError, "shape"),
    "empty": ([], ValueError, "shape"),
    "ragged": ([[0.1]] * 5 + [[0.1, 0.2]], TypeError, "real numbers"),
    "bool": (np.ones((6, 2), bool), TypeError, "real numbers"),
    "complex": (np.zeros((6, 2), complex), TypeError, "real numbers"),
    "object": (np.zeros((6, 2), object), TypeError, "real numbers"),
    "words": ([["0.1"] * 2] * 6, TypeError, "real numbers"),
    "None": (None, TypeError, "real numbers"),
    "a gradient": (torch.zeros(6, 2, requires_grad=True), TypeError, "real numbers.*without gradients"),
}


@pytest.mark.parametrize(("actions", "error", "match"), BAD.values(), ids=BAD)
def test_a_bad_action_raises_and_changes_nothing(actions, error, match):
    env, twin, good = twins()
    before = everything(env)
    with pytest.raises(error, match=match):
        env.step(actions)
    assert everything(env) == before
    assert drive(env, good) == drive(twin, good)


@pytest.mark.parametrize("combination", [only_all(COMBINATIONS[1]), only_all(COMBINATIONS[2])], ids=lambda c: c.tire)
def test_a_bad_action_in_the_last_row_changes_nothing(combination):
    """The first blocks have not been stepped when the last one is seen."""
    env, twin = make_many(combination), make_many(combination)
    for each in (env, twin):
        each.reset(seed=1)
    good = actions_for(env, 70)
    bad = good[0].copy()
    bad[-1, 0] = np.nan
    before = everything(env)
    with pytest.raises(ValueError, match=f"row {env.num_envs - 1} has"):
        env.step(bad)
    assert everything(env) == before
    assert drive(env, good) == drive(twin, good)


@pytest.mark.parametrize("row", [0, BIG - 1])
def test_a_bad_action_among_threads_changes_nothing(row):
    env, twin, good = twins(num_envs=BIG, threads=2)
    bad = good[0].copy()
    bad[row] = np.nan
    before = everything(env)
    with pytest.raises(ValueError, match=f"row {row} has"):
        env.step(bad)
    assert everything(env) == before
    assert drive(env, good[:5]) == drive(twin, good[:5])
    env.close()
    twin.close()


@pytest.mark.parametrize("env_id", IDS)
def test_a_step_before_the_first_reset_raises(env_id):
    for keywords in ({}, {"on_invalid": "terminate"}):
        with pytest.raises(gym.error.ResetNeeded, match=r"reset\(\)"):
            make(env_id, **keywords).step(np.zeros((6, 2), np.float32))


# on_invalid="terminate"


def other_rows(results, row):
    *arrays, info = results
    assert not any("final" in name for name in info)
    return [np.delete(values, row, axis=0).tobytes() for values in (*arrays, *info.values())]


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("telemetry", [False, True])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_invalid_action_ends_its_row_only(bad, telemetry, threads):
    number, row = (BIG, 700) if threads == 2 else (6, 2)
    keywords = {"num_envs": number, "threads": threads, "telemetry": telemetry, "steps": 5}
    env, twin, actions = twins(on_invalid="terminate", **keywords)
    before, seen = env.state, env.restore(env.snapshot())
    spoiled = actions[0].copy()
    spoiled[row, 1] = bad
    results, expected = env.step(spoiled), twin.step(actions[0])
    assert other_rows(results, row) == other_rows(expected, row)
    observation, reward, terminated, truncated, info = results
    assert (reward[row], terminated[row], truncated[row]) == (0.0, True, False)
    assert env.end_names[info["end"][row]] == "invalid_action"
    assert observation[row].tobytes() == seen[row].tobytes(), "the car did not stay where it was"
    assert [values[row] for values in env.state] == [values[row] for values in before]
    # It begins anew in the next step; its neighbours do not notice.
    results, expected = env.step(actions[1]), twin.step(actions[1])
    assert other_rows(results, row) == other_rows(expected, row)
    assert (results[1][row], results[2][row], results[4]["end"][row]) == (0.0, False, 0)
    assert env.state.time[row] == 0.0
    for action in actions[2:10]:
        assert other_rows(env.step(action), row) == other_rows(twin.step(action), row)
    env.close()
    twin.close()


@pytest.mark.parametrize("mode", MODES)
def test_what_an_invalid_action_does_in_each_mode(mode):
    env, _, actions = twins(on_invalid="terminate", autoreset_mode=mode)
    before = env.state
    spoiled = actions[0].copy()
    spoiled[[1, 4]] = np.nan
    observation, _, terminated, truncated, info = env.step(spoiled)
    assert np.flatnonzero(terminated).tolist() == [1, 4]
    assert not truncated.any()
    last = info["final_info"] if mode == "SameStep" else info
    assert last["end"][[1, 4]].tolist() == [INVALID_ACTION] * 2
    assert env.state.time[1] == (0.0 if mode == "SameStep" else before.time[1])
    if mode == "SameStep":
        assert info["end"].tolist() == [0] * 6
        assert info["final_obs"][1, 0] == np.float32(before.lateral_position[1])
    if mode == "Disabled":
        later, reward, terminated, _, info = env.step(spoiled)  # ended already: nothing to raise or to end
        assert info["end"][[1, 4]].tolist() == [INVALID_ACTION] * 2
        assert (reward[[1, 4]] == 0.0).all()
        assert terminated[[1, 4]].all()
        assert np.array_equal(later[1], observation[1])


@pytest.mark.parametrize("on_invalid", ["raise", "terminate"])
@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_a_waiting_row_may_be_given_anything(mode, on_invalid):
    env, twin, actions = twins(on_invalid=on_invalid, autoreset_mode=mode)
    ended = set()
    for action in actions:
        *_, terminated, truncated, _ = results = env.step(action)
        assert record(results) == record(twin.step(action))
        over = np.flatnonzero(terminated | truncated)
        ended |= set(over)
        wild = actions[0].copy()
        wild[over] = np.nan
        assert record(env.step(wild)) == record(twin.step(actions[0]))
    assert len(ended) > 2


@pytest.mark.parametrize("reward", ["default", "quadratic"])
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_the_torch_environment_says_the_same(mode, reward):
    """TorchVectorEnv documents what an invalid action does; with the quadratic reward it is paid for."""
    keywords = {"reward": reward, "autoreset_mode": mode, "on_invalid": "terminate"}
    if reward == "quadratic":  # compiled for these tests already
        keywords |= {"tire": "tanh", "geometry": "small_angle"}
    number = COMBINATIONS[2].num_envs if reward == "quadratic" else 6
    env, torch_env = gym.make_vec(STAB, number, **keywords), TorchVectorEnv(STAB, number, **keywords)
    env.reset(seed=3)
    torch_env.reset(seed=3)
    torch_env.set_state({name: torch.tensor(values) for name, values in env.state._asdict().items()})
    actions = actions_for(env, 3)
    actions[1, [1, 4], 0] = np.nan
    for action in actions[: 2 if mode is AutoresetMode.NEXT_STEP else 3]:  # torch draws other starts
        observation, gained, terminated, truncated, info = env.step(action)
        expected = torch_env.step(torch.tensor(action))
        np.testing.assert_allclose(observation, expected[0], rtol=0, atol=1e-6)
        np.testing.assert_allclose(gained, expected[1], rtol=1e-11, atol=1e-12)
        assert np.array_equal(terminated, expected[2])
        assert np.array_equal(truncated, expected[3])
        assert np.array_equal(info["end"], expected[4]["end"])
    assert info["end"][[0, 1, 4]].tolist() == [0, INVALID_ACTION, INVALID_ACTION]
    if reward == "quadratic" and mode is AutoresetMode.NEXT_STEP:
        assert gained[1] < -1000.0
