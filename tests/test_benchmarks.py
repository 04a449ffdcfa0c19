"""What the benchmarks measure against is the same car; and they run."""

import importlib
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


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "words", [("one_car.py", "--rounds", "1"), ("revisions.py", "--help"), ("vector_env.py", "--help")]
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
