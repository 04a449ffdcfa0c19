"""Training settings: one TOML file per environment id under agents/configs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.messages import UserError
from bicycle_env.files import read_toml

CONFIGS = Path(__file__).parent / "configs"
ALGORITHMS = ("ppo", "sac", "td3")


@dataclass(frozen=True)
class Settings:
    """What a run needs beside the environment: the table of one algorithm."""

    total_timesteps: int
    n_envs: int
    model: dict[str, Any]
    network: dict[str, Any]


def read(env_id: str, algo: str, config: Path | None = None) -> Settings:
    """The settings of one algorithm, from `config` or from the file shipped for the id; UserError if there are none."""
    path = config or CONFIGS / f"{env_id}.toml"
    if not path.is_file():
        shipped = ", ".join(sorted(file.stem for file in CONFIGS.glob("*.toml")))
        raise UserError(f"no settings file {path}; settings are shipped for: {shipped}")
    try:
        table = read_toml(path)[algo]
        return Settings(int(table["total_timesteps"]), int(table["n_envs"]), table["model"], table["network"])
    except KeyError as error:
        raise UserError(f"{path} has no {error} for {algo}") from None
    except (TypeError, ValueError) as error:
        raise UserError(f"{path} is not a settings file: {error}") from None
