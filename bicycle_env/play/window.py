"""The window of ``bicycle-env play``: pictures at the speed of the road, and what its user does."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from bicycle_env.play.session import NoDisplayError
from bicycle_env.rendering.moving import LINGER, Picture
from bicycle_env.rendering.painting import open_display, pygame

MOST_BEHIND = 3.0
"""So many pictures that there was no time for are left out, one after the other; beyond that time goes slower."""
TITLE = "bicycle_env: Esc leaves, the space bar goes on"


class Window:
    """Opens with the first picture; `drivers` are given its events; `rate`: pictures per s."""

    def __init__(self, rate: float, drivers: list[Any]) -> None:
        self._rate, self._drivers = rate, drivers
        self._surface: Any = None
        self._clock: Any = None
        self._sticks: list[Any] = []
        self.shut = False
        """Whether its user has closed it."""
        self._behind = 0.0
        self._shown = time.perf_counter()

    def skips(self) -> bool:
        """Whether the next picture is to be left out, because the ones before took too long; events are taken then."""
        if self._behind < 1.0:
            return False
        self._behind -= 1.0
        self._listen()
        return True

    def show(self, picture: Picture, wait: bool = False) -> bool:
        """One picture, and whether to go on; where it waits, then for a while, or for the space bar."""
        size = picture.shape[1::-1]
        if self._surface is None or self._surface.get_size() != size:
            self._open(size)
        image = pygame.image.frombuffer(np.ascontiguousarray(picture).tobytes(), size, "RGB")
        self._surface.blit(image, (0, 0))
        pygame.display.flip()
        for _ in range(max(1, round(LINGER * self._rate)) if wait else 1):
            on = self._listen()
            self._clock.tick(self._rate)
            if self.shut or (wait and on):
                break
        now = time.perf_counter()
        self._behind = max(0.0, min(self._behind + (now - self._shown) * self._rate - 1.0, MOST_BEHIND))
        self._shown = now
        if wait:
            self._behind = 0.0
        return not self.shut

    def close(self) -> None:
        """May be called again."""
        if self._clock is not None:
            self._clock, self._surface, self._sticks = None, None, []
            pygame.joystick.quit()
            pygame.display.quit()

    def _open(self, size: tuple[int, ...]) -> None:
        try:
            open_display()
            self._surface = pygame.display.set_mode(size)
        except pygame.error as error:
            raise NoDisplayError(f"no window can be opened here ({error}): give --out FILE.gif") from None
        pygame.display.set_caption(TITLE)
        pygame.joystick.init()
        self._sticks = [pygame.joystick.Joystick(k) for k in range(pygame.joystick.get_count())]
        self._clock = pygame.time.Clock()

    def _listen(self) -> bool:
        """Pass events on; whether the space bar was pressed."""
        on = False
        for event in pygame.event.get():
            pressed = event.key if event.type == pygame.KEYDOWN else None
            self.shut |= event.type == pygame.QUIT or pressed == pygame.K_ESCAPE
            on |= pressed == pygame.K_SPACE
            for driver in self._drivers:
                driver.take(event)
        return on
