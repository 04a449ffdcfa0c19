"""From the keywords of an environment to checked values: the same for one car, many cars and torch."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from gymnasium.error import ClosedEnvironmentError
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import RELAXED_NAMES, STATE_NAMES, LinearModel, continuous_model, rk4_map
from bicycle_env.analysis.stability import Stability, stability
from bicycle_env.envs.plain import plain_spec
from bicycle_env.envs.setup import ADDED, Setup
from bicycle_env.envs.time_limit import resolve_horizon
from bicycle_env.envs.told import Told, frozen, tell
from bicycle_env.physics import actuators, tires
from bicycle_env.physics.actuators import Actuator
from bicycle_env.physics.car import CarParameters, CarState, car_on_road
from bicycle_env.physics.integrators import check_timestep
from bicycle_env.physics.linear_single_track import fastest_rate, straight_running
from bicycle_env.physics.model import Model
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.records import record_of
from bicycle_env.physics.relaxed_single_track import RelaxedSingleTrack
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.physics.validation import checked_speed, choice, in_range, positive, whole
from bicycle_env.physics.vehicle import Vehicle
from bicycle_env.tasks import randomised, rewards
from bicycle_env.tasks.checking import check, check_reward
from bicycle_env.tasks.episode import Rules
from bicycle_env.tasks.options import altered
from bicycle_env.tasks.rewards import Quadratic, Reward
from bicycle_env.tasks.task import Entry, Task

STEER_MODES = ("front", "rear", "both")
DEFAULT_SPEED_RATIO = 1.2
DEFAULT_SPEED = 30.0
"""m/s: the default for a car without critical speed."""
MOST_SUBSTEPS = 10_000
MOST_REPEAT = 1000
MOST_GROWTH = 20.0
"""Largest growth rate x control_timestep: e^20 is 5e8. Beyond, numbers overflow before an episode can end."""


@dataclasses.dataclass(frozen=True)
class Configuration:
    """One car, on one road, with one task: what an environment is made of."""

    task: Task
    vehicle: Vehicle
    model: Model
    speed: float
    steer: str
    friction: float
    relaxation_length: float | None
    reward: Reward
    horizon: int
    front_actuator: Actuator
    rear_actuator: Actuator
    control_timestep: float
    physics_timestep: float
    substeps: int
    action_repeat: int
    rules: Rules
    observation_entries: tuple[Entry, ...]
    level: str | None

    @property
    def tire(self) -> tires.Tire:
        return self.model.tire

    @property
    def geometry(self) -> str:
        return self.model.geometry

    @property
    def axles(self) -> int:
        """How many axles the action steers."""
        return 2 if self.steer == "both" else 1

    @property
    def observation_scale(self) -> NDArray[np.float64]:
        return np.array([entry.scale for entry in self.observation_entries])

    @property
    def observation_bound(self) -> NDArray[np.float32]:
        return np.array([entry.bound for entry in self.observation_entries], dtype=np.float32)

    @property
    def car(self) -> CarParameters:
        """The numbers that the equations need."""
        actuators = (self.front_actuator, self.rear_actuator)
        return car_on_road(self.vehicle, self.speed, self.friction, *actuators, self.relaxation_length or 0.0)

    @property
    def State(self) -> Any:
        """Named-tuple class of ``env.unwrapped.state``: the task's, with what the model has of its own."""
        own, task, place = self.model.own, self.task.State, len(CarState._fields)
        return record_of(task.__name__, (*task._fields[:place], *own, *task._fields[place:])) if own else task

    @property
    def settings(self) -> Any:
        """The task's numbers at this speed."""
        return self.task.settings(self.speed)

    @property
    def end_names(self) -> tuple[str, ...]:
        """The words of the end codes 0, 1, 2, ..."""
        return self.task.end_names

    @property
    def costs(self) -> Quadratic:
        """What Q and R are made of: the reward's if it is quadratic, else the task's own."""
        found: Any = self.reward if isinstance(self.reward, Quadratic) else self.task.rewards["quadratic"]
        return found  # type: ignore[no-any-return]

    @property
    def action_timestep(self) -> float:
        """From one action to the next, s."""
        return self.control_timestep * self.action_repeat

    @property
    def steps_to_pass(self) -> int:
        """How many control steps the way to a success takes at least."""
        return math.ceil(self.task.seconds_to_pass(self.car) / self.control_timestep - 1e-9)

    @property
    def steps_to_settle(self) -> int:
        """For how many control steps up to the time-out a car must have been settled: then it was a success."""
        return max(1, math.ceil(self.task.settled_seconds / self.control_timestep - 1e-9))

    def linear_model(self, quasi_static: bool = False) -> LinearModel:
        """What one step integrates, linearised at straight running; see :class:`Configured`."""
        rules, repeat = self.rules, self.action_repeat
        columns = [k for k, steered in enumerate((rules.steers_front, rules.steers_rear)) if steered]
        actuators = (self.front_actuator, self.rear_actuator)
        scale = np.array([actuators[k].angle_limit for k in columns])
        length = None if quasi_static else self.relaxation_length
        names, unpaid = (STATE_NAMES, ()) if length is None else (RELAXED_NAMES, (0.0, 0.0))
        a, b = continuous_model(self.vehicle, self.speed, actuators, length)
        a, b = rk4_map(a, b[:, columns] * scale, self.action_timestep, self.substeps * repeat)
        state_costs = (*self.costs.state_costs, *unpaid)
        command_costs = [self.costs.command_costs[k] for k in columns]
        inputs = [("front_steer_command", "rear_steer_command")[k] for k in columns]
        q, r = (repeat * np.diag(costs) for costs in (state_costs, command_costs))
        return LinearModel(a, b, q, r, self.action_timestep, names, tuple(inputs), scale)


class Configured:
    """Gives an environment its configuration's fields as attributes."""

    configuration = Told[Configuration]()
    task = Told[Task]()
    vehicle = Told[Any]()
    """A Vehicle; a tuple of num_envs of them where each car has its own."""
    model = Told[Model]()
    """The car's equations of motion."""
    tire = Told[tires.Tire]()
    speed = Told[Any]()
    """m/s; an array (num_envs,) where each car has its own."""
    steer = Told[str]()
    friction = Told[Any]()
    """An array (num_envs,) where each car has its own."""
    geometry = Told[str]()
    relaxation_length = Told[Any]()
    """m; None on tires that answer at once; an array (num_envs,) where each car has its own."""
    reward = Told[Reward]()
    horizon = Told[int]()
    """Steps that a failure of the quadratic reward pays for: the time limit, unless given."""
    front_actuator = Told[Actuator]()
    rear_actuator = Told[Actuator]()
    control_timestep = Told[float]()
    physics_timestep = Told[float]()
    substeps = Told[int]()
    action_repeat = Told[int]()
    """Control steps for which an action is held: what one step of the environment is."""
    action_timestep = Told[float]()
    """From one action to the next, s."""
    rules = Told[Rules]()
    observation_entries = Told[tuple[Entry, ...]]()
    observation_names = Told[tuple[str, ...]]()
    observation_scale = Told[NDArray[np.float64]]()
    """(entries,)"""
    observation_mirror = Told[NDArray[np.float64]]()
    """(entries,): +1 or -1, what each entry is multiplied by in the mirror image."""
    level = Told[str | None]()
    """What ``level=`` was, or the level that the task is without it; None for a task without levels."""
    telemetry = Told[bool]()
    _spec: Any = None
    closed: bool = False
    """After close() only what is can be asked, such as ``state``; nothing can be done any more."""

    def _adopt(self, configuration: Configuration) -> None:
        fields = {field.name: getattr(configuration, field.name) for field in dataclasses.fields(configuration)}
        names = tuple(entry.name for entry in configuration.observation_entries)
        tell(
            self,
            configuration=configuration,
            **fields,
            tire=configuration.tire,
            geometry=configuration.geometry,
            action_timestep=configuration.action_timestep,
            observation_names=names,
            observation_scale=frozen(configuration.observation_scale),
            observation_mirror=frozen(np.array([entry.mirror for entry in configuration.observation_entries])),
        )

    @property
    def spec(self) -> Any:
        """How the environment was made, the keywords in their plain form: its JSON makes an equal one.

        With a law of one's own ``to_json`` raises; the spec itself makes an equal environment in any case.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: Any) -> None:
        self._spec = plain_spec(spec)

    def _refuse_if_closed(self, asked: str) -> None:
        if self.closed:
            raise ClosedEnvironmentError(f"{asked} after close(): make a new environment")

    @property
    def stability(self) -> Stability:
        """Straight running without steering: critical_speed, speed_ratio, eigenvalues, time_to_double."""
        return stability(self.vehicle, self.speed, self.relaxation_length)

    def linear_model(self, quasi_static: bool = False) -> LinearModel:
        """What one step integrates, linearised at straight running; exact for the linear tire, small angles.

        The costs are those of a control step, times ``action_repeat``.
        Six states; with a relaxation length two more, unless `quasi_static`: then as if the tires answered at once.
        """
        return self.configuration.linear_model(quasi_static)


def configure(task: Task, setup: Setup, time_limit: int | None = None) -> Configuration:
    """Check every keyword; ValueError or TypeError names a bad one, its value and what is allowed.

    `time_limit`: steps of an episode, the default of the horizon; None where it is not known or there is none.
    """
    usual_speed = task.usual_speed
    task = altered(task, **{name: getattr(setup, name) for name in ADDED})
    check(task)
    vehicle = resolve_vehicle(setup.vehicle)
    relaxed = setup.relaxation_length is not None
    model: Model = (RelaxedSingleTrack if relaxed else SingleTrack).of(setup.tire, setup.geometry)
    relaxation_length = in_range("relaxation_length", setup.relaxation_length) if relaxed else None
    speed = resolve_speed(vehicle, setup.speed, setup.speed_ratio, usual_speed)
    steer = choice("steer", setup.steer, STEER_MODES)
    friction = in_range("friction", setup.friction)
    reward = rewards.resolve(setup.reward, task.rewards)
    check_reward(task, reward)
    horizon = whole("horizon", resolve_horizon(setup.horizon, time_limit, task.episode_steps))
    front_actuator = actuators.resolve("front_actuator", setup.front_actuator)
    rear_actuator = actuators.resolve("rear_actuator", setup.rear_actuator)
    control_timestep = in_range("control_timestep", setup.control_timestep, "timestep")
    physics_timestep = in_range("physics_timestep", setup.physics_timestep, "timestep")
    drawn = randomised.resolve(setup.randomise)
    cars = randomised.extremes(drawn, vehicle)
    fastest = max(fastest_rate(car, speed, relaxation_length) for car in cars)
    lags = [1.0 / time for time in randomised.least_time_constants(drawn, front_actuator, rear_actuator)]
    check_timestep("physics_timestep", physics_timestep, max(fastest, *lags))
    substeps = _substeps(control_timestep, physics_timestep)
    action_repeat = whole("action_repeat", setup.action_repeat, 1, MOST_REPEAT)
    growth = max(float(np.max(np.linalg.eigvals(straight_running(car, speed, relaxation_length)).real)) for car in cars)
    if growth * control_timestep > MOST_GROWTH:
        raise ValueError(
            f"control_timestep must be <= {MOST_GROWTH / growth:.3g} s here, got {control_timestep:g}: without "
            f"steering, a deviation of this car grows as e^({growth:.4g} t)"
        )
    rules = Rules(control_timestep, substeps, horizon, float(steer != "rear"), float(steer != "front"))
    entries = task.entries(speed, front_actuator.angle_limit, rear_actuator.angle_limit)
    return Configuration(
        task,
        vehicle,
        model,
        speed,
        steer,
        friction,
        relaxation_length,
        reward,
        horizon,
        front_actuator,
        rear_actuator,
        control_timestep,
        physics_timestep,
        substeps,
        action_repeat,
        rules,
        entries,
        setup.level,
    )


def resolve_speed(
    vehicle: Vehicle, speed: float | None, speed_ratio: float | None, usual_speed: float | None = None
) -> float:
    """The speed [m/s] from at most one of the two keywords; ValueError or TypeError otherwise.

    With neither, the task's `usual_speed`; without one 1.2 times the critical speed, or 30 m/s for a car without it.
    """
    if speed is not None and speed_ratio is not None:
        raise ValueError(f"give speed or speed_ratio, not both; got {speed!r} and {speed_ratio!r}")
    if speed is None and speed_ratio is None:
        speed = usual_speed
    if speed is not None:
        return checked_speed(speed)
    if speed_ratio is None and math.isinf(vehicle.critical_speed):
        return DEFAULT_SPEED
    ratio = positive("speed_ratio", DEFAULT_SPEED_RATIO if speed_ratio is None else speed_ratio)
    if math.isinf(vehicle.critical_speed):
        raise ValueError(
            f"speed_ratio must not be used (got {ratio:g}): this vehicle does not oversteer and has no critical speed; "
            "give speed in m/s"
        )
    return checked_speed(ratio * vehicle.critical_speed, "speed_ratio x critical speed")


def _substeps(control_timestep: float, physics_timestep: float) -> int:
    ratio = control_timestep / physics_timestep
    if ratio > MOST_SUBSTEPS:
        raise ValueError(
            f"physics_timestep must be >= control_timestep / {MOST_SUBSTEPS} = {control_timestep / MOST_SUBSTEPS:g} s, "
            f"got {physics_timestep:g}"
        )
    substeps = round(ratio)
    if substeps < 1 or abs(substeps * physics_timestep - control_timestep) > 1e-9 * control_timestep:
        raise ValueError(
            f"physics_timestep must divide control_timestep = {control_timestep:g} s, got {physics_timestep:g}"
        )
    return substeps
