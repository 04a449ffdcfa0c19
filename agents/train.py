"""Train a policy with Stable-Baselines3.

    python -m agents.train --env-id BicycleStab-v0 --algo ppo --seed 0 --out runs/stab-ppo

The run's folder then holds: policy.safetensors and policy.json (the policy, as data), run.json (settings, versions,
git revision, seed), curve.csv (learning curve), tensorboard/ and checkpoint/ (for --resume).
"""

from __future__ import annotations

import io
import json
import pickle
import shutil
import signal
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import stable_baselines3 as sb3
import torch
import tyro
from rich.console import Console
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.utils import safe_mean
from stable_baselines3.common.vec_env import VecMonitor

import bicycle_env  # noqa: F401  (registers the environments)
from agents import export, messages, settings
from agents.evaluate import environment, make_vector_env, parse_keywords
from agents.messages import UserError
from bicycle_env import provenance
from bicycle_env.files import write_bytes, write_json
from bicycle_env.physics import announcements
from bicycle_env.wrappers import SB3VecEnv

CHECKPOINTS = 10
CURVE_POINTS = 100
CURVE_HEADER = "timesteps,seconds,success_rate,mean_return,mean_length"
ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
BUFFER_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


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
    try:
        network["activation_fn"] = ACTIVATIONS[network.pop("activation")]
        if "action_noise" in model_keywords:
            axles = env.action_space.shape[0]
            model_keywords["action_noise"] = NormalActionNoise(
                np.zeros(axles), np.full(axles, model_keywords["action_noise"])
            )
        rate = model_keywords["learning_rate"]
        if model_keywords.pop("learning_rate_decay", False):
            model_keywords["learning_rate"] = lambda remaining: (
                rate * max(remaining, 0.0)
            )  # the last rollout overshoots
        algorithm = {"ppo": sb3.PPO, "sac": sb3.SAC, "td3": sb3.TD3}[args.algo]
        return algorithm(
            "MlpPolicy",
            env,
            seed=args.seed,
            device="cpu",
            tensorboard_log=str(tensorboard),
            policy_kwargs=network,
            **model_keywords,
        )
    except (TypeError, KeyError) as error:
        raise UserError(f"the settings for {args.algo} do not fit Stable-Baselines3: {error}") from None


class Record(BaseCallback):
    """Writes the learning curve and checkpoints while training."""

    def __init__(self, folder: Path, total: int, curve: list[str], seconds_before: float) -> None:
        super().__init__()
        self.folder, self.total, self.curve = folder, total, curve
        self.seconds_before, self.start = seconds_before, time.perf_counter()
        self.next_point = self.next_checkpoint = 0

    @property
    def seconds(self) -> float:
        return self.seconds_before + time.perf_counter() - self.start

    def _on_training_start(self) -> None:
        self.next_point = self.num_timesteps + self.total // CURVE_POINTS
        self.next_checkpoint = self.num_timesteps + self.total // CHECKPOINTS

    def _on_step(self) -> bool:
        if self.num_timesteps >= self.next_point and self.model.ep_info_buffer:
            self.next_point = self.num_timesteps + self.total // CURVE_POINTS
            self.curve.append(curve_row(self.model, self.seconds))
        if self.num_timesteps >= self.next_checkpoint:
            self.next_checkpoint = self.num_timesteps + self.total // CHECKPOINTS
            save_checkpoint(self.model, self.folder, self.curve, self.seconds)
        return True


def curve_row(model: BaseAlgorithm, seconds: float) -> str:
    """One line of the learning curve: means over the last 100 training episodes."""
    episodes = model.ep_info_buffer or []
    success = safe_mean(model.ep_success_buffer or [0.0])
    mean_return = safe_mean([episode["r"] for episode in episodes])
    length = safe_mean([episode["l"] for episode in episodes])
    return f"{model.num_timesteps},{seconds:.1f},{success:.4f},{mean_return:.3f},{length:.1f}"


def save_checkpoint(model: BaseAlgorithm, folder: Path, curve: list[str], seconds: float) -> None:
    """All that --resume needs, written aside and then put in place of the last one."""
    state: dict[str, Any] = dict(model.get_parameters())
    if getattr(model, "log_ent_coef", None) is not None:
        state["log_ent_coef"] = model.log_ent_coef.detach()
    content = io.BytesIO()
    torch.save(state, content)
    fresh, place = folder / "checkpoint.new", folder / "checkpoint"
    shutil.rmtree(fresh, ignore_errors=True)
    write_bytes(fresh / "model.pt", content.getvalue())
    if isinstance(model, OffPolicyAlgorithm) and model.replay_buffer is not None:
        buffer = model.replay_buffer
        filled = buffer.buffer_size if buffer.full else buffer.pos
        arrays = io.BytesIO()
        np.savez(arrays, **{name: getattr(buffer, name)[:filled] for name in BUFFER_ARRAYS}, place=buffer.pos)
        write_bytes(fresh / "replay_buffer.npz", arrays.getvalue())
    write_json(
        fresh / "progress.json", {"timesteps": model.num_timesteps, "seconds": round(seconds, 1), "curve": curve}
    )
    old = folder / "checkpoint.old"
    shutil.rmtree(old, ignore_errors=True)
    if place.exists():
        place.rename(old)
    fresh.rename(place)
    shutil.rmtree(old, ignore_errors=True)
    write_bytes(folder / "curve.csv", ("\n".join([CURVE_HEADER, *curve]) + "\n").encode())


def load_checkpoint(model: BaseAlgorithm, folder: Path) -> tuple[list[str], float]:
    """Put a checkpoint's content into a fresh model; gives the curve so far and the seconds spent."""
    place = folder / "checkpoint"
    if not (place / "progress.json").is_file():
        place = folder / "checkpoint.old"  # a kill between two renames leaves the last one here
    if not (place / "progress.json").is_file():
        raise UserError(f"--resume: {folder} has no checkpoint")
    progress = json.loads((place / "progress.json").read_text(encoding="utf-8"))
    # weights_only: tensors and plain containers, nothing that can run code.
    state = torch.load(place / "model.pt", map_location="cpu", weights_only=True)
    if "log_ent_coef" in state:
        with torch.no_grad():
            model.log_ent_coef.copy_(state.pop("log_ent_coef"))
    model.set_parameters(state, exact_match=True, device="cpu")
    if isinstance(model, OffPolicyAlgorithm) and model.replay_buffer is not None:
        with np.load(place / "replay_buffer.npz", allow_pickle=False) as arrays:
            buffer, filled = model.replay_buffer, len(arrays["rewards"])
            for name in BUFFER_ARRAYS:
                getattr(buffer, name)[:filled] = arrays[name]
            buffer.pos, buffer.full = int(arrays["place"]), filled == buffer.buffer_size
    model.num_timesteps = progress["timesteps"]
    return progress["curve"], progress["seconds"]


def train(args: Args, console: Console) -> Path:
    """Train as the arguments say; gives the run's folder."""
    keywords = parse_keywords(args.env_keywords)
    environment(args.env_id)
    chosen = settings.read(args.env_id, args.algo, args.config)
    total = chosen.total_timesteps if args.total_timesteps is None else args.total_timesteps
    if total < 1:
        raise UserError(f"--total-timesteps must be at least 1, got {total}")
    if args.seed < 0:
        raise UserError(f"--seed must be at least 0, got {args.seed}")
    folder = args.out or Path("runs") / f"{args.env_id}-{args.algo}-{args.seed}"
    identity = {"env_id": args.env_id, "env_keywords": keywords, "algo": args.algo, "seed": args.seed}
    if (folder / "run.json").exists():
        if not args.resume:
            raise UserError(f"{folder} holds a run already; choose another --out, or go on with --resume")
        try:
            before = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        except ValueError as error:
            raise UserError(f"--resume: {folder / 'run.json'} is damaged: {error}") from None
        for name, value in identity.items():
            if before.get(name) != value:
                raise UserError(f"--resume: the run in {folder} has {name} = {before.get(name)!r}, not {value!r}")
        chosen = settings.Settings(**before["settings"])
    elif args.resume:
        raise UserError(f"--resume: {folder} holds no run")

    torch.set_num_threads(1)  # small networks: more threads only wait for each other
    model = build(args, chosen, keywords, folder / "tensorboard")
    if args.resume:
        try:
            curve, seconds = load_checkpoint(model, folder)
        except (OSError, ValueError, KeyError, RuntimeError, pickle.UnpicklingError) as error:
            raise UserError(f"--resume: the checkpoint in {folder} is damaged: {str(error).splitlines()[0]}") from None
        if before["finished"] and model.num_timesteps >= total:
            raise UserError(
                f"--resume: the run has {model.num_timesteps} steps already; give a larger --total-timesteps"
            )
    else:
        curve, seconds = [], 0.0
        _reserve(folder)
    description = {
        **identity,
        "total_timesteps": total,
        "settings": asdict(chosen),
        **provenance.collect(),
        "finished": False,
    }
    write_json(folder / "run.json", description)
    record = Record(folder, total, curve, seconds)
    remaining = total - model.num_timesteps
    if remaining > 0:
        _learn(model, remaining, record, args.quiet, reset=not args.resume)
    if model.ep_info_buffer:
        curve.append(curve_row(model, record.seconds))
    save_checkpoint(model, folder, curve, record.seconds)
    export.network(model, args.algo, identity | {"timesteps": model.num_timesteps}).save(folder)
    write_json(
        folder / "run.json",
        {**description, "finished": True, "timesteps": model.num_timesteps, "seconds": round(record.seconds, 1)},
    )
    model.get_env().close()
    _summary(console, args, folder, model, record.seconds)
    return folder


def _reserve(folder: Path) -> None:
    """Make the folder of a new run; of two trainings that start at once, the second is refused."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "run.json").open("x").close()
    except FileExistsError:
        raise UserError(f"{folder} holds a run already, or is a file; choose another --out") from None


def _learn(model: BaseAlgorithm, steps: int, record: Record, quiet: bool, reset: bool) -> None:
    """Learn; Ctrl-C and a termination signal leave a checkpoint behind."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        model.learn(steps, callback=record, progress_bar=not quiet, reset_num_timesteps=reset)
    except KeyboardInterrupt:
        save_checkpoint(model, record.folder, record.curve, record.seconds)
        raise UserError(f"stopped at {model.num_timesteps} steps; go on with the same command and --resume") from None
    finally:
        signal.signal(signal.SIGTERM, before)


def _summary(console: Console, args: Args, folder: Path, model: BaseAlgorithm, seconds: float) -> None:
    success = safe_mean(model.ep_success_buffer or [float("nan")])
    console.print(
        f"\n{args.algo.upper()} on {args.env_id}, seed {args.seed}: {model.num_timesteps:,} steps in {seconds:.0f} s "
        f"({model.num_timesteps / max(seconds, 1e-9):,.0f} steps/s)\n"
        f"success in the last {len(model.ep_success_buffer or [])} training episodes, exploration on: "
        f"{100 * success:.0f} %\n"
        f"policy and record of the run: {folder}\n"
        f"evaluate it: python -m agents.evaluate --env-id {args.env_id} --policy {folder} lqr zero"
        + (f" --env-keywords '{args.env_keywords}'" if args.env_keywords != "{}" else ""),
        highlight=False,
        soft_wrap=True,
    )


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.train", description=__doc__)
    with announcements.silenced(args.quiet):
        train(args, messages.console())


if __name__ == "__main__":
    messages.run(main)
