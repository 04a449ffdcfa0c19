"""The whole table: every learner on every id and level of the plan, some seeds each, beside the classical controllers.

    python -m agents.benchmark                       # runs it, or goes on where it was stopped
    python -m agents.benchmark --quick               # ten minutes: two seeds, a twentieth of the steps
    python -m agents.benchmark --plan ablations      # what each option of agents.ppo is worth, on one id
    python -m agents.benchmark --plan remedies       # what was tried on the id where plain PPO fails
    python -m agents.benchmark --plan exploration    # actions and noise held or not, on the other ids

A cell is an id, a level and a learner. Its seeds are trained in processes of their own, side by side, and kept in
runs/benchmark/; what has finished there is not done again. Every policy then drives the same 2000 starts as the best
classical controller tuned for the level (results/headroom.json), so that their difference is one of the same starts.
Written: runs/benchmark.json and, beside it, learning curves against steps and seconds, and performance profiles.
"""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import tyro
from numpy.typing import NDArray
from rich import box
from rich.table import Table

from agents import benchmark_picture, messages, scores, settings, stopping
from agents.benchmark_plans import PLANS, Cell
from agents.episodes import start_seeds
from agents.evaluate import console_for_tables
from agents.messages import UserError
from agents.statistics import bootstrap, iqm, mean, share
from bicycle_env import control, files, optimum, provenance
from bicycle_env.optimum import Outcomes

STARTS, REPORT_SEED = 2000, 1
"""That report: no policy, no setting and no checkpoint is chosen on them."""
LEARNERS: dict[str, tuple[str, tuple[str, ...]]] = {
    "native-ppo": ("agents.ppo", ()),
    "policy-search": ("agents.policy_search", ()),
    "sb3-ppo": ("agents.train", ("--algo", "ppo")),
    "sb3-sac": ("agents.train", ("--algo", "sac")),
}
"""The module that trains, and options of its command line."""
QUICK_SEEDS, QUICK_SHARE = 2, 0.05
FIGURES = ("success_rate", "on_road_rate", "episode_return")
SCORES = ("score", "regret")
"""By the headroom study of the day."""
PROFILE = [round(0.01 * k, 2) for k in range(101)]
"""Success rates of which it is told how many seeds reach them."""


@dataclass
class Args:
    """Train and compare every learner, or go on with it; the table, one results file and its pictures."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORDS [WORDS ...]")] = ()
    """Only cells in whose name ("BicycleStab-v0 medium native-ppo") all of these stand, as they are."""
    seeds: int | None = None
    """Of each cell, 0, 1, 2, ...; by default as the plan says."""
    jobs: int = 2
    """Trainings at a time, one core each."""
    plan: Literal["table", "ablations", "remedies", "exploration"] = "table"
    """Every learner on every id and level; or PPO with one option after the other changed, on BicycleActiveSteer-v0 or
    on BicycleEvade-v0, or with other ways to try things out on the rest."""
    quick: bool = False
    """Two seeds of each cell, a twentieth of the steps: to see that all works, not how well."""
    runs: Path | None = None
    """Folder of the trainings; by default runs/benchmark, with --quick runs/benchmark-quick."""
    out: Path | None = None
    """Results file; by default runs/benchmark.json, or runs/ and the plan's name; with --quick
    runs/benchmark-quick.json and so on. Cells not trained now stay in it."""


class Job(NamedTuple):
    """A training of one seed."""

    cell: Cell
    seed: int
    folder: Path

    @property
    def done(self) -> bool:
        return (self.folder / "policy.json").is_file()

    def command(self, quick: bool) -> list[str]:
        module, options = LEARNERS[self.cell.learner]
        words = [sys.executable, "-m", module, *options, "--env-id", self.cell.env_id, "--seed", str(self.seed)]
        words += ["--env-keywords", json.dumps({"level": self.cell.level}), "--out", str(self.folder), "--quiet"]
        words += self.cell.options
        if quick:
            words += ["--total-timesteps", str(quick_steps(self.cell))]
        return [*words, "--resume"] if (self.folder / "run.json").is_file() else words


def quick_steps(cell: Cell) -> int:
    """A twentieth of what the cell's settings say."""
    if cell.learner in settings.OWN:
        module = importlib.import_module(LEARNERS[cell.learner][0])
        words = ["--env-id", cell.env_id, "--env-keywords", json.dumps({"level": cell.level})]
        steps = settings.usual(module.Args, cell.learner, words).total_timesteps
    else:
        steps = settings.read(cell.env_id, LEARNERS[cell.learner][1][1]).total_timesteps
    return max(1, int(QUICK_SHARE * steps))


def chosen(args: Args) -> list[Cell]:
    """The cells that the options ask for; UserError if there are none."""
    seeds = QUICK_SEEDS if args.quick and args.seeds is None else args.seeds
    plan = PLANS[args.plan]
    found = [cell for cell in plan if all(word in cell.name for word in args.only)]
    if not found:
        names = "\n".join(cell.name for cell in plan)
        raise UserError(f"--only {' '.join(args.only)}: no cell has all of these words; the cells are\n{names}")
    return found if seeds is None else [cell._replace(seeds=seeds) for cell in found]


def train_all(jobs: list[Job], args: Args) -> None:
    """Train what has not finished, `jobs` at a time; a bar with the time that is left.

    Raises:
        UserError: a training failed; the others are stopped, and go on with the same command.
    """
    waiting = [job for job in jobs if not job.done]
    running: dict[Job, subprocess.Popen[str]] = {}
    with messages.progress() as bar:
        task = bar.add_task("trainings", total=len(jobs), completed=len(jobs) - len(waiting))
        try:
            while waiting or running:
                while waiting and len(running) < args.jobs:
                    job = waiting.pop(0)
                    running[job] = subprocess.Popen(
                        job.command(args.quick), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
                    )
                    bar.update(task, description=f"{job.cell.name}, seed {job.seed}")
                for job, process in list(running.items()):
                    if process.poll() is not None:
                        del running[job]
                        bar.advance(task)
                        if not bar.console.is_terminal:
                            words = f"{job.cell.name}, seed {job.seed}"
                            bar.console.print(f"{words}: {sum(one.done for one in jobs)} of {len(jobs)} trainings")
                        if process.returncode:
                            errors = (process.stderr.read() if process.stderr else "").strip().splitlines()
                            raise UserError(f"training in {job.folder} failed: {files.shown(' '.join(errors[-1:]))}")
                time.sleep(0.2)
        except stopping.Stopped as stopped:
            words = "stopped; the same command goes on, with the trainings that were under way where they were"
            raise stopping.Stopped(stopped.code - 128, words) from None
        finally:
            for process in running.values():
                process.terminate()


def measured(cell: Cell, folders: list[Path]) -> dict[str, Any]:
    """How a cell's policies do on the starts that report, and how long it took."""
    keywords = {"level": cell.level}
    cars = optimum.Cars(cell.env_id, keywords)
    starts = start_seeds(STARTS, REPORT_SEED)
    many = cars.of(STARTS)
    classical = known_classical(cell)
    law = control.make(classical["controller"], cars.plant, parameters=classical["parameters"])
    theirs = optimum.drive(many, optimum.by(law), starts)
    known = scores.known_of(cell.env_id, cell.level)
    found = [optimum.drive(many, optimum.by(control.load(folder, cars.plant)), starts) for folder in folders]
    seeds = [one_seed(folder, outcomes, known) for folder, outcomes in zip(folders, found, strict=True)]
    difference = np.array([one.success.astype(float) - theirs.success for one in found])
    return {
        **cell._asdict(),
        "classical": {"controller": classical["controller"], "success_rate": share(theirs.success)},
        "trainings": seeds,
        "over_seeds": all_over_seeds(seeds),
        "better_than_classical": {"value": iqm(difference.mean(axis=1)), "interval": stratified(difference)},
        "profile": [float(np.mean([one.success.mean() >= level for one in found])) for level in PROFILE],
    }


def one_seed(folder: Path, outcomes: Outcomes, known: scores.Known | None) -> dict[str, Any]:
    """A training's figures and its learning curve."""
    run = files.read_json(folder / "run.json", files.table({"seed": files.whole_in(0, 10**12)}, others=True))
    curve = np.loadtxt(folder / "curve.csv", delimiter=",", skiprows=1, ndmin=2)
    figures: dict[str, Any] = {
        "seed": run["seed"],
        "timesteps": run["timesteps"],
        "seconds": run["seconds"],
        "success_rate": share(outcomes.success),
        "on_road_rate": share(outcomes.on_road),
        "episode_return": mean(outcomes.episode_return),
        "curve": [[int(row[0]), float(row[1]), float(row[2])] for row in curve[:, :3]],
    }
    if known is not None:
        success = figures["success_rate"]["value"]
        figures |= {"score": known.score(success), "regret": known.regret(figures["episode_return"]["value"])}
        figures["seconds_to_reference"] = known.seconds_to_reference(figures["curve"])
    return figures


def all_over_seeds(seeds: list[dict[str, Any]]) -> dict[str, Any]:
    """Of all figures; of score and regret where there is one."""
    figures = {key: over_seeds([one[key]["value"] for one in seeds]) for key in FIGURES}
    there = [key for key in SCORES if seeds[0].get(key) is not None]
    return {**figures, **{key: over_seeds([one[key] for one in seeds]) for key in there}}


def over_seeds(values: list[float]) -> dict[str, Any]:
    """Interquartile mean over seeds, its 95 % bootstrap interval, and the range."""
    return {"value": iqm(values), "interval": bootstrap(values, iqm), "range": [min(values), max(values)]}


def stratified(difference: NDArray[np.float64], samples: int = 2000) -> tuple[float, float]:
    """95 % bootstrap interval of the interquartile mean over seeds: seeds and starts are both drawn anew."""
    random = np.random.default_rng(0)
    seeds, starts = difference.shape
    drawn = [
        iqm(difference[random.integers(0, seeds, seeds)][:, random.integers(0, starts, starts)].mean(axis=1))
        for _ in range(samples)
    ]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(low), float(high)


def known_classical(cell: Cell) -> dict[str, Any]:
    """The best classical controller tuned for the cell's level, with its parameters; UserError if none is on disk."""
    part = scores.part_of(cell.env_id, cell.level)
    if part is None:
        raise UserError(f"{scores.FILE} knows no classical controller for {cell.env_id} {cell.level}: make headroom")
    found: dict[str, Any] = part["drivers"][part["classical"]["driver"]]
    return found


def shown(cells: dict[str, dict[str, Any]]) -> Table:
    """For people."""
    table = Table(
        box=box.SIMPLE_HEAD,
        collapse_padding=True,
        title=f"{STARTS} starts, the same for all; interquartile mean over seeds [95 % interval]",
    )
    words = ("id and level", "learner")
    for heading in (*words, "seeds", "success [%]", "better by\n[points]", "than the best\nclassical [%]",
                    "on road\n[%]", "score", "seconds"):  # fmt: skip
        table.add_column(heading, justify="left" if heading in words else "right", no_wrap=True)
    for cell in cells.values():
        figures = cell["over_seeds"]
        seconds = np.median([one["seconds"] for one in cell["trainings"]])
        known = scores.known_of(cell["env_id"], cell["level"])
        score = None if known is None else known.score(figures["success_rate"]["value"])
        table.add_row(
            f"{cell['env_id']} {cell['level']}",
            cell["variant"] or cell["learner"],
            str(len(cell["trainings"])),
            interval(figures["success_rate"], 100.0),
            interval(cell["better_than_classical"], 100.0),
            f"{100.0 * cell['classical']['success_rate']['value']:.1f} {cell['classical']['controller']}",
            f"{100.0 * figures['on_road_rate']['value']:.1f}",
            "-" if score is None else f"{score:.2f}",
            f"{seconds:.0f}",
        )
    return table


def interval(figure: dict[str, Any], factor: float) -> str:
    low, high = figure["interval"]
    return f"{factor * figure['value']:.1f} [{factor * low:.1f}, {factor * high:.1f}]"


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.benchmark", description=__doc__)
    messages.check_least(args, seeds=1, jobs=1)
    quick = "-quick" if args.quick else ""  # quick cells never stand among the others
    out = args.out or Path("runs") / f"{'benchmark' if args.plan == 'table' else args.plan}{quick}.json"
    messages.check_output("--out", out)
    runs = args.runs or Path("runs") / f"benchmark{quick}"
    messages.check_output("--runs", runs, folder=True)
    cells = chosen(args)
    for cell in cells:
        known_classical(cell)  # before any work
    console = console_for_tables()
    jobs = [Job(cell, seed, runs / cell.name.replace(" ", "-") / f"seed{seed}") for cell in cells for seed in
            range(cell.seeds)]  # fmt: skip
    train_all(jobs, args)
    before: dict[str, Any] = {}
    if out.is_file():
        before = benchmark_picture.read(out)
    made_by = provenance.collect()
    for cell in cells:
        folders = [job.folder for job in jobs if job.cell == cell]
        when = {name: made_by[name] for name in ("git", "date", "machine")}  # cells may be of several
        before[cell.name] = {**measured(cell, folders), **when}
        console.print(f"measured: {cell.name}")
    ordered = {cell.name: before[cell.name] for cell in PLANS[args.plan] if cell.name in before}
    words = ["python -m agents.benchmark", *([f"--plan {args.plan}"] if args.plan != "table" else [])]
    command = " ".join([*words, *(["--quick"] if args.quick else [])])
    files.write_json(out, {"command": command, **made_by, "starts": STARTS, "seed": REPORT_SEED, "cells": ordered})
    if args.plan == "table":
        benchmark_picture.draw(ordered, out.with_suffix(".png"))
    console.print(shown(ordered))
    console.print(f"written: {out}")


if __name__ == "__main__":
    messages.run(main)
