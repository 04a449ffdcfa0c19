"""The corridor of a task as it is drawn: its edges along the road, so fine that a step looks like a step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float]
Shape = tuple[Point, ...]
Line = NDArray[np.float64]

SPACING = 0.1
"""m, of the places at which the edges are asked for; the same ones in all pictures of a road."""
MOST_PLACES = 5000
HALVINGS = 4
"""How often an interval is halved in which an edge changes by more than ``JUMP``: to 6 mm, less than a pixel."""
JUMP = 0.05
"""m."""


class Corridor(NamedTuple):
    """Right and left edge, straight between these places. The ends are beyond the borders of the picture."""

    places: Line
    """Along the road, m."""
    right: Line
    """Lateral positions, m."""
    left: Line

    @property
    def is_straight(self) -> bool:
        """Whether it is the same everywhere."""
        return len(self.places) == 2 and self.right[0] == self.right[1] and self.left[0] == self.left[1]

    @property
    def outline(self) -> Shape:
        """Of all that is inside."""
        return (*_points(self.places, self.right), *reversed(_points(self.places, self.left)))

    def lines(self, width: float) -> tuple[Shape, Shape]:
        """Outlines of the lines of this width [m] along the right and the left edge."""
        return _band(self.places, self.right, width), _band(self.places, self.left, width)

    def beside(self, begin: float, end: float) -> tuple[float, float]:
        """The outermost lateral positions of the right and the left edge between two places, m."""
        places = np.array([begin, *self.places[(self.places > begin) & (self.places < end)], end])
        right, left = (np.interp(places, self.places, edge) for edge in (self.right, self.left))
        return float(np.min(right)), float(np.max(left))


def corridor(reference: Callable[[Line], Any], begin: float, end: float) -> Corridor:
    """What the corridor is from `begin` to `end` [m]. ``reference(places)``: the task's reference there."""

    def edges(places: Line) -> NDArray[np.float64]:
        found = reference(places)
        centre, half = (np.broadcast_to(x, places.shape) for x in (found.road_centre, found.road_half_width))
        return np.array([centre - half, centre + half])

    spacing = max(SPACING, (end - begin) / MOST_PLACES)
    places = spacing * np.arange(np.floor(begin / spacing), np.ceil(end / spacing) + 1)
    sides = edges(places)
    for _ in range(HALVINGS):
        jumps = np.any(abs(np.diff(sides)) > JUMP, axis=0)
        places = np.sort(np.concatenate([places, 0.5 * (places[:-1] + places[1:])[jumps]]))
        sides = edges(places)
    # Where both edges run on as they are, the ends are enough.
    changes = np.any(np.diff(sides) != 0.0, axis=0)
    kept = np.concatenate([[True], changes[:-1] | changes[1:], [True]])
    return Corridor(places[kept], *sides[:, kept])


def _points(x: Line, y: Line) -> Shape:
    return tuple(zip(x.tolist(), y.tolist(), strict=True))


def _band(x: Line, y: Line, width: float) -> Shape:
    """A line through these points, as wide everywhere, with its corners."""
    along, across = np.diff(x), np.diff(y)
    length = np.hypot(along, across)
    normals = np.array([-across / length, along / length])
    before = np.concatenate([normals[:, :1], normals], axis=1)
    after = np.concatenate([normals, normals[:, -1:]], axis=1)
    corner = (before + after) / np.maximum(1.0 + np.sum(before * after, axis=0), 0.5)  # a spike's ends somewhere
    aside = 0.5 * width * corner
    return (*_points(x + aside[0], y + aside[1]), *reversed(_points(x - aside[0], y - aside[1])))
