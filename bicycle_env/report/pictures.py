"""The pictures of a report, each with words for someone who has not read the code."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from bicycle_env import analysis, plots
from bicycle_env.analysis.recovery.recoverable_set import GOAL_SIDESLIP, GOAL_YAW_RATE
from bicycle_env.report.page import Picture
from bicycle_env.report.quantities import DEGREE
from bicycle_env.report.study import BOX, STEER_LIMITS, Study

PORTRAIT = (0.5, 1.2)  # |sideslip| [rad], |yaw rate| [rad/s] that the phase planes show
STEP = 1.0 * DEGREE


class Subject(NamedTuple):
    """One picture to be drawn."""

    name: str
    title: str
    caption: Callable[[Study], str]
    alternative: Callable[[Study], str]
    draw: Callable[[Study], object]


def draw(study: Study, progress: Callable[[str], None], left_out: list[str]) -> Iterator[Picture]:
    """Draw the pictures one by one; `progress` hears what comes next.

    `left_out` is told, in words, of pictures that cannot be drawn of a car whose numbers are beyond all cars'.
    """
    for subject in SUBJECTS:
        progress(f"drawing {subject.name}.png")
        try:
            picture = Picture(
                f"{subject.name}.png",
                subject.title,
                subject.caption(study),
                subject.alternative(study),
                plots.png(subject.draw(study)),
            )
        except (ValueError, ArithmeticError, RuntimeError) as error:
            left_out.append(f"The picture {subject.title!r} cannot be drawn of this car: {error}.")
            progress(left_out[-1])
        else:
            yield picture


def _root_locus(study: Study) -> str:
    critical, here = study.vehicle.critical_speed, f"at {study.speed:.1f} m/s"
    words = (
        "Left: real and imaginary part of the two eigenvalues against speed; the star is this speed. A negative real "
        "part is a deviation that dies out, a positive one (grey) a deviation that grows; an imaginary part is an "
        "oscillation. Right: the same two eigenvalues as points of the complex plane that move with the speed. "
    )
    if math.isinf(critical):
        return (
            words + f"This car does not oversteer: whatever the speed, both stay in the left half-plane, also {here}."
        )
    crossing = f"At {critical:.1f} m/s, the critical speed (6.17), one crosses zero along the real axis: "
    return words + crossing + "a car that loses its stability this way does not swing, it simply turns away."


def _stability_map(study: Study) -> str:
    kind = analysis.classification(study.vehicle)
    where = {
        "oversteer": "This car lies on the oversteering side: it has a critical speed.",
        "neutral": "This car lies on the neutral line: stable, with nothing in reserve.",
        "understeer": "This car lies on the understeering side: no speed makes it unstable.",
    }[kind]
    return (
        "Which cars are stable at which speed. Left: only the centre of mass moves along the wheelbase; right: only "
        "the cornering stiffness moves from one axle to the other. In the grey area straight running is unstable; "
        f"the thin lines say in which time a deviation doubles there. {where}"
    )


def _bode(study: Study) -> str:
    words = (
        "How strongly, and how late, the car answers a small sinusoidal steer angle of the front (left) or the rear "
        "axle (right), against the frequency. A phase of 0 is in step with the wheel, -90 a quarter of a period late, "
        "+180 or -180 the opposite way: at low frequency a stable car turns against a steered rear axle. "
    )
    if analysis.is_stable(study.vehicle, study.speed):
        return words + (
            "Lateral acceleration comes back into step at high frequency: with front steering it has lost nothing by "
            "then, with rear steering half a period, the mark of its zero in the right half-plane."
        )
    return words + (
        "At this speed the car is unstable by itself: such a response exists only while something keeps it on the "
        "road, and its phase at low frequency is turned by 180 degrees against a stable car's."
    )


def _step(study: Study) -> str:
    found = plots.wrong_way(study.vehicle, study.speed, "rear_steer", "lateral_acceleration")
    words = (
        f"One axle's road wheels jump to {STEP / DEGREE:g} deg to the left at time 0. Colour: the book's linear tire; "
        f"dashed: the {study.tire.name} tire, which cannot pull harder than friction allows. Yellow: a start the wrong "
        "way, enlarged in the small axes. "
    )
    if found is None:
        return words
    return words + (
        "A rear axle steered to the left first pushes the car to the left; only when the body has turned does the car "
        f"go where it will go, to the right. Here that takes {1000 * found.duration:.0f} ms. The mathematical sign of "
        f"it is the zero at +{found.zero:.3g} 1/s, in the right half-plane: no controller can remove it, and it limits "
        "how fast feedback can be. With front steering neither lateral acceleration nor yaw rate has one."
    )


def _phase_plane(study: Study) -> str:
    shares = {name: f"{100 * share:.0f} %" for name, share in study.shares.items()}
    front, rear = (limit / DEGREE for limit in STEER_LIMITS)
    if any(turn.kind == "saddle" for turn in study.equilibria):
        border = (
            "The thick blue lines are the stable manifolds of the saddles: the border between cars that end on one "
            "side and on the other. "
        )
    elif study.shares["straight"] == 1.0:
        border = "By itself this car comes back from everywhere in the dash-dotted box. "
    else:
        border = (
            "There is no saddle with straight wheels at this speed: a car that does not come back by itself slides "
            "away on both axles. "
        )
    return (
        "Every point is a state: how far the car's body is turned against its path (sideslip) and how fast it turns "
        "(yaw rate). Left: the arrows show how the car moves when nobody steers; steady states are marked, a green "
        f"circle is one to which the car returns. {border}Right: coloured states can be saved by SOME steering within "
        f"{front:.1f} deg of front and {rear:.1f} deg of rear steer, in the time that the colour says; from a grey "
        f"state nobody can save the car. Saved means: less than {GOAL_SIDESLIP / DEGREE:.1f} deg of sideslip and "
        f"{GOAL_YAW_RATE / DEGREE:.1f} deg/s of yaw rate within {study.recoverable.horizon:g} s, even if the car would "
        f"leave again without help. Of the dash-dotted box {shares['recoverable']} can be saved, a linear "
        f"regulator (LQR, dashed) saves {shares['lqr']}, straight wheels {shares['straight']} (dotted). The wheels "
        "follow at once here: with real actuators everybody saves less."
    )


def _steady_turns(study: Study) -> str:
    limit = study.handling.largest_lateral_acceleration
    how = {
        "plows": "the front axle reaches its limit first, so the car plows: more steer does not turn it more",
        "spins": "the rear axle reaches its limit first, so the car spins",
        "neutral": "both axles reach their limit together",
    }.get(study.handling.limit, "")
    end = (
        f"The tires end every turn at {limit:.2f} m/s²: {how}."
        if math.isfinite(limit)
        else "The linear tire knows no end."
    )
    return (
        "Left: the front steer angle that a steady turn needs, against its lateral acceleration. Blue is what it "
        "needs beyond wheelbase / radius: leaning to the right is understeer, to the left oversteer, and the "
        f"dotted line is the linear car. {end} Middle and right: every steady turn that exists at this speed, against "
        "the angle of one axle. On solid green lines the car stays by itself, on dashed red ones only with a driver "
        "who corrects; on dash-dotted grey ones both axles slide, and hardly anything draws the car back to that turn. "
        "Where a dashed line ends at another (white circle, a fold) the steady turn is lost: there is none beyond that "
        "angle."
    )


def _draw_phase_plane(study: Study) -> object:
    portrait = analysis.phase_portrait(
        study.vehicle,
        study.speed,
        tire=study.tire,
        friction=study.friction,
        sideslip_limit=PORTRAIT[0],
        yaw_rate_limit=PORTRAIT[1],
        trajectories=0,
    )
    return plots.phase_plane(portrait, study.recoverable, study.lqr_gain, BOX)


SUBJECTS = (
    Subject(
        "root_locus",
        "Eigenvalues against speed",
        _root_locus,
        lambda study: (
            f"Eigenvalues at {study.speed:.1f} m/s: "
            + ", ".join(f"{value:.2f}" for value in np.asarray(analysis.eigenvalues(study.vehicle, study.speed)))
            + " 1/s; curves over the speed and a root locus in the complex plane."
        ),
        lambda study: plots.root_locus(study.vehicle, study.speed),
    ),
    Subject(
        "stability_map",
        "Stability map",
        _stability_map,
        lambda study: (
            "Two maps of speed against the place of the centre of mass and against the rear axle's share of the "
            "stiffness; the car is marked in the "
            f"{'stable' if analysis.is_stable(study.vehicle, study.speed) else 'unstable'} area."
        ),
        lambda study: plots.stability_map(study.vehicle, study.speed),
    ),
    Subject(
        "bode",
        "Frequency response, front and rear",
        _bode,
        lambda _: (
            "Gain and phase of yaw rate, lateral acceleration and sideslip from 0.05 to 10 Hz, for the front axle on "
            "the left and the rear axle on the right."
        ),
        lambda study: plots.bode(study.vehicle, study.speed),
    ),
    Subject(
        "step_responses",
        "Step response, front and rear",
        _step,
        lambda _: (
            "Lateral acceleration, yaw rate, sideslip and lateral position after a step of the front axle on the left "
            "and the rear axle on the right; the starts the wrong way are shaded."
        ),
        lambda study: plots.step_responses(study.vehicle, study.speed, study.tire, study.friction, STEP),
    ),
    Subject(
        "phase_plane",
        "Phase plane and what can be saved",
        _phase_plane,
        lambda study: (
            "Sideslip against yaw rate: streamlines without steering on the left; on the right the recoverable set, "
            f"{100 * study.shares['recoverable']:.0f} % of the box, with the outlines of what LQR and straight wheels "
            "save."
        ),
        _draw_phase_plane,
    ),
    Subject(
        "steady_turns",
        "Handling diagram and steady turns",
        _steady_turns,
        lambda study: (
            "Lateral acceleration against steer angle, up to "
            f"{study.handling.largest_lateral_acceleration:.2f} m/s²; yaw rate of stable and unstable steady turns "
            "against front and rear steer."
        ),
        lambda study: plots.steady_turns(study.vehicle, study.speed, study.tire, study.friction),
    ),
)
