"""How fast can a policy enter the double lane change and pass? The figure that practitioners know.

    python -m agents.entry_speed --json results/entry_speed.json
    python -m agents.entry_speed --course iso3888-2 --policy lqr my_controller:YawDamper
    python -m agents.entry_speed --policy learned=runs/entry/{course}-{steer} --keep --json results/entry_speed.json

The speeds are a ladder of 0.25 m/s; one is passed if every start is. Passing need not be monotone: a speed below the
highest may fail, and the table says how far all pass. Each speed has its own controller, designed for it; a trained
policy is the same at all of them, and is not told the speed. "lqr-tuned" and "preview-tuned" have their weights, and
the time that they look ahead, chosen for the highest entry speed, on other starts than those reported.

NAME=POLICY calls a row NAME; in POLICY, {course} and {steer} stand for the course and the axles. A folder of folders
with trained policies, as agents.jobs makes one of seeds, is one row: its interquartile mean, and the range in brackets.
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
from agents.statistics import iqm
from bicycle_env import control, files, optimum, provenance
from bicycle_env.control.driver import Preview
from bicycle_env.tasks.double_lane_change import COURSES

ENV_ID = "BicycleDoubleLaneChange-v0"
RUNG = 0.25  # m/s
LADDER = (0.4, 2.2)
"""Its ends, as multiples of the course's usual speed."""
PREVIEW_TIMES = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1)  # s
SPARE = 0.5  # s: the way round is longer than straight on
ROUNDS, BEYOND = 3, 1.0
"""Of "lqr-tuned": how often weights are tuned anew, and how much faster than what passes so far, m/s."""

CONTENT = files.table(
    {"courses": files.mapping(files.mapping(files.mapping(files.mapping(files.anything))))}, others=True
)
SAME = ("env_id", "env_keywords", "seed", "starts", "rung")
"""What rows of one file have in common."""
LARGEST = 50_000_000
"""Bytes of a results file."""
OF_RUN = ("env_id", "env_keywords", "algo", "settings", "timesteps", "seconds", "git")

MakePolicy = Callable[[gym.Env], control.Policy]


@dataclass
class Args:
    """Find the highest speed at which policies pass the cones."""

    course: tuple[str, ...] = tuple(COURSES)
    """Courses."""
    steer: tuple[str, ...] = ("front", "both")
    """Which axles are steered. A driver alone leaves the rear wheels straight: he is driven with "front" only."""
    policy: tuple[str, ...] = ("preview", "preview-tuned", "stanley", "lqr", "lqr-tuned")
    """As for agents.evaluate; also lqr-tuned and preview-tuned, and NAME=POLICY."""
    starts: int = 50
    """Starts at each speed, the same for all."""
    seed: int = 1
    """Seed of the starts, those of the tuning included."""
    env_keywords: str = "{}"
    """More keywords of the environment as JSON, for example '{"friction": 0.5}'."""
    json: Path | None = None
    """Also write the figures to this file."""
    keep: bool = False
    """Rows that are in the file and are not driven now stay there; each new one says when and how it was driven."""


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


def named(word: str, course: str, steer: str) -> tuple[str, str]:
    """What a row is called, and its policy."""
    label, equals, policy = word.partition("=")
    policy = (policy if equals else label).replace("{course}", course).replace("{steer}", steer)
    return label, policy


def seeds_of(name: str) -> list[Path]:
    """The folders of trained policies in a folder that holds none itself; none for a policy of any other kind."""
    folder = Path(name)
    if not folder.is_dir() or (folder / "policy.json").is_file():
        return []
    return sorted(file.parent for file in folder.glob("*/policy.json"))


def passed(speeds: NDArray[Any], share: NDArray[Any]) -> dict[str, Any]:
    """A row of one policy."""
    figures = {"highest": highest(speeds, share), "unbroken": unbroken(speeds, share)}
    return {**figures, "speeds": speeds.tolist(), "shares": share.tolist()}


def over_seeds(folders: list[Path], rows: list[dict[str, Any]]) -> dict[str, Any]:
    """A row of several trained policies: interquartile means, each policy's own row, and how they were trained."""
    runs = [files.read_json(folder / "run.json", files.mapping(files.anything)) for folder in folders]
    each = [
        {"seed": run.get("seed"), **row, "training": {name: run.get(name) for name in OF_RUN}}
        for run, row in zip(runs, rows, strict=True)
    ]
    return {**{key: iqm([row[key] for row in rows]) for key in ("highest", "unbroken")}, "seeds": each}


def row_of(name: str, keywords: dict[str, Any], speeds: NDArray[Any], args: Args) -> dict[str, Any]:
    """What a policy passes, on the starts that report."""
    reported, selecting = (start_seeds(args.starts, args.seed, purpose) for purpose in ("report", "select"))
    chosen: dict[str, Any] = {}
    if name == "lqr-tuned":
        make, chosen = tuned_lqr(keywords, speeds, selecting, args.seed)
    elif name == "preview-tuned":
        make, chosen = tuned_preview(keywords, speeds, selecting)
    elif folders := seeds_of(name):
        makes = [lambda env, folder=folder: find_policy(str(folder), env) for folder in folders]
        return over_seeds(folders, [passed(speeds, shares(keywords, speeds, make, reported)) for make in makes])
    else:
        make = lambda env: find_policy(name, env)  # noqa: E731
    return {**passed(speeds, shares(keywords, speeds, make, reported)), **chosen}


def range_of(row: dict[str, Any], key: str) -> str:
    """A figure of a row, in m/s, with the range over seeds where there are some."""
    values = [one[key] for one in row.get("seeds", [])]
    return f"{row[key]:.2f}" + (f" [{min(values):.2f}, {max(values):.2f}]" if values else "")


def kept(path: Path, same: dict[str, Any]) -> dict[str, Any]:
    """The content of the file to which rows are added; UserError for one whose rows are not comparable."""
    try:
        before: dict[str, Any] = files.read_json(path, CONTENT, LARGEST)
    except (ValueError, OSError) as error:
        raise UserError(f"--keep: {files.shown(error)}") from None
    for name in SAME:
        if before.get(name) != same[name]:
            raise UserError(f"--keep: {path} has {name} {before.get(name)!r}, asked for is {same[name]!r}")
    return before


def table(rows: dict[str, dict[str, dict[str, Any]]]) -> Table:
    """For people."""
    shown = Table(title="highest entry speed that passes", box=box.SIMPLE_HEAD, title_justify="left")
    for name in ("course", "steer", "policy", "m/s", "km/h", "unbroken up to, m/s"):
        shown.add_column(name, justify="right" if "/" in name else "left")
    for course, modes in rows.items():
        for steer, policies in modes.items():
            for name, row in policies.items():
                speed, solid = range_of(row, "highest"), range_of(row, "unbroken")
                shown.add_row(course, steer, name, speed, f"{3.6 * row['highest']:.1f}", solid)
    return shown


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.entry_speed", description=__doc__)
    messages.check_least(args, starts=1, seed=0)
    messages.check_output("--json", args.json)
    more = parse_keywords(args.env_keywords)
    if {"course", "steer", "speed", "speed_ratio", "max_episode_steps"} & set(more):
        raise UserError("--env-keywords: course and steer are options of their own; speed and time are the ladder's")
    if args.keep and args.json is None:
        raise UserError("--keep: --json must name the file")
    same = {"env_id": ENV_ID, "env_keywords": more, "seed": args.seed, "starts": args.starts, "rung": RUNG}
    before = kept(args.json, same) if args.keep and args.json is not None and args.json.is_file() else None
    rows: dict[str, dict[str, dict[str, Any]]] = {}
    begin = time.perf_counter()
    for course in args.course:
        for steer in args.steer:
            keywords = {**more, "course": course, "steer": steer}
            usual: Any = make_env(ENV_ID, keywords).unwrapped
            low, high = (round(end * usual.speed / RUNG) for end in LADDER)
            speeds = RUNG * np.arange(low, high + 1)
            for word in args.policy:
                label, policy = named(word, course, steer)
                if steer != "front" and policy.partition("-")[0] in control.DRIVERS:
                    continue
                rows.setdefault(course, {}).setdefault(steer, {})[label] = row_of(policy, keywords, speeds, args)
    console = console_for_tables()
    console.print(table(rows))
    if args.json is None:
        return
    made_by = {
        "command": f"python -m agents.entry_speed --course {' '.join(args.course)} --steer {' '.join(args.steer)} "
        f"--policy {' '.join(args.policy)} --starts {args.starts} --seed {args.seed}"
        + (f" --env-keywords '{json.dumps(more)}'" if more else ""),
        **provenance.collect(),
        "seconds": round(time.perf_counter() - begin, 1),
    }
    if before is None:
        files.write_json(args.json, {**made_by, **same, "courses": rows})
    else:
        for course, modes in rows.items():
            for steer, policies in modes.items():
                place = before["courses"].setdefault(course, {}).setdefault(steer, {})
                place.update({name: {**row, "made_by": made_by} for name, row in policies.items()})
        files.write_json(args.json, before)
    console.print(f"figures: {args.json}")


if __name__ == "__main__":
    messages.run(main)
