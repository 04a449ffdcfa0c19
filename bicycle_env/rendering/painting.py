"""The scene in pixels, and the colours of all pictures.

Colours that mean something are those of Okabe and Ito (Color Universal Design, 2008): readers with any colour vision
can tell them apart.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, NamedTuple

from gymnasium.error import DependencyNotInstalled

from bicycle_env.installation import needs
from bicycle_env.rendering.corridor import Point, Shape
from bicycle_env.rendering.scene import Arrow, Scene, arrow_outline

try:
    import pygame as pygame  # a re-export, for the modules beside this one
except ImportError as error:
    raise DependencyNotInstalled(needs("render()", "pygame-ce", "render")) from error

UNSEEN = ("dummy", "offscreen")
"""SDL's drivers without a screen."""


def open_display() -> None:
    """Make pygame ready for windows.

    Raises:
        pygame.error: there is no display. SDL would draw where nobody sees it, which only SDL_VIDEODRIVER may ask for.
    """
    pygame.display.init()
    if pygame.display.get_driver() in UNSEEN and not os.environ.get("SDL_VIDEODRIVER"):
        pygame.display.quit()
        raise pygame.error("there is no display")


Colour = tuple[int, int, int]

SKY_BLUE: Colour = (86, 180, 233)
GREEN: Colour = (0, 158, 115)
YELLOW: Colour = (240, 228, 66)
VERMILLION: Colour = (213, 94, 0)
PURPLE: Colour = (204, 121, 167)

WHITE: Colour = (244, 244, 240)
BLACK: Colour = (12, 13, 15)
ASPHALT: Colour = (56, 59, 64)
TARGET: Colour = (40, 66, 100)
ICE: Colour = (150, 180, 196)
OBSTACLE: Colour = (96, 70, 58)
TUFT: Colour = (84, 88, 94)
CONE: Colour = (230, 159, 0)
VERGE: Colour = (128, 139, 120)
VERGE_STRIPE: Colour = (118, 129, 111)
GLASS: Colour = (22, 40, 54)
HEADLIGHT: Colour = (255, 250, 205)

FORCE, SATURATED_FORCE, TRAVEL, PATH, CAR, TRAIL = YELLOW, VERMILLION, PURPLE, GREEN, SKY_BLUE, SKY_BLUE
GUST, STRUCK, OUTSIDE = WHITE, VERMILLION, VERMILLION

FINENESS = 2
"""The road is painted this many times as large and then reduced, which smooths all edges."""
FORCE_WIDTH, TRAVEL_WIDTH, PATH_WIDTH, TRAIL_WIDTH = 0.22, 0.13, 0.17, 0.09
"""m."""
GUST_WIDTH = 0.4
"""m."""
CONE_RADIUS, STRUCK_RADIUS = 0.18, 0.4
"""m; larger where it was hit, to be seen beside the others."""


class View(NamedTuple):
    """From the road to pixels: the same scale in both directions, y upwards."""

    left: float
    """x at the left border, m."""
    middle: float
    """y at half the height, m."""
    scale: float
    """Pixels per metre."""
    height: int
    """Pixels."""

    def pixel(self, point: Point) -> Point:
        # Centres of pixels: what lies symmetrically about the middle line is painted symmetrically.
        return (
            (point[0] - self.left) * self.scale - 0.5,
            0.5 * self.height - 0.5 - (point[1] - self.middle) * self.scale,
        )

    def pixels(self, shape: Shape) -> list[tuple[int, int]]:
        # Rounded here: pygame cuts fractions off, which moves shapes up.
        return [(round(x), round(y)) for x, y in map(self.pixel, shape)]


def pixels_per_metre(scene: Scene, height: int) -> float:
    """Scale of a picture of the road that is so many pixels high."""
    return height / (2.0 * scene.half_height)


def paint_road(scene: Scene, width: int, height: int) -> Any:
    """A new pygame Surface of this many pixels with everything that is on the road; no text."""
    size = (width * FINENESS, height * FINENESS)
    surface = pygame.Surface(size)
    view = View(scene.left, scene.middle, pixels_per_metre(scene, size[1]), size[1])
    surface.fill(VERGE)
    _fill(surface, view, scene.verge_stripes, VERGE_STRIPE)
    _fill(surface, view, scene.posts, WHITE)
    _fill(surface, view, (scene.corridor,), ASPHALT)
    _fill(surface, view, scene.tufts, TUFT)
    if scene.target_lane:
        _fill(surface, view, (scene.target_lane,), TARGET)
    if scene.ice:  # on the road, not beside it
        ice, road = pygame.Surface(size), pygame.Surface(size)
        _fill(ice, view, scene.ice, ICE)
        _fill(road, view, (scene.corridor,), (255, 255, 255))
        ice.blit(road, (0, 0), special_flags=pygame.BLEND_MULT)
        ice.set_colorkey((0, 0, 0))
        surface.blit(ice, (0, 0))
    _fill(surface, view, (*scene.road_edges, *scene.lane_dashes), WHITE)
    for obstacle in scene.obstacles:
        _fill(surface, view, (obstacle,), OBSTACLE)
        _outline(surface, view, obstacle, WHITE, 0.15)
    for dash in scene.path_dashes:
        _stroke(surface, view, dash, PATH, PATH_WIDTH)
    for cone in map(view.pixel, scene.cones):
        pygame.draw.circle(surface, CONE, cone, CONE_RADIUS * view.scale)
    _stroke(surface, view, (*scene.trail, scene.centre_of_mass), TRAIL, TRAIL_WIDTH)
    _paint_car(surface, view, scene)
    _paint_arrow(surface, view, scene.travel, TRAVEL, TRAVEL_WIDTH)
    for force in (scene.front_force, scene.rear_force):
        _paint_arrow(surface, view, force, SATURATED_FORCE if force.saturated else FORCE, FORCE_WIDTH)
    _paint_arrow(surface, view, scene.gust, GUST, GUST_WIDTH)
    for cone in map(view.pixel, scene.struck):
        pygame.draw.circle(surface, BLACK, cone, (STRUCK_RADIUS + 0.1) * view.scale)
        pygame.draw.circle(surface, STRUCK, cone, STRUCK_RADIUS * view.scale)
    for point in map(view.pixel, scene.outside):
        pygame.draw.circle(surface, BLACK, point, 0.22 * view.scale)
        pygame.draw.circle(surface, OUTSIDE, point, 0.15 * view.scale)
    x, y = view.pixel(scene.centre_of_mass)
    pygame.draw.circle(surface, BLACK, (x, y), 0.16 * view.scale)
    pygame.draw.circle(surface, WHITE, (x, y), 0.10 * view.scale)
    return pygame.transform.smoothscale(surface, (width, height))


def _paint_car(surface: Any, view: View, scene: Scene) -> None:
    _fill(surface, view, (scene.body,), CAR)
    _outline(surface, view, scene.body, BLACK, 0.05)
    _fill(surface, view, (scene.windscreen, scene.rear_window), GLASS)
    _fill(surface, view, scene.headlights, HEADLIGHT)
    _fill(surface, view, scene.taillights, VERMILLION)
    for wheel in scene.wheels.values():
        _fill(surface, view, (wheel,), BLACK)
        _outline(surface, view, wheel, WHITE, 0.03)


def _paint_arrow(surface: Any, view: View, arrow: Arrow, colour: Colour, width: float) -> None:
    outline = arrow_outline(arrow, width)
    if outline:
        _fill(surface, view, (outline,), colour)
        _outline(surface, view, outline, BLACK, 0.04)


def _fill(surface: Any, view: View, shapes: Sequence[Shape], colour: Colour) -> None:
    for shape in shapes:
        pygame.draw.polygon(surface, colour, view.pixels(shape))


def _outline(surface: Any, view: View, shape: Shape, colour: Colour, width: float) -> None:
    pygame.draw.polygon(surface, colour, view.pixels(shape), _thickness(view, width))


def _stroke(surface: Any, view: View, shape: Shape, colour: Colour, width: float) -> None:
    if len(shape) > 1:
        pygame.draw.lines(surface, colour, False, view.pixels(shape), _thickness(view, width))


def _thickness(view: View, width: float) -> int:
    """An odd number of pixels: pygame draws lines of an even one beside their middle."""
    return max(1, round(width * view.scale)) | 1
