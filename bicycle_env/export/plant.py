"""The plant: one RK4 substep of the single-track model of a car with its tires and actuators, and what surrounds it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bicycle_env.envs.configuration import resolve_speed
from bicycle_env.export.routines import Argument, Library, Routine
from bicycle_env.physics import actuators, tires
from bicycle_env.physics.actuators import FRONT, REAR, Actuator
from bicycle_env.physics.car import CarParameters, CarState, car_on_road
from bicycle_env.physics.integrators import check_timestep, rk4
from bicycle_env.physics.lateral import Axles
from bicycle_env.physics.linear_single_track import fastest_rate
from bicycle_env.physics.model import Model
from bicycle_env.physics.presets import resolve_tired
from bicycle_env.physics.relaxed_single_track import RelaxedSingleTrack
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.physics.validation import in_range
from bicycle_env.physics.vehicle import Vehicle

SUBSTEPS = 5
"""Of a control step in the test vectors, and in the environments."""
CASES = 24
LONG = 100
"""Substeps of a few of them: a difference of one bit grows."""
C_STEP = """\
{p}_state now = *state;
{p}_command held;
{p}_limited(&held, command, car);
for (int k = 0; k < substeps; k++)
    {p}_substep(&now, &now, &held, car, timestep);
*next = now;"""
JS_STEP = """\
const held = new_command();
limited(held, command, car);
Object.assign(next, state);
for (let k = 0; k < substeps; k++) substep(next, next, held, car, timestep);"""


class Command(NamedTuple):
    """What the road wheels are asked to do, rad."""

    front_steer_command: Any
    rear_steer_command: Any


@dataclasses.dataclass(frozen=True)
class Plant:
    """A car at one speed on one road, with its actuators."""

    vehicle: Vehicle
    model: Model
    speed: float
    friction: float
    relaxation_length: float | None
    front_actuator: Actuator
    rear_actuator: Actuator
    timestep: float
    """Of the physics, s."""
    pushed: bool
    """Whether the car's side_force and yaw_moment act."""

    @property
    def car(self) -> CarParameters:
        """The numbers that the equations need."""
        return car_on_road(
            self.vehicle,
            self.speed,
            self.friction,
            self.front_actuator,
            self.rear_actuator,
            self.relaxation_length or 0.0,
        )

    def __str__(self) -> str:
        ratio = self.speed / self.vehicle.critical_speed
        beside = f", {ratio:.4g} x the critical speed" if ratio else ""
        return f"{self.vehicle.name or 'car'} at {self.speed:.6g} m/s{beside}; {self.model}; friction {self.friction:g}"


def plant(
    vehicle: str | Vehicle | Mapping[str, Any] = "oversteer",
    tire: str | tires.Tire | Mapping[str, Any] = "fiala",
    *,
    speed: float | None = None,
    speed_ratio: float | None = None,
    friction: float = 1.0,
    geometry: str | None = None,
    relaxation_length: float | None = None,
    front_actuator: Actuator | Mapping[str, Any] = FRONT,
    rear_actuator: Actuator | Mapping[str, Any] = REAR,
    physics_timestep: float = 0.004,
    pushed: bool = False,
) -> Plant:
    """Choose what to export; the keywords are those of the environments.

    Args:
        pushed: whether the car's ``side_force`` [N] and ``yaw_moment`` [N m] act, as under a gust.

    Raises:
        ValueError, TypeError: a bad value, named with its allowed range; a timestep too long for RK4.
        OSError: a car's file that cannot be read.
    """
    vehicle, tire = resolve_tired(vehicle, tire)
    relaxed = relaxation_length is not None
    model: Model = (RelaxedSingleTrack if relaxed else SingleTrack).of(tire, geometry)
    length = in_range("relaxation_length", relaxation_length) if relaxed else None
    found = Plant(
        vehicle,
        model,
        resolve_speed(vehicle, speed, speed_ratio),
        in_range("friction", friction),
        length,
        actuators.resolve("front_actuator", front_actuator),
        actuators.resolve("rear_actuator", rear_actuator),
        in_range("physics_timestep", physics_timestep, "timestep"),
        pushed,
    )
    lags = (1.0 / actuator.time_constant for actuator in (found.front_actuator, found.rear_actuator))
    check_timestep("physics_timestep", found.timestep, max(fastest_rate(vehicle, found.speed, length), *lags))
    return found


def routines(model: Model, pushed: bool) -> tuple[Routine, ...]:
    """Of a model: what of the car's command acts, a substep, a control step, the axles; where it relaxes, its start."""
    state, command, car = Argument("state", model.State), Argument("command", Command), Argument("car", CarParameters)
    following, timestep, count = (
        Argument("next", model.State, "state"),
        Argument("timestep"),
        Argument("substeps", kind="count"),
    )

    def limited(xp: Any) -> Any:
        def limited(command: Command, car: CarParameters) -> Command:
            front, rear = command
            return Command(
                xp.maximum(xp.minimum(front, car.front_angle_limit), -car.front_angle_limit),
                xp.maximum(xp.minimum(rear, car.rear_angle_limit), -car.rear_angle_limit),
            )

        return limited

    def substep(xp: Any) -> Any:
        advance = rk4(xp, model.State, model.actuated_rates(xp, pushed))

        def substep(state: Any, command: Command, car: CarParameters, timestep: Any) -> Any:
            return advance(state, command, command, command, car, timestep)

        return substep

    def control_step(xp: Any) -> Any:
        within, advance = limited(xp), substep(xp)

        def control_step(state: Any, command: Command, car: CarParameters, timestep: Any, substeps: Any) -> Any:
            held = within(command, car)
            for _ in range(int(substeps)):
                state = advance(state, held, car, timestep)
            return state

        return control_step

    found = (
        Routine(
            "limited",
            "A command within the angle limits of the actuators.",
            (command, car),
            (Argument("acting", Command, "command"),),
            limited,
        ),
        Routine(
            "substep",
            "One RK4 step of the car and its actuators; the command is within its limits.",
            (state, command, car, timestep),
            (following,),
            substep,
        ),
        Routine(
            "control_step",
            "The command is limited and held for so many substeps of timestep [s].",
            (state, command, car, timestep, count),
            (following,),
            control_step,
            C_STEP,
            JS_STEP,
        ),
        Routine(
            "axles",
            "Slip angles and lateral forces of both axles in a state, and the accelerations that they cause.",
            (state, car),
            (Argument("acting", Axles, "axle_forces"),),
            lambda xp: model.axles(xp, pushed),
        ),
    )
    if not model.own:
        return found
    settled = Routine(
        "settled",
        "The state of a car that has long moved like this: its tires lag no more.",
        (Argument("state", CarState, "car_state"), car),
        (following,),
        model.complete,
    )
    return (*found, settled)


def library(plant: Plant, name: str = "bicycle_plant") -> Library:
    """The plant as functions, with its numbers and the inputs of its test vectors."""
    found, car = routines(plant.model, plant.pushed), plant.car
    draws = np.random.default_rng(14)
    sizes = CarState(50.0, 2.0, 0.3, 0.3 * plant.speed, 1.0, car.front_angle_limit, car.rear_angle_limit)
    own = [0.3] * len(plant.model.own)
    limits = np.array([car.front_angle_limit, car.rear_angle_limit])
    cases: dict[str, list[list[float]]] = {routine.name: [] for routine in found}
    for k in range(CASES):
        share = k / (CASES - 1)  # from straight running to far into sliding
        numbers = tuple(car)
        if plant.pushed:
            push = {"side_force": 3e3 * draws.uniform(-1.0, 1.0), "yaw_moment": 3e3 * draws.uniform(-1.0, 1.0)}
            numbers = tuple(car._replace(**push))
        state = (share * draws.uniform(-1.0, 1.0, len(sizes) + len(own)) * np.array([*sizes, *own])).tolist()
        command = (share * 1.5 * draws.uniform(-1.0, 1.0, 2) * limits).tolist()
        cases["limited"].append([*command, *numbers])
        cases["substep"].append([*state, *command, *numbers, plant.timestep])
        cases["control_step"].append([*state, *command, *numbers, plant.timestep, LONG if k % 8 == 4 else SUBSTEPS])
        cases["axles"].append([*state, *numbers])
        if own:
            cases["settled"].append([*state[: len(sizes)], *numbers])
    return Library(
        name,
        (f"The single-track model: {plant}.",),
        found,
        {"exported_car": car, "exported_timestep": plant.timestep},
        {"exported_car": "car"},
        cases,
    )
