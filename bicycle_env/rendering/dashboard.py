"""What is to be read below the road: numbers, steering and grip, a legend, the phase plane. Degrees, pixels."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from bicycle_env.rendering import painting as p
from bicycle_env.rendering.corridor import Point
from bicycle_env.rendering.painting import Colour, pygame
from bicycle_env.rendering.scene import Arrow, Scene, arrow_outline, is_saturated

BACKGROUND: Colour = (20, 22, 26)
RULER: Colour = (34, 37, 42)
TEXT: Colour = (236, 236, 232)
FAINT: Colour = (150, 154, 160)
GROOVE: Colour = (58, 62, 68)

GAUGE_WIDTH = 132
SCALE_BAR = 5.0
"""m."""
LIMIT_MARGIN = 1.18
"""The phase plane reaches this much beyond the limits."""
TICKS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)


class Reading(NamedTuple):
    """The numbers of one moment; SI units, rad."""

    speed: float
    critical_speed: float
    """Infinite for a car that has none."""
    tire: str
    friction: float
    time: float
    sideslip: float
    yaw_rate: float
    front_steer: float
    rear_steer: float
    front_steer_limit: float
    rear_steer_limit: float
    front_force: float
    rear_force: float
    front_grip: float
    """Friction x static load, N."""
    rear_grip: float
    sideslip_limit: float
    yaw_rate_limit: float
    end: str
    """Why the episode has ended; empty while it runs."""
    settled: bool
    beside: Mapping[str, str]
    """By the quantity's name, what the task wants of it, in words."""


@functools.cache
def _font(size: int) -> Any:
    pygame.font.init()
    return pygame.font.Font(None, size)


@functools.lru_cache(maxsize=512)
def _text(words: str, size: int, colour: Colour) -> Any:
    # At twice the size and reduced: the letters of small sizes are set too far apart.
    try:
        large = _font(2 * size).render(words, True, colour)
    except pygame.error:  # somebody has called pygame.quit(), which ends the life of all fonts
        _font.cache_clear()
        large = _font(2 * size).render(words, True, colour)
    return pygame.transform.smoothscale_by(large, 0.5)


def write(
    surface: Any, words: str, place: Point, size: int = 20, colour: Colour = TEXT, anchor: str = "midleft"
) -> None:
    """Put one line of text; `anchor` is the name of a pygame.Rect corner."""
    image = _text(words, size, colour)
    surface.blit(image, image.get_rect(**{anchor: (round(place[0]), round(place[1]))}))


def paint_ruler(surface: Any, scene: Scene, scale: float, area: Any) -> None:
    """Distance along the road, m, in a strip right below it."""
    pygame.draw.rect(surface, RULER, area)
    for metre in range(math.ceil(scene.left), math.floor(scene.right) + 1):
        x = area.left + round((metre - scene.left) * scale)
        height = 7 if metre % 10 == 0 else 5 if metre % 5 == 0 else 3
        pygame.draw.line(surface, TEXT if metre % 5 == 0 else FAINT, (x, area.top), (x, area.top + height))
        if metre % 10 == 0:
            write(surface, f"{metre} m", (x, area.top + 16), 18, anchor="center")


def paint_numbers(surface: Any, reading: Reading, area: Any) -> None:
    """The table of numbers."""
    rows = [
        ("speed", f"{reading.speed:.1f} m/s = {3.6 * reading.speed:.0f} km/h"),
        ("speed ratio", against_critical(reading.speed, reading.critical_speed)),
        ("tire", f"{reading.tire}, friction {reading.friction:.2f}"),
        ("time", f"{reading.time:.2f} s"),
        ("sideslip", f"{_degrees(reading.sideslip)}°"),
        ("yaw rate", f"{_degrees(reading.yaw_rate)}°/s{reading.beside.get('yaw_rate', '')}"),
        ("front steer", f"{_degrees(reading.front_steer)}°{reading.beside.get('front_steer', '')}"),
        ("rear steer", f"{_degrees(reading.rear_steer)}°"),
    ]
    for k, (name, value) in enumerate(rows):
        y = area.top + 13 + 22 * k
        write(surface, name, (area.left, y), 22, FAINT)
        write(surface, value, (area.left + 96, y), 22)
    word, colour = ("running", TEXT)
    if reading.end:
        word, colour = f"ended: {in_words(reading.end)}", p.YELLOW
    elif reading.settled:
        word, colour = "settled, running straight", p.SKY_BLUE
    y = area.top + 13 + 22 * len(rows)
    write(surface, "episode", (area.left, y), 22, FAINT)
    write(surface, word, (area.left + 96, y), 22, colour)


def paint_gauges(surface: Any, reading: Reading, area: Any) -> None:
    """Steer angles between their limits, left steer to the left; below them how much of its grip each axle uses."""
    write(surface, "L", (area.left + 100, area.top + 8), 18, FAINT, "center")
    write(surface, "steer", (area.left + 110 + GAUGE_WIDTH / 2, area.top + 8), 18, FAINT, "center")
    write(surface, "R", (area.left + 120 + GAUGE_WIDTH, area.top + 8), 18, FAINT, "center")
    steers = (
        ("front", reading.front_steer, reading.front_steer_limit),
        ("rear", reading.rear_steer, reading.rear_steer_limit),
    )
    for k, (name, steer, limit) in enumerate(steers):
        y = area.top + 20 + 20 * k
        groove = _groove(surface, name, f"±{math.degrees(limit):.0f}°", area.left, y)
        reach = round(0.5 * GAUGE_WIDTH * min(max(steer / limit, -1.0), 1.0))
        bar = pygame.Rect(groove.centerx - max(reach, 0), groove.top, abs(reach), groove.height)
        pygame.draw.rect(surface, p.SKY_BLUE, bar)
        pygame.draw.line(surface, TEXT, (groove.centerx, groove.top - 2), (groove.centerx, groove.bottom + 1))
    write(surface, "grip used", (area.left + 110 + GAUGE_WIDTH / 2, area.top + 70), 18, FAINT, "center")
    forces = (
        ("front", reading.front_force, reading.front_grip),
        ("rear", reading.rear_force, reading.rear_grip),
    )
    for k, (name, force, grip) in enumerate(forces):
        used = abs(force) / grip
        y = area.top + 82 + 20 * k
        groove = _groove(surface, name, f"{100.0 * used:.0f} %", area.left, y)
        colour = p.SATURATED_FORCE if is_saturated(force, grip) else p.FORCE
        width = round(GAUGE_WIDTH * min(used, 1.0))
        pygame.draw.rect(surface, colour, (groove.left, groove.top, width, groove.height))


def paint_legend(surface: Any, scene: Scene, scale: float, area: Any) -> None:
    """What the arrows and lines on the road mean, and the scale bar."""

    def arrow(x: float, y: float, colour: Colour) -> None:
        outline = arrow_outline(Arrow((x, y), (x + 30.0, y)), 5.0)
        pygame.draw.polygon(surface, colour, outline)

    top, second = area.top + 10, area.left + 200
    arrow(area.left, top, p.FORCE)
    write(surface, "lateral force of an axle", (area.left + 38, top), 19)
    arrow(area.left, top + 20, p.SATURATED_FORCE)
    write(surface, "the same, grip used up", (area.left + 38, top + 20), 19)
    arrow(area.left, top + 40, p.TRAVEL)
    write(surface, "direction of travel", (area.left + 38, top + 40), 19)
    for x in (second, second + 18):
        pygame.draw.line(surface, p.PATH, (x, top), (x + 11, top), 3)
    write(surface, "path to follow", (second + 38, top), 19)
    pygame.draw.line(surface, p.TRAIL, (second, top + 20), (second + 29, top + 20), 2)
    write(surface, "path driven", (second + 38, top + 20), 19)
    if scene.target_lane or scene.ice:  # there is room for one
        colour, words = (p.TARGET, "target lane") if scene.target_lane else (p.ICE, "ice")
        pygame.draw.rect(surface, colour, (second, top + 33, 30, 14))
        pygame.draw.rect(surface, FAINT, (second, top + 33, 30, 14), 1)
        write(surface, words, (second + 38, top + 40), 19)
    y, end = top + 59, area.left + round(SCALE_BAR * scale)
    pygame.draw.line(surface, TEXT, (area.left, y), (end, y), 2)
    for x in (area.left, end):
        pygame.draw.line(surface, TEXT, (x, y - 4), (x, y + 5))
    write(surface, f"{SCALE_BAR:g} m, along and across", (end + 8, y), 19)


def paint_phase_plane(surface: Any, reading: Reading, history: Sequence[Point], area: Any) -> None:
    """Yaw rate against sideslip; beyond the box the car counts as spun. `history`: (sideslip, yaw rate), rad."""
    plot = pygame.Rect(area.left + 46, area.top + 18, area.width - 52, area.height - 52)
    limits = (reading.sideslip_limit, reading.yaw_rate_limit)

    def pixel(point: Point) -> Point:
        sizes = (plot.width - 1, plot.height - 1)
        u, v = (min(max(value / (LIMIT_MARGIN * limit), -1.0), 1.0) for value, limit in zip(point, limits, strict=True))
        return (plot.left + 0.5 * sizes[0] * (1.0 + u), plot.top + 0.5 * sizes[1] * (1.0 - v))

    pygame.draw.rect(surface, RULER, plot)
    for axis, limit in enumerate(limits):
        reach = math.degrees(LIMIT_MARGIN * limit)
        step = max(tick for tick in TICKS if 2.0 * tick <= reach or tick == TICKS[0])
        count = int(reach / step)
        for value in (k * step for k in range(-count, count + 1)):
            place = (math.radians(value), -1e9) if axis == 0 else (-1e9, math.radians(value))
            x, y = pixel(place)
            end = (x, plot.top) if axis == 0 else (plot.right - 1, y)
            pygame.draw.line(surface, FAINT if value == 0 else GROOVE, (x, y), end)
            label = f"{value:+g}" if value else "0"
            if axis == 0:
                write(surface, label, (x, plot.bottom + 9), 17, anchor="center")
            else:
                write(surface, label, (plot.left - 5, y), 17, anchor="midright")
    corners = [pixel((su * limits[0], sv * limits[1])) for su, sv in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    pygame.draw.polygon(surface, p.VERMILLION, corners, 2)
    write(surface, "beyond the box: spun", ((plot.left + plot.right) / 2, plot.top - 9), 18, p.VERMILLION, "center")
    now = (reading.sideslip, reading.yaw_rate)
    points = [pixel(point) for point in (*history, now)]
    if len(points) > 1:
        pygame.draw.lines(surface, p.TRAIL, False, points, 2)
    pygame.draw.circle(surface, p.BLACK, points[-1], 6)
    pygame.draw.circle(surface, TEXT, points[-1], 5)
    write(surface, "sideslip (°)", (plot.centerx, plot.bottom + 25), 19, anchor="center")
    title = pygame.transform.rotate(_text("yaw rate (°/s)", 19, TEXT), 90)
    surface.blit(title, title.get_rect(center=(area.left + 6, plot.centery)))


def paint_end(surface: Any, reading: Reading, area: Any, at_top: bool) -> None:
    """Why the episode has ended, in big letters across the road."""
    image = _text(in_words(reading.end).upper(), 64, p.WHITE)
    box = pygame.Rect(0, 0, image.get_width() + 60, 64)
    box.centerx = area.centerx
    box.top = area.top + 10 if at_top else area.bottom - 10 - box.height
    pygame.draw.rect(surface, p.BLACK, box.inflate(8, 8), border_radius=10)
    pygame.draw.rect(surface, p.VERMILLION, box, border_radius=8)
    surface.blit(image, image.get_rect(center=(box.centerx, box.centery + 3)))


def _groove(surface: Any, name: str, value: str, left: int, y: int) -> Any:
    write(surface, name, (left + 40, y + 6), 19)
    groove = pygame.Rect(left + 110, y, GAUGE_WIDTH, 12)
    pygame.draw.rect(surface, GROOVE, groove)
    write(surface, value, (groove.right + 12, y + 6), 19)
    return groove


def in_words(end: str) -> str:
    """An end as words: "left_lane" must not be read as the lane on the left."""
    return end.replace("left_", "left the ").replace("_", " ")


def _degrees(angle: float) -> str:
    text = f"{math.degrees(angle):+.1f}"
    return "0.0" if text in ("+0.0", "-0.0") else text


def against_critical(speed: float, critical_speed: float) -> str:
    """The speed as a multiple of the critical speed, in words; both in m/s."""
    if math.isinf(critical_speed):
        return "stable at any speed"
    return f"{speed / critical_speed:.2f} times critical ({critical_speed:.1f} m/s)"
