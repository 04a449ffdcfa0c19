"""Who steers, as functions to be written out: manoeuvres at the front wheels, classical laws at the rear ones."""

from __future__ import annotations

from typing import Any

from bicycle_env.control.four_wheel_steer import (
    FilterNumbers,
    RearLaw,
    Sano,
    SpeedDependent,
    YawRate,
    ZeroSideslip,
    filtered,
)
from bicycle_env.export.routines import Argument, Library, Routine
from bicycle_env.physics.car import CarParameters
from bicycle_env.physics.records import record_of
from bicycle_env.tasks.drivers import Driver, SineWithDwell, Step

MANOEUVRES: tuple[Driver, ...] = (Step(side="left"), SineWithDwell(side="left"))
"""To the left; the page chooses the angle."""
NUMBERS: dict[str, tuple[str, ...]] = {
    SpeedDependent.name: ("ratio",),
    Sano.name: (),
    ZeroSideslip.name: FilterNumbers._fields,
    YawRate.name: ("ratio", "yaw_rate_gain"),
}
"""Of each law, what depends on the car and its speed."""
Rear: Any = record_of("Rear", ("action", "remembered"))
"""Of the rear wheels, in [-1, 1] once it is clipped; what the law remembers."""


def numbers_of(law: RearLaw) -> dict[str, float]:
    """Of a law, those of NUMBERS."""
    source = law.numbers if isinstance(law, ZeroSideslip) else law
    return {field: float(getattr(source, field)) for field in NUMBERS[law.name]}


def library(sano: Sano) -> Library:
    """Each manoeuvre and each law by its name; `sano`: of any car."""
    car, time = Argument("car", CarParameters), Argument("time")
    found, constants, types = [], {}, {}
    for driver in MANOEUVRES:
        record = record_of("Numbers", tuple(driver.numbers()))
        found.append(
            Routine(
                driver.name,
                "The front wheels' action at a time [s] of the episode.",
                (time, Argument("numbers", record, f"{driver.name}_numbers"), car),
                (Argument("action"),),
                _manoeuvre(driver),
            )
        )
        constants[f"exported_{driver.name}"] = record(**driver.numbers())
        types[f"exported_{driver.name}"] = f"{driver.name}_numbers"
    for name, fields in NUMBERS.items():
        word = name.replace("-", "_")
        found.append(
            Routine(
                word,
                "The rear wheels' action after the front wheels', and the yaw rate as observed, times its scale.",
                (
                    *(Argument("front"), Argument("observed"), Argument("scale"), Argument("memory")),
                    *(Argument("numbers", record_of("Numbers", fields), f"{word}_numbers"), car),
                ),
                (Argument("rear", Rear),),
                _rear(name, sano),
            )
        )
    words = ("Manoeuvres of bicycle_env.drivers, and four-wheel-steer laws of bicycle_env.control.",)
    return Library("steering", words, tuple(found), constants, types, {})


def _manoeuvre(driver: Driver) -> Any:
    def law(xp: Any) -> Any:
        angle = driver.law(xp, lambda *_: None)

        def manoeuvre(time: Any, numbers: Any, car: Any) -> Any:
            return angle(None, None, time, numbers, None) / car.front_angle_limit

        return manoeuvre

    return law


def _rear(name: str, sano: Sano) -> Any:
    def law(xp: Any) -> Any:
        curve = sano.curve(xp)

        def steer(front: Any, yaw_rate: Any, memory: Any, numbers: Any) -> tuple[Any, Any]:
            if name == ZeroSideslip.name:
                return filtered(front, memory, numbers)
            if name == Sano.name:
                return curve(front), memory
            made = SpeedDependent if name == SpeedDependent.name else YawRate
            return made.rear_steer(numbers, front, yaw_rate), memory

        def rear(front: Any, observed: Any, scale: Any, memory: Any, numbers: Any, car: Any) -> Any:
            angle, remembered = steer(front * car.front_angle_limit, observed / scale, memory, numbers)
            return Rear(angle / car.rear_angle_limit, remembered)

        return rear

    return law
