"""FMVSS 126 (49 CFR 571.126), electronic stability control: what a sine with dwell asks of a car, as laws and figures.

The ratios of S5.2 have a floor here, and the displacement is that of the same car with straight rear wheels. The
standard's own figures are metrics. Its text was not read; the numbers are those that several sources agree on.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.metrics import Metric, Run
from bicycle_env.tasks.task import Law

BEGIN = 0.5
"""s after the start: the driver begins to steer."""
FIRST_RATIO, FIRST_TIME = 0.35, 1.0
"""S5.2.1: the yaw rate per its peak, so many s after the driver has finished."""
SECOND_RATIO, SECOND_TIME = 0.20, 1.75
"""S5.2.2."""
DISPLACEMENT_TIME = 1.07
"""s after the beginning: S5.2.3, where the standard asks for LEAST_DISPLACEMENT of a car of up to 3500 kg."""
LEAST_DISPLACEMENT = 1.83
"""m."""
PEAK_FROM = 0.375
"""Periods after the beginning from which on the peak is sought: before it the yaw rate is that of the first half."""
FLOOR = 0.2
"""rad/s: a peak counts at least so much. The ratios alone would reward a large one."""
TWIN_SHARE = 0.8
"""Of the displacement that the car would have had with straight rear wheels."""
ROUNDING = 1e-4
"""s by which a control step may come early, so that single precision counts the same steps."""


def since_finish(own: Any, time: Any) -> Any:
    """s since the driver has finished."""
    return time - BEGIN - 1.0 / own.frequency - own.dwell


def allowed_yaw_rate(xp: Any) -> Law:
    """``allowed_yaw_rate(own, time) -> rad/s``, asked for once at FIRST_TIME and always from SECOND_TIME on."""

    def allowed_yaw_rate(own: Any, time: Any) -> Any:
        ratio = xp.where(since(own, time) > SECOND_TIME - ROUNDING, SECOND_RATIO + 0.0 * time, FIRST_RATIO)
        return ratio * xp.maximum(own.peak_yaw_rate, FLOOR)

    since = xp.function(since_finish)
    return allowed_yaw_rate


def judgement(xp: Any) -> Law:
    """``judgement(state, episode, world) -> (peak, fast, short)`` of a control step, the episode before it.

    The peak of the yaw rate, and whether in this step the yaw rate is too large or the displacement too small.
    """

    def judgement(state: CarState, episode: EpisodeState, world: World) -> tuple[Any, Any, Any]:
        own, step = episode.task_state, world.rules.control_timestep
        before, now = episode.steps * step, (episode.steps + 1.0) * step
        size = abs(state.yaw_rate)
        counts = now - BEGIN > PEAK_FROM / own.frequency - ROUNDING
        peak = xp.where(counts, xp.maximum(own.peak_yaw_rate, size), own.peak_yaw_rate)
        floored = xp.maximum(peak, FLOOR)
        then, late = since(own, before), since(own, now)
        first = (late > FIRST_TIME - ROUNDING) & (then < FIRST_TIME - ROUNDING) & (size > FIRST_RATIO * floored)
        second = (late > SECOND_TIME - ROUNDING) & (size > SECOND_RATIO * floored)
        there = (now - BEGIN > DISPLACEMENT_TIME - ROUNDING) & (before - BEGIN < DISPLACEMENT_TIME - ROUNDING)
        least = xp.maximum((TWIN_SHARE * own.side) * own.twin_lateral_position, 0.0)
        return peak, first | second, there & (own.side * state.lateral_position < least)

    since = xp.function(since_finish)
    return judgement


def asked_yaw_rate(own: Any, time: Any) -> Any:
    """rad/s, nan where nothing is asked for."""
    allowed = allowed_yaw_rate(NUMPY)(own, time)
    return np.where(since_finish(own, time) > FIRST_TIME - ROUNDING, allowed, np.nan)


# Figures


def _at(run: Run, since: Any, seconds: float, values: Any) -> float | None:
    """The value at the first control step that is so late; None where the episode ended before."""
    late = np.flatnonzero(since > seconds - ROUNDING)
    return float(values[late[0]]) if len(late) else None


def _yaw_rate_ratio(seconds: float) -> Any:
    def ratio(run: Run) -> float | None:
        """The standard's own: no floor."""
        own = SimpleNamespace(**run.steps)
        size, peak = np.abs(run.steps["yaw_rate"]), np.maximum(own.peak_yaw_rate, 1e-12)
        return _at(run, since_finish(own, run.steps["time"]), seconds, size / peak)

    return ratio


def _displacement(run: Run) -> float | None:
    return _at(run, run.steps["time"] - BEGIN, DISPLACEMENT_TIME, run.steps["side"] * run.steps["lateral_position"])


def _displacement_ratio(run: Run) -> float | None:
    own = SimpleNamespace(**run.steps)
    there = own.side * own.twin_lateral_position
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(there > 0.0, own.side * run.steps["lateral_position"] / there, np.inf)
    return _at(run, run.steps["time"] - BEGIN, DISPLACEMENT_TIME, ratio)


def _fmvss(run: Run) -> float:
    """1 where the figures of the standard are met to the letter, else 0."""
    first, second = _yaw_rate_ratio(FIRST_TIME)(run), _yaw_rate_ratio(SECOND_TIME)(run)
    displacement = _displacement(run)
    if first is None or second is None or displacement is None:
        return 0.0
    return float(first <= FIRST_RATIO and second <= SECOND_RATIO and displacement >= LEAST_DISPLACEMENT)


METRICS = (
    Metric("yaw_rate_ratio_1s", "", "|yaw rate| per its peak 1 s after the driver", _yaw_rate_ratio(FIRST_TIME)),
    Metric("yaw_rate_ratio_1.75s", "", "the same 1.75 s after the driver", _yaw_rate_ratio(SECOND_TIME)),
    Metric("displacement", "m", "to the driver's side 1.07 s after the beginning", _displacement),
    Metric("displacement_ratio", "", "the same per that of straight rear wheels", _displacement_ratio),
    Metric("fmvss", "", "1 where FMVSS 126's figures are met to the letter, else 0", _fmvss),
    Metric(
        "floor_decides",
        "",
        "1 where the peak is below the floor, else 0",
        lambda run: float(run.steps["peak_yaw_rate"][-1] < FLOOR),
    ),
)
