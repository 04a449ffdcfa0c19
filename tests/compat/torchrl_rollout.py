"""TorchRL: the native vector environment in GymWrapper, each row compared with its single environment."""

import gymnasium as gym
import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, GymWrapper
from torchrl.envs.utils import check_env_specs

import bicycle_env  # noqa: F401

ENV_ID = "BicycleStab-v0"
ROWS, STEPS, LIMIT = 8, 300, 60


def make(mode: str) -> EnvBase:
    return GymWrapper(gym.make_vec(ENV_ID, ROWS, autoreset_mode=mode, max_episode_steps=LIMIT))


def drive(env: EnvBase) -> TensorDictBase:
    """A rollout in which rows end and go on; seeded by TorchRL's own means."""
    torch.manual_seed(0)
    env.set_seed(0)
    walk = torch.cumsum(0.8 * torch.rand(STEPS, ROWS, 2) - 0.4, 0).clamp(-1.0, 1.0)
    step = iter(walk)

    def policy(data: TensorDictBase) -> TensorDictBase:
        return data.set("action", next(step))

    return env.rollout(STEPS, policy, break_when_any_done=False)


def compare(data: TensorDictBase) -> tuple[int, int]:
    """Every observation, next observation, reward and end against the single environments; counts the ends."""
    terminations = time_outs = 0
    for row in range(ROWS):
        env = gym.make(ENV_ID, max_episode_steps=LIMIT)
        env.reset(seed=row)
        observation, _ = env.reset()
        for k in range(STEPS):
            now = data[row, k]
            np.testing.assert_array_equal(now["observation"].numpy(), observation)
            observation, reward, terminated, truncated, _ = env.step(now["action"].numpy())
            np.testing.assert_array_equal(now["next", "observation"].numpy(), observation)
            assert now["next", "reward"].item() == np.float32(reward)
            assert now["next", "terminated"].item() == terminated
            assert now["next", "truncated"].item() == truncated
            if terminated or truncated:
                terminations, time_outs = terminations + terminated, time_outs + truncated
                observation, _ = env.reset()
    return terminations, time_outs


def main() -> None:
    for mode in ("SameStep", "Disabled"):
        check_env_specs(make(mode))
        terminations, time_outs = compare(drive(make(mode)))
        assert terminations > 0, mode
        assert time_outs > 0, mode
        print(f"checked: {mode}: {ROWS} rows of {STEPS} steps as single environments', {terminations + time_outs} ends")
    try:
        make("NextStep")
    except RuntimeError as error:
        print(f"checked: NextStep: refused by TorchRL ({str(error).split('.')[0]})")


if __name__ == "__main__":
    main()
