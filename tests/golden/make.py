"""Write the frozen rollouts that tests/tasks/test_golden_rollouts.py compares with.

    python tests/golden/make.py

Run it after a change that is meant to change the numbers, and say so in the commit.
"""

import json
import math
from pathlib import Path

import gymnasium as gym
import numpy as np

import bicycle_env  # noqa: F401  (registers the environments)
from bicycle_env.control import make
from bicycle_env.registration import ENVIRONMENTS

FILE = Path(__file__).parent / "rollouts.json"
EVERY = 25
SEED = 3


def feedback(env_id):
    """The LQR of an environment as one matrix (observation entries, axles), rounded: plain numbers on any machine."""
    plant = gym.make(env_id).unwrapped
    if "driver_command" in plant.observation_names:  # the rear wheels by the yaw rate and what the driver does
        by_name = {"yaw_rate": [1.5], "front_steer": [-0.4]}
        return [by_name.get(name, [0.0]) for name in plant.observation_names]
    policy = make("lqr", plant)
    probes = 1e-3 * np.eye(len(plant.observation_names))
    matrix = [[round(float(value) * 1e3, 3) for value in policy.act(probe)] for probe in probes]
    if "side" in plant.observation_names:  # half way into the other lane, so that the episode is a whole one
        place = plant.observation_names.index("lateral_position")
        matrix[plant.observation_names.index("side")] = [round(-2.5 * value, 3) for value in matrix[place]]
    return matrix


def rollout(env_id, seed, matrix):
    """An episode with u = clip(o'M): every 25 steps what was seen, the state, and the return so far.

    The products are summed exactly (math.fsum), so that no BLAS decides a digit.
    """
    env = gym.make(env_id)
    observation, info = env.reset(seed=seed)
    frames, total, steps, over = [], 0.0, 0, False
    while True:
        if steps % EVERY == 0 or over:
            frames.append(
                {
                    "step": steps,
                    "observation": [float(value) for value in observation],
                    "state": list(env.unwrapped.state),
                    "return": total,
                    "end": info["end"],
                }
            )
        if over:
            return frames
        seen = [float(value) for value in observation]
        action = [
            min(max(math.fsum(value * row[axle] for value, row in zip(seen, matrix, strict=True)), -1.0), 1.0)
            for axle in range(len(matrix[0]))
        ]
        observation, reward, terminated, truncated, info = env.step(np.array(action))
        total += reward
        steps += 1
        over = terminated or truncated


def main():
    golden = {}
    for row in ENVIRONMENTS:
        matrix = feedback(row.id)
        golden[row.id] = {"seed": SEED, "feedback": matrix, "frames": rollout(row.id, SEED, matrix)}
    FILE.write_text(json.dumps(golden, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
