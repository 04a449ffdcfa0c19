"""One page on which to explore a car, its drivers and their runs: see docs/explore.md and ``bicycle-env explore``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bicycle_env.explore.content import page
from bicycle_env.explore.server import USUAL_PORT, Server
from bicycle_env.export.writing import write_folder
from bicycle_env.physics.presets import vehicles

__all__ = ["USUAL_PORT", "Server", "page", "write"]


def write(out: str | Path, names: Sequence[str] = tuple(vehicles)) -> list[Path]:
    """Write the page as static files, for any web server; the paths. `names`: of the presets on it.

    Raises:
        FileError: the folder holds a file of such a name that no `explore` wrote.
        OSError: the folder cannot be written to.
    """
    return write_folder(out, page(names), {"what": "the explorer"}, "bicycle-env explore")
