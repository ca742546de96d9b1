"""Renderer of simulator states. pygame-ce is imported with the first picture."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from ..checks import load, raise_invalid
from ..engine.memory import RUNNING
from ..simulator import Simulator
from .camera import cell
from .history import History, Moment

if TYPE_CHECKING:
    from .page import Page
    from .window import Window

RENDER_MODES = ["human", "rgb_array"]
"""Render modes: a live window, or pictures as arrays."""
MAX_TEAMS = 16
"""Maximum number of environments in a picture; the first ones are shown."""


def render_metadata(simulator: Simulator) -> dict[str, Any]:
    """Render modes and frame rate, one frame per step in real time."""
    return {"render_modes": RENDER_MODES.copy(), "render_fps": 1.0 / simulator.scenario.tau}


class Renderer:
    """Renderer of a simulator: paths, headings, bearings, sensor limits, obstacles and V(t).

    Obstacles are orange; a robot has the same colour everywhere, and its number beside it. Its
    wedge points along the body axis, or the last motion if there is none; short arrows are its
    bearings. A thin line connects robots that observe each other, and half a line starts at a robot
    that observes the other one only. Limited ranges and fields of view are drawn in 2-D. A white
    number is the number of merged robots, a cross marks a merge, a ring a contact. The view is
    fitted to the initial condition and the obstacles. 3-D scenes are in perspective, with plumb
    lines to the ground. Of several environments the first ``MAX_TEAMS`` are shown side by side.

    The owner calls ``reset`` and ``see`` after each reset and step. Nothing is recorded without a
    render mode; a copy has the paths, but no window until its next reset.

    Args:
        simulator: the environments.
        render_mode: "human", "rgb_array" or None; a ValueError for another.
        size: width and height in pixels.
        horizon: initial length of the time axis, s; None is a tenth of the time limit.
    """

    def __init__(
        self,
        simulator: Simulator,
        render_mode: str | None,
        size: tuple[int, int] = (600, 600),
        horizon: float | None = None,
    ) -> None:
        known = isinstance(render_mode, str) and render_mode in RENDER_MODES
        if render_mode is not None and not known:
            raise_invalid("render_mode", render_mode, f"None or one of {RENDER_MODES}")
        self.render_mode, self.size = render_mode, size
        self._simulator, self._horizon = simulator, horizon
        self._teams = min(simulator.num_envs, MAX_TEAMS)
        self.policy = ""
        """Name of the policy, which the header of a picture shows."""
        self._histories: list[History] = []
        self._page: Page | None = None
        self.window: Window | None = None  # while one is open
        self._dismissed = False

    def reset(self) -> None:
        """Start new histories after a reset; in "human" mode open the window."""
        if self.render_mode is not None:
            self._look()
            self._show()

    def see(self, contact: NDArray[np.bool_]) -> None:
        """Record a step with contacts (B, n); in "human" mode show it, at most in real time."""
        if self.render_mode is None:
            return
        self._look(contact)
        if self.window is not None:
            over = not (self._simulator.status == RUNNING).any()
            if over or self.window.wants_picture:
                self._show()
            self.window.wait(self._simulator.scenario.tau)
            if self.window.closed:
                self.window, self._dismissed = None, True

    def render(self) -> NDArray[np.uint8] | None:
        """Picture, (height, width, 3); None in "human" mode.

        Raises:
            RuntimeError: before the first reset, or if no window can be opened.
            ImportError: without the extra ``render``.
        """
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() draws nothing without a render mode; choose one when the environment is "
                f"made: render_mode={RENDER_MODES[0]!r} or {RENDER_MODES[1]!r}"
            )
            return None
        if not self._histories and self._simulator.get_state()["episode"][0] < 0:
            raise RuntimeError("call reset() before render()")
        self._look()
        if self.render_mode == "human":
            self._show()
            return None
        surface, (width, height) = self._draw(), self.size
        flat = np.frombuffer(_load_pygame().image.tobytes(surface, "RGB"), dtype=np.uint8)
        return flat.reshape(height, width, 3).copy()

    def pictures(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Pictures of the single environments; errors and "human" mode as ``render``.

        Environments beyond the first ``MAX_TEAMS`` share one blank picture.
        """
        if (picture := self.render()) is None:
            return None
        parts = []
        for team in range(self._teams):
            left, top, width, height = cell(team, self._teams, *self.size)
            parts.append(picture[top : top + height, left : left + width])
        blank = np.full_like(parts[0], 255)
        return (*parts, *[blank] * (self._simulator.num_envs - self._teams))

    def pixels(self, positions: NDArray[np.float64], team: int = 0) -> NDArray[np.float64]:
        """Pixels (..., 2) of points (..., d), m, of an environment in the last picture."""
        if self._page is None:
            raise RuntimeError("call render() before pixels()")
        return self._page.pixels(positions, team)

    def surface(self, keeps_view: bool = False) -> Any:
        """Picture of the current state as a pygame surface, which the next picture overwrites.

        With ``keeps_view`` the view stays as it is if the state was changed from outside.
        """
        self._look()
        self._open_page().keeps_view = keeps_view
        return self._draw()

    def points(self, pixels: NDArray[np.float64], team: int = 0) -> NDArray[np.float64]:
        """Points (..., 2), m, of pixels of a planar environment; the inverse of ``pixels``."""
        if self._page is None:
            raise RuntimeError("call render() before points()")
        return self._page.points(pixels, team)

    def close(self) -> None:
        """Close the window."""
        if self.window is not None:
            self.window.close()
            self.window = None

    def _look(self, contact: NDArray[np.bool_] | None = None) -> None:
        """Append the current state to the histories; a new episode starts a new history."""
        simulator, teams, histories = self._simulator, self._teams, self._histories
        if contact is None:
            contact = np.zeros(simulator.merged_into.shape, dtype=np.bool_)
        columns = (
            simulator.steps[:teams].tolist(),
            simulator.time[:teams].tolist(),
            simulator.positions[:teams].copy(),
            simulator.headings[:teams],
            simulator.merged_into[:teams],
            contact[:teams].copy(),
            simulator.lyapunov()[:teams].tolist(),
            simulator.obstacles[:teams].copy(),
            simulator.failed[:teams],
        )
        initially = simulator.initial_lyapunov.tolist()
        self._histories = []
        for team, moment in enumerate(map(Moment, *columns)):
            obstacles, initial = moment.obstacles, initially[team]
            history = histories[team] if histories else None
            if history is not None:
                last = history.moments[-1]
                seen_already = (
                    moment.steps == last.steps
                    and np.array_equal(moment.positions, last.positions)
                    and np.array_equal(obstacles, last.obstacles)
                )
                if moment.steps == last.steps + 1 and initial == history.initial_lyapunov:
                    history.moments.append(moment)
                elif not seen_already:
                    history = None
            self._histories.append(history or History(obstacles, initial, [moment]))

    def _open_page(self) -> Page:
        if self._page is None:
            _load_pygame()
            from .page import Page

            self._page = Page(self._simulator, self.size, self._horizon)
        return self._page

    def _draw(self) -> Any:
        return self._open_page().draw(self._histories, self.policy)

    def _show(self) -> None:
        """Draw into the window unless the user has closed it."""
        if self.render_mode != "human" or self._dismissed:
            return
        picture, pygame = self._draw(), _load_pygame()
        if self.window is None:
            from .window import Window

            try:
                self.window = Window(f"rendezvous: {self._simulator.scenario.name}", self.size)
            except pygame.error as error:
                raise RuntimeError(
                    f'no window can be opened here ({error}); render_mode="rgb_array" needs none'
                ) from error
        self.window.show(picture)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_page": None, "window": None}


def _load_pygame() -> Any:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    return load("pygame", "a picture", "render")
