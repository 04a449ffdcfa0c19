"""The one table of environment ids."""

from __future__ import annotations

from typing import NamedTuple

import gymnasium as gym


class Row(NamedTuple):
    """One environment id. Defaults live in the constructors: gym.make merges these keywords with the user's."""

    id: str
    entry_point: str
    vector_entry_point: str
    max_episode_steps: int


ENVIRONMENTS = (
    Row(
        "BicycleStab-v0",
        "bicycle_env.envs.bicycle_stab:BicycleStabEnv",
        "bicycle_env.envs.bicycle_stab:BicycleStabVectorEnv",
        400,
    ),
    Row(
        "BicycleLaneChange-v0",
        "bicycle_env.envs.bicycle_lane_change:BicycleLaneChangeEnv",
        "bicycle_env.envs.bicycle_lane_change:BicycleLaneChangeVectorEnv",
        300,
    ),
)


def register() -> None:
    """Register every id that is not registered yet."""
    for row in ENVIRONMENTS:
        if row.id not in gym.registry:
            gym.register(
                row.id,
                entry_point=row.entry_point,
                vector_entry_point=row.vector_entry_point,
                max_episode_steps=row.max_episode_steps,
            )
