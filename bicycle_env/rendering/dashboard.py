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
from bicycle_env.rendering.told import in_words

BACKGROUND: Colour = (20, 22, 26)
RULER: Colour = (34, 37, 42)
TEXT: Colour = (236, 236, 232)
FAINT: Colour = (150, 154, 160)
GROOVE: Colour = (58, 62, 68)

GAUGE_WIDTH = 132
ROW = 20
"""Pixels from a number to the next."""
LEGEND_ROW = 17
LEGEND_ROWS = 5
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
    beside: Mapping[str, tuple[str, float]]
    """By the quantity's name, what the task or the driver wants of it: who, and how much."""
    front_steer_command: float
    rear_steer_command: float
    gust: float
    """Force to the left, N."""
    drawn: Sequence[str]
    """What of this episode was drawn and is not to be seen, in words."""


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


def paint_drawn(surface: Any, reading: Reading, area: Any) -> None:
    """What was drawn for this episode, as much of it as has room."""
    if reading.drawn:
        words = fitted(("drawn for this episode:", *reading.drawn), 19, area.width)
        write(surface, words, (area.left, area.centery), 19, FAINT)


def fitted(parts: Sequence[str], size: int, width: int) -> str:
    """The parts in one line, as many as there is room for in a width [pixels], and how many are left out."""
    for kept in range(len(parts), 0, -1):
        left = [f"{len(parts) - kept} more"] if kept < len(parts) else []
        words = ", ".join([*parts[:kept], *left]).replace(":,", ":", 1)
        if _font(2 * size).size(words)[0] <= 2 * width:
            break
    return words


def paint_numbers(surface: Any, reading: Reading, area: Any) -> None:
    """The table of numbers."""
    wind = f", gust {reading.gust:+.0f} N" if reading.gust else ""
    rows = [
        ("speed", f"{reading.speed:.1f} m/s = {3.6 * reading.speed:.0f} km/h"),
        ("speed ratio", against_critical(reading.speed, reading.critical_speed)),
        ("tire", f"{reading.tire}, friction {reading.friction:.2f}"),
        ("time", f"{reading.time:.2f} s{wind}"),
        ("sideslip", f"{_degrees(reading.sideslip)}°"),
        ("yaw rate", f"{_degrees(reading.yaw_rate)}°/s{_beside(reading, 'yaw_rate')}"),
        ("front steer", f"{_degrees(reading.front_steer)}°{_beside(reading, 'front_steer')}"),
        ("rear steer", f"{_degrees(reading.rear_steer)}°"),
    ]
    for k, (name, value) in enumerate(rows):
        y = area.top + 10 + ROW * k
        write(surface, name, (area.left, y), 22, FAINT)
        write(surface, value, (area.left + 96, y), 22)
    word, colour = ("running", TEXT)
    if reading.end:
        word, colour = f"ended: {in_words(reading.end)}", p.YELLOW
    elif reading.settled:
        word, colour = "settled, running straight", p.SKY_BLUE
    y = area.top + 10 + ROW * len(rows)
    write(surface, "episode", (area.left, y), 22, FAINT)
    write(surface, word, (area.left + 96, y), 22, colour)


def paint_gauges(surface: Any, reading: Reading, area: Any) -> None:
    """Steer angles between their limits, left steer to the left, and a tip at what is commanded; below them how much of
    its grip each axle uses."""
    write(surface, "L", (area.left + 100, area.top + 5), 18, FAINT, "center")
    write(surface, "steer (tip: command)", (area.left + 110 + GAUGE_WIDTH / 2, area.top + 5), 18, FAINT, "center")
    write(surface, "R", (area.left + 120 + GAUGE_WIDTH, area.top + 5), 18, FAINT, "center")
    steers = (
        ("front", reading.front_steer, reading.front_steer_limit, reading.front_steer_command),
        ("rear", reading.rear_steer, reading.rear_steer_limit, reading.rear_steer_command),
    )
    for k, (name, steer, limit, command) in enumerate(steers):
        y = area.top + 17 + 19 * k
        groove = _groove(surface, name, f"±{math.degrees(limit):.0f}°", area.left, y)
        reach, tip = (round(0.5 * GAUGE_WIDTH * min(max(part / limit, -1.0), 1.0)) for part in (steer, command))
        bar = pygame.Rect(groove.centerx - max(reach, 0), groove.top, abs(reach), groove.height)
        pygame.draw.rect(surface, p.SKY_BLUE, bar)
        pygame.draw.line(surface, TEXT, (groove.centerx, groove.top - 2), (groove.centerx, groove.bottom + 1))
        x = groove.centerx - tip
        pygame.draw.polygon(surface, TEXT, ((x, groove.top - 1), (x - 4, groove.top - 6), (x + 4, groove.top - 6)))
    write(surface, "grip used", (area.left + 110 + GAUGE_WIDTH / 2, area.top + 58), 18, FAINT, "center")
    forces = (
        ("front", reading.front_force, reading.front_grip),
        ("rear", reading.rear_force, reading.rear_grip),
    )
    for k, (name, force, grip) in enumerate(forces):
        used = abs(force) / grip
        y = area.top + 66 + 17 * k
        groove = _groove(surface, name, f"{100.0 * used:.0f} %", area.left, y)
        colour = p.SATURATED_FORCE if is_saturated(force, grip) else p.FORCE
        width = round(GAUGE_WIDTH * min(used, 1.0))
        pygame.draw.rect(surface, colour, (groove.left, groove.top, width, groove.height))


def paint_legend(surface: Any, scene: Scene, scale: float, area: Any) -> None:
    """What the arrows, lines and patches on the road mean, and the scale bar."""

    def arrow(colour: Colour) -> Any:
        def paint(x: float, y: float) -> None:
            pygame.draw.polygon(surface, colour, arrow_outline(Arrow((x, y), (x + 30.0, y)), 5.0))

        return paint

    def patch(colour: Colour) -> Any:
        def paint(x: float, y: float) -> None:
            pygame.draw.rect(surface, colour, (x, y - 6, 30, 12))
            pygame.draw.rect(surface, FAINT, (x, y - 6, 30, 12), 1)

        return paint

    def dashes(x: float, y: float) -> None:
        for begin in (x, x + 18):
            pygame.draw.line(surface, p.PATH, (begin, y), (begin + 11, y), 3)

    def line(x: float, y: float) -> None:
        pygame.draw.line(surface, p.TRAIL, (x, y), (x + 29, y), 2)

    def cones(x: float, y: float) -> None:
        pygame.draw.circle(surface, p.CONE, (x + 7, y), 4)
        pygame.draw.circle(surface, p.STRUCK, (x + 22, y), 6)

    def outside(x: float, y: float) -> None:
        pygame.draw.circle(surface, p.OUTSIDE, (x + 15, y), 4)

    left = [
        (arrow(p.FORCE), "lateral force of an axle"),
        (arrow(p.SATURATED_FORCE), "the same, grip used up"),
        (arrow(p.TRAVEL), "direction of travel"),
        *([(arrow(p.GUST), "gust")] if scene.gust.start != scene.gust.end else []),
    ]
    right = [
        (dashes, "reference path"),
        (line, "path driven"),
        *([(patch(p.TARGET), "target lane")] if scene.target_lane else []),
        *([(patch(p.ICE), "ice")] if scene.ice else []),
        *([(patch(p.OBSTACLE), "obstacle")] if scene.obstacles else []),
        *([(cones, "cone; hit")] if scene.cones or scene.struck else []),
        *([(outside, "corner outside")] if scene.outside else []),
    ]
    for column, x in ((left, area.left), (right, area.left + 200)):
        for k, (paint, words) in enumerate(column[:LEGEND_ROWS]):
            y = area.top + 8 + LEGEND_ROW * k
            paint(x, y)
            write(surface, words, (x + 38, y), 19)
    y, end = area.top + 8 + LEGEND_ROW * (LEGEND_ROWS - 1), area.left + round(SCALE_BAR * scale)
    pygame.draw.line(surface, TEXT, (area.left, y), (end, y), 2)
    for x in (area.left, end):
        pygame.draw.line(surface, TEXT, (x, y - 4), (x, y + 5))
    write(surface, f"{SCALE_BAR:g} m", (end + 8, y), 19)


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


def _beside(reading: Reading, quantity: str) -> str:
    if quantity not in reading.beside:
        return ""
    who, value = reading.beside[quantity]
    return f" ({who} {round(math.degrees(value), 1) + 0.0:+.1f})"


def _degrees(angle: float) -> str:
    text = f"{math.degrees(angle):+.1f}"
    return "0.0" if text in ("+0.0", "-0.0") else text


def against_critical(speed: float, critical_speed: float) -> str:
    """The speed as a multiple of the critical speed, in words; both in m/s."""
    if math.isinf(critical_speed):
        return "stable at any speed"
    return f"{speed / critical_speed:.2f} times critical ({critical_speed:.1f} m/s)"
