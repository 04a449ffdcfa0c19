"""MPC that keeps the body in a corridor: BicycleEvade-v0 and BicycleDoubleLaneChange-v0."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES, rk4_map
from bicycle_env.control import Parameter
from bicycle_env.control.design.gains import discrete_gain
from bicycle_env.control.design.shooting import STATES, Shooting, Stage, wheel_reach
from bicycle_env.control.design.symbolic import advanced, casadi, commands
from bicycle_env.control.lqr import WeightedPolicy, continuous_design_model, weights_of
from bicycle_env.optimum.predictive import SUBSTEPS, Knowledge, Predictive
from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.tasks import double_lane_change, evade

Matrix = NDArray[np.float64]

GATE_COST = 1000.0
"""Per m^2 by which the corridor, less its margin, is overstepped."""


class CorridorMPC(Predictive):
    """LQR's cost on a wanted motion, and a corridor that no point of the body is to leave, as far as can be.

    Along both sides of the body the task's ``judged_points`` are kept `margin` within the corridor, softly, as it is
    where the plan before passes. LQR's cost to go about the last wanted state stands for what is beyond the horizon.
    """

    margin: ClassVar[Parameter] = Parameter("margin", 0.0, 1.0, 0.1, 0.05)
    """m."""
    damping: ClassVar[float]
    """Of the shooting problem."""

    def __init__(self, plant: Any) -> None:
        self._reference, vehicle = plant.task.reference(NUMPY), plant.vehicle
        self._forward = np.linspace(vehicle.front_extent, -vehicle.rear_extent, plant.task.judged_points)
        self._half_width = 0.5 * vehicle.body_width
        self._late = sum(name.startswith("front_action_") for name in plant.task.TaskState._fields)
        super().__init__(plant)
        continuous = continuous_design_model(plant)
        self._linear = rk4_map(continuous.A, continuous.B, self.timestep, SUBSTEPS)
        self._inputs = continuous.input_names

    def _built(self) -> Shooting:
        ca, N, plant, points = casadi(), self.horizon, self.plant, len(self._forward)
        axles = plant.action_space.shape[-1]
        friction, P = ca.SX.sym("friction"), ca.SX.sym("P", STATES, STATES)
        Q, R = ca.SX.sym("Q", STATES), ca.SX.sym("R", axles)
        wanted = ca.SX.sym("wanted", STATES, N + 1)
        low, high = (ca.SX.sym(name, points, N) for name in ("low", "high"))
        state, held = ca.SX.sym("state", STATES), ca.SX.sym("held", 2)
        step = plant.control_timestep
        moved = [
            advanced(plant, SUBSTEPS, seconds, state, ca.vertsplit(held), plant.speed, friction)
            for seconds in (self.timestep, step)
        ]
        advance = ca.Function("stage", [state, held, friction], moved[:1])
        self._control_step = ca.Function("step", [state, held, friction], moved[1:])

        def stage(k: int, state: Any, action: Any, slack: Any) -> Stage:
            away = state - wanted[:, k]
            cost = ca.dot(Q, away**2) + ca.dot(R, action**2) + GATE_COST * ca.sumsqr(slack)
            across = state[0] + ca.DM(self._forward) * ca.sin(state[1])
            half = self._half_width * ca.cos(state[1])
            left = across + half - slack[0] - high[:, k], -np.inf, 0.0
            right = across - half + slack[1] - low[:, k], 0.0, np.inf
            return Stage(cost, (left, right))

        return Shooting(
            plant,
            N,
            self.timestep,
            2,
            ca.vertcat(ca.SX.sym("start", STATES), friction, ca.vec(P), Q, R, *map(ca.vec, (wanted, low, high))),
            lambda _, state, action: advance(state, ca.vertcat(*commands(plant, action)), friction),
            stage,
            lambda state: ca.bilin(P, state - wanted[:, N], state - wanted[:, N]),
            self.damping,
        )

    @abc.abstractmethod
    def _wanted(self, car: Any, place: Matrix) -> tuple[Matrix, float]:
        """(horizon + 1, 6) where the centre of mass is at `place` [m] along the road; and their lateral weight."""

    def _asked(self, car: Any, states: Matrix | None, values: Matrix, knows: Knowledge) -> tuple[Matrix, Matrix]:
        plant, friction = self.plant, self.friction(car, knows)
        start = np.array([getattr(car, name) for name in STATE_NAMES])
        begin = car.longitudinal_position
        for sent in self._under_way(car):
            begin += plant.control_timestep * self._along(start)
            held = start[4:6] + np.clip(sent - start[4:6], -self._reach, self._reach)
            start = np.asarray(self._control_step(start, held, friction)).ravel()
        states = np.tile(start, (self.horizon + 1, 1)) if states is None else states
        speeds = self._along(states.T)
        place = begin + self.timestep * np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]))])
        wanted, lateral = self._wanted(car, place)
        low, high = self._corridor(car, place, states[:, 1], float(values[-1]))
        weights = weights_of(self.searched[:-1], values[:-1])
        Q, R = weights.matrices(plant.speed, self._inputs)
        P = discrete_gain(*self._linear, Q, R)[1]
        Q[0, 0] = lateral
        limits = low[:, :-1].T.ravel(), high[:, :-1].T.ravel()
        return start, np.concatenate([[friction], P.ravel(), np.diag(Q), np.diag(R), wanted.ravel(), *limits])

    def _under_way(self, car: Any) -> Iterator[Matrix]:
        """The commands [rad] that were given and have not acted yet, the oldest first."""
        limits = np.array([self.plant.front_actuator.angle_limit, self.plant.rear_actuator.angle_limit])
        for k in range(self._late, 0, -1):
            yield limits * (getattr(car, f"front_action_{k}"), getattr(car, f"rear_action_{k}"))

    @property
    def _reach(self) -> Matrix:
        actuators = self.plant.front_actuator, self.plant.rear_actuator
        return np.array([wheel_reach(one, self.plant.control_timestep) for one in actuators])

    def _along(self, states: Matrix) -> Any:
        """m/s along the road, of states (6, ...)."""
        return self.plant.speed * np.cos(states[1]) - states[2] * np.sin(states[1])

    def _corridor(self, car: Any, place: Matrix, heading: Matrix, margin: float) -> tuple[Matrix, Matrix]:
        """(points, stages) each: between what the points may be, the narrowest until halfway to the next stages."""
        along = place + self._forward[:, None] * np.cos(heading)
        near = 0.5 * self.timestep * self.plant.speed
        zero = np.zeros(along.shape)
        lows, highs = [], []
        for x in (along - near, along, along + near):
            there = self._reference(CarState(x, *[zero] * STATES), car, self.world)
            lows.append(there.road_centre - there.road_half_width + margin)
            highs.append(there.road_centre + there.road_half_width - margin)
        return np.max(lows, axis=0), np.min(highs, axis=0)


def _lqr_weights(starts: dict[str, float], spread: float = 0.3) -> tuple[Parameter, ...]:
    """LQR's parameters from other beginnings."""
    return tuple(
        dataclasses.replace(one, least=1e-3, greatest=1e5, start=starts[one.name], spread=spread)
        for one in WeightedPolicy.parameters
        if one.name in starts
    )


class EvadeMPC(CorridorMPC):
    """BicycleEvade-v0: before the obstacle's end into the other lane, then into the own one; when is the plan's to say.

    The lateral position costs something at the end of the horizon alone.
    """

    horizon = 50
    damping = 30.0  # with 3 the iterations do not settle on a slippery road
    parameters = (
        *_lqr_weights({"heading": 20.0, "sideslip": 100.0, "yaw_rate": 0.1, "front_command": 0.5, "rear_command": 0.5}),
        CorridorMPC.margin,
    )

    def _wanted(self, car: Any, place: Matrix) -> tuple[Matrix, float]:
        wanted = np.zeros((len(place), STATES))
        until = evade.places(NUMPY)(car, self.world.car).end
        wanted[:, 0] = np.where(place < until, evade.LANE_WIDTH * car.side, 0.0)
        return wanted, 0.0


class DoubleLaneChangeMPC(CorridorMPC):
    """BicycleDoubleLaneChange-v0: the path, known ahead, and the cones."""

    horizon = 40
    damping = 1.0
    parameters = (
        *_lqr_weights({"heading": 100.0, "sideslip": 1e3, "yaw_rate": 0.3, "front_command": 0.3, "rear_command": 0.4}),
        CorridorMPC.margin,
    )

    def _wanted(self, car: Any, place: Matrix) -> tuple[Matrix, float]:
        wanted = np.zeros((len(place), STATES))
        wanted[:, 0], slope = double_lane_change.path(NUMPY)(place, car, self.world)
        wanted[:, 1] = np.arctan(slope)
        wanted[:, 3] = np.gradient(wanted[:, 1], self.timestep)
        return wanted, 1.0
