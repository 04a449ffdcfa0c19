"""A task of one's own in one file: a narrow place on the road, in a gust.

    export PYTHONPATH=examples
    python examples/my_task.py         # drives it with LQR and draws runs/my_task.png
    python -m agents.train --env-id my_task:Mine/Gusty-v0 --algo ppo --total-timesteps 300000 --out runs/gusty
    python -m agents.evaluate --env-id my_task:Mine/Gusty-v0 --policy runs/gusty lqr zero

A law is a function of ``xp``, the namespace that it is written in: floats, ``xp``'s functions, no ``if`` on data, no
numpy. It then runs in plain Python, compiled for one car and for thousands, and on tensors. What is not said here is
the parent's. The first use checks everything; a mistake is one line that names the law.
"""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

import bicycle_env
from bicycle_env.tasks import SHARED, Bounded, CarParameters, CarState, Metric, Reference, Stabilise, replaced


class Gust(NamedTuple):
    """What an episode of this task has of its own."""

    wind_place: Any  # m along the road
    wind_force: Any  # N, to the left


@dataclasses.dataclass(frozen=True)
class Gusty(Stabilise):
    """Run straight through a narrow place while the wind blows across 20 m of the road."""

    name = "gusty"
    episode_steps = 200
    TaskState, flipped = Gust, ("wind_force",)  # in the mirror image the wind comes from the other side
    uniforms = 3
    uniform_corridor = False  # each corner of the body is judged at its own place
    ends = ("spun", "left_road", "too_far")
    rewards = {**Stabilise.rewards, "default": Bounded(lateral_weight=4.0, heading_weight=20.0, effort_weight=0.1)}  # noqa: RUF012

    road_half_width: float = 1.5  # m: a field is a keyword of gym.make

    def start(self, xp):
        def start(uniforms, world):
            lateral_position, zero = 0.3 * (2.0 * uniforms[0] - 1.0), 0.0 * uniforms[0]
            force = xp.where(uniforms[2] < 0.5, -2500.0 + zero, 2500.0 + zero)
            return CarState(zero, lateral_position, zero, zero, zero, zero, zero), Gust(
                40.0 + 20.0 * uniforms[1], force
            )

        return start

    def reference(self, xp):  # where the car should be, and the corridor: what is drawn is what is judged
        half_width = self.road_half_width

        def reference(state, task_state, world):
            zero = 0.0 * state.lateral_position
            narrow = xp.maximum(1.0 - abs(state.longitudinal_position - 80.0) / 20.0, 0.0)  # 1 in the middle of it
            return Reference(zero, zero, zero, zero, half_width * (1.0 - 0.3 * narrow))

        return reference

    def conditions(self, xp):  # the car of this moment
        pushed = replaced(xp, CarParameters, ("side_force", "yaw_moment"))

        def conditions(state, episode, time, world):
            gust = episode.task_state
            there = abs(state.longitudinal_position - gust.wind_place) < 10.0
            force = xp.where(there, gust.wind_force, 0.0)
            return pushed(world.car, force, 0.5 * force)

        return conditions

    def end(self, xp):
        usual = xp.function(super().end(xp))

        def end(state, reference, episode, world):
            code = usual(state, reference, episode, world)
            return xp.where((code == 0) & (state.longitudinal_position > 400.0), 4, code)  # 3 is an invalid action

        return end

    @property
    def metrics(self):
        def least(run):
            return float(np.min(run.steps["clearance"]))

        return (*SHARED, Metric("least_clearance", "m", "from the edge to the nearest corner of the body", least))


bicycle_env.register("Mine/Gusty-v0", Gusty)


if __name__ == "__main__":
    import gymnasium as gym

    from bicycle_env import control, plots

    env = gym.make("Mine/Gusty-v0")
    policy, (observation, _) = control.make("lqr", env.unwrapped), env.reset(seed=1)
    states, over = [env.unwrapped.state], False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        states.append(env.unwrapped.state)
        over = terminated or truncated
    plots.save(plots.episode(states, labels=["LQR"], env=env), "runs/my_task.png")
    print(f"{env.unwrapped.end or 'time'}; success: {env.unwrapped.is_success}; runs/my_task.png")
