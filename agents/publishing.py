"""Publish the best of some runs as the policy that comes with the package, and write the leaderboard anew.

    python -m agents.publishing runs/stab-0 runs/stab-1 --level medium
    python -m agents.publishing               # scores and leaderboard alone, after results/headroom.json has changed

The best is the one with the most success on the starts that select, as its run.json says; the 2000 starts that report
choose nothing. Its folder says what it is: policy.json has the level, the score, the training, and what made it.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import tyro

from agents import messages, scores, trained
from agents.episodes import start_seeds
from agents.evaluate import environment
from agents.headroom_setting import LEARNED
from agents.messages import UserError
from agents.statistics import mean, share
from bicycle_env import control, leaderboard, optimum, provenance
from bicycle_env.control.network import BASE, DESCRIPTION_FILE
from bicycle_env.control.pretrained import FOLDER, USUAL_LEVEL, place, published
from bicycle_env.files import (
    FileError,
    anything,
    mapping,
    number_in,
    read_json,
    shown,
    table,
    text,
    whole_in,
    write_json,
)

STARTS, SEED = 2000, 1
"""That report."""
BEST = table({"success_rate": number_in(0.0, 1.0), "episode_return": number_in(-1e12, 1e12)}, others=True)
RECORD = table(
    {"env_id": text(200), "seed": whole_in(0, 2**63), "env_keywords": mapping(anything), "best": BEST}, others=True
)
PUBLISHED = table({"training": table({"best": BEST}, others=True)}, others=True)
OF_TRAINING = (
    *("algo", "seed", "settings", "env_keywords", "timesteps", "seconds", "best", "resumed"),
    *("date", "machine", "versions", "git"),
)
"""Of run.json, what policy.json keeps."""
SCORED = table({"score": mapping(anything)}, others=True)


@dataclass
class Args:
    """Publish the best of some runs; without runs, measure the scores of those that are there anew."""

    runs: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Folders of finished trainings, of one id."""
    level: str | None = None
    """That the policy is published for, and driven at: easy, medium or hard."""
    out: Path = FOLDER
    """Folder of the policies and the leaderboard."""


class Run(NamedTuple):
    """A training, and how its policy drives at the level."""

    folder: Path
    record: dict[str, Any]
    network: control.Network
    score: dict[str, Any]

    @property
    def selected_by(self) -> tuple[float, float]:
        """Success and mean return on the starts that select."""
        return self.record["best"]["success_rate"], self.record["best"]["episode_return"]


def publish(
    folders: Sequence[Path], level: str, out: Path = FOLDER, starts: int = STARTS, command: str = ""
) -> list[Run]:
    """Write the best policy of some runs into its folder below `out`, and the leaderboard; all runs, the best first.

    Args:
        folders: of the runs.
        level: of their id.
        out: folder of the policies.
        starts: that report.
        command: that is written down.

    Raises:
        UserError: a run that cannot be published, a bad level, runs of different ids or of another level; all are worse
            on the starts that select than the policy that is there.
    """
    records = [record_of(folder) for folder in folders]
    ids = sorted({record["env_id"] for record in records})
    if len(ids) != 1:
        raise UserError(f"the runs must be of one id, got {', '.join(map(shown, ids))}")
    environment(ids[0])
    try:
        cars = optimum.Cars(ids[0], {"level": level})
    except (ValueError, TypeError) as error:
        raise UserError(f"--level: {shown(error)}") from None
    for folder, record in zip(folders, records, strict=True):
        trained_at = record["env_keywords"] or {"level": USUAL_LEVEL}
        if trained_at != {"level": level}:
            raise UserError(f"{shown(folder)} was trained and selected with {shown(trained_at)}, not at level {level}")
    runs = [scored_run(folder, record, cars, level, starts) for folder, record in zip(folders, records, strict=True)]
    runs.sort(key=lambda run: run.selected_by, reverse=True)
    best = runs[0]
    refuse_worse(place(ids[0], level, out), best)
    made_by = provenance.collect()  # before a file is written: the revision is that of the code
    best.network.description |= {
        "env_keywords": {"level": level},
        "level": level,
        "command": command,
        **made_by,
        "score": best.score,
        "training": {name: best.record[name] for name in OF_TRAINING if name in best.record},
        "runs": [
            {
                "seed": run.record["seed"],
                "selection": run.record["best"],
                "success_rate": run.score["success_rate"],
                "episode_return": run.score["episode_return"],
            }
            for run in runs
        ],
    }
    best.network.save(place(ids[0], level, out))
    write_leaderboard(out, command, made_by)
    return runs


def refuse_worse(there: Path, best: Run) -> None:
    """UserError if the policy in a folder is better on the starts that select."""
    if not (there / DESCRIPTION_FILE).is_file():
        return
    selection = read_json(there / DESCRIPTION_FILE, PUBLISHED)["training"]["best"]
    if (selection["success_rate"], selection["episode_return"]) > best.selected_by:
        raise UserError(
            f"{shown(there)} has a better policy: {100.0 * selection['success_rate']:.1f} % of the starts that select, "
            f"the best of these runs {100.0 * best.selected_by[0]:.1f} %; remove the folder to publish all the same"
        )


def record_of(folder: Path) -> dict[str, Any]:
    """What run.json says; UserError unless it is of a finished run that has chosen its best policy."""
    try:
        record: dict[str, Any] = read_json(folder / "run.json", RECORD)
    except (FileError, OSError) as error:
        raise UserError(
            f"{shown(folder)} is no finished run of a trainer that keeps its best policy: {error}"
        ) from None
    return record


def scored_run(folder: Path, record: dict[str, Any], cars: optimum.Cars, level: str, starts: int) -> Run:
    """A run, with its policy's figures; UserError for a policy that does not fit."""
    network = trained.load(str(folder))
    if BASE in network.description:
        raise UserError(f"{shown(folder)}: only networks ship, and this one is added to a controller's actions")
    trained.check_fit(str(folder), network, cars.plant)
    return Run(folder, record, network, figures(network, cars, record["env_id"], level, starts))


def figures(network: control.Network, cars: optimum.Cars, env_id: str, level: str, starts: int) -> dict[str, Any]:
    """How a policy does on the starts that report."""
    outcomes = optimum.drive(cars.of(starts), optimum.by(network), start_seeds(starts, SEED))
    success = share(outcomes.success)
    return {
        "starts": starts,
        "seed": SEED,
        "success_rate": success,
        "episode_return": mean(outcomes.episode_return),
        **measured_by(scores.known_of(env_id, level), success),
    }


def measured_by(known: scores.Known | None, success: dict[str, Any]) -> dict[str, float | None]:
    """A success rate's score, and what it is measured by."""
    if known is None:
        return {"score": None, "best_found": None}
    return {"score": known.score(success["value"]), "best_found": known.reference_success}


def write_leaderboard(out: Path = FOLDER, command: str = "", made_by: Mapping[str, Any] | None = None) -> None:
    """The policies in a folder beside what the headroom study says of classical controllers and the best found.

    The policies' own files have their scores by the same study.

    Args:
        out: folder of the policies.
        command: that is written down.
        made_by: of before anything was written; by default of now.
    """
    made_by = made_by or provenance.collect()
    for env_id, those in published(out).items():
        for level in those:
            path = place(env_id, level, out) / DESCRIPTION_FILE
            description = read_json(path, SCORED)
            score = description["score"]
            score |= measured_by(scores.known_of(env_id, level), score["success_rate"])
            write_json(path, description)
    content = {"command": command, **made_by, "levels": levels(out)}
    write_json(out / leaderboard.FILE.name, content)


def levels(out: Path = FOLDER) -> dict[str, Any]:
    """By id and level, the rows of the leaderboard."""
    study = read_json(scores.FILE, table({"settings": mapping(scores.PART)}, others=True), scores.LARGEST)["settings"]
    studied = [name for name, part in study.items() if part.get("level")]
    policies = [f"{env_id} {level}" for env_id, those in published(out).items() for level in those]
    return {name: {"rows": rows(*name.split(), out)} for name in dict.fromkeys((*studied, *policies))}


def rows(env_id: str, level: str, out: Path) -> list[dict[str, Any]]:
    """The drivers of a level: the best first, the best found last."""
    known, part = scores.known_of(env_id, level), scores.part_of(env_id, level)

    def row(name: str, kind: str, figures: dict[str, Any]) -> dict[str, Any]:
        shared = {key: figures[key] for key in ("starts", "success_rate", "episode_return")}
        # The reference is the scale's other end; its own success is one of fewer starts.
        rate = figures["success_rate"]["value"] if kind != "reference" or known is None else known.reference_success
        score = None if known is None else known.score(rate)
        return {"name": name, "kind": kind, **shared, "score": score}

    found = []
    if (folder := place(env_id, level, out)).is_dir():
        found.append(row(control.PRETRAINED, "policy", read_json(folder / DESCRIPTION_FILE, SCORED)["score"]))
    drivers = {} if part is None else part["drivers"]
    for name, figures in drivers.items():
        if "controller" in figures and figures["sees"] == "observation":
            found.append(row(name, "classical", figures))
    found.sort(key=lambda row: (row["success_rate"]["value"], row["episode_return"]["value"]), reverse=True)
    if known is not None and known.reference != LEARNED:  # that is the first row
        found.append(row(known.reference, "reference", drivers[known.reference]))
    return found


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.publishing", description=__doc__)
    messages.check_output("--out", args.out, folder=True)
    command = shlex.join(["python", "-m", "agents.publishing", *sys.argv[1:]])
    console = messages.console()
    if not args.runs:
        if args.level is not None:
            raise UserError("--level needs runs to publish")
        write_leaderboard(args.out, command)
    elif args.level is None:
        raise UserError("--level must say what level the policy is published for: easy, medium or hard")
    else:
        runs = publish(args.runs, args.level, args.out, command=command)
        for run in runs:
            success, episode_return = run.score["success_rate"], run.score["episode_return"]
            low, high = (100.0 * end for end in success["interval"])
            console.print(
                f"{shown(run.folder)}: selected with {100.0 * run.selected_by[0]:.1f} %, reports "
                f"{100.0 * success['value']:.1f} % [{low:.1f}, {high:.1f}], return {episode_return['value']:.1f}",
                soft_wrap=True,
            )
        console.print(f"published: {place(runs[0].record['env_id'], args.level, args.out)}", soft_wrap=True)
    console.print(f"written: {args.out / leaderboard.FILE.name}", soft_wrap=True)


if __name__ == "__main__":
    messages.run(main)
