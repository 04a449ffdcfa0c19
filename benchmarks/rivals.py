"""Other ways to do the same, to be measured against: the step on numpy arrays, SB3 without an environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.tasks.control_step import transition
from bicycle_env.tasks.episode import EpisodeState, World


def numpy_step(env_id: str, num_envs: int, tire: str) -> Callable[[], Callable[[int], int]]:
    """The same laws on arrays (num_envs,), observation and random restart of ended rows included."""

    def prepare() -> Callable[[int], int]:
        env: Any = gym.make(env_id, tire=tire).unwrapped
        made, task = env.configuration, env.task
        step = transition(NUMPY, task, made.model, made.reward)
        observe, start = task.observe(NUMPY), task.start(NUMPY)
        world = World(CarParameters(*(np.float64(value) for value in made.car)), made.rules, made.settings)
        rng = np.random.default_rng(0)
        state, task_state = start(rng.random((task.uniforms, num_envs)), world)
        zero = np.zeros(num_envs)
        kept = [
            CarState(*(np.broadcast_to(value, num_envs) for value in state)),
            EpisodeState(zero, zero, zero, zero, task_state),
        ]
        scale, bound = made.observation_scale[:, None], made.observation_bound[:, None]
        actions = rng.uniform(-1.0, 1.0, (8, 2, num_envs))

        def play(count: int) -> int:
            for k in range(count):
                state, memory, _, end, _ = step(kept[0], kept[1], tuple(actions[k % 8]), world, made.substeps)
                over = (end > 0) | (memory.steps >= task.episode_steps)
                if np.any(over):
                    fresh, _ = start(rng.random((task.uniforms, num_envs)), world)
                    state = CarState(*(np.where(over, a, b) for a, b in zip(fresh, state, strict=True)))
                    memory = memory._replace(steps=np.where(over, 0.0, memory.steps))
                np.clip((np.stack(observe(state, memory, world)) / scale).astype(np.float32), -bound, bound)
                kept[:] = state, memory
            return count * num_envs

        return play

    return prepare


def sb3_ratio() -> float:
    """Steps per second of SB3's PPO with our environment over those with one that does nothing."""
    from sb3_training import ratio

    return float(ratio())
