"""The demo's pictures: one rescue side by side, which starts are saved, the learning curve."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from matplotlib.lines import Line2D

from agents.episodes import Episode, start_seeds
from agents.headroom_setting import recoverable
from bicycle_env import plots
from bicycle_env.control import Policy
from bicycle_env.files import read_bytes, write_bytes
from bicycle_env.plots.style import BLACK, BLUE, GREY, ORANGE, RED, LineStyle, dress, new_figure, save

STYLES = {"zero": LineStyle(GREY, "-"), "lqr": LineStyle(ORANGE, "--"), "learned": LineStyle(BLUE, "-")}
LABELS = {"zero": "uncontrolled", "lqr": "LQR", "learned": "learned"}


def history(env: gym.Env, policy: Policy, seed: int) -> tuple[list[Any], str]:
    """The states of one episode, and why it ended before its time."""
    plant: Any = env.unwrapped
    observation, _ = env.reset(seed=seed)
    policy.reset()
    states, over = [plant.state], False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        states.append(plant.state)
        over = terminated or truncated
    return states, plant.end


def drive(env: gym.Env, policies: dict[str, Policy], seed: int, path: Path) -> None:
    """One start, driven by every policy: path on the road, time histories of the car and of both axles, phase plane."""
    plant: Any = env.unwrapped
    runs, ends = zip(*(history(env, policy, seed) for policy in policies.values()), strict=True)
    start = runs[0][0]
    sideslip, yaw_rate = (math.degrees(value) for value in (start.lateral_velocity / plant.speed, start.yaw_rate))
    spinning = max(abs(sideslip), abs(yaw_rate)) >= 1.0
    spin = f": sideslip {sideslip:.0f} deg, yaw rate {yaw_rate:.0f} deg/s" if spinning else ""
    figure = plots.episode(
        *runs,
        labels=[LABELS[name] for name in policies],
        styles=[STYLES[name] for name in policies],
        env=env,
        ends=ends,
        duration=4.0 if spinning else 6.0,
        title=f"The same start for all{spin}, at {plots.speed_in_words(plant.vehicle, plant.speed)}",
    )
    save(figure, path)


def saved_starts(env: gym.Env, driven: dict[str, list[Episode]], seed: int, path: Path) -> None:
    """Which starts each policy saves, in the plane of sideslip and yaw rate, and beyond what bound no steering does."""
    plant: Any = env.unwrapped
    count = len(next(iter(driven.values())))
    starts = []
    for start in start_seeds(count, seed):
        env.reset(seed=start)
        starts.append((plant.state.lateral_velocity / plant.speed, plant.state.yaw_rate))
    x, y = np.degrees(np.array(starts)).T
    slips, rates = (np.linspace(-1.1, 1.1, 121) * np.max(np.abs(values)) for values in (x, y))
    within = recoverable(plant).contains(plant.speed * np.radians(slips), np.radians(rates)[:, None])
    figure = new_figure(
        11, 4.3, f"The same {count} starts: which cars are brought back to straight running in their lane"
    )
    for axis, (name, episodes) in zip(figure.subplots(1, len(driven), sharey=True), driven.items(), strict=True):
        won = np.array([episode.success for episode in episodes])
        axis.contour(slips, rates, within, levels=[0.5], colors=BLACK, linewidths=1.2)
        axis.scatter(x[won], y[won], s=22, color=BLUE, label="saved")
        axis.scatter(x[~won], y[~won], s=26, color=RED, marker="x", label="lost")
        dress(axis, xlabel="sideslip at the start [deg]", title=f"{LABELS[name]}: {100 * won.mean():.1f} % saved")
        if axis.get_subplotspec().is_first_col():
            axis.set_ylabel("yaw rate at the start [deg/s]")
    bound = Line2D([], [], color=BLACK, linewidth=1.2, label="bound: outside, no steering saves the car")
    handles, _ = axis.get_legend_handles_labels()
    figure.legend(handles=[*handles, bound], loc="outside lower center", ncols=3)
    save(figure, path)


def learning_curves(curves: list[Path], env_id: str, lines: dict[str, float], path: Path) -> None:
    """Success on the starts that select, one line per seed, beside the drivers' shares on those of the table."""
    figure = new_figure(7.5, 3.8)
    axis = figure.subplots()
    for k, curve in enumerate(curves):
        rows = list(csv.DictReader(io.StringIO(read_bytes(curve).decode("utf-8"))))
        steps = [float(row["timesteps"]) / 1e6 for row in rows]
        label = "while it learns, on the starts that select" + (f" ({len(curves)} seeds)" if len(curves) > 1 else "")
        axis.plot(
            steps, [100 * float(row["success_rate"]) for row in rows], color=BLUE, alpha=0.8, label="" if k else label
        )
    for name, share in lines.items():
        color, line = (BLUE, ":") if name == "learned" else STYLES[name]
        axis.axhline(100 * share, color=color, linestyle=line, label=f"{LABELS[name]}, on the starts that report")
    dress(
        axis,
        xlabel="environment steps [millions]",
        ylabel="success [%]",
        ylim=(-3, 103),
        title=f"Learning {env_id}",
    )
    axis.legend(loc="lower right")
    save(figure, path)


def top_view(env_id: str, keywords: dict[str, Any], policy_of: Any, seed: int, steps: int, path: Path) -> None:
    """One frame of the environment's own renderer, `steps` control steps into an episode."""
    import pygame

    env = gym.make(env_id, render_mode="rgb_array", **keywords)
    policy = policy_of(env)
    observation, _ = env.reset(seed=seed)
    for _ in range(steps):
        env.render()  # the trail of the phase-plane inset grows with the frames
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        if terminated or truncated:
            break
    frame: Any = env.render()
    surface = pygame.surfarray.make_surface(frame.swapaxes(0, 1))
    content = io.BytesIO()
    pygame.image.save(surface, content, "frame.png")
    write_bytes(path, content.getvalue())
    env.close()
