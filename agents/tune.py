"""Tune a controller for an environment, so that what a learner is compared with is a good one and no straw man.

    python -m agents.tune --env-id BicycleStab-v0 --env-keywords '{"friction": 0.4}' --out runs/icy.json
    python -m agents.evaluate --env-keywords '{"friction": 0.4}' --policy runs/icy.json lqr
    python -m agents.tune --env-id BicycleActiveSteer-v0 --controller rear-switched --out runs/switched.json

    python -m agents.tune --algo native-ppo --env-id BicycleStab-v0 --trials 20      # a learner's settings, with Optuna
    python -m agents.tune --algo sac --trials 20 --out runs/sac.json   # and runs/sac.toml, for agents.train --config

The cross-entropy method over the controller's parameters (bicycle_env.optimum.tune), several times from random places,
thousands of cars at once. The score is the success rate plus the mean reward per step. Candidates are scored on starts
of their own, and the best is chosen on others; no evaluation uses either. With --algo the settings of a learner are
searched instead: every trial is a training, in a study that goes on where it was stopped and that processes may share.
The file says with which command to train by what was found.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from rich import box
from rich.progress import Progress
from rich.table import Table

from agents import learner_tuning, messages, settings
from agents.episodes import start_seeds
from agents.evaluate import console_for_tables, make_env, parse_keywords
from agents.messages import UserError
from bicycle_env import control, optimum, provenance
from bicycle_env.files import write_json

TUNING_STARTS, SELECTION_STARTS = 128, 1000


@dataclass
class Args:
    """Find parameters for a controller, or settings for a learner, in one environment."""

    env_id: str = "BicycleStab-v0"
    """Environment id."""
    env_keywords: str = "{}"
    """Keywords of the environment as JSON, for example '{"speed_ratio": 1.3, "steer": "rear"}'."""
    controller: str = "lqr"
    """One of those listed above, or "module:Class" of one's own, a control.TunablePolicy."""
    restarts: int = 5
    """How often the search begins anew, from another random place."""
    iterations: int | None = None
    """Of each; by default 10, of a law whose cars have parameters of their own (rear-*, evade-path) 40."""
    seed: int = 0
    """Of the search and of its starts."""
    out: Path | None = None
    """File for the parameters; by default runs/ENV_ID-CONTROLLER.json, with --algo runs/STUDY/tuning.json. Settings of
    Stable-Baselines3 stand beside it, with the ending .toml, as agents.train --config takes them."""
    algo: Literal["native-ppo", "policy-search", "jax-ppo", "ppo", "sac", "td3"] | None = None
    """A learner, in place of a controller; the last three are Stable-Baselines3's."""
    trials: int = 20
    """With --algo: how many the study is to have, those that it has already counted."""
    total_timesteps: int | None = None
    """With --algo: of each training; by default the shipped settings'."""
    storage: str | None = None
    """With --algo: the study's database as SQLAlchemy names it; by default runs/STUDY/study.db. Several processes may
    search in one, each with the same --study and a --folder of its own."""
    study: str | None = None
    """With --algo: its name; by default ENV_ID-LEVEL-ALGO."""
    folder: Path | None = None
    """With --algo: of the trainings; by default runs/STUDY."""


def tune(
    env_id: str,
    keywords: dict[str, Any],
    seed: int,
    bar: Progress,
    *,
    controller: str = "lqr",
    restarts: int = 5,
    iterations: int | None = None,
) -> optimum.Tuning:
    """Tune for one environment on the starts that are kept for it, with a line in the progress bar."""
    job = bar.add_task(f"tuning {controller}", total=None)
    try:
        return optimum.tune(
            env_id,
            keywords,
            controller,
            start_seeds(TUNING_STARTS, seed, "tune"),
            start_seeds(SELECTION_STARTS, seed, "select"),
            restarts=restarts,
            iterations=iterations,
            seed=seed,
            progress=lambda done, total: bar.update(job, completed=done, total=total),
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        raise UserError(str(error)) from None


def record(controller: str, tuning: optimum.Tuning) -> dict[str, Any]:
    """What a results file says about a tuning; "parameters" are the best."""
    rates = [candidate.success_rate for candidate in tuning.restarts]
    return {
        "controller": controller,
        "parameters": tuning.best.parameters,
        "tuning_starts": TUNING_STARTS,
        "selection_starts": SELECTION_STARTS,
        "on_selection_starts": {
            **{name: candidate._asdict() for name, candidate in _named(tuning).items()},
            "restarts": [candidate._asdict() for candidate in tuning.restarts],
            "success_rate_of_restarts": [min(rates), max(rates)],
        },
    }


def _named(tuning: optimum.Tuning) -> dict[str, optimum.Candidate]:
    """The best, and what the controller has without tuning, if it has."""
    return {"best": tuning.best, **({"shipped": tuning.shipped} if tuning.shipped else {})}


def table(tuning: optimum.Tuning) -> Table:
    """The best, every restart and the shipped parameters, for people: a column each."""
    columns = _named(tuning) | {f"restart {k}": candidate for k, candidate in enumerate(tuning.restarts)}
    shown = Table(title=f"on {SELECTION_STARTS} starts that select", box=box.SIMPLE_HEAD, title_justify="left")
    for name in ("", *columns):
        shown.add_column(name, justify="right" if name else "left")
    rates = {"success %": "success_rate", "on road %": "on_road_rate"}
    for name, field in rates.items():
        shown.add_row(name, *(f"{100 * getattr(one, field):.1f}" for one in columns.values()))
    shown.add_row("return", *(f"{one.mean_return:.1f}" for one in columns.values()))
    for name in tuning.best.parameters:
        shown.add_row(name.replace("_", " "), *(f"{one.parameters[name]:.4g}" for one in columns.values()))
    return shown


def tune_learner(args: Args, algo: str) -> None:
    """What --algo asks for."""
    env: Any = make_env(args.env_id, parse_keywords(args.env_keywords))
    level = env.unwrapped.level if env.unwrapped.scored_level else "own"
    study = args.study or f"{args.env_id}-{level}-{algo}"
    folder = args.folder or Path("runs") / study
    out = args.out or folder / "tuning.json"
    messages.check_output("--folder", folder, folder=True)
    messages.check_output("--out", out)
    config = out.with_suffix(".toml")
    if algo in settings.ALGORITHMS:
        if config == out:
            raise UserError("--out must not end in .toml: so does the settings file that stands beside it")
        messages.check_output("--out", config)
    asked = learner_tuning.Search(
        args.env_id,
        args.env_keywords,
        algo,
        args.trials,
        args.total_timesteps,
        args.seed,
        args.storage,
        study,
        folder,
        config,
    )
    found = learner_tuning.search(asked)
    console = console_for_tables()
    console.print(learner_tuning.table(found))
    command = f"python -m agents.tune --algo {algo} --env-id {args.env_id} --trials {args.trials} --seed {args.seed}"
    command += f" --total-timesteps {args.total_timesteps}" if args.total_timesteps else ""
    command += f" --env-keywords '{args.env_keywords}'" if args.env_keywords != "{}" else ""
    learner_tuning.trainer_of(asked).write(found["settings"], command)  # first: the record's command names it
    write_json(out, {"command": command, **found})
    console.print(f"settings: {out}; train with them, seeds of your own: {found['train']} --seed 0", soft_wrap=True)


def main() -> None:
    listed = "Controllers: " + ", ".join(control.TUNABLE)
    args = tyro.cli(Args, prog="python -m agents.tune", description=f"{__doc__}\n{listed}")
    messages.check_least(args, restarts=1, iterations=1, seed=0, trials=1, total_timesteps=1)
    if args.algo is not None:
        tune_learner(args, args.algo)
        return
    out = args.out or Path("runs") / f"{args.env_id}-{args.controller}.json"
    messages.check_output("--out", out)
    keywords = parse_keywords(args.env_keywords)
    make_env(args.env_id, keywords)
    try:
        iterations = args.iterations or optimum.budget(control.tunable(args.controller)).iterations
    except (TypeError, ValueError) as error:
        raise UserError(f"--controller: {error}") from None
    console = console_for_tables()
    begin = time.perf_counter()
    with messages.progress() as bar:
        tuning = tune(
            args.env_id,
            keywords,
            args.seed,
            bar,
            controller=args.controller,
            restarts=args.restarts,
            iterations=iterations,
        )
    console.print(table(tuning))
    rates = [100 * candidate.success_rate for candidate in tuning.restarts]
    console.print(f"success of the {args.restarts} restarts: {min(rates):.1f} to {max(rates):.1f} %")
    write_json(
        out,
        {
            "command": f"python -m agents.tune --env-id {args.env_id} --controller {args.controller}"
            f" --restarts {args.restarts} --iterations {iterations} --seed {args.seed}"
            + (f" --env-keywords '{args.env_keywords}'" if args.env_keywords != "{}" else ""),
            **provenance.collect(),
            "seconds": round(time.perf_counter() - begin, 1),
            "env_id": args.env_id,
            "env_keywords": keywords,
            **record(args.controller, tuning),
        },
    )
    evaluated = f"python -m agents.evaluate --env-id {args.env_id} --policy {out}"
    evaluated += f" --env-keywords '{args.env_keywords}'" if keywords else ""
    made = f"control.make({args.controller!r}, env, parameters={str(out)!r})"
    console.print(f"parameters: {out}; drive with them: {made if ':' in args.controller else evaluated}")


if __name__ == "__main__":
    messages.run(main)
