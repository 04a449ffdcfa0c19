"""Trained policies as the commands take them: a folder, and the environment keywords that it was trained with."""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path
from typing import Any

import gymnasium as gym

from agents.messages import UserError
from agents.run_folder import Folder
from bicycle_env import control
from bicycle_env.envs.single.single_track_env import SingleTrackEnv, keyword_names
from bicycle_env.files import shown

WORD = re.compile(r"[A-Za-z0-9_]{1,40}")
LABELS = ("name", "source")  # of a vehicle: free text, which nothing reads
NOT_FROM_A_FILE = {"self", "telemetry", "render_mode", "task_keywords"}
OF_TRAINING = ("dtype", "threads", "staggered_start", "on_invalid", "telemetry")
"""Keywords of many cars at once, which say nothing about the one that is evaluated."""
LIMIT = "max_episode_steps"  # gym.make's own
ARCHIVE = ".zip"
"""Of Stable-Baselines3."""
TRAINERS = {"native-ppo": "ppo", "policy-search": "policy_search", "jax-ppo": "ppo_jax", "rllib-ppo": "train_rllib"}
"""Module of this package by the algorithm in a run's record; those of Stable-Baselines3 are agents.train's."""


def is_trained(name: str) -> bool:
    """Whether a --policy names a trained policy's folder, or something in its place, and no controller or weights."""
    other = name in (*control.NAMES, control.PRETRAINED) or name.endswith((".json", ARCHIVE))
    return not other and Path(name).exists()


def load(name: str) -> control.Network:
    """A trained policy, without its base; UserError in one line for whatever is wrong with its files."""
    try:
        return control.read(name)
    except (ValueError, OSError) as error:
        begun = (Path(name) / "checkpoint").is_dir() and not (Path(name) / "policy.json").is_file()
        raise UserError(f"{shown(error)}{_how_to_go_on(Path(name)) if begun else ''}") from None


def _how_to_go_on(folder: Path) -> str:
    """What is said of a run that was stopped: its best policy is in the checkpoint until it ends."""
    record = None
    with contextlib.suppress(ValueError, OSError):
        record = Folder(folder).record()
    algo = "" if record is None else record["algo"]
    module = TRAINERS.get(algo, f"train --algo {algo}" if algo else "train")
    return (
        f"; its training was stopped, and the best policy so far is written when it ends: python -m agents.{module} "
        "with the options it began with, and --resume"
    )


def driving(name: str, network: control.Network, env: gym.Env) -> control.Network | control.Residual:
    """The policy that drives an environment: with its base, if it has one; UserError unless it fits."""
    check_fit(name, network, env)
    try:
        return control.on_base(network, env, name)
    except ValueError as error:
        raise UserError(shown(error)) from None


def keywords_of(name: str, network: control.Network, environment: type[SingleTrackEnv]) -> dict[str, Any]:
    """The environment keywords in a policy's file, plain values only.

    A policy may come from a stranger, so its file can name an environment's keywords (not a window to open), with
    numbers, truth values, words and tables of these; never a file, a module or an id. The ranges are the environment's.

    Raises:
        UserError: it holds something else; the line says what, and that --env-keywords serves instead.
    """
    found: dict[str, Any] = network.description.get("env_keywords", {})
    found = {key: value for key, value in found.items() if key not in OF_TRAINING}
    allowed = {LIMIT, *keyword_names(environment)}
    try:
        for key, value in found.items():
            if key not in allowed - NOT_FROM_A_FILE:
                raise ValueError(f"{key!r} is no keyword that a policy's file may set")
            _check_plain(key, value)
    except ValueError as error:
        raise UserError(f"{shown(name)}: env_keywords: {shown(error)}; give --env-keywords") from None
    return found


def _check_plain(key: str, value: Any) -> None:
    if isinstance(value, dict):
        for inner, content in value.items():
            _check_plain(inner, content)
    elif isinstance(value, str) and key not in LABELS and not WORD.fullmatch(value):
        raise ValueError(f"{key} must be a word, not the name of a file or a module, got {value!r}")
    elif isinstance(value, list):
        raise ValueError(f"{key} must be a number, a word or a table, got a list")


def common_keywords(trained: dict[str, control.Network], environment: type[SingleTrackEnv]) -> dict[str, Any]:
    """The environment keywords of all these policies; UserError if they differ: then the user must choose."""
    each = {name: keywords_of(name, network, environment) for name, network in trained.items()}
    different = {json.dumps(keywords, sort_keys=True) for keywords in each.values()}
    if len(different) > 1:
        listed = "; ".join(f"{shown(name)}: {json.dumps(keywords)}" for name, keywords in each.items())
        raise UserError(f"the policies were trained with different keywords; choose with --env-keywords. {listed}")
    return next(iter(each.values()), {})


def check_fit(name: str, network: control.Network, env: gym.Env) -> None:
    """UserError unless observations and actions are the environment's; the line names the keywords of both."""
    try:
        network.check_fit(env.unwrapped)
    except ValueError as error:
        raise UserError(f"{shown(name)}: {error}") from None
