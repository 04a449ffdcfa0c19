"""What the benchmarks measure against is the same car; and they run."""

import importlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env  # noqa: F401

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))


@pytest.mark.exhaustive
@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
def test_the_kernel_in_c_has_the_same_bits():
    """With the linear tire, in strict arithmetic, while no car has ended: those it lets go on.

    Its places in memory are written from the Python tuples.
    """
    env = gym.make_vec("BicycleStab-v0", 64, tire="linear").unwrapped
    env.reset(seed=0)
    start = env._rows.numbers.copy()
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 64, 2)).astype(np.float32)
    found = []
    for step in (env._kernels.step, importlib.import_module("limit.build").kernel("linear")):
        env._rows.numbers[:] = start
        results, seen = env._new_results(), []
        for action in actions:
            arrays = (env._rows.numbers, action, env._generators.addresses, *results)
            step(*arrays, False, 0, env._rows.blocks)
            seen += [result.copy() for result in results]
        found.append(seen)
    for mine, theirs in zip(*found, strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_trainings_side_by_side_are_measured_from_one_to_the_cores(monkeypatch, tmp_path):
    """Each number of them keeps its best round, and is compared with as many times one."""
    scaling = importlib.import_module("scaling")
    assert [scaling.counts_up_to(most) for most in (1, 2, 6, 8)] == [[1], [1, 2], [1, 2, 4, 6], [1, 2, 4, 8]]
    rates = {1: [90, 100, 100], 3: [180, 240], 2: [160, 150]}  # the first: before anything is measured

    def trained(at_once, steps, folder):
        assert steps in (1, 7)
        rate = rates[at_once].pop(0)
        return {"at_once": at_once, "steps_per_second": rate, "with_the_start": rate, "cars": 8}

    monkeypatch.setattr(scaling, "trained", trained)
    monkeypatch.setattr(scaling, "cores", lambda: 2)
    monkeypatch.setattr(scaling, "cars_alone", lambda cars: 1000 * cars)
    path = tmp_path / "scaling.json"
    monkeypatch.setattr("sys.argv", ["scaling.py", "--most", "3", "--steps", "7", "--json", str(path)])
    assert scaling.main() == 0
    content = json.loads(path.read_text())
    assert [(row["at_once"], row["steps_per_second"], row["of_as_many"]) for row in content["rows"]] == [
        (1, 100, 1.0),
        (2, 160, 0.8),
        (3, 240, 0.8),
    ]
    assert content["command"] == "python benchmarks/scaling.py --steps 7 --most 3"
    assert content["cars_alone"] == 8000


@pytest.mark.exhaustive
def test_trainings_run_side_by_side(tmp_path):
    row = importlib.import_module("scaling").trained(2, 1000, tmp_path)
    assert row["steps_per_second"] == pytest.approx(sum(row["steps_per_second_each"]), abs=2)
    assert 0 < row["with_the_start"] < row["steps_per_second"]


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "words",
    [
        ("one_car.py", "--rounds", "1"),
        ("scaling.py", "--help"),
        ("revisions.py", "--help"),
        ("vector_env.py", "--help"),
    ],
)
def test_a_benchmark_runs(words, tmp_path):
    done = subprocess.run(
        [sys.executable, str(FOLDER / words[0]), *words[1:]], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.exhaustive
@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
@pytest.mark.parametrize("in_c", [False, True])
def test_the_bare_kernels_step(in_c):
    assert importlib.import_module("vector_env").kernel("linear", in_c, 128)()(10) == 1280
