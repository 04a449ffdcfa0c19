"""What the search for recoverable states found, and how to use it."""

from __future__ import annotations

import dataclasses
import functools
import math
import sys
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bicycle_env.analysis.recovery import feedback, least_time
from bicycle_env.physics import tires
from bicycle_env.physics.actuators import Actuator
from bicycle_env.physics.car import CarParameters, CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.physics.validation import number, positive
from bicycle_env.physics.vehicle import Vehicle
from bicycle_env.simulation import simulate

Array = NDArray[np.float64]

GOAL_SIDESLIP = 0.03  # rad
GOAL_YAW_RATE = 0.08  # rad/s
GOAL_COURSE = 0.05  # rad, with a lane only
HOLD = 0.01  # s: how long a replayed steer angle is held
EDGE = -math.expm1(-1.0)  # the value at a least time of one horizon


@dataclasses.dataclass(frozen=True, eq=False)
class RecoverableSet:
    """What :func:`recoverable_set` returns.

    An upper bound for every controller and learner with these tires, limits and horizon, up to the ``resolution``: the
    edge is known to about one cell. Within some cells of the edge the least time is too long, being interpolated with
    states that are lost.
    """

    vehicle: Vehicle
    speed: float
    tire: tires.Tire
    geometry: str
    friction: float
    steer_limits: tuple[float, float]
    """Largest road-wheel angles (front, rear), rad; 0 for an axle that is not steered."""
    sideslip_limit: float
    yaw_rate_limit: float
    horizon: float
    lane: float | None
    """Half-width of the lane in which the centre of mass must stay, m; None: no lane, two states."""
    lateral_velocity: Array
    """Grid axis (n,), m/s."""
    yaw_rate: Array
    """Grid axis (m,), rad/s."""
    course: Array | None
    """Grid axis (p,) of heading + V / U, rad; None without a lane."""
    lateral_position: Array | None
    """Grid axis (q,), m; None without a lane."""
    value: Array
    """1 - exp(-T / horizon) of the least time T on the grid, (n, m) or with a lane (n, m, p, q)."""
    steer_angles: Array
    """(k, 2): the pairs (front, rear) that the search chose from, rad."""

    def __repr__(self) -> str:
        nodes = " x ".join(map(str, self.value.shape))
        lane = "" if self.lane is None else f", lane={self.lane:g}"
        return (
            f"RecoverableSet(vehicle={self.vehicle.name or 'unnamed'!r}, speed={self.speed:g}, tire={self.tire!r}, "
            f"friction={self.friction:g}, horizon={self.horizon:g}{lane}, {nodes} nodes)"
        )

    @functools.cached_property
    def least_time(self) -> Array:
        """Least time to recovery on the grid, (n, m) or with a lane (n, m, p, q), s; infinite outside the set."""
        with np.errstate(divide="ignore"):
            time: Array = np.where(self.value <= EDGE, -self.horizon * np.log1p(-self.value), np.inf)
        return time

    @property
    def resolution(self) -> tuple[float, ...]:
        """Size of a cell in each state: m/s, rad/s, and with a lane rad, m."""
        return tuple(float(axis[1] - axis[0]) for axis in self._axes)

    def contains(
        self,
        lateral_velocity: ArrayLike,
        yaw_rate: ArrayLike,
        heading: ArrayLike | None = None,
        lateral_position: ArrayLike | None = None,
    ) -> NDArray[np.bool_]:
        """Whether states can be saved; the least time is interpolated between the nodes.

        Args:
            lateral_velocity: m/s; all arguments broadcast.
            yaw_rate: rad/s.
            heading: rad, with a lane only. None: with any heading.
            lateral_position: m, with a lane only. None: at any place in the lane. Give both or neither.

        Returns:
            Booleans of the broadcast shape; False beyond the limits of the grid.

        Raises:
            ValueError, TypeError: a value that is not a finite number; a heading or position without a lane.
        """
        given = {"lateral_velocity": lateral_velocity, "yaw_rate": yaw_rate}
        if (heading is None) != (lateral_position is None):
            raise ValueError("give heading and lateral_position, both or neither")
        if heading is not None and lateral_position is not None:
            if self.lane is None:
                raise ValueError("heading and lateral_position belong to a set with a lane: recoverable_set(lane=...)")
            given |= {"heading": heading, "lateral_position": lateral_position}
        arrays = np.broadcast_arrays(*(_finite(name, values) for name, values in given.items()))
        if len(arrays) == 4:
            value: Array = self._value_at(self._points(*arrays))
        else:
            value = self.projected_value_at(np.stack(arrays, axis=-1))
        return np.reshape(value <= EDGE, arrays[0].shape)

    def share(self, sideslip: float, yaw_rate: float) -> float:
        """The share of the box |sideslip| <= sideslip [rad], |yaw rate| <= yaw_rate [rad/s] that can be saved.

        With a lane: of cars that travel along the lane's middle, their course straight and their body turned.
        """
        lateral_velocity, rates = self._box(positive("sideslip", sideslip), positive("yaw_rate", yaw_rate))
        if self.lane is None:
            inside = self.contains(lateral_velocity, rates)
        else:
            inside = self.contains(lateral_velocity, rates, -lateral_velocity / self.speed, 0.0)
        return float(np.mean(inside))

    def saved_by(
        self, gain: ArrayLike, lateral_velocity: ArrayLike | None = None, yaw_rate: ArrayLike | None = None
    ) -> NDArray[np.bool_]:
        """Which states a clipped linear feedback saves, by simulation, judged as the set is.

        Args:
            gain: K of steer = -K (V, r), (2, 2), rad; with a lane of -K (V, r, heading, lateral position), (2, 4).
            lateral_velocity: m/s; by default the grid's nodes (n, m).
            yaw_rate: rad/s; broadcasts with it. With a lane the car travels along its middle, as in :meth:`share`.

        Returns:
            Booleans of the broadcast shape.

        Raises:
            ValueError, TypeError: a gain of another shape or values that are not finite.
            IntractableError: the car's fastest mode needs more steps than can be simulated.
        """
        matrix = _finite("gain", gain)
        states = 2 if self.lane is None else 4
        if matrix.shape != (2, states):
            raise ValueError(f"gain must have shape (2, {states}), got {matrix.shape}")
        whole_gain = np.zeros((2, 4))
        whole_gain[:, :states] = matrix
        if lateral_velocity is None or yaw_rate is None:
            lateral_velocity, yaw_rate = np.meshgrid(self.lateral_velocity, self.yaw_rate, indexing="ij")
        v, r = np.broadcast_arrays(_finite("lateral_velocity", lateral_velocity), _finite("yaw_rate", yaw_rate))
        zero = np.zeros_like(v)
        in_lane = self.lane is not None
        return feedback.saved_by_feedback(
            self._model,
            self._car,
            CarState(zero, zero, -v / self.speed, v, r, zero, zero),
            whole_gain,
            min(0.5 * HOLD, least_time.longest_step(self.vehicle, self.speed)),
            self.horizon,
            (self.sideslip_limit, self.yaw_rate_limit, np.inf, self.lane if self.lane is not None else np.inf),
            (GOAL_SIDESLIP, GOAL_YAW_RATE, GOAL_COURSE if in_lane else np.inf, np.inf),
        )

    def saved_share(self, gain: ArrayLike, sideslip: float, yaw_rate: float) -> float:
        """The share of the box of :meth:`share` that a clipped linear feedback saves."""
        return float(np.mean(self.saved_by(gain, *self._box(sideslip, yaw_rate, 121))))

    def steer(
        self, lateral_velocity: float, yaw_rate: float, heading: float = 0.0, lateral_position: float = 0.0
    ) -> tuple[float, float]:
        """The set's own steering in a state: the pair (front, rear) [rad] whose next state has the least time.

        Heading and lateral position matter with a lane only.
        """
        angles = self.steer_angles
        one = np.ones(len(angles))
        state = CarState(
            0.0 * one,
            lateral_position * one,
            heading * one,
            lateral_velocity * one,
            yaw_rate * one,
            angles[:, 0],
            angles[:, 1],
        )
        steered = (angles[:, 0], angles[:, 1])
        rates, advance, car = self._physics
        rate = rates(state, steered, car)
        cells = np.max(
            np.abs([rate.lateral_velocity, rate.yaw_rate]) / np.array(self.resolution[:2])[:, None], initial=0.0
        )
        step = min(least_time.longest_step(self.vehicle, self.speed), least_time.CELLS / max(cells, 1e-9))
        after = advance(state, steered, steered, steered, car, np.float64(step))
        if self.lane is None:
            points = np.stack([after.lateral_velocity, after.yaw_rate], axis=-1)
        else:
            points = self._points(after.lateral_velocity, after.yaw_rate, after.heading, after.lateral_position)
        front, rear = angles[int(np.argmin(self._value_at(points)))]
        return float(front), float(rear)

    def rescue(
        self, lateral_velocity: float, yaw_rate: float, heading: float = 0.0, lateral_position: float = 0.0
    ) -> dict[str, Array]:
        """Drive from a state with the set's own steering until the goal, the limits or the horizon is reached.

        The steering is found step by step and then replayed from the start through ``bicycle_env.simulate``, whose
        histories are returned; the last sample is the goal if the car was saved (:meth:`is_recovered`).
        """
        start = {
            "lateral_velocity": number("lateral_velocity", lateral_velocity),
            "yaw_rate": number("yaw_rate", yaw_rate),
            "heading": number("heading", heading),
            "lateral_position": number("lateral_position", lateral_position),
        }
        _, advance, car = self._physics
        state = CarState(*(np.float64(start.get(name, 0.0)) for name in CarState._fields))
        held: list[tuple[float, float]] = []
        for _ in range(round(self.horizon / HOLD)):
            here = (state.lateral_velocity, state.yaw_rate, state.heading, state.lateral_position)
            if held and (self.is_recovered(*here) or not self._is_within(*here)):
                break
            angles = self.steer(*(float(value) for value in here))
            held.append(angles)
            pair = (np.float64(angles[0]), np.float64(angles[1]))
            state = advance(state, pair, pair, pair, car, np.float64(HOLD))
        return simulate(
            self.vehicle,
            self.speed,
            np.array(held),
            len(held) * HOLD,
            tire=self.tire,
            friction=self.friction,
            geometry=self.geometry,
            initial_state=start,
            timestep=HOLD,
        )

    def is_recovered(
        self, lateral_velocity: float, yaw_rate: float, heading: float = 0.0, lateral_position: float = 0.0
    ) -> bool:
        """Whether a state is the goal: |sideslip| < 0.03, |yaw rate| < 0.08; with a lane |course| < 0.05 too."""
        sideslip = lateral_velocity / self.speed
        upright = abs(sideslip) < GOAL_SIDESLIP and abs(yaw_rate) < GOAL_YAW_RATE
        if self.lane is None:
            return upright
        return upright and abs(heading + sideslip) < GOAL_COURSE and abs(lateral_position) <= self.lane

    def _is_within(self, lateral_velocity: float, yaw_rate: float, _heading: float, lateral_position: float) -> bool:
        upright = abs(lateral_velocity) <= self.sideslip_limit * self.speed and abs(yaw_rate) <= self.yaw_rate_limit
        return upright and (self.lane is None or abs(lateral_position) <= self.lane)

    @property
    def _axes(self) -> tuple[Array, ...]:
        pair = (self.lateral_velocity, self.yaw_rate)
        if self.course is None or self.lateral_position is None:
            return pair
        return (*pair, self.course, self.lateral_position)

    def _box(self, sideslip: float, yaw_rate: float, points: int = 401) -> tuple[Array, Array]:
        """(points, points) each: the middles of equal cells of a box."""
        middles = (2.0 * np.arange(points) + 1.0) / points - 1.0
        v, r = np.meshgrid(middles * sideslip * self.speed, middles * yaw_rate, indexing="ij")
        return v, r

    @functools.cached_property
    def _car(self) -> CarParameters:
        return car_with_limits(self.vehicle, self.speed, self.friction, self.steer_limits)

    @property
    def _model(self) -> SingleTrack:
        return SingleTrack(self.tire, self.geometry)

    @functools.cached_property
    def _physics(self) -> tuple[Any, Any, CarParameters]:
        rates = self._model.rates(NUMPY)
        return rates, rk4(NUMPY, CarState, rates), CarParameters(*(np.float64(value) for value in self._car))

    @functools.cached_property
    def _value_at(self) -> Any:
        """Kruzhkov's transform of the least time at points (..., axes); 1 beyond the grid."""
        return _interpolator(self._axes, self.value)

    @functools.cached_property
    def projected_value_at(self) -> Any:
        return _interpolator(self._axes[:2], self.value if self.lane is None else np.min(self.value, axis=(2, 3)))

    def _points(self, lateral_velocity: Any, yaw_rate: Any, heading: Any, lateral_position: Any) -> Array:
        course = heading + lateral_velocity / self.speed
        return np.stack([lateral_velocity, yaw_rate, course, lateral_position], axis=-1)


def car_with_limits(vehicle: Vehicle, speed: float, friction: float, limits: tuple[float, float]) -> CarParameters:
    """The numbers of a car whose road wheels follow at once; an axle that is not steered stays at 0."""
    instant = Actuator(angle_limit=1.0)
    front, rear = (max(limit, sys.float_info.min) for limit in limits)
    return car_on_road(vehicle, speed, friction, instant, instant)._replace(
        front_angle_limit=front, rear_angle_limit=rear
    )


def _interpolator(axes: tuple[Array, ...], value: Array) -> Any:
    import scipy.interpolate  # takes as long to import as the rest of the package

    return scipy.interpolate.RegularGridInterpolator(axes, value, bounds_error=False, fill_value=1.0)


def _finite(name: str, values: ArrayLike) -> Array:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be finite numbers, got {values!r}") from None
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name} must be finite numbers, got {values!r}")
    return array
