"""What an experimenter may add to any task, by the environments' keywords."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bicycle_env.physics.validation import whole
from bicycle_env.tasks import disturbances as disturbing
from bicycle_env.tasks import drivers, randomised
from bicycle_env.tasks import sensors as sensing
from bicycle_env.tasks.delays import MOST_DELAY, MOST_FRAMES, Frames, LateActions, LateObservations
from bicycle_env.tasks.disturbances import DisturbedTask
from bicycle_env.tasks.drivers import DrivenTask
from bicycle_env.tasks.randomised import RandomisedTask
from bicycle_env.tasks.sensors import SensedTask
from bicycle_env.tasks.task import Task


def altered(
    task: Task,
    randomise: Mapping[str, Any] | None = None,
    disturbances: Any = (),
    driver: Any = None,
    action_delay: int = 0,
    observation_delay: int = 0,
    sensors: Any = None,
    history: int = 1,
) -> Task:
    """The task with what is added to it; the task itself where nothing is.

    Raises:
        ValueError, TypeError: a bad value, named with what is allowed.
    """
    drawn, acting = randomised.resolve(randomise), disturbing.resolve(disturbances)
    at_the_wheel, measured_by = drivers.resolve(driver), sensing.resolve(sensors)
    late_actions = whole("action_delay", action_delay, 0, MOST_DELAY)
    late_observations = whole("observation_delay", observation_delay, 0, MOST_DELAY)
    frames = whole("history", history, 1, MOST_FRAMES)
    if at_the_wheel is not None:
        task = task.undriven
    if late_actions:
        task = LateActions(task, late_actions)
    if at_the_wheel is not None:
        task = DrivenTask(task, at_the_wheel)
    if drawn:
        task = RandomisedTask(task, drawn)
    if acting:
        task = DisturbedTask(task, acting)
    if measured_by is not None:
        task = SensedTask(task, measured_by)
    if late_observations:
        task = LateObservations(task, late_observations)
    return Frames(task, frames - 1) if frames > 1 else task
