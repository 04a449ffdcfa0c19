"""Training settings: one TOML file per environment id under agents/configs."""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.messages import UserError, console
from bicycle_env.files import (
    FileError,
    anything,
    listed,
    mapping,
    number_in,
    one_of,
    parse_json,
    read_toml,
    shown,
    table,
    text,
    whole_in,
    write_bytes,
)
from bicycle_env.physics.validation import flag

CONFIGS = Path(__file__).parent / "configs"
DEFAULT = "BicycleStab-v0"
ALGORITHMS = ("ppo", "sac", "td3")
RLLIB = "rllib-ppo"
ACTIVATIONS = ("tanh", "relu")

SHARE, COUNT = number_in(0.0, 1.0), whole_in(1, 10**8)
EVERY_MODEL = {
    "learning_rate": SHARE,
    "learning_rate_decay": flag,
    "gamma": SHARE,
    "batch_size": COUNT,
    "stats_window_size": whole_in(1, 10_000),
    "use_sde": flag,
    "sde_sample_freq": whole_in(-1, 10**8),
}
ON_POLICY = {
    **EVERY_MODEL,
    "n_steps": COUNT,
    "n_epochs": whole_in(1, 10_000),
    "gae_lambda": SHARE,
    "ent_coef": number_in(0.0, 1e6),
    "vf_coef": number_in(0.0, 1e6),
    "max_grad_norm": number_in(0.0, 1e9),
    "clip_range": number_in(1e-9, 1e6),
    "clip_range_vf": number_in(1e-9, 1e6),
    "target_kl": number_in(0.0, 1e6),
    "normalize_advantage": flag,
}
OFF_POLICY = {
    **EVERY_MODEL,
    "buffer_size": COUNT,
    "tau": SHARE,
    "learning_starts": whole_in(0, 10**12),
    "train_freq": COUNT,
    "gradient_steps": whole_in(-1, 10**6),
    "action_noise": number_in(0.0, 10.0),
}
MODELS = {
    "ppo": ON_POLICY,
    "sac": {
        **OFF_POLICY,
        "ent_coef": number_in(0.0, 1e6),
        "target_entropy": number_in(-1e6, 1e6),
        "target_update_interval": COUNT,
        "use_sde_at_warmup": flag,
    },
    "td3": {
        **{name: check for name, check in OFF_POLICY.items() if "sde" not in name},
        "policy_delay": COUNT,
        "target_policy_noise": number_in(0.0, 10.0),
        "target_noise_clip": number_in(0.0, 10.0),
    },
}
PPO = {
    "total_timesteps": whole_in(1, 10**12),
    "cars": whole_in(2, 10**5),
    "decisions": whole_in(1, 10**5),
    "hold": whole_in(1, 1000),
    "epochs": whole_in(1, 10_000),
    "learning_rate": SHARE,
    "gamma": listed(SHARE, 2, 2),
    "gae_lambda": SHARE,
    "clip": number_in(1e-9, 1e6),
    "entropy": number_in(0.0, 1e6),
    "reward_scale": number_in(1e-9, 1e9),
    "width": whole_in(1, 4096),
    "deviation": number_in(1e-6, 1e3),
    "mirrored": flag,
}
OWN = {
    "native-ppo": {
        **PPO,
        "history": whole_in(1, 1000),
        "minibatch": COUNT,
        "informed_critic": flag,
        "end_forfeited": flag,
        "success_bonus": number_in(0.0, 1e6),
        "speeds": listed(number_in(0.1, 1000.0), 0, 2),
        "imitate": text(200),
        "residual": text(200),
        "plan": whole_in(0, 10**5),
        "noise_hold": whole_in(1, 1000),
        "critic_alone": whole_in(0, 10**6),
    },
    "jax-ppo": {**PPO, "minibatches": whole_in(1, 10**5)},
    "policy-search": {
        "total_timesteps": whole_in(1, 10**12),
        "pairs": whole_in(1, 10**5),
        "starts": whole_in(1, 10**5),
        "hold": whole_in(1, 1000),
        "history": whole_in(1, 1000),
        "width": whole_in(1, 4096),
        "deviation": number_in(1e-9, 1e3),
        "learning_rate": SHARE,
        "mirrored": flag,
    },
}
"""Settings of this package's own trainers: options of their command lines."""
NETWORK = table(
    {"activation": one_of(ACTIVATIONS)},
    {
        "net_arch": listed(whole_in(1, 4096), most=16),
        "log_std_init": number_in(-20.0, 2.0),
        "ortho_init": flag,
        "n_critics": whole_in(1, 16),
    },
)


def check_seed(seed: int) -> None:
    """UserError for a seed that no training takes."""
    if not 0 <= seed < 2**32:
        raise UserError(f"--seed must be at least 0 and less than 2^32, got {seed}")


def own(args: Any, algo: str) -> dict[str, Any]:
    """The settings among the options of one of this package's trainers; UserError for a value out of its range.

    The seed is checked, too.
    """
    check_seed(args.seed)
    found: dict[str, Any] = {}
    for name, check in OWN[algo].items():
        value = getattr(args, name)
        try:
            found[name] = check(f"--{name.replace('_', '-')}", list(value) if isinstance(value, tuple) else value)
        except (TypeError, ValueError) as error:
            raise UserError(str(error)) from None
    return found


def usual(options: type[Any], algo: str, words: Sequence[str] | None = None) -> Any:
    """A trainer's options with the settings that are shipped for the id, and the level, on its command line.

    Of the file's table, ``[ALGO.hard]`` says what is other at the level "hard". An id without a file has the options'
    own defaults.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--env-id", "--env_id", default=DEFAULT)
    parser.add_argument("--env-keywords", "--env_keywords", default="{}")
    known, _ = parser.parse_known_args(None if words is None else list(words))
    path = CONFIGS / f"{known.env_id}.toml"
    if not path.is_file():
        return options()
    found = read_toml(path, mapping(anything)).get(algo, {})
    levels = {name: found.pop(name) for name in list(found) if isinstance(found[name], dict)}
    with contextlib.suppress(ValueError, TypeError):  # what is wrong with the keywords is said later
        found |= levels.get(parse_json(known.env_keywords, "--env-keywords", mapping(anything)).get("level"), {})
    checked = table({}, OWN[algo])(str(path), found)
    return options(**{name: tuple(value) if isinstance(value, list) else value for name, value in checked.items()})


@dataclass(frozen=True)
class Settings:
    """What a run needs beside the environment: the table of one algorithm."""

    total_timesteps: int
    n_envs: int
    model: dict[str, Any]
    network: dict[str, Any]


def checked(name: str, content: Any, algo: str) -> Settings:
    """Settings of an algorithm from the table of a file, with plain values in documented ranges only.

    Raises:
        ValueError, TypeError: the key is named.
    """
    check = table(
        {
            "total_timesteps": whole_in(1, 10**12),
            "n_envs": whole_in(1, 10**5),
            "model": table({"learning_rate": SHARE}, MODELS[algo]),
            "network": NETWORK,
        }
    )
    return Settings(**check(name, content))


def read(env_id: str, algo: str, config: Path | None = None) -> Settings:
    """The settings of one algorithm, from `config` or from the file shipped for the id; UserError if there are none.

    An id for which no file is shipped, a task of one's own, has those of ``DEFAULT``.
    """
    path = config or CONFIGS / f"{env_id}.toml"
    if config is None and not path.is_file():
        console(stderr=True).print(f"no settings are shipped for {env_id}: those of {DEFAULT} serve; or give --config")
        path = CONFIGS / f"{DEFAULT}.toml"
    if not path.is_file():
        raise UserError(f"no settings file {path}")
    try:
        tables = read_toml(path, mapping(anything))
        if algo not in tables:
            raise UserError(f"{path} has no table {algo!r}")
        return checked(algo, tables[algo], algo)
    except FileError as error:
        raise UserError(f"not a settings file: {error}") from None
    except (TypeError, ValueError) as error:
        raise UserError(f"{path}: {error}") from None


def write(path: Path, algo: str, chosen: Settings, remark: str) -> None:
    """A settings file of one algorithm, with a remark at its top: what :func:`read` takes as `config`."""
    tables = {
        algo: {"total_timesteps": chosen.total_timesteps, "n_envs": chosen.n_envs},
        f"{algo}.model": chosen.model,
        f"{algo}.network": chosen.network,
    }
    lines = [f"# {shown(remark, 1000)}"]
    for name, content in tables.items():
        # JSON's numbers, truth values, words and lists are TOML's, too.
        lines += ["", f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in content.items())]
    write_bytes(path, ("\n".join(lines) + "\n").encode())
