"""What does planning ahead save? MPC on the hard levels of the three newer ids, from the true state.

    python -m agents.mpc_headroom --json results/mpc.json
    python -m agents.mpc_headroom --quick --only Evade

Of what is hidden it is told nothing, the friction, what the driver will do, or both (optimum/predictive.py). For each
row its weights are chosen among twenty sets, on starts that only tune; the rows are of the first starts of
agents.headroom, from which the best classical controller of that study starts once more. Finished rows are kept beside
the output (NAME.parts/), and the same command goes on where it was stopped; --older takes those of other revisions.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rich import box
from rich.progress import Progress
from rich.table import Table

import bicycle_env
from agents import headroom, messages, scores
from agents.episodes import start_seeds
from agents.evaluate import console_for_tables
from agents.headroom import cell, kept, part_file
from agents.headroom_setting import FULL_STATE, plain
from agents.messages import UserError
from agents.statistics import bootstrap, mean, share
from bicycle_env import control, optimum, provenance
from bicycle_env.files import write_json
from bicycle_env.optimum import Cars, Knowledge, Outcomes, Predictive

TOLD = {
    "nothing": Knowledge(),
    "friction": Knowledge(friction=True),
    "command": Knowledge(command=True),
    "friction and command": Knowledge(friction=True, command=True),
}
"""Beside the state."""
DRIVEN = "BicycleActiveSteer-v0"
"""The id in which someone else has the steering wheel."""
ROWS = {
    f"{env_id} hard": (env_id, {told: knows for told, knows in TOLD.items() if env_id == DRIVEN or not knows.command})
    for env_id in optimum.PREDICTIVE
}
CLASSICAL = "classical"


@dataclass
class Args:
    """Drive the hard levels with model-predictive control."""

    quick: bool = False
    """A look: fewer starts and sets of weights (two minutes)."""
    seed: int = 1
    """Seed of the starts that are reported, as of agents.headroom."""
    search_seed: int = 0
    """Seed of the starts on which the weights are chosen, and of the sets."""
    only: str = ""
    """Settings whose name contains this."""
    older: bool = False
    """Take finished rows of other revisions of the code, too: each says its own."""
    json: Path | None = None
    """Write the figures to this file."""


@dataclass(frozen=True)
class Extent:
    """How much is driven."""

    reported: int
    tuning: int
    """Starts on which the weights are chosen ..."""
    sets: int
    """... and among how many."""


FULL, QUICK = Extent(100, 16, 20), Extent(8, 4, 3)


class Setting:
    """One id at its hard level: who drives it, from the same starts."""

    def __init__(self, name: str, args: Args, extent: Extent, bar: Progress) -> None:
        self.name, self.extent, self.search_seed, self._bar = name, extent, args.search_seed, bar
        self.env_id, self.told = ROWS[name]
        self.keywords = headroom.SETTINGS[name].keywords
        self.cars = Cars(self.env_id, self.keywords)
        self.seeds = start_seeds(extent.reported, args.seed)
        self._mpc: Predictive | None = None

    @property
    def mpc(self) -> Predictive:
        """Built when first asked for."""
        if self._mpc is None:
            self._mpc = optimum.PREDICTIVE[self.env_id](self.cars.plant)
        return self._mpc

    def row(self, what: str) -> dict[str, Any]:
        """The figures of the classical controller, or of MPC with what it is told."""
        return self.classical() if what == CLASSICAL else self.predictive(what)

    def classical(self) -> dict[str, Any]:
        """The best that agents.headroom has tuned for the level; with the state, where it is better for it."""
        part = scores.part_of(self.env_id, "hard")
        if part is None:
            raise UserError(f"results/headroom.json has no {self.name}: python -m agents.headroom comes first")
        drivers, named = part["drivers"], part["classical"]["driver"]
        names = [name for name in (named, f"{named}, sees the state") if name in drivers]
        best = max(names, key=lambda name: float(drivers[name]["success_rate"]["value"]))
        keywords = {**self.keywords, **(FULL_STATE[self.env_id] if best != named else {})}
        cars = Cars(self.env_id, keywords)
        controller, parameters = drivers[best]["controller"], drivers[best]["parameters"]
        law = control.make(controller, cars.plant, parameters=parameters)
        begin = time.perf_counter()
        outcomes = optimum.drive(cars.of(len(self.seeds)), optimum.by(law), self.seeds)
        sees = drivers[best]["sees"]
        return {"driver": best, "sees": sees, "parameters": parameters, **figures(outcomes, begin)}

    def predictive(self, told: str) -> dict[str, Any]:
        """Weights are chosen, then it drives the starts that are reported."""
        begin, job = time.perf_counter(), self._bar.add_task("", total=self.extent.sets + 1)
        values, rate = self.chosen(told, job)
        mpc = self.mpc
        mpc.plans, mpc.failures, mpc.seconds = 0, 0, 0.0
        outcomes = self.driven(told, values, self.seeds, job)
        self._bar.remove_task(job)
        return {
            "sees": "state" if told == "nothing" else f"state, {told}",
            "parameters": dict(zip((one.name for one in mpc.searched), values.tolist(), strict=True)),
            "sets": self.extent.sets,
            "on_tuning_starts": rate,
            **figures(outcomes, begin),
            "milliseconds_per_step": round(1e3 * mpc.seconds / int(outcomes.steps.sum()), 3),
            "plans": mpc.plans,
            "failures": mpc.failures,
        }

    def chosen(self, told: str, job: Any) -> tuple[NDArray[np.float64], float]:
        """The best of the sets on the tuning starts, and its success there.

        The first set is the usual one, half of the others are drawn about it and the rest, closer, about the best.
        """
        seeds = start_seeds(self.extent.tuning, self.search_seed, "tune")
        parameters, random = self.mpc.searched, np.random.default_rng([self.search_seed, *TOLD[told]])
        space = optimum.Space(parameters)
        usual = space.places(np.array([one.start for one in parameters], float))
        spread = np.array([one.spread for one in parameters])
        best, values, rate, place = -np.inf, usual, 0.0, usual
        for k in range(self.extent.sets):
            near = 0.0 if k == 0 else 1.0 if 2 * k < self.extent.sets else 0.5
            tried = space.clipped(
                (place if near == 0.5 else usual) + near * spread * random.standard_normal(len(usual))
            )
            trial = np.array([float(f"{value:.4g}") for value in space.values(tried[None])[0]])
            outcomes = self.driven(told, trial, seeds, job)
            won = float(np.mean(outcomes.success))
            score = won + float(np.mean(outcomes.episode_return)) / self.cars.episode_steps
            if score > best:
                best, values, rate, place = score, trial, won, tried
        return values, rate

    def driven(self, told: str, values: NDArray[np.float64], seeds: list[int], job: Any) -> Outcomes:
        cars = self.cars.of(len(seeds))
        act, done = self.mpc.by(cars, values, TOLD[told]), self._bar.tasks[self._bar.task_ids.index(job)].completed
        steps = self.cars.episode_steps

        def shown(observation: Any, step: int) -> Any:
            self._bar.update(job, description=f"{self.name}, told {told}", completed=done + step / steps)
            return act(observation, step)

        outcomes = optimum.drive(cars, shown, seeds)
        self._bar.update(job, completed=done + 1)
        return outcomes


def figures(outcomes: Outcomes, begin: float) -> dict[str, Any]:
    """Of a row; with each start's own success, for differences over the same starts."""
    return {
        "success_rate": share(outcomes.success),
        "on_road_rate": share(outcomes.on_road),
        "episode_return": mean(outcomes.episode_return),
        "starts": len(outcomes.success),
        "saved": outcomes.success.astype(int).tolist(),
        "seconds": round(time.perf_counter() - begin, 1),
    }


def study(args: Args, names: list[str], origin: dict[str, Any], bar: Progress) -> dict[str, dict[str, Any]]:
    """The settings' rows, those that are on disk already from there."""
    folder = None if args.json is None else args.json.with_suffix(".parts")
    found: dict[str, dict[str, Any]] = {}
    whole = bar.add_task("rows", total=sum(1 + len(ROWS[name][1]) for name in names))
    for name in names:
        setting = Setting(name, args, QUICK if args.quick else FULL, bar)
        rows: dict[str, Any] = {}
        for what in (CLASSICAL, *setting.told):
            label = f"{name} {what}"
            row = kept(folder, label, origin, args.older)
            if row is None:
                begin = time.process_time()
                row = {"git": origin["git"], **setting.row(what)}
                row["processor_seconds"] = round(time.process_time() - begin, 1)
                if folder is not None:
                    folder.mkdir(parents=True, exist_ok=True)
                    write_json(part_file(folder, label), {**origin, "part": row})
            rows[what] = row
            bar.advance(whole)
            bar.console.print(f"{label}: {100.0 * row['success_rate']['value']:.0f} % of {row['starts']} starts")
        found[name] = setting_of(setting, rows)
    return found


def setting_of(setting: Setting, rows: dict[str, Any]) -> dict[str, Any]:
    """A setting as JSON holds it: how far MPC stands above the classical controller, over the same starts."""
    classical = np.array(rows[CLASSICAL]["saved"], float)
    for what in setting.told:
        difference = np.array(rows[what]["saved"], float) - classical
        rows[what]["better_than_classical"] = {"value": float(np.mean(difference)), "interval": bootstrap(difference)}
    kind = optimum.PREDICTIVE[setting.env_id]
    timestep = setting.cars.plant.control_timestep
    return {
        "env_id": setting.env_id,
        "level": "hard",
        "keywords": plain(setting.keywords),
        "horizon": round(kind.horizon * optimum.HOLD * timestep, 6),
        "timestep": round(optimum.HOLD * timestep, 6),
        CLASSICAL: rows[CLASSICAL],
        "mpc": {what: rows[what] for what in setting.told},
    }


def table(settings: dict[str, dict[str, Any]]) -> Table:
    """For people."""
    shown = Table(box=box.SIMPLE_HEAD, title_justify="left", title="mean [95 % interval]")
    heads = ("setting", "driver", "success %", "on road %", "return", "better by, points", "ms a step", "failures")
    for k, name in enumerate(heads):
        shown.add_column(name, justify="left" if k < 2 else "right", no_wrap=True)
    for name, part in settings.items():
        rows = {part[CLASSICAL]["driver"]: part[CLASSICAL]}
        rows |= {f"MPC, told {what}": row for what, row in part["mpc"].items()}
        for k, (driver, row) in enumerate(rows.items()):
            columns = ("success_rate", 100.0), ("on_road_rate", 100.0), ("episode_return", 1.0)
            cells = [cell(row[key], factor) for key, factor in columns]
            cells.append(cell(row["better_than_classical"]) if k else "")
            cells += [f"{row['milliseconds_per_step']:.2f}", str(row["failures"])] if k else ["", ""]
            shown.add_row("" if k else name, driver, *cells)
        shown.add_section()
    return shown


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.mpc_headroom", description=__doc__)
    messages.check_least(args, seed=0, search_seed=0)
    names = [name for name in ROWS if args.only in name]
    if not names:
        raise UserError(f"--only must be a part of one of: {', '.join(ROWS)}; got {args.only!r}")
    messages.check_output("--json", args.json)
    begin = time.perf_counter()
    command = f"python -m agents.mpc_headroom --seed {args.seed} --search-seed {args.search_seed}"
    origin = {
        "command": command + (" --quick" if args.quick else "") + (f" --only '{args.only}'" if args.only else ""),
        **provenance.collect(),
        "version": bicycle_env.__version__,
        "quick": args.quick,
        "seed": args.seed,
        "search_seed": args.search_seed,
    }
    with messages.progress() as bar:
        settings = study(args, names, origin, bar)
    console = console_for_tables()
    console.print(table(settings))
    if args.json is not None:
        seconds = round(time.perf_counter() - begin, 1)
        write_json(args.json, {**origin, "seconds": seconds, "settings": settings})
        console.print(f"figures: {args.json}")


if __name__ == "__main__":
    messages.run(main)
