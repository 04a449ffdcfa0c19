"""Branches of steady turns against one steer angle, and where they fold back or begin to oscillate.

The steady turns are the zeros of one function of the rear slip angle (:mod:`bicycle_env.analysis.equilibria`). With one
steer angle set free they are a curve in a plane. Pseudo-arclength continuation (H. B. Keller, 1977) follows it round
its folds: a step along the tangent, then Newton's method at a right angle to it.

    g(rear slip, steer) = 0        and at a fold also        dg/d(rear slip) = 0, which is det J = 0
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.continuation import SteerPlane, branch_through, changes, passes
from bicycle_env.analysis.equilibria import Equilibrium, RearBalance, checked_model, described, turns_at
from bicycle_env.physics.tires import Tire
from bicycle_env.physics.validation import choice, number, positive
from bicycle_env.physics.vehicle import Vehicle

Array = NDArray[np.float64]

EVEN_STARTS, NEAR_STARTS = 13, (0.0, 0.5, 1.5, 4.0)
"""Branches start from all steady turns at 13 steer angles between the limits, and where both axles are steered alike
(straight running, or at an angle) or differ by some slip scales mu Fz / C: short branches are there."""


class Bifurcation(NamedTuple):
    """A point of a branch where the number of steady turns or their stability changes."""

    kind: str
    """"fold": two steady turns meet and vanish (saddle-node); "hopf": an oscillation begins to grow."""
    row: int
    """Its place in the branch's arrays."""
    front_steer: float
    """rad."""
    rear_steer: float
    """rad."""
    equilibrium: Equilibrium


class EquilibriumBranch(NamedTuple):
    """Connected steady turns in the order in which they follow each other; arrays of n rows, bifurcations included."""

    front_steer: Array
    """(n,) rad."""
    rear_steer: Array
    """(n,) rad."""
    lateral_velocity: Array
    """(n,) m/s."""
    yaw_rate: Array
    """(n,) rad/s."""
    sideslip: Array
    """(n,) V / U, rad."""
    lateral_acceleration: Array
    """(n,) U r, m/s^2."""
    eigenvalues: NDArray[np.complex128]
    """(n, 2) 1/s."""
    kind: NDArray[np.str_]
    """(n,) see :class:`Equilibrium`; "degenerate" at a bifurcation."""
    is_stable: NDArray[np.bool_]
    """(n,) False at a bifurcation."""
    bifurcations: tuple[Bifurcation, ...]
    ends: tuple[str, str]
    """Why the branch ends at its first and last row: "steer limit", "sideslip limit", "full sliding" (both axles slide
    there, see :func:`equilibria`), or "closed" twice for a loop, whose last row is its first."""


def equilibrium_branches(
    vehicle: str | Vehicle,
    speed: float,
    input: str = "front_steer",
    other_steer: float = 0.0,
    tire: str | Tire = "fiala",
    friction: float = 1.0,
    geometry: str | None = None,
    steer_limit: float = 0.2,
    sideslip_limit: float = 1.0,
) -> tuple[EquilibriumBranch, ...]:
    """All branches of steady turns against one steer angle, the one through straight running first.

    Every point solves the equations to rounding, a fold the extended system (g = 0 and dg/d(rear slip) = 0) too. A
    closed branch between two of the steer angles from which branches are started is not found, nor is a pair of
    folds that are closer than 0.02 slip scales (their steer angles then differ by less than 1e-5 of one).

    Args:
        vehicle: a preset's name or a Vehicle.
        speed: U, m/s.
        input: the axle that is steered: "front_steer" or "rear_steer".
        other_steer: the other axle's constant steer angle, rad.
        tire: a name in ``bicycle_env.tires.LAWS`` or a tire object whose force opposes the slip.
        friction: road friction coefficient.
        geometry: "small_angle" or "exact"; by default small_angle for the linear tire and exact for the others.
        steer_limit: largest steer angle of the branches, rad, below pi/2.
        sideslip_limit: largest |V / U| of the branches.

    Raises:
        ValueError, TypeError: as :func:`equilibria`.
    """
    model = checked_model(vehicle, speed, tire, friction, geometry)
    choice("input", input, ("front_steer", "rear_steer"))
    other_steer = number("other_steer", other_steer, -1.5, 1.5)
    steer_limit = number("steer_limit", steer_limit, high=1.5, above=0.0)
    sideslip_limit = positive("sideslip_limit", sideslip_limit)
    plane = SteerPlane(RearBalance(model), input == "front_steer", other_steer, steer_limit, sideslip_limit)

    near = [other_steer + side * distance * plane.scale for distance in NEAR_STARTS for side in (-1.0, 1.0)]
    angles = {*np.linspace(-steer_limit, steer_limit, EVEN_STARTS), *(x for x in near if abs(x) < steer_limit)}
    seeds = [
        np.array([slip, angle]) / plane.scale
        for angle in sorted(angles, key=lambda angle: abs(angle - other_steer))
        for slip in sorted(turns_at(plane.balance, plane.pair(angle), sideslip_limit).tolist(), key=abs)
    ]
    branches = []
    while seeds:
        rows, ends = branch_through(plane, seeds[0])
        if len(rows) > 1:  # not one that only touches a limit
            branches.append(_described(plane, rows, ends))
        seeds = [seed for seed in seeds[1:] if not passes(plane, rows, seed)]
    return tuple(branches)


def _described(plane: SteerPlane, rows: Array, ends: tuple[str, str]) -> EquilibriumBranch:
    """The public form of a branch, with its bifurcations as further rows."""
    found = [(place, "fold", x) for place, x in changes(plane, rows, plane.determinant)]
    for place, x in changes(plane, rows, plane.divergence):
        if plane.gradient(x)[0] > 0.0:  # det J > 0: a pair of imaginary eigenvalues, not two of opposite sign
            found.append((place, "hopf", x))
    found.sort(key=lambda item: item[0])
    places = [place + 1 for place, _, _ in found]
    if found:
        rows = np.insert(rows, places, [x for _, _, x in found], axis=0)
    steer = plane.pair(rows[:, 1] * plane.scale)
    front_steer, rear_steer = (np.broadcast_to(angle, len(rows)).copy() for angle in steer)
    state = plane.balance.state(rows[:, 0] * plane.scale, rear_steer)
    turns = described(plane.balance.model, *state, front_steer, rear_steer)

    bifurcations = []
    for shift, (place, (_, kind, _)) in enumerate(zip(places, found, strict=True)):
        row = place + shift
        turns[row] = turns[row]._replace(kind="degenerate", is_stable=False)
        bifurcations.append(Bifurcation(kind, row, float(front_steer[row]), float(rear_steer[row]), turns[row]))
    return EquilibriumBranch(
        front_steer=front_steer,
        rear_steer=rear_steer,
        lateral_velocity=state[0],
        yaw_rate=state[1],
        sideslip=np.array([turn.sideslip for turn in turns]),
        lateral_acceleration=np.array([turn.lateral_acceleration for turn in turns]),
        eigenvalues=np.array([turn.eigenvalues for turn in turns]),
        kind=np.array([turn.kind for turn in turns]),
        is_stable=np.array([turn.is_stable for turn in turns]),
        bifurcations=tuple(bifurcations),
        ends=ends,
    )
