"""Does the reward ask for what success judges? Shown before anything is trained.

    python -m agents.alignment --json results/alignment.json
    python -m agents.alignment --env-id BicycleEvade-v0 --env-keywords '{"steer": "both"}'

Ranks: the tuned classical controller is made worse in six ways, each to many degrees; of these policies 24 are chosen,
by their success on starts that select, as evenly as they are to be had from 5 to 95 %. Their mean returns must rank
them as their success does: Spearman's correlation at least 0.9. Search: the cross-entropy method on the controller's
parameters, from the tuned ones on, climbs the return; it may lose at most two points of success against the same
search, budget and seeds, that climbs success.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rich import box
from rich.table import Table
from scipy.stats import spearmanr

from agents import messages
from agents.episodes import start_seeds
from agents.evaluate import console_for_tables, parse_keywords
from agents.messages import UserError
from agents.statistics import bootstrap, mean, share
from agents.worsened import FAMILIES, POLICIES, ROUNDS, Bench, Variant, evenly, pool
from bicycle_env import control, optimum, plots, provenance
from bicycle_env.files import anything, mapping, read_json, write_json
from bicycle_env.plots.style import dress, line_style

Array = NDArray[Any]

CONTROLLERS = {
    "BicycleStab-v0": "lqr",
    "BicycleLaneChange-v0": "lqr",
    "BicycleDoubleLaneChange-v0": "lqr",
    "BicycleActiveSteer-v0": "rear-switched",
    "BicycleEvade-v0": "evade-path",
}
"""Of each id its best classical one."""
LEAST_CORRELATION, MOST_LOST = 0.9, 0.02
LEAST_POLICIES = 20
APART = ("noise", "harsher")
"""Families that are also left out: noise ends in failures that cost little return, and harsh steering costs return and
no success."""
SEARCHES, ITERATIONS, TUNING_STARTS, SELECTION_STARTS = 3, 10, 128, 1000
"""How many policy searches, and what each may use."""


@dataclass
class Args:
    """Compare what the reward asks for with what success judges."""

    env_id: str = ""
    """One environment id; by default all that are registered."""
    env_keywords: str = "{}"
    """Keywords of the environment as JSON, for example '{"steer": "both"}'."""
    starts: int = 2000
    """Starts that a policy is judged by, the same for all."""
    seed: int = 1
    """Seed of the starts, the policies and the searches."""
    older: bool = False
    """With --env-id: what the file of --json holds of other ids stays in it, each saying its own revision."""
    json: Path | None = None
    """Write the figures to this file, and beside it a picture."""


def correlation(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Spearman's of success and return, with its 95 % bootstrap interval over policies; 0 where they have no order."""
    pairs = pairs_of(rows)
    return {"value": spearman(pairs), "interval": bootstrap(pairs, spearman)}


def pairs_of(rows: Sequence[dict[str, Any]]) -> Array:
    """(policies, 2), success and return."""
    pairs = [[row[name]["value"] for name in ("success_rate", "episode_return")] for row in rows]
    return np.array(pairs).reshape(-1, 2)


def spearman(pairs: Array) -> float:
    """Spearman's correlation of two columns; 0 where they have no order."""
    known = len(pairs) > 2 and np.all(np.ptp(pairs, axis=0) > 0.0)
    return float(spearmanr(pairs[:, 0], pairs[:, 1]).statistic) if known else 0.0


def ranks(bench: Bench, args: Args, done: Callable[[], None]) -> dict[str, Any]:
    """The policies, and how their returns rank them."""
    variants, success = pool(bench, args.seed, done)
    families = [one.family for one in variants]
    reported, rows = start_seeds(args.starts, args.seed), []
    for k in evenly(np.array(success), families):
        won, returns = bench.drive([variants[k]], reported, np.random.default_rng([args.seed, k]))[:, 0]
        rows.append(
            {
                "family": families[k],
                "degree": float(f"{variants[k].degree:.4g}"),
                "success_rate": share(won),
                "episode_return": mean(returns),
            }
        )
        done()
    return {
        "policies": rows,
        "correlation": correlation(rows),
        "correlation_without": correlation([row for row in rows if row["family"] not in APART]),
    }


def search(bench: Bench, args: Args, done: Callable[[], None]) -> dict[str, Any]:
    """What a search on return loses against one on success."""
    reported, found = start_seeds(args.starts, args.seed), {}
    for score in ("success", "return"):
        found[score] = optimum.tune(
            bench.env_id,
            bench.keywords,
            bench.controller.name,
            start_seeds(TUNING_STARTS, args.seed, "tune"),
            start_seeds(SELECTION_STARTS, args.seed, "select"),
            restarts=SEARCHES,
            iterations=ITERATIONS,
            seed=args.seed,
            score=score,
            begin=bench.tuned,
            progress=lambda *_: done(),
        ).restarts
    sound = np.ones(len(bench.plant.observation_names))
    driven = {}
    for score, parameters in {
        "tuned": [bench.tuned],
        **{s: [one.parameters for one in found[s]] for s in found},
    }.items():
        values = [control.values_of(bench.controller, bench.plant, one) for one in parameters]
        variants = [Variant("", 0.0, value, sound) for value in values]
        driven[score] = np.concatenate(
            [bench.drive([one], reported, np.random.default_rng(0)) for one in variants], axis=1
        )
    lost = driven["success"][0] - driven["return"][0]
    return {
        **{
            score: {
                "success_rate": mean(one[0].mean(axis=0)),
                "episode_return": mean(one[1].mean(axis=0)),
                "success_rates": one[0].mean(axis=1).tolist(),
                **({"parameters": [candidate.parameters for candidate in found[score]]} if score in found else {}),
            }
            for score, one in driven.items()
        },
        "lost": {**mean(lost.mean(axis=0)), "range": [lost.mean(axis=1).min(), lost.mean(axis=1).max()]},
    }


def verdict(row: dict[str, Any]) -> str:
    """ "yes", or what the reward fails."""
    failed = []
    if len(row["policies"]) < LEAST_POLICIES:
        failed.append(f"{len(row['policies'])} policies")
    if not row["correlation"]["value"] >= LEAST_CORRELATION:
        failed.append("ranks")
    if row["search"]["lost"]["value"] > MOST_LOST:
        failed.append("search")
    return "no: " + ", ".join(failed) if failed else "yes"


def kept(path: Path, args: Args, keywords: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The rows of a file, by id, each with its revision; UserError if they are of other starts, seeds or keywords."""
    content: dict[str, Any] = read_json(path, mapping(anything))
    for name, asked in {"starts": args.starts, "seed": args.seed, "env_keywords": keywords}.items():
        if content.get(name) != asked:
            raise UserError(f"--older: {path} is of {name} {content.get(name)}, not {asked}")
    return {env_id: {"git": content["git"], **row} for env_id, row in content["environments"].items()}


def study(env_id: str, keywords: dict[str, Any], args: Args) -> dict[str, Any]:
    """Everything about one environment."""
    begin = time.perf_counter()
    bench = Bench(env_id, keywords, CONTROLLERS[env_id])
    with messages.progress() as bar:
        job = bar.add_task(env_id, total=4 + ROUNDS + POLICIES + 2 * SEARCHES * ITERATIONS)
        ranked = ranks(bench, args, lambda: bar.advance(job))
        row = {"controller": bench.controller.name, **ranked, "search": search(bench, args, lambda: bar.advance(job))}
    return {**row, "aligned": verdict(row), "seconds": round(time.perf_counter() - begin, 1)}


def table(rows: dict[str, dict[str, Any]]) -> Table:
    """For people."""
    shown = Table(box=box.SIMPLE_HEAD, title_justify="left", title="value [95 % interval]")
    columns = (
        "correlation",
        f"without\n{', '.join(APART)}",
        "search on\nsuccess [%]",
        "on return\n[%]",
        "lost\n[points]",
    )
    for name in ("environment", "policies", *columns, "aligned", "s"):
        shown.add_column(name, justify="left" if name in ("environment", "aligned") else "right")
    for env_id, row in rows.items():
        rates = [one["success_rate"]["value"] for one in row["policies"]]
        one = row["search"]
        shown.add_row(
            env_id,
            f"{len(rates)}, {100 * min(rates):.0f} to {100 * max(rates):.0f} %",
            *(cell(row[name], 1.0, ".3f") for name in ("correlation", "correlation_without")),
            *(cell(one[score]["success_rate"]) for score in ("success", "return")),
            cell(one["lost"]),
            row["aligned"],
            f"{row['seconds']:.0f}",
        )
    return shown


def cell(figure: dict[str, Any], factor: float = 100.0, form: str = ".1f") -> str:
    """A value, and below it its interval."""
    low, high = (factor * end for end in figure["interval"])
    return f"{factor * figure['value']:{form}}\n[{low:{form}}, {high:{form}}]"


def picture(rows: dict[str, dict[str, Any]], path: Path) -> None:
    """Return against success, a panel for each id."""
    height, width = -(-len(rows) // 3), min(3, len(rows))
    figure = plots.new_figure(
        max(4.2 * width, 7.5), 3.6 * height + 1.2, "Does a policy with a higher return save more starts?"
    )
    axes = figure.subplots(height, width, squeeze=False).ravel()
    less = ", ".join(repr(FAMILIES[family][2]) for family in APART)
    for axis, (env_id, row) in zip(axes, rows.items(), strict=False):
        for k, family in enumerate(FAMILIES):
            own = [one for one in row["policies"] if one["family"] == family]
            x, y = ([one[name]["value"] for one in own] for name in ("success_rate", "episode_return"))
            axis.plot(
                100 * np.array(x), y, "os^vDP"[k], color=line_style(k).color, label=FAMILIES[family][2], markersize=6
            )
        for score, marker in (("success", "*"), ("return", "x")):
            one = row["search"][score]
            axis.plot(
                100 * one["success_rate"]["value"], one["episode_return"]["value"], marker, color="black",
                markersize=11 if marker == "*" else 8, label=f"found by search on {score}",
            )  # fmt: skip
        value, without = (row[name]["value"] for name in ("correlation", "correlation_without"))
        dress(axis, xlabel="starts that succeed [%]", ylabel="mean return", xlim=(0, 102))
        words = f"{env_id}\nrank correlation {value:.3f}\n(without {less}: {without:.3f})"
        axis.set_title(words, fontsize="medium")
    for axis in axes[len(rows) :]:
        axis.set_axis_off()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, title="what was made worse")
    plots.save(figure, path)


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.alignment", description=__doc__)
    messages.check_least(args, starts=1, seed=0)
    messages.check_output("--json", args.json)
    if args.env_id and args.env_id not in CONTROLLERS:
        raise UserError(f"--env-id must be one of {', '.join(CONTROLLERS)}; got {args.env_id!r}")
    keywords = parse_keywords(args.env_keywords)
    if keywords and not args.env_id:
        raise UserError("--env-keywords needs --env-id: the ids do not share their keywords")
    if args.older and not (args.env_id and args.json):
        raise UserError("--older needs --env-id and --json: the file whose other ids stay")
    rows = kept(args.json, args, keywords) if args.older and args.json else {}
    origin = provenance.collect()
    for env_id in [args.env_id] if args.env_id else CONTROLLERS:
        rows[env_id] = {"git": origin["git"], **study(env_id, keywords, args)}
    rows = {env_id: rows[env_id] for env_id in CONTROLLERS if env_id in rows}
    console = console_for_tables()
    console.print(table(rows))
    if args.json is not None:
        write_json(
            args.json,
            {
                "command": f"python -m agents.alignment --starts {args.starts} --seed {args.seed}"
                + (f" --env-id {args.env_id}" if args.env_id else "")
                + (f" --env-keywords '{args.env_keywords}'" if keywords else "")
                + (" --older" if args.older else ""),
                **origin,
                "seconds": round(sum(row["seconds"] for row in rows.values()), 1),
                "seed": args.seed,
                "starts": args.starts,
                "env_keywords": keywords,
                "environments": rows,
            },
        )
        picture(rows, args.json.with_suffix(".png"))
        console.print(f"figures: {args.json}, picture: {args.json.with_suffix('.png').name}")


if __name__ == "__main__":
    messages.run(main)
