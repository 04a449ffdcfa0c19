"""What the pages of all environments say alike: the keywords that each has, and what ``telemetry=True`` tells."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from bicycle_env.envs.setup import Setup
from bicycle_env.physics.actuators import Actuator
from bicycle_env.tasks.task import Task

ARGUMENTS = """\
| vehicle | a name in `bicycle_env.vehicles`, a file (.toml, .json, CommonRoad's .yaml), a `Vehicle` or a dict |
| tire | `"linear"`, `"tanh"`, `"fiala"`, `"magic_formula"`, a file (.tir), a tire object or a dict |
| speed | m/s; not with speed_ratio; 30 if neither is given and the vehicle has no critical speed |
| speed_ratio | speed as a multiple of the vehicle's critical speed; 1.2 if neither is given |
| steer | `"front"`, `"rear"` or `"both"` |
| friction | road friction coefficient |
| geometry | `"small_angle"` or `"exact"`; by default small_angle for the linear tire, else exact |
| relaxation_length | m that a tire rolls until its force follows (0.3 to 0.6 in a car); `None`: at once |
| front_actuator | `Actuator(angle_limit, rate_limit, time_constant)`, dict |
| rear_actuator | the same for the rear axle |
| control_timestep | s between actions, unless action_repeat holds them longer |
| physics_timestep | s of an RK4 step; divides control_timestep |
| reward | `"default"`, `"quadratic"`, a `rewards.Reward` or its dict |
| horizon | steps a failure of the quadratic reward pays for: the time limit, or {steps}, by default |
| randomise | drawn for each episode: `{"friction": (0.3, 1.0)}`, or of `bicycle_env.distributions` |
| disturbances | of `bicycle_env.disturbances`: `Gust`, `IcePatch`, `FrictionStep`, `StiffnessLoss` |
| driver | at the front wheels: one of `bicycle_env.drivers`, or a name: `"step"`, `"preview"`, ... |
| action_delay | control steps until an action acts |
| observation_delay | how many control steps ago the observations are of |
| action_repeat | control steps that an action is held; the reward is their sum, the time limit counts them |
| sensors | what is observed: `bicycle_env.Sensors(signals="car", noise={"yaw_rate": 0.01})` |
| history | how many of the latest observations stand side by side, the newest first |
| level | `"easy"`, `"medium"` or `"hard"`: numbers below the other keywords; see docs/levels.md |
| telemetry | more in `info` |
| render_mode | `"human"` or `"rgb_array"` |
"""
"""Keyword and meaning; the defaults come from :class:`Setup` and from the task."""
TELEMETRY = """\
With `telemetry=True` also: front_slip_angle, rear_slip_angle [rad], front_lateral_force, rear_lateral_force [N],
lateral_acceleration (V' + U r) [m/s^2], yaw_acceleration [rad/s^2], sideslip [rad], front_saturation,
rear_saturation (|force| / (friction x axle load)), lateral_error, goal_error [m], heading_error [rad], clearance
(from the edge of the corridor to the nearest point of the body that is judged, by default its corners) [m].
"""


def written_page(text: str, task: Task, meanings: Mapping[str, str]) -> str:
    """An environment's docstring with the tables in place of `{keywords}` and `{telemetry}`.

    `meanings`: of the keywords that mean another thing there.
    """
    defaults = {field.name: field.default for field in dataclasses.fields(Setup)}
    defaults |= {"telemetry": False, "render_mode": None, **task.defaults}
    rows = []
    for row in ARGUMENTS.replace("{steps}", str(task.episode_steps)).splitlines():
        _, name, meaning, _ = (part.strip() for part in row.split("|"))
        rows.append(f"| {name} | `{_default(defaults[name])}` | {meanings.get(name, meaning)} |")
    blocks, lines = {"{keywords}": rows, "{telemetry}": TELEMETRY.splitlines()}, []
    for line in text.splitlines():
        indent = line[: len(line) - len(line.lstrip())]
        lines += [f"{indent}{each}" for each in blocks.get(line.strip(), [line.lstrip()])]
    return "\n".join(lines)


def _default(value: Any) -> str:
    """As the tables write it."""
    if isinstance(value, Actuator):
        angle, rate = math.degrees(value.angle_limit), math.degrees(value.rate_limit)
        return f"Actuator({angle:g} deg, {rate:g} deg/s, {value.time_constant:g} s)"
    return f'"{value}"' if isinstance(value, str) else repr(value)
