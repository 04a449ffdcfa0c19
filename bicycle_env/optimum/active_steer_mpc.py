"""MPC of BicycleActiveSteer-v0: the reference yaw rate is followed and the displacement kept."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.control import Parameter
from bicycle_env.control.design.shooting import STATES, Shooting, Stage, wheel_reach
from bicycle_env.control.design.symbolic import advanced, casadi, commands
from bicycle_env.optimum.predictive import HOLD, SUBSTEPS, Knowledge, Predictive
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.tasks.active_steer import Script
from bicycle_env.tasks.drivers import SineWithDwell
from bicycle_env.tasks.fmvss126 import BEGIN, DISPLACEMENT_TIME, ROUNDING, since_finish
from bicycle_env.tasks.steadiness import SETTLING, reference_yaw_rate

Matrix = NDArray[np.float64]

FREE_SIDESLIP = 0.05
"""rad, as the reward has it."""
COMMAND_COST = 1e-4
"""On the squared action: next to nothing."""
DISPLACEMENT_COST = 30.0
"""Per m^2 that is missing."""
NO_LIMIT = 1e3
"""m."""


class ActiveSteerMPC(Predictive):
    """BicycleActiveSteer-v0's rear wheels: the reference yaw rate is followed, the front wheels do as the driver wants.

    Cost of a stage: (r - r_ref)^2, and by weights the sideslip beyond 0.05 rad, how far the action is from where the
    wheels are (their rate), and after the driver, who may be known to finish, yaw rate and sideslip; `final` times as
    much at the horizon. When it is judged, `displacement` times that of the twin, driven on in the model, is a soft
    limit.
    """

    horizon = 40
    parameters = (
        Parameter("sideslip", 0.01, 1e3, 0.5, 0.4, "log"),
        Parameter("rate", 1e-6, 1.0, 1e-3, 0.4, "log"),
        Parameter("after", 0.01, 1e3, 10.0, 0.4, "log"),
        Parameter("final", 0.1, 1e3, 30.0, 0.4, "log"),
        Parameter("displacement", 0.0, 2.0, 0.9, 0.05),
    )

    def _built(self) -> Shooting:
        ca, N, plant = casadi(), self.horizon, self.plant
        weights, known = ca.SX.sym("weights", len(self.parameters) - 1), ca.SX.sym("known", 2)
        sideslip_weight, rate_weight, after_weight, final = ca.vertsplit(weights)
        speed, _ = ca.vertsplit(known)
        command, reference, after = (ca.SX.sym(name, N + 1) for name in ("command", "reference", "after"))
        least, judged = ca.SX.sym("least", N), ca.SX.sym("judged", 2)  # m; the side, and s from the stage before
        self._wanted = reference_yaw_rate(NUMPY)
        self._script = SineWithDwell().law(NUMPY, plant.task.reference(NUMPY))
        state, fixed = ca.SX.sym("state", STATES), ca.SX.sym("fixed", 4)
        angle, rear, its_speed, its_friction = ca.vertsplit(fixed)
        held = commands(plant, ca.SX(1) * rear)
        held[0] = angle
        moved = advanced(plant, SUBSTEPS, self.timestep, state, held, its_speed, its_friction)
        self._advance = advance = ca.Function("stage", [state, fixed], [moved])

        def followed(k: int, state: Any) -> Any:
            sideslip = state[2] / speed
            settling = after_weight * after[k] * (state[3] ** 2 + sideslip**2)
            return (state[3] - reference[k]) ** 2 + settling

        def stage(k: int, state: Any, action: Any, slack: Any) -> Stage:
            rate = action[0] - state[5] / plant.rear_actuator.angle_limit
            cost = followed(k, state) + sideslip_weight * slack[0] ** 2 + rate_weight * rate**2
            cost += COMMAND_COST * action[0] ** 2 + DISPLACEMENT_COST * slack[1] ** 2
            there = state[0] + judged[1] * (speed * ca.sin(state[1]) + state[2] * ca.cos(state[1]))
            slips = state[2] / speed - slack[0], -FREE_SIDESLIP, FREE_SIDESLIP
            return Stage(cost, (slips, (judged[0] * there + slack[1] - least[k], 0.0, np.inf)))

        return Shooting(
            plant,
            N,
            self.timestep,
            2,
            ca.vertcat(ca.SX.sym("start", STATES), weights, known, command, reference, after, least, judged),
            lambda k, state, action: advance(state, ca.vertcat(command[k], action, known)),
            stage,
            lambda state: final * (followed(N, state) + sideslip_weight * (state[2] / speed) ** 2),
        )

    def _asked(self, car: Any, states: Matrix | None, values: Matrix, knows: Knowledge) -> tuple[Matrix, Matrix]:
        del states  # it is asked for the same wherever the car will be
        steps, step = HOLD * (self.horizon + 1), self.plant.control_timestep
        times = car.time + step * np.arange(steps)
        command = np.full(steps, car.driver_command)
        if knows.command:
            numbers = Script(car.amplitude, car.frequency, car.dwell, BEGIN)
            most = self.plant.front_actuator.angle_limit
            command = np.clip(car.side * self._script(None, None, times, numbers, None), -most, most)
        late = since_finish(car, times[::HOLD])
        finished = knows.command or late[0] > -ROUNDING
        after = np.clip(late / SETTLING, 0.0, 1.0) * finished
        command = command.reshape(-1, HOLD).mean(axis=1)
        friction, front = self.friction(car, knows), np.empty(self.horizon + 1)
        front[0] = car.front_steer
        actuator = self.plant.front_actuator
        reach = wheel_reach(actuator, self.timestep)
        share = -math.expm1(-self.timestep / actuator.time_constant)
        for k, wanted in enumerate(command[:-1]):
            front[k + 1] = front[k] + share * np.clip(wanted - front[k], -reach, reach)
        relative = friction / self.plant.friction
        own = car._replace(twin_front_steer=front, relative_friction=relative)
        reference = self._wanted(own, self.world.car)
        start = np.array([getattr(car, name) for name in STATE_NAMES])
        known = np.array([car.speed, friction])
        lead, least = self._displacement(car, command, known, float(values[-1]))
        numbers = (values[:-1], known, command, reference, after, least, [car.side, lead])
        return start, np.concatenate(numbers)

    def _displacement(self, car: Any, command: Matrix, known: Matrix, share: float) -> tuple[float, Matrix]:
        """How long after a stage it is judged, s, and the least in each stage, m; no limit in all but one."""
        least = np.full(self.horizon, -NO_LIMIT)
        until = BEGIN + DISPLACEMENT_TIME - ROUNDING - car.time
        stage, lead = divmod(until, self.timestep)
        if 0.0 <= stage < self.horizon:
            names = ("lateral_position", "heading", "lateral_velocity", "yaw_rate", "front_steer")
            twin = np.array([*(getattr(car, f"twin_{name}") for name in names), 0.0])
            for k in range(int(stage)):
                twin = np.asarray(self._advance(twin, [command[k], 0.0, *known])).ravel()
            there = twin[0] + lead * (car.speed * np.sin(twin[1]) + twin[2] * np.cos(twin[1]))
            least[int(stage)] = max(share * car.side * there, 0.0)
        return lead, least
