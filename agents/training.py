"""What the trainers of this package share: a run in its folder, its learning curve, its best policy, its checkpoints.

A trainer asks :class:`Run` between two of its updates, where nothing is half done: what is due is written, and a run
that was stopped and goes on from there gives the policy of one that was not, to the bit, on one machine with one set of
versions. agents.train, whose loop is Stable-Baselines3's, takes :class:`Selection` alone.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from agents import messages, stopping
from agents.episodes import start_seeds
from agents.messages import UserError
from agents.run_folder import Folder, begun, changes, earlier_record, held, refuse_run
from agents.state_arrays import ANY, Arrays, State
from bicycle_env import control, optimum, provenance
from bicycle_env.files import FileError, shown

SELECTED = 500
"""Starts on which the best policy of a run is chosen; they are in no table."""
SELECTION_SEED = 0
ASSESSMENTS = 20
"""Points of the learning curve."""
CHECKPOINTS = 10
LINES = 10
"""That tell how far a run is, where no bar can be drawn."""
LARGEST_STATE = 200_000_000  # bytes

Watch = Callable[[int, float, float], None]
"""``watch(timesteps, success, mean return)`` on the starts that select, with the policy as it is then."""
Layers = list[tuple[NDArray[Any], NDArray[Any]]]
"""(weight (out, in), bias (out,)) of each affine layer."""


@dataclass
class Plan:
    """What a run is, and for how long."""

    env_id: str
    env_keywords: dict[str, Any]
    algo: str
    seed: int
    settings: dict[str, Any]
    total_timesteps: int

    @property
    def identity(self) -> dict[str, Any]:
        """What a run that goes on must have as before."""
        return {
            "env_id": self.env_id,
            "env_keywords": self.env_keywords,
            "algo": self.algo,
            "seed": self.seed,
            "settings": {**self.settings, "total_timesteps": self.total_timesteps},
        }


def manner(args: Any, plant: Any) -> dict[str, Any]:
    """What a policy's file says of how it acts, from the options `hold`, `history` and `mirrored`.

    Raises:
        UserError: `mirrored`, and the task has no mirror image.
    """
    found: dict[str, Any] = {"hold": args.hold, "history": args.history}
    if args.mirrored:
        if plant.task.flipped is None:
            raise UserError(f"--mirrored: the task {plant.task.name} has no mirror image; give --no-mirrored")
        found["mirror"] = plant.observation_mirror.astype(int).tolist()
    return found


def damaged(error: Exception) -> UserError:
    """What is said of a checkpoint that cannot be used."""
    return UserError(f"--resume: the checkpoint is damaged: {shown(error)}")


def diverged(folder: Path, timesteps: int, saved_at: int) -> UserError:
    """What is said of a training whose weights are not finite after so many steps; its last checkpoint is before."""
    kept = f"the last good one, of {saved_at} steps, is kept" if saved_at else "there is none yet"
    return UserError(
        f"training has diverged: after {timesteps} steps weights are not finite; a smaller learning_rate may help. Of "
        f"the checkpoints in {folder} {kept}"
    )


class Selection:
    """A run's learning curve and its best policy: by success on starts of their own, by the mean return between equals.

    Assessing draws nothing from a generator of the training's: the cars and their starts are its own.
    """

    def __init__(self, cars: optimum.Cars) -> None:
        self._cars, self._seeds = cars, start_seeds(SELECTED, SELECTION_SEED, "select")
        self.curve: list[str] = []
        self.policy: control.Network | None = None
        """The best so far; None before the first is assessed."""
        self.best = (-1.0, 0.0, 0)  # less than any: success is at least 0
        """Its success, its mean return, and after how many steps it was."""

    @property
    def last(self) -> int:
        """After how many steps the curve's last point is; 0 if it has none."""
        return int(self.curve[-1].partition(",")[0]) if self.curve else 0

    def assess(self, policy: control.Network, timesteps: int, seconds: float, watch: Watch | None = None) -> None:
        """A point of the curve; the policy is kept if it is the best so far."""
        drives = control.on_base(policy, self._cars.plant, "policy")
        outcomes = optimum.drive(self._cars.of(len(self._seeds)), optimum.by(drives), self._seeds)
        success, mean_return, length = (float(np.mean(column)) for column in np.take(outcomes, (0, 2, 3), axis=0))
        self.curve.append(f"{timesteps},{seconds:.1f},{success:.4f},{mean_return:.3f},{length:.1f}")
        if (success, mean_return) > self.best[:2]:
            self.best, self.policy = (success, mean_return, timesteps), policy
        if watch is not None:
            watch(timesteps, success, mean_return)

    def state(self) -> State:
        """The best policy, as a checkpoint holds it; its curve stands in progress.json."""
        kept = {} if self.policy is None else {f"best.{name}": array for name, array in self.policy.arrays().items()}
        return {**kept, "best": np.array(self.best, np.float64)}

    def take_up(self, arrays: Arrays, curve: list[str], network: Callable[[Layers, int], control.Network]) -> None:
        """Put back what :meth:`state` gave; ValueError for what it cannot have given.

        Args:
            arrays: of a checkpoint.
            curve: of its progress.json.
            network: gives the policy of these layers, which it had after so many steps.
        """
        success, mean_return, when = arrays.take("best", np.float64, 3).tolist()
        layers: Layers = []
        while (name := f"best.layer{len(layers)}") + ".weight" in arrays:
            weight = arrays.take(f"{name}.weight", np.float32, ANY, ANY)
            layers.append((weight, arrays.take(f"{name}.bias", np.float32, ANY)))
        self.best, self.curve = (success, mean_return, int(when)), list(curve)
        self.policy = network(layers, int(when)) if layers else None

    def save(self, folder: Path) -> dict[str, Any]:
        """Write the best policy into a folder; gives what the run's record says of it."""
        if self.policy is None:
            raise ValueError("a run must be assessed before it finishes")
        self.policy.save(folder)
        success, mean_return, when = self.best
        figures = {"success_rate": success, "episode_return": mean_return}
        return {"timesteps": when, **figures, "starts": len(self._seeds)}

    def summary(self, name: str, env_id: str, timesteps: int, seconds: float, folder: Path) -> str:
        """What is said at the end of a run: how good the best is, where it is, how it is evaluated."""
        success, _, when = self.best
        return (
            f"{name}: {timesteps:,} steps in {seconds:.0f} s; the best policy, "
            f"after {when:,} of them, saves {100.0 * success:.1f} % of the {len(self._seeds)} starts that chose it\n"
            f"policy and record of the run: {folder}\n"
            f"evaluate it, with the keywords of its training: python -m agents.evaluate --env-id {env_id} "
            f"--policy {folder}"
        )


class Run:
    """A training under way: made by :func:`run_in`.

    Args:
        folder: its own.
        plan: what it is.
        cars: of its environment, on which policies are assessed.
        manner: what the policy's file says of how it acts: "hold", "history", "mirror".
    """

    def __init__(self, folder: Folder, plan: Plan, cars: optimum.Cars, manner: Mapping[str, Any]) -> None:
        self._folder, self._plan, self._manner = folder, plan, manner
        self._names, self._selection = list(cars.plant.observation_names), Selection(cars)
        made_by = provenance.collect()
        self._made_by = {name: made_by[name] for name in ("versions", "machine", "git")}
        self.record = {**plan.identity, **made_by, "finished": False, "resumed": []}
        self._saved_at, self._before, self._start = 0, 0.0, time.perf_counter()
        self.timesteps = 0
        """Control steps that all cars have driven."""
        self.request = stopping.Request()
        self._tell: Callable[[], None] = lambda: None
        self.watch: Watch | None = None

    @property
    def seconds(self) -> float:
        """Of training and assessing, those before a stop included."""
        return self._before + time.perf_counter() - self._start

    @property
    def best(self) -> tuple[float, float, int]:
        """Of the best policy: success and mean return on the starts that select, and after how many steps it was."""
        return self._selection.best

    def network(self, layers: Layers, timesteps: int | None = None) -> control.Network:
        """A multilayer perceptron with tanh, without its base, as it was after so many steps; by default now's."""
        steps = self.timesteps if timesteps is None else timesteps
        identity = {name: value for name, value in self._plan.identity.items() if name != "settings"}
        description = {**identity, "timesteps": steps, "observation_names": self._names, **self._manner}
        return control.Network(layers, "tanh", "clip", description)

    def after_update(
        self, timesteps: int, policy: Callable[[], control.Network], state: Callable[[], State], finite: bool
    ) -> None:
        """What is due after so many steps: a point of the learning curve, a checkpoint, the end.

        Args:
            timesteps: control steps that all cars have driven.
            policy: gives the deterministic policy as it is now.
            state: gives the arrays that the trainer goes on from.
            finite: whether all that was learned is.

        Raises:
            UserError: the training has diverged.
            Stopped: a signal came; a checkpoint is written.
        """
        if not finite:
            kept = f"the last good one, of {self._saved_at} steps, is kept" if self._saved_at else "there is none yet"
            raise UserError(
                f"training has diverged: after {timesteps} steps weights are not finite; a smaller learning rate may "
                f"help. Of the checkpoints in {self._folder.path} {kept}"
            )
        before, self.timesteps = self.timesteps, timesteps
        self._tell()
        total = self._plan.total_timesteps
        over = timesteps >= total
        if over or _passed(before, timesteps, total, ASSESSMENTS):
            self._selection.assess(policy(), timesteps, self.seconds, self.watch)
        if over or self.request.number is not None or _passed(before, timesteps, total, CHECKPOINTS):
            self._save(state())
        if self.request.number is not None and not over:
            raise stopping.Stopped(
                self.request.number, f"stopped at {timesteps} steps; go on with the same command and --resume"
            )

    def show(self, bar: Progress) -> None:
        """Show there how far the run is."""
        job = bar.add_task("", total=self._plan.total_timesteps)

        told = self.timesteps

        def tell() -> None:
            nonlocal told
            words = f"{self._plan.env_id}, seed {self._plan.seed}"
            if self._selection.policy is not None:
                words += f": best saves {100.0 * self.best[0]:.1f} %"
            bar.update(job, completed=self.timesteps, description=words)
            total = self._plan.total_timesteps
            if not bar.console.is_terminal and _passed(told, self.timesteps, total, LINES):  # a log file shows no bar
                told = self.timesteps
                bar.console.print(f"{words}, {told:,} of {total:,} steps in {self.seconds:.0f} s")

        self._tell = tell
        tell()

    def checkpoint(self, state: Callable[[], State]) -> None:
        """A checkpoint of now, unless the last one is."""
        if self._saved_at != self.timesteps:
            self._save(state())

    def _save(self, state: State) -> None:
        progress = {
            "timesteps": self.timesteps,
            "total_timesteps": self._plan.total_timesteps,
            "seconds": round(self.seconds, 1),
            "curve": self._selection.curve,
            **self._made_by,
        }
        self._folder.save(progress, {**state, **self._selection.state()})
        self._saved_at = self.timesteps

    def go_on(self, place: Path, before: Mapping[str, Any], console: Console) -> Arrays:
        """Take up what the last checkpoint has of the run itself; gives what it has of the trainer.

        Raises:
            UserError: it is damaged, or the run has come to its end already.
        """
        try:
            progress = self._folder.progress(place)
            if "digest" not in progress:
                raise FileError(f"{place}: of another kind of training")
            arrays = Arrays(self._folder.arrays(place, progress["digest"], LARGEST_STATE))
            self._selection.take_up(arrays, progress["curve"], self.network)
        except (ValueError, OSError) as error:
            raise damaged(error) from None
        self.timesteps = self._saved_at = progress["timesteps"]
        self._before = progress["seconds"]
        if before["finished"]:
            raise UserError(f"--resume: the run has finished: {self.timesteps} steps")
        reasons = changes(progress, self._made_by)
        entry = {"at": self.timesteps, "exact": not reasons}
        if reasons:
            entry["reason"] = shown("; ".join(reasons))
            console.print(f"note: the run goes on, but not to the bit as without the stop: {entry['reason']}")
        self.record["resumed"] = [*before.get("resumed", []), entry]
        return arrays

    def finish(self, console: Console) -> None:
        """Write the best policy, and that the run has finished; say where, and how good it is."""
        best = self._selection.save(self._folder.path)
        spent = {"timesteps": self.timesteps, "seconds": round(self.seconds, 1)}
        self._folder.write_record({**self.record, "finished": True, **spent, "best": best})
        name = f"{self._plan.env_id}, seed {self._plan.seed}"
        words = self._selection.summary(name, self._plan.env_id, self.timesteps, self.seconds, self._folder.path)
        console.print(words, soft_wrap=True)


def _passed(before: int, now: int, total: int, points: int) -> bool:
    """Whether one of so many points of the whole lies between."""
    every = max(1, total // points)
    return now // every > before // every


@contextlib.contextmanager
def run_in(
    path: Path,
    plan: Plan,
    cars: optimum.Cars,
    manner: Mapping[str, Any],
    resume: bool,
    console: Console,
    quiet: bool,
) -> Iterator[tuple[Run, Arrays | None]]:
    """A run in its folder, and the arrays from which it goes on, None from the beginning; signals only make a request.

    Raises:
        UserError: the folder holds another run, a damaged one, or with `resume` none.
    """
    if resume and not begun(path):
        raise UserError(f"--resume: {path} holds no run")
    if not resume:
        refuse_run(path)
    with held(path) as folder:
        before = None
        if resume:
            before = earlier_record(folder, plan.identity)
        else:
            refuse_run(path)  # another training may have begun meanwhile
        run, arrays = Run(folder, plan, cars, manner), None
        place = folder.checkpoint()
        if before is not None and place is not None:
            arrays = run.go_on(place, before, console)
        folder.write_record(run.record)
        with contextlib.ExitStack() as stack:
            if not quiet:
                run.show(stack.enter_context(messages.progress()))
            run.request = stack.enter_context(stopping.deferred())
            yield run, arrays
