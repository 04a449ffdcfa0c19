"""CommonRoad's vehicle parameters as fields of a ``Vehicle`` (Althoff, Würsching: CommonRoad: Vehicle Models, 2020).

Their single-track model has at each axle the cornering stiffness mu C_S F_z with mu = p_dy1 and C_S = -p_ky1 / p_dy1:
-p_ky1 per rad of the static load. What their other models have (roll, suspension, wheels) has no place here.
"""

from __future__ import annotations

from typing import Any

from bicycle_env.physics.validation import in_range, known_keys, number

P_KY1 = -21.92
"""Of the one set of tires that CommonRoad has for all vehicles (parameters_tire.yaml), 1/rad."""
NEEDED = {
    "m": ("mass", "kg"),
    "I_z": ("yaw_inertia", "kg m^2"),
    "a": ("length", "m, centre of mass to front axle"),
    "b": ("length", "m, centre of mass to rear axle"),
}
MASSLESS = (
    ". Without a mass no force moves a car: such a file, as CommonRoad's vehicle 4 (a truck with its trailer), is for "
    "kinematic models alone"
)
TABLES = ("steering", "longitudinal", "tire", "trailer")
OTHERS = (
    *("l", "w", "T_f", "T_r", "m_s", "m_uf", "m_ur", "I_Phi_s", "I_y_s", "I_xz_s", "K_sf", "K_sdf", "K_sr", "K_sdr"),
    *("K_ras", "K_tsf", "K_tsr", "K_rad", "K_zt", "h_cg", "h_raf", "h_rar", "h_s", "I_uf", "I_ur", "I_y_w", "K_lt"),
    *("R_w", "T_sb", "T_se", "D_f", "D_r", "E_f", "E_r"),
)


def fields(gravity: float, _: str, content: dict[str, Any]) -> dict[str, Any]:
    """The fields of a ``Vehicle``; ValueError or TypeError in one line names a parameter by CommonRoad's name."""
    known_keys("parameter of CommonRoad's", content, [*NEEDED, *OTHERS, *TABLES])
    if missing := [f"{name!r} ({unit})" for name, (_, unit) in NEEDED.items() if name not in content]:
        why = "" if "m" in content else MASSLESS
        raise ValueError(f"missing parameter{'s' * (len(missing) > 1)} {', '.join(missing)}{why}")
    mass, inertia, front, rear = (in_range(name, content[name], kind) for name, (kind, _) in NEEDED.items())
    tire = content.get("tire", {})
    if not isinstance(tire, dict):
        raise TypeError(f"tire must be a table with p_ky1, got {tire!r}")
    per_load = -number("tire.p_ky1", tire.get("p_ky1", P_KY1), -1000.0, -0.001)
    weight, wheelbase = mass * gravity, front + rear
    found: dict[str, Any] = {
        "mass": mass,
        "yaw_inertia": inertia,
        "cg_to_front": front,
        "cg_to_rear": rear,
        "front_cornering_stiffness": per_load * weight * rear / wheelbase,
        "rear_cornering_stiffness": per_load * weight * front / wheelbase,
        "source": f"CommonRoad's vehicle parameters; {per_load:g} per rad of an axle's load, "
        f"{'the file' if 'p_ky1' in tire else 'CommonRoad'}'s tire.",
    }
    for name, field in (("T_f", "front_half_track"), ("T_r", "rear_half_track")):
        if name in content:
            found[field] = in_range(name, content[name], "length") / 2.0
    if "w" in content:
        found["body_width"] = in_range("w", content["w"], "length")
    if "l" in content:
        overhang = (number("l", content["l"], wheelbase + 0.01, 100.0) - wheelbase) / 2.0
        found |= {"front_overhang": overhang, "rear_overhang": overhang}
    return found
