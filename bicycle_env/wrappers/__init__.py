"""Wrappers and adapters, one per file."""

from typing import TYPE_CHECKING, Any

from bicycle_env.installation import needs
from bicycle_env.wrappers.front_driver import FrontDriver
from bicycle_env.wrappers.record_success import RecordSuccess

if TYPE_CHECKING:
    from bicycle_env.wrappers.sb3_vec_env import SB3VecEnv

__all__ = ["FrontDriver", "RecordSuccess", "SB3VecEnv"]


def __getattr__(name: str) -> Any:
    if name == "SB3VecEnv":  # imported when first needed, with Stable-Baselines3 and torch
        try:
            from bicycle_env.wrappers.sb3_vec_env import SB3VecEnv
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(needs("SB3VecEnv", "Stable-Baselines3", "agents"), name=error.name) from error
        return SB3VecEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
