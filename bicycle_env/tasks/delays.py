"""Delays, in control steps: actions that arrive later, observations that are of earlier, or of several times."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

from bicycle_env.physics.car import CarState
from bicycle_env.physics.records import composed, field, sequence
from bicycle_env.tasks.altered import AlteredTask, unchanged
from bicycle_env.tasks.control_step import command_of
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.task import Entry, Law

MOST_DELAY = 50
MOST_FRAMES = 50


@dataclasses.dataclass(frozen=True)
class LateActions(AlteredTask):
    """An action acts so many control steps after it was given; before the first one, straight wheels.

    The reward is that of the action given.
    """

    steps: int

    @property
    def kept(self) -> tuple[str, ...]:
        return tuple(f"{axle}_action_{k}" for k in range(1, self.steps + 1) for axle in ("front", "rear"))

    @property
    def kept_flipped(self) -> tuple[str, ...]:
        return self.kept

    def draw(self, xp: Any) -> Law:
        zeros = composed(xp, self.Kept, ["0.0 * state.heading"] * len(self.kept), "state")

        def draw(uniforms: Any, state: CarState, own: Any, world: World) -> Any:
            return zeros(state)

        return draw

    def update(self, xp: Any) -> Law:
        older = (f"own.{name}" for name in self.kept[:-2])
        shift = composed(xp, self.Kept, ["action[0]", "action[1]", *older], "action, own")

        def update(state: CarState, episode: EpisodeState, action: Any, world: World) -> Any:
            return shift(action, episode.task_state)

        return update

    def command(self, xp: Any) -> Law:
        inner = xp.function(command_of(xp, self.task))
        front, rear = (field(xp, name) for name in self.kept[-2:])

        def command(state: CarState, episode: EpisodeState, action: Any, world: World) -> tuple[Any, Any]:
            own = episode.task_state
            sent: tuple[Any, Any] = inner(state, episode, (front(own), rear(own)), world)
            return sent

        return command


@dataclasses.dataclass(frozen=True)
class LateObservations(AlteredTask):
    """What is observed is of so many control steps ago, at first of the start; the preview of the road is not late."""

    steps: int
    word: ClassVar[str] = "ago"
    """In the names of what is kept."""

    @property
    def _entries(self) -> tuple[Any, ...]:
        task = self.task
        entries = task.entries(30.0, 0.1, 0.1)  # names and mirror images do not depend on these
        return entries[: len(entries) - len(task.preview_times)]

    @property
    def kept(self) -> tuple[str, ...]:
        return tuple(f"{entry.name}_{k}_{self.word}" for k in range(self.steps + 1) for entry in self._entries)

    @property
    def kept_flipped(self) -> tuple[str, ...]:
        mirrors = [entry.mirror for _ in range(self.steps + 1) for entry in self._entries]
        return tuple(name for name, mirror in zip(self.kept, mirrors, strict=True) if mirror < 0.0)

    def draw(self, xp: Any) -> Law:
        observe, size = xp.function(self.task.observe(xp)), len(self._entries)
        fill = composed(xp, self.Kept, [f"values[{j % size}]" for j in range(len(self.kept))], "values")

        def draw(uniforms: Any, state: CarState, own: Any, world: World) -> Any:
            zero = 0.0 * state.heading
            return fill(observe(state, EpisodeState(zero, zero, zero, zero, own), world))

        return draw

    def refill(self, xp: Any) -> Law:
        observe, size = self.task.observe(xp), len(self._entries)
        refilled = self.task.refilled(xp)
        fill = composed(xp, self.Kept, [f"values[{j % size}]" for j in range(len(self.kept))], "values")

        def refill(state: CarState, episode: EpisodeState, world: World) -> Any:
            if refilled is not None:
                episode = episode._replace(task_state=refilled(state, episode, world))
            return fill(observe(state, episode, world))

        return refill

    def update(self, xp: Any) -> Law:
        observe, command = xp.function(self.task.observe(xp)), xp.function(command_of(xp, self.task))
        remember = xp.function(self.task.remember(xp) or unchanged(xp, self.task.TaskState))
        size = len(self._entries)
        older = (f"own.{name}" for name in self.kept[:-size])
        shift = composed(xp, self.Kept, [*(f"values[{j}]" for j in range(size)), *older], "values, own")

        def update(state: CarState, episode: EpisodeState, action: Any, world: World) -> Any:
            front, rear = command(state, episode, action, world)
            own = remember(state, episode, action, world)
            after = EpisodeState(front, rear, episode.steps + 1.0, episode.settled_steps, own)
            return shift(observe(state, after, world), episode.task_state)

        return update

    def observe(self, xp: Any) -> Law:
        return self._told(xp, self.kept[-len(self._entries) :])

    def _told(self, xp: Any, names: tuple[str, ...]) -> Law:
        late = sequence(xp, [f"own.{name}" for name in names], "own")

        def observe(state: CarState, episode: EpisodeState, world: World) -> tuple[Any, ...]:
            values: tuple[Any, ...] = late(episode.task_state)
            return values

        return observe


@dataclasses.dataclass(frozen=True)
class Frames(LateObservations):
    """The latest observations side by side, the newest first, at first all of the start; then the newest preview.

    `steps`: how many of earlier there are.
    """

    word = "kept"

    def entries(self, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
        newest = self.task.entries(speed, front_limit, rear_limit)
        seen = newest[: len(self._entries)]
        earlier = (
            entry._replace(name=f"{entry.name}_{k}_ago", meaning=f"{k} control steps ago")
            for k in range(1, self.steps + 1)
            for entry in seen
        )
        return (*seen, *earlier, *newest[len(seen) :])

    def observe(self, xp: Any) -> Law:
        return self._told(xp, self.kept)
