"""Cars for the tests of the torch environment."""

import numpy as np
import torch
from combinations import ON_ROADS

from bicycle_env.envs import TorchVectorEnv

torch.set_num_threads(1)

STAB, LANE = "BicycleStab-v0", "BicycleLaneChange-v0"
IDS = list(ON_ROADS)
OPTIONS = {LANE: ("direction", "change_start"), "BicycleDoubleLaneChange-v0": ("direction",)}
MODES = ("SameStep", "NextStep", "Disabled")
CARS = 40
BEYOND = {
    "longitudinal_position": 150.0,
    "lateral_position": 9.0,
    "heading": 1.6,
    "lateral_velocity": 40.0,
    "yaw_rate": 5.0,
    "front_steer": 0.1,
    "rear_steer": 0.05,
    "front_steer_command": 0.1,
    "rear_steer_command": 0.05,
}
"""Half-widths of the widest states, beyond every limit."""
STILL = dict.fromkeys(BEYOND, 0.0)


def known(env_id, **options):
    """Those of some options, or numbers of the task's state, that the task has."""
    return {name: options[name] for name in OPTIONS.get(env_id, ())}


def quick(num_envs=4, env_id=STAB, **keywords):
    """The law with the fewest operations, and few of them a step, where the law does not matter."""
    fewest = {"tire": "linear", "geometry": "small_angle", "physics_timestep": 0.02}
    return TorchVectorEnv(env_id, num_envs, **{**fewest, **keywords})


def random_states(count=CARS, seed=3):
    rng = np.random.default_rng(seed)
    width = np.linspace(0.02, 1.0, count)  # from straight running to the end of an episode
    states = {name: most * width * rng.uniform(-1.0, 1.0, count) for name, most in BEYOND.items()}
    states["longitudinal_position"] = abs(states["longitudinal_position"])
    return states


def random_actions(count=CARS, axles=2, seed=4):
    return np.random.default_rng(seed).uniform(-1.3, 1.3, (count, axles)).astype(np.float32)


def row_of(values, row):
    return {name: float(column[row]) for name, column in values.items()}


def zeros(envs):
    return torch.zeros(envs.num_envs, envs.single_action_space.shape[0])


def assert_near(tensor, expected, tolerance=1e-12):
    expected = np.asarray(expected, dtype=float)
    np.testing.assert_array_less(
        np.abs(tensor.numpy() - expected), tolerance * np.maximum(1.0, np.abs(expected)) + 1e-300
    )


def assert_same_bits(these, those):
    """Nested tuples and mappings of tensors."""
    assert type(these) is type(those)
    if isinstance(these, dict):
        assert these.keys() == those.keys()
        these, those = tuple(these.values()), tuple(those.values())
    if isinstance(these, (tuple, list)):
        for one, other in zip(these, those, strict=True):
            assert_same_bits(one, other)
    else:
        assert these.dtype == those.dtype
        assert torch.equal(these, those)
