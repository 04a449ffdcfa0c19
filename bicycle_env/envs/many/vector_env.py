"""The native vector environment: thousands of cars, one compiled call a step. It holds the arrays; no physics here."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from bicycle_env.envs.fleet import ConfiguredFleet, configure_fleet
from bicycle_env.envs.many import block_kernels, blocks
from bicycle_env.envs.many.drawn_rows import RENDER_MODES, DrawnRows
from bicycle_env.envs.many.generators import Generators, checked_seeds
from bicycle_env.envs.many.rows import Rows, VectorSnapshot, checked_cars, checked_mask, checked_start
from bicycle_env.envs.many.threads import Threads
from bicycle_env.envs.origin import origin_of
from bicycle_env.envs.single.single_track_env import FLOAT32, SingleTrackEnv, converted_action, keyword_names
from bicycle_env.envs.telemetry import MEASURED, telemetry
from bicycle_env.envs.told import Told, read_only, tell
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.validation import flag, known_keys, whole
from bicycle_env.tasks.ends import INVALID_ACTION

INT8 = np.dtype(np.int8)
MOST_THREADS = 1024


class SingleTrackVectorEnv(ConfiguredFleet, DrawnRows, gym.vector.VectorEnv[Any, Any, Any]):
    """Base of the vector environments; the subclasses name a task.

    Row i is, to the bit, the single environment that was seeded with ``seed + i``, for any number of rows and threads.

    Args:
        num_envs: how many cars.
        max_episode_steps: control steps until the time-out, which truncates; by default the task's, -1: none.
        autoreset_mode: "NextStep", "SameStep" or "Disabled", or Gymnasium's enum. "NextStep": a row that has ended
            starts anew in the next step, which ignores its action and gives reward 0. "SameStep": in the same step, and
            its last observation and info are ``info["final_obs"]`` (num_envs, entries) and ``info["final_info"]``.
            "Disabled": it stays where it is, with reward 0 and its flags, until
            ``reset(options={"reset_mask": mask})``.
        dtype: "float64", or "float32" for twice the speed.
        threads: share the rows among so many threads.
        staggered_start: after a reset of all rows, the episode of row i begins at a later time of its clock, evenly
            spread, so that the time-outs of all rows do not fall together.
        on_invalid: what an action that is not finite does. "raise": ValueError, before anything changes. "terminate":
            the episode of its row ends as "invalid_action", the car stays, its reward is 0 (quadratic: all steps that
            are left are paid for), and the others go on.
        telemetry: more in ``info``.
        varied: each car has numbers of its own, which the options ``vehicle``, ``speed`` and ``friction`` of ``reset``
            may change. So it is in any case where a keyword is given per car.
        render_mode: None, or "rgb_array": ``render()`` gives pictures of the rows in `render_rows`.
        render_rows: which rows are drawn; the others' pictures are black.
        keywords: those of the single environment. vehicle, speed, speed_ratio, friction and
            relaxation_length take one value or num_envs.

    ``info``, (num_envs,) each: ``end``, int8 codes whose words are ``end_names``; ``cost``, 1.0 while a corner of the
    body is outside of the corridor; ``is_success``, running and settled for the last second: at a time-out, a success.
    A mask ``_name`` beside each ``name`` says of which rows it tells.
    """

    metadata: dict[str, Any] = {**ConfiguredFleet.metadata, "render_modes": [*RENDER_MODES]}  # noqa: RUF012
    single_class: ClassVar[type[SingleTrackEnv]]
    threads = Told[int]()

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if cls.__doc__ is None and SingleTrackVectorEnv.__doc__ is not None:
            one = cls.single_class.__name__
            cls.__doc__ = f"Many cars at once: see {one} for the task.\n\n    {SingleTrackVectorEnv.__doc__}"

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = "NextStep",
        dtype: str = "float64",
        threads: int = 1,
        staggered_start: bool = False,
        on_invalid: str = "raise",
        telemetry: bool = False,
        varied: bool = False,
        render_mode: str | None = None,
        render_rows: Sequence[int] = (0,),
        **keywords: Any,
    ) -> None:
        own = [name for name in inspect.signature(SingleTrackVectorEnv).parameters if name != "keywords"]
        known_keys("keyword", keywords, dict.fromkeys([*own, *keyword_names(self.single_class)]), TypeError)
        steps = self.single_class.default_task.episode_steps if max_episode_steps is None else max_episode_steps
        limit = self._adopt_options(num_envs, steps, autoreset_mode, dtype, staggered_start, on_invalid, telemetry)
        tell(self, threads=whole("threads", threads, 1, MOST_THREADS))
        self._adopt_pictures(render_mode, render_rows, self.num_envs)
        origin = origin_of(self.single_class.default_task, keywords, limit)
        self._adopt_fleet(configure_fleet(origin, self.num_envs, flag("varied", varied)))
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / self.action_timestep))}
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        entries = len(self.observation_names)
        self._observation_shape, self._value_shape = (self.num_envs, entries), (2, self.num_envs)
        self._kind = blocks.Kind(
            self.task, self.model, entries, blocks.best_length(self.num_envs), self.fleet.varied, self.dtype
        )
        self._rows = Rows(self._kind, self.fleet, self.num_envs, self.max_episode_steps)
        self._flags = np.ones((4, self.num_envs), dtype=np.bool_)
        self._everyone = self._flags[3]
        self._started = False
        self._changed = False  # whether a reset has given other cars
        always = self.telemetry or bool(self.task.told)
        self._tells_little = not always
        self._plain = self.autoreset_mode is not AutoresetMode.SAME_STEP and not always
        self._restarts = self.autoreset_mode is AutoresetMode.NEXT_STEP
        self._generators = Generators(self.num_envs)
        self._bind()

    @functools.cached_property
    def _kernels(self) -> block_kernels.Kernels:
        """Compiled, or loaded, when episodes are asked for: as those of the single environment."""
        return block_kernels.kernels(self._kind, self.reward)

    @functools.cached_property
    def _run(self) -> Callable[..., int]:
        return self._run_shared if self._threads.helpers else self._kernels.step

    def _bind(self) -> None:
        self._numbers, self._blocks = self._rows.numbers, self._rows.blocks
        self._threads = Threads(self.threads, self.num_envs, self._blocks)

    # Gymnasium's interface

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start episodes.

        Args:
            seed: row i gets ``seed + i``; or one seed (or None) for each row.
            options: ``reset_mask`` (num_envs,) of bool: only these rows, the others go on; ``state``: a mapping of
                state names to numbers or (num_envs,) arrays, names not given being 0; the task's own options, one
                value or num_envs of them; with ``varied`` the ``vehicle``, ``speed`` and ``friction`` that these rows
                drive, whatever restarts come, until they are reset again.

        Returns:
            Observations of all rows (num_envs, entries) and info.

        Raises:
            ValueError, TypeError: a bad seed or option, before anything changes.
            gymnasium.error.ClosedEnvironmentError: after close().
        """
        self._refuse_if_closed("reset()")
        given = dict(options) if isinstance(options, Mapping) else options
        masked = given.pop("reset_mask", None) if isinstance(given, dict) else None
        mask = checked_mask(masked, self.num_envs)
        others = checked_cars(self.task, given, self.fleet, self.num_envs)
        changes = checked_start(self.task, given, others or self.fleet, self.num_envs, self.dtype)
        seeds = checked_seeds(seed, self.num_envs)
        if not self._started and not np.all(mask):
            raise gym.error.ResetNeeded("the first reset() must start all rows: it takes no reset_mask")
        kernels = self._kernels
        self._generators.seed(seeds, mask)
        if others is not None or self._changed:
            self._changed = True
            self._rows.put_cars(others or self.fleet, mask)
        kernels.start(self._numbers, mask, self._generators.addresses)
        if changes:
            self._rows.put(changes, mask)
            self._rows.refill(self.task, self.fleet, self.rules, mask)
        if self.staggered_start and masked is None and self.max_episode_steps is not None:
            spread = np.arange(self.num_envs) * self.max_episode_steps // self.num_envs
            self._rows.put({"steps": spread.astype(np.float64)}, mask)
        self._started = True
        observation, values, flags, end = results = self._new_results()
        self._kernels.look(self._numbers, self._everyone, observation, values)
        flags[2], end[:] = self.is_success, self._rows.column("end")
        return observation, self._info(results)

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One control step of all rows, or ``action_repeat`` of them; finite values outside [-1, 1] saturate.

        Args:
            actions: (num_envs, axles). A row that is waiting for its reset ignores its values.

        Returns:
            Observations (num_envs, entries) float32, rewards (num_envs,) float64, terminated, truncated, info.

        Raises:
            ValueError, TypeError: actions of another shape or type, or not finite with on_invalid="raise"; nothing
                has changed then.
            gymnasium.error.ResetNeeded: there was no reset.
            gymnasium.error.ClosedEnvironmentError: after close().
        """
        if not self._started:  # nor is it after close()
            self._refuse_if_closed("step()")
            raise gym.error.ResetNeeded("call reset() before step()")
        if (
            type(actions) is not np.ndarray
            or actions.dtype is not FLOAT32
            or actions.shape != self._action_shape
            or not actions.flags.carray
        ):
            actions = converted_action(actions, self._action_shape, self.steer)
        observation, values, flags, end = results = self._new_results()
        ended = self._drive(actions, results, self._restarts)
        if self._plain or (not ended and self._tells_little):
            cost, success, here = values[1], flags[2], flags[3]
            info = {"end": end, "cost": cost, "is_success": success, "_end": here, "_cost": here, "_is_success": here}
            return observation, values[0], flags[0], flags[1], info
        more: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended:
            more = self._restarted(flags[0] | flags[1], results)
        return observation, values[0], flags[0], flags[1], {**self._info(results), **more}

    def close_extras(self, **_: Any) -> None:
        """Stop the threads; then only what is, such as ``state``, can be asked."""
        self._threads.stop()
        self._started = False

    # What else a user may ask

    @property
    def state(self) -> Any:
        """The present states: the single environment's named tuple, of arrays (num_envs,); copies."""
        time = self._rows.column("steps") * self.control_timestep
        return self._rows.record(self.configuration.State, time=time)

    @state.setter
    def state(self, _value: Any) -> None:
        raise AttributeError(read_only("state"))

    @property
    def is_success(self) -> NDArray[np.bool_]:
        """(num_envs,): running, and settled for the last second; at a time-out, a success."""
        settled = self._rows.column("settled_steps") >= self.configuration.steps_to_settle
        return np.asarray(settled & (self._rows.column("end") == 0))

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generator of each row, as SyncVectorEnv gives them."""
        return self._generators.each()

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of each row: what ``reset`` last gave it, or a random one."""
        return self._generators.seeds()

    def measure(self) -> dict[str, NDArray[np.float64]]:
        """Slip angles, forces, accelerations and the reference in the present states, (num_envs,) each."""
        out = np.empty((self.num_envs, len(MEASURED)))
        self._kernels.measure(self._numbers, out)
        return dict(zip(MEASURED, np.ascontiguousarray(out.T), strict=True))

    def snapshot(self) -> VectorSnapshot:
        """The whole state of all rows, random generators included; ResetNeeded before the first reset."""
        if not self._started:
            self._refuse_if_closed("snapshot()")
            raise gym.error.ResetNeeded("call reset() before snapshot()")
        return VectorSnapshot(self._rows.episodes.copy(), self._generators.states(), self.configuration.State._fields)

    def restore(self, snapshot: VectorSnapshot) -> NDArray[np.float32]:
        """Return to a snapshot of this or of an equally made environment; gives the observations there."""
        if not isinstance(snapshot, VectorSnapshot):
            raise TypeError(f"snapshot must come from snapshot() of an equal environment, got {type(snapshot)!r}")
        if not self._fits(snapshot):
            mine, theirs = self._rows.episodes, snapshot.rows
            raise ValueError(
                f"snapshot must come from an equal environment: this one has {self.num_envs} cars of {mine.shape[1]} "
                f"numbers, {mine.dtype}; the snapshot {len(snapshot.generators)} of {theirs.shape[1]}, {theirs.dtype}"
            )
        self._refuse_if_closed("restore()")
        self._generators.restore(snapshot.generators)
        self._rows.episodes[:] = snapshot.rows
        self._changed = self.fleet.varied
        self._started = True
        results = self._new_results()
        self._kernels.look(self._numbers, self._everyone, *results[:2])
        observation: NDArray[np.float32] = results[0]
        return observation

    def mixed(self, snapshot: VectorSnapshot, other: VectorSnapshot, names: Sequence[str]) -> VectorSnapshot:
        """A snapshot of this environment with numbers of the task's state, by name, as in another one."""
        return snapshot._replace(rows=self._rows.mixed(snapshot.rows, other.rows, names))

    # Inner workings

    def _fits(self, snapshot: VectorSnapshot) -> bool:
        mine, theirs = self._rows.episodes, snapshot.rows
        if snapshot.names not in ((), self.configuration.State._fields):
            return False
        return (mine.shape, mine.dtype, self.num_envs) == (theirs.shape, theirs.dtype, len(snapshot.generators))

    def _new_results(self) -> tuple[Any, Any, Any, Any]:
        """Observation, values (reward, cost), flags (terminated, truncated, success, all True) and end codes of a step.

        The last flags are what ``info`` says of which rows it tells; a copy of all four takes no longer than one array.
        """
        return (
            np.empty(self._observation_shape, FLOAT32),
            np.empty(self._value_shape),
            self._flags.copy(),
            np.empty(self.num_envs, INT8),
        )

    @functools.cached_property
    def _drive(self) -> Callable[..., int]:
        return self._run_once if self.action_repeat == 1 else self._run_repeated

    def _run_once(self, actions: Any, results: tuple[Any, Any, Any, Any], restarts: bool) -> int:
        """One control step, and how many rows have ended."""
        ended = self._run(self._numbers, actions, self._generators.addresses, *results, restarts, 0, self._blocks)
        if ended < 0:
            ended = self._run_without(~np.all(np.isfinite(actions), axis=1), actions, results, restarts)
        return ended

    def _run_repeated(self, actions: Any, results: tuple[Any, Any, Any, Any], restarts: bool) -> int:
        """``action_repeat`` control steps: rows that end stay where they are; the sum of the rewards."""
        waiting, (observation, values, flags, end) = self._over, results
        self._run_once(actions, results, False)
        total = values[0].copy()
        for _ in range(self.action_repeat - 1):
            self._run_once(actions, results, False)
            total += values[0]
        values[0] = total
        if restarts and np.any(waiting):
            self._kernels.start(self._numbers, waiting, self._generators.addresses)
            self._kernels.look(self._numbers, waiting, observation, values)
            flags[:3, waiting], end[waiting] = False, 0
        return int(np.count_nonzero(flags[0] | flags[1]))

    def _run_shared(self, *arguments: Any) -> int:
        """The compiled step, its blocks shared among the threads."""
        arguments, actions = arguments[:-2], arguments[1]
        finite = np.isfinite(actions)
        if not np.all(finite) and np.any(~np.all(finite, axis=1) & ~self._over):  # before any thread changes anything
            return block_kernels.BAD_ACTION
        return self._threads.sum(self._kernels.step, arguments)

    def _run_without(self, bad: Any, actions: Any, results: tuple[Any, Any, Any, Any], restarts: bool) -> int:
        """A step of which some rows' actions are not finite: refused, or the end of those rows' episodes."""
        bad &= ~self._over  # a row that is waiting takes no action
        if self.on_invalid == "raise":
            row = int(np.argmax(bad))
            raise ValueError(f"actions must be finite, nominally in [-1, 1]; row {row} has {actions[row]}")
        spoiled = self._rows.copy_of(bad)
        finite = np.where(np.isfinite(actions), actions, FLOAT32.type(0.0))
        self._run(self._numbers, finite, self._generators.addresses, *results, restarts, 0, self._blocks)
        observation, values, flags, end = results
        self._rows.put_back(spoiled, bad)
        self._rows.put({"end": INVALID_ACTION}, bad)
        self._kernels.look(self._numbers, bad, observation, values)
        values[0, bad] = self._forfeit(bad)
        flags[0, bad], flags[1:3, bad], end[bad] = True, False, INVALID_ACTION
        return int(np.count_nonzero(flags[0] | flags[1]))

    def _restarted(self, over: Any, results: tuple[Any, Any, Any, Any]) -> dict[str, Any]:
        """Start the rows that have ended, in the same step; their last observation and info."""
        observation, values, flags, end = results
        final_info = self._info((None, values.copy(), flags.copy(), end.copy()), over)
        final = {"final_obs": observation.copy(), "_final_obs": over, "final_info": final_info}
        self._kernels.start(self._numbers, over, self._generators.addresses)
        self._kernels.look(self._numbers, over, observation, values)
        end[over], flags[2, over] = 0, False
        return {**final, "_final_info": over.copy()}

    @property
    def _over(self) -> NDArray[np.bool_]:
        """(num_envs,): the rows whose episode has ended."""
        limit = math.inf if self.max_episode_steps is None else self.max_episode_steps
        return np.asarray((self._rows.column("end") > 0) | (self._rows.column("steps") >= limit))

    def _info(self, results: tuple[Any, Any, Any, Any], rows: Any = None) -> dict[str, Any]:
        _, values, flags, end = results
        info = {"end": end, "cost": values[1], "is_success": flags[2]}
        info |= {name: self._rows.column(name) for name in self.task.told}
        if self.telemetry:
            info |= telemetry(self.state, self.measure())
        here = flags[3] if rows is None else rows.copy()
        return {**info, **{f"_{name}": here for name in info}}

    def _forfeit(self, rows: Any) -> Any:
        """What an invalid action costs: with the quadratic reward, all steps that are left at the worst."""
        law = self.reward.forfeit(NUMPY, self.task)
        reward = 0.0 if law is None else law(self._rows.column("steps"), self._rows.cars(self.fleet)[0], self.rules)
        return np.broadcast_to(reward, self.num_envs)[rows]

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions and threads stay in their process: all are made anew.
        left = ("_kernels", "_run", "_drive", "_threads", "_numbers", "_blocks")
        return {name: value for name, value in self.__dict__.items() if name not in left}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()
