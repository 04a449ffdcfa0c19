"""Frozen numbers: a change that moves a digit of the environments must be meant. Made by tests/golden/make.py."""

import importlib.util
import json
from pathlib import Path

import pytest

from bicycle_env.registration import ENVIRONMENTS

FOLDER = Path(__file__).parents[1] / "golden"
GOLDEN = json.loads((FOLDER / "rollouts.json").read_text(encoding="utf-8"))
IDS = [row.id for row in ENVIRONMENTS]


@pytest.fixture(scope="module")
def maker():
    spec = importlib.util.spec_from_file_location("golden_maker", FOLDER / "make.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_id_has_a_golden_rollout():
    assert sorted(GOLDEN) == sorted(IDS)


@pytest.mark.parametrize("env_id", IDS)
def test_the_golden_rollout(env_id, maker):
    frozen = GOLDEN[env_id]
    frames = maker.rollout(env_id, frozen["seed"], frozen["feedback"])
    assert len(frames) == len(frozen["frames"]) > 10, "the frozen rollout is a whole episode"
    for frame, expected in zip(frames, frozen["frames"], strict=True):
        assert frame == expected, expected["step"]  # on every machine


@pytest.mark.parametrize("env_id", IDS)
def test_another_seed_is_another_rollout(env_id, maker):
    frozen = GOLDEN[env_id]
    frames = maker.rollout(env_id, frozen["seed"] + 1, frozen["feedback"])
    assert not any(frame == expected for frame, expected in zip(frames, frozen["frames"], strict=False))


@pytest.mark.parametrize("env_id", IDS)
def test_the_frozen_numbers_tell_a_millionth_of_a_gain(env_id, maker):
    frozen = GOLDEN[env_id]
    changed = [[value * (1.0 + 1e-6) for value in row] for row in frozen["feedback"]]
    frames = maker.rollout(env_id, frozen["seed"], changed)
    assert not all(frame == expected for frame, expected in zip(frames, frozen["frames"], strict=False))
