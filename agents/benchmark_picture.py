"""The benchmark's picture: learning curves against steps and seconds, and how many of the seeds reach which success.

    python -m agents.benchmark_picture results/benchmark.json

draws it anew, beside the results file, as agents.benchmark does when it has measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from agents import messages
from agents.benchmark_tables import LEARNERS
from agents.scores import LEVELS
from agents.statistics import iqm
from bicycle_env import files
from bicycle_env.plots.style import BLACK, BLUE, GREEN, ORANGE, PINK, RED, LineStyle, dress, new_figure, save

LARGEST = 50_000_000
"""Bytes of a results file."""
CONTENT = files.table({"cells": files.mapping(files.mapping(files.anything))}, others=True)
STYLES = {
    "native-ppo": LineStyle(BLUE, "-"),
    "policy-search": LineStyle(ORANGE, "-."),
    "sb3-ppo": LineStyle(GREEN, (0, (4, 1))),
    "sb3-sac": LineStyle(RED, (0, (1, 1))),
}
OTHER = LineStyle(PINK, (0, (6, 1, 1, 1)))
"""Of a learner that has no style of its own."""
FAR_APART = 8.0
"""Ratio of the shortest to the longest of the learners' trainings from which on their axis is logarithmic."""
WHAT = (
    "Success of learned policies while they learn, and at the end. A line: the seeds' interquartile mean; its band: "
    "the worst to the best seed.\nLearning curves: on the 500 starts that select; right, and the dashed line: on the "
    "2000 that report."
)


@dataclass
class Args:
    """Draw the picture of a results file of agents.benchmark, beside it."""

    results: tyro.conf.Positional[Path] = Path("runs/benchmark.json")
    """As agents.benchmark has written it."""


class Curves:
    """Of a learner's seeds, at the same steps: success, its mean and range, and the median time."""

    def __init__(self, trainings: Sequence[Mapping[str, Any]]) -> None:
        curves = [np.array(one["curve"], float) for one in trainings]
        first, last = max(curve[0, 0] for curve in curves), min(curve[-1, 0] for curve in curves)
        steps = curves[0][:, 0]
        self.steps = steps[(steps >= first) & (steps <= last)]
        seconds, success = (np.array([np.interp(self.steps, curve[:, 0], curve[:, k]) for curve in curves]) for k in
                            (1, 2))  # fmt: skip
        self.seconds: NDArray[np.float64] = np.median(seconds, axis=0)
        self.mean = np.array([iqm(column) for column in success.T])
        self.least, self.most = success.min(axis=0), success.max(axis=0)


def draw(cells: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """A row for each id and level: success while training against steps and seconds, and at the end."""
    ids = list(dict.fromkeys(cell["env_id"] for cell in cells.values()))
    there = {(cell["env_id"], cell["level"]) for cell in cells.values()}
    places = sorted(there, key=lambda place: (ids.index(place[0]), LEVELS.index(place[1])))
    figure = new_figure(12.0, 2.25 * len(places) + 1.5)
    figure.suptitle(WHAT, fontsize=10)
    axes = np.reshape(figure.subplots(len(places), 3, sharey="row", width_ratios=(3, 3, 2)), (-1, 3))
    for row, place in zip(axes, places, strict=True):
        draw_place(row, [cell for cell in cells.values() if (cell["env_id"], cell["level"]) == place])
        row[0].set_ylabel(f"{place[0]}\n{place[1]}\n\nsuccess [%]")
    for axis, title in zip(axes[0], ("against steps", "against time", "at the end"), strict=True):
        axis.set_title(title)
    handles = [
        figure.axes[0].plot([], [], color=style.color, linestyle=style.line, linewidth=1.8, label=label)[0]
        for name, (style, label) in shown(cells).items()
    ]
    classical = figure.axes[0].plot([], [], color=BLACK, linestyle="--", linewidth=1.0)[0]
    classical.set_label("best classical controller, tuned")
    figure.legend(handles=[*handles, classical], loc="outside lower center", ncols=3)
    save(figure, path, 100)


def shown(cells: Mapping[str, Mapping[str, Any]]) -> dict[str, tuple[LineStyle, str]]:
    """Of each learner that has a cell, how it is drawn, and its words."""
    names = [*LEARNERS, *(cell["learner"] for cell in cells.values())]
    there = {cell["learner"] for cell in cells.values()}
    return {
        name: (STYLES.get(name, OTHER), LEARNERS.get(name, name).replace("`", ""))
        for name in dict.fromkeys(names)
        if name in there
    }


def draw_place(row: Sequence[Any], cells: Sequence[Mapping[str, Any]]) -> None:
    """The three panels of an id and level."""
    longest: list[tuple[float, float]] = []
    classical = 100.0 * cells[0]["classical"]["success_rate"]["value"]
    top = classical
    for cell in cells:
        style, curves = STYLES.get(cell["learner"], OTHER), Curves(cell["trainings"])
        longest.append((float(curves.steps[-1]), float(curves.seconds[-1])))
        for axis, across in zip(row, (curves.steps / 1e6, curves.seconds), strict=False):
            axis.plot(across, 100.0 * curves.mean, color=style.color, linestyle=style.line, linewidth=1.8)
            axis.fill_between(
                across, 100.0 * curves.least, 100.0 * curves.most, color=style.color, alpha=0.15, linewidth=0
            )
        seeds = sorted((100.0 * one["success_rate"]["value"] for one in cell["trainings"]), reverse=True)
        shares = np.linspace(0.0, 100.0, len(seeds) + 1)
        row[2].step(shares, [seeds[0], *seeds], color=style.color, linestyle=style.line, linewidth=1.8)
        top = max(top, 100.0 * float(curves.most.max()))
    for axis in row:
        axis.axhline(classical, color=BLACK, linestyle="--", linewidth=1.0)
    dress(row[0], xlabel="control steps [millions]", ylim=(-3.0, min(103.0, 1.15 * top + 3.0)))
    dress(row[1], xlabel="seconds of training, one core")
    dress(row[2], xlabel="seeds that save at least so much [%]", xlim=(-3.0, 103.0))
    for axis, lengths in zip(row, zip(*longest, strict=True), strict=False):
        if max(lengths) > FAR_APART * min(lengths):
            axis.set_xscale("log")
            axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            axis.set_xlabel(f"{axis.get_xlabel()}, logarithmic")
        else:
            axis.set_xlim(left=0.0)


def read(path: Path) -> dict[str, Any]:
    """The cells of a results file; FileError for one that is damaged."""
    found: dict[str, Any] = files.read_json(path, CONTENT, LARGEST)["cells"]
    return found


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.benchmark_picture", description=__doc__)
    cells = read(args.results)
    path = args.results.with_suffix(".png")
    messages.check_output("the picture", path)
    draw(cells, path)
    messages.console().print(f"written: {path}")


if __name__ == "__main__":
    messages.run(main)
