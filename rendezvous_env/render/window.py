"""A window that plays what happens: space pauses, the right arrow or s makes one step."""

from __future__ import annotations

import time

import pygame

_LEAST_PAUSE = 1 / 60
"""Between two pictures, s; steps that are shorter are not all shown."""
_PAUSE_KEYS = (pygame.K_SPACE,)
_STEP_KEYS = (pygame.K_RIGHT, pygame.K_s)
_CLOSE_KEYS = (pygame.K_ESCAPE, pygame.K_q)


class Window:
    """A window of its own, in which time passes as in the simulation or more slowly.

    Args:
        title: of the window.
        size: width and height in pixels.
    """

    def __init__(self, title: str, size: tuple[int, int]) -> None:
        pygame.display.init()
        self._title = title
        self.screen: pygame.Window | None = pygame.Window(title, size)
        self.paused = False
        self._steps = 0
        self._due = self._shown = time.monotonic()

    @property
    def closed(self) -> bool:
        """Whether it is gone, closed by its user or by ``close``."""
        return self.screen is None

    @property
    def wants_picture(self) -> bool:
        """Whether it is time for the next picture."""
        self._read_events()
        return self.paused or time.monotonic() - self._shown >= _LEAST_PAUSE

    def show(self, picture: pygame.Surface) -> None:
        """Put a picture into the window."""
        if self.screen is not None:
            self.screen.get_surface().blit(picture, (0, 0))
            self.screen.flip()
            self._shown = time.monotonic()

    def wait(self, seconds: float) -> None:
        """Wait until a step of so many seconds is over; while paused, for a key."""
        while self.is_held():
            time.sleep(0.01)
        now = time.monotonic()
        self._due = max(self._due + seconds, now)
        time.sleep(self._due - now)

    def is_held(self) -> bool:
        """Whether it is paused, and no single step is asked for."""
        self._read_events()
        if not self.paused or self.closed:
            return False
        if self._steps:
            self._steps -= 1
            return False
        return True

    def _read_events(self) -> None:
        for event in pygame.event.get() if self.screen is not None else ():
            if getattr(event, "window", None) not in (None, self.screen):
                continue
            if event.type in (pygame.QUIT, pygame.WINDOWCLOSE):
                self.close()
            elif event.type == pygame.KEYDOWN:
                self._press(event.key)

    def _press(self, key: int) -> None:
        if key in _PAUSE_KEYS:
            self.paused, self._steps = not self.paused, 0
        elif key in _STEP_KEYS:
            self.paused, self._steps = True, self._steps + 1
        elif key in _CLOSE_KEYS:
            self.close()
        if self.screen is not None:
            self.screen.title = self._title + (" (paused)" if self.paused else "")

    def close(self) -> None:
        """Take the window off the screen."""
        if self.screen is not None:
            self.screen.destroy()
            self.screen = None
