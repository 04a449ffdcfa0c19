"""Where is room above linear control? What any steering could save, and what controllers save, for several conditions.

    python -m agents.room --policy lqr --json results/room.json

Each condition is a variant of BicycleStab-v0. The bound is the share of the same random starts that lie in the
four-state recoverable set: in the lane, with road wheels that follow at once. A controller's road wheels lag and are
limited in rate, so the bound may not be reached where the actuators are slow; a controller that comes near it is
nearly optimal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import bicycle_env
from agents import messages
from agents.episodes import evaluate, start_seeds
from agents.evaluate import console_for_tables, find_policy, make_env
from agents.messages import UserError
from agents.statistics import wilson
from bicycle_env import Actuator, analysis, plots, provenance
from bicycle_env.files import write_json

ENV_ID = "BicycleStab-v0"
LANE = 1.75  # m, from the lane's middle; beyond it by half a body the episode ends


@dataclass
class Args:
    """Compare what could be saved with what is saved."""

    policy: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME|FOLDER [NAME|FOLDER ...]")] = ("lqr",)
    """Controllers or folders of trained policies, as in agents.evaluate."""
    episodes: int = 200
    """Starts per condition, the same for every policy."""
    seed: int = 1
    """Seed of the starts."""
    only: str = ""
    """Conditions whose name contains this."""
    json: Path | None = None
    """Write the figures to this file, and a picture beside it."""


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


def starts(env: gym.Env, seeds: list[int]) -> np.ndarray:
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
        lane=LANE + 0.5 * plant.vehicle.body_width,
        progress=False,
    )


def share(saved: np.ndarray) -> dict[str, Any]:
    """A share with its 95 % interval."""
    return {"value": float(np.mean(saved)), "interval": wilson(int(np.sum(saved)), len(saved))}


def study(args: Args) -> dict[str, dict[str, Any]]:
    rows: dict[str, dict[str, Any]] = {}
    seeds = start_seeds(args.episodes, args.seed)
    with Progress(console=Console(stderr=True), transient=True) as bar:
        for name, keywords in CONDITIONS.items():
            if args.only not in name:
                continue
            env = make_env(ENV_ID, {**keywords, "telemetry": True})
            job = bar.add_task(f"{name}: recoverable set", total=args.episodes * len(args.policy))
            inside = bound(env).contains(*starts(env, seeds).T)
            rows[name] = {"bound": share(inside)}
            for done, policy in enumerate(args.policy):
                bar.update(job, description=f"{name}: {policy}")
                driven = evaluate(
                    env,
                    find_policy(policy, env),
                    args.episodes,
                    args.seed,
                    lambda count, job=job, done=done: bar.update(job, completed=done * args.episodes + count),
                )
                saved = np.array([episode.success for episode in driven])
                rows[name][policy] = {**share(saved), "saved outside the set": int(np.sum(saved & ~inside))}
    return rows


def table(rows: dict[str, dict[str, Any]], policies: tuple[str, ...]) -> Table:
    shown = Table(box=box.SIMPLE_HEAD)
    shown.add_column("condition")
    for name in ("bound", *policies):
        shown.add_column(f"{name} [%]", justify="right")
    for name, row in rows.items():
        cells = [
            f"{100 * cell['value']:.1f} [{100 * cell['interval'][0]:.1f}, {100 * cell['interval'][1]:.1f}]"
            for cell in row.values()
        ]
        shown.add_row(name, *cells)
    return shown


def picture(rows: dict[str, dict[str, Any]], policies: tuple[str, ...], path: Path) -> None:
    """One bar per policy in front of the bound's."""
    figure = plots.new_figure(9.0, 1.2 + 0.55 * len(rows), "Random starts of BicycleStab-v0 that are saved")
    axes = figure.subplots()
    places = np.arange(len(rows))[::-1]
    bounds = np.array([100.0 * row["bound"]["value"] for row in rows.values()])
    axes.barh(places, bounds, height=0.8, color="0.9", edgecolor="0.4", label="what some steering could save (bound)")
    height = 0.7 / len(policies)
    for k, policy in enumerate(policies):
        values = np.array([100.0 * row[policy]["value"] for row in rows.values()])
        errors = np.abs(100.0 * np.array([row[policy]["interval"] for row in rows.values()]).T - values)
        axes.barh(
            places + 0.35 - (k + 0.5) * height,
            values,
            height=0.9 * height,
            xerr=errors,
            color=plots.line_style(k + 1).color,
            error_kw={"elinewidth": 0.8},
            label={"lqr": "LQR", "mpc": "model-predictive control"}.get(policy, policy),
        )
    axes.set_yticks(places, list(rows))
    axes.set_xlabel("share of the starts [%], with 95 % intervals")
    axes.set_xlim(0.0, 100.0)
    axes.grid(axis="y", visible=False)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    plots.save(figure, path)


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.room", description=__doc__)
    if args.episodes < 1:
        raise UserError(f"--episodes must be at least 1, got {args.episodes}")
    if not any(args.only in name for name in CONDITIONS):
        raise UserError(f"--only must be a part of one of: {', '.join(CONDITIONS)}; got {args.only!r}")
    console = console_for_tables()
    rows = study(args)
    console.print(table(rows, args.policy))
    if args.json is not None:
        write_json(
            args.json,
            {
                "command": f"python -m agents.room --policy {' '.join(args.policy)} --episodes {args.episodes} "
                f"--seed {args.seed}" + (f" --only '{args.only}'" if args.only else ""),
                **provenance.collect(),
                "version": bicycle_env.__version__,
                "conditions": rows,
            },
        )
        picture(rows, args.policy, args.json.with_suffix(".png"))
        console.print(f"figures: {args.json}, picture: {args.json.with_suffix('.png')}")


if __name__ == "__main__":
    messages.run(main)
