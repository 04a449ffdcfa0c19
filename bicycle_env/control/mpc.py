"""Nonlinear model-predictive control: at every step the steering of the next second is optimised anew, with CasADi."""

from __future__ import annotations

import math
import types
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import rk4_map
from bicycle_env.control.design.gains import preview_cost, preview_gain
from bicycle_env.control.design.observation_map import Reading, interpolation
from bicycle_env.control.design.shooting import STATES, Shooting, Stage
from bicycle_env.control.design.symbolic import casadi, control_step
from bicycle_env.control.lqr import Weights, continuous_design_model, cost_matrices, preview_steps, wanted_states
from bicycle_env.control.policy import Array, Plant, Policy
from bicycle_env.control.remembered import Remembered
from bicycle_env.physics.linear_single_track import fastest_rate
from bicycle_env.physics.validation import positive, whole

Matrix = NDArray[np.float64]

SLACKS = 2
"""Inputs beside the actions: by how much the lane [m] and the sideslip [rad] are overstepped."""
SLACK_COST = (300.0, 3000.0)
"""On their squares; the weights of LQR are 1 per m^2 and some 100 per rad^2."""
LANE_MARGIN = 0.25
"""The lane's soft limit is that far inside of the place where the whole body has left the lane, m."""
FIRST_ITERATIONS = 10
"""SQP iterations in the first step of an episode, where there is no plan of the step before."""

OF_THE_PLANT = (
    *("vehicle", "model", "speed", "friction", "steer", "front_actuator", "rear_actuator"),
    *("action_timestep", "substeps", "action_repeat", "action_space"),
)
"""What the problem is built from, so that a copy can build it again."""


class MPC(Policy):
    """Nonlinear MPC: LQR's cost on the nonlinear car, with the actuators' limits and soft limits of lane and sideslip.

    Multiple shooting (``control/design/shooting.py``) over ``horizon`` control steps, with the package's own equations
    in CasADi's symbols. Stage cost and cost beyond the horizon are those of the LQR with preview, so that with no limit
    at work the action is LQR's. Angle and rate limits of the actuators are constraints. Gauss-Newton SQP, one iteration
    a step from the plan of the step before, moved on (M. Diehl, H. G. Bock, J. P. Schloeder, SIAM J. Control Optim. 43,
    2005), with a solver that uses the stages (HPIPM) where CasADi has it.

    It remembers the plan of each car: call ``reset`` when an episode starts. Where the quadratic program cannot be
    solved, the moved plan is driven on; ``failures`` counts these steps of all cars.

    Attributes also: the linear ``model``, and ``gain`` and ``preview`` of the LQR that it comes down to.

    Args:
        weights: as for LQR, by default the tuned ones of the task.
        horizon: control steps.
        iterations: SQP iterations per control step.
        lane_half_width: of the lane around the path, m; its soft limit is where the body has nearly left it.
        sideslip_limit: rad; soft.
        substeps: RK4 steps per control step; by default the fewest that are short beside the fastest mode.

    Raises:
        ValueError, TypeError: an argument out of range.
        ModuleNotFoundError: CasADi is missing.
    """

    name = "mpc"

    def __init__(
        self,
        plant: Plant,
        weights: Weights | None = None,
        horizon: int = 60,
        iterations: int = 1,
        lane_half_width: float = 1.75,
        sideslip_limit: float = 0.6,
        substeps: int | None = None,
    ) -> None:
        self.model = plant.linear_model(quasi_static=True)  # before all else: cars that differ are refused here
        self.horizon, self.iterations = whole("horizon", horizon, 2, 1000), whole("iterations", iterations)
        lane_limit = positive("lane_half_width", lane_half_width) + 0.5 * plant.vehicle.body_width - LANE_MARGIN
        sideslip_limit = positive("sideslip_limit", sideslip_limit)
        substeps = fewest_substeps(plant) if substeps is None else whole("substeps", substeps)
        timestep = plant.action_timestep

        continuous = continuous_design_model(plant)
        A, B = rk4_map(continuous.A, continuous.B, timestep, substeps)
        self.model = self.model._replace(A=A, B=B)
        self._Q, self._R = cost_matrices(plant, weights, plant.speed)
        self._reading = Reading(plant)
        ahead = preview_steps(self._reading.times, timestep)
        self._wanted = wanted_states(plant.speed * timestep, timestep, ahead)
        # The preview in each step of the horizon: moved on, its last value held
        self._shown = np.minimum(np.arange(self.horizon + 1)[:, None] + np.arange(ahead + 1), ahead)
        self._per_step = interpolation(self._reading.times, np.linspace(0.0, ahead * timestep, ahead + 1))
        self._P, self._S = preview_cost(A, B, self._Q, self._R, self._wanted, ahead)
        self.gain, path_gain = preview_gain(A, B, self._Q, self._R, self._wanted, ahead)
        self.preview = path_gain @ self._per_step

        self._axles = len(self.model.input_names)
        car: Any = types.SimpleNamespace(**{name: getattr(plant, name) for name in OF_THE_PLANT})
        self._problem = car, lane_limit, sideslip_limit, substeps
        self._build(*self._problem)
        self._remembered = Remembered(
            self.horizon * self._shooting.width + STATES + 1
        )  # the plan, and 1 once there is one
        self._plans = np.empty((0, 0))
        self.failures = 0

    def __getstate__(self) -> dict[str, Any]:
        """All but what CasADi has built: not each of its solvers can be pickled, and it is built again."""
        return {name: value for name, value in self.__dict__.items() if name != "_shooting"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._build(*self._problem)

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self._remembered.reset(rows)
        self._plans = self._plans[:0] if rows is None else self._plans

    def act(self, observation: Array) -> NDArray[np.float32]:
        cars = np.atleast_2d(np.asarray(observation, np.float64)) * self._reading.scale
        memory = self._remembered.of(len(cars))
        actions = np.empty((len(cars), self._axles), np.float32)
        for car, remembered, action in zip(cars, memory, actions, strict=True):
            plan = self._optimised(car, None if remembered[-1] == 0.0 else remembered[:-1])
            remembered[:-1], remembered[-1] = plan, 1.0
            action[:] = np.clip(plan[STATES : STATES + self._axles], -1.0, 1.0)
        self._plans = memory[:, :-1]
        return actions.reshape(*np.shape(observation)[:-1], self._axles)

    def planned(self, row: int = 0) -> tuple[Matrix, Matrix]:
        """What a car is to do: states (horizon + 1, 6), lateral positions from its own, and actions (horizon, axles).

        Raises IndexError where no such car was driven since the last reset.
        """
        return self._shooting.stages(self._plans[row])

    def _optimised(self, car: Matrix, before: Matrix | None) -> Matrix:
        """The plan of one car, an observation in SI units, from its plan of the step before."""
        state, points = car @ self._reading.state, car @ self._reading.path
        shown = (self._per_step @ points)[self._shown]
        reference = shown @ self._wanted.T
        parameters = np.concatenate([state, reference.ravel(), self._S @ shown[-1]])
        plan = self._first_guess(state, points, reference) if before is None else self._moved_on(before, state)
        iterations = FIRST_ITERATIONS if before is None else self.iterations
        plan, solved = self._shooting.improved(plan, parameters, iterations)
        self.failures += not solved
        return plan

    def _first_guess(self, state: Matrix, points: Matrix, reference: Matrix) -> Matrix:
        """The state decays to the path; the first action is that of LQR, the others are 0."""
        decay = 0.95 ** np.arange(self.horizon + 1)
        plan = self._shooting.of_states(reference + decay[:, None] * (state - reference[0]))
        plan[STATES : STATES + self._axles] = np.clip(-self.gain @ state - self.preview @ points, -1.0, 1.0)
        return plan

    def _moved_on(self, plan: Matrix, state: Matrix) -> Matrix:
        """The plan of the step before, a step later, seen from the car's new place."""
        stage = self._shooting.width
        seen = plan.copy()
        seen[::stage] -= plan[stage]
        return self._shooting.moved_on(seen, state)

    def _build(self, plant: Plant, lane_limit: float, sideslip_limit: float, substeps: int) -> None:
        """What is asked, stage by stage."""
        ca, N, next_state = casadi(), self.horizon, control_step(plant, substeps)
        start, beyond = ca.SX.sym("start", STATES), ca.SX.sym("beyond", STATES)
        reference = ca.SX.sym("reference", STATES, N + 1)

        def stage(k: int, state: Any, action: Any, slack: Any) -> Stage:
            away = state - reference[:, k]
            cost = ca.bilin(self._Q, away, away) + ca.bilin(self._R, action, action)
            soft = (away[0], lane_limit), (state[2] / plant.speed, sideslip_limit)
            for j in range(SLACKS):
                cost += SLACK_COST[j] * slack[j] ** 2
            return Stage(cost, tuple((value - slack[j], -limit, limit) for j, (value, limit) in enumerate(soft)))

        self._shooting = Shooting(
            plant,
            N,
            plant.action_timestep,
            SLACKS,
            ca.vertcat(start, ca.vec(reference), beyond),
            lambda _, state, action: next_state(state, action),
            stage,
            lambda state: ca.bilin(self._P, state, state) + 2.0 * ca.dot(beyond, state),
        )


def fewest_substeps(plant: Plant) -> int:
    """RK4 steps per control step with timestep x fastest mode <= 1/2, but not more than the plant's."""
    lags = (1.0 / plant.front_actuator.time_constant, 1.0 / plant.rear_actuator.time_constant)
    fastest = max(fastest_rate(plant.vehicle, plant.speed), *lags)
    return min(plant.substeps * plant.action_repeat, math.ceil(2.0 * plant.action_timestep * fastest))
