"""All obstacles of a team: where a shape enters the step, a table and a picture.

Kernels take kinds, numbers of corners, and rows that begin with the bounding ball. What they ask
of obstacle m is chosen by its kind; code compiled for a set of balls contains no other shapes.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import shown
from ..compilation import by_type, kernel
from ..physics.vectors import X_AXIS, load, store
from . import shape
from .capsule import CAPSULES, Capsule
from .disc import BALLS, Disc, Sphere
from .polygon import POLYGONS, Polygon
from .shape import ABSENT, AHEAD, BOUND, KIND, MIDDLE, azimuth_axes, centre_direction, centre_of_row

Obstacle = Disc | Sphere | Polygon | Capsule
KINDS = (BALLS, POLYGONS, CAPSULES)
"""Every kind of shape."""
_KINDS = {kind.kind: kind for kind in KINDS}


class RoundObstacles(NamedTuple):
    """Obstacles of one team, all of them discs or spheres."""

    kinds: NDArray[np.int64]  # (M,), ABSENT or BALL
    corners: NDArray[np.int64]  # (M,), zeros
    shapes: NDArray[np.float64]  # (M, width)


class AnyObstacles(NamedTuple):
    """Obstacles of one team, of any kind."""

    kinds: NDArray[np.int64]  # (M,), ABSENT or one of the ``KINDS``
    corners: NDArray[np.int64]  # (M,), vertices of a polygon; 0 for other kinds
    shapes: NDArray[np.float64]  # (M, width)


ObstacleSet = RoundObstacles | AnyObstacles


def _asked(question: str) -> Any:
    """By the type of the set: what its balls answer, or one kind after another."""
    ask: Callable[..., Any] = getattr(BALLS, question)

    @kernel
    def of_balls(world, m, *arguments):
        return ask(world.shapes[m], world.corners[m], *arguments)

    of_any = of_balls
    for kind in KINDS[1:]:
        if (answer := getattr(kind, question)) is not None:
            of_any = _or_else(kind.kind, answer, of_any)
    return by_type("world", lambda made: of_balls if made is RoundObstacles else of_any)


def _or_else(kind: int, ask: Callable[..., Any], otherwise: Callable[..., Any]) -> Any:
    @kernel
    def chosen(world, m, *arguments):
        if world.kinds[m] == kind:
            return ask(world.shapes[m], world.corners[m], *arguments)
        return otherwise(world, m, *arguments)

    return chosen


@_asked("surface")
def _surface(world, m, point):
    """Of an obstacle that is there, see ``surface``."""


@_asked("entry")
def entry(world, m, point, way, depth):
    """Fraction of a straight way at which it meets obstacle m, see ``ShapeKind.entry``."""


@_asked("normals")
def normals(world, m, point):
    """Two unit normals of an obstacle touched by a point, which differ on vertices only."""


@_asked("edges")
def _edges(world, m, point):
    """Bearings of both edges, seen in the plane."""


@_asked("cone")
def _cone(world, m, point, axes, out):
    """Boundary rays into ``out``, seen in 3-D."""


@kernel
def surface(world, m, point):
    """Signed distance to obstacle m, m, inf for an absent slot, and the unit normal there."""
    if world.kinds[m] == ABSENT:
        return np.inf, X_AXIS
    return _surface(world, m, point)


@kernel
def distance_to(world, m, point):
    """Signed distance to obstacle m, m, as ``surface`` has it."""
    distance, _ = surface(world, m, point)
    return distance


@kernel
def distances_to(world, points, out):
    """Signed distances, m, of points (n, d), m, to each obstacle into ``out`` (n, M), as
    ``distance_to``.
    """
    for i in range(out.shape[0]):
        point = load(points[i])
        for m in range(out.shape[1]):
            out[i, m] = distance_to(world, m, point)


@kernel
def clear_of_obstacles(point, world, margin):
    """Whether a point (a triple, m) has distances ≥ ``margin`` (m, signed) to a whole set."""
    for m in range(world.kinds.shape[0]):
        if within(world, m, point, max(margin, 0.0)) and distance_to(world, m, point) < margin:
            return False
    return True


@kernel
def clear(world):
    """Let all slots be absent."""
    world.kinds[:] = ABSENT
    world.corners[:] = 0
    world.shapes[:] = 0.0


@kernel
def within(world, m, point, reach):
    """Whether the bounding ball (c, R) of obstacle m is near: ‖p − c‖ ≤ R + reach, m."""
    if world.kinds[m] == ABSENT:
        return False
    square, bound = 0.0, world.shapes[m, BOUND] + reach
    for k in range(3):
        difference = point[k] - world.shapes[m, MIDDLE + k]
        square += difference * difference
    return square <= bound * bound


@kernel
def silhouette_2d(world, m, point, out):
    """Unit bearings of both edges of obstacle m, the counter-clockwise first, seen from a point
    outside it, into (2, d) ``out``; on the surface, the two directions along it.
    """
    left, right = _edges(world, m, point)
    store(left, out[0])
    store(right, out[1])


@kernel
def silhouette_3d(world, m, point, net_bearing, axis_x, axis_y, out):
    """Boundary rays of the cone of obstacle m, seen from a point outside it, at the azimuths
    k · 45° of ``azimuth_axes``, into (8, 3) ``out``; in the global frame.
    """
    towards = centre_direction(point, centre_of_row(world.shapes[m]))
    e, w = azimuth_axes(towards, net_bearing, axis_x, axis_y)
    _cone(world, m, point, (towards, e, w), out)


def pack(
    obstacles: Sequence[Obstacle], slots: int, width: int | None = None
) -> NDArray[np.float64]:
    """Obstacles as a table (slots, width), by default as narrow as possible; the rows left over are
    absent. More obstacles, or larger ones, than there is room for are refused.
    """
    rows = [obstacle.packed() for obstacle in obstacles]
    needed = row_width(obstacles)
    if len(rows) > slots:
        there = f"the scenario has room for {slots}; set its obstacle_slots"
        raise ValueError(f"obstacles: {len(rows)} given, but {there}")
    if width is not None and needed > width:
        large = next(k for k, row in enumerate(rows) if len(row) > width)
        raise ValueError(
            f"obstacles[{large}] is {shown(obstacles[large])}, which needs a longer row than the "
            "scenario's own obstacles; it must be of their kinds, a polygon of no more corners"
        )
    table = np.full((slots, width or needed), float(ABSENT))
    for row, packed in zip(table, rows, strict=False):
        row[: len(packed)] = packed
    return table


def row_width(obstacles: Sequence[Obstacle]) -> int:
    """Columns of a table: as few as the largest obstacle needs."""
    return max((len(obstacle.packed()) for obstacle in obstacles), default=shape.DETAILS)


def faults(
    table: NDArray[np.float64], dim: int, only_balls: bool = False
) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """What could be wrong with tables (..., M, width): where, and what a row must be."""
    kind, corners, width = table[..., KIND], table[..., shape.CORNERS], table.shape[-1]
    possible = [BALLS] if only_balls else KINDS
    known = [ABSENT] + [
        one.kind
        for one in possible
        if (one.edges if dim == 2 else one.cone) and one.numbers <= width - shape.DETAILS
    ]
    yield ~np.isin(kind, known), f"a row that begins with one of {known}"
    most = (width - shape.DETAILS) // 2
    counted = (corners >= 3) & (corners <= most) & (corners == np.floor(corners))
    cornered = np.isin(kind, [one.kind for one in KINDS if one.least_corners])
    what = f"a row with 3 to {most} corners if it is a polygon, else 0"
    yield np.where(cornered, ~counted, corners != 0), what
    yield np.asarray(~np.isfinite(table).all(axis=-1)), "finite"
    thin = np.logical_and(kind != ABSENT, table[..., shape.RADIUS] < shape.LEAST_THICKNESS)
    yield thin, f"of radius {shape.LEAST_THICKNESS:g} m or more"


def world_of(table: NDArray[np.float64], only_balls: bool = False) -> ObstacleSet:
    """Tables (..., M, width) as a set; kinds and corners whole numbers, everything contiguous."""
    kinds = np.ascontiguousarray(table[..., KIND].astype(np.int64))
    corners = np.ascontiguousarray(table[..., shape.CORNERS].astype(np.int64))
    shapes = np.ascontiguousarray(table[..., AHEAD:])
    return (RoundObstacles if only_balls else AnyObstacles)(kinds, corners, shapes)


def table_of(world: Any) -> NDArray[np.float64]:
    """A set as tables (..., M, width)."""
    ahead = (np.asarray(world.kinds)[..., None], np.asarray(world.corners)[..., None])
    return np.concatenate([*ahead, world.shapes], axis=-1)


def check_outside(field: str, positions: NDArray[np.float64], value: Sequence[Obstacle]) -> None:
    """Refuse positions, (n, d), m, inside obstacles, naming the first robot and its obstacle."""
    world = world_of(pack(value, len(value)))
    for i, position in enumerate(positions):
        point = (*position.tolist(), 0.0)[:3]
        for m, obstacle in enumerate(value):
            if (distance := distance_to(world, m, point)) < 0:
                depth = f"{-distance:.6g} m inside {shown(obstacle)}; it must be outside"
                raise ValueError(f"{field}: robot_{i} at {position.tolist()} is {depth}")


def outlines(table: NDArray[np.float64], dim: int) -> list[shape.Outline]:
    """Pictures of all obstacles of a table (M, width): discs and outlines, in 3-D balls."""
    return [
        outline
        for row in table[table[:, KIND] != ABSENT]
        for outline in _KINDS[int(row[KIND])].outlines(row[AHEAD:], int(row[shape.CORNERS]), dim)
    ]
