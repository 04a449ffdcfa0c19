"""A reward of one's own: another one for a task of the package, from a script.

python examples/my_reward.py       # the return of LQR under it, for 64 cars
"""

import dataclasses

import gymnasium as gym
import numpy as np

import bicycle_env  # noqa: F401 (registers the environments)
from bicycle_env import control
from bicycle_env.tasks import Reward


@dataclasses.dataclass(frozen=True)
class Alive(Reward):
    """1 for a step in the lane, less what the tires slide: sideslip beyond a tenth of a radian costs."""

    price: float = 5.0  # per rad: a constant of the compiled code

    def law(self, xp):
        price = self.price

        def alive(state, reference, action, episode, before, end, world):
            sideslip = abs(state.lateral_velocity) / world.car.speed
            return xp.where(end > 0, 0.0 * sideslip, 1.0 - price * xp.maximum(sideslip - 0.1, 0.0))

        return alive


if __name__ == "__main__":
    envs = gym.make_vec("BicycleStab-v0", num_envs=64, reward=Alive(price=2.0), autoreset_mode="Disabled")
    policy = control.make("lqr", gym.make("BicycleStab-v0"))
    observations, _ = envs.reset(seed=0)
    total, over = np.zeros(64), np.zeros(64, bool)
    while not over.all():
        observations, rewards, terminated, truncated, _ = envs.step(policy.act(observations))
        total += np.where(over, 0.0, rewards)
        over |= terminated | truncated
    print(f"LQR: mean return {total.mean():.1f} of at most 400; {envs.unwrapped.is_success.mean():.0%} saved")
