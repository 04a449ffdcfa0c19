"""Train several seeds, evaluate all on the same starts beside the classical controllers, write one results file.

    python -m agents.seeds --env-id BicycleLaneChange-v0 --algo ppo --seeds 5

Writes runs/ENV_ID-ALGO.json and, beside it, a picture of the learning curves and one of driven episodes.
"""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from agents import messages, pictures, scores, settings
from agents.episodes import evaluate, hardest_saved, summarise
from agents.evaluate import console_for_tables, find_policy, make_env, print_table
from agents.messages import UserError
from agents.statistics import bootstrap, iqm
from bicycle_env import control, files, provenance

ALWAYS = ("lqr", "zero")
PROGRESS = files.table({"timesteps": files.whole_in(0, 10**12)}, others=True)
RUN = files.table(
    {"seed": files.whole_in(0, 10**12), "timesteps": files.whole_in(0, 10**12), "seconds": files.number_in(0, 1e12)},
    others=True,
)


@dataclass
class Args:
    """Train with several seeds, take the best policy of each, compare with LQR and the uncontrolled car."""

    env_id: str = "BicycleLaneChange-v0"
    """Environment id."""
    algo: Literal["ppo", "sac", "td3"] = "ppo"
    """Algorithm of Stable-Baselines3."""
    seeds: int = 5
    """How many: 0, 1, 2, ..."""
    episodes: int = 200
    """Starts of the evaluation, the same for every policy."""
    controllers: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME [NAME ...]")] = ()
    """Other controllers that drive the same starts beside lqr and zero, by the names that agents.evaluate lists."""
    evaluation_seed: int = 1
    """Seed of these starts."""
    total_timesteps: int | None = None
    """Training steps; by default as agents/configs says."""
    jobs: int = 2
    """Trainings at a time, one core each."""
    out: Path | None = None
    """Results file; by default runs/ENV_ID-ALGO.json."""
    runs: Path | None = None
    """Folder for the runs; by default a new one under runs/. Finished runs found there are kept, others go on."""
    median_of_lqr: float = 0.0
    """Exit 1 if the median success over seeds is below this share of LQR's."""
    worst_of_lqr: float = 0.0
    """Exit 1 if any seed's success is below this share of LQR's."""


def train_all(args: Args, folder: Path, total: int) -> list[Path]:
    """Run the trainings in processes of their own, `jobs` at a time; gives the runs' folders."""
    folders = [folder / f"seed{seed}" for seed in range(args.seeds)]
    waiting = [(seed, place) for seed, place in enumerate(folders) if not (place / "policy.json").is_file()]
    running: dict[Path, tuple[subprocess.Popen[str], Any]] = {}
    with messages.progress() as bar:
        while waiting or running:
            while waiting and len(running) < args.jobs:
                seed, place = waiting.pop(0)
                command = [sys.executable, "-m", "agents.train", "--env-id", args.env_id, "--algo", args.algo]
                command += ["--seed", str(seed), "--total-timesteps", str(total), "--out", str(place), "--quiet"]
                if (place / "run.json").is_file():
                    command.append("--resume")
                process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
                running[place] = process, bar.add_task(f"seed {seed}", total=total)
            for place, (process, job) in list(running.items()):
                progress = place / "checkpoint" / "progress.json"
                if progress.is_file():
                    bar.update(job, completed=files.read_json(progress, PROGRESS)["timesteps"])
                if process.poll() is not None:
                    del running[place]
                    bar.update(job, completed=total)
                    if process.returncode:
                        _, errors = process.communicate()
                        for other, _ in running.values():
                            other.terminate()
                        raise UserError(f"training in {place} failed: {errors.strip().splitlines()[-1:]}")
            time.sleep(0.5)
    return folders


def aggregate(seeds: list[dict[str, Any]]) -> dict[str, Any]:
    """Interquartile mean over seeds with a 95 % bootstrap interval, per figure."""
    found: dict[str, Any] = {}
    figures = [key for key, figure in seeds[0].items() if isinstance(figure, dict) and "value" in figure]
    for key in figures:
        values = [row[key]["value"] for row in seeds if key in row]
        if len(values) == len(seeds):
            found[key] = {"value": iqm(values), "interval": bootstrap(values, iqm), "median": float(np.median(values))}
            found[key]["range"] = [min(values), max(values)]
    return found


def main() -> int:
    args = tyro.cli(Args, prog="python -m agents.seeds", description=__doc__)
    messages.check_least(args, seeds=1, jobs=1, episodes=1, evaluation_seed=0, total_timesteps=1)
    out = args.out or Path("runs") / f"{args.env_id}-{args.algo}.json"
    messages.check_output("--out", out)
    messages.check_output("--runs", args.runs, folder=True)
    console = console_for_tables()
    env: Any = make_env(args.env_id, {"telemetry": True})
    task = env.unwrapped.task
    by_name = {name: find_policy(name, env) for name in (*ALWAYS, *args.controllers)}
    total = args.total_timesteps or settings.read(args.env_id, args.algo).total_timesteps
    folder = args.runs or Path("runs") / time.strftime(f"benchmark-{args.env_id}-{args.algo}-%Y%m%d-%H%M%S")
    console.print(f"training {args.algo.upper()} on {args.env_id}, {args.seeds} seeds of {total:,} steps, in {folder}")
    folders = train_all(args, folder, total)

    by_hand = {name: evaluate(env, policy, args.episodes, args.evaluation_seed) for name, policy in by_name.items()}
    controllers = {name: summarise(driven) for name, driven in by_hand.items()}
    learned = [evaluate(env, control.load(place), args.episodes, args.evaluation_seed) for place in folders]
    seeds = [summarise(driven) for driven in learned]
    trainings = []
    for place in folders:
        run = files.read_json(place / "run.json", RUN)
        # Runs of earlier revisions, whose policy is the last, have no "best".
        trainings.append({key: run[key] for key in ("seed", "timesteps", "seconds", "best") if key in run})
    whole = aggregate(seeds)
    algo = args.algo.upper()
    rows = {**controllers, **{f"{algo}, seed {k}": row for k, row in enumerate(seeds)}}
    print_table(console, f"{args.env_id}: {args.episodes} episodes, the same starts; mean [95 % interval]", rows, task)
    print_table(console, f"over {args.seeds} seeds: interquartile mean [95 % bootstrap interval]", {algo: whole}, task)

    found = scores.known(env)
    every = {**controllers, algo: whole}
    for line in [] if found is None else scores.sentences(found, every):
        console.print(line)

    lqr = controllers["lqr"]["success_rate"]["value"]
    shares = [row["success_rate"]["value"] for row in seeds]
    files.write_json(
        out,
        {
            "command": f"python -m agents.seeds --env-id {args.env_id} --algo {args.algo} --seeds {args.seeds}"
            + (f" --controllers {' '.join(args.controllers)}" if args.controllers else ""),
            **provenance.collect(),
            "env_id": args.env_id,
            "algo": args.algo,
            "evaluation_seed": args.evaluation_seed,
            "trainings": trainings,
            "controllers": controllers,
            "seeds": seeds,
            "over_seeds": whole,
            **({} if found is None else {"scores": scores.scored(found, every)}),
            "median_success_of_lqr": float(np.median(shares)) / lqr if lqr else None,
            "worst_success_of_lqr": min(shares) / lqr if lqr else None,
        },
    )
    curves, drive = out.with_suffix(".curves.png"), out.with_suffix(".drive.png")
    pictures.learning_curves(
        [place / "curve.csv" for place in folders],
        args.env_id,
        {name: row["success_rate"]["value"] for name, row in controllers.items()},
        curves,
    )
    median = int(np.argsort(shares)[len(shares) // 2])
    drivers = {name: by_name[name] for name in reversed(ALWAYS)}
    start = hardest_saved(by_hand["lqr"], learned[median], args.evaluation_seed)
    pictures.drive(env, {**drivers, "learned": control.load(folders[median])}, start, drive)
    slowest = max(training["seconds"] for training in trainings)
    of_lqr = [share / lqr if lqr else float("nan") for share in (float(np.median(shares)), min(shares))]
    console.print(
        f"median success {np.median(shares):.3f} = {of_lqr[0]:.2f} of LQR's, worst {min(shares):.3f} = "
        f"{of_lqr[1]:.2f}; slowest training {slowest:.0f} s\n"
        f"written: {out}, {curves.name}, {drive.name}"
    )
    failed = np.median(shares) < args.median_of_lqr * lqr or min(shares) < args.worst_of_lqr * lqr
    if failed:
        console.print(f"below what was asked: median {args.median_of_lqr}, worst {args.worst_of_lqr} of LQR's success")
    return int(failed)


if __name__ == "__main__":
    messages.run(main)
