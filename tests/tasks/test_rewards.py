"""Rewards are values: a name, an object, its plain form, or a law of one's own, the same in every environment."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all
from gymnasium.envs.registration import EnvSpec

from bicycle_env.envs import TorchVectorEnv
from bicycle_env.tasks import rewards
from bicycle_env.tasks.checking import check_reward
from bicycle_env.tasks.lane_change import LaneChange
from bicycle_env.tasks.stabilise import Stabilise

STAB = "BicycleStab-v0"
KIND = {"tire": "linear", "geometry": "small_angle"}


@dataclasses.dataclass(frozen=True)
class Smooth(rewards.Reward):
    """Less for a fast steer now, and for a large heading before; a failure costs."""

    weight: float = 2.0
    failure: float = 50.0

    def before(self, xp):
        return lambda state, reference, action, world: abs(state.heading)

    def law(self, xp):
        weight, failure = self.weight, self.failure

        def law(state, reference, action, memory, before, end, world):
            change = action[0] - memory.front_steer_command / world.car.front_angle_limit
            return -weight * change * change - before - xp.where(end > 0, failure, 0.0 * before)

        return law


@dataclasses.dataclass(frozen=True)
class Fined(rewards.Reward):
    """1 for every step; a failure pays the task's limit of the yaw rate for each that is done."""

    def law(self, xp):
        return lambda state, reference, action, episode, before, end, world: 1.0 + 0.0 * state.heading

    def forfeit(self, xp, task):
        fine = task.limits.yaw_rate
        return lambda steps, car, rules: -fine * steps


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
@pytest.mark.parametrize(
    "reward",
    [Smooth(), only_all(Fined()), only_all(Smooth(weight=0.5)), only_all(rewards.Quadratic(yaw_rate_cost=3.0))],
    ids=repr,
)
def test_a_law_of_ones_own_is_the_same_in_every_environment(reward):
    given = {**KIND, "reward": reward, "speed": 40.0}
    single, many = gym.make(STAB, **given), gym.make_vec(STAB, 3, **given, autoreset_mode="Disabled")
    tensors = TorchVectorEnv(STAB, 3, **given, autoreset_mode="Disabled")
    single.reset(seed=5)
    many.reset(seed=5)
    tensors.reset(seed=0)
    state = many.unwrapped.state._asdict()
    tensors.set_state({name: np.full(3, column[0]).tolist() for name, column in state.items()})
    rng = np.random.default_rng(1)
    for done in range(1, 60):
        action = rng.uniform(-1.0, 1.0, 2).astype(np.float32)
        before = single.unwrapped.state
        _, expected, terminated, _, _ = single.step(action)
        assert many.step(np.tile(action, (3, 1)))[1][0] == expected
        found = tensors.step(torch.from_numpy(np.tile(action, (3, 1))))[1]
        np.testing.assert_allclose(found.numpy(), expected, rtol=1e-12)
        if isinstance(reward, Smooth):
            change = float(action[0]) - before.front_steer_command / single.unwrapped.front_actuator.angle_limit
            wanted = -reward.weight * change**2 - abs(before.heading) - reward.failure * terminated
            assert expected == pytest.approx(wanted, rel=1e-12)
        if isinstance(reward, Fined):
            assert expected == 1.0 - 2.0 * done * terminated
        if terminated:
            break
    assert terminated


def test_the_names_are_the_tasks_own_rewards():
    for task, env_id in ((Stabilise(), STAB), (LaneChange(), "BicycleLaneChange-v0")):
        assert {"default", "quadratic"} <= set(task.rewards)
        for name in task.rewards:
            assert gym.make(env_id, reward=name).unwrapped.reward == task.rewards[name]


def test_the_plain_form_and_json():
    plain = {"name": "bounded", "lateral_weight": 3.0}
    env = gym.make(STAB, reward=plain)
    assert env.unwrapped.reward == rewards.Bounded(lateral_weight=3.0)
    again = gym.make(EnvSpec.from_json(gym.make(STAB, reward=rewards.Bounded(lateral_weight=3.0)).spec.to_json()))
    assert again.unwrapped.reward == env.unwrapped.reward


def test_the_model_has_the_costs_of_the_reward_or_else_the_tasks_own():
    own = gym.make(STAB, reward=rewards.Quadratic(yaw_rate_cost=3.0, rear_command_cost=0.7)).unwrapped.linear_model()
    assert own.Q.diagonal().tolist() == [0.0, 0.0, 0.0, 3.0, 0.0, 0.0]
    assert own.R.diagonal().tolist() == [0.1, 0.7]
    usual = gym.make(STAB, reward="quadratic").unwrapped.linear_model()
    assert np.array_equal(gym.make(STAB, reward=Smooth()).unwrapped.linear_model().Q, usual.Q)


@pytest.mark.parametrize(
    ("bad", "error", "words"),
    [
        ("quadratc", ValueError, "did you mean 'quadratic'"),
        ({"name": "bounded", "lateral": 1.0}, ValueError, "field of reward 'bounded' 'lateral'; did you mean"),
        ({"lateral_weight": 1.0}, ValueError, "a dict must have a 'name', one of 'bounded', 'quadratic'"),
        (
            {"name": "bounded", "lateral_weight": -1.0},
            ValueError,
            "lateral_weight must be a finite number >= 0, got -1",
        ),
        (3, TypeError, f"reward must be one of {', '.join(map(repr, Stabilise.rewards))}, a Reward object or a dict"),
        (rewards.Bounded, TypeError, "a Reward object or a dict, got <class"),
    ],
)
def test_what_is_no_reward_is_refused(bad, error, words):
    for make in (gym.make, lambda env_id, **given: gym.make_vec(env_id, 2, **given)):
        with pytest.raises(error, match=words):
            make(STAB, reward=bad)


def test_a_command_that_costs_nothing_is_refused():
    with pytest.raises(ValueError, match="rear_command_cost must be a finite number > 0, got 0"):
        rewards.Quadratic(rear_command_cost=0.0)


def variant(law):
    return dataclasses.dataclass(frozen=True)(type("Variant", (rewards.Reward,), {"law": lambda self, xp: law}))()


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (lambda s, r, a, m, b, e, w: s.yawrate, "'law' fails on two cars at once .*'yawrate'"),
        (lambda s, r, a, m, b, e, w: 1.0, "must give one finite number per car, got 1.0"),
        (lambda s, r, a, m, b, e, w: 1.0 if e > 0 else 0.0, "branches on data: use xp.where"),
        (lambda s, r, a, m, b, e, w: np.cos(s.heading), "it calls numpy's cos: use xp.cos"),
        (lambda s, r, a, m, b, e, w: s.heading, "is another one for the mirror image"),
    ],
    ids=["typo", "constant", "branch", "numpy", "mirror"],
)
def test_a_fault_is_one_line(law, words):
    with pytest.raises(ValueError, match=f"^reward Variant.*{words}"):
        check_reward(Stabilise(), variant(law))
