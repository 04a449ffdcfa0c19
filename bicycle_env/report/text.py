"""The numbers as plain text: the report's tables, and the list of cars."""

from __future__ import annotations

import dataclasses
import math
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

from bicycle_env import analysis
from bicycle_env.physics.presets import vehicles
from bicycle_env.physics.vehicle import GRAVITY
from bicycle_env.report.quantities import finite, groups
from bicycle_env.report.study import Study
from bicycle_env.report.words import in_words, summary, title


def as_text(study: Study, width: int = 100) -> str:
    """The report's numbers as tables."""
    parts = [
        title(study),
        textwrap.fill(summary(study), width),
        "",
    ]
    for group in groups(study):
        rows = [(row.label, in_words(row), row.equation) for row in group.rows]
        parts += [group.title, *_aligned(rows, indent="  "), ""]
    return "\n".join(parts)


def vehicles_as_text(width: int = 100) -> str:
    """The presets: a table, and below it where the numbers come from."""
    heads = ("name", "mass", "wheelbase", "balance", "understeer gradient", "critical speed", "characteristic speed")
    units = ("", "[kg]", "[m]", "", "[deg/g]", "[m/s]", "[m/s]")
    rows = [heads, units]
    for name, car in vehicles.items():
        rows.append(
            (
                name,
                f"{car.mass:.0f}",
                f"{car.wheelbase:.2f}",
                analysis.classification(car),
                f"{math.degrees(analysis.understeer_gradient(car)) * GRAVITY:+.2f}",
                _speed(analysis.critical_speed(car)),
                _speed(analysis.characteristic_speed(car)),
            )
        )
    sources = [
        textwrap.fill(f"{name}: {car.source}", max(width, 40), subsequent_indent="    ")
        for name, car in vehicles.items()
    ]
    return "\n".join([*_aligned(rows), "", "Sources", *sources, ""])


def vehicles_as_json() -> dict[str, Any]:
    """All parameters of the presets by name, with balance and speeds; None for a speed that there is not."""
    return {
        name: {
            **dataclasses.asdict(car),
            "classification": analysis.classification(car),
            "critical_speed": finite(analysis.critical_speed(car)),
            "characteristic_speed": finite(analysis.characteristic_speed(car)),
        }
        for name, car in vehicles.items()
    }


def _speed(speed: float) -> str:
    return f"{speed:.1f}" if math.isfinite(speed) else "none"


def _aligned(rows: Iterable[Sequence[str]], indent: str = "") -> list[str]:
    """Columns as wide as their widest cell."""
    rows = list(rows)
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return [
        indent + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
