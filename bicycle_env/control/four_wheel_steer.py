"""Classical four-wheel-steer laws: what the rear wheels do with what the driver does at the front, and the yaw rate.

Letters are Karnopp's, delta_f and delta_r the road-wheel angles. Sideslip stays zero, V = V' = 0 in (6.22), with

    delta_r = -(Cf/Cr) delta_f + k_r r,   k_r = (m U + (a Cf - b Cr) / U) / Cr

and then (6.23) leaves a yaw rate of first order, stable at every speed:

    T r' + r = G delta_f,   T = Iz / D,   G = L Cf / D,   D = m b U + a L Cf / U

Steadily that is ``delta_r = k_0 delta_f`` with k_0 = k_r G - Cf/Cr. The laws below differ in what they take of this.

A law that only looks at the front wheels is a feedforward: it moves zeros, not poles. The open-loop eigenvalues stay,
at 1.2 times the critical speed of the preset ``oversteer`` 0.64 and -7.1 1/s. Zero sideslip then even takes the car
from its driver: the front wheels no longer reach the sideslip, so that no driver can end its growth at 0.64 1/s; with
the steady ratio alone both drivers of this package make it 1.04 1/s. The yaw-rate law moves the eigenvalues, there to
-1.7 and -11.7 1/s.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis import linear_laws
from bicycle_env.analysis.linear_model import STATE_NAMES, LinearModel
from bicycle_env.analysis.stability import characteristic_polynomial, critical_speed, input_matrix, state_matrix
from bicycle_env.control.design.observation_map import Matrix
from bicycle_env.control.driver import DRIVERS, Driver
from bicycle_env.control.policy import Array, Plant, Policy
from bicycle_env.control.remembered import Remembered
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.validation import choice, number, positive
from bicycle_env.physics.vehicle import Vehicle

# Closed forms


def zero_sideslip_ratio(vehicle: Vehicle, speed: float) -> float:
    """k_0 = (-b + m a U^2 / (Cr L)) / (a + m b U^2 / (Cf L)): rear/front steer of steady turns without sideslip.

    It goes from -b/a at rest, where the car turns about its centre of mass, through 0 at the tangent speed
    (``analysis.tangent_speed``: there the front wheels alone do it) to a Cf / (b Cr) at high speed, which is above 1
    for an oversteering car. Raises ValueError or TypeError for a bad speed.
    """
    squared = positive("speed", speed) ** 2
    a, b, wheelbase = vehicle.cg_to_front, vehicle.cg_to_rear, vehicle.wheelbase
    rear = -b + vehicle.mass * a * squared / (vehicle.rear_cornering_stiffness * wheelbase)
    front = a + vehicle.mass * b * squared / (vehicle.front_cornering_stiffness * wheelbase)
    return rear / front


def zero_sideslip_yaw_rate_gain(vehicle: Vehicle, speed: float) -> float:
    """k_r, s: rear steer per yaw rate of motion without sideslip. Raises as :func:`zero_sideslip_ratio`."""
    return float(-state_matrix(vehicle, speed)[0, 1] / input_matrix(vehicle, speed)[0, 1])


def zero_sideslip_yaw_rate(vehicle: Vehicle, speed: float) -> tuple[float, float]:
    """(G [1/s], T [s]): the yaw rate's gain and time constant without sideslip. Raises as the others."""
    a, b = vehicle.cg_to_front, vehicle.cg_to_rear
    speed, front = positive("speed", speed), vehicle.front_cornering_stiffness
    damping = vehicle.mass * b * speed + a * vehicle.wheelbase * front / speed  # D, N m s
    return vehicle.wheelbase * front / damping, vehicle.yaw_inertia / damping


def yaw_rate_feedback_matrix(vehicle: Vehicle, speed: float, gain: float) -> NDArray[np.float64]:
    """The state matrix (2, 2) of a car that steers its rear wheels by ``delta_r = gain * r``: A + B_r [0, gain].

    The left side of (6.14) grows by gain L Cf Cr / U and the understeer gradient by gain / U. Raises ValueError or
    TypeError for a bad speed.
    """
    return state_matrix(vehicle, speed) + np.outer(input_matrix(vehicle, speed)[:, 1], [0.0, gain])


def critical_speed_with_yaw_rate_feedback(vehicle: Vehicle, gain: float) -> float:
    """The critical speed, m/s, of a car that steers its rear wheels by ``delta_r = gain * r``, gain >= 0 in s.

    The root of ``1/U^2 + gain/(L U) = 1/U_crit^2``: U_crit (x + sqrt(1 + x^2)) with x = gain U_crit / (2 L); infinite
    for a car that does not oversteer. Raises ValueError or TypeError for a bad gain.
    """
    bare = critical_speed(vehicle)
    x = number("gain", gain, low=0.0) * bare / (2.0 * vehicle.wheelbase)
    return bare * (x + math.hypot(1.0, x)) if math.isfinite(bare) else math.inf


def yaw_rate_feedback_gain(
    vehicle: Vehicle, speed: float, speed_margin: float = 2.0, damping_ratio: float = 1.0
) -> float:
    """The least gain >= 0, s, of ``delta_r = gain * r`` with two properties at a speed [m/s].

    The critical speed becomes at least `speed_margin` x speed, and the damping ratio of the two modes is at least
    `damping_ratio`: from 1 on they do not oscillate. For instant rear wheels and the linear tire; the first needs
    ``L (X/U_crit^2 - 1/X)`` with X = speed_margin x speed, the second a root of a quadratic: with the gain, the
    coefficient of s in (6.27) grows by m b Cr and the constant by L Cf Cr / U.

    Raises:
        ValueError, TypeError: a bad speed, speed_margin <= 1, damping_ratio outside [0, 1].
    """
    target = positive("speed", speed) * number("speed_margin", speed_margin, above=1.0)
    gain = max(0.0, vehicle.wheelbase * (target / critical_speed(vehicle) ** 2 - 1.0 / target))
    inertia, damping, stiffness = characteristic_polynomial(vehicle, speed)  # of s^2, s and 1 in (6.27)
    damping_slope, stiffness_slope = linear_laws.yaw_rate_feedback(vehicle, speed)  # per gain
    square = 4.0 * inertia * number("damping_ratio", damping_ratio, 0.0, 1.0) ** 2
    linear = 2.0 * damping * damping_slope - square * stiffness_slope
    roots = np.roots([damping_slope**2, linear, damping**2 - square * stiffness])
    if np.all(np.isreal(roots)) and min(roots.real) < gain < max(roots.real):
        gain = float(max(roots.real))
    return gain


# Laws


class RearLaw(abc.ABC):
    """Steers the rear wheels after the driver's front command and the measured yaw rate.

    Args:
        plant: the environment, with both axles steered (ValueError otherwise).

    Attributes: ``model``, the plant's linear model for which the law is made; ``ratio`` and ``yaw_rate_gain`` [s] of
    its slow, small motion ``delta_r = ratio delta_f + yaw_rate_gain r``.
    """

    name: str
    ratio: float
    yaw_rate_gain: float = 0.0

    def __init__(self, plant: Plant) -> None:
        if plant.steer != "both":
            raise ValueError(f"steer must be 'both' for the rear-steer law {self.name!r}, got {plant.steer!r}")
        self.model = plant.linear_model(quasi_static=True)
        self._front_limit, self._rear_limit = plant.front_actuator.angle_limit, plant.rear_actuator.angle_limit
        self._entry = plant.observation_names.index("yaw_rate")
        self._scale = plant.observation_scale[self._entry]

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:  # noqa: B027 (most laws remember nothing)
        """Forget the past, as ``Policy.reset``."""

    def act(self, front: Array, observation: Array) -> NDArray[np.float32]:
        """The rear action in [-1, 1], () or (cars,), from the front action and the observation(s)."""
        front_steer = self._front_limit * np.atleast_1d(np.asarray(front, np.float64))
        yaw_rate = self._scale * np.atleast_1d(np.asarray(observation, np.float64)[..., self._entry])
        rear = np.clip(self.rear_steer(front_steer, yaw_rate) / self._rear_limit, -1.0, 1.0)
        return rear.astype(np.float32).reshape(np.shape(front))

    @abc.abstractmethod
    def rear_steer(self, front_steer: Matrix, yaw_rate: Matrix) -> Matrix:
        """(cars,) the wanted rear angle, rad, from the front command [rad] and the yaw rate [rad/s], each (cars,)."""

    def front_model(self) -> LinearModel:
        """The car with the law at work, as its driver knows it: the front command is the only input."""
        A, B = self.model.A.copy(), self.model.B
        A[:, STATE_NAMES.index("yaw_rate")] += B[:, 1] * (self.yaw_rate_gain / self._rear_limit)
        front = B[:, :1] + B[:, 1:] * (self.ratio * self._front_limit / self._rear_limit)
        return self.model._replace(
            A=A,
            B=front,
            R=self.model.R[:1, :1],
            input_names=self.model.input_names[:1],
            input_scale=self.model.input_scale[:1],
        )


class SpeedDependent(RearLaw):
    """A rear/front ratio after the speed, without sideslip in steady turns: ``delta_r = k_0(U) delta_f``.

    Slowly the rear wheels turn against the front ones, above the tangent speed with them: the speed-sensing kind of
    four-wheel steering, sold by Mazda from 1987 on. The ratio is a standard result; some later texts call it Sano's
    law, but his papers are about :class:`Sano`.
    """

    name = "speed-dependent"

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self.ratio = zero_sideslip_ratio(plant.vehicle, plant.speed)

    def rear_steer(self, front_steer: Matrix, yaw_rate: Matrix) -> Matrix:  # noqa: ARG002
        return self.ratio * front_steer


class Sano(RearLaw):
    """The rear angle as a function of the steering-wheel angle alone: small angles with the front, large ones against.

    S. Sano, Y. Furukawa, S. Shiraishi, "Four wheel steering system with rear wheel steer angle controlled as a
    function of steering wheel angle", SAE 860625, 1986; S. Sano et al., SAE 885034, 1988: the purely mechanical
    system of the Honda Prelude of 1987. Fast cars are steered by small angles, parked ones by large angles, so that
    the angle stands for the speed. The curve goes through figures that the press gave of that car: rear wheels 1.5 deg
    with the front ones where these are at 9 deg, straight again at 246 deg of the steering wheel (taken as 17 deg at
    the front), 5.3 deg against at full lock (30 deg). Between them it is a monotone cubic, not the papers' curve.
    """

    name = "sano"
    points = ((0.0, 0.0), (9.0, 1.5), (17.0, 0.0), (30.0, -5.3))
    """Front and rear angle, degrees; odd, and constant beyond the last.

    Attributes: ``pieces`` of the curve: (begin, coefficients of 1, x - begin, ...) of each; its ``last`` angle, rad.
    """

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        front, rear = np.radians(self.points).T
        from scipy.interpolate import PchipInterpolator  # takes long to import

        whole = PchipInterpolator(np.append(-front[:0:-1], front), np.append(-rear[:0:-1], rear))
        self.ratio = float(whole(0.0, 1))
        pieces = range(len(front) - 1, len(whole.x) - 1)
        self.pieces = tuple((float(whole.x[k]), *whole.c[::-1, k].tolist()) for k in pieces)
        self.last = float(front[-1])

    def curve(self, xp: Any) -> Callable[[Any], Any]:
        """The law ``(front steer) -> rear steer``, rad."""

        def curve(front_steer: Any) -> Any:
            size = xp.minimum(abs(front_steer), self.last)
            angle = 0.0 * size
            for begin, *coefficients in self.pieces:
                since = size - begin
                power, value = 1.0 + 0.0 * since, 0.0 * since
                for coefficient in coefficients:
                    value, power = value + coefficient * power, power * since
                angle = xp.where(since >= 0.0, value, angle)
            return xp.where(front_steer < 0.0, -angle, angle)

        return curve

    def rear_steer(self, front_steer: Matrix, yaw_rate: Matrix) -> Matrix:  # noqa: ARG002
        angle: Matrix = self.curve(NUMPY)(front_steer)
        return angle


class FilterNumbers(NamedTuple):
    """Of :class:`ZeroSideslip` at a speed."""

    at_once: Any
    """-Cf/Cr."""
    per_yaw_rate: Any
    """k_r, s."""
    gain: Any
    """G, 1/s."""
    rest: Any
    """Of a deviation of r_m after a control step, per itself."""
    mean_rest: Any
    """Its mean over the control step."""


def filtered(front_steer: Any, yaw_rate: Any, numbers: FilterNumbers) -> tuple[Any, Any]:
    """(rear steer, r_m after the control step) from the front command [rad] and r_m before it [rad/s]."""
    steady = numbers.gain * front_steer
    away = yaw_rate - steady
    rear = numbers.at_once * front_steer + numbers.per_yaw_rate * (steady + numbers.mean_rest * away)
    return rear, steady + numbers.rest * away


class ZeroSideslip(RearLaw):
    """A feedforward through a first-order filter, without sideslip in transients either.

    ``delta_r = -(Cf/Cr) delta_f + k_r r_m`` with the yaw rate r_m of the model, ``T r_m' + r_m = G delta_f``, which is
    ``delta_r / delta_f = (k_0 - (Cf/Cr) T s) / (1 + T s)``: the form (K + T1 s) / (1 + T2 s) of K. Mori and N. Irie
    (Nissan), US patent 4947326, 1990, with the place of zero sideslip at the centre of mass. The rear wheels first turn
    against the front ones, which starts the yaw, and then with them. Exact for the linear tire and equal actuators
    within their limits; the commands are held for a control step, in which r_m enters with its mean.
    """

    name = "zero-sideslip"

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        vehicle, speed = plant.vehicle, plant.speed
        self.ratio = zero_sideslip_ratio(vehicle, speed)
        gain, time_constant = zero_sideslip_yaw_rate(vehicle, speed)
        elapsed = plant.action_timestep / time_constant
        self.numbers = FilterNumbers(
            -vehicle.front_cornering_stiffness / vehicle.rear_cornering_stiffness,
            zero_sideslip_yaw_rate_gain(vehicle, speed),
            gain,
            math.exp(-elapsed),
            -math.expm1(-elapsed) / elapsed,
        )
        self._yaw_rate = Remembered(1)

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self._yaw_rate.reset(rows)

    def rear_steer(self, front_steer: Matrix, yaw_rate: Matrix) -> Matrix:  # noqa: ARG002
        model = self._yaw_rate.of(len(front_steer))[:, 0]
        rear: Matrix
        rear, model[:] = filtered(front_steer, model, self.numbers)
        return rear


class YawRate(RearLaw):
    """Yaw-rate feedback, with a feedforward from the front wheels: ``delta_r = k_1 delta_f + k_2 r``.

    The structure of Toyota's active four-wheel steering: "Development of four wheel steering system using yaw rate
    feedback control", SAE 911922, 1991; the gains are this package's. k_2 is :func:`yaw_rate_feedback_gain`'s, so that
    the linear car is stable far above its bare critical speed and its modes do not oscillate; k_1 = k_0 - k_2 G keeps
    the sideslip of steady turns at zero. Where the car needs no feedback, k_2 = 0: it is :class:`SpeedDependent` then.

    Args:
        plant: the environment, with both axles steered.
        speed_margin, damping_ratio: see :func:`yaw_rate_feedback_gain`.
    """

    name = "yaw-rate"

    def __init__(self, plant: Plant, speed_margin: float = 2.0, damping_ratio: float = 1.0) -> None:
        super().__init__(plant)
        vehicle, speed = plant.vehicle, plant.speed
        self.yaw_rate_gain = yaw_rate_feedback_gain(vehicle, speed, speed_margin, damping_ratio)
        yaw_rate_per_steer, _ = zero_sideslip_yaw_rate(vehicle, speed)
        self.ratio = zero_sideslip_ratio(vehicle, speed) - self.yaw_rate_gain * yaw_rate_per_steer

    def rear_steer(self, front_steer: Matrix, yaw_rate: Matrix) -> Matrix:
        return self.ratio * front_steer + self.yaw_rate_gain * yaw_rate


REAR_LAWS: dict[str, type[RearLaw]] = {law.name: law for law in (SpeedDependent, Sano, ZeroSideslip, YawRate)}
"""The rear-steer laws by name."""

COMBINATIONS = tuple(f"{driver}+{law}" for driver in DRIVERS for law in REAR_LAWS)
"""What ``driver_and_law`` takes."""


class DriverAndLaw(Policy):
    """A driver at the front wheels and a law at the rear ones; TypeError for anything else.

    Attributes: ``driver``, ``law``, and ``model``: the car with the law at work, its input the front command.
    """

    def __init__(self, driver: Driver, law: RearLaw) -> None:
        for name, value, kind in (("driver", driver, Driver), ("law", law, RearLaw)):
            if not isinstance(value, kind):
                raise TypeError(f"{name} must be a {kind.__name__}, got {value!r}")
        self.driver, self.law = driver, law
        self.name = f"{driver.name}+{law.name}"
        self.model = law.front_model()

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self.driver.reset(rows)
        self.law.reset(rows)

    def act(self, observation: Array) -> NDArray[np.float32]:
        action = self.driver.act(observation)
        action[..., 1] = self.law.act(action[..., 0], observation)
        return action


def driver_and_law(name: str, plant: Plant) -> DriverAndLaw:
    """``DRIVER+LAW``, for example "preview+sano"; the driver knows the car with the law at work.

    Raises:
        ValueError, TypeError: an unknown driver or law; an environment that does not steer both axles.
    """
    driver, _, law = choice("policy", name, COMBINATIONS).partition("+")
    rear = REAR_LAWS[law](plant)
    return DriverAndLaw(DRIVERS[driver](plant, model=rear.front_model()), rear)
