"""How much room is there above linear control? Who saves how many of the same starts, for several conditions.

    python -m agents.headroom --json results/headroom.json

Each condition is a variant of BicycleStab-v0. Drivers: nobody; LQR with the weights that come with the package; LQR
with weights tuned for the condition, on starts of their own; the best steering that a search finds for each single
start in the true simulator, added to the tuned LQR. The bound is the share of the starts that lie in the four-state
recoverable set: in the lane, with road wheels that follow at once. What the search saves can be saved for certain, what
lies outside the bound cannot; the truth is between the two.
"""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from rich import box
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

import bicycle_env
from agents import messages, tune
from agents.episodes import start_seeds
from agents.evaluate import console_for_tables, make_env
from agents.messages import UserError
from agents.statistics import mean, share
from bicycle_env import Actuator, analysis, control, optimum, plots, provenance
from bicycle_env.files import write_json

ENV_ID = "BicycleStab-v0"
SEARCHED_STEPS = 240
"""Of each episode: a car that is saved has settled long before."""
KEPT_SEQUENCES = 2
"""Of each condition, steering sequences of the search that are written down."""


@dataclass
class Args:
    """Compare what could be saved with what is saved."""

    episodes: int = 200
    """Starts per condition, the same for every driver."""
    seed: int = 1
    """Seed of the starts."""
    search_seed: int = 0
    """Seed of the tuning and of the search, and of the starts that tune and select."""
    only: str = ""
    """Conditions whose name contains this."""
    json: Path | None = None
    """Write the figures to this file, and beside it a picture and steering sequences of the search."""


def actuators(angle: float, front_rate: float, rear_rate: float) -> dict[str, Actuator]:
    """Front at 6 degrees, rear at an angle, each with a rate in degrees per second."""
    return {
        "front_actuator": Actuator(math.radians(6.0), math.radians(front_rate), 0.05),
        "rear_actuator": Actuator(math.radians(angle), math.radians(rear_rate), 0.05),
    }


CONDITIONS: dict[str, dict[str, Any]] = {
    "instant actuators": {
        "front_actuator": Actuator(math.radians(6.0), time_constant=0.005),
        "rear_actuator": Actuator(math.radians(3.0), time_constant=0.005),
        "physics_timestep": 0.002,
    },
    "as shipped": {},
    "1.5 x critical speed": {"speed_ratio": 1.5},
    "rear 1 deg only": actuators(1.0, 40.0, 9.0),
    "front axle only": {"steer": "front"},
    "rear axle only": {"steer": "rear"},
    "friction 0.6": {"friction": 0.6},
    "friction 0.4": {"friction": 0.4},
    "slow wheels: 15 and 5 deg/s": actuators(3.0, 15.0, 5.0),
}
DRIVERS = {
    "uncontrolled": "nobody",
    "shipped": "LQR as shipped",
    "tuned": "LQR tuned for it",
    "search": "found by search",
}
BOUND = "bound"


def states_at_start(env: gym.Env, seeds: list[int]) -> np.ndarray:
    """(episodes, 4): lateral velocity, yaw rate, heading and lateral position."""
    plant: Any = env.unwrapped
    found = []
    for seed in seeds:
        env.reset(seed=seed)
        state = plant.state
        found.append((state.lateral_velocity, state.yaw_rate, state.heading, state.lateral_position))
    return np.array(found)


def bound(env: gym.Env) -> analysis.RecoverableSet:
    """What some steering could save in the environment; beyond half a body outside the lane it has ended."""
    plant: Any = env.unwrapped
    return analysis.recoverable_set(
        plant.vehicle,
        plant.speed,
        plant.tire,
        steer=plant.steer,
        friction=plant.friction,
        steer_limits=(plant.front_actuator.angle_limit, plant.rear_actuator.angle_limit),
        horizon=plant.task.episode_steps * plant.control_timestep,
        lane=plant.task.road_half_width + 0.5 * plant.vehicle.body_width,
        progress=False,
    )


def figures(success: Any, on_road: Any, episode_return: Any, seconds: float, inside: np.ndarray) -> dict[str, Any]:
    """A driver's row: shares and mean with 95 % intervals."""
    return {
        "success_rate": share(success),
        "on_road_rate": share(on_road),
        "episode_return": mean(episode_return),
        "seconds": round(seconds, 1),
        "saved outside the set": int(np.sum(np.asarray(success) & ~inside)),
    }


def condition(keywords: dict[str, Any], args: Args, bar: Progress) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """One row of the study, and some steering sequences of the search."""
    seeds = start_seeds(args.episodes, args.seed)
    env = make_env(ENV_ID, keywords)
    plant: Any = env.unwrapped
    clock = time.perf_counter()

    def lap() -> float:
        nonlocal clock
        before, clock = clock, time.perf_counter()
        return clock - before

    job = bar.add_task("recoverable set", total=None)
    inside = bound(env).contains(*states_at_start(env, seeds).T)
    bar.remove_task(job)
    row: dict[str, Any] = {
        "keywords": plain(keywords),
        BOUND: {"success_rate": share(inside), "seconds": round(lap(), 1)},
    }
    tuning = tune.tune(ENV_ID, keywords, args.search_seed, bar)
    row["tuning"] = {**tune.record("lqr", tuning), "seconds": round(lap(), 1)}
    tuned = control.make("lqr", env, parameters=tuning.best.parameters)
    cars = optimum.make_cars(ENV_ID, keywords, args.episodes)
    policies = {"uncontrolled": control.Zero(plant), "shipped": control.LQR(plant), "tuned": tuned}
    for name, policy in policies.items():
        driven = optimum.drive(cars, lambda observation, _, policy=policy: policy.act(observation), seeds)
        row[name] = figures(*driven[:3], lap(), inside)
    job = bar.add_task("search, start by start", total=args.episodes)
    found = optimum.search_steering(
        ENV_ID,
        keywords,
        tuned,
        seeds,
        span=SEARCHED_STEPS,
        seed=args.search_seed,
        progress=lambda done: bar.update(job, completed=done),
    )
    columns = zip(*((rescue.success, rescue.on_road, rescue.episode_return) for rescue in found), strict=True)
    row["search"] = {
        **figures(*map(np.array, columns), lap(), inside),
        "iterations of those saved": [rescue.iterations for rescue in found if rescue.success and rescue.iterations],
    }
    # Those that only the search saves come first.
    saved = [k for k in range(len(found)) if found[k].success]
    kept = sorted(saved, key=lambda k: found[k].iterations == 0)[:KEPT_SEQUENCES]
    return row, [
        {"keywords": plain(keywords), "start": seeds[k], "iterations": found[k].iterations,
         "actions": found[k].actions.tolist()}
        for k in kept
    ]  # fmt: skip


def plain(keywords: dict[str, Any]) -> dict[str, Any]:
    """Keywords as JSON holds them: an actuator by its fields, an infinite rate by leaving it out."""
    found: dict[str, Any] = {}
    for name, value in keywords.items():
        if isinstance(value, Actuator):
            fields = dataclasses.asdict(value).items()
            found[name] = {field: number for field, number in fields if math.isfinite(number)}
        else:
            found[name] = value
    return found


def study(args: Args) -> tuple[dict[str, dict[str, Any]], dict[str, list[dict[str, Any]]]]:
    """The rows by condition, and the steering sequences."""
    rows, sequences = {}, {}
    for name, keywords in CONDITIONS.items():
        if args.only in name:
            with messages.progress() as bar:
                bar.add_task(f"[bold]{name}", total=None)
                rows[name], sequences[name] = condition(keywords, args, bar)
    return rows, sequences


def cell(figure: dict[str, Any], factor: float = 100.0) -> Text:
    """A value, and below it its interval."""
    low, high = figure["interval"]
    return Text(f"{factor * figure['value']:.1f}\n[{factor * low:.1f}, {factor * high:.1f}]")


def table(rows: dict[str, dict[str, Any]]) -> Table:
    """Every condition with its drivers, for people."""
    shown = Table(box=box.SIMPLE_HEAD, title_justify="left", title="mean [95 % interval]")
    for name in ("condition", "driver", "success %", "on road %", "return", "seconds"):
        shown.add_column(name, justify="left" if name in ("condition", "driver") else "right", no_wrap=True)
    for name, row in rows.items():
        for k, (key, label) in enumerate(DRIVERS.items()):
            one = row[key]
            seconds = one["seconds"] + (row["tuning"]["seconds"] if key == "tuned" else 0.0)
            values = (cell(one["success_rate"]), cell(one["on_road_rate"]), cell(one["episode_return"], 1.0))
            shown.add_row("" if k else name, label, *values, f"{seconds:.1f}")
        shown.add_row("", "upper bound", cell(row[BOUND]["success_rate"]), "", "", f"{row[BOUND]['seconds']:.1f}")
        shown.add_section()
    return shown


def picture(rows: dict[str, dict[str, Any]], path: Path) -> None:
    """One bar per driver in front of the bound's."""
    figure = plots.new_figure(9.0, 1.4 + 0.65 * len(rows), f"Random starts of {ENV_ID} that are saved")
    axes = figure.subplots()
    places = np.arange(len(rows))[::-1]
    bounds = [100.0 * row[BOUND]["success_rate"]["value"] for row in rows.values()]
    axes.barh(places, bounds, height=0.84, color="0.9", edgecolor="0.4", label="upper bound for any steering")
    drivers = [name for name in DRIVERS if name != "uncontrolled"]
    height = 0.75 / len(drivers)
    for k, name in enumerate(drivers):
        rates = [row[name]["success_rate"] for row in rows.values()]
        values = np.array([100.0 * rate["value"] for rate in rates])
        axes.barh(
            places + 0.375 - (k + 0.5) * height,
            values,
            height=0.9 * height,
            xerr=np.abs(100.0 * np.array([rate["interval"] for rate in rates]).T - values),
            color=plots.line_style(k + 1).color,
            error_kw={"elinewidth": 0.8},
            label=DRIVERS[name],
        )
    axes.set_yticks(places, list(rows))
    axes.set_xlabel("share of the starts [%], with 95 % intervals")
    axes.set_xlim(0.0, 100.0)
    axes.grid(axis="y", visible=False)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    plots.save(figure, path)


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.headroom", description=__doc__)
    messages.check_least(args, episodes=1, seed=0, search_seed=0)
    if not any(args.only in name for name in CONDITIONS):
        raise UserError(f"--only must be a part of one of: {', '.join(CONDITIONS)}; got {args.only!r}")
    messages.check_output("--json", args.json)
    console = console_for_tables()
    begin = time.perf_counter()
    rows, sequences = study(args)
    console.print(table(rows))
    if args.json is not None:
        origin = {
            "command": f"python -m agents.headroom --episodes {args.episodes} --seed {args.seed} "
            f"--search-seed {args.search_seed}" + (f" --only '{args.only}'" if args.only else ""),
            **provenance.collect(),
            "version": bicycle_env.__version__,
            "env_id": ENV_ID,
        }
        write_json(args.json, {**origin, "seconds": round(time.perf_counter() - begin, 1), "conditions": rows})
        steering, drawn = args.json.with_suffix(".steering.json"), args.json.with_suffix(".png")
        write_json(steering, {**origin, "sequences": sequences})
        picture(rows, drawn)
        console.print(f"figures: {args.json}, steering: {steering.name}, picture: {drawn.name}")


if __name__ == "__main__":
    messages.run(main)
