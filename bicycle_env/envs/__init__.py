"""Gymnasium environments over the tasks and the physics."""

from bicycle_env.envs.bicycle_active_steer import BicycleActiveSteerEnv
from bicycle_env.envs.bicycle_double_lane_change import BicycleDoubleLaneChangeEnv
from bicycle_env.envs.bicycle_evade import BicycleEvadeEnv
from bicycle_env.envs.bicycle_lane_change import BicycleLaneChangeEnv
from bicycle_env.envs.bicycle_stab import BicycleStabEnv
from bicycle_env.envs.tensors.jax_env import JaxEnv
from bicycle_env.envs.tensors.torch_vector_env import TorchVectorEnv

__all__ = [
    "BicycleActiveSteerEnv",
    "BicycleDoubleLaneChangeEnv",
    "BicycleEvadeEnv",
    "BicycleLaneChangeEnv",
    "BicycleStabEnv",
    "JaxEnv",
    "TorchVectorEnv",
]
