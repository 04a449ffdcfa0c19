"""A vector environment as Stable-Baselines3 knows one. Needs that package, so it is imported when first used."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from stable_baselines3.common.vec_env import VecEnv


class SB3VecEnv(VecEnv):
    """Lets Stable-Baselines3 train on a Gymnasium vector environment.

    ``SB3VecEnv(gym.make_vec("BicycleStab-v0", num_envs=1024, autoreset_mode="SameStep"))``

    Observations, rewards (float32) and ends are what ``DummyVecEnv`` gives with the single environments, to the bit.
    The info of a row whose episode ended holds ``terminal_observation``, ``TimeLimit.truncated`` (so that a time-out
    is bootstrapped) and the row's last info; that of a row that goes on is empty. What the environment tells of all
    rows, as arrays, is :attr:`info`.

    A native vector environment is one object. ``get_attr`` and ``env_method`` ask it once and give its answer for every
    row asked for; ``set_attr`` is refused. Gymnasium's SyncVectorEnv and AsyncVectorEnv hold single environments: these
    are asked one by one, and refuse in turn what is theirs. Stable-Baselines3's own DummyVecEnv and SubprocVecEnv set
    an attribute of the outermost wrapper and never ask the environment: there ``set_attr("friction", 0.5)`` changes
    nothing and says nothing.

    Stable-Baselines3's callbacks count ``eval_freq`` and ``save_freq`` in calls of ``step``, num_envs steps each, and
    its EvalCallback begins its record anew after a resume.

    Args:
        env: a vector environment in the autoreset mode SAME_STEP, bare or in Gymnasium's vector wrappers.

    Attributes:
        env: the same.
        info: what its last ``reset`` or ``step`` told, arrays (num_envs,).

    Raises:
        TypeError: ``env`` is not a vector environment.
        ValueError: it has another autoreset mode: Stable-Baselines3 expects the next episode's first observation in
            the step that ends an episode.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        if not isinstance(env, VectorEnv):
            raise TypeError(f"env must be a gymnasium.vector.VectorEnv, as gym.make_vec makes it, got {env!r}")
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                'env must have the autoreset mode SAME_STEP: gym.make_vec(..., autoreset_mode="SameStep"); got '
                f"{getattr(mode, 'name', mode)}"
            )
        self.env = env
        self.info: Mapping[str, Any] = {}
        self._actions: Any = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata |= {name: env.metadata[name] for name in ("render_fps",) if name in env.metadata}

    def set_options(self, options: Any = None) -> None:
        """Options of the next reset: one mapping for all rows, in which values may be arrays (num_envs,)."""
        if options is not None and not isinstance(options, Mapping):
            raise TypeError(f"options must be one mapping for all rows, got {options!r}")
        super().set_options(None if options is None else dict(options))

    def reset(self) -> Any:
        seeds: Any = self._seeds  # one or None for each row
        observation, self.info = self.env.reset(seed=seeds, options=self._options[0] or None)
        self.reset_infos = [_row(self.info, row) for row in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: np.ndarray[Any, Any]) -> None:
        self._actions = actions

    def step_wait(self) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        over = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]  # not one for all: callbacks write into them
        statistics = {name: info[name] for name in ("episode", "_episode") if name in info}
        last = {**statistics, **info.get("final_info", {})}
        for row in np.flatnonzero(over).tolist():
            self.reset_infos[row] = _row(info, row)
            infos[row] = {
                **_row(last, row),
                "terminal_observation": copy(info["final_obs"][row]),
                "TimeLimit.truncated": bool(truncated[row] and not terminated[row]),
            }
        self.info = info
        return observation, reward.astype(np.float32), over, infos

    def snapshot(self) -> Any:
        """The whole state of the environment itself, generators included; AttributeError if it has no ``snapshot``.

        Statistics that wrappers keep are not in it.
        """
        return self._native("snapshot")()

    def restore(self, snapshot: Any) -> Any:
        """Return to a snapshot of this or of an equally made environment; gives the observations there.

        Seeds and options that were meant for the next reset are dropped. AttributeError if it has no ``restore``.
        """
        observation = self._native("restore")(snapshot)
        self.info, self.reset_infos = {}, [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observation

    def _native(self, name: str) -> Any:
        found = getattr(self.env.unwrapped, name, None)
        if found is None:
            raise AttributeError(f"{self.env.unwrapped} has no {name}(): gym.make_vec makes one that has")
        return found

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> list[Any]:
        """Of the rows that are drawn."""
        images = self.env.render() or [None] * self.num_envs
        return [images[row] for row in getattr(self.env.unwrapped, "render_rows", range(self.num_envs))]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        env: Any = self.env.unwrapped
        each = env.get_attr(attr_name) if hasattr(env, "get_attr") else [getattr(env, attr_name)] * self.num_envs
        return [each[row] for row in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        env: Any = self.env.unwrapped
        if indices is not None or not hasattr(env, "set_attr"):
            raise AttributeError(f"{attr_name} cannot be set in {env}: give it as a keyword to gym.make_vec")
        env.set_attr(attr_name, [value] * self.num_envs)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        env: Any = self.env.unwrapped
        if hasattr(env, "call"):
            each = env.call(method_name, *method_args, **method_kwargs)
        else:
            each = [getattr(env, method_name)(*method_args, **method_kwargs)] * self.num_envs
        return [each[row] for row in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Whether a vector wrapper of this class is around the environment: the same for each row."""
        layer: Any = self.env
        while isinstance(layer, VectorWrapper) and not isinstance(layer, wrapper_class):
            layer = layer.env
        return [isinstance(layer, wrapper_class) for _ in self._get_indices(indices)]


def _row(info: Mapping[str, Any], row: int) -> dict[str, Any]:
    """What the arrays of an info tell of one row; a mask ``_name`` says of which rows ``name`` tells something."""
    own: dict[str, Any] = {}
    for name, value in info.items():
        if name.startswith(("_", "final_")) or not info.get(f"_{name}", {row: True})[row]:
            continue
        own[name] = _row(value, row) if isinstance(value, Mapping) else value[row]
    return own
