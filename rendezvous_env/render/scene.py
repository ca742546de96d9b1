"""What a picture of a team consists of, whoever draws it: pygame, matplotlib or the report's page.

Shapes of obstacles, ways, marks and extents, all in metres; their colours are in ``palette``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..obstacles.obstacle_set import balls, outlines
from ..obstacles.shape import Outline

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def shapes(obstacles: Floats, dim: int) -> list[Outline]:
    """Discs and outlines of the plane; in 3-D balls, which have no vertices.

    Args:
        obstacles: (M, width), a table of ``obstacles.obstacle_set``.
        dim: d, 2 or 3.
    """
    if dim == 2:
        return list(outlines(obstacles))
    return [Outline(ball.centre, ball.radius, np.zeros((0, 3))) for ball in balls(obstacles)]


def outermost(positions: Floats, obstacles: Floats) -> Floats:
    """Points (m, d) that a picture has to hold: places (..., d) and the ends of all shapes."""
    d = positions.shape[-1]
    arms = np.concatenate([np.eye(d), -np.eye(d)])
    ends = [
        vertices if len(vertices) else centre + radius * arms
        for centre, radius, vertices in shapes(obstacles, d)
    ]
    return np.concatenate([positions.reshape(-1, d), *ends])


def facing(headings: Floats, dim: int) -> Floats:
    """Unit vectors (..., d) along bodies with headings (..., k), rad: yaw, or yaw and pitch."""
    yaw, pitch = headings[..., 0], headings[..., 1:].sum(axis=-1)
    flat = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch)], axis=-1)
    return flat if dim == 2 else np.concatenate([flat, np.sin(pitch)[..., None]], axis=-1)


def ways(positions: Floats, active: Bools) -> list[Floats]:
    """Where each robot goes, (T', d), up to where it merges; of positions (T, n, d)."""
    last = active.sum(axis=0) + 1  # one frame more: where it merged
    return [positions[: last[robot], robot] for robot in range(positions.shape[1])]


def ended(flags: Bools) -> NDArray[np.int64]:
    """Frame and robot, (m, 2), where something of (T, n) is no more: of ``active``, the merges."""
    return np.argwhere(flags[:-1] & ~flags[1:]) + np.array([1, 0])


def in_contact(count: int) -> str:
    """How contacts are told: they are counted once for each robot and step."""
    return f"{count} robot-step{'' if count == 1 else 's'} in contact"
