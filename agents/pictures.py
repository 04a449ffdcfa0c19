"""The demo's pictures: one rescue side by side, which starts are saved, the learning curve."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Any

import gymnasium as gym
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from agents.episodes import Episode, start_seeds
from bicycle_env.control import Policy
from bicycle_env.files import write_bytes

# Okabe and Ito's palette, readable by the colour-blind.
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#999999"
STYLES = {"zero": (GREY, "-", "uncontrolled"), "lqr": (ORANGE, "--", "LQR"), "learned": (BLUE, "-", "learned (PPO)")}

mpl.rcParams.update({"font.size": 10, "axes.grid": True, "grid.alpha": 0.3, "axes.axisbelow": True})


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=130)
    write_bytes(path, content.getvalue())


def history(env: gym.Env, policy: Policy, seed: int) -> tuple[dict[str, np.ndarray], str]:
    """States of one episode by their names, and why it ended before its time."""
    plant: Any = env.unwrapped
    observation, _ = env.reset(seed=seed)
    policy.reset()
    states, over = [plant.state], False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        states.append(plant.state)
        over = terminated or truncated
    columns = dict(zip(states[0]._fields, np.array(states).T, strict=True))
    columns["sideslip"] = columns["lateral_velocity"] / plant.speed
    return columns, plant.end


def drive(env: gym.Env, policies: dict[str, Policy], seed: int, path: Path) -> None:
    """One start, driven by every policy: path on the road, time histories of the car and of both axles."""
    plant: Any = env.unwrapped
    runs, ends = {}, {}
    for name, policy in policies.items():
        runs[name], ends[name] = history(env, policy, seed)
    figure = Figure(figsize=(11, 7.2), layout="constrained")
    axes = figure.subplot_mosaic("RRRR;AABB;CCDD", height_ratios=[1.1, 1, 1])
    start = next(iter(runs.values()))
    lane_change = "direction" in start
    spin = (
        f": sideslip {math.degrees(start['sideslip'][0]):.0f} deg, yaw rate "
        f"{math.degrees(start['yaw_rate'][0]):.0f} deg/s"
    )
    figure.suptitle(
        f"The same start for all{'' if lane_change else spin}, at {plant.speed * 3.6:.0f} km/h = "
        f"{plant.stability.speed_ratio:.1f} x the critical speed"
    )
    road = axes["R"]
    handles = []
    for name, run in runs.items():
        color, line, label = STYLES[name]
        handles += road.plot(run["longitudinal_position"], run["lateral_position"], line, color=color, label=label)
        if ends[name]:
            place = run["longitudinal_position"][-1], run["lateral_position"][-1]
            road.plot(*place, "x", color=RED, markersize=9)
            road.annotate(
                f"{label}: {ends[name].replace('_', ' the ')}, the end",
                place,
                xytext=(9, 0),
                textcoords="offset points",
                va="center",
                color=RED,
            )
        for key, column in (("A", "sideslip"), ("B", "yaw_rate"), ("C", "front_steer"), ("D", "rear_steer")):
            axes[key].plot(run["time"], np.degrees(run[column]), line, color=color)
    centre, half = plant.measure()["reference_road_centre"], plant.rules.road_half_width
    for edge in (centre - half, centre + half):
        road.axhline(edge, color="black", linewidth=1.5)
    if lane_change:
        wanted = reference_path(plant, start)
        handles += road.plot(*wanted, ":", color="black", label="the path to follow")
    handles.append(Line2D([], [], color="black", label="road edge" if lane_change else "lane edge"))
    road.set(
        xlabel="along the road [m]",
        ylabel="lateral position [m]",
        ylim=(centre - half - 1.4, centre + half + 1.4),
        title="Path of the centre of mass (to the left is up; the lateral scale is stretched)",
    )
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    longest = 6.0 if lane_change else 4.0
    labels = {"A": "sideslip [deg]", "B": "yaw rate [deg/s]", "C": "front steer [deg]", "D": "rear steer [deg]"}
    for key, label in labels.items():
        axes[key].set(xlabel="time [s]", ylabel=label, xlim=(0, longest))
    save(figure, path)


def reference_path(plant: Any, start: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The lane change's path over the length that the cars drove: places along the road, and lateral positions."""
    places = np.linspace(0.0, float(start["longitudinal_position"][-1]), 300)
    lateral = []
    before = plant.snapshot()
    route = {"direction": "left" if start["direction"][0] > 0 else "right"}
    route["change_start"] = float(start["change_start"][0]) / plant.speed
    for place in places:
        plant.reset(options={"state": {"longitudinal_position": float(place)}, **route})
        lateral.append(plant.measure()["reference_lateral_position"])
    plant.restore(before)
    return places, np.array(lateral)


def saved_starts(env: gym.Env, driven: dict[str, list[Episode]], seed: int, path: Path) -> None:
    """Which starts each policy saves, in the plane of sideslip and yaw rate."""
    plant: Any = env.unwrapped
    count = len(next(iter(driven.values())))
    starts = []
    for start in start_seeds(count, seed):
        env.reset(seed=start)
        starts.append((plant.state.lateral_velocity / plant.speed, plant.state.yaw_rate))
    x, y = np.degrees(np.array(starts)).T
    figure = Figure(figsize=(11, 4.3), layout="constrained")
    for axis, (name, episodes) in zip(figure.subplots(1, len(driven), sharey=True), driven.items(), strict=True):
        won = np.array([episode.success for episode in episodes])
        axis.scatter(x[won], y[won], s=22, color=BLUE, label="saved")
        axis.scatter(x[~won], y[~won], s=26, color=RED, marker="x", label="lost")
        axis.set(xlabel="sideslip at the start [deg]", title=f"{STYLES[name][2]}: {100 * won.mean():.1f} % saved")
        if axis.get_subplotspec().is_first_col():
            axis.set_ylabel("yaw rate at the start [deg/s]")
    figure.suptitle(f"The same {count} starts: which cars are brought back to straight running in their lane")
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    save(figure, path)


def learning_curves(curves: list[Path], what: Any, lines: dict[str, float], path: Path) -> None:
    """Success while training, one line per seed, beside the classical controllers' shares. `what`: env_id and algo."""
    figure = Figure(figsize=(7.5, 3.8), layout="constrained")
    axis = figure.subplots()
    for k, curve in enumerate(curves):
        with curve.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        steps = [float(row["timesteps"]) / 1000 for row in rows]
        label = f"{what.algo.upper()}, while it explores" + (f" ({len(curves)} seeds)" if len(curves) > 1 else "")
        axis.plot(
            steps, [100 * float(row["success_rate"]) for row in rows], color=BLUE, alpha=0.8, label="" if k else label
        )
    for name, share in lines.items():
        color, line, label = STYLES[name]
        axis.axhline(100 * share, color=color, linestyle=line, label=f"{label}, on the test starts")
    axis.set(
        xlabel="environment steps [thousands]",
        ylabel="success in the last 100 episodes [%]",
        ylim=(-3, 103),
        title=f"Learning {what.env_id}",
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
