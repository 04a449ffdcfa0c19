"""How fast can a policy enter the double lane change and pass? The figure that practitioners know.

    python -m agents.entry_speed --json results/entry_speed.json
    python -m agents.entry_speed --course iso3888-2 --policy lqr my_controller:YawDamper

The speeds are a ladder of 0.25 m/s; one is passed if every start is. Passing need not be monotone: a speed below the
highest may fail, and the table says how far all pass. Each speed has its own controller, designed for it. "lqr-tuned"
and "preview-tuned" have their weights, and the time that they look ahead, chosen for the highest entry speed, on other
starts than those reported.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray
from rich import box
from rich.table import Table

from agents import messages, tune
from agents.episodes import start_seeds
from agents.evaluate import console_for_tables, find_policy, make_env, parse_keywords
from agents.messages import UserError
from bicycle_env import control, optimum, provenance
from bicycle_env.control.driver import Preview
from bicycle_env.files import write_json
from bicycle_env.tasks.double_lane_change import COURSES

ENV_ID = "BicycleDoubleLaneChange-v0"
RUNG = 0.25  # m/s
LADDER = (0.4, 2.2)
"""Its ends, as multiples of the course's usual speed."""
PREVIEW_TIMES = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1)  # s
SPARE = 0.5  # s: the way round is longer than straight on
ROUNDS, BEYOND = 3, 1.0
"""Of "lqr-tuned": how often weights are tuned anew, and how much faster than what passes so far, m/s."""

MakePolicy = Callable[[gym.Env], control.Policy]


@dataclass
class Args:
    """Find the highest speed at which policies pass the cones."""

    course: tuple[str, ...] = tuple(COURSES)
    """Courses."""
    steer: tuple[str, ...] = ("front", "both")
    """Which axles are steered. A driver alone leaves the rear wheels straight: he is driven with "front" only."""
    policy: tuple[str, ...] = ("preview", "preview-tuned", "stanley", "lqr", "lqr-tuned")
    """As for agents.evaluate; also lqr-tuned and preview-tuned."""
    starts: int = 50
    """Starts at each speed, the same for all."""
    seed: int = 1
    """Seed of the starts, those of the tuning included."""
    env_keywords: str = "{}"
    """More keywords of the environment as JSON, for example '{"friction": 0.5}'."""
    json: Path | None = None
    """Also write the figures to this file."""


def shares(keywords: dict[str, Any], speeds: NDArray[Any], make: MakePolicy, seeds: list[int]) -> NDArray[np.float64]:
    """(speeds,): the share of the starts that pass at each speed, the policy made anew for each."""
    plants = [make_env(ENV_ID, {**keywords, "speed": float(speed)}) for speed in speeds]
    policies = [make(plant) for plant in plants]
    slowest: Any = plants[int(np.argmin(speeds))].unwrapped
    seconds = slowest.task.seconds_to_pass(slowest.configuration.car) + SPARE
    limit = math.ceil(seconds / slowest.action_timestep)
    own = {**keywords, "speed": np.repeat(speeds, len(seeds)), "max_episode_steps": limit}
    cars = optimum.make_cars(ENV_ID, own, len(speeds) * len(seeds))

    def act(observation: NDArray[Any], _: int) -> NDArray[Any]:
        rows = observation.reshape(len(speeds), len(seeds), -1)
        return np.concatenate([policy.act(row) for policy, row in zip(policies, rows, strict=True)])

    passed = optimum.drive(cars, act, seeds * len(speeds)).success
    share: NDArray[np.float64] = passed.reshape(len(speeds), len(seeds)).mean(axis=1)
    return share


def highest(speeds: NDArray[Any], share: NDArray[Any]) -> float:
    """The highest speed at which every start passes, m/s; 0 where none does."""
    return float(np.max(speeds[share == 1.0], initial=0.0))


def unbroken(speeds: NDArray[Any], share: NDArray[Any]) -> float:
    """The highest speed up to which every speed of the ladder passes, m/s; 0 where the slowest fails."""
    failed = np.flatnonzero(share < 1.0)
    count = failed[0] if len(failed) else len(speeds)
    return float(speeds[count - 1]) if count else 0.0


def tuned_preview(
    keywords: dict[str, Any], speeds: NDArray[Any], seeds: list[int]
) -> tuple[MakePolicy, dict[str, Any]]:
    """MacAdam's driver without delay, and the preview time with which he passes fastest."""

    def maker(seconds: float) -> MakePolicy:
        return lambda env: Preview(env.unwrapped, preview_time=seconds, delay=0.0)  # type: ignore[arg-type]

    best = max(PREVIEW_TIMES, key=lambda seconds: highest(speeds, shares(keywords, speeds, maker(seconds), seeds)))
    return maker(best), {"preview_time": best, "delay": 0.0}


def tuned_lqr(
    keywords: dict[str, Any], speeds: NDArray[Any], seeds: list[int], seed: int
) -> tuple[MakePolicy, dict[str, Any]]:
    """LQR with weights tuned just beyond the speed that it passes so far, until that gains nothing."""

    def maker(parameters: dict[str, float] | None) -> MakePolicy:
        return lambda env: control.make("lqr", env, parameters=parameters)

    best: dict[str, float] | None = None
    reached = highest(speeds, shares(keywords, speeds, maker(best), seeds))
    for _ in range(ROUNDS):
        with messages.progress() as bar:
            tuning = tune.tune(ENV_ID, {**keywords, "speed": reached + BEYOND}, seed, bar, restarts=3, iterations=8)
        now = highest(speeds, shares(keywords, speeds, maker(tuning.best.parameters), seeds))
        if now <= reached:
            break
        best, reached = tuning.best.parameters, now
    return maker(best), {"parameters": best}


def table(rows: dict[str, dict[str, dict[str, Any]]]) -> Table:
    """For people."""
    shown = Table(title="highest entry speed that passes", box=box.SIMPLE_HEAD, title_justify="left")
    for name in ("course", "steer", "policy", "m/s", "km/h", "unbroken up to, m/s"):
        shown.add_column(name, justify="right" if "/" in name else "left")
    for course, modes in rows.items():
        for steer, policies in modes.items():
            for name, row in policies.items():
                speed, solid = row["highest"], row["unbroken"]
                shown.add_row(course, steer, name, f"{speed:.2f}", f"{3.6 * speed:.1f}", f"{solid:.2f}")
    return shown


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.entry_speed", description=__doc__)
    messages.check_least(args, starts=1, seed=0)
    messages.check_output("--json", args.json)
    more = parse_keywords(args.env_keywords)
    if {"course", "steer", "speed", "speed_ratio", "max_episode_steps"} & set(more):
        raise UserError("--env-keywords: course and steer are options of their own; speed and time are the ladder's")
    reported, selecting = (start_seeds(args.starts, args.seed, purpose) for purpose in ("report", "select"))
    rows: dict[str, dict[str, dict[str, Any]]] = {}
    begin = time.perf_counter()
    for course in args.course:
        for steer in args.steer:
            keywords = {**more, "course": course, "steer": steer}
            usual: Any = make_env(ENV_ID, keywords).unwrapped
            low, high = (round(end * usual.speed / RUNG) for end in LADDER)
            speeds = RUNG * np.arange(low, high + 1)
            for name in args.policy:
                if steer != "front" and name.partition("-")[0] in control.DRIVERS:
                    continue
                chosen: dict[str, Any] = {}
                if name == "lqr-tuned":
                    make, chosen = tuned_lqr(keywords, speeds, selecting, args.seed)
                elif name == "preview-tuned":
                    make, chosen = tuned_preview(keywords, speeds, selecting)
                else:
                    make = lambda env, name=name: find_policy(name, env)  # noqa: E731
                share = shares(keywords, speeds, make, reported)
                rows.setdefault(course, {}).setdefault(steer, {})[name] = {
                    "highest": highest(speeds, share),
                    "unbroken": unbroken(speeds, share),
                    **chosen,
                    "speeds": speeds.tolist(),
                    "shares": share.tolist(),
                }
    console = console_for_tables()
    console.print(table(rows))
    if args.json is not None:
        write_json(
            args.json,
            {
                "command": f"python -m agents.entry_speed --course {' '.join(args.course)} --steer "
                f"{' '.join(args.steer)} --policy {' '.join(args.policy)} --starts {args.starts} --seed {args.seed}"
                + (f" --env-keywords '{json.dumps(more)}'" if more else ""),
                **provenance.collect(),
                "seconds": round(time.perf_counter() - begin, 1),
                "env_id": ENV_ID,
                "env_keywords": more,
                "seed": args.seed,
                "starts": args.starts,
                "rung": RUNG,
                "courses": rows,
            },
        )
        console.print(f"figures: {args.json}")


if __name__ == "__main__":
    messages.run(main)
