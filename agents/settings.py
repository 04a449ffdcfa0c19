"""Training settings: one TOML file per environment id under agents/configs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.messages import UserError, console
from bicycle_env.files import FileError, anything, listed, mapping, number_in, one_of, read_toml, table, whole_in
from bicycle_env.physics.validation import flag

CONFIGS = Path(__file__).parent / "configs"
DEFAULT = "BicycleStab-v0"
ALGORITHMS = ("ppo", "sac", "td3")
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
NETWORK = table(
    {"activation": one_of(ACTIVATIONS)},
    {
        "net_arch": listed(whole_in(1, 4096), most=16),
        "log_std_init": number_in(-20.0, 2.0),
        "ortho_init": flag,
        "n_critics": whole_in(1, 16),
    },
)


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
