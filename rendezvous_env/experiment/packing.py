"""Obstacles as tables of numbers, and as the worlds that the equations take.

A row of a table, which files and pictures read, is

    [kind, number of corners, radius of the bounding ball, centre x, y, z, …]

followed by the vertices x0, y0, x1, y1, … of a polygon, or by the half axis x, y, z and the radius
of a capsule. A world keeps kinds and corners as whole numbers beside the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..equations import obstacles as equations
from ..equations.obstacles import ABSENT, BALL, CAPSULE, POLYGON, Balls, Shapes, World
from .checks import shown
from .obstacles import Capsule, Disc, Field, Obstacle, Obstacles, Polygon, Sphere
from .walls import WallField

KIND, CORNERS = 0, 1
_SHAPE = 2
"""Columns of a row before those of a world's shapes."""
RADIUS, CENTRE, DETAILS = (
    _SHAPE + column for column in (equations.RADIUS, equations.CENTRE, equations.DETAILS)
)
_BOX = 8
"""Numbers of the four vertices of a drawn wall."""
AXIS, THICKNESS = _SHAPE + equations.AXIS, _SHAPE + equations.THICKNESS


def row_width(value: Obstacles) -> int:
    """Columns of the table of a scenario's obstacles: as few as the largest of them needs."""
    if isinstance(value, WallField):
        return DETAILS + _BOX
    return DETAILS + max((len(_details(obstacle)) for obstacle in _listed(value)), default=0)


def _listed(value: Obstacles) -> Sequence[Obstacle]:
    return () if isinstance(value, Field) else value


def pack(
    obstacles: Sequence[Obstacle], slots: int, width: int | None = None
) -> NDArray[np.float64]:
    """Obstacles as a table.

    Args:
        obstacles: at most ``slots``.
        slots: M, rows of the table; those left over are absent.
        width: of a row; as narrow as possible if not given.

    Returns:
        (M, width) array.

    Raises:
        ValueError: if there are more obstacles, or larger ones, than there is room for.
    """
    obstacles = tuple(obstacles)
    needed = row_width(obstacles)
    width = needed if width is None else width
    if len(obstacles) > slots:
        raise ValueError(f"obstacles: {len(obstacles)} were given, there is room for {slots}")
    if needed > width:
        raise ValueError(
            f"obstacles: one of them needs {needed - DETAILS} numbers for its shape, there is room "
            f"for {width - DETAILS}"
        )
    table = np.zeros((slots, width))
    table[:, KIND] = ABSENT
    for row, obstacle in zip(table, obstacles, strict=False):
        details = _details(obstacle)
        row[KIND], row[CORNERS] = _kind(obstacle), len(getattr(obstacle, "vertices", ()))
        centre, row[RADIUS] = _bounding_ball(obstacle)
        row[CENTRE : CENTRE + len(centre)] = centre
        row[DETAILS : DETAILS + len(details)] = details
    return table


def _kind(obstacle: Obstacle) -> int:
    return {Disc: BALL, Sphere: BALL, Polygon: POLYGON, Capsule: CAPSULE}[type(obstacle)]


def _bounding_ball(obstacle: Obstacle) -> tuple[NDArray[np.float64], float]:
    """Centre (d,) and radius of a ball that holds the obstacle, m."""
    if isinstance(obstacle, Polygon):
        centre = np.array(obstacle.centroid)
        return centre, float(np.linalg.norm(np.array(obstacle.vertices) - centre, axis=1).max())
    if isinstance(obstacle, Capsule):
        first, second = np.array(obstacle.ends)
        return (first + second) / 2, float(np.linalg.norm(second - first)) / 2 + obstacle.radius
    return np.array(obstacle.centre), obstacle.radius


def _details(obstacle: Obstacle) -> list[float]:
    """What follows the bounding ball in a row."""
    if isinstance(obstacle, Polygon):
        return [number for vertex in obstacle.vertices for number in vertex]
    if isinstance(obstacle, Capsule):
        first, second = np.array(obstacle.ends)
        half = [*((second - first) / 2).tolist(), 0.0][:3]
        return [*half, obstacle.radius]
    return []


def world_of(table: NDArray[np.float64], only_balls: bool = False) -> World:
    """Tables (..., M, width) as a world; kinds and corners whole numbers, everything contiguous."""
    kinds = np.ascontiguousarray(table[..., KIND].astype(np.int64))
    corners = np.ascontiguousarray(table[..., CORNERS].astype(np.int64))
    shapes = np.ascontiguousarray(table[..., _SHAPE:])
    return (Balls if only_balls else Shapes)(kinds, corners, shapes)


def table_of(world: Any) -> NDArray[np.float64]:
    """A world as tables (..., M, width)."""
    ahead = (np.asarray(world.kinds)[..., None], np.asarray(world.corners)[..., None])
    return np.concatenate([*ahead, world.shapes], axis=-1)


def only_balls(value: Obstacles) -> bool:
    """Whether a scenario's obstacles are discs or spheres, however they are drawn."""
    if isinstance(value, WallField):
        return False
    return all(isinstance(obstacle, Disc | Sphere) for obstacle in _listed(value))


def check_outside(field: str, positions: NDArray[np.float64], value: Sequence[Obstacle]) -> None:
    """Refuse positions inside obstacles.

    Args:
        field: what the message calls the positions.
        positions: (n, d), m.
        value: obstacles.

    Raises:
        ValueError: naming the first robot and its obstacle, or positions of another shape.
    """
    positions = np.asarray(positions, dtype=np.float64)
    if positions.ndim != 2 or any(obstacle.dim != positions.shape[1] for obstacle in value):
        raise ValueError(
            f"{field} have shape {positions.shape}; beside {list(value)} they must be (n, d)"
        )
    world = world_of(pack(value, len(value)))
    for i, position in enumerate(positions):
        point = (*position.tolist(), 0.0)[:3]
        for m, obstacle in enumerate(value):
            if (distance := equations.distance_to(world, m, point)) < 0:
                raise ValueError(
                    f"{field}: robot_{i} at {position.tolist()} is {-distance:.6g} m inside "
                    f"{shown(obstacle)}; it must be outside"
                )
