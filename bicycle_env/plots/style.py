"""What all figures of the package share: colours, line styles, axes, files.

Figures are ``matplotlib.figure.Figure`` objects; pyplot and its global state are not used. matplotlib is imported when
the first figure is made.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bicycle_env.files import write_bytes
from bicycle_env.installation import needs
from bicycle_env.physics.vehicle import Vehicle

# Okabe and Ito's palette, readable by the colour-blind.
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PINK, SKY, YELLOW, GREY, BLACK = "#CC79A7", "#56B4E9", "#F0E442", "#999999", "#000000"
PATCHES = {"ice": "#C6DBE7", "obstacle": "#D9C2B4"}
"""Colours of what covers a part of the road, by kind."""
DOTS_PER_INCH = 130


class LineStyle(NamedTuple):
    """How one of several curves is drawn: never told apart by colour alone."""

    color: str
    line: Any
    """A matplotlib line style."""


AXLE = {"front_steer": LineStyle(BLUE, "-"), "rear_steer": LineStyle(RED, "--")}
"""The two steered axles, in every figure."""


def line_style(k: int) -> LineStyle:
    """The k-th of several curves: twelve pairs of colour and dashes before they repeat."""
    colors = (BLUE, ORANGE, GREEN, RED, PINK, SKY)
    lines = ("-", "--", "-.", ":")
    return LineStyle(colors[k % len(colors)], lines[k % len(lines)])


def require_matplotlib() -> None:
    """Raise ModuleNotFoundError with the install line if matplotlib is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise ModuleNotFoundError(needs("a figure", "matplotlib", "analysis"), name="matplotlib") from None


def new_figure(width: float, height: float, title: str = "") -> Any:
    """An empty ``matplotlib.figure.Figure`` of a size in inches, with a constrained layout."""
    require_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    if title:
        figure.suptitle(title)
    return figure


def dress(axes: Any, **properties: Any) -> Any:
    """Give axes the common grid and set their properties: xlabel, ylabel, title, xlim, ..."""
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)
    axes.set(**properties)
    return axes


def cross_hair(axes: Any) -> None:
    """Thin lines through zero, behind everything."""
    for line in (axes.axhline, axes.axvline):
        line(0.0, color=GREY, linewidth=0.8, zorder=0.5)


def legend_below(figure: Any, handles: Sequence[Any], columns: int = 5) -> None:
    """One legend for the whole figure, below it."""
    if handles:
        figure.legend(handles=list(handles), loc="outside lower center", ncols=min(len(handles), columns))


def png(figure: Any, dots_per_inch: float = DOTS_PER_INCH) -> bytes:
    """A figure as the content of a PNG file."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dots_per_inch)
    return content.getvalue()


def save(figure: Any, path: str | Path, dots_per_inch: float = DOTS_PER_INCH) -> None:
    """Write a figure as PNG, whole or not at all; the folder is made if needed. ValueError for another ending."""
    if Path(path).suffix.lower() != ".png":
        raise ValueError(f"path must end in .png, which is what is written, got {str(path)!r}")
    write_bytes(path, png(figure, dots_per_inch))


SPEED, SPEED_RATIO = "{kmh:.0f} km/h", " = {ratio:.3g} x the critical speed"


def speed_in_words(vehicle: Vehicle, speed: float) -> str:
    """``"156 km/h = 1.2 x the critical speed"``; without the second half for a car that has none."""
    words = SPEED.format(kmh=3.6 * speed)
    if math.isinf(vehicle.critical_speed):
        return words
    return words + SPEED_RATIO.format(ratio=speed / vehicle.critical_speed)
