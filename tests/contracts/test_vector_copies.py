"""Copies of the vector environment: snapshots, pickle, other processes; threads, and that close() stops them."""

import base64
import copy
import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import gymnasium as gym
import numpy as np
import pytest
from combinations import only_all
from vector_cases import COMBINATIONS, IDS, LANE_CHANGE, MODES, STAB, actions_for, compiled, drive, make_many, record

BIG = 1100
"""Rows enough for two threads."""


def make(env_id=STAB, num_envs=6, **keywords):
    given = {"num_envs": num_envs, "max_episode_steps": 40, **compiled(env_id, num_envs), **keywords}
    return gym.make_vec(env_id, **given)


def driven(env, steps=25, seed=3):
    """The environment, a while after a reset, and the actions that follow."""
    env.reset(seed=seed)
    actions = actions_for(env, steps + 60)
    drive(env, actions[:steps])
    return env, actions[steps:]


# Copies


@pytest.mark.parametrize("how", ["deepcopy", "pickle"])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", IDS)
def test_a_copy_continues_to_the_bit(env_id, mode, how):
    env, actions = driven(make(env_id, autoreset_mode=mode, telemetry=True))
    twin = copy.deepcopy(env) if how == "deepcopy" else pickle.loads(pickle.dumps(env))
    state = record(twin.state)
    mine = [*drive(env, actions), record(env.reset())]
    assert record(twin.state) == state, "the copy moved with its original"
    assert mine == [*drive(twin, actions), record(twin.reset())]
    assert record(env.state) == record(twin.state)


@pytest.mark.parametrize("combination", [row for row in COMBINATIONS if row.varied][:2], ids=lambda c: c.tire)
def test_a_copy_of_different_cars_continues_too(combination):
    env, actions = driven(make_many(combination, autoreset_mode="SameStep"))
    twin = pickle.loads(pickle.dumps(env))
    assert drive(env, actions) == drive(twin, actions)
    assert np.array_equal(twin.friction, env.friction)


def test_a_copy_before_the_first_reset_needs_one():
    twin = pickle.loads(pickle.dumps(make()))
    with pytest.raises(gym.error.ResetNeeded):
        twin.step(np.zeros((6, 2), np.float32))
    assert record(twin.reset(seed=1)) == record(make().reset(seed=1))


def test_a_copy_in_another_process_continues_to_the_bit():
    """Without this module and without a fork: what spawned workers do."""
    env, actions = driven(make(telemetry=True))
    program = (
        "import base64, hashlib, pickle, sys\n"
        "env, actions = pickle.loads(base64.b64decode(sys.stdin.read()))\n"
        "for action in actions:\n"
        "    results = env.step(action)\n"
        "sys.stdout.write(repr([part.tolist() for part in (*results[:-1], *env.state, *env.reset()[:-1])]))\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program],
        input=base64.b64encode(pickle.dumps((env, actions))).decode(),
        capture_output=True,
        text=True,
        check=False,
        env=os.environ,
    )
    assert ran.returncode == 0, ran.stderr
    for action in actions:
        results = env.step(action)
    assert ran.stdout == repr([part.tolist() for part in (*results[:-1], *env.state, *env.reset()[:-1])])


# Snapshots


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", IDS)
def test_a_snapshot_continues_to_the_bit(env_id, mode):
    env, actions = driven(make(env_id, autoreset_mode=mode))
    snapshot = env.snapshot()
    state = record(env.state)
    first = [*drive(env, actions), record(env.reset())]
    assert record(env.state) != state
    observation = env.restore(snapshot)
    assert record(env.state) == state
    assert first == [*drive(env, actions), record(env.reset())]
    stranger = make(env_id, autoreset_mode=mode)
    for prepare in (lambda: None, lambda: stranger.reset(seed=99)):  # also before its first reset
        prepare()
        assert stranger.restore(snapshot).tobytes() == observation.tobytes()
        assert first == [*drive(stranger, actions), record(stranger.reset())]


@pytest.mark.parametrize("env_id", IDS)
def test_restoring_gives_the_observation_of_that_moment(env_id):
    env, actions = driven(make(env_id))
    observation = env.step(actions[0])[0]
    snapshot = env.snapshot()
    env.reset()
    assert env.restore(snapshot).tobytes() == observation.tobytes()


def test_a_snapshot_holds_the_episode_and_not_the_car():
    """As the single environment's: a model with another friction can be put where the car is."""
    env, actions = driven(make())
    model = make(friction=0.6, max_episode_steps=1000)
    model.restore(env.snapshot())
    assert record(model.state) == record(env.state)
    alone = gym.make(STAB, friction=0.6)
    state = {name: float(values[2]) for name, values in env.state._asdict().items() if name != "time"}
    alone.reset(options={"state": state})
    expected = alone.step(actions[0][2])[0]
    assert np.array_equal(model.step(actions[0])[0][2], expected)
    assert not np.array_equal(env.step(actions[0])[0][2], expected)


def test_a_snapshot_tells_who_has_ended():
    env = make(autoreset_mode="Disabled")
    env.reset(seed=0, options={"state": {"heading": np.array([0.0, 1.19, 0.0, 0.0, 0.0, 0.0]), "yaw_rate": 1.9}})
    still = np.zeros((6, 2), np.float32)
    env.step(still)
    snapshot = env.snapshot()
    expected = record(env.step(still))
    env.reset()
    env.restore(snapshot)
    assert record(env.step(still)) == expected
    assert env.step(still)[4]["end"][1] == 1


@pytest.mark.parametrize(
    ("other", "keywords"),
    [
        ("another task", {"id": LANE_CHANGE, "num_envs": 6, **compiled(LANE_CHANGE, 6)}),
        ("another number", {"id": STAB, "num_envs": 7}),
        only_all("another precision", {"id": STAB, "num_envs": 6, "dtype": "float32"}),
    ],
)
def test_a_snapshot_of_something_else_is_refused(other, keywords):
    stranger = gym.make_vec(**keywords)
    stranger.reset(seed=0)
    refused(stranger.snapshot(), ValueError, "this one has 6 cars of 12 numbers, float64; the snapshot")


@pytest.mark.parametrize(
    "bad", [None, 3, (np.zeros(3),) * 4, gym.make(STAB).unwrapped], ids=lambda bad: type(bad).__name__
)
def test_restore_takes_snapshots_only(bad):
    if isinstance(bad, gym.Env):
        bad.reset(seed=0)
        bad = bad.snapshot()
    refused(bad, TypeError, "snapshot")


def refused(snapshot, error, words):
    env, actions = driven(make())
    twin, _ = driven(make())
    with pytest.raises(error, match=words):
        env.restore(snapshot)
    assert drive(env, actions) == drive(twin, actions)


def test_there_is_no_snapshot_before_the_first_reset():
    with pytest.raises(gym.error.ResetNeeded, match=r"reset\(\)"):
        make().snapshot()


# Threads


def test_close_stops_the_threads_and_a_copy_has_its_own():
    before = set(threading.enumerate())
    env, actions = driven(make(num_envs=BIG, threads=2))
    mine = set(threading.enumerate()) - before
    assert len(mine) == 1
    twin = copy.deepcopy(env)
    drive(twin, actions[:1])
    assert len(set(threading.enumerate()) - before - mine) == 1
    twin.close()
    env.close()
    assert set(threading.enumerate()) == before
    env.close()
    assert env.closed


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no forks here")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
@pytest.mark.parametrize("end", ["step", "close"])
def test_a_fork_has_threads_of_its_own(end):
    """The threads stay in the parent: a child that waited for them would wait for ever."""
    env, actions = driven(make(num_envs=BIG, threads=2))

    def child(pipe):
        if end == "step":
            pipe.send(drive(env, actions[:3]))
        env.close()
        pipe.send("closed")

    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("fork").Process(target=child, args=(there,))
    process.start()
    try:
        answers = []
        while len(answers) < (2 if end == "step" else 1):
            assert here.poll(120), "the child hangs"
            answers.append(here.recv())
        process.join(120)
        assert process.exitcode == 0
    finally:
        process.kill()
    mine = drive(env, actions[:3])
    assert answers == ([mine, "closed"] if end == "step" else ["closed"])
    env.close()


def test_few_rows_start_no_thread():
    before = set(threading.enumerate())
    driven(make(threads=16))
    assert set(threading.enumerate()) == before


def test_environments_in_threads_of_their_own_do_not_meet():
    def run(seed):
        env, actions = driven(make(num_envs=64), seed=seed)
        return drive(env, actions)

    expected = [run(seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(run, range(4))) == expected
