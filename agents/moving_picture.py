"""A moving picture: several policies from the same start, one above the other, each in the environment's own top view.

    python -m agents.moving_picture --env-id BicycleActiveSteer-v0 --policy zero rear-switched pretrained --out run.gif

Which start is shown is a rule, not a choice: the first of the reporting starts that the last policy saves and on which
the one before it ends early (spins, leaves the lane); without one, the first that it fails; without one, the first. The
line above each car says how many of these starts its driver saves.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray

from agents import messages
from agents.episodes import start_seeds
from agents.evaluate import find_policy, make_env, parse_keywords
from agents.messages import UserError
from bicycle_env import optimum
from bicycle_env.control import Policy
from bicycle_env.files import write_bytes
from bicycle_env.optimum import Outcomes

EVERY = 4
"""Control steps from one frame to the next."""
TOP_VIEW = 308
"""Rows of the environment's picture above its instruments."""
SHARE = 0.62
"""Of the size of the environment's picture."""
COLORS = 64
LABEL = 20
"""Rows of a policy's line."""
LINGER = 1500
"""ms that the last frame stays."""
SAVED = "saved"
DARK, LIGHT, RED = (22, 23, 26), (235, 235, 235), (240, 120, 60)


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


def frames_of(env: gym.Env, policy: Policy, seed: int) -> tuple[list[NDArray[np.uint8]], str]:
    """Every so many steps the top view, and how the episode ended: the reason, `SAVED`, or what was missed."""
    plant: Any = env.unwrapped
    observation, _ = env.reset(seed=seed)
    policy.reset()
    frames, over, step = [], False, 0
    while not over:
        if step % EVERY == 0:
            frames.append(np.asarray(env.render())[:TOP_VIEW])
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        over, step = terminated or truncated, step + 1
    frames.append(np.asarray(env.render())[:TOP_VIEW])
    missed = [name.replace("_", " ") for name in plant.task.forfeits if getattr(plant.state, name) > 0.5]
    failed = ", ".join(["failed", *missed])
    words = plant.end.replace("_", " ") if terminated else SAVED if plant.is_success else failed
    return frames, words


def write(runs: Mapping[str, tuple[list[NDArray[np.uint8]], str]], caption: str, path: Path) -> None:
    """The runs below each other, as long as the longest; one that has ended stands still."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(size=13)
    count = max(len(frames) for frames, _ in runs.values())
    height, width = (round(SHARE * side) for side in next(iter(runs.values()))[0][0].shape[:2])
    pages = []
    for k in range(count):
        page = Image.new("RGB", (width, len(runs) * (height + LABEL) + LABEL), DARK)
        draw = ImageDraw.Draw(page)
        for row, (name, (frames, end)) in enumerate(runs.items()):
            top, over = row * (height + LABEL), k >= len(frames) - 1
            draw.text((6, top + 2), f"{name}: {end}" if over else name, RED if over and end != SAVED else LIGHT, font)
            picture = Image.fromarray(frames[min(k, len(frames) - 1)])
            page.paste(picture.resize((width, height), Image.Resampling.LANCZOS), (0, top + LABEL))
        draw.text((6, len(runs) * (height + LABEL) + 2), caption, LIGHT, font)
        pages.append(page.quantize(COLORS, dither=Image.Dither.NONE))
    content = io.BytesIO()
    durations = [20 * EVERY] * (count - 1) + [LINGER]
    pages[0].save(content, "GIF", save_all=True, append_images=pages[1:], duration=durations, loop=0, optimize=True)
    write_bytes(path, content.getvalue())


def show(
    env_id: str, keywords: Mapping[str, Any], policies: Mapping[str, Policy], starts: Sequence[int], path: Path
) -> str:
    """Write the picture of policies, by the names that stand above them; gives what is written there."""
    cars = optimum.Cars(env_id, keywords)
    driven = [optimum.drive(cars.of(len(starts)), optimum.by(policy), list(starts)) for policy in policies.values()]
    place = chosen(driven)
    count = len(starts)
    headings = [
        f"{name} - saves {100.0 * one.success.mean():.0f} % of {count}"
        for name, one in zip(policies, driven, strict=True)
    ]
    env = gym.make(env_id, render_mode="rgb_array", **keywords)
    runs = [frames_of(env, policy, starts[place]) for policy in policies.values()]
    write(dict(zip(headings, runs, strict=True)), f"the same start for all, the {place + 1}th of {count}", path)
    env.close()
    return "\n".join([f"start {place + 1} of {count}", *headings])


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.moving_picture", description=__doc__)
    messages.check_least(args, starts=1, seed=0)
    messages.check_output("--out", args.out)
    if not args.policy:
        raise UserError("--policy must name at least one policy")
    keywords = parse_keywords(args.env_keywords)
    env = make_env(args.env_id, keywords)
    policies = {name: find_policy(name, env) for name in args.policy}
    caption = show(args.env_id, keywords, policies, start_seeds(args.starts, args.seed), args.out)
    messages.console().print(f"{caption}\nwritten: {args.out}")


if __name__ == "__main__":
    messages.run(main)
