"""Trainings of many seeds as jobs of a cluster, or as processes of this machine, through submitit.

    python -m agents.jobs --seeds 10 --out runs/stab agents.ppo --env-id BicycleStab-v0
    python -m agents.jobs --seeds 10 --out runs/stab --cluster slurm --partition cpu agents.ppo --env-id BicycleStab-v0

What stands behind the options is a trainer of this package and its own options, but for --seed, --out and --resume:
each job trains one seed into a folder of its own, OUT/SEED, and goes on there from its last checkpoint where it was
stopped, so that a job that the cluster puts back, and the same command given again, lose nothing. Seeds that have
finished are left alone. Each job has one core: the trainers use no more.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from agents import messages
from agents.messages import UserError
from agents.run_folder import begun
from bicycle_env.files import FileError, anything, mapping, read_json, shown
from bicycle_env.installation import needs

TRAINERS = ("agents.ppo", "agents.policy_search", "agents.ppo_jax", "agents.train")
OWN = ("--seed", "--seeds", "--out", "--resume")
"""What a job says itself."""


@dataclass
class Args:
    """Train seeds as jobs; ends when all have, with exit code 1 if one has failed."""

    seeds: int = 10
    """How many."""
    first_seed: int = 0
    """The first of them."""
    out: Path = Path("runs/jobs")
    """Folder of the seeds' folders."""
    cluster: Literal["local", "slurm"] = "local"
    """Processes of this machine, or SLURM's jobs."""
    at_once: int = 2
    """Jobs at a time."""
    partition: str = ""
    """Of SLURM."""
    minutes: int = 60
    """After which SLURM ends a job; it is put back and goes on from its last checkpoint."""


class Training:
    """One seed's training, as submitit's jobs call it and put it back."""

    def __init__(self, trainer: str, options: Sequence[str], seed: int, folder: Path) -> None:
        self.words = [sys.executable, "-m", trainer, *options, "--seed", str(seed), "--out", str(folder), "--quiet"]
        self.folder = folder

    def __call__(self) -> int:
        """The exit code."""
        resume = ["--resume"] if begun(self.folder) else []
        return subprocess.run([*self.words, *resume], check=False).returncode

    def checkpoint(self) -> Any:
        """For a job whose time is over: the trainer has written a checkpoint when it was told to stop."""
        return importlib.import_module("submitit").helpers.DelayedSubmission(self)


def finished(folder: Path) -> bool:
    """Whether a training in a folder has come to its end; UserError for a record that cannot be read."""
    if not (folder / "run.json").is_file():
        return False
    try:
        return bool(read_json(folder / "run.json", mapping(anything)).get("finished"))
    except (FileError, OSError) as error:
        raise UserError(f"--out: {shown(error)}") from None


def submit(args: Args, trainings: Sequence[Training]) -> list[Any]:
    """The jobs, submitit's own objects."""
    try:
        submitit: Any = importlib.import_module("submitit")
    except ModuleNotFoundError:
        raise UserError(needs("agents.jobs", "submitit", "jobs")) from None
    executor = submitit.AutoExecutor(folder=args.out / "log", cluster=args.cluster)
    executor.update_parameters(name="bicycle-env", timeout_min=args.minutes, cpus_per_task=1, nodes=1, tasks_per_node=1)
    if args.cluster == "slurm":
        executor.update_parameters(slurm_array_parallelism=args.at_once)
        if args.partition:
            executor.update_parameters(slurm_partition=args.partition)
        with executor.batch():
            return [executor.submit(training) for training in trainings]
    jobs: list[Any] = []
    for training in trainings:
        while sum(not job.done() for job in jobs) >= args.at_once:
            time.sleep(0.2)
        jobs.append(executor.submit(training))
    return jobs


def split(words: Sequence[str]) -> tuple[list[str], str, list[str]]:
    """This command's words, the trainer, and its options; UserError where there is none, or one that a job says."""
    place = next((k for k, word in enumerate(words) if word in TRAINERS), None)
    if place is None:
        raise UserError(f"a trainer must follow the options, one of {', '.join(TRAINERS)}")
    options = list(words[place + 1 :])
    for word in options:
        if word.partition("=")[0] in OWN:
            raise UserError(f"{shown(word)} is not for the trainer: a job says it itself")
    return list(words[:place]), words[place], options


def main() -> int:
    words, asks = sys.argv[1:], {"-h", "--help"}
    own, trainer, options = (words, "", []) if not words or asks & set(words[:1]) else split(words)
    args = tyro.cli(Args, args=own or ["--help"] * (not trainer), prog="python -m agents.jobs", description=__doc__)
    messages.check_least(args, seeds=1, first_seed=0, at_once=1, minutes=1)
    messages.check_output("--out", args.out, folder=True)
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    left = [seed for seed in seeds if not finished(args.out / str(seed))]
    args.out.mkdir(parents=True, exist_ok=True)
    console = messages.console()
    trainings = [Training(trainer, options, seed, args.out / str(seed)) for seed in left]
    jobs = submit(args, trainings) if left else []
    failed = [seed for seed, job in zip(left, jobs, strict=True) if job.result() != 0]
    for seed in failed:
        console.print(f"seed {seed} has failed: {args.out / 'log'} holds what it said")
    console.print(
        f"{args.seeds - len(failed)} of {args.seeds} seeds have finished in {args.out}; the best of them, for a level: "
        f"python -m agents.publishing {args.out}/* --level LEVEL",
        soft_wrap=True,
    )
    return int(bool(failed))


if __name__ == "__main__":
    messages.run(main)
