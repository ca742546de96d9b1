"""Interactive episode in a window: pause, step, drag, and drive one robot by keys.

space           pause
s               single step
click, tab      select a robot; the panel shows its observation
mouse           drag a robot or, in the plane, an obstacle
d               drive the selected robot, or let the policy drive it
arrows          drive: directions of the picture, or speed and turn rate
page up, down   drive in 3-D: the third component of the action
r               next episode
q, escape       close
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

from ..engine.memory import RUNNING
from ..obstacles.obstacle_set import clear_of_obstacles, distance_to, world_of
from ..obstacles.polygon import POLYGON
from ..obstacles.shape import CENTRE, CORNERS, DETAILS, KIND
from ..simulator import Simulator
from . import ink, panel
from .palette import robot_colour
from .renderer import Renderer
from .window import Window

_REACH = 14.0  # pixels, from which a click selects a robot
_NEAREST = 1e-6  # m; robots are not dropped closer to each other
_IDLE = 0.02  # polling interval of the keys while paused, s
_LEFT_BUTTON = 1
_DIRECTIONS = {
    pygame.K_RIGHT: (1, 0, 0),
    pygame.K_LEFT: (-1, 0, 0),
    pygame.K_UP: (0, 1, 0),
    pygame.K_DOWN: (0, -1, 0),
    pygame.K_PAGEUP: (0, 0, 1),
    pygame.K_PAGEDOWN: (0, 0, -1),
}
"""Keys that drive: to the right, up, and the third axis."""
Policy = Callable[[NDArray[np.float32], NDArray[np.float64]], Any]


class Player:
    """Episode of one environment that a user watches and changes.

    Args:
        simulator: one environment.
        policy: maps observations (1, n, rows, d) and times (1,) in s to actions (1, n, a).
        name: name of the policy for the header.
        size: edge of the picture, pixels; the panel is beside it.
        seed: seed of the first episode.
        begin: called after every reset.

    Raises:
        RuntimeError: if no window can be opened.
    """

    def __init__(
        self,
        simulator: Simulator,
        policy: Policy,
        name: str = "",
        size: int = 700,
        seed: int | None = 0,
        begin: Callable[[], None] = lambda: None,
    ) -> None:
        self.simulator, self._policy, self._begin = simulator, policy, begin
        self._renderer = Renderer(simulator, "rgb_array", (size, size))
        self._renderer.policy = name
        self.selected = 0
        """Index of the selected robot."""
        self.driven: int | None = None
        """Index of the robot that the keys drive, or None."""
        self._held: set[int] = set()  # keys
        self._dragged: tuple[str, int] | None = None  # "robot" or "obstacle", and its index
        self._grip = np.zeros(2)  # last point of the mouse, m
        self._canvas = pygame.Surface((size + panel.WIDTH, size), depth=32)
        try:
            steps = (pygame.K_s,)
            title = f"rendezvous: {simulator.scenario.name}"
            self.window = Window(title, self._canvas.get_size(), steps, listens=True)
        except pygame.error as error:
            raise RuntimeError(f"no window can be opened here ({error})") from error
        self._reset(seed)

    @property
    def paused(self) -> bool:
        """True while the episode is paused."""
        return self.window.paused

    @property
    def closed(self) -> bool:
        """True if the window is closed."""
        return self.window.closed

    def run(self, max_steps: int | None = None) -> int:
        """Play until the window is closed, or for a number of steps; returns the steps made."""
        made = 0
        while not self.closed and (max_steps is None or made < max_steps):
            made += self.advance()
        return made

    def advance(self) -> bool:
        """Process events, make a step unless the episode is paused or over, and draw.

        Returns whether a step was made.
        """
        held = self.window.is_held()
        self._process_events()
        if self.closed:
            return False
        steps = not held and bool((self.simulator.status == RUNNING).all())
        if steps:
            self._step()
        if not steps or self.window.wants_picture:
            self._show()
        if steps:
            self.window.wait_until(self.simulator.scenario.tau)
        else:
            time.sleep(_IDLE)
        return steps

    def close(self) -> None:
        """Close the window."""
        self.window.close()

    def _reset(self, seed: int | None = None) -> None:
        self._observations = self.simulator.reset(seed)
        self._begin()
        self._dragged = None
        self._renderer.reset()
        self._show(keeps_view=False)

    def _step(self) -> None:
        actions = np.array(
            self._policy(self._observations.copy(), self.simulator.time), dtype=np.float32
        )
        if self.driven is not None:
            actions[0, self.driven] = self._driven_action(self.driven)
        output = self.simulator.step(actions)
        self._observations = output.observations
        self._renderer.see(output.contact)
        survivors = self.simulator.merged_into[0]
        self.selected = int(survivors[self.selected])
        if self.driven is not None:
            self.driven = int(survivors[self.driven])

    def _driven_action(self, robot: int) -> NDArray[np.float64]:
        """Action of the held keys: at the limits of the robot, in its own frame."""
        scenario = self.simulator.scenario
        own, bounds, dim = scenario.of_robot(robot), scenario.robot_bounds[robot], scenario.dim
        ways = [_DIRECTIONS[key] for key in self._held if key in _DIRECTIONS]
        right, up, third = np.sum(ways, axis=0) if ways else np.zeros(3)
        action = np.zeros(len(bounds))
        if own.model.n_angles:  # speed along its axis, then turn rates: left is positive
            action[: own.action_size] = (up, -right, third)[: own.action_size]
            return action * bounds
        way = np.array([right, up, third][:dim], dtype=np.float64)
        if (length := float(np.linalg.norm(way))) > 0.0:
            way /= length
        action[:dim] = self.simulator.frames[0, robot].T @ way
        return action * bounds[:1]

    def _process_events(self) -> None:
        events, self.window.events = self.window.events, []
        moved = None
        for event in events:
            if event.type == pygame.KEYDOWN:
                self._held.add(event.key)
                self._press(event.key)
            elif event.type == pygame.KEYUP:
                self._held.discard(event.key)
            elif event.type == pygame.MOUSEBUTTONDOWN and event.button == _LEFT_BUTTON:
                self._grab(event.pos)
            elif event.type == pygame.MOUSEMOTION:
                moved = event.pos  # only the last of several
            elif event.type == pygame.MOUSEBUTTONUP and event.button == _LEFT_BUTTON:
                self._drag(event.pos)
                moved, self._dragged = None, None
        if moved is not None:
            self._drag(moved)

    def _press(self, key: int) -> None:
        if key == pygame.K_TAB:
            active = np.flatnonzero(self.simulator.active[0])
            later = active[active > self.selected]
            self.selected = int(later[0] if len(later) else active[0])
        elif key == pygame.K_d:
            self.driven = None if self.driven == self.selected else self.selected
        elif key == pygame.K_r:
            self._reset()

    def _grab(self, pixel: tuple[int, int]) -> None:
        """Select the robot below the mouse, or else grab an obstacle."""
        active = np.flatnonzero(self.simulator.active[0])
        places = self._renderer.pixels(self.simulator.positions[0, active])
        distances = np.linalg.norm(places - np.array(pixel), axis=-1)
        is_plane = self.simulator.scenario.dim == 2
        if distances.min() <= _REACH:
            self.selected = int(active[distances.argmin()])
            self._dragged = ("robot", self.selected) if is_plane else None
        elif is_plane:
            self._grip = self._renderer.points(np.array(pixel, np.float64))
            obstacle = self._obstacle_at(self._grip)
            self._dragged = None if obstacle is None else ("obstacle", obstacle)

    def _obstacle_at(self, point: NDArray[np.float64]) -> int | None:
        world = world_of(self.simulator.obstacles[0], dim=2)
        x, y = point.tolist()
        distances = [distance_to(world, m, (x, y, 0.0)) for m in range(len(world.kinds))]
        inside = np.flatnonzero(np.array(distances) <= 0.0)
        return int(inside[0]) if len(inside) else None

    def _drag(self, pixel: tuple[int, int]) -> None:
        """Move the dragged object to the mouse, unless a robot would be in an obstacle."""
        if self._dragged is None:
            return
        (kind, index), point = self._dragged, self._renderer.points(np.array(pixel, np.float64))
        state = self.simulator.get_state()
        if kind == "robot":
            state["positions"][0, index] = point
        else:
            _shift(state["obstacles"][0, index], point - self._grip)
        if self._is_possible(state):
            try:
                self.simulator.set_state(state)
            except ValueError:  # for example an obstacle with a given path
                return
            self._observations = self.simulator.observe()
            self._grip = point

    def _is_possible(self, state: dict[str, NDArray[Any]]) -> bool:
        """True if active robots are apart and outside of obstacles."""
        active = self.simulator.active[0]
        places = state["positions"][0, active]
        offsets = np.linalg.norm(places[:, None] - places, axis=-1)
        if (offsets + np.diag(np.full(len(places), np.inf))).min() < _NEAREST:
            return False
        if self.simulator.scenario.obstacle_contact == "ignore":
            return True
        world = world_of(state["obstacles"][0], dim=2)
        return all(clear_of_obstacles((x, y, 0.0), world, 0.0) for x, y in places.tolist())

    def _show(self, keeps_view: bool = True) -> None:
        picture = self._renderer.surface(keeps_view)
        self._canvas.blit(picture, (0, 0))
        place = self._renderer.pixels(self.simulator.positions[0, self.selected])
        ink.ring(self._canvas, place.tolist(), 1.0, _REACH)
        size = picture.get_height()
        side = self._canvas.subsurface(pygame.Rect(size, 0, panel.WIDTH, size))
        state = "driven by keys" if self.driven == self.selected else "driven by the policy"
        observation = self._observations[0, self.selected].astype(np.float64)
        panel.draw(
            side, self.simulator.scenario.observation_layout, observation, self.selected, state
        )
        pygame.draw.circle(side, robot_colour(self.selected), (panel.WIDTH - 20, 18), 7)
        self.window.show(self._canvas)


def _shift(row: NDArray[np.float64], by: NDArray[np.float64]) -> None:
    """Move an obstacle of a table by a vector (2,), m."""
    row[CENTRE : CENTRE + 2] += by
    if row[KIND] == POLYGON:
        vertices = row[DETAILS : DETAILS + 2 * int(row[CORNERS])]
        vertices += np.tile(by, int(row[CORNERS]))
