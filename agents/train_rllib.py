"""Train with Ray RLlib's PPO on several processes or machines, and write the same folder as the other trainers.

    make rllib                                                     # installs it apart, and trains for a minute
    .venv-rllib/bin/python -m agents.train_rllib --env-id BicycleStab-v0 --runners 2 --out runs/stab-rllib

RLlib 2.60 needs gymnasium 1.2.2, so it has an environment of its own. Every runner is a process that drives some cars
in one native vector environment; the learner is another. On one machine agents.ppo makes several times the steps: this
is for clusters (`ray.init` finds the one that RAY_ADDRESS names), and for whoever has RLlib's tools already.

The best policy by success on 500 starts of their own is kept, as policy.safetensors and policy.json; run.json,
curve.csv and RLlib's own checkpoint, from which --resume goes on, stand beside it.
"""

from __future__ import annotations

import importlib
import logging
import math
import os
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console

import bicycle_env  # noqa: F401  (registers the environments)
from agents import messages, settings, stopping, training
from agents.evaluate import make_env, parse_keywords
from agents.messages import UserError
from agents.run_folder import begun, earlier_record, held, refuse_run
from bicycle_env import control, optimum, provenance
from bicycle_env.backends import announcements

ALGORITHM = settings.RLLIB
CHECKPOINT = "rllib"
"""Folder of RLlib's own, below the run's."""
LARGEST_DIFFERENCE = 1e-4


@dataclass
class Args:
    """Train a policy with RLlib's PPO."""

    env_id: str = "BicycleStab-v0"
    """Environment id; of a module of your own, module:ID."""
    env_keywords: str = "{}"
    """Keywords of the environment as JSON, for example '{"level": "hard"}'."""
    seed: int = 0
    """Seed of networks, exploration and starts; several runners make a run that no seed repeats to the bit."""
    out: Path | None = None
    """Folder of the run; by default runs/ENV_ID-rllib-ppo-SEED."""
    resume: bool = False
    """Go on from RLlib's checkpoint in the folder."""
    quiet: bool = False
    """No progress, and no word about what compiles."""

    total_timesteps: int = 500_000
    """Control steps of all cars together."""
    enough_return: float | None = None
    """End as soon as a policy has this mean return on the starts that select; exit code 1 if none has."""
    runners: int = 2
    """Processes that drive cars; 0: the learner's own."""
    cars: int = 64
    """Of each runner."""
    decisions: int = 64
    """Of each car between two updates."""
    epochs: int = 5
    """Passes over what was driven, in each update."""
    minibatch: int = 1024
    """Decisions in a gradient step."""
    learning_rate: float = 1e-3
    """Of Adam."""
    gamma: float = 0.98
    """What the reward one decision later is worth."""
    width: int = 64
    """Of the two hidden layers."""


def configuration(args: Args, keywords: dict[str, Any]) -> Any:
    """RLlib's PPO, new API stack, on the native vector environment in NextStep mode, which RLlib assumes."""
    ppo: Any = importlib.import_module("ray.rllib.algorithms.ppo")
    module: Any = importlib.import_module("ray.rllib.core.rl_module.default_model_config")
    env_id = args.env_id if ":" in args.env_id else f"bicycle_env:{args.env_id}"
    steps = max(1, args.runners) * args.cars * args.decisions
    return (
        ppo.PPOConfig()
        .environment(env_id, env_config=keywords)
        .env_runners(
            num_env_runners=args.runners,
            num_envs_per_env_runner=args.cars,
            gym_env_vectorize_mode=gym.VectorizeMode.VECTOR_ENTRY_POINT,
            rollout_fragment_length=args.decisions,
        )
        .learners(num_learners=0)
        .training(
            train_batch_size_per_learner=steps,
            minibatch_size=min(args.minibatch, steps),
            num_epochs=args.epochs,
            lr=args.learning_rate,
            gamma=args.gamma,
            lambda_=0.95,
            clip_param=0.2,
            vf_clip_param=1e6,
            grad_clip=0.5,
            use_kl_loss=False,
        )
        .rl_module(
            model_config=module.DefaultModelConfig(
                fcnet_hiddens=[args.width, args.width], fcnet_activation="tanh", vf_share_layers=False
            )
        )
        .debugging(seed=args.seed, log_level="ERROR")
    )


def network(module: Any, names: list[str], description: dict[str, Any]) -> control.Network:
    """The deterministic policy of an RLlib module; RuntimeError if it does not act like the module."""
    torch: Any = importlib.import_module("torch")
    linear = [
        layer
        for part in (module.encoder.actor_encoder, module.pi)
        for layer in part.modules()
        if isinstance(layer, torch.nn.Linear)
    ]
    layers = [(layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in linear]
    weight, bias = layers[-1]
    axles = len(bias) // 2  # the other half are the deviations
    layers[-1] = (weight[:axles], bias[:axles])
    found = control.Network(layers, "tanh", "clip", {**description, "observation_names": names})
    seen = np.random.default_rng(0).uniform(-1.0, 1.0, (64, len(names))).astype(np.float32)
    with torch.no_grad():
        wanted = module.forward_inference({"obs": torch.from_numpy(seen)})["action_dist_inputs"][:, :axles].numpy()
    if not np.max(np.abs(np.clip(wanted, -1.0, 1.0) - found.act(seen))) <= LARGEST_DIFFERENCE:
        raise RuntimeError("the exported policy differs from RLlib's")
    return found


def train(args: Args, console: Console) -> int:
    """Train as the arguments say; gives the exit code."""
    os.environ.setdefault("RAY_BACKEND_LOG_LEVEL", "fatal")  # what it calls errors there is none
    try:
        ray: Any = importlib.import_module("ray")
    except ModuleNotFoundError:
        raise UserError("agents.train_rllib needs ray, which has an environment of its own: make rllib") from None
    keywords = parse_keywords(args.env_keywords)
    settings.check_seed(args.seed)
    messages.check_least(args, total_timesteps=1, runners=0, cars=1, decisions=1, epochs=1, minibatch=1, width=1)
    for name in ("learning_rate", "gamma"):
        try:
            settings.SHARE(f"--{name.replace('_', '-')}", getattr(args, name))
        except ValueError as error:
            raise UserError(str(error)) from None
    path = args.out or Path("runs") / f"{args.env_id}-{ALGORITHM}-{args.seed}"
    messages.check_folder("--out", path)
    plant: Any = make_env(args.env_id, keywords).unwrapped  # mistakes in the keywords are found here
    names = list(plant.observation_names)
    if args.resume and not begun(path):
        raise UserError(f"--resume: {path} holds no run")
    if not args.resume:
        refuse_run(path)
    selection = training.Selection(optimum.Cars(args.env_id, keywords))
    own = ("runners", "cars", "decisions", "epochs", "minibatch", "learning_rate", "gamma", "width")
    identity = {
        "env_id": args.env_id,
        "env_keywords": keywords,
        "algo": ALGORITHM,
        "seed": args.seed,
        "settings": {name: getattr(args, name) for name in own},
    }
    with held(path) as folder:
        before = earlier_record(folder, identity) if args.resume else None
        record = {**identity, **provenance.collect(), "finished": False, "resumed": []}
        if before is not None:
            record["resumed"] = [*before.get("resumed", []), {"exact": False, "reason": "RLlib's checkpoint"}]
        folder.write_record(record)
        for name in ("ray", "ray.rllib"):
            logging.getLogger(name).setLevel(logging.ERROR)
        ray.init(include_dashboard=False, log_to_driver=False, configure_logging=False, ignore_reinit_error=True)
        algorithm = configuration(args, keywords).build_algo()
        place, steps, spent = path / CHECKPOINT, 0, 0.0
        if before is not None and place.is_dir():
            algorithm.restore_from_path(str(place.resolve()))
            steps, spent = int(before.get("timesteps", 0)), float(before.get("seconds", 0.0))
            selection.curve = (path / "curve.csv").read_text(encoding="utf-8").splitlines()[1:]
            if (path / control.network.DESCRIPTION_FILE).is_file():
                selection.policy, kept = control.network.read(path), before["best"]
                selection.best = (kept["success_rate"], kept["episode_return"], kept["timesteps"])
        begin, enough = time.perf_counter(), math.inf if args.enough_return is None else args.enough_return
        try:
            with messages.progress() as bar:
                job = bar.add_task(args.env_id, total=args.total_timesteps, visible=not args.quiet)
                while steps < args.total_timesteps and selection.best[1] < enough:
                    result = algorithm.train()
                    steps = int(result["num_env_steps_sampled_lifetime"])
                    module = algorithm.get_module()
                    policy = network(module, names, {**identity_of_policy(identity), "timesteps": steps})
                    selection.assess(policy, steps, spent + time.perf_counter() - begin)
                    words = f"{args.env_id}: best saves {100.0 * selection.best[0]:.1f} %"
                    bar.update(job, completed=steps, description=words)
        finally:
            algorithm.save_to_path(str(place.resolve()))
            algorithm.stop()
            ray.shutdown()
            best = {} if selection.policy is None else {"best": selection.save(path)}
            over = steps >= args.total_timesteps or selection.best[1] >= enough
            seconds = round(spent + time.perf_counter() - begin, 1)
            folder.write_record({**record, "finished": over, "timesteps": steps, "seconds": seconds, **best})
            folder.write_curve(selection.curve)
    console.print(
        selection.summary(f"{args.env_id}, seed {args.seed}", args.env_id, steps, seconds, path), soft_wrap=True
    )
    return int(selection.best[1] < enough < math.inf)


def identity_of_policy(identity: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in identity.items() if name != "settings"}


def main() -> int:
    stopping.handle(stopping.raise_stopped)
    args = tyro.cli(Args, prog="python -m agents.train_rllib", description=__doc__)
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    with announcements.silenced(args.quiet):
        return train(args, messages.console())


if __name__ == "__main__":
    messages.run(main)
