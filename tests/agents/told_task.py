"""A tiny task whose optimum is known: every episode tells how far to steer, and pays a step later.

A step's reward is ``1 - (last command / limit - target)^2``, so that what is done pays with the next step: of STEPS
steps the first is paid for the zero before the start, and the last action for nothing. Best is the target at every
step. With targets uniform within +-1/2 the mean return is then STEPS - 1/12, of straight wheels STEPS (1 - 1/12).
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import gymnasium as gym

import bicycle_env
from bicycle_env.tasks import CarState, Entry, Reward, Stabilise

ENV_ID = "Told/Tiny-v0"
STEPS = 8
BEST, STRAIGHT = STEPS - 1.0 / 12.0, STEPS * (1.0 - 1.0 / 12.0)


class Told(NamedTuple):
    """What an episode has of its own."""

    target: Any


@dataclasses.dataclass(frozen=True)
class Obeyed(Reward):
    """For the last command, as a share of the limit."""

    def law(self, xp):
        def obeyed(state, reference, action, episode, before, end, world):
            missed = episode.front_steer_command / world.car.front_angle_limit - episode.task_state.target
            return 1.0 - missed * missed

        return obeyed


@dataclasses.dataclass(frozen=True)
class Tell(Stabilise):
    """Steer as you are told."""

    name = "told"
    episode_steps = STEPS
    TaskState, flipped, uniforms = Told, ("target",), 1
    settled_seconds = 0.0
    rewards = {**Stabilise.rewards, "default": Obeyed()}  # noqa: RUF012

    def start(self, xp):
        def start(uniforms, world):
            zero = 0.0 * uniforms[0]
            return CarState(zero, zero, zero, zero, zero, zero, zero), Told(uniforms[0] - 0.5)

        return start

    def entries(self, speed, front_limit, rear_limit):
        told = Entry("target", "", 0.5, 1.0, "of full steer at the front")
        return (*super().entries(speed, front_limit, rear_limit), told)

    def observe(self, xp):
        usual = xp.function(super().observe(xp))

        def observe(state, episode, world):
            return (*usual(state, episode, world), episode.task_state.target)

        return observe

    def success(self, xp):
        def success(state, reference, episode, world):
            command = episode.front_steer_command / world.car.front_angle_limit
            return abs(command - episode.task_state.target) < 0.1

        return success


if ENV_ID not in gym.registry:
    bicycle_env.register(ENV_ID, Tell)
