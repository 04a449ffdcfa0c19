"""Trained policies that come with the package: a folder for an id and a level, ``policies/BicycleStab-v0-medium``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bicycle_env.control.network import DESCRIPTION_FILE, Network, read
from bicycle_env.physics.validation import choice

PRETRAINED = "pretrained"
"""As a policy's name: the one for the environment's id and level."""
FOLDER = Path(__file__).parents[1] / "policies"
USUAL_LEVEL = "medium"


def place(env_id: str, level: str, folder: Path = FOLDER) -> Path:
    """Where the policy of an id and a level is, or would be."""
    return folder / f"{env_id}-{level}"


def published(folder: Path = FOLDER) -> dict[str, tuple[str, ...]]:
    """Ids to levels, of the policies that there are."""
    found: dict[str, tuple[str, ...]] = {}
    for path in sorted(folder.glob(f"*/{DESCRIPTION_FILE}")):
        env_id, _, level = path.parent.name.rpartition("-")
        found[env_id] = (*found.get(env_id, ()), level)
    return found


def load_policy(env_id: str, level: str | None = None) -> Network:
    """A trained policy that comes with the package; numpy suffices to act with it.

    Its ``description`` says how it was trained and how it does: ``description["score"]``. See docs/leaderboard.md.

    Args:
        env_id: "BicycleStab-v0" or another id of the package.
        level: "easy", "medium" or "hard"; None for the id without a level, which is "medium".

    Raises:
        ValueError, TypeError: an id or a level without a policy; the message names those that have one.
    """
    there = published()
    choice("env_id with a policy", env_id, there)
    level = choice(f"level of {env_id} with a policy", USUAL_LEVEL if level is None else level, there[env_id])
    return read(place(env_id, level))


def pretrained(plant: Any) -> Network:
    """The policy for an environment's id and level.

    Raises:
        ValueError: there is none, or it sees or steers something else than this environment shows or lets it.
    """
    if getattr(plant, "spec", None) is None:
        raise ValueError(f"policy {PRETRAINED!r} needs an environment that gym.make has made")
    network = load_policy(plant.spec.id, plant.level)
    network.check_fit(plant)
    return network
