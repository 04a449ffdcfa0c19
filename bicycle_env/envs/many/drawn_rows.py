"""Pictures of some cars of many: each row is drawn as the single environment is."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from bicycle_env.envs.told import Told, tell
from bicycle_env.physics.car import CarParameters
from bicycle_env.physics.validation import choice, whole
from bicycle_env.physics.vehicle import UnitWarning, Vehicle

RENDER_MODES = ("rgb_array",)
OF_A_VEHICLE = ("mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "body_width")
STIFFNESSES = ("front_cornering_stiffness", "rear_cornering_stiffness")


class Present(NamedTuple):
    """What is driven in a row; see ``SingleTrackEnv.present``."""

    vehicle: Vehicle
    car: CarParameters
    settings: Any


class Row:
    """One car of a vector environment, as a viewer asks a single environment; what all rows share is the latter's."""

    def __init__(self, env: Any, numbers: Any, row: int) -> None:
        self._env, self._numbers, self._row = env, numbers, row

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # not yet there while a copy is being made
            raise AttributeError(name)
        return getattr(self._env, name)

    @property
    def state(self) -> Any:
        many = self._env.state
        return type(many)(*(float(values[self._row]) for values in many))

    @property
    def end(self) -> str:
        word: str = self._env.end_names[int(self._numbers.column("end")[self._row])]
        return word

    @property
    def is_success(self) -> bool:
        return bool(self._env.is_success[self._row])

    @property
    def present(self) -> Present:
        env = self._env
        car, settings = self._numbers.cars(env.fleet)
        if not env.fleet.varied:
            return Present(env.vehicle, car, settings)
        own = CarParameters(*(float(self._own(value)) for value in car))
        return Present(_vehicle(env.vehicle[self._row], own), own, type(settings)(*map(self._own, settings)))

    def measure(self) -> dict[str, float]:
        return {name: float(values[self._row]) for name, values in self._env.measure().items()}

    def _own(self, value: Any) -> Any:
        return value[self._row] if np.ndim(value) else value


class DrawnRows:
    """Gives a vector environment ``render()``, and what says which rows are drawn."""

    render_mode: str | None
    render_rows = Told[tuple[int, ...]]()

    def _adopt_pictures(self, render_mode: str | None, render_rows: Sequence[int], num_envs: int) -> None:
        """ValueError or TypeError for a mode that there is not, and for rows that there are not."""
        self.render_mode = None if render_mode is None else choice("render_mode", render_mode, RENDER_MODES)
        if not isinstance(render_rows, (Sequence, np.ndarray)) or isinstance(render_rows, str) or not len(render_rows):
            raise TypeError(f"render_rows must be a sequence of rows, for example (0, 1), got {render_rows!r}")
        places = [whole(f"render_rows[{k}]", row, 0, num_envs - 1) for k, row in enumerate(render_rows)]
        tell(self, render_rows=tuple(dict.fromkeys(places)))
        self._viewers: dict[int, Any] = {}
        self._episodes: dict[int, Any] = {}

    def render(self: Any) -> tuple[np.ndarray[Any, Any], ...] | None:
        """One picture (height, width, 3) of uint8 per row, as Gymnasium's wrappers ask; black for rows not drawn."""
        if self.render_mode is None:
            gym.logger.warn("render() needs render_mode='rgb_array' in gym.make_vec")
            return None
        self._refuse_if_closed("render()")
        if not self._started:
            raise gym.error.ResetNeeded("call reset() before render()")
        from bicycle_env.rendering.viewer import Viewer

        pictures = {}
        for row in self.render_rows:
            if row not in self._viewers:
                self._viewers[row] = Viewer(Row(self, self._rows, row))
            # Every start takes random numbers: another state of the generator is another episode.
            episode = self.np_random[row].bit_generator.state
            if self._episodes.get(row) != episode:
                self._viewers[row].start()
            self._episodes[row] = episode
            pictures[row] = self._viewers[row].draw()
        black = np.zeros_like(pictures[self.render_rows[0]])
        return tuple(pictures.get(row, black) for row in range(self.num_envs))


def _vehicle(nominal: Vehicle, car: CarParameters) -> Vehicle:
    """The vehicle of a row, which a reset may have changed: its track stays the nominal one's, to be drawn."""
    numbers = {name: getattr(car, name) for name in (*OF_A_VEHICLE, *STIFFNESSES)}
    numbers |= {f"{axle}_overhang": car_extent - arm for axle, car_extent, arm in _ends(car)}
    if all(math.isclose(value, getattr(nominal, name), rel_tol=1e-5) for name, value in numbers.items()):
        return nominal
    with warnings.catch_warnings():  # the reset has said it
        warnings.simplefilter("ignore", UnitWarning)
        return dataclasses.replace(nominal, **numbers)


def _ends(car: CarParameters) -> tuple[tuple[str, float, float], ...]:
    return ("front", car.front_extent, car.cg_to_front), ("rear", car.rear_extent, car.cg_to_rear)
