"""One car as pure functions for JAX, in gymnax's form: ``vmap`` makes many of it, ``jit`` compiles, ``grad`` works."""

from __future__ import annotations

import functools
import inspect
import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from bicycle_env.envs.configuration import Configured
from bicycle_env.envs.fleet import MOST_STEPS, Fleet
from bicycle_env.envs.registered_fleet import keywords_of_id, registered_fleet, registered_spec
from bicycle_env.envs.tensors.tensor_kernels import (
    Episodes,
    Library,
    Tensor,
    TensorKernels,
    chosen,
    tensor_kernels,
    world_of,
)
from bicycle_env.installation import needs
from bicycle_env.physics.car import CarParameters
from bicycle_env.physics.validation import choice, known_keys, whole
from bicycle_env.tasks.ends import RUNNING
from bicycle_env.tasks.episode import World

WIDE = 'jax.config.update("jax_enable_x64", True), before JAX makes its first array'


class JaxParams(NamedTuple):
    """What an episode may have of its own beside its state: a pytree of numbers, over which ``vmap`` may go, too."""

    car: CarParameters
    settings: Any
    """The task's."""
    max_steps: Tensor
    """Control steps until the time-out; inf: none."""


class JaxEnv(Configured):
    """One car of an environment id as pure functions: the same laws as ``gym.make``'s, for JAX.

        env = JaxEnv("BicycleStab-v0")
        observation, state = jax.vmap(env.reset)(jax.random.split(key, 1024))
        observation, state, reward, terminated, truncated, info = jax.vmap(env.step)(keys, state, actions)

    ``reset(key, params)`` and ``step(key, state, action, params)`` are gymnax 1.0's. ``step`` starts a new episode
    where one is over: observation and state are the new one's then, ``info["final_observation"]`` the old one's last.
    In float64 a step equals the single environment's to 1e-12; actions that are not finite end an episode.

    Args:
        env_id: a registered id of this package's kind.
        dtype: "float32" or "float64", of the physics and of rewards; observations are float32.
        max_episode_steps: by default the id's; None in gymnasium's way.
        **env_keywords: as of the single environment, without ``render_mode``.

    Attributes: those of the single environment's configuration (``vehicle``, ``speed``, ``observation_names``, ...),
    ``observation_space``, ``action_space`` (Gymnasium's), ``default_params``.

    Raises:
        ImportError: JAX is missing. ValueError, TypeError: a bad keyword, or 64 bits where JAX has them switched off.
        gymnasium.error.Error: an unknown id.
    """

    def __init__(
        self, env_id: str, *, dtype: str = "float32", max_episode_steps: int | None = None, **env_keywords: Any
    ) -> None:
        self.spec = registered_spec(env_id)
        own = [name for name in inspect.signature(JaxEnv).parameters if name != "env_keywords"]
        known_keys("keyword", env_keywords, [*own, *keywords_of_id(self.spec)], TypeError)
        jax = import_jax()
        word = choice("dtype", dtype, MOST_STEPS)
        wide = bool(jax.config.jax_enable_x64)
        if word == "float64" and not wide:
            raise ValueError(f"dtype 'float64' needs {WIDE}")
        steps = self.spec.max_episode_steps if max_episode_steps is None else max_episode_steps
        limit = None if steps in (None, -1) else whole("max_episode_steps", steps, 1, MOST_STEPS[word])
        self._fleet: Fleet = registered_fleet(self.spec, 1, env_keywords, limit)
        if self._fleet.varied:
            raise TypeError("JaxEnv is one car: give one vehicle, speed and friction, and vmap over params")
        self._adopt(self._fleet.configuration)
        bound = self.configuration.observation_bound
        self.observation_space = spaces.Box(-bound, bound, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (self.configuration.axles,), np.float32)
        self._jax, self._library = jax, jax_library(jax, word)
        world = world_of(self._library, self._fleet)
        most = self._library.tensor(math.inf if limit is None else limit)
        self.default_params = JaxParams(world.car, world.settings, most)
        self._jitted = jax.jit(self._reset), jax.jit(self._step), jax.jit(self._start)
        if not wide:
            self._refuse_wide_integers()

    @property
    def num_actions(self) -> int:
        """Axles that are steered."""
        return self.configuration.axles

    def reset(self, key: Any, params: JaxParams | None = None) -> tuple[Tensor, Episodes]:
        """A random start: observation (entries,) float32, and state."""
        found: tuple[Tensor, Episodes] = self._jitted[0](key, params or self.default_params)
        return found

    def start(self, uniforms: Tensor, params: JaxParams | None = None) -> tuple[Tensor, Episodes]:
        """The start that numbers in [0, 1) give, (task.uniforms,): those that the single environment draws, its own."""
        found: tuple[Tensor, Episodes] = self._jitted[2](uniforms, params or self.default_params)
        return found

    def step(
        self, key: Any, state: Episodes, action: Tensor, params: JaxParams | None = None
    ) -> tuple[Tensor, Episodes, Tensor, Tensor, Tensor, dict[str, Tensor]]:
        """One control step, or ``action_repeat`` of them.

        Args:
            key: of the next start, where the episode is over.
            state: of ``reset`` or ``step``.
            action: (axles,); finite values outside [-1, 1] saturate.
            params: by default ``default_params``.

        Returns:
            observation (entries,) float32, state, reward, terminated, truncated, and info: ``end``, ``cost``,
            ``is_success`` and what the task tells, as of the single environment, of the step before a new start, and
            ``final_observation``.
        """
        found: tuple[Tensor, Episodes, Tensor, Tensor, Tensor, dict[str, Tensor]]
        found = self._jitted[1](key, state, action, params or self.default_params)
        return found

    # Inner workings

    def _kernels(self, params: JaxParams) -> TensorKernels:
        world = World(params.car, self.configuration.rules, params.settings)
        return tensor_kernels(self._library, self._fleet, world, params.max_steps)

    def _uniforms(self, key: Any) -> Tensor:
        return self._jax.random.uniform(key, (self.task.uniforms,), self._library.dtype)

    def _start(self, uniforms: Tensor, params: JaxParams) -> tuple[Tensor, Episodes]:
        kernels = self._kernels(params)
        state = kernels.start(uniforms)
        return kernels.look(state)[0], state

    def _reset(self, key: Any, params: JaxParams) -> tuple[Tensor, Episodes]:
        return self._start(self._uniforms(key), params)

    def _step(self, key: Any, state: Episodes, action: Tensor, params: JaxParams) -> tuple[Any, ...]:
        kernels, where = self._kernels(params), self._library.module.where
        action = self._library.tensor(action)
        after, reward = kernels.step(state, action)
        for _ in range(self.action_repeat - 1):  # a car that ends stays where it is
            later, more = kernels.step(after, action)
            ended = after.over
            after, reward = chosen(where, ended, after, later), reward + where(ended, 0.0, more)
        final, cost = kernels.look(after)
        settled = after.episode.settled_steps >= self.configuration.steps_to_settle
        info = {"end": after.end, "cost": cost, "is_success": settled & (after.end == RUNNING)}
        info |= {name: getattr(after.episode.task_state, name) for name in self.task.told}
        fresh = kernels.start(self._uniforms(key))
        going = chosen(where, after.over, fresh, after)
        observation = where(after.over, kernels.look(fresh)[0], final)
        return observation, going, reward, after.end > 0, after.timed_out, {**info, "final_observation": final}

    def _refuse_wide_integers(self) -> None:
        """Noise is made of whole numbers that JAX would cut off: better no environment than another one."""
        key = self._jax.ShapeDtypeStruct((2,), np.uint32)
        action = self._jax.ShapeDtypeStruct(self.action_space.shape, np.float32)

        def whole_step(key: Any, action: Any) -> Any:
            return self._step(key, self._reset(key, self.default_params)[1], action, self.default_params)

        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                self._jax.eval_shape(whole_step, key, action)
            except (UserWarning, OverflowError):
                raise ValueError(f"this environment counts in 64 bits, noise for example, and needs {WIDE}") from None


def import_jax() -> Any:
    """The package; ImportError says how to install it."""
    try:
        import jax
    except ImportError as error:
        raise ImportError(needs("JaxEnv", "jax", "jax"), name="jax") from error
    return jax


def jax_library(jax: Any, dtype: str) -> Library:
    """JAX for the tensor kernels, of one car."""
    arrays = jax.numpy
    number = getattr(arrays, dtype)

    def repeated(count: int, body: Callable[[Any], Any], carry: Any) -> Any:
        return jax.lax.fori_loop(0, count, lambda _, now: body(now), carry)

    def cast(value: Tensor, kind: Any) -> Tensor:
        return value.astype(kind)

    def columns(value: Tensor, axis: int) -> Sequence[Tensor]:
        return [value.take(k, axis) for k in range(value.shape[axis])]

    # The whole step is compiled at once, not a law by itself.
    tensor = functools.partial(arrays.asarray, dtype=number)
    return Library(arrays, number, tensor, cast, columns, (), repeated, lambda law: law)
