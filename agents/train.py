"""Train a policy with Stable-Baselines3.

    python -m agents.train --env-id BicycleStab-v0 --algo ppo --seed 0 --out runs/stab-ppo

The run's folder then holds: policy.safetensors and policy.json (as data, the best policy of the run by success on 500
starts of their own), run.json (settings, versions, git revision, seed, resumes, how good the best is), curve.csv (the
deterministic policy on these starts, twenty times over the run and at its end), tensorboard/ (SB3's own figures, of the
training episodes), checkpoint/ (for --resume) and a lock. A run that was stopped and goes on gives the policy of one
that was not, to the bit, on one machine with one set of versions; where that cannot be, a remark and run.json say why.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import tyro
from rich.console import Console
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CallbackList, ProgressBarCallback
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.vec_env import VecMonitor

import bicycle_env  # noqa: F401  (registers the environments)
from agents import export, messages, old_checkpoint, sb3_state, settings, stopping, trained, training
from agents.evaluate import environment, make_vector_env, parse_keywords
from agents.messages import UserError
from agents.run_folder import CURVE_HEADER, Folder, begun, changes, earlier_record, held, refuse_run
from agents.state_arrays import Arrays
from bicycle_env import control, optimum, provenance
from bicycle_env.backends import announcements
from bicycle_env.files import FileError, shown
from bicycle_env.wrappers import SB3VecEnv

__all__ = ["CURVE_HEADER", "Args", "build", "train"]

ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}


@dataclass
class Args:
    """Train a policy; settings come from agents/configs unless given here."""

    env_id: str = "BicycleStab-v0"
    """Environment id."""
    algo: Literal["ppo", "sac", "td3"] = "ppo"
    """Algorithm of Stable-Baselines3."""
    seed: int = 0
    """Seed of networks, exploration and starts."""
    total_timesteps: int | None = None
    """Environment steps, rounded up to whole rollouts; by default as the settings file says. A decaying learning rate
    reaches 0 there."""
    out: Path | None = None
    """Folder of the run; by default runs/ENV_ID-ALGO-SEED."""
    resume: bool = False
    """Go on from the last checkpoint in the folder."""
    env_keywords: str = "{}"
    """Keywords of the environment as JSON, for example '{"speed_ratio": 1.3, "steer": "rear"}'."""
    config: Path | None = None
    """Settings file (TOML) in place of the shipped one."""
    quiet: bool = False
    """No progress bar, and no word about what compiles."""


def build(args: Args, chosen: settings.Settings, keywords: dict[str, Any], tensorboard: Path) -> BaseAlgorithm:
    """The SB3 model on its environments."""
    env = VecMonitor(SB3VecEnv(make_vector_env(args.env_id, chosen.n_envs, keywords)))
    network = dict(chosen.network)
    model_keywords = dict(chosen.model)
    network["activation_fn"] = ACTIVATIONS[network.pop("activation")]
    if "action_noise" in model_keywords:
        axles = env.action_space.shape[0]
        model_keywords["action_noise"] = NormalActionNoise(
            np.zeros(axles), np.full(axles, model_keywords["action_noise"])
        )
    rate = model_keywords["learning_rate"]
    if model_keywords.pop("learning_rate_decay", False):
        model_keywords["learning_rate"] = lambda remaining: rate * max(remaining, 0.0)  # the last rollout overshoots
    try:
        return sb3_state.algorithm(args.algo)(
            "MlpPolicy",
            env,
            seed=args.seed,
            device="cpu",
            tensorboard_log=str(tensorboard),
            policy_kwargs=network,
            **model_keywords,
        )
    except (TypeError, ValueError, AssertionError, RuntimeError, MemoryError) as error:
        raise UserError(f"the settings for {args.algo} do not fit Stable-Baselines3: {shown(error)}") from None


class Record(BaseCallback):
    """Assesses, keeps the best policy and writes checkpoints while training.

    When that is due follows from the steps alone, so a resumed run has the points and checkpoints of a straight one.

    Args:
        folder: of the run.
        total: steps at which it ends.
        made_by: versions, machine and revision.
        identity: what the policy's file says of its origin.
        selection: chooses the best policy.
        watch: sees each point of the learning curve.
    """

    def __init__(
        self,
        folder: Folder,
        total: int,
        made_by: dict[str, Any],
        identity: dict[str, Any],
        selection: training.Selection,
        watch: training.Watch | None,
    ) -> None:
        super().__init__()
        self.folder, self.total, self.made_by = folder, total, made_by
        self.identity, self.selection, self.watch = identity, selection, watch
        self.seconds_before, self.start = 0.0, time.perf_counter()
        self.request = stopping.Request()
        self.saved_at = 0

    @property
    def seconds(self) -> float:
        return self.seconds_before + time.perf_counter() - self.start

    def _on_step(self) -> bool:
        return True  # what SB3 wants to hear; all is done between two rollouts

    def _due(self, points: int, last: int) -> bool:
        every = max(1, self.total // points)
        return self.model.num_timesteps // every > last // every

    def at_rollout(self) -> bool:
        """Between two rollouts, the only place where a run can be taken up again; False ends the training here."""
        if self._due(training.ASSESSMENTS, self.selection.last):
            self.assess(self.model)
        if self.request.number is not None or self._due(training.CHECKPOINTS, self.saved_at):
            self.save(self.model)
        return self.request.number is None

    def assess(self, model: BaseAlgorithm) -> None:
        """A point of the learning curve, unless this step has one; UserError if the training has diverged."""
        if self.selection.last == model.num_timesteps:
            return
        self.refuse_diverged(model)
        description = self.identity | {"timesteps": model.num_timesteps}
        policy = export.network(model, self.identity["algo"], description)
        self.selection.assess(policy, model.num_timesteps, self.seconds, self.watch)

    def save(self, model: BaseAlgorithm) -> None:
        """Write a checkpoint; UserError if the training has diverged, which leaves the last one in place."""
        self.refuse_diverged(model)
        progress = {
            "timesteps": model.num_timesteps,
            "total_timesteps": self.total,
            "seconds": round(self.seconds, 1),
            "curve": self.selection.curve,
            **self.made_by,
        }
        self.folder.save(progress, {**sb3_state.collect(model), **self.selection.state()})
        self.saved_at = model.num_timesteps

    def refuse_diverged(self, model: BaseAlgorithm) -> None:
        """UserError if weights are not finite."""
        if not sb3_state.finite(model):
            raise training.diverged(self.folder.path, model.num_timesteps, self.saved_at)

    def take_up_selection(self, arrays: Arrays, curve: list[str], model: BaseAlgorithm) -> bool:
        """Put back the best policy so far; False where a checkpoint of an earlier revision has none.

        The curve of such a one was of the training episodes, and is left out: a file has one meaning.
        """
        if "best" not in arrays:
            return False

        def network(layers: training.Layers, timesteps: int) -> control.Network:
            return export.of_layers(model, self.identity["algo"], layers, self.identity | {"timesteps": timesteps})

        self.selection.take_up(arrays, curve, network)
        return True


def load_checkpoint(folder: Folder, model: BaseAlgorithm, record: Record) -> str:
    """Put the last checkpoint into a fresh model; says why the run cannot go on to the bit, "" if it does.

    Raises:
        UserError: it is damaged.
    """
    place = folder.checkpoint()
    try:
        if place is None:
            raise FileError(f"{folder.path} has no checkpoint")
        progress = folder.progress(place)
        old = "digest" not in progress
        if old:
            arrays = Arrays(old_checkpoint.read(place, model, progress["timesteps"]))
        else:
            arrays = Arrays(folder.arrays(place, progress["digest"], sb3_state.most_bytes(model)))
        selected = record.take_up_selection(arrays, progress["curve"], model)
        with_env = sb3_state.put(model, arrays)
        if model.num_timesteps != progress["timesteps"]:
            raise FileError(f"{place}: has {progress['timesteps']} steps, its arrays {model.num_timesteps}")
        if not sb3_state.finite(model):
            raise FileError(f"{place}: has weights that are not finite")
    except (ValueError, OSError) as error:
        raise training.damaged(error) from None
    record.seconds_before, record.saved_at = progress["seconds"], model.num_timesteps
    if old:
        return "the checkpoint is of an earlier revision and lacks the generators and the cars' state"
    reasons = [] if with_env else [sb3_state.NO_SNAPSHOT]
    if not selected:
        reasons.append("the checkpoint is of an earlier revision, and the best policy is chosen from here on")
    reasons += changes(progress, record.made_by)
    if progress["total_timesteps"] != record.total:
        what = "the decaying learning rate was" if decays(model) else "the policies to choose from were those of a run"
        reasons.append(f"{what} to end at {progress['total_timesteps']} steps")
    return shown("; ".join(reasons))


def decays(model: BaseAlgorithm) -> bool:
    """Whether the learning rate depends on the number of steps that are to come."""
    return bool(model.lr_schedule(0.25) != model.lr_schedule(0.75))


def train(args: Args, console: Console, watch: training.Watch | None = None) -> Path:
    """Train as the arguments say; gives the run's folder. `watch` sees each point of the learning curve."""
    keywords = parse_keywords(args.env_keywords)
    environment(args.env_id)
    chosen = settings.read(args.env_id, args.algo, args.config)
    messages.check_least(args, total_timesteps=1)
    settings.check_seed(args.seed)
    path = args.out or Path("runs") / f"{args.env_id}-{args.algo}-{args.seed}"
    messages.check_folder("--out", path)
    if args.resume and not begun(path):
        raise UserError(f"--resume: {path} holds no run")
    identity = {"env_id": args.env_id, "env_keywords": keywords, "algo": args.algo, "seed": args.seed}
    torch.set_num_threads(1)  # small networks: more threads only wait for each other
    model = None
    if not args.resume:
        refuse_run(path)
        model = build(args, chosen, keywords, path / "tensorboard")  # mistakes are found before a folder is made
    with held(path) as folder:
        before = None
        if args.resume:
            before = earlier_record(
                folder, identity, lambda found: settings.checked("settings", found["settings"], found["algo"])
            )
            chosen = chosen if before is None else settings.Settings(**before["settings"])
            model = build(args, chosen, keywords, path / "tensorboard")
        else:
            refuse_run(path)  # another training may have begun meanwhile
        total = args.total_timesteps or chosen.total_timesteps
        made_by = provenance.collect()
        of_one_car = {name: value for name, value in keywords.items() if name not in trained.OF_TRAINING}
        selection = training.Selection(optimum.Cars(args.env_id, of_one_car))
        origin = {name: made_by[name] for name in ("versions", "machine", "git")}
        record = Record(folder, total, origin, identity, selection, watch)
        description = {
            **identity,
            "total_timesteps": total,
            "settings": asdict(chosen),
            **made_by,
            "finished": False,
            "resumed": [],
        }
        goes_on = before is not None and folder.checkpoint() is not None
        if goes_on:
            reason = load_checkpoint(folder, model, record)
            if before["finished"] and model.num_timesteps >= total:
                raise UserError(
                    f"--resume: the run has {model.num_timesteps} steps already; give a larger --total-timesteps"
                )
            if total < min(model.num_timesteps, before.get("total_timesteps", total)):  # a last rollout may go beyond
                raise UserError(
                    f"--total-timesteps must be at least {model.num_timesteps}, the steps of the run so far, "
                    f"got {total}"
                )
            entry = {"at": model.num_timesteps, "exact": not reason, **({"reason": reason} if reason else {})}
            description["resumed"] = [*before.get("resumed", []), entry]
            if reason:
                console.print(
                    f"note: the run goes on, but not to the bit as without the stop: {reason}",
                    markup=False,
                    highlight=False,
                    soft_wrap=True,
                )
        folder.write_record(description)
        _learn(model, record, args.quiet, fresh=not goes_on)
        record.assess(model)
        record.save(model)
        best = selection.save(path)
        spent = {"timesteps": model.num_timesteps, "seconds": round(record.seconds, 1)}
        folder.write_record({**description, "finished": True, **spent, "best": best})
        model.get_env().close()
    name = f"{args.algo.upper()} on {args.env_id}, seed {args.seed}"
    words = selection.summary(name, args.env_id, model.num_timesteps, record.seconds, path)
    console.print(words, highlight=False, soft_wrap=True)
    return path


def _learn(model: BaseAlgorithm, record: Record, quiet: bool, fresh: bool) -> None:
    """Learn what is left; Ctrl-C and a termination signal leave a checkpoint of the next place between two rollouts."""
    remaining = record.total - model.num_timesteps
    if remaining <= 0:
        return
    callbacks: list[BaseCallback] = [record] if quiet else [record, ProgressBarCallback()]
    begin: Callable[[], bool] = record.at_rollout
    with stopping.deferred() as record.request:
        model.at_rollout = begin  # type: ignore[attr-defined]
        try:
            model.learn(remaining, callback=CallbackList(callbacks), reset_num_timesteps=fresh)
        except ValueError:
            record.refuse_diverged(model)  # SB3 and the environment refuse what is not finite, each in its own words
            raise
        if record.request.number is not None:
            if record.saved_at < model.num_timesteps:  # it came in the last rollout
                record.save(model)
            raise stopping.Stopped(
                record.request.number,
                f"stopped at {model.num_timesteps} steps; go on with the same command and --resume",
            )


def main() -> None:
    # A run's folder survives this at any moment. An exception may be swallowed by what is being imported or compiled.
    stopping.handle(stopping.leave_at_once)
    args = tyro.cli(Args, prog="python -m agents.train", description=__doc__)
    with announcements.silenced(args.quiet):
        train(args, messages.console())


if __name__ == "__main__":
    messages.run(main)
