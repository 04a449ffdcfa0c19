"""Collect episodes of a policy as a Minari dataset, for learning without an environment.

    python -m agents.collect --env-id BicycleStab-v0 --policy lqr --episodes 500
    python -m agents.collect --env-id BicycleActiveSteer-v0 --policy pretrained --noise 0.2
    python -m agents.collect --env-id BicycleEvade-v0 --policy search --episodes 50

"random" steers by chance; "search" drives what the search for steering finds for each start, which knows what is
hidden. The dataset holds the environment's spec, level and keywords included, so that minari's
recover_environment() gives the same one; the starts are those of no table and no tuning. Needs the extra [data].
"""

from __future__ import annotations

import importlib
import math
import os
import shlex
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray

import bicycle_env
from agents import messages, scores
from agents.episodes import start_seeds
from agents.evaluate import find_policy, make_env, parse_keywords
from agents.headroom_setting import CONTROLLERS
from agents.messages import UserError
from bicycle_env import control, optimum
from bicycle_env.files import shown
from bicycle_env.installation import needs

RANDOM, SEARCH = "random", "search"
EPISODES_OF_CHANCE = 100
"""Of "random", whose mean return is a dataset's lower reference."""


@dataclass
class Args:
    """Write a Minari dataset of a policy's episodes."""

    env_id: str = "BicycleStab-v0"
    """Environment id."""
    policy: Annotated[str, tyro.conf.arg(metavar="NAME|FOLDER|MODULE:NAME")] = "lqr"
    """As for agents.evaluate; or "random", or "search"."""
    env_keywords: str = "{}"
    """Keywords of the environment as JSON."""
    episodes: int = 100
    """How many."""
    noise: float = 0.0
    """Standard deviation of what is added to each action, of the full angle; not with "search"."""
    seed: int = 0
    """Seed of the starts, of the noise and of the search."""
    dataset_id: str | None = None
    """By default bicycle/ENVIRONMENT/POLICY-v0, with the level in the environment's name."""
    root: Path | None = None
    """Folder of the datasets; by default Minari's own (MINARI_DATASETS_PATH)."""


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.collect", description=__doc__)
    messages.check_least(args, episodes=1, seed=0)
    if not (math.isfinite(args.noise) and args.noise >= 0.0):
        raise UserError(f"--noise must be a finite number of at least 0, got {args.noise:g}")
    if args.noise and args.policy in (RANDOM, SEARCH):
        raise UserError(f"--noise is for policies that are driven, not for {args.policy!r}")
    messages.check_output("--root", args.root, folder=True)
    if args.root is not None:
        os.environ["MINARI_DATASETS_PATH"] = str(args.root)
    try:
        minari: Any = importlib.import_module("minari")
        buffer: Any = importlib.import_module("minari.data_collector.episode_buffer")
    except ModuleNotFoundError as error:
        raise UserError(needs("agents.collect", error.name or "minari", "data")) from None
    env = make_env(args.env_id, parse_keywords(args.env_keywords))
    name = args.dataset_id or default_name(env, args.policy)
    if name in minari.list_local_datasets():
        raise UserError(f"--dataset-id: there is a dataset {name!r} already; minari delete {name} removes it")
    try:
        minari.dataset.minari_dataset.parse_dataset_id(name)
    except ValueError as error:
        raise UserError(f"--dataset-id: {shown(error)}") from None
    seeds = start_seeds(args.episodes, args.seed, "collect")
    returns, episodes = [], []
    with messages.progress() as bar:
        job = bar.add_task(args.policy, total=args.episodes)
        actors = actors_of(args, env, seeds, lambda done: bar.update(job, completed=done))
        for k, (seed, act) in enumerate(zip(seeds, actors, strict=True)):
            episodes.append(buffer.EpisodeBuffer(id=k, seed=seed, **recorded(env, act, seed)))
            returns.append(sum(episodes[-1].rewards))
            bar.update(job, completed=k + 1)
    chance = np.random.default_rng([args.seed, 1])
    spec: Any = env.spec
    lowest = [sum(recorded(env, by_chance(env, chance), seed)["rewards"]) for seed in seeds[:EPISODES_OF_CHANCE]]
    found = scores.known(env)
    with warnings.catch_warnings():  # who made it and where the code is, is for whoever publishes it
        warnings.filterwarnings("ignore", "`(author|author_email|code_permalink)` is set to None")
        dataset = minari.create_dataset_from_buffers(
            name,
            episodes,
            env=importable(spec),
            eval_env=importable(spec),
            algorithm_name=args.policy + (f", noise {args.noise:g}" if args.noise else ""),
            ref_min_score=float(np.mean(lowest)),
            ref_max_score=found.best_return if found else float(np.max(returns)),
            description=shlex.join(["python", "-m", "agents.collect", *sys.argv[1:]]),
            requirements=[f"bicycle-env=={bicycle_env.__version__}"],
            observation_space=env.observation_space,
            action_space=env.action_space,
        )
    messages.console().print(
        f"{name}: {dataset.total_episodes} episodes, {dataset.total_steps} steps, mean return {np.mean(returns):.1f} "
        f"(by chance {np.mean(lowest):.1f})\nminari.load_dataset({name!r})",
        soft_wrap=True,
    )


def default_name(env: gym.Env, policy: str) -> str:
    """bicycle/stab-hard/lqr-v0."""
    plant: Any = env.unwrapped
    spec: Any = env.spec
    words = spec.name.removeprefix("Bicycle")
    kebab = "".join(f"-{letter.lower()}" if letter.isupper() else letter for letter in words).strip("-")
    label = "".join(letter if letter.isalnum() or letter in "-_" else "-" for letter in Path(policy).name)
    return f"bicycle/{kebab}-{plant.level}/{label}-v0"


def importable(spec: Any) -> Any:
    """A spec whose id names the module that registers it, so that it is known wherever it is read."""
    spec.id = spec.id if ":" in spec.id else f"bicycle_env:{spec.id}"
    return spec


Act = Callable[[NDArray[Any]], NDArray[np.float32]]


def by_chance(env: gym.Env, random: np.random.Generator) -> Act:
    shape: Any = env.action_space.shape
    return lambda _: random.uniform(-1.0, 1.0, shape).astype(np.float32)


def actors_of(args: Args, env: gym.Env, seeds: list[int], tell: Callable[[int], None]) -> Iterator[Act]:
    """One for each start."""
    random = np.random.default_rng([args.seed, 0])
    if args.policy == RANDOM:
        yield from (by_chance(env, random) for _ in seeds)
    elif args.policy == SEARCH:
        for one in searched(args, env, seeds, tell):
            rest = iter(one.actions)
            yield lambda _, rest=rest: next(rest)
    else:
        policy = find_policy(args.policy, env)
        for _ in seeds:
            policy.reset()
            yield noisy(policy, args.noise, random)


def noisy(policy: control.Policy, noise: float, random: np.random.Generator) -> Act:
    def act(observation: NDArray[Any]) -> NDArray[np.float32]:
        action = policy.act(observation)
        return np.clip(action + noise * random.standard_normal(action.shape), -1.0, 1.0).astype(np.float32)

    return act if noise else policy.act


def searched(args: Args, env: gym.Env, seeds: list[int], tell: Callable[[int], None]) -> list[optimum.Rescue]:
    """The best found, from the controller tuned for the level where there is one."""
    plant: Any = env.unwrapped
    spec: Any = env.spec
    name = CONTROLLERS.get(spec.id, ("lqr",))[-1]
    parameters = scores.tuned(spec.id, plant.scored_level, name)
    law = control.make(name, env) if parameters is None else control.make(name, plant, parameters=parameters)
    return optimum.search_steering(
        spec.id, parse_keywords(args.env_keywords), law, seeds, seed=args.seed, progress=tell
    )


def recorded(env: gym.Env, act: Act, seed: int) -> dict[str, list[Any]]:
    """An episode as Minari keeps it: one observation more than there are actions."""
    observation, _ = env.reset(seed=seed)
    episode: dict[str, list[Any]] = {
        "observations": [observation], "actions": [], "rewards": [], "terminations": [], "truncations": []
    }  # fmt: skip
    over = False
    while not over:
        action = act(observation)
        observation, reward, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
        values = observation, action, float(reward), terminated, truncated
        for column, value in zip(episode.values(), values, strict=True):
            column.append(value)
    return episode


if __name__ == "__main__":
    messages.run(main)
