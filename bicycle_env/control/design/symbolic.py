"""The package's one source of physics in CasADi's symbols, for controllers that optimise. Imports CasADi when asked."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

from bicycle_env.control.policy import Plant
from bicycle_env.installation import needs
from bicycle_env.physics import elementary
from bicycle_env.physics.car import CarParameters, CarState, car_on_road
from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.model import Model


def casadi() -> Any:
    """The module; ModuleNotFoundError with the install line where it is missing."""
    try:
        import casadi
    except ImportError:
        raise ModuleNotFoundError(needs("model-predictive control", "CasADi", "mpc"), name="casadi") from None
    return casadi


@functools.cache
def casadi_namespace() -> Any:
    """The elementary functions on CasADi's symbols.

    They are CasADi's own, with which the package's agree to 3e-15: in an expression graph each is one node with a
    known derivative, where the package's polynomials would be dozens.
    """
    ca = casadi()
    xp = elementary.namespace("casadi", ca.if_else, ca.floor, sqrt=ca.sqrt)
    xp.minimum, xp.maximum = ca.fmin, ca.fmax
    xp.sin = xp.near_sin = ca.sin
    xp.cos = xp.near_cos = ca.cos
    xp.tan, xp.atan, xp.tanh = ca.tan, ca.atan, ca.tanh
    return xp


def control_step(plant: Plant, substeps: int) -> Any:
    """A ``casadi.Function`` (state (6), action) -> state from one action to the next: the nonlinear car, its actuators.

    States are ``STATE_NAMES``, the action is that of the steered axles in [-1, 1]; RK4 with `substeps` steps. The
    actuators have their lags, but no rate limits: those have a corner, and are constraints to whoever optimises.
    """
    ca = casadi()
    state, action = ca.SX.sym("state", 6), ca.SX.sym("action", plant.action_space.shape[-1])
    wheels = commands(plant, action)
    moved = advanced(plant, substeps, plant.action_timestep, state, wheels, plant.speed, plant.friction)
    return ca.Function("control_step", [state, action], [moved], ["state", "action"], ["next"])


def commands(plant: Plant, action: Any) -> list[Any]:
    """The commands [rad] at the front and rear wheels that an action sends; 0 for an axle that is not steered."""
    found: list[Any] = [casadi().SX(0.0), casadi().SX(0.0)]
    for k, axle in enumerate(steered_axles(plant)):
        found[axle] = action[k] * (plant.front_actuator, plant.rear_actuator)[axle].angle_limit
    return found


def advanced(
    plant: Plant, substeps: int, timestep: float, state: Any, held: Sequence[Any], speed: Any, friction: Any
) -> Any:
    """The state (6) after a timestep [s], as ``control_step``, with two commands [rad] held; symbols or numbers."""
    ca, xp = casadi(), casadi_namespace()
    advance = rk4(xp, CarState, plant.model.quasi_static.actuated_rates(xp))
    actuators = (plant.front_actuator, plant.rear_actuator)
    unlimited = [dataclasses.replace(actuator, rate_limit=math.inf) for actuator in actuators]
    car = car_on_road(plant.vehicle, speed, friction, unlimited[0], unlimited[1])
    moving, inputs = CarState(ca.SX(0.0), *ca.vertsplit(state)), tuple(held)
    for _ in range(substeps):
        moving = advance(moving, inputs, inputs, inputs, car, timestep / substeps)
    return ca.vertcat(*moving[1:])


def steered_axles(plant: Plant) -> tuple[int, ...]:
    """The axles that actions steer, in their order: 0 front, 1 rear."""
    return {"front": (0,), "rear": (1,), "both": (0, 1)}[plant.steer]


def continuous(model: Model, car: CarParameters) -> Any:
    """A ``casadi.Function`` x' = f(x, u): the state by the model's names, u the two commands [rad]; no rate limits."""
    ca, xp = casadi(), casadi_namespace()
    rates = model.actuated_rates(xp)
    state, command = ca.SX.sym("state", len(model.State._fields)), ca.SX.sym("command", 2)
    unlimited = car._replace(front_rate_limit=math.inf, rear_rate_limit=math.inf)
    moving = rates(model.State(*ca.vertsplit(state)), tuple(ca.vertsplit(command)), unlimited)
    return ca.Function("plant", [state, command], [ca.vertcat(*moving)], ["state", "command"], ["rate"])
