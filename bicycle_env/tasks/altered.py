"""Tasks made of another task: all laws are its, but for what a subclass says otherwise.

What an experimenter adds to any task (drawn parameters, disturbances, a driver, delays) is such a task, so that the
environments know nothing of it. What it has to keep of an episode stands behind the other task's own state.

So is what users add to any task, from their own file: another entry of the observation (``entries`` and ``observe``), a
car that depends on where it is (``conditions``), marks on the road.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.model import Model
from bicycle_env.physics.records import joined, part, record_of
from bicycle_env.tasks.ends import Limits, Tolerances
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.marks import Mark
from bicycle_env.tasks.metrics import Metric
from bicycle_env.tasks.task import Allowed, Entry, History, Law, Task


@dataclasses.dataclass(frozen=True)
class AlteredTask(Task):
    """Base of the tasks that change something of another task."""

    task: Task

    def __post_init__(self) -> None:
        if not isinstance(self.task, Task):
            raise TypeError(f"task must be a bicycle_env.tasks.task.Task, got {self.task!r}")

    # What a subclass may add to the task's own state

    @property
    def kept(self) -> tuple[str, ...]:
        """The names of the numbers that stand behind the other task's state."""
        return ()

    @property
    def kept_flipped(self) -> tuple[str, ...]:
        """Those of them that change sign in the mirror image."""
        return ()

    @property
    def kept_hidden(self) -> tuple[str, ...]:
        """Those of them that are drawn and that the first observation does not tell."""
        return ()

    @property
    def Kept(self) -> Any:
        """Named-tuple class of them."""
        return record_of("Kept", self.kept)

    @property
    def numbers(self) -> Mapping[str, float]:
        """Numbers that stand in the settings, after the other task's: others do not make anything compile anew."""
        return {}

    @property
    def draws(self) -> int:
        """How many more uniform numbers a start takes; they come after the other task's."""
        return 0

    def draw(self, xp: Any) -> Law:
        """``draw(uniforms, state, own, world) -> Kept`` at the start; ``own``: the other task's state.

        Its uniform numbers are those from ``self.task.uniforms`` on. Needed where something is ``kept``.
        """
        raise NotImplementedError(f"what is kept, {', '.join(self.kept)}, needs a law 'draw'")

    def update(self, xp: Any) -> Law | None:
        """``update(state, episode, action, world) -> Kept`` after a step, or None where they stay; see ``remember``."""
        return None

    def refill(self, xp: Any) -> Law | None:
        """``refill(state, episode, world) -> Kept`` where a start's state was given, or None where they stay."""
        return None

    # The laws, all the other task's

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.task.name

    @property
    def episode_steps(self) -> int:  # type: ignore[override]
        return self.task.episode_steps

    @property
    def TaskState(self) -> Any:
        return self._more(self.task.TaskState, self.kept)

    @property
    def State(self) -> Any:
        return self._more(self.task.State, self.kept)

    @property
    def Settings(self) -> Any:
        return self._more(self.task.Settings, tuple(self.numbers))

    @property
    def uniforms(self) -> int:  # type: ignore[override]
        return self.task.uniforms + self.draws

    @property
    def ends(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.task.ends

    @property
    def options(self) -> Mapping[str, Allowed]:  # type: ignore[override]
        return self.task.options

    @property
    def rewards(self) -> Any:  # type: ignore[override]
        return self.task.rewards

    @property
    def settled_seconds(self) -> float:  # type: ignore[override]
        return self.task.settled_seconds

    @property
    def uniform_corridor(self) -> bool:  # type: ignore[override]
        return self.task.uniform_corridor

    @property
    def defaults(self) -> Mapping[str, Any]:  # type: ignore[override]
        return self.task.defaults

    @property
    def companions(self) -> tuple[str, ...]:
        return self.task.companions

    @property
    def judged_points(self) -> int:  # type: ignore[override]
        return self.task.judged_points

    @property
    def flipped(self) -> tuple[str, ...] | None:  # type: ignore[override]
        inner = self.task.flipped
        return None if inner is None else (*inner, *self.kept_flipped)

    @property
    def hidden(self) -> tuple[str, ...]:  # type: ignore[override]
        return (*self.task.hidden, *self.kept_hidden)

    @property
    def forfeits(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.task.forfeits

    @property
    def limits(self) -> Limits:
        return self.task.limits

    @property
    def tolerances(self) -> Tolerances:
        return self.task.tolerances

    @property
    def road_half_width(self) -> float:
        return self.task.road_half_width

    @property
    def preview_times(self) -> tuple[float, ...]:
        return self.task.preview_times

    @property
    def usual_speed(self) -> float | None:
        return self.task.usual_speed

    @property
    def metrics(self) -> tuple[Metric, ...]:
        return self.task.metrics

    @property
    def histories(self) -> tuple[History, ...]:
        return self.task.histories

    @property
    def told(self) -> tuple[str, ...]:
        return self.task.told

    def seconds_to_pass(self, car: CarParameters) -> float:
        return self.task.seconds_to_pass(car)

    def settings(self, speed: float) -> Any:
        return self.Settings(*self.task.settings(speed), *self.numbers.values())

    def _more(self, record: Any, names: tuple[str, ...]) -> Any:
        taken = set(names) & set(record._fields)
        if taken:
            raise ValueError(f"{', '.join(sorted(taken))}: the task {self.name} has a number of that name already")
        return record_of(record.__name__, (*record._fields, *names)) if names else record

    def start(self, xp: Any) -> Law:
        inner = self.task.start(xp)
        if not self.kept:
            return inner
        law, draw = xp.function(inner), xp.function(self.draw(xp))
        join = joined(xp, self.TaskState, self.task.TaskState, self.Kept)

        def start(uniforms: Any, world: World) -> tuple[CarState, Any]:
            state, own = law(uniforms, world)
            return state, join(own, draw(uniforms, state, own, world))

        return start

    def remember(self, xp: Any) -> Law | None:
        inner, update = self.task.remember(xp), self.update(xp)
        if not self.kept or (inner is None and update is None):
            return inner
        join = joined(xp, self.TaskState, self.task.TaskState, self.Kept)
        own_law = xp.function(inner or unchanged(xp, self.task.TaskState))
        kept_law = xp.function(update or unchanged(xp, self.Kept))

        def remember(state: CarState, episode: EpisodeState, action: Any, world: World) -> Any:
            return join(own_law(state, episode, action, world), kept_law(state, episode, action, world))

        return remember

    def refilled(self, xp: Any) -> Law | None:
        inner, refill = self.task.refilled(xp), self.refill(xp)
        if not self.kept or (inner is None and refill is None):
            return inner
        join = joined(xp, self.TaskState, self.task.TaskState, self.Kept)
        own_of, kept_of = part(xp, self.task.TaskState), part(xp, self.Kept)

        def refilled(state: CarState, episode: EpisodeState, world: World) -> Any:
            own = own_of(episode.task_state) if inner is None else inner(state, episode, world)
            return join(own, kept_of(episode.task_state) if refill is None else refill(state, episode, world))

        return refilled

    def reference(self, xp: Any) -> Law:
        return self.task.reference(xp)

    def observe(self, xp: Any) -> Law:
        return self.task.observe(xp)

    def preview(self, xp: Any) -> Law:
        return self.task.preview(xp)

    def command(self, xp: Any) -> Law | None:
        return self.task.command(xp)

    def conditions(self, xp: Any) -> Law | None:
        return self.task.conditions(xp)

    def accompany(self, xp: Any, model: Model) -> Law | None:
        return self.task.accompany(xp, model)

    def end(self, xp: Any) -> Law:
        return self.task.end(xp)

    def success(self, xp: Any) -> Law:
        return self.task.success(xp)

    def cost(self, xp: Any) -> Law:
        return self.task.cost(xp)

    def marks(self, task_state: Any, world: World) -> tuple[Mark, ...]:
        return self.task.marks(task_state, world)

    def entries(self, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
        return self.task.entries(speed, front_limit, rear_limit)

    def task_state_with(self, task_state: Any, numbers: Mapping[str, Any], speed: Any) -> Any:
        return self.task.task_state_with(task_state, numbers, speed)


def unchanged(xp: Any, record: Any) -> Law:
    """``f(state, episode, action, world) -> record``: of the task's state, as it was."""
    of = part(xp, record)

    def same(state: CarState, episode: EpisodeState, action: Any, world: World) -> Any:
        return of(episode.task_state)

    return same
