"""Rules that every environment id keeps, with every tire, geometry, steer mode and with or without telemetry."""

import copy
import hashlib
import itertools
import os
import pickle
import subprocess
import sys
import textwrap
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import pytest
import torch
import vector_cases
from gymnasium.utils.env_checker import check_env

import bicycle_env
from bicycle_env import tires
from bicycle_env.registration import ENVIRONMENTS

FREE_ROAD = {"state": {"longitudinal_position": 1e4}}
"""Far beyond whatever stands on the road."""
MAX_STEPS = {row.id: row.max_episode_steps for row in ENVIRONMENTS}


class Combination(NamedTuple):
    id: str
    tire: str
    geometry: str
    steer: str
    telemetry: bool

    @property
    def axles(self):
        return 2 if self.steer == "both" else 1


STEERS = ("front", "rear", "both")
OFTEN = [
    Combination(kind.id, kind.tire, kind.geometry, steer, bool((k + j) % 2))
    for k, kind in enumerate(
        kind for kind in vector_cases.COMBINATIONS[: vector_cases.PAIRWISE] if kind.reward == "default"
    )
    for j, steer in enumerate(STEERS)
]
"""Of `make test`: of all the ways to compile that tests/bits takes pairwise, those with the default reward."""
COMBINATIONS = [
    Combination(*row)
    for row in itertools.product(MAX_STEPS, tires.LAWS, ("small_angle", "exact"), STEERS, (False, True))
]
every = pytest.mark.parametrize(
    "combination",
    [pytest.param(row, marks=() if row in OFTEN else pytest.mark.exhaustive) for row in COMBINATIONS],
    ids=lambda row: "-".join(map(str, row)),
)


def make(combination, **keywords):
    given = combination._asdict()
    return gym.make(given.pop("id"), **given, **keywords)


def actions_for(combination, number, seed=0):
    """A random walk: strong enough to spin the car now and then, so that episodes end too."""
    rng = np.random.default_rng(seed)
    steps = rng.uniform(-0.5, 0.5, (number, combination.axles))
    return list(np.clip(np.cumsum(steps, axis=0), -1.0, 1.0).astype(np.float32))


def record(observation, info, *rest):
    return observation.dtype, observation.tobytes(), tuple(info.items()), *rest


def drive(env, actions):
    """Step through all actions, with a random reset after each end; everything that came back, to the bit."""
    seen = []
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append(record(observation, info, reward, terminated, truncated))
        if terminated or truncated:
            seen.append(record(*env.reset()))
    return seen


# Determinism


@every
def test_the_same_seed_gives_the_same_trajectory_and_another_one_does_not(combination):
    env, twin = make(combination), make(combination)
    actions = actions_for(combination, 150)
    first = [record(*env.reset(seed=7)), *drive(env, actions)]
    assert first == [record(*twin.reset(seed=7)), *drive(twin, actions)]
    assert first == [record(*env.reset(seed=7)), *drive(env, actions)]
    other = [record(*env.reset(seed=8)), *drive(env, actions)]
    assert first[0] != other[0]
    assert not set(first) & set(other)


@every
def test_episodes_of_one_seed_differ_from_each_other(combination):
    env = make(combination)
    starts = [env.reset(seed=3)[0], *(env.reset()[0] for _ in range(5))]
    assert len({start.tobytes() for start in starts}) == 6


@every
@pytest.mark.parametrize("how", ["deepcopy", "pickle"])
def test_a_copy_continues_to_the_bit(combination, how):
    env = make(combination)
    env.reset(seed=11)
    actions = actions_for(combination, 160, seed=1)
    drive(env, actions[:25])
    twin = copy.deepcopy(env) if how == "deepcopy" else pickle.loads(pickle.dumps(env))
    state = twin.unwrapped.state
    mine = [*drive(env, actions[25:]), record(*env.reset())]
    assert twin.unwrapped.state == state, "the copy moved with its original"
    assert mine == [*drive(twin, actions[25:]), record(*twin.reset())]


@every
def test_a_snapshot_continues_to_the_bit(combination):
    env = make(combination).unwrapped
    env.reset(seed=12)
    actions = actions_for(combination, 160, seed=2)
    drive(env, actions[:25])
    snapshot = env.snapshot()
    state, observation = env.state, env.step(actions[0])[0]
    observation = env.restore(snapshot)
    first = [*drive(env, actions[25:]), record(*env.reset())]
    assert env.state != state

    again = env.restore(snapshot)
    assert env.state == state
    assert again.tobytes() == observation.tobytes()
    assert not np.shares_memory(again, observation)
    assert first == [*drive(env, actions[25:]), record(*env.reset())]

    stranger = make(combination).unwrapped
    stranger.reset(seed=99)
    assert stranger.restore(snapshot).tobytes() == observation.tobytes()
    assert first == [*drive(stranger, actions[25:]), record(*stranger.reset())]


def test_restoring_gives_the_observation_of_that_moment():
    for env_id in MAX_STEPS:
        env = gym.make(env_id, steer="both").unwrapped
        env.reset(seed=1)
        for _ in range(10):
            observation = env.step(np.array([0.2, -0.1], np.float32))[0]
        snapshot = env.snapshot()
        env.reset()
        assert env.restore(snapshot).tobytes() == observation.tobytes()


@pytest.mark.parametrize("bad", [None, 3, "state", (np.zeros(3), 0, {})], ids=repr)
def test_restore_takes_snapshots_only(bad):
    env = gym.make("BicycleStab-v0").unwrapped
    env.reset(seed=0)
    with pytest.raises(TypeError, match="snapshot"):
        env.restore(bad)


def test_a_snapshot_of_another_task_is_refused():
    other = gym.make("BicycleLaneChange-v0").unwrapped
    other.reset(seed=0)
    env = gym.make("BicycleStab-v0").unwrapped
    env.reset(seed=0)
    before = env.state
    with pytest.raises((TypeError, ValueError), match="snapshot"):
        env.restore(other.snapshot())
    assert env.state == before


ROLLOUT = textwrap.dedent(
    """
    import hashlib, sys, warnings
    warnings.simplefilter("error")
    import numpy as np
    import gymnasium as gym
    import bicycle_env

    digest = hashlib.sha256()
    for env_id in sorted(row.id for row in bicycle_env.registration.ENVIRONMENTS):
        env = gym.make(env_id, telemetry=True)
        rng = np.random.default_rng(5)
        digest.update(env.reset(seed=21)[0].tobytes())
        for _ in range(300):
            observation, reward, terminated, truncated, info = env.step(rng.uniform(-1.2, 1.2, env.action_space.shape))
            digest.update(observation.tobytes())
            digest.update(repr((reward, terminated, truncated, info, env.unwrapped.state)).encode())
            if terminated or truncated:
                digest.update(env.reset()[0].tobytes())
    """
)


@pytest.mark.exhaustive
def test_another_process_gives_the_same_numbers():
    """Also with another hash seed, and with `python -O`, which drops asserts."""
    here: dict = {}
    exec(compile(ROLLOUT, "rollout", "exec"), here)
    expected = here["digest"].hexdigest()
    assert expected != hashlib.sha256().hexdigest()
    ran = subprocess.run(
        [sys.executable, "-O", "-c", ROLLOUT + "\nsys.stdout.write(digest.hexdigest())"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONHASHSEED": "1"},
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout == expected


# Mirror image

EVEN_STATES = ("longitudinal_position",)
EVEN_INFO = ("end", "cost", "clearance", "front_saturation", "rear_saturation", "is_success")


def random_state(env, rng):
    front, rear = env.front_actuator.angle_limit, env.rear_actuator.angle_limit
    widths = {
        "longitudinal_position": 5.0,
        "lateral_position": 0.8,
        "heading": 0.15,
        "lateral_velocity": 3.0,
        "yaw_rate": 0.6,
        "front_steer": front,
        "rear_steer": rear,
        "front_steer_command": front,
        "rear_steer_command": rear,
    }
    return {name: float(rng.uniform(-width, width)) for name, width in widths.items()}


def mirrored_starts(env, rng):
    state = random_state(env, rng)
    left = {"state": state}
    right = {"state": {name: value if name in EVEN_STATES else -value for name, value in state.items()}}
    options = env.task.options
    fixed = {name: 0.5 * (low + high) for name, (low, high) in options.items() if name != "direction"}
    if "change_start" in fixed:
        fixed["change_start"] = 0.3
    if "direction" in options:
        left |= {"direction": "left", **fixed}
        right |= {"direction": "right", **fixed}
    return left, right


@every
def test_the_mirror_image_is_exact(combination):
    env, image = make(combination).unwrapped, make(combination).unwrapped
    rng = np.random.default_rng(4)
    mirror = env.observation_mirror
    assert mirror.shape == env.observation_space.shape
    assert set(mirror) <= {-1.0, 1.0}
    compared, episodes = 0, 0
    while compared < 150 or episodes < 3:
        episodes += 1
        left, right = mirrored_starts(env, rng)
        observation, info = env.reset(options=left)
        reflection, image_info = image.reset(options=right)
        for action in actions_for(combination, 120, seed=episodes):
            assert np.array_equal(reflection, mirror * observation)
            assert list(info) == list(image_info)
            for name, value in info.items():
                expected = value if name in EVEN_INFO else -value
                assert image_info[name] == expected, name
            observation, reward, terminated, _, info = env.step(action)
            reflection, image_reward, image_terminated, _, image_info = image.step(-action)
            assert reward == image_reward
            assert terminated == image_terminated
            compared += 1
            if terminated:
                assert np.array_equal(reflection, mirror * observation)
                assert info["end"] == image_info["end"] != ""
                assert info["cost"] == image_info["cost"]
                break


@pytest.mark.parametrize("env_id", MAX_STEPS)
def test_the_mirror_image_of_the_quadratic_reward(env_id):
    env, image = (gym.make(env_id, reward="quadratic", steer="both").unwrapped for _ in range(2))
    rng = np.random.default_rng(5)
    for episode in range(4):
        left, right = mirrored_starts(env, rng)
        env.reset(options=left)
        image.reset(options=right)
        for action in actions_for(Combination(env_id, "fiala", "exact", "both", False), 120, seed=episode):
            _, reward, terminated, _, _ = env.step(action)
            assert image.step(-action)[1:3] == (reward, terminated)
            if terminated:
                break


# What comes back


@every
def test_types_and_memory_of_what_comes_back(combination):
    env, twin = make(combination), make(combination)
    observation, info = env.reset(seed=5)
    twin.reset(seed=5)
    kinds = {name: type(value) for name, value in info.items()}
    assert kinds["end"] is str
    assert kinds["cost"] is float
    assert set(kinds.values()) <= {str, float, bool}
    assert ("lateral_acceleration" in kinds) is combination.telemetry
    internals = [value for value in vars(env.unwrapped).values() if isinstance(value, np.ndarray)]
    earlier = []
    for action in actions_for(combination, 120, seed=3):
        assert type(observation) is np.ndarray
        assert observation.dtype == np.float32
        assert env.observation_space.contains(observation)
        assert {name: type(value) for name, value in info.items()} == kinds
        assert list(info) == list(kinds)
        assert not any(np.shares_memory(observation, other) for other in internals)
        assert not any(np.shares_memory(observation, other) for other, _ in earlier[-3:])
        assert not any(info is other for _, other in earlier[-3:])
        earlier.append((observation, info))
        given = action.copy()
        observation, reward, terminated, truncated, info = env.step(action)
        assert np.array_equal(action, given), "the caller's action was changed"
        expected = twin.step(given)
        assert record(observation, info, reward) == record(expected[0], expected[4], expected[1])
        assert type(reward) is float
        assert np.isfinite(reward)
        assert type(terminated) is bool
        assert type(truncated) is bool
        if terminated or truncated:
            assert {name: type(value) for name, value in info.items()} == kinds
            assert env.observation_space.contains(observation)
            observation, info = env.reset()
            twin.reset()
        # A user who overwrites what he was given does not reach the environment.
        action[:] = 0.77
        observation = observation.copy()
        earlier[-1][0][:] = 123.0
        earlier[-1][1].clear()


@every
def test_a_time_out_is_a_truncation_at_the_registered_step(combination):
    env = make(combination)
    env.reset(seed=0, options=FREE_ROAD)
    still = np.zeros(combination.axles, np.float32)
    for _ in range(MAX_STEPS[combination.id] - 1):
        assert env.step(still)[2:4] == (False, False)
    _, _, terminated, truncated, info = env.step(still)
    assert (terminated, truncated) == (False, True)
    assert info["end"] == ""


@pytest.mark.parametrize("env_id", MAX_STEPS)
def test_the_class_itself_knows_no_time_limit(env_id):
    env = gym.make(env_id, steer="both").unwrapped
    env.reset(seed=0, options=FREE_ROAD)
    ends = [env.step(np.zeros(2, np.float32))[2:4] for _ in range(MAX_STEPS[env_id] + 5)]
    assert set(ends) == {(False, False)}


@pytest.mark.parametrize("env_id", MAX_STEPS)
def test_a_step_after_the_end_warns_once_and_moves_nothing(env_id):
    env = gym.make(env_id, steer="both").unwrapped
    env.reset(seed=0, options={"state": {"yaw_rate": 3.0}})
    observation, _, terminated, _, info = env.step(np.zeros(2, np.float32))
    assert terminated
    state = env.state
    with pytest.warns(UserWarning, match="after the episode has ended"):
        again = env.step(np.ones(2, np.float32))
    for _ in range(2):  # no second warning: it would be an error here
        assert env.state == state
        assert np.array_equal(again[0], observation)
        assert again[1:4] == (0.0, True, False)
        assert again[4]["end"] == info["end"]
        again = env.step(np.ones(2, np.float32))


# Actions


@every
def test_finite_actions_outside_the_box_saturate(combination):
    env, twin = make(combination), make(combination)
    rng = np.random.default_rng(6)
    env.reset(seed=9)
    twin.reset(seed=9)
    for k in range(30):
        large = rng.choice([-1e300, -3.0, -1.0, 0.3, 1.0, 1.0000001, 2.0, 1e300], combination.axles)
        if k % 2:
            large = np.clip(large, -3e38, 3e38).astype(np.float32)
        wide, clipped = env.step(large), twin.step(np.clip(large, -1.0, 1.0))
        assert record(wide[0], wide[4], *wide[1:4]) == record(clipped[0], clipped[4], *clipped[1:4])
        if wide[2]:
            env.reset()
            twin.reset()


def bad_actions(axles):
    nan_last = np.zeros(axles, np.float32)
    nan_last[-1] = np.nan
    nan_first = np.zeros(axles, np.float32)
    nan_first[0] = np.nan
    return {
        "nan in the last place": (nan_last, ValueError),
        "nan in the first place": (nan_first, ValueError),
        "float64 nan": (nan_first.astype(np.float64), ValueError),
        "inf": (np.full(axles, np.inf, np.float32), ValueError),
        "-inf": (np.full(axles, -np.inf), ValueError),
        "list with nan": ([float("nan")] * axles, ValueError),
        "scalar": (0.1, ValueError),
        "zero-dimensional": (np.float32(0.1), ValueError),
        "too many": (np.zeros(3, np.float32), ValueError),
        "too few": (np.zeros(axles - 1, np.float32), ValueError),
        "two-dimensional": (np.zeros((1, axles), np.float32), ValueError),
        "empty list": ([], ValueError),
        "bool": (np.ones(axles, bool), TypeError),
        "list of bool": ([True] * axles, TypeError),
        "str": (["0.1"] * axles, TypeError),
        "object": (np.array([0.1] * axles, object), TypeError),
        "complex": (np.zeros(axles, complex), TypeError),
        "None": (None, TypeError),
        "ragged": ([[0.1], [0.1, 0.2]], TypeError),
        "a gradient": (torch.zeros(axles, requires_grad=True), TypeError),
        "on another device": (torch.zeros(axles, device="meta"), TypeError),
    }


@every
def test_a_bad_action_raises_and_changes_nothing(combination):
    env, twin = make(combination), make(combination)
    env.reset(seed=14)
    twin.reset(seed=14)
    good = actions_for(combination, 3, seed=8)
    assert env.step(good[0])[1] == twin.step(good[0])[1]
    for what, (action, error) in bad_actions(combination.axles).items():
        before, generator = env.unwrapped.state, env.unwrapped.np_random.bit_generator.state
        with pytest.raises(error) as caught:
            env.step(action)
        assert "action must" in str(caught.value), what
        assert env.unwrapped.state == before, what
        assert env.unwrapped.np_random.bit_generator.state == generator, what
    for action in good[1:]:
        one, other = env.step(action), twin.step(action)
        assert record(one[0], one[4], *one[1:4]) == record(other[0], other[4], *other[1:4])
    assert record(*env.reset()) == record(*twin.reset())


@every
def test_one_action_in_many_types(combination):
    results = []
    values = [0.25, -0.5][: combination.axles]
    strided = np.zeros(2 * combination.axles)
    strided[::2] = values
    for action in (
        np.array(values, np.float32),
        np.array(values, np.float64),
        np.array(values, np.float16),
        values,
        tuple(values),
        [np.float32(v) for v in values],
        np.array(values, ">f8"),
        strided[::2],
    ):
        env = make(combination)
        env.reset(seed=15)
        step = env.step(action)
        results.append(record(step[0], step[4], *step[1:4]))
    assert len(set(results)) == 1


@pytest.mark.parametrize("env_id", MAX_STEPS)
def test_whole_numbers_are_real_numbers(env_id):
    results = []
    for action in (np.array([1.0, 0.0]), [1, 0], np.array([1, 0]), np.array([1, 0], np.uint8)):
        env = gym.make(env_id, steer="both")
        env.reset(seed=15)
        results.append(env.step(action)[0].tobytes())
    assert len(set(results)) == 1


@pytest.mark.parametrize("env_id", MAX_STEPS)
def test_long_doubles_are_real_numbers(env_id):
    env, twin = gym.make(env_id, steer="both"), gym.make(env_id, steer="both")
    env.reset(seed=15)
    twin.reset(seed=15)
    assert np.array_equal(env.step(np.array([1.0, 0.0], np.longdouble))[0], twin.step(np.array([1.0, 0.0]))[0])


@pytest.mark.parametrize(("steer", "silent"), [("front", "rear"), ("rear", "front")])
@pytest.mark.parametrize("env_id", MAX_STEPS)
def test_an_axle_that_the_action_does_not_steer_stays_straight(env_id, steer, silent):
    env, both = gym.make(env_id, steer=steer), gym.make(env_id, steer="both")
    env.reset(seed=16)
    both.reset(seed=16)
    for action in actions_for(Combination(env_id, "fiala", "exact", steer, False), 20, seed=9):
        observation, _, over, _, _ = env.step(action)
        pair = np.array([action[0], 0.0] if steer == "front" else [0.0, action[0]], np.float32)
        assert np.array_equal(observation, both.step(pair)[0])
        state = env.unwrapped.state
        assert getattr(state, f"{silent}_steer") == getattr(state, f"{silent}_steer_command") == 0.0
        assert getattr(state, f"{steer}_steer") != 0.0
        assert not over


@every
def test_a_step_before_the_first_reset_raises(combination):
    action = np.zeros(combination.axles, np.float32)
    with pytest.raises(gym.error.ResetNeeded):
        make(combination).step(action)
    with pytest.raises(gym.error.ResetNeeded, match=r"reset\(\)"):
        make(combination).unwrapped.step(action)


# The checkers of others


@every
def test_gymnasium_check_env(combination):
    check_env(make(combination).unwrapped, skip_render_check=True)


@every
def test_stable_baselines3_check_env(combination):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(make(combination), warn=True)


def test_every_id_is_registered_once_and_with_its_own_time_limit():
    assert len(MAX_STEPS) == len(ENVIRONMENTS)
    bicycle_env.registration._register_own()
    for row in ENVIRONMENTS:
        spec = gym.spec(row.id)
        assert spec.max_episode_steps == row.max_episode_steps
        assert spec.entry_point == row.entry_point
        assert spec.kwargs == {}
        assert gym.make(f"bicycle_env:{row.id}").spec.max_episode_steps == row.max_episode_steps
