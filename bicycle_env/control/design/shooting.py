"""Optimal steering over a horizon by direct multiple shooting, whatever is asked of the car."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.control.design.symbolic import casadi, steered_axles
from bicycle_env.control.policy import Plant

Matrix = NDArray[np.float64]

STATES = len(STATE_NAMES)


class Stage(NamedTuple):
    """What is asked of one stage, in CasADi's symbols."""

    cost: Any
    """At most quadratic in the plan; how depends on the parameters alone."""
    bounded: tuple[tuple[Any, float, float], ...]
    """Expressions and their bounds."""


class Shooting:
    """Stages of the car's motion, its actuators' limits, what is asked, and the quadratic programs of Gauss-Newton SQP.

    Direct multiple shooting (H. G. Bock, K. J. Plitt, IFAC World Congress 1984). A plan is a vector: of each stage
    states (6), actions and slacks, then the last states.

    Args:
        plant: whose actuators' angle and rate limits hold.
        horizon: stages.
        timestep: of a stage, s; an action is held for it.
        slacks: inputs of a stage beside the actions, without bounds: by how much soft limits are overstepped.
        parameters: CasADi's symbol of all that differs between two problems; the first six are where the car is.
        advance: ``advance(k, state, action)``: the states a stage later.
        stage: ``stage(k, state, action, slack) -> Stage``.
        last: ``last(state)``: the cost beyond the horizon.
        damping: of a plan's change per iteration, on the squared change of each action (Levenberg and Marquardt):
            where tires saturate, full Gauss-Newton steps go to and fro. With 0 none.
    """

    def __init__(
        self,
        plant: Plant,
        horizon: int,
        timestep: float,
        slacks: int,
        parameters: Any,
        advance: Callable[[int, Any, Any], Any],
        stage: Callable[[int, Any, Any, Any], Stage],
        last: Callable[[Any], Any],
        damping: float = 0.0,
    ) -> None:
        ca, N, axles = casadi(), horizon, steered_axles(plant)
        self.horizon, self.axles, self.width = N, len(axles), STATES + len(axles) + slacks
        actuators = [(plant.front_actuator, plant.rear_actuator)[axle] for axle in axles]
        wheels = [STATE_NAMES.index(("front_steer", "rear_steer")[axle]) for axle in axles]
        states = [ca.SX.sym(f"state_{k}", STATES) for k in range(N + 1)]
        inputs = [ca.SX.sym(f"input_{k}", len(axles) + slacks) for k in range(N)]
        cost = last(states[N])
        rows: list[tuple[Any, float, float]] = []  # what is bounded, and the bounds
        for k in range(N):
            state, action, slack = states[k], inputs[k][: len(axles)], inputs[k][len(axles) :]
            # HPIPM recognises the stages by this order: dynamics first, then what holds within the stage.
            rows.append((states[k + 1] - advance(k, state, action), 0.0, 0.0))
            if k == 0:
                rows.append((state - parameters[:STATES], 0.0, 0.0))
            for j, actuator in enumerate(actuators):
                if math.isfinite(actuator.rate_limit):
                    reach = wheel_reach(actuator, timestep)
                    rows.append((action[j] * actuator.angle_limit - state[wheels[j]], -reach, reach))
            asked = stage(k, state, action, slack)
            cost += asked.cost
            rows += asked.bounded

        plan = ca.vertcat(*(part for k in range(N) for part in (states[k], inputs[k])), states[N])
        bounded = ca.vertcat(*(what for what, _, _ in rows))
        low, high = ([row[j] for row in rows for _ in range(row[0].shape[0])] for j in (1, 2))
        limits = np.concatenate([np.full(STATES, math.inf), np.ones(len(axles)), np.full(slacks, math.inf)])
        most = np.concatenate([np.tile(limits, N), np.full(STATES, math.inf)])
        self._bounds = np.array(low), np.array(high), -most, most
        # To CasADi |x| has the slope 0 at 0, where the tires have their own: the slopes are taken a nanometre aside.
        slopes = ca.substitute(ca.jacobian(bounded, plan), plan, plan + 1e-9)
        # Gauss-Newton: the cost is quadratic; the curvature of the dynamics is left out.
        curvature = ca.hessian(cost, plan)[0]
        if damping > 0.0:
            damped = np.concatenate([np.zeros(STATES), np.full(len(axles), damping), np.zeros(slacks)])
            curvature += ca.diag(ca.sparsify(ca.DM(np.concatenate([np.tile(damped, N), np.zeros(STATES)]))))
        wanted = [bounded, slopes, ca.gradient(cost, plan), curvature]
        self._linearised = ca.Function("linearised", [plan, parameters], wanted)
        sparsity = {"h": curvature.sparsity(), "a": slopes.sparsity()}
        self.quadratic_program = ca.conic("quadratic_program", *_solver(sparsity))

    def improved(self, plan: Matrix, parameters: Matrix, iterations: int) -> tuple[Matrix, bool]:
        """The plan after so many SQP iterations; False, and the last one solved, where a program cannot be solved."""
        for _ in range(iterations):
            value, slopes, gradient, curvature = self._linearised(plan, parameters)
            value = np.asarray(value).ravel()
            low, high, least, most = self._bounds
            found = self.quadratic_program(
                h=curvature, g=gradient, a=slopes, lba=low - value, uba=high - value, lbx=least - plan, ubx=most - plan
            )
            step = np.asarray(found["x"]).ravel()
            if not (self.quadratic_program.stats()["success"] and np.all(np.isfinite(step))):
                return plan, False
            plan = plan + step
        return plan, True

    def of_states(self, states: Matrix) -> Matrix:
        """A plan of states (horizon + 1, 6), all else 0."""
        stages = np.zeros((self.horizon + 1, self.width))
        stages[:, :STATES] = states
        return stages.ravel()[: self.horizon * self.width + STATES]

    def moved_on(self, plan: Matrix, state: Matrix) -> Matrix:
        """A plan a stage later, its last stage twice; it begins with the state."""
        moved = np.concatenate([plan[self.width : -STATES], plan[-STATES - self.width :]])
        moved[:STATES] = state
        return moved

    def stages(self, plan: Matrix) -> tuple[Matrix, Matrix]:
        """States (horizon + 1, 6) and actions (horizon, axles) of a plan."""
        stages = np.append(plan, np.zeros(self.width - STATES)).reshape(-1, self.width)
        return stages[:, :STATES], stages[:-1, STATES : STATES + self.axles]


def wheel_reach(actuator: Any, timestep: float) -> float:
    """rad: a command that far from the wheel moves it, by the lag, as far in a step as the rate limit would."""
    return float(actuator.rate_limit * timestep / -math.expm1(-timestep / actuator.time_constant))


def _solver(sparsity: dict[str, Any]) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """Name, sparsity and options of CasADi's solver for the quadratic programs."""
    if casadi().has_conic("hpipm"):
        # Residuals of states, actions and constraints: far below what the wheels and the road notice.
        residuals = dict.fromkeys(("res_g_max", "res_b_max", "res_d_max", "res_m_max"), 1e-6)
        return "hpipm", sparsity, {"error_on_fail": False, "hpipm": {"iter_max": 50, **residuals}}
    return "qrqp", sparsity, {"error_on_fail": False, "print_iter": False, "print_header": False, "print_info": False}
