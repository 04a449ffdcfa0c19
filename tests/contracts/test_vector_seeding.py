"""One generator per row: seeds, what continues without a seed, and the same numbers in other threads and processes."""

import hashlib
import os
import subprocess
import sys
import textwrap

import gymnasium as gym
import numba
import numpy as np
import pytest
from vector_cases import IDS, STAB, actions_for, compiled, drive

from bicycle_env.backends.compiled_random import addresses, next_double

# The draws


@numba.njit
def _draw(generators, out):
    for k in range(out.shape[1]):
        for row in range(len(generators)):
            out[row, k] = next_double(generators[row])


@pytest.mark.parametrize("bits", [np.random.PCG64, np.random.PCG64DXSM, np.random.Philox, np.random.MT19937])
def test_a_draw_is_the_generators_next_number(bits):
    """Between them the generator goes on from where the compiled code left it, and the other way round."""
    mine = [np.random.Generator(bits(seed)) for seed in (0, 1, 2**40)]
    plain = [np.random.Generator(bits(seed)) for seed in (0, 1, 2**40)]
    out = np.empty((3, 50))
    for _ in range(3):
        _draw(addresses(mine), out)
        assert np.array_equal(out, [generator.random(50) for generator in plain])
        assert [generator.random() for generator in mine] == [generator.random() for generator in plain]
    assert out.min() >= 0.0
    assert out.max() < 1.0


# Seeds


def make(env_id=STAB, num_envs=5, **keywords):
    return gym.make_vec(env_id, num_envs=num_envs, max_episode_steps=30, **compiled(env_id, num_envs), **keywords)


def one_by_one(env_id, **keywords):
    return gym.make_vec(env_id, 5, "sync", **compiled(env_id), **keywords)


def starts(env_id, seeds):
    """(rows, entries): what single environments begin with."""
    return np.array([gym.make(env_id, **compiled(env_id)).reset(seed=seed)[0] for seed in seeds])


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize(
    ("seed", "seeds"),
    [
        (0, range(5)),
        (np.int64(40), range(40, 45)),
        (2**62, range(2**62, 2**62 + 5)),
        (2**63 - 2, range(2**63 - 2, 2**63 + 3)),
        (10**40, range(10**40, 10**40 + 5)),
        ([2**64, 1, 2**63, 7**99, 0], [2**64, 1, 2**63, 7**99, 0]),
        (np.uint64(2**63 + 9), range(2**63 + 9, 2**63 + 14)),
        ([9, 9, 1, 0, 2**40], [9, 9, 1, 0, 2**40]),
        (np.array([3, 1, 4, 1, 5]), [3, 1, 4, 1, 5]),
        ((7, 8, 9, 10, 11), range(7, 12)),
    ],
    ids=str,
)
def test_seeds_are_the_single_environments(env_id, seed, seeds):
    env = make(env_id)
    for _ in range(2):
        assert np.array_equal(env.reset(seed=seed)[0], starts(env_id, seeds))


@pytest.mark.parametrize("env_id", IDS)
def test_a_row_without_a_seed_goes_on_with_its_generator(env_id):
    env, sync = make(env_id), one_by_one(env_id, max_episode_steps=30)
    for each in (env, sync):
        each.reset(seed=11)
    for seed in (None, [5, None, None, 6, None], None, [None] * 5, 3, None):
        for actions in actions_for(env, 35):
            assert np.array_equal(env.step(actions)[0], sync.step(actions)[0])
        assert np.array_equal(env.reset(seed=seed)[0], sync.reset(seed=seed)[0])
    for mine, theirs in zip(env.np_random, sync.np_random, strict=True):
        assert mine.random() == theirs.random()


@pytest.mark.parametrize("env_id", IDS)
def test_generators_and_seeds_are_told_as_gymnasium_tells_them(env_id):
    env, sync = make(env_id), one_by_one(env_id)
    for seed in (8, 2**70, [5, None, None, 6, None], None):
        for each in (env, sync):
            each.reset(seed=seed)
        assert type(env.np_random_seed) is type(env.np_random) is tuple
        assert env.np_random_seed == sync.np_random_seed
        assert [one.bit_generator.state for one in env.np_random] == [one.bit_generator.state for one in sync.np_random]


def test_generators_and_seeds_are_there_before_the_first_reset():
    env = make()
    seeds = env.np_random_seed
    assert len(set(seeds)) == 5
    expected = [gym.make(STAB).reset(seed=seed)[0] for seed in seeds]
    assert len(env.np_random) == 5
    assert np.array_equal(env.reset()[0], expected)
    assert env.np_random_seed == seeds


def test_a_reset_of_some_rows_seeds_only_these():
    env = make()
    env.reset(seed=0)
    env.reset(seed=100, options={"reset_mask": np.array([False, True, False, False, True])})
    assert env.np_random_seed == (0, 101, 2, 3, 104)


def test_no_two_rows_share_a_seed():
    """Not after 2^8 rows, where a byte begins anew, nor in the rows of a last block that is not full."""
    env = make(num_envs=1030)
    observation, _ = env.reset(seed=3)
    assert len({row.tobytes() for row in observation}) == 1030
    assert np.array_equal(observation[[255, 256, 257, 1029]], starts(STAB, [258, 259, 260, 1032]))


def test_without_a_seed_runs_differ():
    first = [make().reset()[0].tobytes() for _ in range(3)]
    assert len(set(first)) == 3
    observation = make().reset()[0]
    assert len({row.tobytes() for row in observation}) == 5


@pytest.mark.parametrize("env_id", IDS)
def test_the_same_seed_gives_the_same_run_and_another_one_does_not(env_id):
    env = make(env_id)
    actions = actions_for(env, 60)
    runs = []
    for seed in (1, 1, 2):
        env.reset(seed=seed)
        runs.append(drive(env, actions))
    assert runs[0] == runs[1]
    assert not set(runs[0]) & set(runs[2])


@pytest.mark.parametrize(
    "seed",
    [
        -1,
        1.5,
        True,
        "seven",
        "abcde",
        [1, 2],
        [1, 2, 3, 4, -5],
        [1, 2, 3, 4, 5.5],
        [[1]] * 5,
        np.zeros(5),
        np.array(2.0),
        {},
    ],
    ids=str,
)
def test_a_bad_seed_changes_nothing(seed):
    env, twin = make(), make()
    for each in (env, twin):
        each.reset(seed=2)
    with pytest.raises((TypeError, ValueError), match=r"seed(\[\d\])? must be"):
        env.reset(seed=seed, options={"state": {"yaw_rate": 0.5}})
    actions = actions_for(env, 60)
    assert drive(env, actions) == drive(twin, actions)


# A million steps

RUN = textwrap.dedent(
    """
    import hashlib, sys, warnings
    warnings.simplefilter("error")
    import numpy as np
    import gymnasium as gym
    import bicycle_env

    def digest(threads):
        env = gym.make_vec("BicycleStab-v0", num_envs=2048, threads=threads, max_episode_steps=200)
        rng, hasher = np.random.default_rng(8), hashlib.sha256()
        hasher.update(env.reset(seed=123)[0])
        steps = ended = 0
        while steps < 1_000_000:
            *arrays, info = env.step(rng.uniform(-1.1, 1.1, (2048, 2)).astype(np.float32))
            for array in (*arrays, info["end"], info["cost"]):
                hasher.update(np.ascontiguousarray(array))
            steps += 2048
            ended += np.count_nonzero(info["end"])
        env.close()
        assert ended > 10_000, ended
        return hasher.hexdigest()
    """
)


@pytest.mark.exhaustive
def test_a_million_steps_are_the_same_in_other_threads_and_processes():
    here: dict = {}
    exec(compile(RUN, "run", "exec"), here)
    expected = here["digest"](1)
    assert len(expected) == hashlib.sha256().digest_size * 2
    assert here["digest"](2) == expected
    ran = subprocess.run(
        [sys.executable, "-O", "-c", RUN + "\nsys.stdout.write(digest(2))"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONHASHSEED": "1"},
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout == expected
