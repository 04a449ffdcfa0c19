"""Rollouts whose bits are the same on every processor: what tests/bits/test_bits.py compares with hashes.json.

    python tests/bits/rollouts.py                            # prints the hashes of all rollouts, each in all its forms
    python tests/bits/rollouts.py --only 0 4 --forms single 64
    python tests/bits/rollouts.py --write                    # freezes them, after a change that is meant to change bits

A rollout is four cars with recorded actions over many episodes. Its forms drive the same four: each alone (`single`),
or as the first rows of a vector environment in blocks of 4, 8 or 64. All must give one hash.
"""

import argparse
import gc
import hashlib
import json
import sys
from pathlib import Path
from typing import NamedTuple

import gymnasium as gym
import numpy as np

import bicycle_env  # noqa: F401  (registers the environments)
from bicycle_env.envs.many.blocks import best_length

FILE = Path(__file__).parent / "hashes.json"
STAB, LANE_CHANGE, ACTIVE = "BicycleStab-v0", "BicycleLaneChange-v0", "BicycleActiveSteer-v0"
DOUBLE_LANE_CHANGE, EVADE = "BicycleDoubleLaneChange-v0", "BicycleEvade-v0"
CARS, STEPS, TIME_LIMIT, SEED = 4, 400, 60, 20
BLOCKS = (4, 8, 64)
OWN_LIMIT = {ACTIVE: 100, EVADE: 200}
"""Beyond the twin's judgement; the obstacle comes late."""


class Rollout(NamedTuple):
    """What the compiled code depends on."""

    id: str
    tire: str
    geometry: str
    reward: str
    varied: bool
    """Each car has its own vehicle, speed and friction."""
    dtype: str = "float64"

    @property
    def forms(self):
        return tuple(map(str, BLOCKS)) if self.dtype == "float32" else ("single", *map(str, BLOCKS))


ROLLOUTS = [
    # Every pair of values of two columns stands in one of these eight: the combinations of tests/contracts.
    Rollout(STAB, "linear", "small_angle", "default", False),
    Rollout(LANE_CHANGE, "linear", "exact", "quadratic", True),
    Rollout(STAB, "tanh", "small_angle", "quadratic", False),
    Rollout(LANE_CHANGE, "tanh", "exact", "default", True),
    Rollout(STAB, "fiala", "exact", "default", False),
    Rollout(LANE_CHANGE, "fiala", "small_angle", "quadratic", True),
    Rollout(STAB, "magic_formula", "exact", "quadratic", True),
    Rollout(LANE_CHANGE, "magic_formula", "small_angle", "default", False),
    # The opposite of each: the other task, geometry and reward.
    Rollout(LANE_CHANGE, "linear", "small_angle", "quadratic", False),
    Rollout(STAB, "linear", "exact", "default", True),
    Rollout(LANE_CHANGE, "tanh", "small_angle", "default", True),
    Rollout(STAB, "tanh", "exact", "quadratic", False),
    Rollout(LANE_CHANGE, "fiala", "exact", "quadratic", True),
    Rollout(STAB, "fiala", "small_angle", "default", False),
    Rollout(LANE_CHANGE, "magic_formula", "exact", "default", False),
    Rollout(STAB, "magic_formula", "small_angle", "quadratic", True),
    # Single precision.
    Rollout(STAB, "linear", "small_angle", "default", False, "float32"),
    Rollout(LANE_CHANGE, "tanh", "exact", "default", True, "float32"),
    Rollout(STAB, "fiala", "exact", "default", False, "float32"),
    Rollout(LANE_CHANGE, "magic_formula", "small_angle", "quadratic", True, "float32"),
    # A corridor that is not the same beside the whole body.
    Rollout(DOUBLE_LANE_CHANGE, "fiala", "exact", "default", False),
    Rollout(DOUBLE_LANE_CHANGE, "magic_formula", "small_angle", "quadratic", True),
    Rollout(DOUBLE_LANE_CHANGE, "fiala", "exact", "default", False, "float32"),
    # A companion beside the car, and draws of its own.
    Rollout(ACTIVE, "fiala", "exact", "default", False),
    Rollout(ACTIVE, "tanh", "small_angle", "quadratic", True),
    Rollout(ACTIVE, "magic_formula", "exact", "default", True, "float32"),
    # A corridor that changes along the road, hidden friction, five points along each side.
    Rollout(EVADE, "fiala", "exact", "default", False),
    Rollout(EVADE, "tanh", "small_angle", "quadratic", True),
    Rollout(EVADE, "magic_formula", "exact", "default", True, "float32"),
]
OWN = {
    "vehicle": ("oversteer", "me303", "oversteer", "civic"),
    "speed": (43.3, 38.5, 52.25, 31.0),
    "friction": (1.0, 0.6, 0.85, 0.4),
}
SPEED = 43.3


def recorded_actions():
    """(STEPS, CARS, 2) float32: random walks from the generator's raw bits, exact in every operation."""
    raw = np.random.PCG64(SEED).random_raw(STEPS * CARS * 2) >> np.uint64(59)  # 0 to 31
    jumps = (raw.astype(np.int64) * 2 - 31).reshape(STEPS, CARS, 2)
    walk = np.zeros((CARS, 2), dtype=np.int64)
    actions = np.empty((STEPS, CARS, 2), dtype=np.float32)
    for k, jump in enumerate(jumps):
        walk = np.clip(walk + jump, -90, 90)
        actions[k] = walk / 64
    return actions


def keywords_of(rollout):
    """``(shared, own)``: of all cars, and per car."""
    shared = {
        "tire": rollout.tire,
        "geometry": rollout.geometry,
        "reward": rollout.reward,
        "max_episode_steps": OWN_LIMIT.get(rollout.id, TIME_LIMIT),
        "steer": "both",
    }
    return (shared, OWN) if rollout.varied else ({**shared, "speed": SPEED}, {})


def as_bytes(*values):
    """-0.0 counts as 0.0."""
    return b"".join((np.asarray(value) + np.asarray(value).dtype.type(0)).tobytes() for value in values)


class Record(NamedTuple):
    """What came of a rollout."""

    hash: str
    rewards: np.ndarray
    """(STEPS, CARS)."""
    ends: set
    """The words of the ends that came up, and "time-out"."""


def alone(rollout):
    """The four cars one by one, each with the autoreset of NextStep."""
    shared, own = keywords_of(rollout)
    actions, rows, rewards, ends = recorded_actions(), [], np.zeros((STEPS, CARS)), set()
    for row in range(CARS):
        env = gym.make(rollout.id, **shared, **{name: values[row] for name, values in own.items()})
        observation, _ = env.reset(seed=SEED + row)
        parts, over = [as_bytes(observation)], False
        for k in range(STEPS):
            if over:
                observation, info = env.reset()
                reward, terminated, truncated = 0.0, False, False
            else:
                observation, reward, terminated, truncated, info = env.step(actions[k, row])
            over = terminated or truncated
            rewards[k, row] = reward
            ends |= {info["end"], "time-out" if truncated else ""}
            parts.append(as_bytes(observation, np.float64(reward), np.uint8(terminated), np.uint8(truncated)))
            parts.append(info["end"].encode())
        rows.append(b"".join(parts))
    return Record(_hash(rows), rewards, ends)


def together(rollout, block):
    """The four cars as the first rows of a vector environment in blocks of so many."""
    if best_length(block) != block:
        raise ValueError(f"{block} cars do not lie in blocks of {block}")
    shared, own = keywords_of(rollout)
    own = {name: [values[row % CARS] for row in range(block)] for name, values in own.items()}
    env = gym.make_vec(rollout.id, block, dtype=rollout.dtype, **shared, **own)
    actions, rewards, ends = recorded_actions(), np.zeros((STEPS, CARS)), set()
    observation, _ = env.reset(seed=SEED)
    rows = [[as_bytes(observation[row])] for row in range(CARS)]
    for k in range(STEPS):
        repeated = np.tile(actions[k], (block // CARS, 1))
        observation, reward, terminated, truncated, info = env.step(repeated)
        for row in range(CARS):
            end = env.unwrapped.end_names[info["end"][row]]
            ends |= {end, "time-out" if truncated[row] else ""}
            flags = np.uint8(terminated[row]), np.uint8(truncated[row])
            rows[row] += [as_bytes(observation[row], np.float64(reward[row]), *flags), end.encode()]
        rewards[k] = reward[:CARS]
    return Record(_hash([b"".join(row) for row in rows]), rewards, ends)


def _hash(rows):
    return hashlib.sha256(b"|".join(rows)).hexdigest()[:32]


def record(rollout, form):
    return alone(rollout) if form == "single" else together(rollout, int(form))


def name_of(rollout):
    return "-".join((*rollout[:4], "own" if rollout.varied else "alike", rollout.dtype))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", type=int, nargs="*", default=range(len(ROLLOUTS)), help="numbers of rollouts")
    parser.add_argument("--forms", nargs="*", default=("single", *map(str, BLOCKS)), help="single, 4, 8, 64")
    parser.add_argument("--write", action="store_true", help=f"write {FILE.name}")
    options = parser.parse_args()
    gc.disable()  # the compiler makes much, and most of it is kept
    found = {}
    for number in options.only:
        rollout = ROLLOUTS[number]
        hashes = {form: record(rollout, form).hash for form in rollout.forms if form in options.forms}
        found[name_of(rollout)] = hashes
    if not options.write:
        json.dump(found, sys.stdout, indent=1)
        return
    different = [name for name, hashes in found.items() if len(set(hashes.values())) != 1]
    if different:
        sys.exit(f"not written: one car is not one of many in {', '.join(different)}")
    frozen = {name: next(iter(hashes.values())) for name, hashes in found.items()}
    kept = json.loads(FILE.read_text(encoding="utf-8")) if "--only" in sys.argv else {}
    FILE.write_text(json.dumps({**kept, **frozen}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
