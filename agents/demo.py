"""The demo: train a stabilising policy, compare it with LQR and the uncontrolled car, draw pictures.

The moving picture is of another id, BicycleActiveSteer-v0, with the policy that ships.

    python -m agents.demo          # what `make demo` runs after it has installed everything

Exits 1 unless the table, the pictures and the learned policy's lead over the uncontrolled car are there.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tyro
from rich.progress import track

from agents import messages, moving_picture, policy_search, settings
from agents.episodes import evaluate, hardest_saved, start_seeds, summarise
from agents.evaluate import console_for_tables, make_env, print_table
from bicycle_env import control, load_policy, provenance
from bicycle_env.files import write_json

ENV_ID = "BicycleStab-v0"
PICTURES = ("drive.png", "starts.png", "learning_curve.png", "top_view.png", "active_steer.gif")
SHOWN = "BicycleActiveSteer-v0"
"""Of the moving picture: nobody at the rear wheels, the classical law, and the policy that comes with the package."""
SHOWN_STARTS = 2000
MUST_LEAD = 0.5  # of the starts, over the uncontrolled car


@dataclass
class Args:
    """Train on a car above its critical speed, evaluate, draw."""

    seed: int = 0
    """Seed of the training."""
    episodes: int = 200
    """Starts of the evaluation, the same for all policies."""
    evaluation_seed: int = 1
    """Seed of these starts."""
    total_timesteps: int | None = None
    """Control steps of the training; by default as agents/configs says."""
    out: Path = Path("runs")
    """Where demo.json and the folder demo/ with the pictures go."""


def main() -> int:
    from agents import pictures

    args = tyro.cli(Args, prog="python -m agents.demo", description=__doc__)
    messages.check_least(args, seed=0, episodes=1, evaluation_seed=0, total_timesteps=1)
    messages.check_output("--out", args.out / "demo.json")
    messages.check_output("--out", args.out / "demo", folder=True)
    console = console_for_tables()
    begin = time.perf_counter()
    folder = Path("runs") / time.strftime("demo-%Y%m%d-%H%M%S")
    training = settings.usual(policy_search.Args, policy_search.ALGORITHM, ["--env-id", ENV_ID])
    training = replace(training, env_id=ENV_ID, seed=args.seed, out=folder, quiet=not sys.stderr.isatty())
    if args.total_timesteps is not None:
        training = replace(training, total_timesteps=args.total_timesteps)
    console.print(f"1/3  training on {ENV_ID}: a car at 1.2 times its critical speed, caught soonest by policy search")
    policy_search.train(training, console)
    trained = time.perf_counter()

    env = make_env(ENV_ID, {"telemetry": True})
    plant: Any = env.unwrapped
    policies = {
        "zero": control.make("zero", plant),
        "lqr": control.make("lqr", plant),
        "learned": control.load(folder),
    }
    console.print(f"\n2/3  evaluating on the same {args.episodes} starts")
    driven = {
        name: evaluate(env, policy, args.episodes, args.evaluation_seed)
        for name, policy in track(policies.items(), "evaluating", console=messages.console(stderr=True), transient=True)
    }
    rows = {name: summarise(episodes) for name, episodes in driven.items()}
    print_table(console, f"{ENV_ID}: {args.episodes} episodes, the same starts; mean [95 % interval]", rows, plant.task)

    console.print("\n3/3  drawing")
    place = args.out / "demo"
    start = hardest_saved(driven["lqr"], driven["learned"], args.evaluation_seed)
    shares = {name: row["success_rate"]["value"] for name, row in rows.items()}
    pictures.drive(env, policies, start, place / "drive.png")
    pictures.saved_starts(env, driven, args.evaluation_seed, place / "starts.png")
    pictures.learning_curves([folder / "curve.csv"], ENV_ID, shares, place / "learning_curve.png")
    pictures.top_view(ENV_ID, {}, lambda _: policies["learned"], start, 15, place / "top_view.png")
    cars = make_env(SHOWN, {})
    drivers = {
        "nobody at the rear wheels": control.make("zero", cars.unwrapped),
        "classical: switched gains": control.make("rear-switched", cars.unwrapped),
        "learned": load_policy(SHOWN),
    }
    moving_picture.show(SHOWN, {}, drivers, start_seeds(SHOWN_STARTS, args.evaluation_seed), place / "active_steer.gif")
    lead = shares["learned"] - shares["zero"]
    write_json(
        args.out / "demo.json",
        {
            "command": f"python -m agents.demo --seed {args.seed} --out {args.out}",
            **provenance.collect(),
            "env_id": ENV_ID,
            "training_seed": args.seed,
            "evaluation_seed": args.evaluation_seed,
            "training_seconds": round(trained - begin, 1),
            "total_seconds": round(time.perf_counter() - begin, 1),
            "policies": rows,
            "lead_over_uncontrolled": lead,
        },
    )
    missing = [name for name in PICTURES if not (place / name).is_file()]
    for name in PICTURES:
        console.print(f"     {place / name}")
    console.print(f"     {args.out / 'demo.json'}")
    console.print(
        f"\nThe learned policy saves {100 * shares['learned']:.1f} % of the cars, LQR {100 * shares['lqr']:.1f} %, "
        f"nobody at the wheel {100 * shares['zero']:.1f} %; "
        "the intervals above say how sure that is."
    )
    if missing:
        console.print(f"missing pictures: {', '.join(missing)}")
    if lead < MUST_LEAD:
        console.print(f"the learned policy leads the uncontrolled car by only {100 * lead:.1f} points, not by 50")
    return 1 if missing or lead < MUST_LEAD else 0


if __name__ == "__main__":
    messages.run(main)
