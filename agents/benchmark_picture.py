"""The benchmark's picture: learning curves against steps and seconds, and how many of the seeds reach which success."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bicycle_env.plots.style import BLACK, BLUE, GREEN, ORANGE, RED, dress, new_figure, save

COLORS = {"native-ppo": BLUE, "policy-search": ORANGE, "sb3-ppo": GREEN, "sb3-sac": RED}
WORDS = {
    "native-ppo": "PPO (agents.ppo)",
    "policy-search": "evolution strategy (agents.policy_search)",
    "sb3-ppo": "PPO (Stable-Baselines3)",
    "sb3-sac": "SAC (Stable-Baselines3)",
}


def draw(cells: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """A row for each id and level: success while training against steps and seconds, and at the end."""
    places = list(dict.fromkeys((cell["env_id"], cell["level"]) for cell in cells.values()))
    figure = new_figure(
        12.0, 2.6 * len(places) + 1.2, "Success of learned policies, and of the best classical controller"
    )
    axes = np.reshape(figure.subplots(len(places), 3, sharey=True, width_ratios=(3, 3, 2)), (-1, 3))
    for row, (env_id, level) in zip(axes, places, strict=True):
        mine = [cell for cell in cells.values() if (cell["env_id"], cell["level"]) == (env_id, level)]
        for cell in mine:
            color = COLORS[cell["learner"]]
            for one in cell["trainings"]:
                steps, seconds, success = np.array(one["curve"]).T
                row[0].plot(steps / 1e6, 100.0 * success, color=color, alpha=0.45, linewidth=0.9)
                row[1].plot(seconds, 100.0 * success, color=color, alpha=0.45, linewidth=0.9)
            levels = np.linspace(0.0, 100.0, len(cell["profile"]))
            row[2].plot(100.0 * np.array(cell["profile"]), levels, color=color)
        classical = 100.0 * mine[0]["classical"]["success_rate"]["value"]
        for axis in row:
            axis.axhline(classical, color=BLACK, linestyle="--", linewidth=1.0)
        dress(
            row[0], xlabel="control steps [millions]", ylabel="success [%]", ylim=(-3, 103), title=f"{env_id} {level}"
        )
        dress(row[1], xlabel="seconds of training", title="the same against time")
        dress(row[2], xlabel="seeds that reach it [%]", title="at the end")
    handles = [
        figure.axes[0].plot([], [], color=color, label=WORDS[name])[0]
        for name, color in COLORS.items()
        if any(cell["learner"] == name for cell in cells.values())
    ]
    handles.append(
        figure.axes[0].plot([], [], color=BLACK, linestyle="--", label="best classical controller, tuned")[0]
    )
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    save(figure, path)
