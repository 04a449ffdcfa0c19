"""Many cars on tensors: the environments of this package for training without leaving the GPU."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium as gym
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from bicycle_env.envs.fleet import CAR_OPTIONS, ConfiguredFleet, Fleet
from bicycle_env.envs.many.rows import checked_cars
from bicycle_env.envs.registered_fleet import keywords_of_id, registered_fleet, registered_spec
from bicycle_env.envs.telemetry import telemetry as telemetry_of
from bicycle_env.envs.tensors import torch_device
from bicycle_env.envs.tensors.tensor_kernels import Episodes, Tensor, chosen, mapped, tensor_kernels, world_of
from bicycle_env.envs.tensors.torch_options import TorchOptions
from bicycle_env.envs.told import read_only, tell
from bicycle_env.physics.validation import flag, known_keys, whole
from bicycle_env.tasks.ends import RUNNING


class TorchSnapshot(NamedTuple):
    """All that the future of a TorchVectorEnv depends on; made by ``snapshot()``, taken by ``restore()``."""

    episodes: Episodes
    generator: Tensor
    cars: tuple[Tensor, ...] = ()
    """What each car is made of, with ``varied``."""


class TorchVectorEnv(ConfiguredFleet, VectorEnv[Any, Any, Any]):
    """``num_envs`` cars of one environment id, on torch tensors: the same laws as the single environment.

    A Gymnasium vector environment whose observations, actions, rewards and infos are tensors on one device. ``step``,
    the autoreset and the random starts take place there; with ``on_invalid="terminate"`` nothing is copied to the host
    or waits for it. In float64 a step equals the single environment's to 1e-12. Actions that require a gradient make
    everything that follows differentiable; under ``torch.no_grad()`` nothing is recorded.

        envs = TorchVectorEnv("BicycleStab-v0", 4096, device="cuda", on_invalid="terminate")
        observation, info = envs.reset(seed=0)
        observation, reward, terminated, truncated, info = envs.step(policy(observation))

    Args:
        env_id: a registered id of this package's kind.
        num_envs, max_episode_steps, autoreset_mode, staggered_start, telemetry: as of ``gym.make_vec(env_id)``, whose
            docstring describes them. With "SameStep", ``final_obs`` and ``final_info`` are in the info of every step,
            also of one in which no car's episode ends.
        dtype: "float64" or "float32" (or torch's own): of the physics and of rewards; observations are float32.
        varied: as there; cars change in place: gradients do not flow across such a reset.
        on_invalid: as there. To "raise", the host must wait for the device in every step: on a GPU, "terminate" is for
            speed.
        device: where all tensors are, as torch takes it.
        compile: compile the RK4 substep, and what comes before and after the substeps, with torch.compile: many times
            faster, after a minute in the first steps. Needs a C++ compiler on the CPU, Triton on a GPU.
        **env_keywords: as of the single environment, without ``render_mode``; ``vehicle``, ``speed``, ``speed_ratio``
            and ``friction`` take one value or a sequence or tensor of num_envs of them.

    ``info`` holds what it holds there, as tensors (num_envs,).

    One generator, on the device, draws for all cars in every step: the same seed, num_envs, dtype and kind of device
    give the same run, and no car's starts depend on what the others do. ``np_random_seed`` is what it was seeded with;
    ``np_random`` is numpy's generator of the same seed, from which nothing is drawn here.

    ``copy.deepcopy`` and pickle give an environment that goes on the same, without the gradients of its past.

    Raises:
        ImportError: torch is missing. ValueError, TypeError: a bad keyword. gymnasium.error.Error: an unknown id.
    """

    def __init__(
        self,
        env_id: str,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = "NextStep",
        dtype: Any = "float64",
        staggered_start: bool = False,
        on_invalid: str = "raise",
        telemetry: bool = False,
        varied: bool = False,
        device: Any = "cpu",
        compile: bool = False,
        **env_keywords: Any,
    ) -> None:
        own = [name for name in inspect.signature(TorchVectorEnv).parameters if name != "env_keywords"]
        self.spec = registered_spec(env_id)
        known_keys("keyword", env_keywords, [*own, *keywords_of_id(self.spec)], TypeError)
        torch = torch_device.import_torch()
        steps = self.spec.max_episode_steps if max_episode_steps is None else max_episode_steps
        word = str(dtype).removeprefix("torch.")
        limit = self._adopt_options(num_envs, steps, autoreset_mode, word, staggered_start, on_invalid, telemetry)
        tell(self, dtype=getattr(torch, word))
        self.device, self._generator = torch_device.device_and_generator(torch, device)
        self._np_random, self._np_random_seed = seeding.np_random(self._generator.seed())
        env_keywords = {name: torch_device.as_numbers(torch, name, value) for name, value in env_keywords.items()}
        fleet = registered_fleet(self.spec, self.num_envs, env_keywords, limit, flag("varied", varied))
        self._adopt_fleet(fleet)
        self._compiled = flag("compile", compile)
        self._episodes: Episodes | None = None
        self._changed = False  # whether a reset has given other cars
        self._bind()

    def _bind(self) -> None:
        self._torch = torch = torch_device.import_torch()
        step_limit = math.inf if self.max_episode_steps is None else self.max_episode_steps
        library = torch_device.torch_library(torch, self.num_envs, self.device, self.dtype, self._compiled)
        self._kernels = tensor_kernels(library, self.fleet, world_of(library, self.fleet), step_limit)
        limits = (self.front_actuator.angle_limit, self.rear_actuator.angle_limit)
        self._options = TorchOptions(torch, self.num_envs, self.device, self.dtype, limits, self.model.own)

    @functools.cached_property
    def observation_space(self) -> spaces.Space[Any]:  # type: ignore[override]
        """``single_observation_space``, num_envs times; made when first asked for."""
        return batch_space(self.single_observation_space, self.num_envs)

    @functools.cached_property
    def action_space(self) -> spaces.Space[Any]:  # type: ignore[override]
        """``single_action_space``, num_envs times; made when first asked for."""
        return batch_space(self.single_action_space, self.num_envs)

    # Gymnasium's interface

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start an episode of every car.

        Args:
            seed: makes this and all following episodes repeatable.
            options: as of the single environment; each value, those of ``state`` too, is one or num_envs of them.
                ``reset_mask``: a tensor or array of bool (num_envs,), only these cars start anew. A start takes the
                same random numbers with or without options.

        Raises:
            ValueError, TypeError: a bad seed or option; nothing has changed then.
            gymnasium.error.ResetNeeded: a ``reset_mask`` that leaves out cars before the first reset.
            gymnasium.error.ClosedEnvironmentError: after close().
        """
        self._refuse_if_closed("reset()")
        options = dict(options) if isinstance(options, Mapping) else options
        masked = options.pop("reset_mask", None) if isinstance(options, dict) else None
        mask = None if masked is None else self._options.mask(masked)
        given = self.task.check_options(options, ("reset_mask", *CAR_OPTIONS))
        seed = None if seed is None else whole("seed", seed, 0, math.inf)
        cars = {name: torch_device.as_numbers(self._torch, name, given[name]) for name in CAR_OPTIONS if name in given}
        others = checked_cars(self.task, cars, self.fleet, self.num_envs)
        kept = self._episodes
        if kept is None and mask is not None and not bool(mask.all()):
            raise gym.error.ResetNeeded("the first reset() must start all rows: it takes no reset_mask")
        values = self._options.state(given["state"], "options['state']") if "state" in given else {}
        changes = self.task.option_numbers(given, self._options.allowed)
        if seed is not None:
            self._np_random, self._np_random_seed = seeding.np_random(seed)
            self._generator.manual_seed(torch_device.shortened(seed))
        if others is not None or self._changed:
            self._changed = True
            self._put_cars(others or self.fleet, mask)
        fresh = self._kernels.start(self._uniforms())
        if values:
            fresh = self._with_state(fresh, {**self._kernels.complete(values)._asdict(), **values})
        fresh = self._with_task_state(fresh, changes)
        fresh = self._kernels.refill(fresh) if given else fresh
        if self.staggered_start and mask is None and self.max_episode_steps is not None:
            steps = self._torch.arange(self.num_envs, device=self.device) * self.max_episode_steps // self.num_envs
            fresh = fresh._replace(episode=fresh.episode._replace(steps=steps.to(self.dtype)))
        self._keep(fresh if kept is None or mask is None else chosen(self._torch.where, mask, fresh, kept))
        return self._look()

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """One control step of all cars, or ``action_repeat`` of them; finite values outside [-1, 1] saturate.

        Args:
            actions: a tensor (num_envs, axles) of real numbers on the environment's device, in its full precision.

        Returns:
            observation (num_envs, entries) float32; reward, terminated, truncated (num_envs,); info.

        Raises:
            ValueError, TypeError: actions of another shape, type or device, or not finite with on_invalid="raise";
                nothing has changed then.
            gymnasium.error.ResetNeeded: there was no reset.
            gymnasium.error.ClosedEnvironmentError: after close().
        """
        self._refuse_if_closed("step()")
        before = self._begun("step()")
        actions = self._checked_actions(actions, before)
        after, reward = self._kernels.step(before, actions)
        for _ in range(self.action_repeat - 1):  # cars that end stay where they are
            ended = after.over
            later, more = self._kernels.step(after, actions)
            after, reward = (
                chosen(self._torch.where, ended, after, later),
                reward + more.where(ended.logical_not(), 0.0),
            )
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            over = after.over
            self._episodes = after
            final_observation, final_info = self._look(over)
            self._episodes = self._kernels.restart(over, self._uniforms(), after)
            observation, info = self._look()
            info |= {"final_obs": final_observation, "_final_obs": over}
            info |= {"final_info": final_info, "_final_info": over.clone()}
            return observation, reward, after.end > 0, after.timed_out, info
        over = before.over
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._episodes = self._kernels.restart(over, self._uniforms(), after)
        else:
            self._episodes = chosen(self._torch.where, over, before, after)
        observation, info = self._look()
        reward = reward.where(over.logical_not(), 0.0)
        return observation, reward, self._episodes.end > 0, self._episodes.timed_out.clone(), info

    # What else a user may ask

    @property
    def state(self) -> Any:
        """The present state as the task's named tuple of tensors (num_envs,), SI units."""
        state, episode, *_ = self._begun("state")
        commands = (episode.front_steer_command, episode.rear_steer_command)
        values = self.configuration.State(*state, *commands, episode.steps * self.control_timestep, *episode.task_state)
        return mapped(lambda value: value.clone(), values)

    @state.setter
    def state(self, _value: Any) -> None:
        raise AttributeError(read_only("state"))

    def set_state(self, state: Mapping[str, Any]) -> tuple[Tensor, dict[str, Any]]:
        """Put the cars, all running and none yet settled, into given states; values not given stay.

        No random number is drawn.

        Args:
            state: names of ``state`` to one number or num_envs of them, SI units.

        Returns:
            observation and info there, as ``reset``.

        Raises:
            ValueError, TypeError: a name that is unknown, a value that is not finite or out of range.
        """
        episodes = self._begun("set_state()")
        if not isinstance(state, Mapping):
            raise TypeError(f"state must be a mapping of state names to numbers, got {state!r}")
        known_keys("state name", state, self.configuration.State._fields)
        beyond = {name: value for name, value in state.items() if name in ("time", *self.task.TaskState._fields)}
        values = self._options.state({name: state[name] for name in state if name not in beyond}, "state")
        episode = episodes.episode
        for name, given in beyond.items():
            column = self._options.numbers(f"state[{name!r}]", given, 0.0 if name == "time" else -math.inf)
            if name == "time":
                episode = episode._replace(steps=self._torch.round(column / self.control_timestep))
            else:
                episode = episode._replace(task_state=episode.task_state._replace(**{name: column}))
        nothing = self._torch.zeros_like
        episode = episode._replace(settled_steps=nothing(episode.settled_steps))
        running = Episodes(episodes.state, episode, nothing(episodes.end), nothing(episodes.timed_out))
        self._keep(self._with_state(running, {name: values[name] for name in values if name in state}))
        return self._look()

    @property
    def is_success(self) -> Tensor:
        """bool (num_envs,): running, and settled for the last second; at a time-out, a success."""
        return self._success(self._begun("is_success"))

    def measure(self) -> dict[str, Tensor]:
        """Slip angles, forces, accelerations and the reference in the present state, by the names of the telemetry."""
        return self._kernels.measure(self._begun("measure()"))

    def snapshot(self) -> TorchSnapshot:
        """The whole state, random generator included; ResetNeeded before the first reset."""
        self._refuse_if_closed("snapshot()")
        episodes = mapped(lambda value: value.clone(), self._begun("snapshot()"))
        cars = tuple(each.clone() for each in self._cars) if self._changed else ()
        return TorchSnapshot(episodes, self._generator.get_state(), cars)

    def restore(self, snapshot: TorchSnapshot) -> Tensor:
        """Return to a snapshot of this or of an equally made environment; gives the observations there."""
        if not isinstance(snapshot, TorchSnapshot):
            raise TypeError(f"snapshot must come from snapshot(), got {type(snapshot)!r}")
        numbers = snapshot.episodes.state.heading
        found = (snapshot.episodes.episode.task_state._fields, tuple(numbers.shape), numbers.dtype, numbers.device)
        if found != (self.task.TaskState._fields, (self.num_envs,), self.dtype, self.device):
            raise ValueError(
                f"snapshot must be of {self.num_envs} cars in {self.dtype} on {self.device}, of the same task, "
                f"got one of {numbers.numel()} in {numbers.dtype} on {numbers.device}"
            )
        self._refuse_if_closed("restore()")
        if self._changed and not snapshot.cars:
            self._put_cars(self.fleet, None)
        self._copy_cars(snapshot.cars)
        self._keep(snapshot.episodes)
        self._generator.set_state(snapshot.generator)
        return self._look()[0]

    def detach(self) -> None:
        """Forget how the present state came about: gradients flow back to here and no further."""
        self._episodes = mapped(lambda value: value.detach(), self._begun("detach()"))

    # Inner workings

    def _begun(self, asked: str) -> Episodes:
        if self._episodes is None:
            raise gym.error.ResetNeeded(f"call reset() before {asked}")
        return self._episodes

    @property
    def _cars(self) -> tuple[Tensor, ...]:
        """The tensors of what each car is made of, which the compiled functions hold."""
        world = self._kernels.world
        return (*world.car, *world.settings)

    def _copy_cars(self, cars: tuple[Tensor, ...]) -> None:
        self._changed = self._changed or bool(cars)
        for mine, kept in zip(self._cars if cars else (), cars, strict=True):
            mine.copy_(kept)

    def _put_cars(self, fleet: Fleet, mask: Tensor | None) -> None:
        """In place, in the rows of a mask; the scales of what is observed stay."""
        for mine, values in zip(self._cars, (*fleet.car, *fleet.settings), strict=True):
            if mine.ndim:  # the other numbers are the same for every car
                column = self._torch.tensor(values, dtype=self.dtype, device=self.device)
                wanted = column.expand(self.num_envs)
                mine.copy_(wanted if mask is None else wanted.where(mask, mine))

    def _keep(self, episodes: Episodes) -> None:
        """Each number in a tensor of its own: compiled code is compiled again for tensors that share memory."""
        self._episodes = mapped(lambda value: value.clone(), episodes)

    def _uniforms(self) -> Tensor:
        shape = (self.task.uniforms, self.num_envs)
        return self._torch.rand(shape, generator=self._generator, dtype=self.dtype, device=self.device)

    def _success(self, episodes: Episodes) -> Tensor:
        return (episodes.episode.settled_steps >= self.configuration.steps_to_settle) & (episodes.end == RUNNING)

    def _look(self, rows: Tensor | None = None) -> tuple[Tensor, dict[str, Any]]:
        """Observation and info; `rows`: a mask of those that the info tells of, by default all."""
        episodes = self._begun("observing")
        observation, cost = self._kernels.look(episodes)
        info = {"end": episodes.end.clone(), "cost": cost, "is_success": self._success(episodes)}
        info |= {name: getattr(episodes.episode.task_state, name).clone() for name in self.task.told}
        if self.telemetry:
            info |= telemetry_of(episodes.state, self._kernels.measure(episodes))
        here = self._torch.ones_like(episodes.timed_out) if rows is None else rows.clone()
        return observation, {**info, **{f"_{name}": here for name in info}}

    def _with_state(self, episodes: Episodes, values: Mapping[str, Tensor]) -> Episodes:
        state = {name: value for name, value in values.items() if name in self.model.State._fields}
        commands = {name: value for name, value in values.items() if name not in self.model.State._fields}
        return episodes._replace(state=episodes.state._replace(**state), episode=episodes.episode._replace(**commands))

    def _with_task_state(self, episodes: Episodes, numbers: Mapping[str, Any]) -> Episodes:
        task_state = self.task.task_state_with(episodes.episode.task_state, numbers, self._kernels.world.car.speed)
        task_state = mapped(self._options.filled, task_state)
        return episodes._replace(episode=episodes.episode._replace(task_state=task_state))

    def _checked_actions(self, actions: Any, episodes: Episodes) -> Tensor:
        torch, shape = self._torch, self._action_shape
        if not torch.is_tensor(actions) or actions.dtype == torch.bool or actions.is_complex():
            got = actions.dtype if torch.is_tensor(actions) else type(actions).__name__
            raise TypeError(f"actions must be a tensor of {shape} real numbers on {self.device}, got {got}")
        if tuple(actions.shape) != shape:
            raise ValueError(f"actions must have shape {shape} (steer={self.steer!r}), got {tuple(actions.shape)}")
        if actions.device != self.device:
            raise ValueError(f"actions must be on {self.device}, got some on {actions.device}")
        actions = actions.to(self.dtype)
        if self.on_invalid == "raise":
            bad = ~(torch.isfinite(actions).all(dim=1) | episodes.over)  # a car that is waiting takes no action
            if bool(bad.any()):
                row = int(bad.nonzero()[0])
                raise ValueError(f"actions must be finite, nominally in [-1, 1]; row {row} has {actions[row].tolist()}")
        return actions

    def __getstate__(self) -> dict[str, Any]:
        # Functions and modules do not pickle: they are bound anew. The generator is known by its state.
        left = ("_torch", "_kernels", "_options", "_generator")
        kept = {name: value for name, value in self.__dict__.items() if name not in left}
        if self._episodes is not None:
            kept["_episodes"] = mapped(lambda value: value.detach(), self._episodes)
        return {**kept, "generator": self._generator.get_state(), "cars": self._cars if self._changed else ()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        generator, cars = state.pop("generator"), state.pop("cars")
        self.__dict__.update(state)
        self._bind()
        self._copy_cars(cars)
        self._generator = self._torch.Generator(device=self.device)
        self._generator.set_state(generator)
