"""RLlib: PPO on the native vector environment, whose mode NEXT_STEP it assumes; what it collects checked by driving."""

import gymnasium as gym
import numpy as np
import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.env.single_agent_episode import SingleAgentEpisode

import bicycle_env  # noqa: F401
from bicycle_env.envs.bicycle_stab import BicycleStabVectorEnv

ENV_ID = "bicycle_env:BicycleStab-v0"
ROWS, LIMIT = 8, 60


def config() -> PPOConfig:
    return (
        PPOConfig()
        .environment(ENV_ID, env_config={"max_episode_steps": LIMIT})
        .env_runners(
            num_env_runners=0,
            num_envs_per_env_runner=ROWS,
            gym_env_vectorize_mode=gym.VectorizeMode.VECTOR_ENTRY_POINT,
            rollout_fragment_length=64,
        )
        .learners(num_learners=0)
        .training(train_batch_size=512, minibatch_size=128, num_epochs=2)
        .debugging(seed=0)
    )


def compare(episodes: list[SingleAgentEpisode]) -> tuple[int, int, int]:
    """Drive each whole episode again, alone, from its first observation; counts episodes, steps and time-outs.

    The start is known to float32 only, and the car is unstable: hence a tolerance.
    """
    env = gym.make(ENV_ID, max_episode_steps=LIMIT)
    plant = env.unwrapped
    whole = [episode for episode in episodes if episode.is_done and episode.t_started == 0]
    for episode in whole:
        start = episode.get_observations(0).astype(float) * plant.observation_scale
        assert np.all(start[4:] == 0.0), "an episode starts with the wheels straight"
        observation, _ = env.reset(options={"state": dict(zip(plant.observation_names[:4], start[:4], strict=True))})
        for k, action in enumerate(episode.get_actions()):
            np.testing.assert_allclose(episode.get_observations(k), observation, atol=1e-3)
            observation, reward, terminated, truncated, _ = env.step(action)
            assert abs(episode.get_rewards(k) - reward) < 1e-3
            assert (terminated or truncated) == (k == len(episode) - 1)
        np.testing.assert_allclose(episode.get_observations(-1), observation, atol=1e-3)
        assert episode.is_terminated == terminated
    return len(whole), sum(map(len, whole)), sum(not episode.is_terminated for episode in whole)


def main() -> None:
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False, configure_logging=False)
    algorithm = config().build_algo()
    runner = algorithm.env_runner
    assert isinstance(runner.env.unwrapped, BicycleStabVectorEnv)
    steps = [algorithm.train()["num_env_steps_sampled_lifetime"] for _ in range(3)]
    print(f"checked: PPO: three iterations, {steps[-1]:.0f} steps of the native vector environment")
    number, steps, time_outs = compare(runner.sample(num_timesteps=1500, explore=True))
    assert number > time_outs
    assert time_outs > 0
    print(f"checked: NextStep: {number} episodes of {steps} steps as the single environment's, {time_outs} time-outs")
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
