"""Closed forms of Karnopp, Vehicle Stability, ch. 6: stability, balance, linear models. Nonlinear steady states."""

from bicycle_env.analysis.branches import Bifurcation, EquilibriumBranch, equilibrium_branches
from bicycle_env.analysis.equilibria import Equilibrium, equilibria
from bicycle_env.analysis.handling import HandlingCurve, HandlingDiagram, handling_diagram, steer_for_turn
from bicycle_env.analysis.inertial import (
    InertialMatrices,
    WheelSlips,
    inertial_matrices,
    inertial_state_matrix,
    wheel_slip_angles,
)
from bicycle_env.analysis.nonlinear_model import Jacobians, jacobians
from bicycle_env.analysis.phase_plane import Manifold, Orbit, PhasePortrait, phase_portrait
from bicycle_env.analysis.recovery import IntractableError, RecoverableSet, recoverable_set
from bicycle_env.analysis.stability import (
    Modes,
    Stability,
    characteristic_polynomial,
    characteristic_speed,
    classification,
    critical_speed,
    eigenvalues,
    input_matrix,
    is_stable,
    modes,
    stability,
    stability_criterion,
    state_matrix,
    static_margin,
    steady_state_gain,
    tangent_speed,
    understeer_gradient,
)
from bicycle_env.analysis.transfer_functions import (
    is_minimum_phase,
    state_space,
    transfer_function,
    transfer_matrix,
    zeros,
)

__all__ = [
    "Bifurcation",
    "Equilibrium",
    "EquilibriumBranch",
    "HandlingCurve",
    "HandlingDiagram",
    "InertialMatrices",
    "IntractableError",
    "Jacobians",
    "Manifold",
    "Modes",
    "Orbit",
    "PhasePortrait",
    "RecoverableSet",
    "Stability",
    "WheelSlips",
    "characteristic_polynomial",
    "characteristic_speed",
    "classification",
    "critical_speed",
    "eigenvalues",
    "equilibria",
    "equilibrium_branches",
    "handling_diagram",
    "inertial_matrices",
    "inertial_state_matrix",
    "input_matrix",
    "is_minimum_phase",
    "is_stable",
    "jacobians",
    "modes",
    "phase_portrait",
    "recoverable_set",
    "stability",
    "stability_criterion",
    "state_matrix",
    "state_space",
    "static_margin",
    "steady_state_gain",
    "steer_for_turn",
    "tangent_speed",
    "transfer_function",
    "transfer_matrix",
    "understeer_gradient",
    "wheel_slip_angles",
    "zeros",
]
