"""Many cars in one environment: what is given once for all of them, or once per car."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import LinearModel
from bicycle_env.analysis.stability import Stability
from bicycle_env.envs.arrays import real_array
from bicycle_env.envs.configuration import Configuration, Configured, configure, resolve_speed
from bicycle_env.envs.origin import Origin
from bicycle_env.envs.setup import Setup
from bicycle_env.envs.time_limit import remark
from bicycle_env.envs.told import Told, frozen, tell
from bicycle_env.physics.car import CarParameters, car_on_road
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.validation import choice, flag, whole
from bicycle_env.physics.vehicle import Vehicle

Column = NDArray[np.float64]
"""(num_envs,): one number per car."""
NUMBERS = ("speed", "speed_ratio", "friction", "relaxation_length")
PER_CAR = ("vehicle", *NUMBERS)
"""Keywords that take one value, or a sequence of num_envs of them."""
OWN = ("vehicle", "speed", "friction", "relaxation_length", "observation_scale")
"""What an environment then tells per car."""
MODES = {mode.value: mode for mode in AutoresetMode}
MOST_STEPS = {"float64": 10**9, "float32": 2**24}
"""Of an episode, by type of number: float32 counts no further."""


CAR_OPTIONS = ("vehicle", "speed", "friction")
"""What ``reset`` may change of the cars that are driven, until it is called again."""


class Fleet(NamedTuple):
    """What an environment's cars are made of."""

    origin: Origin
    configuration: Configuration
    """The first car's; what it says beyond the fields below holds for all cars."""
    varied: bool
    """Whether a keyword was given per car: then the fields below are per car, too."""
    vehicle: Vehicle | tuple[Vehicle, ...]
    speed: float | Column
    """m/s."""
    friction: float | Column
    relaxation_length: float | Column | None
    car: CarParameters
    """Of floats or columns."""
    settings: Any
    """The task's numbers, floats; those that depend on the speed are columns if varied."""
    observation_scale: NDArray[np.float64]
    """(entries,), or (num_envs, entries) if varied."""

    def scored_level(self, time_limit: int | None) -> str | None:
        """The level, unless a keyword or another time limit than the task's has made something else of it."""
        origin, one = self.origin, self.configuration
        if time_limit not in (None, origin.task.episode_steps):
            return None
        if any(is_sequence(getattr(origin.setup, name)) for name in PER_CAR):
            return None
        return one.level if one == configure(*origin.of_level, origin.time_limit) else None


def configure_alike(origin: Origin) -> Fleet:
    """Cars that are all the same, or a single one."""
    one = configure(*origin[:3])
    numbers = one.speed, one.friction, one.relaxation_length
    return Fleet(origin, one, False, one.vehicle, *numbers, one.car, one.settings, one.observation_scale)


def with_options(fleet: Fleet, options: Mapping[str, Any]) -> Setup:
    """The setup that the options of a reset ask for: the vehicle, speed and friction not given stay nominal."""
    speed = options.get("speed", fleet.speed)
    given = {name: options[name] for name in CAR_OPTIONS if name in options}
    return dataclasses.replace(fleet.origin.setup, **{**given, "speed": speed, "speed_ratio": None})


def configure_fleet(origin: Origin, num_envs: int, varied: bool = False) -> Fleet:
    """Check a setup as ``configure`` does, the keywords in ``PER_CAR`` for every car.

    `varied`: each car has numbers of its own though they be the same.

    Raises:
        ValueError, TypeError: a bad keyword, named with its value and what is allowed, and the car that has it.
    """
    task, setup, time_limit, _ = origin
    given = {name: getattr(setup, name) for name in PER_CAR}
    if not varied and not any(is_sequence(value) for value in given.values()):
        return configure_alike(origin)

    vehicles = _vehicles(given["vehicle"], num_envs)
    columns = {name: number_column(name, given[name], num_envs) for name in NUMBERS if is_sequence(given[name])}

    def configuration_of(row: int) -> Configuration:
        numbers = {name: columns[name][row] if name in columns else given[name] for name in NUMBERS}
        try:
            return configure(task, dataclasses.replace(setup, vehicle=vehicles[row], **numbers), time_limit)
        except (TypeError, ValueError) as error:
            raise type(error)(f"car {row}: {error}") from None

    first = configuration_of(0)
    groups: dict[Vehicle, list[int]] = {}
    for row, vehicle in enumerate(vehicles):
        groups.setdefault(vehicle, []).append(row)
    for rows in groups.values():
        # What is allowed is an interval: it holds all cars of a vehicle if it holds the least and the greatest of each
        # number. The timestep, too: the fastest mode is the slowest car's, each |eigenvalue| falls with the speed.
        ends = {rows[end(column[rows])] for column in columns.values() for end in (np.argmin, np.argmax)}
        for row in sorted(ends | {rows[0]}):
            configuration_of(row)

    def column_of(name: str, otherwise: float) -> Column:
        value = columns.get(name, otherwise if given[name] is None else given[name])
        return np.broadcast_to(np.asarray(value, dtype=np.float64), num_envs)

    friction = column_of("friction", 1.0)
    relaxation_length = None if given["relaxation_length"] is None else column_of("relaxation_length", 0.0)
    speed = column_of("speed", 0.0).copy()
    car = CarParameters(*(np.empty(num_envs) for _ in CarParameters._fields))
    for vehicle, rows in groups.items():
        if given["speed"] is None and given["speed_ratio"] is None:
            speed[rows] = resolve_speed(vehicle, None, None, task.usual_speed)
        elif given["speed"] is None:
            speed[rows] = column_of("speed_ratio", 1.0)[rows] * vehicle.critical_speed
        numbers: Any = (speed[rows], friction[rows], first.front_actuator, first.rear_actuator)
        if relaxation_length is not None:
            numbers = (*numbers, relaxation_length[rows])
            configuration_of(rows[np.argmax(speed[rows] / relaxation_length[rows])])  # the fastest lag
        for column, values in zip(car, car_on_road(vehicle, *numbers), strict=True):
            column[rows] = values
    many: Any = speed  # tasks write settings and scales for one speed, or for an array of them
    entries = first.task.entries(many, first.front_actuator.angle_limit, first.rear_actuator.angle_limit)
    return Fleet(
        origin,
        first,
        True,
        tuple(vehicles),
        speed,
        friction,
        relaxation_length,
        car,
        first.task.settings(many),
        np.column_stack([np.broadcast_to(entry.scale, num_envs) for entry in entries]),
    )


class ConfiguredFleet(Configured):
    """Gives an environment of many cars its configuration's fields as attributes, and checks its other keywords.

    If one was given per car, ``vehicle`` is a tuple of num_envs Vehicles, ``speed``, ``friction`` and
    ``relaxation_length`` (unless None) are arrays (num_envs,), ``observation_scale`` is one (num_envs, entries).
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (declared so by Gymnasium)
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    fleet = Told[Fleet]()
    max_episode_steps = Told[int | None]()
    staggered_start = Told[bool]()
    on_invalid = Told[str]()
    end_names = Told[tuple[str, ...]]()
    dtype = Told[Any]()

    def _adopt_options(
        self,
        num_envs: int,
        max_episode_steps: int | None,
        autoreset_mode: str | AutoresetMode,
        dtype: str,
        staggered_start: bool,
        on_invalid: str,
        telemetry: bool,
    ) -> int | None:
        """Tell what is no part of a car; the time limit in control steps, None: none.

        Raises:
            ValueError, TypeError: a bad keyword, named with its value and what is allowed.
        """
        self.num_envs = whole("num_envs", num_envs)
        word = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        self.autoreset_mode = MODES[choice("autoreset_mode", word, MODES)]
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        most = MOST_STEPS[choice("dtype", dtype, MOST_STEPS)]
        limit = None if max_episode_steps in (None, -1) else whole("max_episode_steps", max_episode_steps, 1, most)
        tell(
            self,
            max_episode_steps=limit,
            dtype=dtype,
            staggered_start=flag("staggered_start", staggered_start),
            on_invalid=choice("on_invalid", on_invalid, ("raise", "terminate")),
            telemetry=flag("telemetry", telemetry),
        )
        return limit

    def _adopt_fleet(self, fleet: Fleet) -> None:
        self._adopt(fleet.configuration)
        own = {name: frozen(getattr(fleet, name)) for name in OWN}
        car, settings = CarParameters(*map(frozen, fleet.car)), type(fleet.settings)(*map(frozen, fleet.settings))
        end_names = self.configuration.end_names
        tell(self, fleet=fleet._replace(car=car, settings=settings, **own), end_names=end_names, **own)
        remark(self.max_episode_steps, fleet.origin.setup.horizon, self.configuration)
        bound, self._action_shape = self.configuration.observation_bound, (self.num_envs, self.configuration.axles)
        self.single_observation_space: spaces.Space[Any] = spaces.Box(-bound, bound, dtype=np.float32)
        self.single_action_space: spaces.Space[Any] = spaces.Box(-1.0, 1.0, self._action_shape[1:], np.float32)

    @property
    def scored_level(self) -> str | None:
        """As of the single environment; None also where a keyword was given per car."""
        return self.fleet.scored_level(self.max_episode_steps)

    @property
    def stability(self) -> Stability:
        """Straight running without steering, if all cars are alike; ValueError otherwise."""
        self._one_car("analysis.stability(vehicle, speed)")
        return super().stability

    def linear_model(self, quasi_static: bool = False) -> LinearModel:
        """What one control step integrates, linearised, if all cars are alike; ValueError otherwise."""
        self._one_car("linear_model() of a single environment")
        return super().linear_model(quasi_static)

    def _one_car(self, instead: str) -> None:
        if self.fleet.varied:
            raise ValueError(f"the cars of this environment differ: ask {instead} for one of them")


def is_sequence(value: object) -> bool:
    """Whether a value is one per car."""
    return isinstance(value, (list, tuple)) or getattr(value, "ndim", 0) > 0


def _vehicles(value: Any, num_envs: int) -> list[Vehicle]:
    if not is_sequence(value):
        return [resolve_vehicle(value)] * num_envs
    if len(value) != num_envs:
        raise ValueError(f"vehicle must be one vehicle or num_envs = {num_envs} of them, got {len(value)}")
    return [resolve_vehicle(vehicle) for vehicle in value]


def number_column(name: str, value: Any, num_envs: int) -> Column:
    """(num_envs,): one number per car; TypeError or ValueError for anything else."""
    values = real_array(value)
    if values is None:
        raise TypeError(f"{name} must be one number or num_envs = {num_envs} of them, got {value!r}")
    if values.shape != (num_envs,):
        raise ValueError(f"{name} must be one number or num_envs = {num_envs} of them, got shape {values.shape}")
    return values.astype(np.float64)
