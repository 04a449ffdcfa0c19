"""Whether an environment keeps what all of them promise: what ``bicycle_env.check_task`` tries."""

from __future__ import annotations

import importlib.util
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from bicycle_env.envs.many.blocks import KEPT
from bicycle_env.installation import needs
from bicycle_env.physics.car import CarState
from bicycle_env.physics.validation import whole

TOLERANCE = 1e-12
"""Of a step on tensors against the compiled one, per max(1, |number|)."""


def check_task(env_id: str, cars: int, seed: int, keywords: Mapping[str, Any]) -> tuple[str, ...]:
    """See :func:`bicycle_env.check_task`."""
    cars, seed = whole("cars", cars), whole("seed", seed, 0)
    alone = [gym.make(env_id, **keywords) for _ in range(cars)]
    many: Any = gym.make_vec(env_id, cars, autoreset_mode="Disabled", **keywords)
    rng = np.random.default_rng(seed)
    jumps = rng.uniform(-0.4, 0.4, (many.unwrapped.max_episode_steps or 400, *many.action_space.shape))
    actions = np.clip(np.cumsum(jumps, axis=0), -1.3, 1.3).astype(np.float32)
    tried: dict[str, Callable[[], str]] = {
        "one car and many": lambda: _one_and_many(alone, many, actions, seed),
        "tensors": lambda: _tensors(env_id, keywords, many, actions, seed),
        "mirror image": lambda: _mirror_image(alone, gym.make(env_id, **keywords), actions, seed),
        "rendering": lambda: _rendering(env_id, keywords, actions[:, 0], seed),
    }
    return tuple(f"{env_id}: {name}: {_found(env_id, name, trial)}" for name, trial in tried.items())


def _found(env_id: str, name: str, trial: Callable[[], str]) -> str:
    try:
        return trial()
    except Exception as error:
        raise ValueError(f"{env_id}: {name}: {str(error) or type(error).__name__}") from error


def _same(what: str, step: int, car: int, one: Any, other: Any, tolerance: float = 0.0) -> None:
    """ValueError unless two values are the same, to a tolerance per max(1, |value|)."""
    near = abs(np.subtract(one, other)) <= tolerance * np.maximum(1.0, np.abs(one)) if tolerance else one == other
    if not np.all(near):
        raise ValueError(f"{what} of car {car} after {step} steps is {other!r} in place of {one!r}")


def _one_and_many(alone: list[Any], many: Any, actions: NDArray[np.float32], seed: int) -> str:
    names, steps = many.unwrapped.end_names, 0
    observations, info = many.reset(seed=seed)
    running = {row: env.reset(seed=seed + row) for row, env in enumerate(alone)}
    ends: Counter[str] = Counter()
    for k, action in enumerate(actions):
        for row, (observation, told) in running.items():
            _same("observation", k, row, observation.tolist(), observations[row].tolist())
            for name, value in told.items():
                given = names[info["end"][row]] if name == "end" else info[name][row].item()
                _same(f"info[{name!r}]", k, row, value, given)
            _same("state", k, row, alone[row].unwrapped.state, tuple(float(x[row]) for x in many.unwrapped.state))
        if not running:
            break
        observations, rewards, terminated, truncated, info = many.step(action)
        for row in list(running):
            observation, reward, *flags, told = alone[row].step(action[row])
            _same("reward", k + 1, row, reward, rewards[row].item())
            _same("(terminated, truncated)", k + 1, row, flags, [bool(terminated[row]), bool(truncated[row])])
            running[row] = observation, told
            steps += 1
            if any(flags):
                ends[told["end"] or "time"] += 1
                del running[row]
    told_ends = ", ".join(f"{word} {count}" for word, count in sorted(ends.items()))
    return f"the same to the bit in {steps} steps of {len(alone)} cars (ends: {told_ends})"


def _tensors(env_id: str, keywords: Mapping[str, Any], many: Any, actions: NDArray[np.float32], seed: int) -> str:
    if importlib.util.find_spec("torch") is None:
        return f"not tried: {needs('TorchVectorEnv', 'torch', 'agents')}"
    import torch

    from bicycle_env.envs.tensors.torch_vector_env import TorchVectorEnv

    tensors = TorchVectorEnv(env_id, len(actions[0]), autoreset_mode="Disabled", **keywords)
    many.reset(seed=seed)
    tensors.reset(seed=seed)
    over, steps = np.zeros(len(actions[0]), bool), 0
    for k, action in enumerate(actions):
        if np.all(over):
            break
        # Each step from the same state: a car that is unstable magnifies what the steps before have rounded.
        tensors.set_state({name: torch.from_numpy(column) for name, column in many.unwrapped.state._asdict().items()})
        _, rewards, terminated, truncated, info = many.step(action)
        _, gained, *_, told = tensors.step(torch.from_numpy(action))
        columns = {"reward": (rewards, gained), "end": (info["end"], told["end"]), "cost": (info["cost"], told["cost"])}
        here, there = many.unwrapped.state, tensors.state
        columns |= {name: (getattr(here, name), getattr(there, name)) for name in here._fields}
        for row in np.flatnonzero(~over).tolist():
            for name, (one, other) in columns.items():
                _same(name, k + 1, row, one[row].item(), other[row].item(), TOLERANCE)
            steps += 1
        over |= terminated | truncated
    return f"the same to {TOLERANCE:g} in {steps} steps"


def _mirror_image(alone: list[Any], image: Any, actions: NDArray[np.float32], seed: int) -> str:
    plant = alone[0].unwrapped
    if plant.task.flipped is None:
        return "not tried: the task has none (flipped = None)"
    odd = {*CarState._fields[1:], *plant.model.own, *KEPT[:2], *plant.task.flipped}
    names = (*plant.model.State._fields, *KEPT, "end", *plant.task.TaskState._fields)
    signs, steps = np.array([-1.0 if name in odd else 1.0 for name in names]), 0
    for row, env in enumerate(alone):
        env.reset(seed=seed + row)
        image.reset(seed=seed + row)
        start = env.unwrapped.snapshot()
        reflection = image.unwrapped.restore(start._replace(episode=start.episode * signs))
        observation = env.unwrapped.restore(start)
        for k, action in enumerate(actions[:, row]):
            _same(
                "mirrored observation", k, row, (plant.observation_mirror * observation).tolist(), reflection.tolist()
            )
            observation, *this = env.step(action)
            reflection, *that = image.step(-action)
            _same("mirrored (reward, terminated, truncated)", k + 1, row, this[:3], that[:3])
            _same("mirrored end", k + 1, row, this[3]["end"], that[3]["end"])
            steps += 1
            if this[1] or this[2]:
                break
    return f"exact in {steps} steps"


def _rendering(env_id: str, keywords: Mapping[str, Any], actions: NDArray[np.float32], seed: int) -> str:
    if importlib.util.find_spec("pygame") is None:
        return f"not tried: {needs('rendering', 'pygame-ce', 'render')}"
    env = gym.make(env_id, render_mode="rgb_array", **keywords)
    env.reset(seed=seed)
    over, frames = False, 0
    for action in actions:
        if over:
            break
        _, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
        if over or frames == 0:
            frames += env.render() is not None
    env.close()
    return f"{frames} pictures"
