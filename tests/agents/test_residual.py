"""A policy on top of a controller: in training and from its file it drives the same, and a stop loses nothing."""

from __future__ import annotations

import json
import re

import gymnasium as gym
import numpy as np
import pytest
from test_training import assert_equal
from tiny_ppo import UPDATE, start

from agents import publishing, residual, stopping
from agents.messages import UserError
from bicycle_env import control, export
from bicycle_env.files import FileError

STAB = "BicycleStab-v0"
BASE = "lqg"  # it remembers
KEYWORDS = {"max_episode_steps": 44}  # the last of the decisions is cut short


def plant():
    return gym.make(STAB, **KEYWORDS).unwrapped


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("residual") / "run"
    return start(folder, residual=BASE, hold=3, total_timesteps=6 * UPDATE, deviation=0.5)


def test_what_the_cars_are_paid_is_what_the_file_s_policy_earns(straight):
    """To the bit, over whole episodes and into the next one."""
    policy = control.load(straight, plant())
    assert isinstance(policy, control.Residual)
    assert isinstance(policy.base, control.LQG)
    cars = residual.OnTop(STAB, 16, KEYWORDS, residual.base(BASE, plant()), 3)
    assert cars.action_repeat == 3
    seen, _ = cars.reset(seed=7)
    network, paid, over = policy.network, [], np.zeros(16, np.bool_)
    deciding = control.Network(
        list(zip(*[iter(network.arrays().values())] * 2, strict=True)),
        "tanh",
        "clip",
        {**network.description, "hold": 1},  # its decisions
    )
    while not np.all(over):
        seen, rewards, terminated, truncated, _ = cars.step(deciding.act(seen))
        paid.append(np.where(over, np.nan, rewards))
        over = over | terminated | truncated
    env = gym.make(STAB, **KEYWORDS)
    lengths = set()
    for car in range(16):
        observation, _ = env.reset(seed=7 + car)
        policy.reset()
        ended, steps, sums = False, 0, []
        while not ended:
            if steps % 3 == 0:
                sums.append(0.0)
            observation, reward, terminated, truncated, _ = env.step(policy.act(observation))
            ended, steps = terminated or truncated, steps + 1
            sums[-1] += reward
        assert [rewards[car] for rewards in paid if not np.isnan(rewards[car])] == sums
        lengths.add(steps)
    assert 44 in lengths
    assert len(lengths) > 1


def test_a_row_that_has_ended_is_reset_by_its_next_step_and_the_law_forgets():
    cars = residual.OnTop(STAB, 4, {"max_episode_steps": 6}, residual.base(BASE, plant()), 2)
    cars.reset(seed=3)
    actions = np.full((4, 2), 0.1, np.float32)
    for step in range(1, 9):
        _, rewards, terminated, truncated, _ = cars.step(actions)
        remembers = cars.memory()["base.memory"][:, 2]
        assert np.all(truncated == (step % 4 == 3))
        assert not np.any(terminated)
        assert np.all((rewards == 0.0) == (step % 4 == 0))
        assert np.all((remembers == 0.0) == (step % 4 == 0))


@pytest.mark.parametrize("stop_at", [UPDATE, 2 * UPDATE])
def test_a_stopped_run_gives_the_bits_of_a_straight_one(straight, tmp_path, stop_at):
    changes = {"residual": BASE, "hold": 3, "total_timesteps": 6 * UPDATE, "deviation": 0.5}
    with pytest.raises(stopping.Stopped):
        start(tmp_path / "run", stop_at=stop_at, **changes)
    start(tmp_path / "run", resume=True, **changes)
    assert_equal(tmp_path / "run", straight)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("lqq", "did you mean 'lqr'"),
        ("zero", "controller with parameters must be one of"),
        ("rear-switched", "needs .* in the observation"),
        ("test_residual:Own", "not of this package"),
    ],
)
def test_whom_nothing_is_added_to_is_one_line(name, text):
    with pytest.raises(UserError, match=f"--residual: .*{text}") as caught:
        residual.base(name, plant())
    assert "\n" not in str(caught.value)


def test_the_controller_does_not_act_twice(tmp_path):
    with pytest.raises(UserError, match=r"--residual: .* image of lqr, too; give --imitate ''"):
        start(tmp_path / "run", residual=BASE, imitate="lqr")
    assert not (tmp_path / "run").exists()


class Own(control.TunablePolicy):
    """Somebody's own."""

    parameters = ()

    @classmethod
    def of(cls, plant, values):
        return cls()

    def act(self, observation):
        return np.zeros(2, np.float32)


# The file


def test_the_file_names_the_base_with_its_parameters(straight):
    told = json.loads((straight / "policy.json").read_text())
    law = residual.base(BASE, plant())
    assert told["version"] == 3
    assert told["base"]["controller"] == BASE
    assert list(told["base"]["parameters"].values()) == law.values.tolist()


def test_it_is_the_sum_limited(straight):
    policy, alone, law = control.load(straight, plant()), control.read(straight), residual.base(BASE, plant())
    seen = np.random.default_rng(0).normal(0.0, 0.4, (40, len(plant().observation_names))).astype(np.float32)
    both = law.act(seen) + alone.act(seen)
    np.testing.assert_array_equal(policy.act(seen), np.clip(both, -1.0, 1.0))
    assert np.any(np.abs(both) > 1.0)
    assert np.any(np.abs(both) < 1.0)
    assert control.alone_among_many(policy)


def test_without_its_base_it_is_refused(straight, tmp_path):
    with pytest.raises(FileError, match="was trained on top of 'lqg', which is designed for an environment"):
        control.load(straight)
    with pytest.raises(ValueError, match="cannot be written out: it is added to the actions of 'lqg'"):
        export.export_policy(control.read(straight), "c", tmp_path)
    with pytest.raises(UserError, match="only networks ship"):
        publishing.scored_run(straight, {}, None, "medium", 4)


@pytest.mark.parametrize(
    ("base", "text"),
    [
        ({"controller": "os:system", "parameters": {}}, "controller as base"),
        ({"controller": BASE, "parameters": {}}, "missing"),
        ({"controller": BASE, "parameters": {"heading": "1"}}, "heading|missing"),
        ({"controller": BASE}, "parameters"),
        ("lqg", "base"),
    ],
)
def test_a_base_that_cannot_be_is_one_line(straight, tmp_path, base, text):
    for name in ("policy.json", "policy.safetensors"):
        (tmp_path / name).write_bytes((straight / name).read_bytes())
    told = json.loads((tmp_path / "policy.json").read_text())
    (tmp_path / "policy.json").write_text(json.dumps({**told, "base": base}))
    with pytest.raises(FileError, match=f"{re.escape(str(tmp_path))}.*({text})") as caught:
        control.load(tmp_path, plant())
    assert "\n" not in str(caught.value)
