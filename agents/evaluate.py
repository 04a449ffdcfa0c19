"""Evaluate policies on the same starts and print one table.

python -m agents.evaluate --env-id BicycleStab-v0 --policy lqr zero runs/stab-ppo --episodes 200
"""

from __future__ import annotations

import dataclasses
import json
import textwrap
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import tyro
from gymnasium.envs.registration import load_env_creator
from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

import bicycle_env  # noqa: F401  (registers the environments)
from agents import messages, scores, trained
from agents.episodes import evaluate, summarise
from agents.messages import UserError
from bicycle_env import Vehicle, control, provenance, tires
from bicycle_env.envs.registered_fleet import registered_spec
from bicycle_env.envs.single.single_track_env import SingleTrackEnv
from bicycle_env.files import anything, mapping, parse_json, shown, write_json
from bicycle_env.physics.presets import resolve_tired
from bicycle_env.tasks.task import Task


@dataclass
class Args:
    """Drive policies through the same episodes and print a table: means with 95 % intervals."""

    env_id: str = "BicycleStab-v0"
    """Environment id."""
    policy: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME|FOLDER|FILE.json|MODULE:NAME|FILE.zip [...]")] = (
        "lqr",
        "zero",
    )
    """Controllers by name, listed above, with their usual parameters; folders with policy.safetensors and policy.json,
    as train writes them; .json files of a controller's parameters, as tune writes them; a class or function in a module
    of your own; with --trust-pickle .zip files of Stable-Baselines3, and the .pkl of a VecNormalize beside them."""
    episodes: int = 100
    """Episodes per policy."""
    seed: int = 1
    """Seed of the starts; all policies drive from the same ones."""
    env_keywords: str | None = None
    """Keywords of the environment as JSON, for example '{"speed_ratio": 1.3, "steer": "rear"}'. By default those that
    the trained policies among --policy were trained with, if all agree; they serve the controllers too."""
    trust_pickle: bool = False
    """Open .zip files of Stable-Baselines3, which run whatever code is in them."""
    json: Path | None = None
    """Also write the figures to this file."""


DEGREES = 57.29577951308232
CLASSICAL = "classical"
"""As a policy's name: the level's best classical controller, with the parameters that agents.headroom found."""
Column = tuple[str, str, float, str]
COLUMNS: tuple[Column, ...] = (
    ("success_rate", "success\n[%]", 100.0, ".1f"),
    ("on_road_rate", "on the\nroad [%]", 100.0, ".1f"),
    ("episode_return", "mean\nreturn", 1.0, ".1f"),
)
"""Of every task: (key, heading, factor to the shown unit, format)."""


def columns_of(task: Task) -> tuple[Column, ...]:
    """The columns of a table: those of every task, then the task's own figures."""
    more = []
    for metric in task.metrics:
        if metric.in_tables:
            unit, factor = ("deg", DEGREES) if metric.unit == "rad" else (metric.unit, 1.0)
            name = metric.name.replace("_", " ")
            heading = "\n".join(textwrap.wrap(f"{name} [{unit}]" if unit else name, 12))
            more.append((metric.name, heading, factor, ".2f"))
    return (*COLUMNS, *more)


def make_env(env_id: str, keywords: dict[str, Any]) -> gym.Env:
    """gym.make with a user's mistakes turned into one line."""
    return _made(env_id, lambda: gym.make(env_id, **keywords))


def make_vector_env(
    env_id: str, number: int, keywords: dict[str, Any], autoreset_mode: str = "SameStep"
) -> gym.vector.VectorEnv:
    """gym.make_vec, by default as Stable-Baselines3 wants it, with a user's mistakes turned into one line."""
    for name in ("id", "num_envs", "autoreset_mode", "vectorization_mode", "render_mode"):
        if name in keywords:
            raise UserError(f"--env-keywords: {name} is chosen by the training itself")
    return _made(env_id, lambda: gym.make_vec(env_id, number, autoreset_mode=autoreset_mode, **keywords))


def environment(env_id: str) -> type[SingleTrackEnv]:
    """The class behind an id; UserError unless the id is known and the class one of this package's kind."""
    ids = ", ".join(sorted(name for name in gym.registry if name.startswith("Bicycle")))
    try:
        entry: Any = registered_spec(env_id).entry_point
        found = load_env_creator(entry) if isinstance(entry, str) else entry
    except (gym.error.Error, ImportError, AttributeError, ValueError) as error:
        raise UserError(f"{shown(error).rstrip('.')}. Ids of this package: {ids}") from None
    if not (isinstance(found, type) and issubclass(found, SingleTrackEnv)):
        raise UserError(f"--env-id must be an environment of this package, {ids}; got {env_id!r}")
    return found


def _made(env_id: str, make: Callable[[], Any]) -> Any:
    environment(env_id)
    try:
        made = make()
    except gym.error.Error as error:
        raise UserError(shown(error)) from None
    except (TypeError, ValueError, OSError) as error:
        text = str(error).partition(" was raised from the environment creator for ")[0]  # Gymnasium's own words
        raise UserError(f"{env_id}: {shown(text)}") from None
    many = isinstance(made, gym.vector.VectorEnv)
    if (made.unwrapped if many else made.spec).max_episode_steps is None:
        raise UserError(f"{env_id}: max_episode_steps must be at least 1: an episode here must come to an end")
    return made


def parse_keywords(text: str) -> dict[str, Any]:
    """Environment keywords from JSON text.

    A car's or a tire's file is replaced by what is in it: what is written down about a run must not depend on a file of
    today.
    """
    try:
        keywords: dict[str, Any] = parse_json(text, "--env-keywords", mapping(anything))
    except ValueError as error:
        raise UserError(f"{error}; it must be a JSON object, got {shown(repr(text))}") from None
    vehicle, tire, name = keywords.get("vehicle"), keywords.get("tire"), "vehicle"
    try:
        if isinstance(vehicle, str) and Path(vehicle).suffix.lower() in (".json", ".toml", ".yaml", ".yml"):
            keywords["vehicle"] = dataclasses.asdict(Vehicle.read(vehicle))
        if tires.is_tire_file(tire):
            name = "tire"
            if vehicle is None:
                raise ValueError("a property file sets a car's cornering stiffnesses: give the vehicle, too")
            car, law = resolve_tired(keywords["vehicle"], tire)
            keywords |= {"vehicle": dataclasses.asdict(car), "tire": dataclasses.asdict(law)}
    except (TypeError, ValueError, OSError) as error:
        raise UserError(f"--env-keywords: {name}: {shown(error)}") from None
    return keywords


def named(names: Sequence[str], env: gym.Env, trust_pickle: bool = False) -> dict[str, control.Policy]:
    """Policies by the names that tables give them: "classical" by which it is; UserError as of :func:`find_policy`."""
    if not names or "" in names:
        raise UserError("--policy must name at least one policy, and no name may be empty")
    return {classical_of(env)[0] if name == CLASSICAL else name: find_policy(name, env, trust_pickle) for name in names}


def classical_of(env: gym.Env) -> tuple[str, dict[str, Any]]:
    """The best classical controller tuned for an environment's level: its name in tables, and its row there."""
    plant: Any = env.unwrapped
    part = None if plant.scored_level is None else scores.part_of(plant.spec.id, plant.scored_level)
    if part is None:
        raise UserError(f"--policy {CLASSICAL}: {scores.FILE} knows no controller tuned for this environment")
    driver = part["classical"]["driver"]
    return driver, part["drivers"][driver]


def find_policy(name: str, env: gym.Env, trust_pickle: bool = False) -> control.Policy:
    """A policy as ``--policy`` names it; UserError for one that does not fit the environment.

    A controller, "classical" or "pretrained", a class or function of one's own, a trained policy's folder, a file of a
    controller's parameters; with `trust_pickle` also an archive of Stable-Baselines3.
    """
    if name == CLASSICAL:
        _, row = classical_of(env)
        return control.make(row["controller"], env, parameters=row["parameters"])
    if name.endswith(trained.ARCHIVE):
        if not trust_pickle:
            raise UserError(
                f"{shown(name)}: an archive of Stable-Baselines3 can hold code, which runs when it is read; if you "
                "trust whoever made it, python -m agents.evaluate --trust-pickle opens it"
            )
        from agents.archive import Archived

        return Archived(Path(name), env)
    if name.endswith(".json"):
        try:
            return control.from_file(name, env)
        except (TypeError, ValueError, np.linalg.LinAlgError) as error:
            raise UserError(shown(error)) from None
    if not trained.is_trained(name):
        try:
            found = control.make(name, env)
        except ValueError as error:
            known = name in (*control.NAMES, control.PRETRAINED) or ":" in name
            missing = "" if known else f" There is no folder {name!r} of a trained policy either."
            raise UserError(f"{error}{missing}") from None
        if ":" in name:
            _check_action(name, found, env)
        return found
    return trained.driving(name, trained.load(name), env)


def _check_action(name: str, policy: control.Policy, env: gym.Env) -> None:
    """UserError unless what a stranger wrote gives an action of the right shape; what it raises is its own."""
    observation, _ = env.reset(seed=0)
    policy.reset()
    shape, wanted = np.shape(policy.act(observation)), env.action_space.shape
    policy.reset()
    if shape != wanted:
        raise UserError(f"{shown(name)}: an action must have shape {wanted}, got {shape}")


def list_of_controllers() -> str:
    """The names that a command takes as a policy, with a line about each, for its --help."""
    rows = {
        **control.descriptions(),
        "DRIVER": f"{' or '.join(control.DRIVERS)}, for example preview+sano",
        CLASSICAL: "The best of them for the id and level, tuned for it: what agents.headroom found.",
        control.PRETRAINED: "The trained policy that comes with the package for the id and level.",
    }
    width = max(map(len, rows))
    return "\n".join(["Controllers by name:", *(f"  {name:{width}}  {text}" for name, text in rows.items())])


def print_table(console: Console, title: str, rows: dict[str, dict[str, Any]], task: Task) -> None:
    """The table; in a terminal that is too narrow for it only what every task has, and a line about the rest."""
    whole = table(title, rows, task)
    width = Measurement.get(console, console.options.update(max_width=1000), whole).maximum
    if not console.is_terminal:
        console.width = max(width, console.width)
    if width <= console.width:
        console.print(whole)
    else:
        console.print(table(title, rows, task, COLUMNS))
        more = ", ".join(column[0].replace("_", " ") for column in columns_of(task)[len(COLUMNS) :])
        console.print(f"in a terminal of {width} columns, or with --json FILE, also: {more}")


def table(title: str, rows: dict[str, dict[str, Any]], task: Task, columns: Sequence[Column] = ()) -> Table:
    """Rows of figures with intervals as a table for people: each cell the value, and below it the interval."""
    shown = [column for column in columns or columns_of(task) if any(column[0] in row for row in rows.values())]
    result = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left")
    result.add_column("policy", no_wrap=True)
    for _, heading, _, _ in shown:
        result.add_column(Text(heading), justify="right", no_wrap=True)  # Text: "[deg]" is no markup
    for name, row in rows.items():
        cells = []
        for key, _, factor, form in shown:
            if key in row:
                value, (low, high) = row[key]["value"], row[key]["interval"]
                cells.append(Text(f"{value * factor:{form}}\n[{low * factor:{form}}, {high * factor:{form}}]"))
            else:
                cells.append(Text("-"))
        result.add_row(name, *cells)
    return result


def console_for_tables() -> Console:
    """Standard output; wide enough for the tables where it is no terminal."""
    console = messages.console()
    return console if console.is_terminal else messages.console(width=150)


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.evaluate", description=f"{__doc__}\n{list_of_controllers()}")
    messages.check_least(args, episodes=1, seed=0)
    messages.check_output("--json", args.json)
    made_by = environment(args.env_id)
    networks = {name: trained.load(name) for name in args.policy if trained.is_trained(name)}
    if args.env_keywords is None:
        chosen = trained.common_keywords(networks, made_by)
    else:
        chosen = parse_keywords(args.env_keywords)
    keywords = {**chosen, "telemetry": True}
    env = make_env(args.env_id, keywords)
    policies = named(args.policy, env, args.trust_pickle)
    console = console_for_tables()
    for name in policies:
        if name.endswith(trained.ARCHIVE):
            console.print(f"note: {shown(name)} was opened: whatever code is in it has run with your rights")
    if args.env_keywords is None and chosen:
        console.print(f"environment keywords, as in training: {json.dumps(chosen)}")
    for name, network in networks.items():
        before = network.description.get("env_keywords", {})
        if before != chosen:
            console.print(f"note: {name} was trained with the environment keywords {shown(json.dumps(before))}")
    plant: Any = env.unwrapped
    if control.PRETRAINED in policies and plant.scored_level is None:
        console.print(
            f"note: {control.PRETRAINED} was trained for the level {plant.level}, and this is another environment"
        )
    rows, seconds = {}, {}
    with messages.progress() as bar:
        for name, policy in policies.items():
            job = bar.add_task(name, total=args.episodes)
            start = time.perf_counter()
            rows[name] = summarise(
                evaluate(env, policy, args.episodes, args.seed, lambda done, job=job: bar.update(job, completed=done))
            )
            seconds[name] = round(time.perf_counter() - start, 2)
    title = f"{args.env_id}: {args.episodes} episodes, the same starts for all; mean [95 % interval]"
    print_table(console, title, rows, plant.task)
    found = scores.known(env)
    for line in [] if found is None else scores.sentences(found, rows):
        console.print(line)
    if args.json is not None:
        write_json(
            args.json,
            {
                "command": f"python -m agents.evaluate --env-id {args.env_id} --policy {' '.join(args.policy)} "
                f"--episodes {args.episodes} --seed {args.seed}"
                + (f" --env-keywords '{args.env_keywords}'" if args.env_keywords is not None else "")
                + (" --trust-pickle" if args.trust_pickle else ""),
                **provenance.collect(),
                "env_id": args.env_id,
                "env_keywords": keywords,
                "seed": args.seed,
                "seconds": seconds,
                "policies": rows,
                **({} if found is None else {"scores": scores.scored(found, rows)}),
            },
        )
        console.print(f"figures: {args.json}")


if __name__ == "__main__":
    messages.run(main)
