"""Transfer functions for front and rear steering, and the state space that they belong to.

Karnopp, Vehicle Stability, ch. 6, section IV: each is numerator / Delta(s), Delta the polynomial of (6.27). The objects
are python-control's, which is imported when one is asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis import linear_laws
from bicycle_env.analysis.stability import characteristic_polynomial, input_matrix, state_matrix
from bicycle_env.installation import needs
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.validation import choice, positive
from bicycle_env.physics.vehicle import Vehicle

INPUTS = ("front_steer", "rear_steer")
OUTPUTS = ("lateral_velocity", "yaw_rate", "lateral_acceleration", "sideslip", "heading", "lateral_position")
STATES = ("lateral_velocity", "yaw_rate", "heading", "lateral_position")


def numerator(vehicle: str | Vehicle, speed: float, input: str, output: str) -> NDArray[np.float64]:
    """Numerator coefficients over m Iz s^2 + ... of (6.27), highest power first.

    For heading and lateral position the denominator has one and two more powers of s.
    """
    front = choice("input", input, INPUTS) == "front_steer"
    choice("output", output, OUTPUTS)
    vehicle, speed = resolve_vehicle(vehicle), positive("speed", speed)
    return np.array(linear_laws.numerator(vehicle, speed, front, output))


def transfer_function(vehicle: str | Vehicle, speed: float, input: str, output: str) -> Any:
    """The response of an output to a road-wheel angle [rad], as a ``control.TransferFunction`` with named signals.

    Args:
        vehicle: a preset's name or a Vehicle.
        speed: m/s.
        input: "front_steer" or "rear_steer".
        output: "lateral_velocity" [m/s], "yaw_rate" [rad/s], "lateral_acceleration" (V' + U r) [m/s^2], "sideslip"
            (V/U) [rad], "heading" [rad] or "lateral_position" [m].

    Raises:
        ValueError, TypeError: a bad vehicle or speed, an unknown input or output.
        ModuleNotFoundError: python-control is missing.
    """
    top = numerator(vehicle, speed, input, output)
    integrations = {"heading": 1, "lateral_position": 2}.get(output, 0)
    bottom = np.append(characteristic_polynomial(vehicle, speed), np.zeros(integrations))
    return _control().TransferFunction(top, bottom, inputs=[input], outputs=[output], name=f"{input}_to_{output}")


def transfer_matrix(vehicle: str | Vehicle, speed: float) -> Any:
    """All twelve transfer functions as one ``control.TransferFunction`` with six outputs and two inputs."""
    functions = [[transfer_function(vehicle, speed, name, output) for name in INPUTS] for output in OUTPUTS]
    return _control().TransferFunction(
        [[function.num[0][0] for function in row] for row in functions],
        [[function.den[0][0] for function in row] for row in functions],
        inputs=list(INPUTS),
        outputs=list(OUTPUTS),
        name="single_track",
    )


def state_space(vehicle: str | Vehicle, speed: float) -> Any:
    """The linear model as a ``control.StateSpace`` with named signals: states ``STATES``, inputs, all six outputs.

    Heading and lateral position follow by psi' = r, y' = V + U psi. Raises as :func:`transfer_function`.
    """
    body, steering = state_matrix(vehicle, speed), input_matrix(vehicle, speed)
    a, b = np.zeros((4, 4)), np.zeros((4, 2))
    a[:2, :2], b[:2] = body, steering
    a[2, 1] = 1.0
    a[3, 0], a[3, 2] = 1.0, speed
    c, d = np.zeros((6, 4)), np.zeros((6, 2))
    c[0, 0] = c[1, 1] = c[4, 2] = c[5, 3] = 1.0
    c[2, :2] = body[0] + [0.0, speed]
    d[2] = steering[0]
    c[3, 0] = 1.0 / speed
    return _control().StateSpace(
        a, b, c, d, inputs=list(INPUTS), outputs=list(OUTPUTS), states=list(STATES), name="single_track"
    )


def zeros(vehicle: str | Vehicle, speed: float, input: str, output: str) -> NDArray[np.complex128]:
    """Zeros of a transfer function, 1/s: one in the right half-plane makes the response start the wrong way."""
    return np.roots(numerator(vehicle, speed, input, output)).astype(np.complex128)


def is_minimum_phase(vehicle: str | Vehicle, speed: float, input: str, output: str) -> bool:
    """Whether no zero lies in the right half-plane."""
    return bool(np.all(zeros(vehicle, speed, input, output).real <= 0.0))


def _control() -> Any:
    try:
        import control
    except ImportError:
        raise ModuleNotFoundError(needs("a transfer function", "python-control", "analysis"), name="control") from None
    return control
