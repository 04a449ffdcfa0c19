"""Cars that learn side by side at speeds of their own, from one to another evenly spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agents.messages import UserError

ONE = "--speeds without numbers drives all cars at one"


def own(speeds: Sequence[float], count: int) -> dict[str, Any]:
    """The keyword that gives each of so many cars its speed; none without speeds."""
    return {"speed": np.linspace(*speeds, count)} if speeds else {}


def check(args: Any, keywords: Mapping[str, Any]) -> None:
    """UserError for a trainer's `speeds` that are not two, or beside what contradicts them."""
    if not args.speeds:
        return
    if len(args.speeds) != 2:
        raise UserError(f"--speeds must be two, from and to, got {len(args.speeds)}")
    if not 0.0 < args.speeds[0] < args.speeds[1]:
        raise UserError(f"--speeds must rise from above 0, got {args.speeds[0]:g} and {args.speeds[1]:g}")
    if {"speed", "speed_ratio"} & set(keywords):
        raise UserError(f"--speeds: --env-keywords must not name a speed, too; {ONE}")
    for name in ("imitate", "residual"):
        if getattr(args, name):
            raise UserError(f"--speeds: a controller for --{name} is designed for one speed; {ONE}")
