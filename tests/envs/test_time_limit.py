"""The time limit is one number: that of the wrapper, of the vector environment, and of the quadratic reward."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordEpisodeStatistics, TimeLimit

from bicycle_env.envs import TorchVectorEnv
from bicycle_env.registration import ENVIRONMENTS

STAB = "BicycleStab-v0"
KIND = {"reward": "quadratic", "tire": "tanh", "geometry": "small_angle", "physics_timestep": 0.02}
LOST = {"state": {"yaw_rate": 1.9, "heading": 1.0}}  # spins in the first steps


def single(**keywords):
    env = gym.make(STAB, **KIND, **keywords)
    env.reset(seed=0, options=LOST)
    return env


def failure(env):
    """The reward of the step in which the car spins."""
    while True:
        _, reward, terminated, _, _ = env.step(np.ones(2, np.float32))
        if terminated:
            return reward


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
@pytest.mark.parametrize("limit", [300, 1000])
def test_a_failure_pays_for_the_steps_up_to_the_limit(limit):
    given = single(max_episode_steps=limit)
    explicit = single(max_episode_steps=-1, horizon=limit)
    assert given.unwrapped.horizon == given.unwrapped.rules.horizon == limit
    expected = failure(explicit)
    assert failure(given) == expected
    many = gym.make_vec(STAB, 3, **KIND, max_episode_steps=limit)
    assert many.unwrapped.horizon == limit
    many.reset(seed=0, options=LOST)
    while True:
        _, rewards, terminated, _, _ = many.step(np.ones((3, 2), np.float32))
        if terminated.any():
            break
    assert rewards.tolist() == [expected] * 3
    tensors = TorchVectorEnv(STAB, 2, **KIND, max_episode_steps=limit)
    assert tensors.horizon == tensors.rules.horizon == limit


@pytest.mark.parametrize("row", ENVIRONMENTS, ids=lambda row: row.id)
def test_the_registered_limit_is_the_tasks_own(row):
    env = gym.make(row.id)
    before = env.unwrapped.horizon
    env.reset(seed=0)
    assert before == env.unwrapped.horizon == row.max_episode_steps == env.unwrapped.task.episode_steps


@pytest.mark.parametrize(
    "make",
    [
        lambda: gym.make(STAB, max_episode_steps=70),
        lambda: gym.make(gym.make(STAB, max_episode_steps=70).spec),
        lambda: RecordEpisodeStatistics(gym.make(STAB, max_episode_steps=70)),
        lambda: copy.deepcopy(gym.make(STAB, max_episode_steps=70)),
        lambda: pickle.loads(pickle.dumps(gym.make(STAB, max_episode_steps=70))),
        lambda: gym.make_vec(STAB, 1, "sync", max_episode_steps=70).envs[0],
    ],
    ids=["make", "spec", "wrapped", "copied", "pickled", "sync"],
)
def test_however_it_is_made(make):
    env = make()
    env.reset(seed=0)
    assert env.unwrapped.horizon == 70


def test_without_a_limit_it_is_the_tasks_own():
    assert single(max_episode_steps=-1).unwrapped.horizon == 400
    assert gym.make_vec(STAB, 2, max_episode_steps=-1).unwrapped.horizon == 400
    assert TorchVectorEnv(STAB, 2, max_episode_steps=-1).horizon == 400


def test_a_copy_goes_on_with_the_horizon_that_it_has():
    env = single(max_episode_steps=1000)
    other = copy.deepcopy(env.unwrapped)
    other.reset(seed=0, options=LOST)
    assert other.horizon == 1000
    env.reset(seed=0, options=LOST)
    assert failure(other) == failure(env)


def test_another_environments_limit_is_not_this_ones():
    class Inside(gym.Wrapper):
        """Resets another environment while it is being reset."""

        other = gym.make(STAB, max_episode_steps=-1)

        def reset(self, **keywords):
            self.other.reset(seed=0)
            return super().reset(**keywords)

    env = TimeLimit(Inside(gym.make(STAB, max_episode_steps=-1)), 90)
    env.reset(seed=0)
    assert (env.unwrapped.horizon, Inside.other.unwrapped.horizon) == (90, 400)


MAKERS = {
    "single": lambda **keywords: gym.make(STAB, **keywords).reset(seed=0),
    "native": lambda **keywords: gym.make_vec(STAB, 2, **keywords),
    "torch": lambda **keywords: TorchVectorEnv(STAB, 2, **keywords),
}


@pytest.mark.parametrize("kind", MAKERS)
def test_an_explicit_horizon_wins_with_a_remark(kind):
    with pytest.warns(UserWarning, match="horizon = 500 is not the time limit of 60 steps"):
        MAKERS[kind](reward="quadratic", horizon=500, max_episode_steps=60)
    MAKERS[kind](reward="quadratic", horizon=60, max_episode_steps=60)
    MAKERS[kind](horizon=500, max_episode_steps=60)  # without effect on the default reward


@pytest.mark.parametrize("kind", MAKERS)
def test_a_limit_too_short_for_success_is_remarked(kind):
    with pytest.warns(UserWarning, match="max_episode_steps = 49 makes success impossible.* 50 steps"):
        MAKERS[kind](max_episode_steps=49)
