"""PPO in JAX: its advantages by hand, the same bits again and after a stop, seeds side by side, and it learns."""

from __future__ import annotations

import json
import os
import signal
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from agents import ppo_jax, training
from agents.messages import UserError
from agents.stopping import Stopped
from bicycle_env import control, provenance

jax = pytest.importorskip("jax")
pytest.importorskip("optax")

TINY = ppo_jax.Args(
    env_keywords='{"tire": "linear"}',
    seed=3,
    quiet=True,
    total_timesteps=5120,
    cars=16,
    decisions=8,
    hold=2,
    epochs=2,
    minibatches=2,
    width=8,
)  # 20 updates of 256 control steps, each with a point of the curve
MADE_BY = provenance.collect()


@pytest.fixture(autouse=True)
def _bits():
    yield
    jax.config.update("jax_enable_x64", False)


def start(folder, stop_after=None, **changes):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "SELECTED", 16)
        patch.setattr(provenance, "collect", lambda: MADE_BY)
        patch.setattr(os, "fsync", lambda _: None)
        kept, left = training.Run.after_update, [stop_after]

        def after(run, timesteps, *rest):
            if timesteps == left[0]:
                left.clear(), left.append(None)
                signal.raise_signal(signal.SIGTERM)
            kept(run, timesteps, *rest)

        patch.setattr(training.Run, "after_update", after)
        ppo_jax.train(replace(TINY, out=folder, **changes), Console(quiet=True))
    return folder


def digest(folder):
    return json.loads((folder / "policy.json").read_text())["weights_sha256"]


def test_the_advantages_by_hand():
    """Car 0 terminates with decision 1, car 1's time is over with decision 0: what it saw last stands for the rest."""
    driven = SimpleNamespace(
        reward=np.array([[1.0, 2.0], [3.0, 0.0], [0.0, 4.0]]),
        value=np.array([[10.0, 20.0], [30.0, 40.0], [50.0, 60.0]]),
        next_value=np.array([[30.0, 45.0], [55.0, 60.0], [70.0, 80.0]]),
        terminated=np.array([[False, False], [True, False], [False, False]]),
        over=np.array([[False, True], [True, False], [False, False]]),
    )
    last = [0.5 * 70 - 50, 4 + 0.5 * 80 - 60]
    middle = [3 - 30, 0.5 * 60 - 40 + 0.2 * last[1]]
    first = [1 + 0.5 * 30 - 10 + 0.2 * middle[0], 2 + 0.5 * 45 - 20]
    found = ppo_jax.advantages(driven, 0.5, 0.4)
    np.testing.assert_allclose(found, [first, middle, last], rtol=1e-6)


@pytest.mark.exhaustive
def test_the_same_seed_gives_the_same_policy_and_a_stop_changes_no_bit(tmp_path):
    straight = digest(start(tmp_path / "straight"))
    assert digest(start(tmp_path / "again")) == straight
    assert digest(start(tmp_path / "other", seed=4)) != straight
    with pytest.raises(Stopped, match="stopped at 2560 steps"):
        start(tmp_path / "stopped", stop_after=2560)
    start(tmp_path / "stopped", resume=True)
    assert digest(tmp_path / "stopped") == straight
    rows = [
        [line.split(",")[k] for k in (0, 2, 3)]
        for name in ("straight", "stopped")
        for line in (tmp_path / name / "curve.csv").read_text().splitlines()
    ]
    assert rows[: len(rows) // 2] == rows[len(rows) // 2 :]


@pytest.mark.exhaustive
def test_seeds_train_side_by_side_and_stop_together(tmp_path):
    start(tmp_path / "three", seeds=3)
    alone = control.load(start(tmp_path / "alone", seed=4)).arrays()
    beside = control.load(tmp_path / "three" / "4").arrays()
    for name, array in alone.items():
        np.testing.assert_allclose(beside[name], array, atol=2e-3)
    assert len({digest(tmp_path / "three" / str(seed)) for seed in (3, 4, 5)}) == 3
    with pytest.raises(Stopped):
        start(tmp_path / "stopped", seeds=3, stop_after=1280)  # while the first one's is written
    start(tmp_path / "stopped", seeds=3, resume=True)
    for seed in (3, 4, 5):
        assert digest(tmp_path / "stopped" / str(seed)) == digest(tmp_path / "three" / str(seed))


@pytest.mark.exhaustive
def test_it_learns(tmp_path):
    folder = start(
        tmp_path / "run", total_timesteps=120_000, cars=128, decisions=32, hold=1, epochs=4, minibatches=4, width=32
    )
    first, *_, last = [float(line.split(",")[3]) for line in (folder / "curve.csv").read_text().splitlines()[1:]]
    assert last > 3.0 * first


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"minibatches": 3}, "--minibatches must divide --cars times --decisions, 128, got 3"),
        ({"seeds": 0}, "--seeds must be at least 1, got 0"),
        ({"gamma": (0.5, 1.5)}, "--gamma"),
        ({"env_id": "BicycleStub-v0"}, "BicycleStub"),
    ],
)
def test_a_mistake_is_one_line(changes, text, tmp_path):
    with pytest.raises(UserError, match=text):
        start(tmp_path / "run", **changes)
    assert not (tmp_path / "run").exists()
