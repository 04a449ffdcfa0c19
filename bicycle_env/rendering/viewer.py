"""The pictures of one environment: frames as arrays, or a window."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.rendering import dashboard
from bicycle_env.rendering.corridor import Shape
from bicycle_env.rendering.dashboard import BACKGROUND, Reading
from bicycle_env.rendering.painting import open_display, paint_road, pixels_per_metre, pygame
from bicycle_env.rendering.scene import Scene, Setup, build_scene, side_wind, task_state
from bicycle_env.rendering.told import drawn_in_words
from bicycle_env.tasks.episode import World

WIDTH, HEIGHT = 960, 540
ROAD_HEIGHT = 308
"""Pixels at the top of a frame that show the road; they hold no text while the episode runs."""
RULER_HEIGHT = 26
DRAWN_HEIGHT = 20
"""Of the line that says what was drawn."""


class _Moment(NamedTuple):
    """What stays of an earlier picture; SI units."""

    time: float
    place: tuple[float, float]
    phase: tuple[float, float]
    """Sideslip, yaw rate."""
    struck: Shape
    """Cones that have been hit until then."""


class Viewer:
    """Draws an environment of this package, in its present state, at each ``draw()``.

    ``render_mode`` "rgb_array" needs no display. With "human", ``draw()`` waits so that frames follow each other at
    ``env.metadata["render_fps"]``; once its user has closed the window, it stays closed and nothing is drawn.
    """

    def __init__(self, env: Any) -> None:
        self._env = env
        self._history: list[_Moment] = []
        self._clock: Any = None
        self._shut = False

    def start(self) -> None:
        """Forget the episode before."""
        self._history.clear()

    def draw(self) -> NDArray[np.uint8] | None:
        """The present state: a new array (540, 960, 3), or the window brought up to date and None."""
        if self._env.render_mode != "human":
            pixels = pygame.image.tobytes(self._frame(), "RGB")
            return np.frombuffer(pixels, np.uint8).reshape(HEIGHT, WIDTH, 3).copy()
        if not self._shut:
            self._show(self._frame())
        return None

    def close(self) -> None:
        """Close the window, if there is one; may be called again."""
        if self._clock is not None:
            self._clock = None
            pygame.display.quit()

    def _frame(self) -> Any:
        reading, scene = self._look()
        surface = pygame.Surface((WIDTH, HEIGHT))
        surface.fill(BACKGROUND)
        surface.blit(paint_road(scene, WIDTH, ROAD_HEIGHT), (0, 0))
        scale = pixels_per_metre(scene, ROAD_HEIGHT)
        dashboard.paint_ruler(surface, scene, scale, pygame.Rect(0, ROAD_HEIGHT, WIDTH, RULER_HEIGHT))
        top = ROAD_HEIGHT + RULER_HEIGHT + DRAWN_HEIGHT
        dashboard.paint_drawn(surface, reading, pygame.Rect(16, top - DRAWN_HEIGHT, WIDTH - 32, DRAWN_HEIGHT))
        dashboard.paint_numbers(surface, reading, pygame.Rect(16, top, 320, HEIGHT - top))
        dashboard.paint_gauges(surface, reading, pygame.Rect(328, top, 330, 100))
        dashboard.paint_legend(surface, scene, scale, pygame.Rect(328, top + 102, 330, 84))
        history = [moment.phase for moment in self._history]
        dashboard.paint_phase_plane(surface, reading, history, pygame.Rect(676, top + 2, 278, HEIGHT - top - 2))
        if reading.end:
            at_top = scene.centre_of_mass[1] < scene.middle
            dashboard.paint_end(surface, reading, pygame.Rect(0, 0, WIDTH, ROAD_HEIGHT), at_top)
        return surface

    def _look(self) -> tuple[Reading, Scene]:
        env, car = self._env, self._env.present
        state, measured, limits = env.state, env.measure(), env.task.limits
        grip = {f"{axle}_grip": measured[f"{axle}_peak_force"] for axle in ("front", "rear")}
        setup = setup_of(env)._replace(**grip)
        # restore() may have gone back in time
        self._history = [moment for moment in self._history if moment.time < state.time]
        struck = self._history[-1].struck if self._history else ()
        scene = build_scene(setup, state, measured, [moment.place for moment in self._history], struck)
        reading = Reading(
            speed=measured["speed"],
            critical_speed=car.vehicle.critical_speed,
            tire=type(env.tire).__name__,
            friction=measured["front_peak_force"] / car.vehicle.front_axle_load,
            time=state.time,
            sideslip=state.lateral_velocity / measured["speed"],
            yaw_rate=state.yaw_rate,
            front_steer=state.front_steer,
            rear_steer=state.rear_steer,
            front_steer_limit=env.front_actuator.angle_limit,
            rear_steer_limit=env.rear_actuator.angle_limit,
            front_force=measured["front_lateral_force"],
            rear_force=measured["rear_lateral_force"],
            **grip,
            sideslip_limit=limits.sideslip,
            yaw_rate_limit=limits.yaw_rate,
            end=env.end,
            settled=env.is_success,
            beside=_beside(env, state),
            front_steer_command=state.front_steer_command,
            rear_steer_command=state.rear_steer_command,
            gust=side_wind(setup, state)[0],
            drawn=drawn_in_words(env.task, task_state(env.task, state)),
        )
        phase = reading.sideslip, reading.yaw_rate
        self._history.append(_Moment(state.time, scene.centre_of_mass, phase, scene.struck))
        return reading, scene

    def _show(self, frame: Any) -> None:
        if self._clock is None:
            open_display()
            self._clock = pygame.time.Clock()
        # Another environment in this process may have closed the one window that pygame has.
        window = pygame.display.get_surface()
        if window is None:
            open_display()
            window = pygame.display.set_mode((WIDTH, HEIGHT))
            pygame.display.set_caption(f"bicycle_env: {self._env.task.name}")
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self._shut = True
            self.close()
            return
        window.blit(frame, (0, 0))
        pygame.display.flip()
        self._clock.tick(self._env.metadata["render_fps"])


def _beside(env: Any, state: Any) -> dict[str, tuple[str, float]]:
    """The first history of each quantity at this moment, rad."""
    own = task_state(env.task, state)
    found: dict[str, tuple[str, float]] = {}
    for history in env.task.histories:
        found.setdefault(history.quantity, (history.label, float(history.law(own, state.time, env.present.car))))
    return found


def setup_of(env: Any) -> Setup:
    """What stays the same in all pictures of an episode."""
    present = env.present
    car = present.car
    return Setup(
        vehicle=present.vehicle,
        geometry=env.geometry,
        task=env.task,
        world=World(car, env.rules, present.settings),
        front_grip=car.front_peak_force,
        rear_grip=car.rear_peak_force,
        aspect=WIDTH / ROAD_HEIGHT,
    )
