"""All that a Stable-Baselines3 training's future depends on, as plain arrays. SB3's private names stand here only.

SB3 cannot enter a rollout again, so a state is taken where one starts: see :func:`algorithm`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import stable_baselines3 as sb3
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.type_aliases import RolloutReturn

from agents import generators, state_arrays
from agents.state_arrays import ANY, MOMENTS, Arrays, State
from bicycle_env.envs.many.vector_env import VectorSnapshot

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": sb3.PPO, "sac": sb3.SAC, "td3": sb3.TD3}
BUFFER_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
COUNTERS = ("num_timesteps", "_episode_num", "_n_updates")
LONGEST_STATISTICS = 10_000  # episodes in SB3's windows
NO_SNAPSHOT = "the environment has no snapshot"


def algorithm(name: str) -> type[BaseAlgorithm]:
    """The SB3 class, which before each rollout calls its attribute ``at_rollout`` and ends `learn` if that gives False.

    Nothing has been drawn for the rollout there, and the last update is complete.
    """

    class WithBoundary(ALGORITHMS[name]):  # type: ignore[misc]
        at_rollout: Callable[[], bool] | None = None

        def collect_rollouts(self, *arguments: Any, **keywords: Any) -> Any:
            if self.at_rollout is not None and not self.at_rollout():
                off_policy = isinstance(self, OffPolicyAlgorithm)
                return RolloutReturn(0, 0, continue_training=False) if off_policy else False
            return super().collect_rollouts(*arguments, **keywords)

    WithBoundary.__name__ = ALGORITHMS[name].__name__
    return WithBoundary


def collect(model: BaseAlgorithm) -> State:
    """The state of a model between two rollouts, as arrays by name; those of the environment only if it can tell."""
    state = state_arrays.of_process()
    state["action_space"] = generators.rows([model.action_space.np_random.bit_generator.state])
    state["counters"] = np.array([getattr(model, name) for name in COUNTERS], np.int64)
    state["progress_remaining"] = np.array([model._current_progress_remaining], np.float64)
    state |= state_arrays.of_tensors(_tensors(model))
    for name, optimizer in _optimizers(model).items():
        state |= state_arrays.of_adam(name, optimizer)
    if isinstance(model, OffPolicyAlgorithm):
        buffer: Any = model.replay_buffer
        state["buffer.place"] = np.array([buffer.pos, buffer.full], np.int64)
        for name in BUFFER_ARRAYS:
            state[f"buffer.{name}"] = getattr(buffer, name)[: buffer.size()].copy()
    episodes = model.ep_info_buffer or []
    state["episodes.r"] = np.array([episode["r"] for episode in episodes], np.float32)
    state["episodes.l"] = np.array([episode["l"] for episode in episodes], np.int32)
    state["episodes.t"] = np.array([episode["t"] for episode in episodes], np.float64)
    state["episodes.success"] = np.array(model.ep_success_buffer or [], np.bool_)
    monitor: Any = model.get_env()
    snapshot = _snapshot(model)
    if snapshot is not None:
        state |= state_arrays.of_cars(snapshot)
        state["env.observation"] = np.array(model._last_obs, np.float32)
        state["env.episode_starts"] = np.array(model._last_episode_starts, np.bool_)
        state["monitor.returns"] = monitor.episode_returns.copy()
        state["monitor.lengths"] = monitor.episode_lengths.copy()
        state["monitor.count"] = np.array([monitor.episode_count], np.int64)
    return state


def most_bytes(model: BaseAlgorithm) -> int:
    """What the arrays of a state of this model can have at most: an upper bound, to be asked before one is read."""
    numbers = 8 * sum(tensor.numel() for tensor in _tensors(model).values()) * (1 + len(MOMENTS))
    if isinstance(model, OffPolicyAlgorithm):
        numbers += sum(getattr(model.replay_buffer, name).nbytes for name in BUFFER_ARRAYS)
    return numbers + model.n_envs * 8 * 1000 + LONGEST_STATISTICS * 32 + 2_000_000


def put(model: BaseAlgorithm, arrays: Arrays) -> bool:
    """Put a state into a fresh model that is made alike; gives whether the environment's state was in it, too.

    Raises:
        ValueError: an array is missing, has another shape or type than this model's, or a value that cannot be.
    """
    take = arrays.take
    counters = take("counters", np.int64, len(COUNTERS))
    if np.any(counters < 0):
        raise ValueError("'counters' must not be negative")
    for name, value in zip(COUNTERS, counters.tolist(), strict=True):
        setattr(model, name, value)
    model._current_progress_remaining = float(take("progress_remaining", np.float64, 1)[0])
    state_arrays.put_tensors(_tensors(model), arrays)
    for name, optimizer in _optimizers(model).items():
        state_arrays.put_adam(name, optimizer, arrays)
    if isinstance(model, OffPolicyAlgorithm):
        _put_buffer(model.replay_buffer, take)
    _put_episodes(model, take)
    with_env = "env.rows" in arrays
    if with_env:
        _put_env(model, arrays)
    (model.action_space.np_random.bit_generator.state,) = generators.from_rows(take("action_space", np.uint64, 1, 6))
    state_arrays.put_process(arrays)
    arrays.end()
    return with_env


def finite(model: BaseAlgorithm) -> bool:
    """Whether all of the networks' numbers are."""
    return all(bool(torch.isfinite(tensor).all()) for tensor in _tensors(model).values())


def _tensors(model: BaseAlgorithm) -> dict[str, torch.Tensor]:
    """All weights, target networks included; SAC's entropy coefficient stands outside of its networks."""
    found = {f"policy.{name}": tensor for name, tensor in model.policy.state_dict().items()}
    entropy = getattr(model, "log_ent_coef", None)
    return found if entropy is None else found | {"log_ent_coef": entropy}


def _optimizers(model: BaseAlgorithm) -> dict[str, torch.optim.Optimizer]:
    found: dict[str, torch.optim.Optimizer] = {}
    for name in model._get_torch_save_params()[0]:
        owner: Any = model
        for part in name.split("."):
            owner = getattr(owner, part)
        if isinstance(owner, torch.optim.Optimizer):
            found[f"optimizer.{name}"] = owner
    return found


def _snapshot(model: BaseAlgorithm) -> VectorSnapshot | None:
    env: Any = model.get_env()
    if model._last_obs is None:
        return None
    try:
        snapshot: VectorSnapshot = env.snapshot()
    except AttributeError:
        return None
    return snapshot


def _put_buffer(buffer: Any, take: Callable[..., NDArray[Any]]) -> None:
    place, full = take("buffer.place", np.int64, 2).tolist()
    if not 0 <= place < buffer.buffer_size or full not in (0, 1):
        raise ValueError(f"'buffer.place' must lie in the buffer of {buffer.buffer_size} steps, is {place}")
    buffer.pos, buffer.full = place, bool(full)
    for name in BUFFER_ARRAYS:
        whole = getattr(buffer, name)
        whole[: buffer.size()] = take(f"buffer.{name}", whole.dtype, buffer.size(), *whole.shape[1:])


def _put_episodes(model: BaseAlgorithm, take: Callable[..., NDArray[Any]]) -> None:
    returns = take("episodes.r", np.float32, ANY)
    number = len(returns)
    lengths, times = take("episodes.l", np.int32, number), take("episodes.t", np.float64, number)
    success = take("episodes.success", np.bool_, ANY)
    if max(number, len(success)) > model._stats_window_size:
        raise ValueError(f"'episodes.r' must have at most {model._stats_window_size} entries, has {number}")
    # numpy's scalars, as VecMonitor makes them: a mean over them is rounded in their own precision.
    episodes = ({"r": r, "l": n, "t": float(t)} for r, n, t in zip(returns, lengths, times, strict=True))
    model.ep_info_buffer = deque(episodes, maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(success, maxlen=model._stats_window_size)


def _put_env(model: BaseAlgorithm, arrays: Arrays) -> None:
    monitor: Any = model.get_env()
    there = state_arrays.put_cars(monitor, monitor.env.unwrapped.dtype, model.n_envs, arrays)
    observation = arrays.take("env.observation", np.float32, model.n_envs, *monitor.observation_space.shape)
    if not np.array_equal(there, observation):
        raise ValueError("'env.observation' is not what the cars in 'env.rows' observe")
    model._last_obs = observation  # type: ignore[assignment]
    model._last_episode_starts = arrays.take("env.episode_starts", np.bool_, model.n_envs)
    monitor.episode_returns = arrays.take("monitor.returns", np.float32, model.n_envs)
    monitor.episode_lengths = arrays.take("monitor.lengths", np.int32, model.n_envs)
    if np.any(monitor.episode_lengths < 0):
        raise ValueError("'monitor.lengths' must not be negative")
    (monitor.episode_count,) = arrays.take("monitor.count", np.int64, 1).tolist()
