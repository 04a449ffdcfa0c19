"""The native vector environment: thousands of cars, one compiled call a step. It holds the arrays; no physics here."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from bicycle_env.envs.fleet import ConfiguredFleet
from bicycle_env.envs.many import block_kernels, blocks
from bicycle_env.envs.many.generators import Generators, checked_seeds
from bicycle_env.envs.many.rows import Rows, checked_cars, checked_mask, checked_start
from bicycle_env.envs.many.threads import Threads
from bicycle_env.envs.registered_fleet import fleet_of
from bicycle_env.envs.single.single_track_env import FLOAT32, ONE_CAR, SingleTrackEnv, converted_action, keyword_names
from bicycle_env.envs.telemetry import MEASURED, telemetry
from bicycle_env.envs.time_limit import remark
from bicycle_env.envs.told import Told, read_only, tell
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.validation import choice, flag, known_keys, whole
from bicycle_env.tasks.ends import INVALID_ACTION
from bicycle_env.tasks.episode import EpisodeState, World

BOOL, INT8 = np.dtype(np.bool_), np.dtype(np.int8)
MODES = {mode.value: mode for mode in AutoresetMode}
MOST_THREADS = 1024
MOST_STEPS = {"float64": 10**9, "float32": 2**24}
"""float32 counts no further."""


class VectorSnapshot(NamedTuple):
    """All that the future of a vector environment depends on."""

    rows: NDArray[Any]
    generators: tuple[Any, ...]
    names: tuple[str, ...] = ()
    """Of the numbers of the task's state."""


class SingleTrackVectorEnv(ConfiguredFleet, gym.vector.VectorEnv[Any, Any, Any]):
    """Base of the vector environments; the subclasses name a task.

    Row i is, to the bit, the single environment that was seeded with ``seed + i``, for any number of rows and threads.

    Args:
        num_envs: how many cars.
        max_episode_steps: time limit in control steps; by default the task's, -1: none.
        autoreset_mode: "NextStep", "SameStep" or "Disabled", or Gymnasium's enum. "SameStep" returns the last
            observation and info of a row that ended as ``info["final_obs"]`` (num_envs, entries) and
            ``info["final_info"]``, the latter with ``is_success``. "Disabled": reset rows by
            ``reset(options={"reset_mask": mask})``; a row that has ended stays where it is.
        dtype: "float64", or "float32" for twice the speed.
        threads: share the rows among so many threads.
        staggered_start: after a reset of all rows, the episode of row i begins at a later time of its clock, evenly
            spread, so that the time-outs of all rows do not fall together.
        on_invalid: an action that is not finite: "raise", before anything changes; or "terminate" its row, with the
            end code 3, while the others go on.
        telemetry: more in ``info``.
        varied: each car has numbers of its own, which the options ``vehicle``, ``speed`` and ``friction`` of ``reset``
            may change. So it is in any case where a keyword is given per car.
        render_mode: must be None: draw with a single environment.
        keywords: those of the single environment. vehicle, speed, speed_ratio, friction and
            relaxation_length take one value or num_envs.

    ``info``: ``end`` (num_envs,) int8, see ``end_names``; ``cost`` (num_envs,).
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (declared so by Gymnasium)
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    single_class: ClassVar[type[SingleTrackEnv]]
    threads = Told[int]()

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
        **keywords: Any,
    ) -> None:
        own = [name for name in inspect.signature(SingleTrackVectorEnv).parameters if name != "keywords"]
        shared = [name for name in keyword_names(self.single_class) if name not in ONE_CAR]
        known_keys("keyword", keywords, [*own, *shared], TypeError)
        self.num_envs = whole("num_envs", num_envs)
        mode = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        self.autoreset_mode = MODES[choice("autoreset_mode", mode, MODES)]
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        tell(
            self,
            dtype=choice("dtype", dtype, ("float64", "float32")),
            threads=whole("threads", threads, 1, MOST_THREADS),
            staggered_start=flag("staggered_start", staggered_start),
            on_invalid=choice("on_invalid", on_invalid, ("raise", "terminate")),
            telemetry=flag("telemetry", telemetry),
        )
        if render_mode is not None:
            raise ValueError(f"render_mode must be None for many cars (draw one by gym.make), got {render_mode!r}")
        steps = self.single_class.default_task.episode_steps if max_episode_steps is None else max_episode_steps
        limit = None if steps == -1 else whole("max_episode_steps", steps, 1, MOST_STEPS[self.dtype])
        self._adopt_fleet(fleet_of(self.single_class, self.num_envs, keywords, limit, flag("varied", varied)))
        tell(self, max_episode_steps=limit, end_names=self.configuration.end_names)
        remark(limit, keywords.get("horizon"), self.configuration.steps_to_settle, self.reward.uses_horizon)

        bound = self.configuration.observation_bound
        self.single_observation_space = spaces.Box(-bound, bound, dtype=np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (self.configuration.axles,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._observation_shape = (self.num_envs, len(bound))
        self._value_shape = (2, self.num_envs)
        self._action_shape = (self.num_envs, self.configuration.axles)

        self._kind = blocks.Kind(
            self.task,
            self.model,
            len(bound),
            blocks.best_length(self.num_envs),
            self.fleet.varied,
            self.dtype,
        )
        self._rows = Rows(self._kind, self.fleet, self.num_envs, self.max_episode_steps)
        self._everyone = np.ones(self.num_envs, dtype=np.bool_)
        self._started = False
        always = self.telemetry or bool(self.task.told)
        self._tells_little = not always
        self._plain = self.autoreset_mode is not AutoresetMode.SAME_STEP and not always
        self._restarts = self.autoreset_mode is AutoresetMode.NEXT_STEP
        self._generators = Generators(self.num_envs)
        self._bind()

    def _bind(self) -> None:
        self._kernels = block_kernels.kernels(self._kind, self.reward)
        self._step = self._kernels.step
        self._numbers, self._blocks = self._rows.numbers, self._rows.blocks
        self._threads = Threads(self.threads, self.num_envs, self._blocks)
        self._run = self._run_shared if self._threads.helpers else self._step

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
        self._generators.seed(seeds, mask)
        if self.fleet.varied:
            self._rows.put_cars(others or self.fleet, mask)
        self._kernels.start(self._numbers, mask, self._generators.addresses)
        if changes:
            self._rows.put(changes, mask)
            self._refill(mask)
        if self.staggered_start and masked is None and self.max_episode_steps is not None:
            spread = np.arange(self.num_envs) * self.max_episode_steps // self.num_envs
            self._rows.put({"steps": spread.astype(np.float64)}, mask)
        self._started = True
        observation, values, _, _ = self._new_results()
        self._kernels.look(self._numbers, self._everyone, observation, values)
        return observation, self._info(self._rows.column("end").astype(np.int8), values[1])

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
        results = self._new_results()
        once = self.action_repeat == 1
        ended = self._run_once(actions, results, self._restarts) if once else self._run_repeated(actions, results)
        observation, values, flags, end = results
        if self._plain or (not ended and self._tells_little):
            here = self._everyone.copy()
            info = {"end": end, "cost": values[1], "_end": here, "_cost": here}
            return observation, values[0], flags[0], flags[1], info
        more: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended:
            more = self._restarted(flags[0] | flags[1], observation, values, end)
        return observation, values[0], flags[0], flags[1], {**self._info(end, values[1]), **more}

    def close_extras(self, **_: Any) -> None:
        """Stop the threads; then only what is, such as ``state``, can be asked."""
        self._threads.stop()
        self._started = False

    # What else a user may ask

    @property
    def state(self) -> Any:
        """The present states: the single environment's named tuple, of arrays (num_envs,); copies."""
        return self._rows.state(self.configuration.State, self.control_timestep)

    @state.setter
    def state(self, _value: Any) -> None:
        raise AttributeError(read_only("state"))

    @property
    def is_success(self) -> NDArray[np.bool_]:
        """(num_envs,): running, and settled for the last second; at a time-out, a success."""
        return np.asarray(self._settled & (self._rows.column("end") == 0))

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
        self._started = True
        results = self._new_results()
        self._kernels.look(self._numbers, self._everyone, *results[:2])
        observation: NDArray[np.float32] = results[0]
        return observation

    # Inner workings

    def _refill(self, mask: NDArray[np.bool_]) -> None:
        """What the task keeps of a start, in the rows of a mask, after their starts were changed by options."""
        law = self.task.refilled(NUMPY)
        if law is not None:
            state, task = self.state, self.task
            own = task.TaskState(*(getattr(state, name) for name in task.TaskState._fields))
            zero = np.zeros(self.num_envs)
            episode = EpisodeState(state.front_steer_command, state.rear_steer_command, zero, zero, own)
            car, settings = self._rows.cars(self.fleet)
            world = World(car, self.rules, settings)
            place = self.model.State(*(getattr(state, name) for name in self.model.State._fields))
            filled = law(place, episode, world)
            self._rows.put(filled._asdict(), mask)

    def _fits(self, snapshot: VectorSnapshot) -> bool:
        mine, theirs = self._rows.episodes, snapshot.rows
        if snapshot.names not in ((), self.configuration.State._fields):
            return False
        return (mine.shape, mine.dtype, self.num_envs) == (theirs.shape, theirs.dtype, len(snapshot.generators))

    def _new_results(self) -> tuple[Any, Any, Any, Any]:
        """Observation, values (reward, cost), flags (terminated, truncated) and end codes of a step."""
        return (
            np.empty(self._observation_shape, FLOAT32),
            np.empty(self._value_shape),
            np.empty(self._value_shape, BOOL),
            np.empty(self.num_envs, INT8),
        )

    def _run_once(self, actions: Any, results: tuple[Any, Any, Any, Any], restarts: bool) -> int:
        """One control step, and how many rows have ended."""
        ended = self._run(self._numbers, actions, self._generators.addresses, *results, restarts, 0, self._blocks)
        if ended < 0:
            ended = self._run_without(~np.all(np.isfinite(actions), axis=1), actions, results, restarts)
        return ended

    def _run_repeated(self, actions: Any, results: tuple[Any, Any, Any, Any]) -> int:
        """``action_repeat`` control steps: rows that end stay where they are; the sum of the rewards."""
        waiting, (observation, values, flags, end) = self._over, results
        self._run_once(actions, results, False)
        total = values[0].copy()
        for _ in range(self.action_repeat - 1):
            self._run_once(actions, results, False)
            total += values[0]
        values[0] = total
        if self._restarts and np.any(waiting):
            self._kernels.start(self._numbers, waiting, self._generators.addresses)
            self._kernels.look(self._numbers, waiting, observation, values)
            flags[:, waiting], end[waiting] = False, 0
        return int(np.count_nonzero(flags[0] | flags[1]))

    def _run_shared(self, *arguments: Any) -> int:
        """``_step``, its blocks shared among the threads."""
        arguments, actions = arguments[:-2], arguments[1]
        finite = np.isfinite(actions)
        if not np.all(finite) and np.any(~np.all(finite, axis=1) & ~self._over):  # before any thread changes anything
            return block_kernels.BAD_ACTION
        return self._threads.sum(self._step, arguments)

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
        flags[0, bad], flags[1, bad], end[bad] = True, False, INVALID_ACTION
        return int(np.count_nonzero(flags[0] | flags[1]))

    def _restarted(self, over: Any, observation: Any, values: Any, end: Any) -> dict[str, Any]:
        """Start the rows that have ended, in the same step; their last observation and info."""
        final_info = self._info(end.copy(), values[1].copy(), over)
        final = {"final_obs": observation.copy(), "_final_obs": over, "final_info": final_info}
        self._kernels.start(self._numbers, over, self._generators.addresses)
        self._kernels.look(self._numbers, over, observation, values)
        end[over] = 0
        return {**final, "_final_info": over.copy()}

    @property
    def _over(self) -> NDArray[np.bool_]:
        """(num_envs,): the rows whose episode has ended."""
        limit = math.inf if self.max_episode_steps is None else self.max_episode_steps
        return np.asarray((self._rows.column("end") > 0) | (self._rows.column("steps") >= limit))

    @property
    def _settled(self) -> NDArray[np.bool_]:
        return np.asarray(self._rows.column("settled_steps") >= self.configuration.steps_to_settle)

    def _info(self, end: Any, cost: Any, rows: Any = None) -> dict[str, Any]:
        info = {"end": end, "cost": cost, **{name: self._rows.column(name) for name in self.task.told}}
        if self.telemetry:
            info |= telemetry(self.state, self.measure())
        if self.telemetry or rows is not None:  # a row that has begun its next episode cannot be asked any more
            info["is_success"] = self._settled & (end == 0)
        here = self._everyone.copy() if rows is None else rows.copy()
        return {**info, **{f"_{name}": here for name in info}}

    def _forfeit(self, rows: Any) -> Any:
        """What an invalid action costs: with the quadratic reward, all steps that are left at the worst."""
        law = self.reward.forfeit(NUMPY, self.task)
        reward = 0.0 if law is None else law(self._rows.column("steps"), self._rows.cars(self.fleet)[0], self.rules)
        return np.broadcast_to(reward, self.num_envs)[rows]

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions and threads stay in their process: all are made anew.
        left = ("_kernels", "_step", "_run", "_threads", "_numbers", "_blocks")
        return {name: value for name, value in self.__dict__.items() if name not in left}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()
