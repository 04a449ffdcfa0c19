"""What an optimum saves: controllers tuned for an environment, and steering found by search in the true simulator.

It stands on top of envs and control; nothing below imports it.
"""

from __future__ import annotations

from bicycle_env.optimum.active_steer_mpc import ActiveSteerMPC
from bicycle_env.optimum.corridor_mpc import DoubleLaneChangeMPC, EvadeMPC
from bicycle_env.optimum.outcomes import Cars, Outcome, Outcomes, by, drive, make_cars, replay
from bicycle_env.optimum.parameter_search import OwnParameters, draws_of, search_parameters
from bicycle_env.optimum.plan_search import Planned, search_plan
from bicycle_env.optimum.predictive import HOLD, Knowledge, Predictive
from bicycle_env.optimum.steering_search import Rescue, search_steering
from bicycle_env.optimum.tuning import Budget, Candidate, Space, Tuning, budget, tune

PREDICTIVE: dict[str, type[Predictive]] = {
    "BicycleActiveSteer-v0": ActiveSteerMPC,
    "BicycleDoubleLaneChange-v0": DoubleLaneChangeMPC,
    "BicycleEvade-v0": EvadeMPC,
}
"""By the id that a controller is made for."""

__all__ = [
    "HOLD",
    "PREDICTIVE",
    "ActiveSteerMPC",
    "Budget",
    "Candidate",
    "Cars",
    "DoubleLaneChangeMPC",
    "EvadeMPC",
    "Knowledge",
    "Outcome",
    "Outcomes",
    "OwnParameters",
    "Planned",
    "Predictive",
    "Rescue",
    "Space",
    "Tuning",
    "budget",
    "by",
    "draws_of",
    "drive",
    "make_cars",
    "replay",
    "search_parameters",
    "search_plan",
    "search_steering",
    "tune",
]
