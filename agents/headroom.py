"""How good is good? For every environment and level: nobody, the classical controllers tuned for it, the best found.

    python -m agents.headroom --json results/headroom.json
    python -m agents.headroom --quick --only Evade

The plant is exact and a step costs a tenth of a microsecond, so what steering can do is found by search, start by
start, and each success is proven by a replay. The starts are the same for every driver. "Best found" knows what is
hidden and what comes, and is a lower bound of what can be saved; "best found without knowing" has for each start one
law, which does best over 32 draws of what is hidden. Where something is hidden, scores are measured against the second,
else against the first. Settings run side by side, each in a process of its own. Finished ones are kept beside the
output (NAME.parts/), and the same command goes on where it was stopped; --older takes those of other revisions, too.
"""

from __future__ import annotations

import concurrent.futures
import math
import multiprocessing
import os
import queue
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich import box
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

import bicycle_env
from agents import headroom_picture, headroom_setting, messages
from agents.evaluate import console_for_tables
from agents.headroom_setting import FULL, QUICK, Extent, Setting
from agents.messages import UserError
from agents.scores import LEVELS
from bicycle_env import Actuator, provenance
from bicycle_env.files import FileError, anything, mapping, read_json, write_json
from bicycle_env.registration import ENVIRONMENTS

STAB = "BicycleStab-v0"


@dataclass
class Args:
    """Compare what could be saved with what is saved, for every id and level."""

    quick: bool = False
    """A look: fewer starts, restarts and samples (some five minutes)."""
    seed: int = 1
    """Seed of the starts that are reported."""
    search_seed: int = 0
    """Seed of the tuning and of the search, and of the starts that tune and select."""
    only: str = ""
    """Settings whose name contains this."""
    older: bool = False
    """Take finished settings of other revisions of the code, too: each says its own."""
    processes: int = os.cpu_count() or 1
    """How many settings at a time."""
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
    "1.5 x critical speed": {"speed_ratio": 1.5},
    "rear 1 deg only": actuators(1.0, 40.0, 9.0),
    "front axle only": {"steer": "front"},
    "rear axle only": {"steer": "rear"},
    "friction 0.6": {"friction": 0.6},
    "friction 0.4": {"friction": 0.4},
    "slow wheels: 15 and 5 deg/s": actuators(3.0, 15.0, 5.0),
}
"""Of BicycleStab-v0: variants that are no levels."""
SETTINGS = {
    **{f"{row.id} {level}": Setting(row.id, level, {"level": level}) for row in ENVIRONMENTS for level in LEVELS},
    **{f"{STAB}, {name}": Setting(STAB, None, keywords) for name, keywords in CONDITIONS.items()},
}
ORDER = sorted(
    SETTINGS,
    key=lambda name: (
        (*LEVELS, None).index(SETTINGS[name].level),
        -[row.id for row in ENVIRONMENTS].index(SETTINGS[name].env_id),
    ),
)
"""Neighbours are of different ids: two processes would compile the same at the same time. And those that take longest,
of the ids with the most controllers and the most that is hidden, should not begin last."""


def worker(name: str, extent: Extent, seed: int, search_seed: int, told: Any) -> dict[str, Any]:
    """A setting's part of the study, in a process of its own."""

    def tell(what: str, done: float, total: float) -> None:
        told.put((name, what, done, total))

    begin = time.process_time()  # of all threads; a setting starts no processes
    part = headroom_setting.study(SETTINGS[name], extent, seed, search_seed, tell)
    return {**part, "processor_seconds": round(time.process_time() - begin, 1)}


def study(args: Args, names: list[str], origin: dict[str, Any], bar: Progress) -> dict[str, dict[str, Any]]:
    """The parts by name, those that are on disk already from there."""
    folder = None if args.json is None else args.json.with_suffix(".parts")
    parts = {name: part for name in names if (part := kept(folder, name, origin, args.older)) is not None}
    left = [name for name in ORDER if name in names and name not in parts]
    whole = bar.add_task("settings", total=len(names), completed=len(parts))
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager:
        told: Any = manager.Queue()
        extent = QUICK if args.quick else FULL
        pool = concurrent.futures.ProcessPoolExecutor(min(args.processes, len(left) or 1), context)
        try:
            running = {pool.submit(worker, name, extent, args.seed, args.search_seed, told): name for name in left}
            jobs: dict[str, Any] = {}
            while running:
                over, _ = concurrent.futures.wait(running, timeout=0.5, return_when="FIRST_COMPLETED")
                while True:
                    try:
                        name, what, done, total = told.get_nowait()
                    except queue.Empty:
                        break
                    if name not in jobs:
                        jobs[name] = bar.add_task(name)
                    bar.update(jobs[name], description=f"{name}: {what}", completed=done, total=total)
                for future in over:
                    name = running.pop(future)
                    parts[name] = {"git": origin["git"], **future.result()}
                    if folder is not None:
                        folder.mkdir(parents=True, exist_ok=True)
                        write_json(part_file(folder, name), {**origin, "part": parts[name]})
                    if name in jobs:
                        bar.remove_task(jobs.pop(name))
                    bar.advance(whole)
                    room = parts[name]["room"]["value"]
                    bar.console.print(f"{name}: room {100.0 * room:.1f} points, {len(parts)} of {len(names)} settings")
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    return {name: parts[name] for name in names}


def part_file(folder: Path, name: str) -> Path:
    words = "".join(letter if letter.isalnum() else "-" for letter in name)
    return folder / f"{words}.json"


def kept(folder: Path | None, name: str, origin: dict[str, Any], older: bool = False) -> dict[str, Any] | None:
    """The part of an earlier run with the same seeds and extent, of the same code unless `older`; None without one."""
    if folder is None or not part_file(folder, name).is_file():
        return None
    try:
        found: dict[str, Any] = read_json(part_file(folder, name), mapping(anything))
    except FileError:
        return None
    keys = ("quick", "seed", "search_seed", *(() if older else ("git", "versions")))
    same = all(found.get(key) == origin[key] for key in keys)
    return found["part"] if same else None


def cell(figure: dict[str, Any], factor: float = 100.0) -> Text:
    """A value, and below it its interval."""
    low, high = figure["interval"]
    return Text(f"{factor * figure['value']:.1f}\n[{factor * low:.1f}, {factor * high:.1f}]")


def table(parts: dict[str, dict[str, Any]]) -> Table:
    """Every setting with its drivers, for people."""
    shown = Table(box=box.SIMPLE_HEAD, title_justify="left", title="mean [95 % interval]")
    for name in ("setting", "driver", "starts", "success %", "on road %", "return", "seconds"):
        shown.add_column(name, justify="left" if name in ("setting", "driver") else "right", no_wrap=True)
    for name, part in parts.items():
        for k, (driver, row) in enumerate(part["drivers"].items()):
            columns = ("success_rate", 100.0), ("on_road_rate", 100.0), ("episode_return", 1.0)
            values = [cell(row[key], factor) if key in row else "" for key, factor in columns]
            shown.add_row("" if k else name, driver, str(row["starts"]), *values, f"{row['seconds']:.1f}")
        room = part["room"]
        low, high = (100.0 * end for end in room["interval"])
        words = f"room: {100.0 * room['value']:.1f} [{low:.1f}, {high:.1f}] points, {part['reference']['driver']}"
        shown.add_row("", Text(f"{words} over {part['classical']['driver']}", style="bold"))
        shown.add_section()
    return shown


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.headroom", description=__doc__)
    messages.check_least(args, seed=0, search_seed=0, processes=1)
    names = [name for name in SETTINGS if args.only in name]
    if not names:
        raise UserError(f"--only must be a part of one of: {', '.join(SETTINGS)}; got {args.only!r}")
    messages.check_output("--json", args.json)
    console = console_for_tables()
    begin = time.perf_counter()
    for library in ("OPENBLAS", "OMP", "MKL"):  # of the processes that are started: one thread each
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    command = f"python -m agents.headroom --seed {args.seed} --search-seed {args.search_seed}"
    origin = {
        "command": command + (" --quick" if args.quick else "") + (f" --only '{args.only}'" if args.only else ""),
        **provenance.collect(),
        "version": bicycle_env.__version__,
        "quick": args.quick,
        "seed": args.seed,
        "search_seed": args.search_seed,
    }
    with messages.progress() as bar:
        parts = study(args, names, origin, bar)
    console.print(table(parts))
    if args.json is not None:
        sequences = {name: part.pop("sequences") for name, part in parts.items()}
        seconds = round(time.perf_counter() - begin, 1)
        write_json(args.json, {**origin, "seconds": seconds, "processes": args.processes, "settings": parts})
        steering, drawn = args.json.with_suffix(".steering.json"), args.json.with_suffix(".png")
        write_json(steering, {**origin, "sequences": sequences})
        headroom_picture.draw(parts, drawn)
        console.print(f"figures: {args.json}, steering: {steering.name}, picture: {drawn.name}")


if __name__ == "__main__":
    messages.run(main)
