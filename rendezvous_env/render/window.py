"""Live window: space pauses, the right arrow or s makes a single step, q closes."""

import time

import pygame

_LEAST_PAUSE = 1 / 60  # minimum time between two pictures, s; of shorter steps only some are shown


class Window:
    """Window that shows an episode at most in real time.

    ``step_keys`` make a single step. Events without a meaning for the window are listed in
    ``events`` if it ``listens``.
    """

    def __init__(
        self,
        title: str,
        size: tuple[int, int],
        step_keys: tuple[int, ...] = (pygame.K_RIGHT, pygame.K_s),
        listens: bool = False,
    ) -> None:
        self._title, self._size, self._step_keys = title, size, step_keys
        self._listens = listens
        self.events: list[pygame.Event] = []
        """Events for the owner, who clears the list."""
        self.screen: pygame.Window | None = self._opened()
        self.paused = False
        self._steps = 0  # requested while paused
        self._due = self._shown = time.monotonic()

    @property
    def closed(self) -> bool:
        """True if the window is closed."""
        return self.screen is None

    @property
    def wants_picture(self) -> bool:
        """True if the next picture is due."""
        self._read_events()
        return self.paused or time.monotonic() - self._shown >= _LEAST_PAUSE

    def show(self, picture: pygame.Surface) -> None:
        """Show a picture."""
        if self.screen is None:
            return
        try:
            self.screen.get_surface().blit(picture, (0, 0))
        except pygame.error:  # other code has quit pygame, and with it all windows
            self.screen = None  # first: freed later, it could close a new window at its address
            self.screen = self._opened()
            self.screen.get_surface().blit(picture, (0, 0))
        self.screen.flip()
        self._shown = time.monotonic()

    def wait(self, seconds: float) -> None:
        """Wait until a step of the given duration is over, or for a key while paused."""
        while self.is_held():
            time.sleep(0.01)
        self.wait_until(seconds)

    def wait_until(self, seconds: float) -> None:
        """Wait until a step of the given duration is over."""
        now = time.monotonic()
        self._due = max(self._due + seconds, now)
        time.sleep(self._due - now)

    def is_held(self) -> bool:
        """True if it is paused without a pending single step."""
        self._read_events()
        if not self.paused or self.closed:
            return False
        if self._steps:
            self._steps -= 1
            return False
        return True

    def _opened(self) -> pygame.Window:
        pygame.display.init()
        return pygame.Window(self._title, self._size)

    def _read_events(self) -> None:
        pygame.display.init()  # it may have been ended
        for event in pygame.event.get() if self.screen is not None else ():
            if getattr(event, "window", None) not in (None, self.screen):
                continue
            key = event.key if event.type == pygame.KEYDOWN else None
            if key == pygame.K_SPACE:
                self.paused, self._steps = not self.paused, 0
            elif key is not None and key in self._step_keys:
                self.paused, self._steps = True, self._steps + 1
            elif key in (pygame.K_ESCAPE, pygame.K_q) or event.type in (
                pygame.QUIT,
                pygame.WINDOWCLOSE,
            ):
                self.close()
            elif self._listens:
                self.events.append(event)
            if key is not None and self.screen is not None:
                self.screen.title = self._title + (" (paused)" if self.paused else "")

    def close(self) -> None:
        """Close the window."""
        if self.screen is not None:
            self.screen.destroy()
            self.screen = None
