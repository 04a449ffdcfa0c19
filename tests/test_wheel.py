"""The wheel holds bicycle_env only, and works where nothing else of the checkout is."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def run(*command: str, **keywords: object) -> str:
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, check=False, **keywords)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.exhaustive
def test_the_wheel_installs_and_steps_elsewhere(tmp_path):
    source = tmp_path / "source"
    run("-c", COPY, str(ROOT), str(source))
    run("-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path / "dist"), str(source))
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert tops == {"bicycle_env", f"{'-'.join(wheel.name.split('-')[:2])}.dist-info"}
    assert "bicycle_env/py.typed" in names
    assert wheel.stat().st_size < 2_000_000
    pages = {path.name for path in (ROOT / "bicycle_env/explore/page").iterdir()}
    assert pages == {name.split("/")[-1] for name in names if name.startswith("bicycle_env/explore/page/")}
    assert "bicycle_env/export/network.mjs" in names
    assert "bicycle_env/control/tuned_parameters.json" in names
    shipped = {
        path.relative_to(ROOT).as_posix() for path in (ROOT / "bicycle_env/policies").rglob("*") if path.is_file()
    }
    assert shipped == {name for name in names if name.startswith("bicycle_env/policies/")}
    assert "bicycle_env/policies/BicycleStab-v0-medium/policy.safetensors" in shipped

    site = tmp_path / "site"
    run("-m", "pip", "install", "-q", "--no-deps", "--target", str(site), str(wheel))
    printed = run(
        "-c", STEP, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(site), "NUMBA_CACHE_DIR": str(tmp_path / "c")}
    )
    where, reward, action, steered, drivers = printed.split()
    assert Path(where).is_relative_to(site)
    assert 0.0 < float(reward) <= 1.0
    assert float(action) != 0.0
    assert 0.0 < abs(float(steered)) <= 1.0
    assert "pretrained" in drivers.split(",")


COPY = """
import shutil, sys
from pathlib import Path

import pytest
root, copy = map(Path, sys.argv[1:])
copy.mkdir()
for name in ("pyproject.toml", "README.md", "LICENSE"):
    shutil.copy(root / name, copy / name)
shutil.copytree(root / "bicycle_env", copy / "bicycle_env", ignore=shutil.ignore_patterns("__pycache__"))
shutil.copytree(root / "agents", copy / "agents", ignore=shutil.ignore_patterns("__pycache__"))
"""

STEP = """
import gymnasium as gym
import bicycle_env
from bicycle_env import control, leaderboard
env = gym.make("bicycle_env:BicycleStab-v0", tire="linear")
observation, _ = env.reset(seed=0)
action = control.make("lqr", env.unwrapped).act(observation)
_, reward, *_ = env.step(action)
steered = bicycle_env.load_policy("BicycleStab-v0").act(observation)
rows = leaderboard.read()["levels"]["BicycleStab-v0 medium"]["rows"]
print(bicycle_env.__file__, reward, action[0], steered[0], ",".join(row["name"].split()[0] for row in rows))
"""
