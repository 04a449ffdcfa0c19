"""What the tests of the vector environment share: combinations, actions, and cars alone to hold its rows against."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from bicycle_env.registration import ENVIRONMENTS

IDS = [row.id for row in ENVIRONMENTS]
STAB, LANE_CHANGE, ACTIVE = "BicycleStab-v0", "BicycleLaneChange-v0", "BicycleActiveSteer-v0"
DOUBLE_LANE_CHANGE, EVADE = "BicycleDoubleLaneChange-v0", "BicycleEvade-v0"
FEW, MANY = 11, 190
"""Rows in short and in long blocks, the last block not full."""
TIME_LIMIT = 60
MODES = ("NextStep", "SameStep", "Disabled")


class Combination(NamedTuple):
    """What the compiled code depends on; steer, telemetry and autoreset mode are free beside it."""

    id: str
    tire: str
    geometry: str
    reward: str
    num_envs: int
    varied: bool


COMBINATIONS = [
    Combination(STAB, "linear", "small_angle", "default", FEW, False),
    Combination(LANE_CHANGE, "linear", "exact", "quadratic", MANY, True),
    Combination(STAB, "tanh", "small_angle", "quadratic", MANY, False),
    Combination(LANE_CHANGE, "tanh", "exact", "default", FEW, True),
    Combination(STAB, "fiala", "exact", "default", FEW, False),
    Combination(LANE_CHANGE, "fiala", "small_angle", "quadratic", MANY, True),
    Combination(STAB, "magic_formula", "exact", "quadratic", FEW, True),
    Combination(LANE_CHANGE, "magic_formula", "small_angle", "default", MANY, False),
    Combination(ACTIVE, "fiala", "exact", "default", FEW, True),
    Combination(ACTIVE, "tanh", "small_angle", "quadratic", MANY, False),
    Combination(EVADE, "fiala", "exact", "default", FEW, True),
    Combination(EVADE, "linear", "small_angle", "quadratic", MANY, False),
]
PAIRWISE = 8
"""Every pair of values of two columns stands in one of so many first rows; compiling all 128 would take minutes."""


def compiled(env_id, num_envs=None):
    """Keywords where the law does not matter: a kind that the combinations compile, too; for one car without num_envs.

    Of the change of lane, the one in blocks of 8, whose cars have numbers of their own: here the same for each.
    """
    if env_id != LANE_CHANGE:
        return {}
    return {"tire": "tanh"} | ({} if num_envs is None else {"friction": np.ones(num_envs)})


def some_rows(num_envs):
    """Rows at both ends of blocks of 8 and 64 cars."""
    return [row for row in (0, 7, 8, 10, 63, 64, 189) if row < num_envs]


def keywords_of(combination):
    """``(shared, own)``: keywords of gym.make and gym.make_vec, and those that each car has its own of."""
    shared = {name: getattr(combination, name) for name in ("tire", "geometry", "reward")}
    number = combination.num_envs
    own = {
        "vehicle": [("oversteer", "me303")[row % 2] for row in range(number)],
        "speed_ratio": np.linspace(1.05, 1.5, number),
        "friction": np.linspace(0.6, 1.1, number)[::-1],
    }
    return shared, own if combination.varied else {}


def actions_for(env, steps, seed=0):
    """(steps, num_envs, axles) float32: random walks, some beyond [-1, 1], that spin some cars and not others."""
    rng = np.random.default_rng(seed)
    jumps = rng.uniform(-0.4, 0.4, (steps, *env.action_space.shape))
    return np.clip(np.cumsum(jumps, axis=0), -1.3, 1.3).astype(np.float32)


class Outcome(NamedTuple):
    """What one step or reset says about one car."""

    observation: bytes
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]
    final: "Outcome | None"


class Alone:
    """A single environment with the autoreset of Gymnasium's vector environments."""

    def __init__(self, env, mode):
        self.env, self.mode, self.over = env, mode, False

    @staticmethod
    def first(env_id, seeds, resets):
        """The observation after the last of some resets."""
        env = gym.make(env_id, **compiled(env_id))
        env.reset(seed=seeds)
        return [env.reset()[0] for _ in range(resets - 1)][-1]

    def reset(self, **keywords):
        observation, info = self.env.reset(**keywords)
        self.over = False
        return Outcome(observation.tobytes(), 0.0, False, False, info, None)

    def step(self, action):
        if self.over and self.mode == "NextStep":
            return self.reset()
        observation, reward, terminated, truncated, info = self.env.step(action)
        seen = Outcome(observation.tobytes(), reward, terminated, truncated, info, None)
        self.over = terminated or truncated
        if self.over and self.mode == "SameStep":
            fresh = self.reset()
            seen = seen._replace(observation=fresh.observation, info=fresh.info, final=seen)
        return seen


def row_of(env, row, observation, info, reward=None, terminated=None, truncated=None):
    """The outcome of one row of the vector environment, its codes as words."""
    final = None
    if "final_obs" in info and info["_final_obs"][row]:
        assert info["_final_info"][row]
        final_info = {name: value for name, value in info["final_info"].items() if not name.startswith("_")}
        assert all(info["final_info"][f"_{name}"][row] for name in final_info)
        ended = (reward[row].item(), bool(terminated[row]), bool(truncated[row]))
        final = Outcome(info["final_obs"][row].tobytes(), *ended, _words(env, row, final_info), None)
    present = {name: value for name, value in info.items() if name[0] != "_" and not name.startswith("final_")}
    assert all(info[f"_{name}"][row] for name in present)
    values = (
        (0.0, False, False) if reward is None else (reward[row].item(), bool(terminated[row]), bool(truncated[row]))
    )
    return Outcome(observation[row].tobytes(), *values, _words(env, row, present), final)


def _words(env, row, info):
    return {name: env.end_names[value[row]] if name == "end" else value[row].item() for name, value in info.items()}


def make_alone(combination, row, mode="NextStep", max_episode_steps=TIME_LIMIT, **keywords):
    """Row `row` of :func:`make_many` as a single environment."""
    shared, own = keywords_of(combination)
    mine = {name: value[row] for name, value in own.items()}
    return Alone(gym.make(combination.id, max_episode_steps=max_episode_steps, **shared, **mine, **keywords), mode)


def make_many(combination, max_episode_steps=TIME_LIMIT, **keywords):
    shared, own = keywords_of(combination)
    given = {"num_envs": combination.num_envs, "max_episode_steps": max_episode_steps, **shared, **own, **keywords}
    return gym.make_vec(combination.id, **given)


def everything(env):
    """All that the future depends on."""
    snapshot = env.snapshot()
    return record([snapshot.rows]), repr(snapshot.generators)


def record(results):
    """All bytes that a reset or a step gave."""
    parts = []
    for item in results:
        if isinstance(item, dict):
            parts += [name.encode() + record([item[name]]) for name in sorted(item)]
        else:
            parts.append(item.tobytes())
    return b"|".join(parts)


def drive(env, actions):
    """The bytes of every step."""
    return [record(env.step(action)) for action in actions]
