"""Closed forms of Karnopp, Vehicle Stability, ch. 6: stability, balance, linear models."""

from bicycle_env.analysis.stability import (
    Stability,
    characteristic_polynomial,
    characteristic_speed,
    critical_speed,
    eigenvalues,
    input_matrix,
    is_stable,
    stability,
    stability_criterion,
    state_matrix,
    static_margin,
    steady_state_gain,
    tangent_speed,
    understeer_gradient,
)

__all__ = [
    "Stability",
    "characteristic_polynomial",
    "characteristic_speed",
    "critical_speed",
    "eigenvalues",
    "input_matrix",
    "is_stable",
    "stability",
    "stability_criterion",
    "state_matrix",
    "static_margin",
    "steady_state_gain",
    "tangent_speed",
    "understeer_gradient",
]
