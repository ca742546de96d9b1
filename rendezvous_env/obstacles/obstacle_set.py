"""All obstacles of a team together: where a shape enters the step, a table and a picture.

Kernels take a world: kinds, numbers of corners, and rows that begin with the bounding ball. What
they ask of obstacle m is chosen by its kind. Compiled code for a world of balls contains nothing
about other shapes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import shown
from ..compilation import chosen_by_type, kernel
from ..physics.vectors import X_AXIS, store
from . import capsule, disc, polygon, shape
from .capsule import (
    CAPSULE,
    Capsule,
    capsule_entry,
    capsule_ray,
    capsule_silhouette,
    capsule_surface,
)
from .disc import BALL, Disc, Sphere, ball_entry, ball_surface, disc_edges, half_angle, sphere_ray
from .polygon import (
    POLYGON,
    Polygon,
    edges_touched,
    polygon_entry,
    polygon_silhouette,
    polygon_surface,
)
from .shape import ABSENT, KIND, Ball, Outline, azimuth_axes, centre_direction

Obstacle = Disc | Sphere | Polygon | Capsule
SHAPES: dict[str, type[Obstacle]] = {
    "disc": Disc,
    "sphere": Sphere,
    "polygon": Polygon,
    "capsule": Capsule,
}
"""By the kind that files say."""
_OUTLINES = {BALL: disc.outline, POLYGON: polygon.outline, CAPSULE: capsule.outline}
_BEADS = {BALL: disc.beads, CAPSULE: capsule.beads}
_AHEAD = 2
"""Columns of a table before those of a world's rows: kind and corners."""
RADIUS, CENTRE, DETAILS = shape.RADIUS - _AHEAD, shape.CENTRE - _AHEAD, shape.DETAILS - _AHEAD
"""Columns of a world's row."""
AXIS, THICKNESS = capsule.AXIS - _AHEAD, capsule.THICKNESS - _AHEAD
"""Columns of a capsule's row: its half axis, and its own radius."""


class Balls(NamedTuple):
    """Obstacles of one team, all of them discs or spheres."""

    kinds: NDArray[np.int64]
    """(M,), ABSENT or BALL."""
    corners: NDArray[np.int64]
    """(M,), zeros."""
    shapes: NDArray[np.float64]
    """(M, width)."""


class Shapes(NamedTuple):
    """Obstacles of one team, of any kind."""

    kinds: NDArray[np.int64]
    """(M,), ABSENT, BALL, POLYGON or CAPSULE."""
    corners: NDArray[np.int64]
    """(M,), vertices of a polygon; 0 for other kinds."""
    shapes: NDArray[np.float64]
    """(M, width)."""


World = Balls | Shapes


@kernel
def centre_of(world, m):
    """Centre c_m = (x, y, z) of obstacle m (an index) of a world, a triple, m."""
    return world.shapes[m, CENTRE], world.shapes[m, CENTRE + 1], world.shapes[m, CENTRE + 2]


@kernel
def _axis_of(world, m):
    return world.shapes[m, AXIS], world.shapes[m, AXIS + 1], world.shapes[m, AXIS + 2]


@kernel
def _surface_of_ball(world, m, point):
    return ball_surface(point, centre_of(world, m), world.shapes[m, RADIUS])


@kernel
def _surface_of_any(world, m, point):
    if world.kinds[m] == POLYGON:
        return polygon_surface(point, world.shapes[m], DETAILS, world.corners[m])
    if world.kinds[m] == CAPSULE:
        return capsule_surface(
            point, centre_of(world, m), _axis_of(world, m), world.shapes[m, THICKNESS]
        )
    return ball_surface(point, centre_of(world, m), world.shapes[m, RADIUS])


def _surface(world: Any, m: int, point: Any) -> Any:
    """By the type of the world, see ``surface``."""
    return (_surface_of_ball if isinstance(world, Balls) else _surface_of_any)(world, m, point)


@chosen_by_type(_surface)
def _compiled_surface(world, m, point):
    chosen = _surface_of_ball if world.instance_class is Balls else _surface_of_any
    return lambda world, m, point: chosen(world, m, point)


@kernel
def surface(world, m, point):
    """Signed distance from a point to the surface of obstacle m, and the unit normal there.

        ± min_q ‖p − q‖ over its surface, and ∇ of that

    Args:
        world: obstacles of one team.
        m: which one, an index.
        point: p, a triple, m.

    Returns:
        Distance in m, negative inside, inf for an absent slot; and the outward normal at the
        nearest point of the surface, a unit triple.
    """
    if world.kinds[m] == ABSENT:
        return np.inf, X_AXIS
    return _surface(world, m, point)


@kernel
def distance_to(world, m, point):
    """± min_q ‖p − q‖, a number, m: signed distance to obstacle m; arguments as ``surface``."""
    distance, _ = surface(world, m, point)
    return distance


@kernel
def clear_of_obstacles(point, world, margin):
    """Whether a point (a triple, m) has distances ≥ ``margin`` (m, signed) to a whole world."""
    for m in range(world.kinds.shape[0]):
        if distance_to(world, m, point) < margin:
            return False
    return True


@kernel
def within(world, m, point, reach):
    """Whether the bounding ball (c, R) of obstacle m is near: ‖p − c‖ ≤ R + reach.

    Args:
        world: obstacles of one team.
        m: which one, an index.
        point: p, a triple, m.
        reach: m.
    """
    if world.kinds[m] == ABSENT:
        return False
    square, bound = 0.0, world.shapes[m, RADIUS] + reach
    for k in range(3):
        difference = point[k] - world.shapes[m, CENTRE + k]
        square += difference * difference
    return square <= bound * bound


@kernel
def _entry_of_ball(world, m, point, way, depth):
    return ball_entry(point, way, centre_of(world, m), world.shapes[m, RADIUS], depth)


@kernel
def _entry_of_any(world, m, point, way, depth):
    if world.kinds[m] == POLYGON:
        return polygon_entry(point, way, world.shapes[m], DETAILS, world.corners[m], depth)
    centre = centre_of(world, m)
    if world.kinds[m] == CAPSULE:
        axis, thickness = _axis_of(world, m), world.shapes[m, THICKNESS]
        return capsule_entry(point, way, centre, axis, thickness, depth)
    return ball_entry(point, way, centre, world.shapes[m, RADIUS], depth)


def entry(world, m, point, way, depth):
    """Fraction s of a straight way p + s w at which it meets the surface of an obstacle.

    Args:
        world: obstacles of one team.
        m: which one, an index; it is there.
        point: p, where the way begins, a triple, m.
        way: w, a triple, m.
        depth: only a way that goes deeper than this (m) meets it; a negative depth makes the
            obstacle fatter by so much.

    Returns:
        s, a number in [0, 1]; inf if it does not meet it.
    """
    chosen = _entry_of_ball if isinstance(world, Balls) else _entry_of_any
    return chosen(world, m, point, way, depth)


@chosen_by_type(entry)
def _compiled_entry(world, m, point, way, depth):
    chosen = _entry_of_ball if world.instance_class is Balls else _entry_of_any
    return lambda world, m, point, way, depth: chosen(world, m, point, way, depth)


@kernel
def _normals_of_ball(world, m, point):
    _, normal = _surface_of_ball(world, m, point)
    return normal, normal


@kernel
def _normals_of_any(world, m, point):
    _, normal = _surface_of_any(world, m, point)
    if world.kinds[m] == POLYGON:
        return edges_touched(point, world.shapes[m], DETAILS, world.corners[m], normal)
    return normal, normal


def normals(world, m, point):
    """Two unit triples n = ∇ distance of an obstacle touched by a point; arguments as ``surface``.

    They differ on the vertex of a polygon only, where either edge may be slid along.
    """
    chosen = _normals_of_ball if isinstance(world, Balls) else _normals_of_any
    return chosen(world, m, point)


@chosen_by_type(normals)
def _compiled_normals(world, m, point):
    chosen = _normals_of_ball if world.instance_class is Balls else _normals_of_any
    return lambda world, m, point: chosen(world, m, point)


@kernel
def silhouette_2d(world, m, point, out):
    """Bearings of the two edges of an obstacle of the plane, as seen from a point outside it.

    With t the tangent point these are (t − p)/‖t − p‖; on the surface, the two directions along it.

    Args:
        world: obstacles of one team.
        m: which one, an index; it is there.
        point: p, a triple, m.
        out: (2, d) array for unit vectors in the global frame: first the counter-clockwise edge,
            then the clockwise one.
    """
    centre = centre_of(world, m)
    if world.kinds[m] == BALL:
        ax, ay, bx, by, _ = disc_edges(
            centre[0] - point[0], centre[1] - point[1], world.shapes[m, RADIUS]
        )
        left, right = (ax, ay, 0.0), (bx, by, 0.0)
    elif world.kinds[m] == CAPSULE:
        axis, thickness = _axis_of(world, m), world.shapes[m, THICKNESS]
        left, right = capsule_silhouette(point, centre, axis, thickness)
    else:
        towards, _ = centre_direction(point, centre)
        left, right = polygon_silhouette(point, towards, world.shapes[m], DETAILS, world.corners[m])
    store(left, out[0])
    store(right, out[1])


@kernel
def silhouette_3d(world, m, point, net_bearing, axis_x, axis_y, out):
    """Boundary rays of the cone under which an obstacle is seen, at eight azimuths k · 45°.

    Azimuth 0 about the direction u of its centre is the part of the net bearing that is
    perpendicular to u; if that vanishes, of axis_x, and then of axis_y.

    Args:
        world: obstacles of one team.
        m: which one; it is there.
        point: a triple, m, outside the obstacle or on it.
        net_bearing: f, a triple, m/s, in the global frame.
        axis_x: the robot's local x axis in the global frame, a triple.
        axis_y: its y axis.
        out: (8, 3) array for unit vectors in the global frame.
    """
    centre = centre_of(world, m)
    towards, distance = centre_direction(point, centre)
    e, w = azimuth_axes(towards, net_bearing, axis_x, axis_y)
    cosine, sine = half_angle(distance, world.shapes[m, RADIUS])
    axis, thickness = X_AXIS, 0.0
    if world.kinds[m] == CAPSULE:
        axis, thickness = _axis_of(world, m), world.shapes[m, THICKNESS]
    for k in range(8):
        if world.kinds[m] == CAPSULE:
            ray = capsule_ray(point, centre, axis, thickness, towards, e, w, k)
        else:
            ray = sphere_ray(towards, e, w, cosine, sine, k)
        store(ray, out[k])


# ---- tables -------------------------------------------------------------------------------------


def row_width(obstacles: Sequence[Obstacle]) -> int:
    """Columns of the table of obstacles: as few as the largest of them needs."""
    most = max((len(obstacle.packed().details) for obstacle in obstacles), default=0)
    return shape.DETAILS + most


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
    rows = [obstacle.packed() for obstacle in obstacles]
    needed = shape.DETAILS + max((len(row.details) for row in rows), default=0)
    width = needed if width is None else width
    if len(rows) > slots:
        raise ValueError(f"obstacles: {len(rows)} were given, there is room for {slots}")
    if needed > width:
        raise ValueError(
            f"obstacles: one of them needs {needed - shape.DETAILS} numbers for its shape, there "
            f"is room for {width - shape.DETAILS}"
        )
    table = np.zeros((slots, width))
    table[:, KIND] = ABSENT
    for row, packed in zip(table, rows, strict=False):
        row[KIND], row[shape.CORNERS] = packed.kind, packed.corners
        row[shape.RADIUS] = packed.radius
        row[shape.CENTRE : shape.CENTRE + len(packed.centre)] = packed.centre
        row[shape.DETAILS : shape.DETAILS + len(packed.details)] = packed.details
    return table


def faults(
    table: NDArray[np.float64], dim: int, only_balls: bool = False
) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """What could be wrong with tables (..., M, width): where, and what a row must be; counts first,
    since they are indices.
    """
    kind, corners, width = table[..., KIND], table[..., shape.CORNERS], table.shape[-1]
    known = [ABSENT, BALL]
    if not only_balls:
        known += [POLYGON] if dim == 2 else []
        known += [CAPSULE] if width > capsule.THICKNESS else []
    yield ~np.isin(kind, known), f"a row that begins with one of {known}"
    most = (width - shape.DETAILS) // 2
    counted = (corners >= 3) & (corners <= most) & (corners == np.floor(corners))
    what = f"a row with 3 to {most} corners if it is a polygon, else 0"
    yield np.where(kind == POLYGON, ~counted, corners != 0), what
    yield np.asarray(~np.isfinite(table).all(axis=-1)), "finite"
    yield np.logical_and(kind != ABSENT, table[..., shape.RADIUS] < 0), "of radius 0 or more"


def world_of(table: NDArray[np.float64], only_balls: bool = False) -> World:
    """Tables (..., M, width) as a world; kinds and corners whole numbers, everything contiguous."""
    kinds = np.ascontiguousarray(table[..., KIND].astype(np.int64))
    corners = np.ascontiguousarray(table[..., shape.CORNERS].astype(np.int64))
    shapes = np.ascontiguousarray(table[..., _AHEAD:])
    return (Balls if only_balls else Shapes)(kinds, corners, shapes)


def table_of(world: Any) -> NDArray[np.float64]:
    """A world as tables (..., M, width)."""
    ahead = (np.asarray(world.kinds)[..., None], np.asarray(world.corners)[..., None])
    return np.concatenate([*ahead, world.shapes], axis=-1)


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
            if (distance := distance_to(world, m, point)) < 0:
                raise ValueError(
                    f"{field}: robot_{i} at {position.tolist()} is {-distance:.6g} m inside "
                    f"{shown(obstacle)}; it must be outside"
                )


def outlines(table: NDArray[np.float64]) -> Iterator[Outline]:
    """Every obstacle of a table (M, width) of the plane that is there."""
    for row in table[table[:, KIND] != ABSENT]:
        yield _OUTLINES[int(row[KIND])](row)


def balls(table: NDArray[np.float64]) -> Iterator[Ball]:
    """Every obstacle of a table (M, width) of space that is there, as balls."""
    for row in table[table[:, KIND] != ABSENT]:
        yield from _BEADS[int(row[KIND])](row)
