"""Minari: a data set collected from the single environment, read again and driven again."""

import os
import tempfile

import gymnasium as gym
import minari
import numpy as np
from minari import DataCollector

import bicycle_env  # noqa: F401
from bicycle_env import control

ENV_ID = "bicycle_env:BicycleStab-v0"
EPISODES = 6


def main() -> None:
    env = DataCollector(gym.make(ENV_ID, telemetry=True), record_infos=True, data_format="hdf5")
    policy = control.make("lqr", env)
    rng = np.random.default_rng(0)
    driven = []
    for seed in range(EPISODES):
        observation, _ = env.reset(seed=seed)
        policy.reset()
        rewards, over = [], False
        while not over:
            action = np.clip(policy.act(observation) + rng.normal(0.0, 0.1, 2), -1.0, 1.0).astype(np.float32)
            observation, reward, terminated, truncated, info = env.step(action)
            rewards.append(reward)
            over = terminated or truncated
        driven.append((seed, rewards, terminated, info["sideslip"]))
    dataset = env.create_dataset("bicycle/stab/lqr-v0", algorithm_name="LQR with noise")

    dataset = minari.load_dataset("bicycle/stab/lqr-v0")
    assert dataset.total_episodes == EPISODES
    again = dataset.recover_environment()
    for episode, (seed, rewards, terminated, sideslip) in zip(dataset.iterate_episodes(), driven, strict=True):
        observation, _ = again.reset(seed=seed)
        np.testing.assert_array_equal(episode.observations[0], observation)
        for k, action in enumerate(episode.actions):
            observation, reward, *_ = again.step(action)
            np.testing.assert_array_equal(episode.observations[k + 1], observation)
            assert reward == rewards[k] == episode.rewards[k]
        assert episode.terminations[-1] == terminated
        assert episode.infos["sideslip"][-1] == sideslip
    print(
        f"checked: DataCollector: {EPISODES} episodes of {dataset.total_steps} steps read and driven again to the bit"
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        os.environ["MINARI_DATASETS_PATH"] = place
        main()
