"""The phase plane of the nonlinear car at constant steer angles: directions, trajectories, steady turns, separatrices.

The stable manifold of a saddle is the set of states that end in it. It separates states with different fates: where
straight running is stable it bounds the region from which the car comes back; above the critical speed straight running
is itself the saddle and its stable manifold is all from which an uncontrolled car comes back.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bicycle_env.analysis.equilibria import Equilibrium, RearBalance, checked_model, described, turns_at
from bicycle_env.analysis.nonlinear_model import NonlinearModel, checked_steer
from bicycle_env.analysis.recovery.least_time import IntractableError
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.tires import Tire
from bicycle_env.physics.validation import positive, whole
from bicycle_env.physics.vehicle import Vehicle

Array = NDArray[np.float64]

OFFSET = 1e-5
"""Distance from the saddle at which a manifold is begun, in half-widths of the box. The manifold leaves its eigenvector
by about its square, 1e-10, and a saddle known to 1e-15 turns the direction by 1e-15 / 1e-5: the cube root of the
rounding unit is the best compromise. Both errors shrink along the way, for the manifold attracts in that direction."""

TOLERANCE = 1e-10
"""Of the integration, relative to the half-widths of the box."""

SPACING = 0.01
"""Largest distance between neighbouring points of an orbit, in half-widths of the box."""

MOST_EVALUATIONS = 200_000
"""Of the equations of motion for one trajectory; usual cars take some hundreds to thousands."""


class Orbit(NamedTuple):
    """States along a trajectory, dense enough for a smooth line."""

    time: Array
    """(n,) s; negative and descending along a stable manifold, which is followed backwards from its saddle."""
    lateral_velocity: Array
    """(n,) m/s."""
    yaw_rate: Array
    """(n,) rad/s."""


class Manifold(NamedTuple):
    """One of the two halves of a saddle's stable or unstable manifold."""

    saddle: Equilibrium
    stability: str
    """"stable": states that end in the saddle; "unstable": states that came from it."""
    orbit: Orbit
    """From the saddle outwards, until it leaves the box, comes to another steady turn or has taken too long."""


class PhasePortrait(NamedTuple):
    """What a picture of the phase plane shows; see :func:`phase_portrait`."""

    speed: float
    """U, m/s."""
    lateral_velocity: Array
    """(columns,) m/s: the grid's axis."""
    yaw_rate: Array
    """(rows,) rad/s: the grid's other axis."""
    lateral_velocity_rate: Array
    """(rows, columns) V', m/s^2."""
    yaw_acceleration: Array
    """(rows, columns) r', rad/s^2."""
    trajectories: tuple[Orbit, ...]
    equilibria: tuple[Equilibrium, ...]
    """Those within the box, from the lowest yaw rate to the highest."""
    manifolds: tuple[Manifold, ...]
    """Of every saddle within the box: two stable and two unstable halves."""


def phase_portrait(
    vehicle: str | Vehicle,
    speed: float,
    steer: ArrayLike = (0.0, 0.0),
    tire: str | Tire = "fiala",
    friction: float = 1.0,
    geometry: str | None = None,
    sideslip_limit: float = 0.4,
    yaw_rate_limit: float = 1.0,
    grid: tuple[int, int] = (41, 41),
    trajectories: int = 24,
    duration: float = 4.0,
) -> PhasePortrait:
    """The phase plane of (lateral_velocity, yaw_rate) inside a box at constant road-wheel angles.

    Args:
        vehicle: a preset's name or a Vehicle.
        speed: U, m/s.
        steer: road-wheel angles (front, rear), rad.
        tire: a name in ``bicycle_env.tires.LAWS`` or a tire object whose force opposes the slip.
        friction: road friction coefficient.
        geometry: "small_angle" or "exact"; by default small_angle for the linear tire and exact for the others.
        sideslip_limit: the box has ``|V| <= sideslip_limit x speed``.
        yaw_rate_limit: the box has ``|r| <= yaw_rate_limit``, rad/s.
        grid: points of the vector field (lateral velocities, yaw rates), 2 to 2000 each.
        trajectories: number of points, 0 to 1000, spread evenly along the edge of the box, from which the motion is
            followed; where it leaves the box, the trajectory is the one that ends there.
        duration: longest time of a trajectory, s.

    Raises:
        ValueError, TypeError: as :func:`equilibria`.
        IntractableError: the car's fastest mode is too fast for its slowest one to be followed.
    """
    model = checked_model(vehicle, speed, tire, friction, geometry)
    steer = checked_steer(steer)
    sideslip_limit = positive("sideslip_limit", sideslip_limit)
    yaw_rate_limit = positive("yaw_rate_limit", yaw_rate_limit)
    if not isinstance(grid, Sequence) or len(grid) != 2:
        raise ValueError(f"grid must be two whole numbers (lateral velocities, yaw rates), got {grid!r}")
    columns, rows = whole("grid[0]", grid[0], 2, 2000), whole("grid[1]", grid[1], 2, 2000)
    trajectories = whole("trajectories", trajectories, 0, 1000)
    duration = positive("duration", duration)

    box = np.array([sideslip_limit * model.speed, yaw_rate_limit])
    lateral_velocity, yaw_rate = np.linspace(-box[0], box[0], columns), np.linspace(-box[1], box[1], rows)
    lateral_velocity_rate, yaw_acceleration = model.rates(*np.meshgrid(lateral_velocity, yaw_rate), *steer)

    balance = RearBalance(model)
    slips = turns_at(balance, steer, sideslip_limit)
    turns = [
        turn
        for turn in described(model, *balance.state(slips, steer[1]), *steer)
        if abs(turn.yaw_rate) <= yaw_rate_limit
    ]
    return PhasePortrait(
        model.speed,
        lateral_velocity,
        yaw_rate,
        lateral_velocity_rate,
        yaw_acceleration,
        tuple(_through(model, steer, point, duration, box) for point in _edge_of(box, trajectories)),
        tuple(sorted(turns, key=lambda turn: turn.yaw_rate)),
        tuple(half for turn in turns if turn.kind == "saddle" for half in _manifolds(model, steer, turn, box)),
    )


def _through(model: NonlinearModel, steer: tuple[float, float], point: Array, duration: float, box: Array) -> Orbit:
    """The trajectory that enters the box at a point of its edge, or leaves it there."""
    entering = _orbit(model, steer, point, duration, box)
    leaving = _orbit(model, steer, point, -duration, box)
    if entering.time[-1] >= -leaving.time[-1]:
        return entering
    return Orbit(leaving.time[::-1] - leaving.time[-1], leaving.lateral_velocity[::-1], leaving.yaw_rate[::-1])


def _edge_of(box: Array, count: int) -> list[Array]:
    """Points evenly along the edge of the box, counted in half-widths; symmetrical if the count is even."""
    starts = []
    for along in (np.arange(count) + 0.5) * 8.0 / max(count, 1):
        side, place = divmod(along, 2.0)
        corner = {0: (1.0, place - 1.0), 1: (1.0 - place, 1.0), 2: (-1.0, 1.0 - place), 3: (place - 1.0, -1.0)}
        starts.append(np.array(corner[int(side)]) * box)
    return starts


def _manifolds(model: NonlinearModel, steer: tuple[float, float], saddle: Equilibrium, box: Array) -> list[Manifold]:
    point = np.array([saddle.lateral_velocity, saddle.yaw_rate])
    rates, vectors = np.linalg.eig(model.jacobians(saddle.lateral_velocity, saddle.yaw_rate, *steer).state)
    halves = []
    for rate, vector in zip(rates.real, vectors.real.T, strict=True):
        # Long enough to come from the offset to the size of the box, and as long again at that rate.
        duration = math.copysign(2.0 * math.log(1.0 / OFFSET) / abs(rate), rate)
        for side in (1.0, -1.0):
            start = point + side * OFFSET * vector / np.max(np.abs(vector / box))
            orbit = _orbit(model, steer, start, duration, box)
            from_saddle = Orbit(*(np.concatenate([[x0], x]) for x0, x in zip((0.0, *point), orbit, strict=True)))
            halves.append(Manifold(saddle, "stable" if rate < 0.0 else "unstable", from_saddle))
    return halves


def _orbit(model: NonlinearModel, steer: tuple[float, float], start: Array, duration: float, box: Array) -> Orbit:
    """Follow the motion for a time [s], backwards if negative, or to the edge of the box."""
    from scipy.integrate import solve_ivp  # `import bicycle_env` stays light

    evaluations = itertools.count()

    def rates(_: float, state: Array) -> tuple[float, float]:
        if next(evaluations) >= MOST_EVALUATIONS:
            raise IntractableError(f"a trajectory of this car takes more than {MOST_EVALUATIONS} evaluations")
        lateral_velocity, yaw_rate = state.tolist()
        return model.rates(lateral_velocity, yaw_rate, *steer, xp=PYTHON)

    def beyond(_: float, state: Array) -> float:
        return float(np.max(np.abs(state / box))) - 1.0

    beyond.terminal, beyond.direction = True, 1.0  # type: ignore[attr-defined]
    found = solve_ivp(
        rates,
        (0.0, duration),
        start,
        method="DOP853",
        rtol=TOLERANCE,
        atol=TOLERANCE * box,
        events=beyond,
        dense_output=True,
    )
    length = np.max(np.abs(np.diff(found.y) / box[:, None]), axis=0)
    parts = np.maximum(1, np.ceil(length / SPACING)).astype(int)
    pieces = [
        np.linspace(t0, t1, n, endpoint=False) for t0, t1, n in zip(found.t[:-1], found.t[1:], parts, strict=True)
    ]
    time = np.concatenate([*pieces, found.t[-1:]])
    states = found.sol(time) if len(time) > 1 else found.y
    return Orbit(time, states[0], states[1])
