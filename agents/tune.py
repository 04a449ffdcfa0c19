"""Tune a controller for an environment, so that what a learner is compared with is a good regulator and no straw man.

    python -m agents.tune --env-id BicycleStab-v0 --env-keywords '{"friction": 0.4}' --out runs/icy.json
    python -m agents.evaluate --env-keywords '{"friction": 0.4}' --policy runs/icy.json lqr
    python -m agents.tune --env-id BicycleActiveSteer-v0 --controller rear-switched --out runs/switched.json

The cross-entropy method over the logarithms of the LQR's weights (bicycle_env.optimum.tune_weights), or over the gains
of a rear-steer law (tune_gains), several times from random places, thousands of cars at once. The score is the success
rate plus the mean reward per step. Candidates are scored on starts of their own, and the best is chosen on others; no
evaluation uses either.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich import box
from rich.progress import Progress
from rich.table import Table

from agents import messages
from agents.episodes import start_seeds
from agents.evaluate import console_for_tables, make_env, parse_keywords
from agents.messages import UserError
from bicycle_env import optimum, provenance
from bicycle_env.files import write_json

TUNING_STARTS, SELECTION_STARTS = 128, 1000
LAW_ITERATIONS = 40


@dataclass
class Args:
    """Find weights for the LQR, or gains for another controller, in one environment."""

    env_id: str = "BicycleStab-v0"
    """Environment id."""
    env_keywords: str = "{}"
    """Keywords of the environment as JSON, for example '{"speed_ratio": 1.3, "steer": "rear"}'."""
    controller: str = "lqr"
    """"lqr", or a rear-steer law of BicycleActiveSteer-v0."""
    restarts: int = 5
    """How often the search begins anew, from other random weights."""
    iterations: int | None = None
    """Of each; by default 10, of a rear-steer law 40."""
    seed: int = 0
    """Of the search and of its starts."""
    out: Path | None = None
    """Weights file; by default runs/ENV_ID-weights.json."""


def tune(
    env_id: str, keywords: dict[str, Any], seed: int, bar: Progress, *, restarts: int = 5, iterations: int = 10
) -> optimum.Tuning:
    """Tune for one environment on the starts that are kept for it, with a line in the progress bar."""
    job = bar.add_task("tuning the LQR's weights", total=restarts * iterations)
    try:
        return optimum.tune_weights(
            env_id,
            keywords,
            start_seeds(TUNING_STARTS, seed, "tune"),
            start_seeds(SELECTION_STARTS, seed, "select"),
            restarts=restarts,
            iterations=iterations,
            seed=seed,
            progress=lambda done, _: bar.update(job, completed=done),
        )
    except np.linalg.LinAlgError as error:
        raise UserError(str(error)) from None


def tune_law(
    env_id: str, keywords: dict[str, Any], controller: str, seed: int, bar: Progress, *, restarts: int, iterations: int
) -> optimum.GainTuning:
    """The gains of a rear-steer law, likewise."""
    job = bar.add_task(f"tuning {controller}", total=restarts * iterations)
    try:
        return optimum.tune_gains(
            env_id,
            keywords,
            controller,
            start_seeds(TUNING_STARTS, seed, "tune"),
            start_seeds(SELECTION_STARTS, seed, "select"),
            restarts=restarts,
            iterations=iterations,
            seed=seed,
            progress=lambda done, _: bar.update(job, completed=done),
        )
    except ValueError as error:
        raise UserError(str(error)) from None


def record(tuning: optimum.Tuning) -> dict[str, Any]:
    """What a results file says about a tuning; "weights" are the best."""
    rates = [candidate.success_rate for candidate in tuning.restarts]
    return {
        "weights": tuning.best.weights._asdict(),
        "tuning_starts": TUNING_STARTS,
        "selection_starts": SELECTION_STARTS,
        "on_selection_starts": {
            **{name: _figures(candidate) for name, candidate in _named(tuning).items()},
            "restarts": [_figures(candidate) for candidate in tuning.restarts],
            "success_rate_of_restarts": [min(rates), max(rates)],
        },
    }


def law_record(controller: str, tuning: optimum.GainTuning) -> dict[str, Any]:
    """The same about gains."""
    rates = [candidate.success_rate for candidate in tuning.restarts]
    return {
        "controller": controller,
        "gains": list(tuning.best.gains),
        "tuning_starts": TUNING_STARTS,
        "selection_starts": SELECTION_STARTS,
        "on_selection_starts": {
            "best": tuning.best._asdict(),
            "restarts": [candidate._asdict() for candidate in tuning.restarts],
            "success_rate_of_restarts": [min(rates), max(rates)],
        },
    }


def _named(tuning: optimum.Tuning) -> dict[str, Any]:
    """The best, and the weights that come with the package, if they do."""
    return {"best": tuning.best, **({"shipped": tuning.shipped} if tuning.shipped else {})}


def _figures(candidate: Any) -> dict[str, Any]:
    return {**candidate._asdict(), "weights": candidate.weights._asdict()}


def table(tuning: optimum.Tuning) -> Table:
    """The best, every restart and the shipped weights, for people."""
    shown = Table(title=f"on {SELECTION_STARTS} starts that select", box=box.SIMPLE_HEAD, title_justify="left")
    for name in ("", "success %", "on road %", "return", *tuning.best.weights._fields):
        shown.add_column(name.replace("_", " "), justify="right" if name else "left")
    rows = _named(tuning) | {f"restart {k}": candidate for k, candidate in enumerate(tuning.restarts)}
    for name, one in rows.items():
        figures = (f"{100 * one.success_rate:.1f}", f"{100 * one.on_road_rate:.1f}", f"{one.mean_return:.1f}")
        shown.add_row(name, *figures, *(f"{weight:.4g}" for weight in one.weights))
    return shown


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.tune", description=__doc__)
    messages.check_least(args, restarts=1, iterations=1, seed=0)
    out = args.out or Path("runs") / f"{args.env_id}-weights.json"
    messages.check_output("--out", out)
    keywords = parse_keywords(args.env_keywords)
    make_env(args.env_id, keywords)
    console = console_for_tables()
    begin = time.perf_counter()
    iterations = args.iterations or (10 if args.controller == "lqr" else LAW_ITERATIONS)
    given = {"restarts": args.restarts, "iterations": iterations}
    with messages.progress() as bar:
        if args.controller == "lqr":
            tuning: Any = tune(args.env_id, keywords, args.seed, bar, **given)
            console.print(table(tuning))
            found = record(tuning)
        else:
            tuning = tune_law(args.env_id, keywords, args.controller, args.seed, bar, **given)
            found = law_record(args.controller, tuning)
    rates = [100 * candidate.success_rate for candidate in tuning.restarts]
    console.print(f"success of the {args.restarts} restarts: {min(rates):.1f} to {max(rates):.1f} %")
    write_json(
        out,
        {
            "command": f"python -m agents.tune --env-id {args.env_id}"
            + (f" --controller {args.controller}" if args.controller != "lqr" else "")
            + f" --restarts {args.restarts} --iterations {iterations} --seed {args.seed}"
            + (f" --env-keywords '{args.env_keywords}'" if args.env_keywords != "{}" else ""),
            **provenance.collect(),
            "seconds": round(time.perf_counter() - begin, 1),
            "env_id": args.env_id,
            "env_keywords": keywords,
            **found,
        },
    )
    if args.controller == "lqr":
        console.print(
            f"weights: {out}; drive with them: python -m agents.evaluate --env-id {args.env_id} --policy {out} lqr"
        )
    else:
        console.print(
            f"gains: {out}; drive with them: control.REAR_STEERINGS[{args.controller!r}](env.unwrapped, gains)"
        )


if __name__ == "__main__":
    messages.run(main)
