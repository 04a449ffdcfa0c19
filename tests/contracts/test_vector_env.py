"""Row i of the vector environment is the single environment that was seeded with seed + i, to the bit."""

import itertools

import gymnasium as gym
import numpy as np
import pytest
from combinations import ON_ROADS, only_all
from vector_cases import (
    ACTIVE,
    COMBINATIONS,
    LANE_CHANGE,
    PAIRWISE,
    STAB,
    TIME_LIMIT,
    Alone,
    Combination,
    actions_for,
    drive,
    make_alone,
    make_many,
    record,
    row_of,
    some_rows,
)

from bicycle_env.envs.many.blocks import ROW_COST, best_length

VARIANTS = [
    ("both", False, "NextStep"),
    ("front", True, "SameStep"),
    ("rear", False, "SameStep"),
    ("both", True, "NextStep"),
]
TWO_OF_THEM = [
    row if half == k.bit_count() % 2 else only_all(*row)
    for k, combination in enumerate(COMBINATIONS)
    for half, row in enumerate(((combination, VARIANTS[:2]), (combination, VARIANTS[2:])))
]
"""`make test` drives each combination in two of the variants, each value of a column in all four."""
every = pytest.mark.parametrize("combination", COMBINATIONS, ids=lambda c: "-".join(map(str, c)))


def modes_of(variants):
    return tuple(mode for *_, mode in variants)


def test_the_combinations_hold_every_pair_of_values():
    for one, other in itertools.combinations(range(len(Combination._fields)), 2):
        pairs = {(row[one], row[other]) for row in COMBINATIONS[:PAIRWISE]}
        assert pairs == set(itertools.product({pair[0] for pair in pairs}, {pair[1] for pair in pairs}))
    chosen = [row for row in TWO_OF_THEM if not hasattr(row, "marks") and row[0] in COMBINATIONS[:PAIRWISE]]
    for column in range(len(Combination._fields)):
        pairs = {(row[column], modes_of(variants)) for row, variants in chosen}
        assert len(pairs) == 2 * len({row[column] for row in COMBINATIONS[:PAIRWISE]})


# The single environment


@pytest.mark.parametrize(
    ("combination", "variants"),
    TWO_OF_THEM,
    ids=lambda rows: "-".join(map(str, rows if isinstance(rows, Combination) else modes_of(rows))),
)
def test_each_row_is_the_single_environment(combination, variants):
    ends = set()
    for steer, telemetry, mode in variants:
        ends |= compare_with_alone(combination, mode, steer=steer, telemetry=telemetry)
    assert {"", "time-out"} <= ends, "none timed out"
    assert len(ends) > 2 or combination.id not in ON_ROADS, "no car ended by itself"


def compare_with_alone(combination, mode, steps=100, **keywords):
    """Drive both; the ends that came up."""
    env = make_many(combination, autoreset_mode=mode, **keywords)
    alone = {row: make_alone(combination, row, mode, **keywords) for row in some_rows(combination.num_envs)}
    observation, info = env.reset(seed=17)
    ends = set()
    for row, car in alone.items():
        assert row_of(env, row, observation, info) == car.reset(seed=17 + row), f"row {row}"
    for k, action in enumerate(actions_for(env, steps)):
        observation, reward, terminated, truncated, info = env.step(action)
        for row, car in alone.items():
            seen = row_of(env, row, observation, info, reward, terminated, truncated)
            expected = car.step(action[row])
            assert seen == expected, f"row {row}, step {k}, {mode}"
            last = expected.final or expected
            ends |= {last.info["end"], "time-out" if last.truncated else ""}
    for row, car in alone.items():
        assert tuple(column[row] for column in env.state) == car.env.unwrapped.state
        assert env.is_success[row] == car.env.unwrapped.is_success
        assert {name: values[row] for name, values in env.measure().items()} == car.env.unwrapped.measure()
    return ends


@pytest.mark.parametrize(
    "own",
    [
        {"speed": np.linspace(30.0, 50.0, 5)},
        {"vehicle": ("oversteer", "civic", "me303", "oversteer", "civic"), "speed": 30},
        {"friction": [1, 0.3, 0.5, 1, 2]},
    ],
    ids="-".join,
)
def test_a_keyword_per_row_is_that_keyword_alone(own):
    keywords = {"tire": "tanh", "max_episode_steps": 40}
    env = gym.make_vec(LANE_CHANGE, 5, **own, **keywords)
    observation, info = env.reset(seed=2)
    alone = []
    for row in range(5):
        mine = {name: value[row] if np.ndim(value) else value for name, value in own.items()}
        alone.append(Alone(gym.make(LANE_CHANGE, **mine, **keywords), "NextStep"))
        assert row_of(env, row, observation, info) == alone[row].reset(seed=2 + row)
    for action in actions_for(env, 60):
        observation, reward, terminated, truncated, info = env.step(action)
        for row, car in enumerate(alone):
            assert row_of(env, row, observation, info, reward, terminated, truncated) == car.step(action[row])


# Any number of rows and threads, any order

SIZES = (1, 3, 8, 9, 64, 127, 128, 200)
MOST = 1100
"""Rows of the reference, enough for two threads."""


def run_of(env, number, seeds, actions):
    """Row by row, all that came back, a reset first."""
    results = [env.reset(seed=seeds), *(env.step(action) for action in actions)]
    parts = [part for *arrays, info in results for part in (*arrays, info["end"], info["cost"])]
    return [b"".join(part[row].tobytes() for part in parts) for row in range(number)]


@pytest.fixture(scope="module")
def reference():
    """``(actions, rows)``: what each of MOST rows gave."""
    env = gym.make_vec(STAB, MOST, max_episode_steps=TIME_LIMIT)
    actions = actions_for(env, 80, seed=1)
    rows = run_of(env, MOST, 7, actions)
    assert len(set(rows)) == MOST
    return actions, rows


def test_the_number_of_rows_changes_no_row(reference):
    actions, rows = reference
    assert {best_length(number) for number in (*SIZES, MOST)} == set(ROW_COST)
    for number in SIZES:
        env = gym.make_vec(STAB, number, max_episode_steps=TIME_LIMIT)
        assert run_of(env, number, 7, actions[:, :number]) == rows[:number], number


@pytest.mark.parametrize("threads", [2, 3, 1024])
def test_threads_change_no_row(reference, threads):
    actions, rows = reference
    for number in (3, MOST):
        env = gym.make_vec(STAB, number, max_episode_steps=TIME_LIMIT, threads=threads)
        assert run_of(env, number, 7, actions[:, :number]) == rows[:number]
        env.close()


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
def test_threads_change_no_row_in_other_modes(mode):
    given = {"num_envs": MOST, "max_episode_steps": TIME_LIMIT, "autoreset_mode": mode, "telemetry": True}
    env, twin = (gym.make_vec(STAB, **given, threads=threads) for threads in (1, 2))
    actions = actions_for(env, 70, seed=2)
    assert record(env.reset(seed=1)) == record(twin.reset(seed=1))
    assert drive(env, actions) == drive(twin, actions)
    twin.close()


def test_the_order_of_the_rows_changes_no_row(reference):
    """A row knows nothing of its neighbours: the same cars elsewhere, beside others."""
    actions, rows = reference
    order = np.random.default_rng(3).permutation(200)
    env = gym.make_vec(STAB, 200, max_episode_steps=TIME_LIMIT)
    assert run_of(env, 200, (7 + order).tolist(), actions[:, order]) == [rows[row] for row in order]
    some = order[:8]
    env = gym.make_vec(STAB, 8, max_episode_steps=TIME_LIMIT)
    assert run_of(env, 8, (7 + some).tolist(), actions[:, some]) == [rows[row] for row in some]


# Mirror image

WIDTHS = {
    "lateral_position": 0.8,
    "heading": 0.15,
    "lateral_velocity": 3.0,
    "yaw_rate": 0.6,
    "front_steer": 0.1,
    "rear_steer": 0.05,
    "front_steer_command": 0.1,
    "rear_steer_command": 0.05,
}


def mirrored_options(task):
    """Of a start to the left and of one to the right."""
    drawn = {name: 0.5 * (low + high) for name, (low, high) in task.options.items() if name != "direction"}
    if "change_start" in drawn:
        drawn["change_start"] = 0.3
    return [{"direction": side, **drawn} if "direction" in task.options else {} for side in ("left", "right")]


@every
def test_the_mirror_image_is_exact(combination):
    """Mirrored starts and actions give mirrored rows, until each ends."""
    left, right = (make_many(combination, autoreset_mode="Disabled", telemetry=True) for _ in range(2))
    rng, number = np.random.default_rng(6), combination.num_envs
    state = {name: rng.uniform(-width, width, number) for name, width in WIDTHS.items()}
    sides = mirrored_options(left.task)
    observation, info = left.reset(options={"state": state, **sides[0]})
    image = {name: -values for name, values in state.items()}
    reflection, image_info = right.reset(options={"state": image, **sides[1]})
    even = ("end", "cost", "clearance", "front_saturation", "rear_saturation", "is_success")
    for actions in actions_for(left, 100, seed=4):
        assert np.array_equal(reflection, left.observation_mirror * observation)
        for name in info:
            sign = 1 if name in even or name.startswith("_") else -1
            assert np.array_equal(image_info[name], info[name] if sign == 1 else -info[name]), name
        observation, reward, terminated, truncated, info = left.step(actions)
        reflection, image_reward, image_terminated, image_truncated, image_info = right.step(-actions)
        assert np.array_equal(image_reward, reward)
        assert np.array_equal(image_terminated, terminated)
        assert np.array_equal(image_truncated, truncated)
    assert terminated.any() or combination.id == ACTIVE  # whose driver has not done his worst yet


@pytest.mark.parametrize("combination", [row for row in COMBINATIONS if not row.varied], ids=lambda c: c.tire)
def test_the_configuration_is_the_single_environments(combination):
    env, alone = make_many(combination), make_alone(combination, 0).env.unwrapped
    assert (env.vehicle, env.speed, env.friction) == (alone.vehicle, alone.speed, alone.friction)
    assert np.array_equal(env.stability.eigenvalues, alone.stability.eigenvalues)
    assert np.array_equal(env.linear_model().A, alone.linear_model().A)
    assert env.observation_names == alone.observation_names
    assert np.array_equal(env.observation_scale, alone.observation_scale)
