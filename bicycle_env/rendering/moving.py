"""Moving pictures: cars below each other, and the files whose frames they become. Pictures are (height, width, 3)."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bicycle_env.files import write_bytes
from bicycle_env.installation import needs
from bicycle_env.rendering import painting as p
from bicycle_env.rendering.dashboard import BACKGROUND, FAINT, TEXT, fitted, write
from bicycle_env.rendering.painting import pygame
from bicycle_env.rendering.viewer import ROAD_HEIGHT

Picture = NDArray[np.uint8]
LINE = 20
"""Rows of a heading."""
HIGHEST = 940
"""Rows of a window, on a screen of 1080."""
LINGER = 1.5
"""s that the last picture of an episode stays."""


class Panel(NamedTuple):
    """One car of several."""

    heading: str
    picture: Picture
    failed: bool


def top_view(picture: Picture) -> Picture:
    """The road of an environment's picture, without its instruments."""
    return picture[:ROAD_HEIGHT]


def stacked(panels: Sequence[Panel], caption: Sequence[str] = (), share: float = 1.0) -> Picture:
    """Panels below each other, each under its heading, and a caption of parts at the foot; `share` of their size."""
    height, width = (round(share * side) for side in panels[0].picture.shape[:2])
    foot = len(panels) * (height + LINE)
    surface = pygame.Surface((width, foot + (LINE if caption else 0)))
    surface.fill(BACKGROUND)
    for row, panel in enumerate(panels):
        top = row * (height + LINE)
        write(surface, panel.heading, (8, top + LINE // 2), 20, p.VERMILLION if panel.failed else TEXT)
        image = pygame.image.frombuffer(panel.picture.tobytes(), panel.picture.shape[1::-1], "RGB")
        surface.blit(pygame.transform.smoothscale(image, (width, height)), (0, top + LINE))
    if caption:
        write(surface, fitted(caption, 19, width - 16), (8, foot + LINE // 2), 19, FAINT)
    return np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8).reshape(*surface.get_size()[::-1], 3)


def share_on_screen(panels: Sequence[Panel]) -> float:
    """Of their size, at most all of it, with which a stack of panels and its caption is no higher than `HIGHEST`."""
    room = HIGHEST - LINE * (len(panels) + 1)
    return min(1.0, room / float(sum(len(panel.picture) for panel in panels)))


class Film(Protocol):
    """A file of pictures."""

    every: int
    """Control steps from one picture to the next."""
    shares: tuple[float, float]
    """Of the size of pictures: of one, which has text, and of several."""

    def add(self, picture: Picture, last: bool = False) -> None:
        """One picture more; the last of an episode stays for a while."""

    def close(self) -> None:
        """Write the file, whole or not at all."""


class GIF:
    """Loops for ever; needs Pillow. `timestep`: from one control step to the next, s."""

    every = 4
    shares = (0.8, 0.62)
    colors = 96

    def __init__(self, path: str | Path, timestep: float) -> None:
        try:
            from PIL import Image
        except ImportError as error:
            raise ModuleNotFoundError(needs("a GIF", "Pillow", "render")) from error
        self._image, self._path = Image, Path(path)
        # Browsers show what should last less than 20 ms for 100 ms.
        self._milliseconds = max(20, 10 * round(100.0 * timestep * self.every))
        self._pages: list[Any] = []
        self._durations: list[int] = []

    def add(self, picture: Picture, last: bool = False) -> None:
        page = self._image.fromarray(picture)
        # An octree keeps colours of few pixels, such as a cone's, where the median cut gives them to others.
        look: Any = {"method": self._image.Quantize.FASTOCTREE, "dither": self._image.Dither.NONE}
        self._pages.append(page.quantize(self.colors, **look))
        self._durations.append(round(1000 * LINGER) if last else self._milliseconds)

    def close(self) -> None:
        content = io.BytesIO()
        first, *others = self._pages
        look: Any = {"append_images": others, "duration": self._durations, "loop": 0, "optimize": True}
        first.save(content, "GIF", save_all=True, **look)
        write_bytes(self._path, content.getvalue())


class MP4:
    """H.264, as every browser plays it; needs imageio-ffmpeg, which brings its own ffmpeg."""

    every = 2
    shares = (1.0, 1.0)

    def __init__(self, path: str | Path, timestep: float) -> None:
        try:
            import imageio_ffmpeg
        except ImportError as error:
            raise ModuleNotFoundError(needs("an mp4", "imageio-ffmpeg", "video")) from error
        self._ffmpeg, self._path = imageio_ffmpeg, Path(path)
        self._rate = 1.0 / (timestep * self.every)
        self._folder = tempfile.TemporaryDirectory()
        self._file = Path(self._folder.name) / "film.mp4"
        self._writer: Any = None

    def add(self, picture: Picture, last: bool = False) -> None:
        if self._writer is None:
            size = picture.shape[1::-1]
            self._writer = self._ffmpeg.write_frames(str(self._file), size, fps=self._rate, macro_block_size=2)
            self._writer.send(None)
        for _ in range(max(1, round(LINGER * self._rate)) if last else 1):
            self._writer.send(np.ascontiguousarray(picture))

    def close(self) -> None:
        self._writer.close()
        write_bytes(self._path, self._file.read_bytes())
        self._folder.cleanup()


FILMS: dict[str, Any] = {".gif": GIF, ".mp4": MP4}
"""By the ending of the file's name."""
