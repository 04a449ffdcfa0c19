"""The picture of the headroom: for each setting the best classical controller, and above it the room."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.headroom_setting import BEST, BLIND, BOUND, LEARNED, UNCONTROLLED
from bicycle_env import plots

SIDES = ("classical", "reference")


def draw(parts: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """One horizontal bar per setting, from what nobody saves over the controllers to the best found."""
    figure = plots.new_figure(9.5, 1.8 + 0.42 * len(parts), "Share of the starts that are saved, and the room above")
    axes = figure.subplots()
    places = np.arange(len(parts))[::-1]
    colours = {name: plots.line_style(k).color for k, name in enumerate(("classical", BLIND, BEST))}
    for place, part in zip(places, parts.values(), strict=True):
        rates = {name: 100.0 * row["success_rate_of_searched"] for name, row in part["drivers"].items()}
        classical, above = part["classical"]["driver"], part["reference"]["driver"]
        rates |= {
            driver: 100.0 * part[side]["success_rate"] for side, driver in zip(SIDES, (classical, above), strict=True)
        }
        if BOUND in rates:
            axes.barh(place, rates[BOUND], height=0.86, color="0.93", edgecolor="0.6", linewidth=0.6)
        axes.barh(place, rates[BEST], height=0.62, color=colours[BEST], alpha=0.35)
        if BLIND in rates:
            axes.barh(place, rates[BLIND], height=0.62, color="white")  # one shade through another is a third
            axes.barh(place, rates[BLIND], height=0.62, color=colours[BLIND], alpha=0.55)
        axes.barh(place, rates[classical], height=0.34, color=colours["classical"])
        if LEARNED in rates:
            axes.plot(rates[LEARNED], place, "D", color="black", markersize=4, markerfacecolor="white", clip_on=False)
        axes.plot(rates[UNCONTROLLED], place, "|", color="black", markersize=11, markeredgewidth=2.0)
        room = 100.0 * part["room"]["value"]
        words = classical.removesuffix(", tuned")
        axes.text(101.5, place, f"{room:+.1f}  over {words}", va="center", fontsize=8)
    axes.set_yticks(places, list(parts))
    axes.set_xlim(0.0, 100.0)
    axes.set_ylim(-0.7, len(parts) - 0.3)
    axes.set_xlabel("share of the starts [%]; right: room in points, reference over the best tuned controller")
    axes.grid(axis="y", visible=False)
    handles = [
        axes.barh(0, 0, color=colours["classical"], label="best classical controller, tuned for the setting"),
        axes.barh(0, 0, color=colours[BLIND], alpha=0.55, label="best found without knowing what is hidden"),
        axes.barh(0, 0, color=colours[BEST], alpha=0.35, label="best found, knowing it"),
        axes.barh(0, 0, color="0.93", edgecolor="0.6", label="upper bound, any steering"),
        axes.plot(
            [],
            [],
            "D",
            color="black",
            markersize=4,
            markerfacecolor="white",
            linestyle="",
            label="the policy that ships, learned",
        )[0],
        axes.plot([], [], "|", color="black", markersize=11, markeredgewidth=2.0, label="nobody steers")[0],
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    plots.save(figure, path)
