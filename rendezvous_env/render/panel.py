"""Panel beside a picture: the observation of one robot, and the keys of a player."""

import numpy as np
import pygame

from ..scenario.observation_layout import ObservationLayout
from . import ink
from .palette import OBSTACLE_EDGE, robot_colour
from .scene import Floats

WIDTH = 260
"""Width of the panel, pixels."""
_TEXT, _LINE, _LEFT = 17, 18, 14  # pixels
_MOST_LINES = 16
_RADIUS = 84  # of the compass, pixels
KEYS = (
    "space pause, s step, r reset, q close",
    "tab or click: select a robot",
    "d: drive it, or let the policy",
    "arrows: drive the selected robot",
    "mouse: drag a robot or an obstacle",
)
"""Help on keys and mouse."""


def draw(
    surface: pygame.Surface,
    layout: ObservationLayout,
    observation: Floats,
    robot: int,
    state: str,
) -> None:
    """Draw the observation (rows, d) of a robot in its own frame: a compass and its rows."""
    surface.fill(ink.WHITE)
    pygame.draw.line(surface, ink.FRAME, (0, 0), (0, surface.get_height()))
    ink.write(surface, f"robot {robot}, {state}", (_LEFT, 10), 22)
    ink.write(surface, "observes in its own frame:", (_LEFT, 34), _TEXT)
    middle = (WIDTH / 2, 54 + _RADIUS)
    pygame.draw.circle(surface, ink.FRAME, middle, _RADIUS, 1)
    ink.write(surface, "x", (middle[0] + _RADIUS + 4, middle[1]), _TEXT, anchor="midleft")
    _draw_arrows(surface, layout, observation, robot, middle)
    top = round(middle[1]) + _RADIUS + 12
    lines = lines_of(layout, observation)
    room = max(1, (surface.get_height() - top - (len(KEYS) + 1) * _LINE) // _LINE)
    most = min(room, _MOST_LINES)
    if len(lines) > most:
        lines = [*lines[: most - 1], f"and {len(lines) - most + 1} more"]
    for k, line in enumerate(lines):
        ink.write(surface, line, (_LEFT, top + k * _LINE), _TEXT)
    foot = surface.get_height() - len(KEYS) * _LINE - 6
    for k, line in enumerate(KEYS):
        ink.write(surface, line, (_LEFT, foot + k * _LINE), _TEXT - 1)


def _draw_arrows(
    surface: pygame.Surface,
    layout: ObservationLayout,
    observation: Floats,
    robot: int,
    middle: tuple[float, float],
) -> None:
    """Bearings to neighbours in the colour of the robot, and to edges of obstacles."""
    rows = observation[: layout.obstacles.stop]
    for row in np.flatnonzero(rows.any(axis=1)).tolist():
        flat = rows[row, :2] / np.linalg.norm(rows[row])
        is_robot = row < layout.neighbours.stop
        length = _RADIUS if is_robot else 0.75 * _RADIUS
        tip = np.array(middle) + length * np.array([flat[0], -flat[1]])
        shade = robot_colour(robot) if is_robot else OBSTACLE_EDGE
        pygame.draw.line(surface, shade, middle, tip.tolist(), 2 if is_robot else 1)
        ink.wedge(surface, shade, tip, np.array([flat[0], -flat[1]]), 8, 4)


def lines_of(layout: ObservationLayout, observation: Floats) -> list[str]:
    """Text of the rows of an observation (rows, d) that are not zero."""
    parts = layout.split(observation)
    lines = [f"row {k}: {_numbers(row)} m/s" for k, row in enumerate(parts.neighbours) if row.any()]
    lines = lines or ["no neighbour"]
    for m in np.flatnonzero(parts.obstacles.any(axis=(1, 2))).tolist():
        edges = parts.obstacles[m]
        shown = f"{_numbers(edges[0])} to {_numbers(edges[1])}" if len(edges) == 2 else "8 rays"
        lines.append(f"obstacle {m}: {shown}")
    for name in ("gravity", "velocity"):
        if (row := getattr(parts, name)) is not None:
            lines.append(f"{name}: {_numbers(row)}")
    return lines


def _numbers(row: Floats) -> str:
    return "(" + ", ".join(f"{number:.2f}" for number in row.tolist()) + ")"
