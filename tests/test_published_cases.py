"""Published numbers of other people, one test per case: ``pytest -k ME303-STEP.eig`` runs that case alone.

The cases, their sources and their tolerances are in data/reference_cases.json. A case that the package cannot compute
is skipped under its own id, with the reason.
"""

import dataclasses
import itertools
import json
import math
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import Vehicle, analysis, drivers, simulate, tires, vehicles
from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.tasks import fmvss126
from bicycle_env.tasks.double_lane_change import COURSES, Side
from bicycle_env.tasks.episode import World

CASES = json.loads((Path(__file__).parent / "data" / "reference_cases.json").read_text(encoding="utf-8"))
GRAVITY = 9.81
STEP = 0.1  # rad, the front steer of ME303-STEP


def vehicle_of(parameters):
    a, b = parameters["a"], parameters["b"]
    return Vehicle(
        mass=parameters["m"],
        yaw_inertia=parameters.get("Iz", parameters["m"] * a * b),
        cg_to_front=a,
        cg_to_rear=b,
        front_cornering_stiffness=parameters["Cf"],
        rear_cornering_stiffness=parameters["Cr"],
    )


# ME303-STEP: the response to a step of the front steer, as modes


def me303_eigenvalues(parameters):
    return np.sort(analysis.eigenvalues(vehicle_of(parameters), parameters["U"]).real)


def me303_steady_state(parameters):
    vehicle, speed = vehicle_of(parameters), parameters["U"]
    return [
        STEP * analysis.steady_state_gain(vehicle, speed, input="front_steer", output=output)
        for output in ("lateral_velocity", "yaw_rate")
    ]


def me303_amplitudes(parameters, state):
    """Amplitudes of the (fast, slow) mode from the matrices; the simulated response must be the sum of these modes."""
    vehicle, speed = vehicle_of(parameters), parameters["U"]
    matrix, column = analysis.state_matrix(vehicle, speed), analysis.input_matrix(vehicle, speed)[:, 0]
    rates, modes = np.linalg.eig(matrix)
    order = np.argsort(rates)
    rates, modes = rates[order], modes[:, order]
    steady = -np.linalg.solve(matrix, column * STEP)
    amplitudes = modes * np.linalg.solve(modes, -steady)

    run = simulate(vehicle, speed, (STEP, 0.0), 5.0, tire="linear", timestep=1e-3)
    shapes = np.exp(np.outer(run["time"], rates))
    for row, name in enumerate(("lateral_velocity", "yaw_rate")):
        np.testing.assert_allclose(run[name], steady[row] + shapes @ amplitudes[row], rtol=0.0, atol=1e-10)
        fitted = np.linalg.lstsq(np.column_stack([shapes, np.ones(len(shapes))]), run[name], rcond=None)[0]
        np.testing.assert_allclose(fitted, [*amplitudes[row], steady[row]], rtol=0.0, atol=1e-9)
    return amplitudes[state]


# MENDES-LQR: the state there is [y, psi, beta, r]


def mendes_body_matrices(parameters):
    """A (2, 2) and B (2,) for (beta, r), from those for (V, r): beta = V / U."""
    vehicle, speed = vehicle_of(parameters), parameters["U"]
    to_sideslip = np.diag([1.0 / speed, 1.0])
    a = to_sideslip @ analysis.state_matrix(vehicle, speed) @ np.linalg.inv(to_sideslip)
    return a, to_sideslip @ analysis.input_matrix(vehicle, speed)[:, 0]


def mendes_matrices(parameters):
    a, b = mendes_body_matrices(parameters)
    return [*a.ravel(), *b]


def mendes_gain(parameters):
    from bicycle_env.control.design.gains import continuous_gain

    a, b = np.zeros((4, 4)), np.zeros((4, 1))
    a[0, 1] = a[0, 2] = parameters["U"]
    a[1, 3] = 1.0
    a[2:, 2:], b[2:, 0] = mendes_body_matrices(parameters)
    gain, _ = continuous_gain(a, b, np.diag(np.array(parameters["Q"], float)), np.array([[1.0]]))
    assert gain.shape == (1, 4)
    return gain[0]


# PYCTRL-KIN: kinematic steering of Astrom and Murray, state feedback and observer by pole placement


def second_order_poles(frequency, damping):
    return frequency * np.array(
        [complex(-damping, math.sqrt(1 - damping**2)), complex(-damping, -math.sqrt(1 - damping**2))]
    )


def kinematic_gain(parameters):
    from bicycle_env.control.design.gains import pole_placement_gain, reference_gain

    a, b = np.array(parameters["A"]), np.array(parameters["B"], float)[:, None]
    gain = pole_placement_gain(a, b, second_order_poles(parameters["wc"], parameters["zeta"]))
    return [*gain[0], reference_gain(a, b, np.array([[1.0, 0.0]]), gain)[0, 0]]


def kinematic_observer_gain(parameters):
    from bicycle_env.control.design.gains import observer_gain

    a, c = np.array(parameters["A"]), np.array(parameters["C"], float)[None]
    return observer_gain(a, c, second_order_poles(parameters["wo"], parameters["zeta"]))[:, 0]


# CABROL: steady cornering of an understeering car


def cabrol_cornering(parameters):
    """The steady turn of the given radius, reached by simulation at the steer angle that the yaw-rate gain asks for."""
    vehicle, speed = vehicle_of(parameters), parameters["U"]
    steer = speed / parameters["R"] / analysis.steady_state_gain(vehicle, speed, output="yaw_rate")
    return {name: values[-1] for name, values in simulate(vehicle, speed, (steer, 0.0), 6.0, tire="linear").items()}


def cabrol_forces(parameters):
    turn = cabrol_cornering(parameters)
    assert turn["lateral_acceleration"] == pytest.approx(parameters["U"] ** 2 / parameters["R"], rel=1e-6)
    return [turn["front_lateral_force"], turn["rear_lateral_force"]]


def cabrol_slip_angles(parameters):
    turn = cabrol_cornering(parameters)
    assert turn["front_slip_angle"] < 0.0
    assert turn["rear_slip_angle"] < 0.0
    return [-turn["front_slip_angle"], -turn["rear_slip_angle"]]


def degrees_per_g(vehicle):
    return math.degrees(analysis.understeer_gradient(vehicle) * GRAVITY)


def cabrol_gradient(parameters):
    at_wheels = degrees_per_g(vehicle_of(parameters))
    return [at_wheels, at_wheels * parameters["steering_ratio"]]


def cabrol_acceleration_gain(parameters):
    gain = analysis.steady_state_gain(vehicle_of(parameters), parameters["U"], output="lateral_acceleration")
    return [math.radians(gain), math.radians(gain) / GRAVITY]


# KKTSE: cornering compliances D = axle load / axle stiffness


def from_compliances(parameters):
    given = vehicle_of(parameters)
    front, rear = (math.radians(parameters[name]) for name in ("Df_deg_per_g", "Dr_deg_per_g"))
    vehicle = Vehicle(
        mass=given.mass,
        yaw_inertia=given.yaw_inertia,
        cg_to_front=given.cg_to_front,
        cg_to_rear=given.cg_to_rear,
        front_cornering_stiffness=given.front_axle_load / front,
        rear_cornering_stiffness=given.rear_axle_load / rear,
    )
    assert vehicle.front_cornering_stiffness == pytest.approx(parameters["Cf"], rel=1e-12)
    assert vehicle.rear_cornering_stiffness == pytest.approx(parameters["Cr"], rel=1e-12)
    return vehicle


def tangent_speed(parameters):
    vehicle = from_compliances(parameters)
    speed = analysis.tangent_speed(vehicle)
    assert analysis.steady_state_gain(vehicle, 0.99 * speed, output="sideslip") > 0.0
    assert analysis.steady_state_gain(vehicle, 1.01 * speed, output="sideslip") < 0.0
    return speed * 3.6


# MENDES, beyond the linear model


def magic_formula_curve(parameters):
    tire = tires.MagicFormula(shape=parameters["C"], curvature=parameters["E"])
    slip_angles = np.radians(parameters["slip_angles_deg"])
    return -tire.lateral_force(slip_angles, parameters["cornering_stiffness"], parameters["D"])


def skid_pad_radius(parameters):
    vehicle, speed = vehicle_of(parameters), parameters["U"]
    for axle, load in (("front", vehicle.front_axle_load), ("rear", vehicle.rear_axle_load)):
        assert parameters["mu"] * load == pytest.approx(parameters["axle_magic_formula"][axle]["D"], rel=1e-9)
    run = simulate(
        vehicle,
        speed,
        (parameters["delta_f"], 0.0),
        10.0,
        tire=tires.MagicFormula(shape=1.0, curvature=-1.0),
        friction=parameters["mu"],
        geometry="exact",
    )
    return math.hypot(speed, run["lateral_velocity"][-1]) / run["yaw_rate"][-1]


def free_response(parameters, name):
    vehicle, speed = vehicle_of(parameters), parameters["U"]
    start = {"lateral_velocity": parameters["V_0"], "yaw_rate": parameters["r_0"]}
    run = simulate(vehicle, speed, (parameters["delta_f"], 0.0), 2.4, tire="linear", initial_state=start, timestep=1e-3)
    at = np.rint(np.array(parameters["t"]) / 1e-3).astype(int)
    np.testing.assert_allclose(run["time"][at], parameters["t"], rtol=0.0, atol=1e-12)
    return run[name][at]


# ISO3888: the double lane change, from the corridor as it is judged


def corridor(course, width=2.0):
    """Of a car so wide, driven to the left: x (n,) from the start, right and left edge (n,), and the default speed."""
    car = dataclasses.replace(vehicles["understeer"], body_width=width)
    env = gym.make("BicycleDoubleLaneChange-v0", course=course, vehicle=car, direction="left").unwrapped
    numbers = env.task.settings(env.speed)
    x = np.arange(0.0, numbers.end_5 + 5.0, 0.01)
    zero = 0.0 * x
    there = env.task.reference(NUMPY)(CarState(x, *[zero] * 6), Side(1.0), World(env.configuration.car, None, numbers))
    return x, there.road_centre - there.road_half_width, there.road_centre + there.road_half_width, env.speed


def sections(course, width=2.0):
    """``(length, right edge, left edge)`` of each stretch of one width, without the approach and what comes after."""
    x, right, left, _ = corridor(course, width)
    steps = np.flatnonzero(np.diff(left - right)) + 1
    return [(x[end] - x[begin], right[begin], left[begin]) for begin, end in itertools.pairwise(steps)]


def section_lengths(parameters, course):
    lengths = [round(length, 1) for length, _, _ in sections(course)]
    own = COURSES[course].lengths
    assert lengths == pytest.approx([*own[:4], sum(own[4:])], abs=0.02)  # the last lane may be of two sections
    return own


def lane_widths(course):
    """k and c of ``width = k w + c`` for the lanes 1, 3, 5, from bodies of 2.2 and 2.4 m, beyond any least width."""
    narrow, wide = (np.array([left - right for _, right, left in sections(course, width)][::2]) for width in (2.2, 2.4))
    factors = (wide - narrow) / 0.2
    return factors, narrow - 2.2 * factors


def first_course_widths(parameters):
    factors, more = lane_widths("iso3888-1")
    assert more == pytest.approx([more[0]] * 3, abs=1e-12)
    return np.round([*factors, more[0]], 12)


def second_course_widths(parameters):
    factors, more = lane_widths("iso3888-2")
    assert factors[1] == pytest.approx(1.0, abs=1e-12)
    return np.round([factors[0], more[0], more[1]], 12)


def right_to_right_and_speed(parameters):
    (_, right_1, _), _, (_, right_3, _), _, (_, right_5, _) = sections("iso3888-1")
    assert right_5 == pytest.approx(right_1, abs=1e-12)
    return np.round([right_3 - right_1, 3.6 * corridor("iso3888-1")[3]], 12)


def gap_between_lanes(parameters):
    (_, _, left_1), _, (_, right_3, _), _, _ = sections("iso3888-2")
    return round(right_3 - left_1, 12)


# FMVSS126: the sine with dwell, and what the package's task takes of the criteria


def sine_with_dwell(parameters):
    """Frequency and dwell of the default driver, whose angle must be that of the standard at its corners."""
    from bicycle_env.physics.elementary import NUMPY

    driver = drivers.SineWithDwell(amplitude=1.0, start=0.0)
    time = np.array([0.25 / 0.7, 0.5 / 0.7, 1.07143, 1.3, 1.57142, 1.75, 1.92857, 3.0])
    angle = driver.law(NUMPY, None)(None, None, time, driver, None)
    expected = [1.0, 0.0, -1.0, -1.0, -1.0, -math.sin(2.0 * math.pi * 0.7 * (1.92857 - 1.75)), 0.0, 0.0]
    np.testing.assert_allclose(angle, expected, atol=2e-5)
    return [driver.frequency, driver.dwell]


COMPUTED = {
    "FMVSS126-SIG.par": sine_with_dwell,
    "FMVSS126-CRIT.resp": lambda parameters: [fmvss126.DISPLACEMENT_TIME, fmvss126.LEAST_DISPLACEMENT],
    "FMVSS126-CRIT.yaw": lambda parameters: [100.0 * fmvss126.FIRST_RATIO, 100.0 * fmvss126.SECOND_RATIO],
    "ME303-STEP.eig": me303_eigenvalues,
    "ME303-STEP.ss": me303_steady_state,
    "ME303-STEP.V": lambda parameters: me303_amplitudes(parameters, 0),
    "ME303-STEP.r": lambda parameters: me303_amplitudes(parameters, 1),
    "MENDES-LQR.AB": mendes_matrices,
    "MENDES-LQR.K": mendes_gain,
    "PYCTRL-KIN.K": kinematic_gain,
    "PYCTRL-KIN.L": kinematic_observer_gain,
    "CABROL.forces": cabrol_forces,
    "CABROL.slip": cabrol_slip_angles,
    "CABROL.K": cabrol_gradient,
    "CABROL.vch": lambda parameters: analysis.characteristic_speed(vehicle_of(parameters)),
    "CABROL.rgain": lambda parameters: analysis.steady_state_gain(
        vehicle_of(parameters), parameters["U"], output="yaw_rate"
    ),
    "CABROL.aygain": cabrol_acceleration_gain,
    "CABROL.sm": lambda parameters: 100.0 * analysis.static_margin(vehicle_of(parameters)),
    "KKTSE.K_civic": lambda parameters: degrees_per_g(from_compliances(parameters)),
    "KKTSE.tangent": tangent_speed,
    "KKTSE.K_tsx": lambda parameters: degrees_per_g(from_compliances(parameters)),
    "MENDES-MF-CURVE.F": magic_formula_curve,
    "MENDES-SKIDPAD-R.constU": skid_pad_radius,
    "MENDES-FREE-LIN.beta": lambda parameters: free_response(parameters, "sideslip"),
    "MENDES-FREE-LIN.r": lambda parameters: free_response(parameters, "yaw_rate"),
    "ISO3888-1.len": lambda parameters: section_lengths(parameters, "iso3888-1"),
    "ISO3888-1.total": lambda parameters: sum(section_lengths(parameters, "iso3888-1")),
    "ISO3888-1.width": first_course_widths,
    "ISO3888-1.off": right_to_right_and_speed,
    "ISO3888-2.len": lambda parameters: section_lengths(parameters, "iso3888-2"),
    "ISO3888-2.total": lambda parameters: sum(section_lengths(parameters, "iso3888-2")),
    "ISO3888-2.width": second_course_widths,
    "ISO3888-2.off": gap_between_lanes,
}

SKIPPED = {
    "MENDES-SKIDPAD-R.full": "its forward speed is free; this package holds the speed constant (see .constU)",
    "FMVSS126-SIG.sis": "it asks for a rate of the steering wheel; this car has road wheels only",
    "FMVSS126-CRIT.amp": "its amplitudes are those of the steering wheel; this car has road wheels only",
}


def parametrised(case):
    reason = SKIPPED.get(case["id"])
    marks = [] if reason is None else [pytest.mark.skip(reason=f"{case['id']}: {reason}")]
    return pytest.param(case, id=case["id"], marks=marks)


@pytest.mark.parametrize("case", [parametrised(case) for case in CASES])
def test_published(case):
    computed = np.asarray(COMPUTED[case["id"]](case["parameters_SI"]), dtype=float)
    published = np.asarray(case["published_value"], dtype=float)
    assert case["tolerance_type"] == "abs"
    assert computed.shape == published.shape
    deviation = np.abs(computed - published)
    assert np.all(deviation <= case["tolerance"]), f"computed {computed}, published {published}"


def test_every_case_is_computed_or_skipped_once():
    ids = [case["id"] for case in CASES]
    assert sorted(ids) == sorted([*COMPUTED, *SKIPPED])
