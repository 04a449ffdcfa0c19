"""The Gymnasium environment: one car, any task. It holds the arrays and asks the compiled kernels; no physics here."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import logger, spaces
from numpy.typing import NDArray

from bicycle_env.backends.compiled_random import addresses
from bicycle_env.envs.arguments import written_page
from bicycle_env.envs.arrays import real_array
from bicycle_env.envs.configuration import Configuration, Configured, configure
from bicycle_env.envs.fleet import CAR_OPTIONS, configure_alike, with_options
from bicycle_env.envs.many import block_kernels
from bicycle_env.envs.many.blocks import KEPT, Kind, layout, shared_layout
from bicycle_env.envs.many.rows import Rows
from bicycle_env.envs.origin import names_of, origin_of
from bicycle_env.envs.setup import shown
from bicycle_env.envs.single.kernels import step_of_one
from bicycle_env.envs.telemetry import MEASURED, telemetry
from bicycle_env.envs.time_limit import limit_around, remark, resolve_horizon
from bicycle_env.envs.told import read_only, tell
from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.validation import choice, flag
from bicycle_env.tasks.episode import EpisodeState, Rules, World
from bicycle_env.tasks.task import Task, checked_state

RENDER_MODES = ("human", "rgb_array")
FLOAT32 = np.dtype(np.float32)
ONE = np.ones(1, dtype=np.bool_)
STEPS, SETTLED = KEPT.index("steps"), KEPT.index("settled_steps")


class Snapshot(NamedTuple):
    """All that the future of an environment depends on; made by ``snapshot()``, taken by ``restore()``."""

    episode: NDArray[np.float64]
    end: int
    generator: Any
    names: tuple[str, ...] = ()
    """Of the numbers of the task's state."""
    driven: Configuration | None = None
    """The car that is driven, where ``reset`` was given another one."""


class SingleTrackEnv(Configured, gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Base of the environments; the subclasses have a task and document it."""

    metadata: dict[str, Any] = {  # noqa: RUF012 (declared so by Gymnasium)
        "render_modes": list(RENDER_MODES),
        "render_fps": 50,
    }
    default_task: ClassVar[Task]
    """The task without keywords of its own; these change its fields."""
    meanings: ClassVar[Mapping[str, str]] = {}
    """Of keywords, for the page, where they are not as ``envs/arguments.py`` says."""

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        task = getattr(cls, "default_task", None)
        defaults = {} if task is None else task.defaults
        cls.__signature__ = shown(inspect.signature(SingleTrackEnv), defaults)  # type: ignore[attr-defined]
        if cls.__doc__ is not None and task is not None:
            cls.__doc__ = written_page(cls.__doc__, task, cls.meanings)

    def __init__(self, *, telemetry: bool = False, render_mode: str | None = None, **task_keywords: Any) -> None:
        self._fleet = configure_alike(origin_of(self.default_task, task_keywords))
        configuration = self._fleet.configuration
        self._adopt(configuration)
        tell(self, telemetry=flag("telemetry", telemetry))
        self._given_horizon = self._fleet.origin.setup.horizon
        self._limit_asked = False
        self.render_mode = None if render_mode is None else choice("render_mode", render_mode, RENDER_MODES)
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / self.action_timestep))}
        bound = configuration.observation_bound
        self.observation_space = spaces.Box(-bound, bound, dtype=np.float32)
        self._action_shape = (configuration.axles,)
        self.action_space = spaces.Box(-1.0, 1.0, self._action_shape, np.float32)
        self._kind = Kind(self.task, self.model, len(bound), 1, False, "float64")
        self._rows = Rows(self._kind, self._fleet, 1, None)
        self._at = layout(self._kind)
        self._observation_size = len(bound)
        self._present, self._car = configuration, configuration.car
        self._end_names = configuration.end_names
        self._end_code = block_kernels.BAD_ACTION  # not yet reset
        self._warned = False
        self._plain = not (self.telemetry or self.task.told or self.render_mode == "human" or self.action_repeat > 1)
        self._limit: float = math.inf
        self._viewer: Any = None
        self._bind()

    @functools.cached_property
    def _kernels(self) -> block_kernels.Kernels:
        """Compiled, or loaded, when an episode is asked for: whoever wants the numbers of a plant does not wait."""
        return block_kernels.kernels(self._kind, self.reward, step_of_one)

    @functools.cached_property
    def _step(self) -> Any:
        if self.closed:
            return self._step_after_close
        return self._kernels.step if self.action_repeat == 1 else self._step_repeated

    def _bind(self) -> None:
        self._State = self.configuration.State
        self._numbers = self._rows.numbers
        self._episode = self._rows.episodes[0, :, 0]

    # Gymnasium's interface

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode.

        Args:
            seed: makes this and the following episodes repeatable.
            options: ``{"state": {name: value}}`` starts from that state, names not given being 0. ``vehicle``,
                ``speed`` [m/s], ``friction``: of the car that is driven until the next reset; what the environment is
                called by, and scales and controllers, stay nominal. The task's own options are named in its
                documentation. A start takes the same random numbers with or without.

        Raises:
            ValueError, TypeError: an unknown option or state name, a value that is not finite or out of range.
            gymnasium.error.ClosedEnvironmentError: after close().
        """
        self._refuse_if_closed("reset()")
        if not self._limit_asked:
            self._ask_for_the_limit()
        given = self.task.check_options(options, CAR_OPTIONS)
        cars = [name for name in CAR_OPTIONS if name in given and name not in self.task.options]
        driven = self.configuration
        if cars:
            driven = configure(self._fleet.origin.task, with_options(self._fleet, {name: given[name] for name in cars}))
        limits = (self.front_actuator.angle_limit, self.rear_actuator.angle_limit)
        state = checked_state(given["state"], *limits, own=self.model.own) if "state" in given else None
        changes = self.task.option_numbers(given)
        kernels = self._kernels
        super().reset(seed=seed)
        if driven is not self._present:
            self._drive(driven)
        kernels.start(self._numbers, ONE, addresses([self.np_random]))
        if given:
            at = self._at
            if state is not None:
                placed = CarState(*(state[name] for name in CarState._fields))
                state = {**self.model.complete(PYTHON)(placed, self._car)._asdict(), **state}
                self._episode[: at.kept + 2] = [state[name] for name in (*self.model.State._fields, *KEPT[:2])]
            task_state = self.task.TaskState(*self._episode[at.task_state :])
            self._episode[at.task_state :] = self.task.task_state_with(task_state, changes, driven.speed)
            self._refill()
        observation, cost = self._look()
        self._end_code = 0
        self._warned = False
        if self._viewer is not None:
            self._viewer.start()
        if self.render_mode == "human":
            self.render()
        return observation, self._info(cost)

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Hold an action for one control step, or ``action_repeat`` of them; finite values outside [-1, 1] saturate.

        Raises:
            ValueError, TypeError: an action of the wrong shape or type, or not finite; nothing has changed then.
            gymnasium.error.ResetNeeded: there was no reset.
            gymnasium.error.ClosedEnvironmentError: after close().
        """
        if self._end_code != 0:
            return self._after_the_end()
        if type(action) is not np.ndarray or action.dtype is not FLOAT32 or action.shape != self._action_shape:
            action = converted_action(action, self._action_shape, self.steer, np.float64)
        values = action.tolist()
        observation = np.empty(self._observation_size, FLOAT32)
        reward, end, cost, success = self._step(self._numbers, observation, values[0], values[-1])
        terminated, word = False, ""
        if end:
            if end == block_kernels.BAD_ACTION:
                raise ValueError(f"action must be finite numbers, nominally in [-1, 1], got {action!r}")
            self._end_code, terminated, word = end, True, self._end_names[end]
        if self._plain:
            return observation, reward, terminated, False, {"end": word, "cost": cost, "is_success": success}
        if self.render_mode == "human":
            self.render()
        truncated = self.action_repeat > 1 and self._steps >= self._limit
        return observation, reward, terminated, truncated, self._info(cost)

    def render(self) -> Any:
        """Draw the present state: an array (height, width, 3) of uint8 for "rgb_array", a window for "human"."""
        if self.render_mode is None:
            logger.warn("render() needs render_mode='rgb_array' or 'human' in gym.make")
            return None
        self._refuse_if_closed("render()")
        if self._end_code == block_kernels.BAD_ACTION:
            raise gym.error.ResetNeeded("call reset() before render()")
        if self._viewer is None:
            from bicycle_env.rendering.viewer import Viewer

            self._viewer = Viewer(self)
        return self._viewer.draw()

    def close(self) -> None:
        """Close the window, if there is one; then only what is, such as ``state``, can be asked."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None
        self.closed = True
        self._step = self._step_after_close  # so that a step need not ask

    # What else a user may ask

    @property
    def state(self) -> Any:
        """The present state as a named tuple of floats, SI units."""
        values, steps = self._episode.tolist(), self._at.kept + STEPS
        own = values[self._at.task_state :]
        return self._State(*values[:steps], values[steps] * self.control_timestep, *own)

    @state.setter
    def state(self, _value: Any) -> None:
        raise AttributeError(read_only("state"))

    @property
    def present(self) -> Configuration:
        """What is driven: the configuration, unless ``reset`` was given another vehicle, speed or friction."""
        return self._present

    @property
    def scored_level(self) -> str | None:
        """The level of which a result here is one; None where a keyword has made another setting of it.

        So has a time limit other than the task's, which is known from the first ``reset`` on. A keyword that says what
        the level says changes nothing.
        """
        return self._fleet.scored_level(None if math.isinf(self._limit) else int(self._limit))

    @property
    def end(self) -> str:
        """Why the episode ended, "" while it is running: what ``info["end"]`` says."""
        return "" if self._end_code == block_kernels.BAD_ACTION else self._end_names[self._end_code]

    @property
    def is_success(self) -> bool:
        """Whether the car is running and has been settled for the last second: at a time-out, a success."""
        return self._end_code == 0 and bool(
            self._episode[self._at.kept + SETTLED] >= self.configuration.steps_to_settle
        )

    def measure(self) -> dict[str, float]:
        """Slip angles, forces, accelerations and the reference in the present state, by the names of the telemetry."""
        out = np.empty((1, len(MEASURED)))
        self._kernels.measure(self._numbers, out)
        return dict(zip(MEASURED, out[0].tolist(), strict=True))

    def snapshot(self) -> Snapshot:
        """The whole state, random generator included; not the step count of a wrapper such as TimeLimit."""
        names = self._State._fields
        other = None if self._present is self.configuration else self._present
        return Snapshot(self._episode.copy(), self._end_code, self.np_random.bit_generator.state, names, other)

    def restore(self, snapshot: Snapshot) -> NDArray[np.float32]:
        """Return to a snapshot of this or of an equally made environment; gives the observation there."""
        if not isinstance(snapshot, Snapshot):
            raise TypeError(f"snapshot must come from snapshot(), got {type(snapshot)!r}")
        if snapshot.episode.shape != self._episode.shape or snapshot.names not in ((), self._State._fields):
            mine, theirs = self._State._fields, snapshot.names
            raise TypeError(
                "snapshot must come from snapshot() of an environment of the same id and keywords: its state has "
                f"{', '.join(sorted(set(theirs) ^ set(mine))) or 'other numbers'} more or less"
            )
        self._drive(snapshot.driven or self.configuration)
        self._episode[:] = snapshot.episode
        self._end_code = snapshot.end
        self.np_random.bit_generator.state = snapshot.generator
        return self._look()[0]

    # Inner workings

    def _refill(self) -> None:
        """What the task keeps of a start, after the start was changed by options."""
        law = self.task.refilled(PYTHON)
        if law is not None:
            values, driven, at = self._episode.tolist(), self._present, self._at
            own = self.task.TaskState(*values[at.task_state :])
            episode = EpisodeState._make([*values[at.kept : at.end], own])
            world = World(driven.car, self.rules, driven.settings)
            state = self.model.State(*values[: at.kept])
            self._episode[at.task_state :] = law(state, episode, world)

    def _drive(self, driven: Configuration) -> None:
        """Put another car's numbers where the compiled code finds them; scales and controllers stay nominal."""
        place = shared_layout(self._kind)
        self._present, self._car = driven, driven.car
        self._numbers[place.car : place.rules] = driven.car
        self._numbers[place.settings : place.scale] = driven.settings

    def _look(self) -> tuple[NDArray[np.float32], float]:
        """Observation and cost of the episode as it is."""
        observation, values = np.empty((1, self._observation_size), FLOAT32), np.empty((2, 1))
        self._kernels.look(self._numbers, ONE, observation, values)
        return observation[0].copy(), float(values[1, 0])

    def _ask_for_the_limit(self) -> None:
        """Before the first episode: which time limit is around this environment?"""
        limit = limit_around(self)
        self._limit = math.inf if limit is None else limit
        configuration, self._limit_asked = self.configuration, True
        remark(limit, self._given_horizon, configuration)
        horizon = resolve_horizon(self._given_horizon, limit, self.task.episode_steps)
        self._adopt(
            dataclasses.replace(configuration, horizon=horizon, rules=configuration.rules._replace(horizon=horizon))
        )
        self._present = self.configuration
        self._numbers[shared_layout(self._kind).rules + Rules._fields.index("horizon")] = horizon

    def _info(self, cost: float) -> dict[str, Any]:
        info: dict[str, Any] = {"end": self.end, "cost": cost, "is_success": self.is_success}
        if self.task.told:
            state = self.state
            info |= {name: getattr(state, name) for name in self.task.told}
        if self.telemetry:
            info |= telemetry(self.state, self.measure())
        return info

    @property
    def _steps(self) -> float:
        return float(self._episode[self._at.kept + STEPS])

    def _step_repeated(self, *arguments: Any) -> tuple[float, int, float, bool]:
        """The compiled step, ``action_repeat`` times unless the episode ends before: the sum of the rewards."""
        reward, end, cost, success = self._kernels.step(*arguments)
        for _ in range(self.action_repeat - 1):
            if end or self._steps >= self._limit:
                break
            more, end, cost, success = self._kernels.step(*arguments)
            reward += more
        return reward, end, cost, success

    def _step_after_close(self, *_: Any) -> Any:
        self._refuse_if_closed("step()")

    def _after_the_end(self) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        self._refuse_if_closed("step()")
        if self._end_code == block_kernels.BAD_ACTION:
            raise gym.error.ResetNeeded("call reset() before step()")
        if not self._warned:
            self._warned = True
            logger.warn("step() after the episode has ended: the car stays where it is; call reset()")
        observation, cost = self._look()
        return observation, 0.0, True, False, self._info(cost)

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions do not pickle and windows do not copy: both are made anew.
        left = ("_kernels", "_step", "_viewer", "_numbers", "_episode", "_State")
        return {name: value for name, value in self.__dict__.items() if name not in left}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._viewer = None
        self._bind()


def converted_action(action: Any, shape: tuple[int, ...], steer: str, dtype: Any = np.float32) -> NDArray[Any]:
    """A real array of the shape, of a float type; finite values are clipped, others stay. TypeError, ValueError."""
    converted = real_array(action)
    if converted is None:
        raise TypeError(f"action must be real numbers in [-1, 1] of shape {shape}, without gradients, got {action!r}")
    if converted.shape != shape:
        raise ValueError(f"action must have shape {shape} (steer={steer!r}), got shape {converted.shape}: {action!r}")
    converted = converted.astype(np.float64)
    clipped = np.where(np.isfinite(converted), np.clip(converted, -1.0, 1.0), converted)
    return np.ascontiguousarray(clipped, dtype=dtype)


def keyword_names(env_class: type[SingleTrackEnv]) -> list[str]:
    """All keywords of an environment: its own, then its task's."""
    return names_of(env_class.default_task)
