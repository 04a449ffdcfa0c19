"""Train a policy with Stable-Baselines3.

    python -m agents.train --env-id BicycleStab-v0 --algo ppo --seed 0 --out runs/stab-ppo

The run's folder then holds: policy.safetensors and policy.json (the policy, as data), run.json (settings, versions,
git revision, seed, resumes), curve.csv (learning curve), tensorboard/, checkpoint/ (for --resume) and a lock. A run
that was stopped and goes on gives the policy of one that was not, to the bit, on one machine with one set of versions;
where that cannot be, a remark and run.json say why.
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
from stable_baselines3.common.utils import safe_mean
from stable_baselines3.common.vec_env import VecMonitor

import bicycle_env  # noqa: F401  (registers the environments)
from agents import export, messages, old_checkpoint, sb3_state, settings, stopping
from agents.evaluate import environment, make_vector_env, parse_keywords
from agents.messages import UserError
from agents.run_folder import CURVE_HEADER, Folder, begun, changes, earlier_record, held, refuse_run
from bicycle_env import provenance
from bicycle_env.backends import announcements
from bicycle_env.files import FileError, shown
from bicycle_env.wrappers import SB3VecEnv

__all__ = ["CURVE_HEADER", "Args", "build", "train"]

CHECKPOINTS = 10
CURVE_POINTS = 100
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
    """Environment steps; by default as the settings file says. A decaying learning rate reaches 0 there."""
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
    """Writes the learning curve and checkpoints while training.

    When points and checkpoints are due follows from the steps alone, so a resumed run has those of a straight one.
    """

    def __init__(self, folder: Folder, total: int, made_by: dict[str, Any]) -> None:
        super().__init__()
        self.folder, self.total, self.made_by = folder, total, made_by
        self.curve: list[str] = []
        self.seconds_before, self.start = 0.0, time.perf_counter()
        self.request = stopping.Request()
        self.saved_at = 0

    @property
    def seconds(self) -> float:
        return self.seconds_before + time.perf_counter() - self.start

    def _on_step(self) -> bool:
        if self._due(CURVE_POINTS, self._last_point) and self.model.ep_info_buffer:
            self.add_point(self.model)
        return True

    @property
    def _last_point(self) -> int:
        return int(self.curve[-1].partition(",")[0]) if self.curve else 0

    def _due(self, points: int, last: int) -> bool:
        every = max(1, self.total // points)
        return self.model.num_timesteps // every > last // every

    def add_point(self, model: BaseAlgorithm) -> None:
        """A row of the learning curve, unless this step has one."""
        if model.ep_info_buffer and model.num_timesteps > self._last_point:
            self.curve.append(curve_row(model, self.seconds))

    def at_rollout(self) -> bool:
        """Between two rollouts, the only place where a run can be taken up again; False ends the training here."""
        if self.request.number is not None or self._due(CHECKPOINTS, self.saved_at):
            self.save(self.model)
        return self.request.number is None

    def save(self, model: BaseAlgorithm) -> None:
        """Write a checkpoint; UserError if the training has diverged, which leaves the last one in place."""
        refuse_diverged(model)
        progress = {
            "timesteps": model.num_timesteps,
            "total_timesteps": self.total,
            "seconds": round(self.seconds, 1),
            "curve": self.curve,
            **self.made_by,
        }
        self.folder.save(progress, sb3_state.collect(model))
        self.saved_at = model.num_timesteps


def refuse_diverged(model: BaseAlgorithm) -> None:
    if not sb3_state.finite(model):
        raise UserError(
            f"training has diverged: after {model.num_timesteps} steps weights are not finite; a smaller learning_rate "
            "may help"
        )


def curve_row(model: BaseAlgorithm, seconds: float) -> str:
    """One line of the learning curve: means over the last 100 training episodes."""
    episodes = model.ep_info_buffer or []
    success = safe_mean(model.ep_success_buffer or [0.0])
    mean_return = safe_mean([episode["r"] for episode in episodes])
    length = safe_mean([episode["l"] for episode in episodes])
    return f"{model.num_timesteps},{seconds:.1f},{success:.4f},{mean_return:.3f},{length:.1f}"


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
            state = old_checkpoint.read(place, model, progress["timesteps"])
        else:
            state = folder.arrays(place, progress["digest"], sb3_state.most_bytes(model))
        with_env = sb3_state.put(model, state)
        if model.num_timesteps != progress["timesteps"]:
            raise FileError(f"{place}: has {progress['timesteps']} steps, its arrays {model.num_timesteps}")
        refuse_diverged(model)
    except (ValueError, OSError) as error:
        raise UserError(f"--resume: the checkpoint is damaged: {shown(error)}") from None
    record.curve, record.seconds_before = list(progress["curve"]), progress["seconds"]
    record.saved_at = model.num_timesteps
    if old:
        return "the checkpoint is of an earlier revision and lacks the generators and the cars' state"
    reasons = [] if with_env else [sb3_state.NO_SNAPSHOT]
    reasons += changes(progress, record.made_by)
    if progress["total_timesteps"] != record.total and decays(model):
        reasons.append(f"the decaying learning rate was to end at {progress['total_timesteps']} steps")
    return shown("; ".join(reasons))


def decays(model: BaseAlgorithm) -> bool:
    """Whether the learning rate depends on the number of steps that are to come."""
    return bool(model.lr_schedule(0.25) != model.lr_schedule(0.75))


def train(args: Args, console: Console) -> Path:
    """Train as the arguments say; gives the run's folder."""
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
        record = Record(folder, total, {name: made_by[name] for name in ("versions", "machine", "git")})
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
        record.add_point(model)
        record.save(model)
        export.network(model, args.algo, identity | {"timesteps": model.num_timesteps}).save(path)
        spent = {"timesteps": model.num_timesteps, "seconds": round(record.seconds, 1)}
        folder.write_record({**description, "finished": True, **spent})
        model.get_env().close()
    _summary(console, args, path, model, record.seconds)
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
            refuse_diverged(model)  # SB3 and the environment refuse what is not finite, each in its own words
            raise
        if record.request.number is not None:
            if record.saved_at < model.num_timesteps:  # it came in the last rollout
                record.save(model)
            raise stopping.Stopped(
                record.request.number,
                f"stopped at {model.num_timesteps} steps; go on with the same command and --resume",
            )


def _summary(console: Console, args: Args, folder: Path, model: BaseAlgorithm, seconds: float) -> None:
    success = safe_mean(model.ep_success_buffer or [float("nan")])
    console.print(
        f"\n{args.algo.upper()} on {args.env_id}, seed {args.seed}: {model.num_timesteps:,} steps in {seconds:.0f} s "
        f"({model.num_timesteps / max(seconds, 1e-9):,.0f} steps/s)\n"
        f"success in the last {len(model.ep_success_buffer or [])} training episodes, exploration on: "
        f"{100 * success:.0f} %\n"
        f"policy and record of the run: {folder}\n"
        f"evaluate it, with the keywords of its training: python -m agents.evaluate --env-id {args.env_id} "
        f"--policy {folder} lqr zero",
        highlight=False,
        soft_wrap=True,
    )


def main() -> None:
    # A run's folder survives this at any moment. An exception may be swallowed by what is being imported or compiled.
    stopping.handle(stopping.leave_at_once)
    args = tyro.cli(Args, prog="python -m agents.train", description=__doc__)
    with announcements.silenced(args.quiet):
        train(args, messages.console())


if __name__ == "__main__":
    messages.run(main)
