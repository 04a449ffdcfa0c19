"""A moving picture: several policies from the same start, one above the other, each in the environment's own top view.

    python -m agents.moving_picture --env-id BicycleActiveSteer-v0 --policy zero rear-switched pretrained --out run.gif

Which start is shown is a rule, not a choice: the first of the reporting starts that the last policy saves and on which
the one before it ends early (spins, leaves the lane); without one, the first that it fails; without one, the first. The
line above each car says how many of these starts its driver saves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import tyro

from agents import messages
from agents.episodes import start_seeds
from agents.evaluate import make_env, named, parse_keywords
from bicycle_env import optimum, play
from bicycle_env.control import Policy
from bicycle_env.optimum import Outcomes
from bicycle_env.rendering import moving


@dataclass
class Args:
    """Write a GIF of policies from the same start, stacked."""

    env_id: str = "BicycleActiveSteer-v0"
    """Environment id."""
    policy: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME|FOLDER [...]")] = (
        "zero",
        "rear-switched",
        "pretrained",
    )
    """As for agents.evaluate; the last two decide which start is shown."""
    env_keywords: str = "{}"
    """Keywords of the environment as JSON."""
    starts: int = 2000
    """Reporting starts that are driven to choose one, and of which the lines tell."""
    seed: int = 1
    """Seed of these starts."""
    out: Path = Path("runs/moving_picture.gif")
    """Where the picture goes."""


def chosen(driven: Sequence[Outcomes]) -> int:
    """Which start is shown, by its place."""
    if len(driven) < 2:
        return 0
    saved, before = driven[-1].success, driven[-2]
    for lost in (~before.on_road, ~before.success):
        found = np.flatnonzero(saved & lost)
        if len(found):
            return int(found[0])
    return 0


def show(
    env_id: str, keywords: Mapping[str, Any], policies: Mapping[str, Policy], starts: Sequence[int], path: Path
) -> str:
    """Write the picture of policies, by the names that stand above them; gives what is written there."""
    cars = optimum.Cars(env_id, keywords)
    driven = [optimum.drive(cars.of(len(starts)), optimum.by(policy), list(starts)) for policy in policies.values()]
    place = chosen(driven)
    count = len(starts)
    headings = [
        f"{name} - saves {100.0 * one.success.mean():.0f} % of {count}, keeps {100.0 * one.on_road.mean():.1f} % on "
        "the road"
        for name, one in zip(policies, driven, strict=True)
    ]
    envs = [gym.make(env_id, render_mode="rgb_array", **keywords) for _ in policies]
    drives = [play.Drive(*each) for each in zip(headings, envs, policies.values(), strict=True)]
    film = moving.GIF(path, drives[0].plant.action_timestep)
    caption = (f"the same start for all: {place + 1} of {count}",)

    def keep(step: int, over: bool) -> bool:
        if over or step % film.every == 0:
            film.add(moving.stacked(play.panels_of(drives), caption, film.shares[1]), over)
        return True

    play.together(drives, starts[place], keep)
    film.close()
    for env in envs:
        env.close()
    return "\n".join([f"start {place + 1} of {count}", *headings])


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.moving_picture", description=__doc__)
    messages.check_least(args, starts=1, seed=0)
    messages.check_output("--out", args.out)
    keywords = parse_keywords(args.env_keywords)
    env = make_env(args.env_id, keywords)
    policies = named(args.policy, env)
    caption = show(args.env_id, keywords, policies, start_seeds(args.starts, args.seed), args.out)
    messages.console().print(f"{caption}\nwritten: {args.out}")


if __name__ == "__main__":
    messages.run(main)
