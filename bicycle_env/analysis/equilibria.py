"""Steady turns of the nonlinear car: every state in which V' = 0 and r' = 0 at constant road-wheel angles.

The two equations are one. In a steady turn the axles share the centripetal force as they share the weight,

    Yf cos(df) = m U r b/(a+b),    Yr cos(dr) = m U r a/(a+b)                     from (6.18), (6.19) with V' = r' = 0

so the rear slip angle alone gives the yaw rate (second equation), then V (definition 6.20 of the rear slip angle), and
what is left is one function of one variable, the yaw acceleration r' of that state. No law is inverted: the method is
the same for a law that rises for ever, one that saturates and one that falls beyond its peak. Along that curve, with J
the Jacobian of (V', r') with respect to (V, r),

    det J = cos^2(rear slip + rear steer) dr'/d(rear slip)        in small angles without the cosine

so the zeros where r' falls are the saddles, those where it rises are the others, and the two kinds alternate.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bicycle_env.analysis.nonlinear_model import NonlinearModel, checked_steer
from bicycle_env.analysis.stability import stability_criterion
from bicycle_env.physics.dual_numbers import Dual, dual_namespace
from bicycle_env.physics.elementary import NUMPY, PYTHON
from bicycle_env.physics.lateral import one, unchanged
from bicycle_env.physics.tires import Linear, Tire
from bicycle_env.physics.validation import positive
from bicycle_env.physics.vehicle import Vehicle

Array = NDArray[np.float64]

SLIDING = 1e-6
"""An axle counts as sliding where the slope of its force is below this share of its cornering stiffness. Where both do,
motion takes a day, and rounding of the forces, 1e-16, would begin to make steady turns of its own."""

RESOLUTION = 0.05
"""Largest step of the search: relative change of a slip angle, or change in slip scales mu Fz / C around zero."""


class Equilibrium(NamedTuple):
    """One steady turn and the motion near it."""

    lateral_velocity: float
    """V, m/s."""
    yaw_rate: float
    """r, rad/s."""
    sideslip: float
    """V / U, rad."""
    lateral_acceleration: float
    """U r, m/s^2."""
    front_slip_angle: float
    """rad."""
    rear_slip_angle: float
    """rad."""
    eigenvalues: NDArray[np.complex128]
    """(2,) of the Jacobian of (V', r') there, 1/s."""
    kind: str
    """"stable node", "stable focus", "saddle", "unstable node", "unstable focus", or "degenerate" where an eigenvalue
    has no real part to rounding: a fold, or the critical speed itself. The linearisation decides nothing there."""
    is_stable: bool
    """Whether all small deviations decay; False for a degenerate one."""


def equilibria(
    vehicle: str | Vehicle,
    speed: float,
    steer: ArrayLike = (0.0, 0.0),
    tire: str | Tire = "fiala",
    friction: float = 1.0,
    geometry: str | None = None,
    sideslip_limit: float = 1.0,
) -> tuple[Equilibrium, ...]:
    """All isolated steady turns at constant road-wheel angles, from the lowest yaw rate to the highest.

    The search covers every steady turn within the sideslip limit: as a tire force opposes its slip, all of them have
    ``|yaw_rate| <= speed (sideslip_limit + tan |front_steer|) / cg_to_front``. Two of them are told apart if their slip
    angles differ by more than rounding; see :data:`RESOLUTION` for the step in which sign changes and extrema of the
    one function are sought.

    Not listed: states in which both axles slide. A law that is flat beyond its sliding slip angle (Fiala) gives such
    turns as a continuum: with equal cosines of both steer angles, every V with both slip angles beyond sliding and
    ``|yaw_rate| = friction g cos(steer) / speed`` is one, neither attracting nor repelling. A tanh counts as
    flat, to 1e-6, beyond 8 slip scales mu Fz / C.

    Args:
        vehicle: a preset's name or a Vehicle.
        speed: U, m/s.
        steer: road-wheel angles (front, rear), rad.
        tire: a name in ``bicycle_env.tires.LAWS`` or a tire object whose force opposes the slip.
        friction: road friction coefficient.
        geometry: "small_angle" or "exact"; by default small_angle for the linear tire and exact for the others.
        sideslip_limit: largest |V / U| that is sought.

    Returns:
        A tuple of :class:`Equilibrium`; empty if there is none within the limit.

    Raises:
        ValueError, TypeError: a bad value, named with its allowed range; a linear car at its critical speed, which has
            no steady turn with steering and a line of them without.
    """
    balance = RearBalance(checked_model(vehicle, speed, tire, friction, geometry))
    steer = checked_steer(steer)
    slips = turns_at(balance, steer, positive("sideslip_limit", sideslip_limit))
    found = described(balance.model, *balance.state(slips, steer[1]), *steer)
    return tuple(sorted(found, key=lambda turn: turn.yaw_rate))


def checked_model(
    vehicle: str | Vehicle, speed: float, tire: str | Tire, friction: float, geometry: str | None
) -> NonlinearModel:
    """The model; ValueError for a linear car at its critical speed, where its matrix is singular."""
    model = NonlinearModel(vehicle, speed, tire, friction, geometry)
    if isinstance(model.single_track.tire, Linear) and model.single_track.geometry == "small_angle":
        car = model.car
        wheelbase = car.cg_to_front + car.cg_to_rear
        stabilising = wheelbase**2 * car.front_cornering_stiffness * car.rear_cornering_stiffness / car.speed**2
        if abs(stability_criterion(model.vehicle, model.speed)) <= 1e-12 * stabilising:
            critical = model.vehicle.critical_speed
            raise ValueError(f"speed must differ from the critical speed {critical:g} m/s, got {model.speed:g}")
    return model


def described(
    model: NonlinearModel, lateral_velocity: Array, yaw_rate: Array, front_steer: Any, rear_steer: Any
) -> list[Equilibrium]:
    """The properties of steady turns (n,) that were found; the steer angles broadcast."""
    jacobian = model.jacobians(lateral_velocity, yaw_rate, front_steer, rear_steer).state
    values = np.linalg.eigvals(jacobian).astype(np.complex128)
    front_slip, rear_slip = model.slip_angles(lateral_velocity, yaw_rate, front_steer, rear_steer)
    kinds = [kind_of(pair) for pair in values]
    return [
        Equilibrium(
            lateral_velocity=float(lateral_velocity[k]),
            yaw_rate=float(yaw_rate[k]),
            sideslip=float(lateral_velocity[k] / model.speed),
            lateral_acceleration=float(model.speed * yaw_rate[k]),
            front_slip_angle=float(front_slip[k]),
            rear_slip_angle=float(rear_slip[k]),
            eigenvalues=values[k],
            kind=kinds[k],
            is_stable=kinds[k].startswith("stable"),
        )
        for k in range(len(kinds))
    ]


def kind_of(eigenvalues: NDArray[np.complex128]) -> str:
    """The kind of an equilibrium from its two eigenvalues; see :class:`Equilibrium`."""
    growth = eigenvalues.real
    if np.min(np.abs(growth)) <= 1e-9 * np.max(np.abs(eigenvalues)):
        return "degenerate"
    if growth[0] * growth[1] < 0.0:
        return "saddle"
    shape = "node" if np.all(eigenvalues.imag == 0.0) else "focus"
    return f"{'stable' if growth[0] < 0.0 else 'unstable'} {shape}"


class RearBalance:
    """The curve of states in which the rear axle's force keeps the turn, by the rear slip angle; see the module."""

    def __init__(self, model: NonlinearModel) -> None:
        self.model = model

    def state(self, rear_slip: Any, rear_steer: Any, *, xp: Any = NUMPY) -> tuple[Any, Any]:
        """(V, r) on the curve, m/s and rad/s; it does not depend on the front steer angle."""
        car = self.model.car
        exact = self.model.single_track.geometry == "exact"
        cosine, tangent = (xp.near_cos, xp.tan) if exact else (one, unchanged)
        force = self.model.law(xp)(rear_slip, car.rear_cornering_stiffness, car.rear_peak_force) * cosine(rear_steer)
        wheelbase = car.cg_to_front + car.cg_to_rear
        yaw_rate = 0.0 + force * (wheelbase / (car.mass * car.speed * car.cg_to_front))
        return car.speed * tangent(rear_slip + rear_steer) + car.cg_to_rear * yaw_rate, yaw_rate

    def residual(self, rear_slip: Any, front_steer: Any, rear_steer: Any, *, xp: Any = NUMPY) -> Any:
        """r' on the curve, rad/s^2: zero in a steady turn."""
        lateral_velocity, yaw_rate = self.state(rear_slip, rear_steer, xp=xp)
        return self.model.rates(lateral_velocity, yaw_rate, front_steer, rear_steer, xp=xp)[1]

    def slope(self, rear_slip: Any, front_steer: Any, rear_steer: Any, *, xp: Any = NUMPY) -> Any:
        """dr'/d(rear slip) along the curve, 1/s^2 per rad: a positive multiple of det J."""
        moving, dual = Dual(rear_slip, 1.0 + 0.0 * rear_slip), dual_namespace(xp)
        return self.residual(moving, front_steer, rear_steer, xp=dual).slope

    def is_sliding(self, rear_slip: Any, front_steer: Any, rear_steer: Any, *, xp: Any = NUMPY) -> Any:
        """Whether both axles slide in the state of the curve: no isolated steady turn is there."""
        state = self.state(rear_slip, rear_steer, xp=xp)
        slips = self.model.slip_angles(*state, front_steer, rear_steer, xp=xp)
        front, rear = self.model.stiffness_left(*slips, xp=xp)
        return (abs(front) < SLIDING) & (abs(rear) < SLIDING)


def turns_at(balance: RearBalance, steer: tuple[float, float], sideslip_limit: float) -> Array:
    """Rear slip angles (n,) of all isolated steady turns within the sideslip limit."""
    nodes = _nodes(balance, steer, sideslip_limit)
    sliding = balance.is_sliding(nodes, *steer)
    edges = [_edge(balance, steer, low, high) for low, high in _brackets(nodes, sliding[1:] != sliding[:-1])]
    nodes, order = np.unique([*nodes, *itertools.chain(*edges)], return_index=True)
    sliding = np.concatenate([sliding, *(balance.is_sliding(np.array(edge), *steer) for edge in edges)])[order]
    slopes = balance.slope(nodes, *steer)
    turning = ~(sliding[1:] | sliding[:-1]) & (slopes[1:] * slopes[:-1] < 0.0)
    extrema = [_root(balance.slope, steer, *pair) for pair in _brackets(nodes, turning)]
    nodes, order = np.unique([*nodes, *extrema], return_index=True)
    sliding = np.append(sliding, np.zeros(len(extrema), np.bool_))[order]

    # Between neighbours both axles slide, or the residual is monotone.
    values = balance.residual(nodes, *steer)
    at_nodes = nodes[(values == 0.0) & ~sliding]
    change = ~(sliding[1:] | sliding[:-1]) & (values[1:] * values[:-1] < 0.0)
    between = [_root(balance.residual, steer, *pair) for pair in _brackets(nodes, change)]
    # At the critical speed three turns are one; rounding, 1e-16, parts them by its root. Straight running stays exact.
    slips = np.empty(0)
    for slip in sorted([*at_nodes, *between], key=abs):
        if np.all(np.abs(slip - slips) >= 1e-7 * balance.model.rear_slip_scale):
            slips = np.append(slips, slip)
    inside: NDArray[np.bool_] = np.abs(balance.state(slips, steer[1])[0]) <= sideslip_limit * balance.model.speed
    return slips[inside]


def _nodes(balance: RearBalance, steer: tuple[float, float], sideslip_limit: float) -> Array:
    """Rear slip angles, ascending, between which neither slip angle changes by more than the resolution."""
    model = balance.model
    tangent, angle = (np.tan, np.arctan) if model.single_track.geometry == "exact" else (unchanged, unchanged)
    a, b = model.vehicle.cg_to_front, model.vehicle.cg_to_rear
    # From |V|/U <= limit and forces that oppose the slip: a |r|/U <= limit + tan |df|, and the rear angle follows.
    widest = angle(sideslip_limit + b / a * (sideslip_limit + tangent(abs(steer[0]))))
    low, high = min(-widest - steer[1], 0.0), max(widest - steer[1], 0.0)
    nodes = np.unique([*np.linspace(low, 0.0, 129), *np.linspace(0.0, high, 129)])
    while True:
        front, rear = model.slip_angles(*balance.state(nodes, steer[1]), *steer)
        jump = np.abs(np.diff(np.arcsinh(front / model.front_slip_scale)))
        jump += np.abs(np.diff(np.arcsinh(rear / model.rear_slip_scale)))
        coarse = (jump > RESOLUTION) & (np.diff(nodes) > 1e-13)
        if not np.any(coarse):
            return nodes
        nodes = np.unique([*nodes, *(0.5 * (nodes[:-1] + nodes[1:])[coarse])])


def _brackets(nodes: Array, chosen: NDArray[np.bool_]) -> list[tuple[float, float]]:
    return list(zip(nodes[:-1][chosen].tolist(), nodes[1:][chosen].tolist(), strict=True))


def _root(function: Callable[..., Any], steer: tuple[float, float], low: float, high: float) -> float:
    return root(lambda rear_slip: float(function(rear_slip, *steer, xp=PYTHON)), low, high)


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """A zero between two points at which the function has different signs, to rounding."""
    from scipy.optimize import brentq  # `import bicycle_env` stays light

    zero: float = brentq(function, low, high, xtol=1e-18, rtol=4.0 * np.finfo(float).eps, maxiter=500)
    return zero


def _edge(balance: RearBalance, steer: tuple[float, float], low: float, high: float) -> tuple[float, float]:
    """Two rear slip angles, 1e-9 of the interval apart, between which sliding of both axles begins or ends."""
    closeness = max(1e-9 * (high - low), 2.0 * float(np.spacing(max(abs(low), abs(high)))))
    while high - low > closeness:
        nodes = np.linspace(low, high, 65)
        sliding = balance.is_sliding(nodes, *steer)
        first = int(np.argmax(sliding != sliding[0]))
        low, high = float(nodes[first - 1]), float(nodes[first])
    return low, high
