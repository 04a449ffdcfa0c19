"""Single precision: the same laws, close to double precision for as long as an episode lasts."""

import gymnasium as gym
import numpy as np
import pytest
from combinations import only_all
from vector_cases import COMBINATIONS, FEW, MODES, STAB, actions_for, drive, make_many, record

OBSERVATION_TOLERANCE = 1e-3
"""In units of the observation's scales; measured 2e-5 to 2.3e-4 over 100 steps of cars that run away by themselves."""
REWARD_TOLERANCE = 2e-3
"""Of the reward's own size or of 1; measured 8e-7 (default) and 3e-4 (quadratic)."""


def until_the_end(combination, seed, steps=100):
    """Drive both precisions until each row has ended; ``(differences of running rows, end codes, step of the end)``."""
    pair = [make_many(combination, 1000, dtype=dtype, autoreset_mode="Disabled") for dtype in ("float64", "float32")]
    results = [env.reset(seed=seed)[0] for env in pair]
    ended = np.zeros((2, combination.num_envs), int)
    observation_error = reward_error = 0.0
    assert np.abs(results[0] - results[1]).max() < 1e-5
    for step, action in enumerate(0.3 * actions_for(pair[0], steps, seed), start=1):
        (double, reward, *over), (single, single_reward, *single_over) = [env.step(action)[:4] for env in pair]
        for row_ended, terminated in zip(ended, (over[0], single_over[0]), strict=True):
            row_ended[(row_ended == 0) & terminated] = step
        assert pair[1].observation_space.contains(single)
        assert single_reward.dtype == np.float64
        running = ~(over[0] | single_over[0])
        if running.any():
            observation_error = max(observation_error, np.abs(double - single)[running].max())
            difference = np.abs(reward - single_reward) / np.maximum(1.0, np.abs(reward))
            reward_error = max(reward_error, difference[running].max())
    codes = [env.step(action)[4]["end"] for env in pair]
    return observation_error, reward_error, codes, ended


@pytest.mark.parametrize(
    "combination", [COMBINATIONS[4], only_all(COMBINATIONS[5])], ids=lambda c: "-".join(map(str, c))
)
def test_an_episode_is_close_to_double_precision(combination):
    same, count = 0, 0
    for seed in range(0, 8 if combination.num_envs == FEW else 1):
        observation_error, reward_error, codes, ended = until_the_end(combination, 1000 * seed)
        assert 1e-8 < observation_error < OBSERVATION_TOLERANCE
        assert reward_error < REWARD_TOLERANCE
        assert set(codes[0]) - {0}, "no car ended"
        same += np.count_nonzero((codes[0] == codes[1]) & (ended[0] == ended[1]))
        count += combination.num_envs
        assert np.abs(ended[0] - ended[1]).max() <= 1
    assert same >= 0.99 * count


@pytest.mark.parametrize("mode", MODES)
def test_rows_of_single_precision_do_not_depend_on_their_neighbours_either(mode):
    """For one block and for many, for any order."""
    given = {"dtype": "float32", "autoreset_mode": mode, "max_episode_steps": 40}
    env, other = gym.make_vec(STAB, 8, **given), gym.make_vec(STAB, 16, **given)
    actions, order = actions_for(other, 60), np.random.default_rng(0).permutation(16)
    runs = []
    for each, rows in ((other, np.arange(16)), (other, order), (env, order[:8])):
        first = each.reset(seed=rows.tolist())[0]
        steps = [each.step(actions[k][rows])[:4] for k in range(len(actions))]
        runs.append(
            {
                row: first[k].tobytes() + b"".join(part[k].tobytes() for step in steps for part in step)
                for k, row in enumerate(rows)
            }
        )
    assert runs[0] == runs[1]
    assert runs[2] == {row: runs[0][row] for row in order[:8]}


@pytest.mark.parametrize("telemetry", [False, only_all(True)])
def test_mirrored_rows_are_exact_in_single_precision(telemetry):
    state = {"lateral_position": 0.3, "heading": -0.1, "lateral_velocity": 2.0, "yaw_rate": 0.4, "front_steer": 0.03}
    signs = np.array([1.0, -1.0] * 4)
    env = gym.make_vec(STAB, 8, dtype="float32", autoreset_mode="Disabled", telemetry=telemetry)
    observation, _ = env.reset(seed=0, options={"state": {name: value * signs for name, value in state.items()}})
    for action in actions_for(env, 60):
        assert np.array_equal(observation[1], -observation[0])
        assert np.array_equal(observation[::2], observation[[0]].repeat(4, axis=0))
        observation, reward, _, _, info = env.step(action[[0]] * signs[:, None].astype(np.float32))
        assert (reward == reward[0]).all()
        if telemetry:
            assert (np.abs(info["front_lateral_force"]) == abs(info["front_lateral_force"][0])).all()


def test_single_precision_is_repeatable_and_continues_from_copies():
    env, twin = (gym.make_vec(STAB, 6, dtype="float32") for _ in range(2))
    actions = actions_for(env, 60)
    for each in (env, twin):
        each.reset(seed=1)
    assert drive(env, actions[:30]) == drive(twin, actions[:30])
    twin.reset()
    twin.restore(env.snapshot())
    assert drive(env, actions[30:]) == drive(twin, actions[30:])
    assert record(env.state) == record(twin.state)
    assert all(values.dtype == np.float64 for values in env.state)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_an_observation_is_clipped_on_both_sides(side):
    env = gym.make_vec(STAB, 8, dtype="float32", autoreset_mode="Disabled")
    observation, _ = env.reset(seed=0, options={"state": {"lateral_position": side * 50.0, "yaw_rate": side * 9.0}})
    assert observation[:, 0].tolist() == [side * 10.0] * 8
    assert observation[:, 3].tolist() == [side * 10.0] * 8
