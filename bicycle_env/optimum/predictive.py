"""MPC that is told more than a policy sees: what does planning ahead save, and what is knowing the hidden worth?

Controllers of an experiment. They start from the TRUE state, whatever an id shows; of friction and of the driver's
future they know what a :class:`Knowledge` says. Each holds what its task asks for: ``ActiveSteerMPC`` the reference yaw
rate, the others a corridor as soft constraints on points of the body. They plan on stages of ``HOLD`` control steps and
hold an action as long; actions that are still under way are known, and the plan begins where they lead.
"""

from __future__ import annotations

import abc
import time
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control import Parameter, searched
from bicycle_env.control.design.shooting import STATES, Shooting
from bicycle_env.optimum.outcomes import Act, Array
from bicycle_env.tasks.episode import World

Matrix = NDArray[np.float64]

HOLD = 2
"""Control steps of a stage, and until the next plan."""
SUBSTEPS = 1
"""RK4 steps of a stage of 0.04 s: the fastest mode, a wheel's, decays in 0.05 s, which is followed to 0.1 %."""
FIRST_ITERATIONS, ITERATIONS = 10, 1
"""SQP iterations of an episode's first plan and of all others."""


class Knowledge(NamedTuple):
    """What a controller is told beside the state."""

    friction: bool = False
    """The true one; False: it plans with the nominal one."""
    command: bool = False
    """What the driver will do; False: he is taken to hold the wheel where it is."""


class Predictive(abc.ABC):
    """Base: drives the cars of a native vector environment, each by a plan of its own.

    Args:
        plant: the single environment.

    Attributes: ``searched``, the parameters that count for the plant; ``plans``, how many were made, ``failures``, of
    how many the quadratic program could not be solved (the plan before is driven on), and ``seconds`` of the processor
    that they took.
    """

    parameters: ClassVar[tuple[Parameter, ...]]
    """The weights, as those of tunable controllers."""
    horizon: ClassVar[int]
    """Stages."""

    def __init__(self, plant: Any) -> None:
        configuration = plant.configuration
        self.plant, self.timestep = plant, HOLD * plant.control_timestep
        self.world = World(configuration.car, plant.rules, configuration.settings)
        own: Any = type(self)
        self.searched: tuple[Parameter, ...] = searched(own, plant)
        self.plans, self.failures, self.seconds = 0, 0, 0.0
        self._shooting = self._built()

    @abc.abstractmethod
    def _built(self) -> Shooting:
        """The problem, in symbols."""

    @abc.abstractmethod
    def _asked(self, car: Any, states: Matrix | None, values: Matrix, knows: Knowledge) -> tuple[Matrix, Matrix]:
        """The state in which the plan begins (6,), and the problem's parameters after it.

        Args:
            car: the environment's state, one car's.
            states: (horizon + 1, 6) of the plan so far; None without one.
            values: of ``searched``.
        """

    def by(self, cars: Any, values: Matrix, knows: Knowledge) -> Act:
        """For ``drive``: what it does with these weights (parameters,)."""
        vector = cars.unwrapped
        plans: list[Matrix | None] = [None] * vector.num_envs
        actions = np.zeros((vector.num_envs, self._shooting.axles), np.float32)

        def act(_: Array, step: int) -> Array:
            if step % HOLD == 0:
                state, begin = vector.state, time.process_time()
                now = (step - 0.5) * vector.control_timestep  # the clock of a car that has ended stands still
                for row in np.flatnonzero(state.time > now):
                    plan = self.plan(type(state)(*(float(column[row]) for column in state)), plans[row], values, knows)
                    plans[row] = plan
                    actions[row] = np.clip(plan[STATES : STATES + self._shooting.axles], -1.0, 1.0)
                self.seconds += time.process_time() - begin
            return actions

        return act

    def plan(self, car: Any, before: Matrix | None, values: Matrix, knows: Knowledge) -> Matrix:
        """A car's plan from its state and its plan a stage before, None at the start; see ``stages``."""
        shooting, states = self._shooting, None
        if before is not None:
            before = shooting.moved_on(before, before[shooting.width : shooting.width + STATES])
            states = shooting.stages(before)[0]
        start, asked = self._asked(car, states, values, knows)
        if before is None:
            before = shooting.of_states(np.tile(start, (self.horizon + 1, 1)))
        before[:STATES] = start
        iterations = FIRST_ITERATIONS if states is None else ITERATIONS
        plan, solved = shooting.improved(before, np.concatenate([start, asked]), iterations)
        self.plans, self.failures = self.plans + 1, self.failures + (not solved)
        return plan

    def stages(self, plan: Matrix) -> tuple[Matrix, Matrix]:
        """States (horizon + 1, 6), and actions (horizon, axles)."""
        return self._shooting.stages(plan)

    def friction(self, car: Any, knows: Knowledge) -> float:
        """What it plans with."""
        if not knows.friction:
            return float(self.plant.friction)
        drawn = getattr(car, "friction", None)
        return float(self.plant.friction * car.relative_friction if drawn is None else drawn)
