"""Who drives each id and level how well: trained policies that come with the package, and classical controllers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bicycle_env.files import Check, listed, mapping, number_in, read_json, table, text, whole_in
from bicycle_env.physics.validation import choice

FILE = Path(__file__).parent / "policies" / "leaderboard.json"
KINDS = {"policy": "trained", "classical": "classical", "reference": "search"}
"""Of a driver: a policy of the package, a controller, or what search finds for each start alone."""
LARGEST = 1_000_000
"""Bytes."""


def _or_none(check: Check) -> Check:
    return lambda name, value: None if value is None else check(name, value)


NUMBER = number_in(-1e12, 1e12)
FIGURE = table({"value": NUMBER, "interval": listed(NUMBER, 2, 2)}, others=True)
ROW = table(
    {
        "name": text(100),
        "kind": text(100),
        "starts": whole_in(1, 10**9),
        "success_rate": FIGURE,
        "episode_return": FIGURE,
        "score": _or_none(NUMBER),
    },
    others=True,
)
CONTENT = table({"levels": mapping(table({"rows": listed(ROW, 1)}, others=True))}, others=True)
HEADS = ("", "success [%]", "return", "score", "starts", "")


def read(path: Path = FILE) -> dict[str, Any]:
    """The file's content: ``["levels"]["BicycleStab-v0 medium"]["rows"]`` are the drivers, the best first."""
    found: dict[str, Any] = read_json(path, CONTENT, LARGEST)
    return found


def of_id(levels: Mapping[str, Any], env_id: str | None) -> dict[str, Any]:
    """The levels of an id, all for None; ValueError or TypeError for an unknown one, with the nearest."""
    if env_id is None:
        return dict(levels)
    choice("env_id", env_id, dict.fromkeys(name.partition(" ")[0] for name in levels))
    return {name: level for name, level in levels.items() if name.partition(" ")[0] == env_id}


def as_text(levels: Mapping[str, Any]) -> str:
    """A table for each level."""
    rows = {name: [HEADS, *(_cells(row) for row in level["rows"])] for name, level in levels.items()}
    everyone = [row for each in rows.values() for row in each]
    widths = [max(len(cell) for cell in column) for column in zip(*everyone, strict=True)]
    lines = []
    for name, each in rows.items():
        lines.append(name)
        for row in each:
            cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
            lines.append(f"  {'  '.join(cells)}".rstrip())
        lines.append("")
    return "\n".join(lines)


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    score = "-" if row["score"] is None else f"{row['score']:.2f}"
    success, episode_return = _with_interval(row["success_rate"], 100.0), _with_interval(row["episode_return"], 1.0)
    return row["name"], success, episode_return, score, str(row["starts"]), KINDS.get(row["kind"], row["kind"])


def _with_interval(figure: Mapping[str, Any], factor: float) -> str:
    low, high = (factor * end for end in figure["interval"])
    return f"{factor * figure['value']:.1f} [{low:.1f}, {high:.1f}]"
