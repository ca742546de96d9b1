"""All obstacles of an environment: the interface of shapes to steps, tables and outlines.

Kernels take kinds, numbers of corners, and rows that begin with the bounding ball. The kind of
obstacle m selects its functions. Code compiled for a set of balls contains no other shapes.

Robots move among the *union* of the obstacles. A path is a contact only if it goes more than 1 µm
deep into a shape. Shapes that overlap by less, or not at all, would therefore leave a passage. A
*skin* closes shapes that only just meet, and gaps of less than 1.8 µm: robots stay 2 µm away from
such shapes, and a path is a contact 1 µm before them. The criterion is

    ρ = min_x max_m d_m(x),   −1.1 µm < ρ < 0.9 µm

of two shapes, or three in 3-D, with d_m the signed distances. If ρ is larger, there is a passage.
If it is less, the shapes have a common point deep in each of them. So without a contact no path
passes where the union is closed. The sets that paths avoid overlap as the shapes do (nerve
theorem), and leave free space as connected as the union does (Alexander duality).
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import short_repr
from ..compilation import by_type, inner_kernel, kernel
from ..physics.ellipsoids import along, ball, cut
from ..physics.vectors import X_AXIS, add, combine, norm, store, subtract
from . import shape
from .capsule import CAPSULES, Capsule
from .disc import BALLS, Disc, Sphere
from .moving import Moving
from .polygon import POLYGONS, Polygon
from .shape import (
    ABSENT,
    AHEAD,
    BOUND,
    CONTACT_DEPTH,
    KIND,
    MIDDLE,
    SKIN,
    azimuth_axes,
    centre_direction,
    centre_of_row,
)

Obstacle = Disc | Sphere | Polygon | Capsule | Moving
KINDS = (BALLS, POLYGONS, CAPSULES)
"""All shape kinds."""
_KINDS = {kind.kind: kind for kind in KINDS}
_GAP, _OVERLAP = 0.9 * CONTACT_DEPTH, 1.1 * CONTACT_DEPTH  # m; between these shapes only just meet
_MAX_CUTS = 1000
_MAX_PUSHES = 8


class RoundObstacles(NamedTuple):
    """Obstacles of one environment, all discs or spheres."""

    kinds: NDArray[np.int64]  # (M,), ABSENT or BALL
    corners: NDArray[np.int64]  # (M,), zeros
    shapes: NDArray[np.float64]  # (M, width)
    skins: NDArray[np.float64]  # (M,), m, 0 or SKIN; derived from the shapes


class AnyObstacles(NamedTuple):
    """Obstacles of one environment, of any kind."""

    kinds: NDArray[np.int64]  # (M,), ABSENT or one of the ``KINDS``
    corners: NDArray[np.int64]  # (M,), vertices of a polygon; 0 for other kinds
    shapes: NDArray[np.float64]  # (M, width)
    skins: NDArray[np.float64]  # (M,), m, 0 or SKIN; derived from the shapes


ObstacleSet = RoundObstacles | AnyObstacles


def _asked(question: str) -> Any:
    """Dispatch by type of the set: the function of balls, or of each kind."""
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
    """``surface`` of a present obstacle."""


@_asked("entry")
def _entry(world, m, point, way, depth, skin):
    """Entry; see ``ShapeKind.entry``."""


@_asked("normals")
def _normals(world, m, point):
    """Normals of an obstacle without a skin."""


@_asked("edges")
def _edges(world, m, point):
    """Bearings of both edges, in 2-D."""


@_asked("cone")
def _cone(world, m, point, axes, out):
    """Boundary rays into ``out``, in 3-D."""


@kernel
def surface(world, m, point):
    """Signed distance to obstacle m, m, inf for an absent slot, and the unit normal there."""
    if world.kinds[m] == ABSENT:
        return np.inf, X_AXIS
    return _surface(world, m, point)


@kernel
def distance_to(world, m, point):
    """Signed distance to obstacle m, m, as ``surface``."""
    distance, _ = surface(world, m, point)
    return distance


@kernel(inline="code")
def entry(world, m, point, way, depth):
    """Fraction of a straight path at which it meets obstacle m or its skin.

    See ``ShapeKind.entry``.
    """
    return _entry(world, m, point, way, depth, world.skins[m])


@kernel
def normals(world, m, point):
    """Two unit normals of an obstacle at a touching point; they differ only on vertices."""
    if world.skins[m] > 0.0:
        _, normal = surface(world, m, point)
        return normal, normal
    return _normals(world, m, point)


@kernel
def is_hidden_by_obstacles(world, point, way):
    """True if the straight path from a point, triples, m, goes into an obstacle beyond contact."""
    for m in range(world.kinds.shape[0]):
        if world.kinds[m] != ABSENT and entry(world, m, point, way, CONTACT_DEPTH) <= 1.0:
            return True
    return False


@kernel
def clear_of_obstacles(point, world, margin):
    """True if a point (a triple, m) has distances ≥ ``margin`` (m, signed) to all obstacles.

    Skins are included.
    """
    for m in range(world.kinds.shape[0]):
        if within(world, m, point, max(margin, 0.0)):
            if distance_to(world, m, point) < margin + world.skins[m]:
                return False
    return True


@kernel
def push_out(point, world, margin):
    """Move a point that is slightly inside obstacles or skins onto their surface.

    Returns the point, and whether its distance is at least ``margin``, m.
    """
    for _ in range(_MAX_PUSHES):
        if clear_of_obstacles(point, world, margin):
            return True, point
        for m in range(world.kinds.shape[0]):
            distance, normal = surface(world, m, point)
            if distance < world.skins[m]:
                point = add(point, world.skins[m] - distance, normal)
    return clear_of_obstacles(point, world, margin), point


@kernel
def close_seams(world, dim):
    """Assign skins to shapes that only just meet others, in 2 or 3 dimensions."""
    world.skins[:] = 0.0
    for m in range(world.kinds.shape[0]):
        for k in range(m):
            if not _near(world, k, m):
                continue
            _close(world, (k, k, m), dim)
            for j in range(k if dim == 3 else 0):
                if _near(world, j, k) and _near(world, j, m):
                    _close(world, (j, k, m), dim)


@kernel
def close_disc_seams(world):
    """``close_seams`` for discs in 2-D, where ρ of two discs has a closed form."""
    world.skins[:] = 0.0
    for m in range(world.kinds.shape[0]):
        for k in range(m):
            if world.kinds[k] != ABSENT and world.kinds[m] != ABSENT:
                offset = subtract(centre_of_row(world.shapes[m]), centre_of_row(world.shapes[k]))
                distance, one, other = norm(offset), world.shapes[k, BOUND], world.shapes[m, BOUND]
                # at the point that is best for both discs; −min(R) if one disc contains the other
                highest = max(0.5 * (distance - one - other), -min(one, other))
                if -_OVERLAP < highest < _GAP:
                    world.skins[k] = world.skins[m] = SKIN


@inner_kernel
def _near(world, k, m):
    """True if bounding balls leave at most a gap that is closed."""
    if world.kinds[k] == ABSENT:
        return False
    return within(world, m, centre_of_row(world.shapes[k]), world.shapes[k, BOUND] + 2.0 * _GAP)


@inner_kernel
def _close(world, group, dim):
    open_yet = False
    for m in group:
        open_yet = open_yet or world.skins[m] == 0.0
    if open_yet and _only_just_meet(world, group, dim):
        for m in group:
            world.skins[m] = SKIN


@inner_kernel
def _only_just_meet(world, group, dim):
    """True if −1.1 µm < ρ < 0.9 µm, ρ the least maximum of signed distances to a few shapes.

    True also if ρ cannot be determined.
    """
    point, radius = _among(world, group)
    axes = ball(radius)
    least, best = -np.inf, np.inf
    for _ in range(_MAX_CUTS):
        highest, normal = _highest(world, group, point)
        width = norm(along(axes, normal))
        least, best = max(least, highest - width), min(best, highest)
        if best <= -_OVERLAP or least >= _GAP:
            return False
        if (least > -_OVERLAP and best < _GAP) or not width > 0.0:
            return True
        point, axes = cut(point, axes, normal, (highest - best) / width, dim)
    return True


@inner_kernel
def _highest(world, group, point):
    """Largest signed distance to a few shapes, m, and its gradient."""
    highest, normal = surface(world, group[0], point)
    for m in group[1:]:
        distance, other = surface(world, m, point)
        if distance > highest:
            highest, normal = distance, other
    return highest, normal


@inner_kernel
def _among(world, group):
    """Initial point among a few shapes, and a bound on its distance to the optimum.

    For two balls it is the optimum.
    """
    point, share = centre_of_row(world.shapes[group[0]]), 1.0
    for m in group[1:]:
        offset = subtract(centre_of_row(world.shapes[m]), point)
        distance = norm(offset)
        spare = distance + world.shapes[group[0], BOUND] - world.shapes[m, BOUND]
        share = min(max(0.5 * spare / distance, 0.0), 1.0) if distance > 0.0 else 0.0
        point = combine(1.0, point, share, offset)
    highest, _ = _highest(world, group, point)
    m = group[0]
    radius = norm(subtract(point, centre_of_row(world.shapes[m]))) + world.shapes[m, BOUND]
    return point, radius + max(highest, 0.0)


@kernel
def clear(world):
    """Mark all slots as absent."""
    world.kinds[:] = ABSENT
    world.corners[:] = 0
    world.shapes[:] = 0.0
    world.skins[:] = 0.0


@kernel
def within(world, m, point, reach):
    """True if the bounding ball (c, R) of obstacle m with skin is near: ‖p − c‖ ≤ R + reach, m."""
    if world.kinds[m] == ABSENT:
        return False
    square, bound = 0.0, world.shapes[m, BOUND] + world.skins[m] + reach
    for k in range(3):
        difference = point[k] - world.shapes[m, MIDDLE + k]
        square += difference * difference
    return square <= bound * bound


@kernel
def silhouette_2d(world, m, point, out):
    """Unit bearings of both edges of obstacle m, counterclockwise first, into (2, d) ``out``.

    They are seen from a point outside it; on the surface they are the two tangents.
    """
    left, right = _edges(world, m, point)
    store(left, out[0])
    store(right, out[1])


@kernel
def silhouette_3d(world, m, point, net_bearing, axis_x, axis_y, out):
    """Boundary rays of the cone of obstacle m, seen from a point outside, into (8, 3) ``out``.

    In the global frame, at the azimuths k · 45° of ``azimuth_axes``.
    """
    towards = centre_direction(point, centre_of_row(world.shapes[m]))
    e, w = azimuth_axes(towards, net_bearing, axis_x, axis_y)
    _cone(world, m, point, (towards, e, w), out)


def pack(
    obstacles: Sequence[Obstacle], slots: int, width: int | None = None
) -> NDArray[np.float64]:
    """Obstacles as a table (slots, width), by default as narrow as possible.

    Unused rows are absent. ValueError for too many or too large obstacles.
    """
    rows = [obstacle.packed() for obstacle in obstacles]
    needed = row_width(obstacles)
    if len(rows) > slots:
        there = f"the scenario has {slots} obstacle slots; set obstacle_slots"
        raise ValueError(f"obstacles: {len(rows)} given, but {there}")
    if width is not None and needed > width:
        large = next(k for k, row in enumerate(rows) if len(row) > width)
        raise ValueError(
            f"obstacles[{large}] is {short_repr(obstacles[large])}, which needs a longer row than "
            "the scenario's obstacles; it must be of their kinds, a polygon of no more corners"
        )
    table = np.full((slots, width or needed), float(ABSENT))
    for row, packed in zip(table, rows, strict=False):
        row[: len(packed)] = packed
    return table


def row_width(obstacles: Sequence[Obstacle]) -> int:
    """Number of columns of a table: the minimum for the largest obstacle."""
    return max((len(obstacle.packed()) for obstacle in obstacles), default=shape.DETAILS)


def faults(
    table: NDArray[np.float64], dim: int, only_balls: bool = False
) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Possible faults of tables (..., M, width): their positions, and the requirement of a row."""
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


def world_of(
    table: NDArray[np.float64], only_balls: bool = False, dim: int | None = None
) -> ObstacleSet:
    """Convert tables (..., M, width) to a contiguous set; kinds and corners are integers.

    Args:
        table: see ``pack``.
        only_balls: whether the consumer's code supports only discs and spheres.
        dim: dimension, 2 or 3; None is 3 unless some shape is flat, which is always valid.
    """
    kinds = np.ascontiguousarray(table[..., KIND].astype(np.int64))
    corners = np.ascontiguousarray(table[..., shape.CORNERS].astype(np.int64))
    shapes = np.ascontiguousarray(table[..., AHEAD:])
    skins = _skins_of(kinds, corners, shapes, dim)
    return (RoundObstacles if only_balls else AnyObstacles)(kinds, corners, shapes, skins)


def _skins_of(kinds: Any, corners: Any, shapes: Any, dim: int | None) -> NDArray[np.float64]:
    """``close_seams`` for every table, once for equal consecutive tables."""
    skins = np.zeros(kinds.shape)
    here = RoundObstacles if (kinds <= BALLS.kind).all() else AnyObstacles
    if dim is None:
        flat = [kind.kind for kind in KINDS if kind.cone is None]
        dim = 2 if np.isin(kinds, flat).any() else 3
    before = None
    for which in np.ndindex(kinds.shape[:-1]):
        present = kinds[which] != ABSENT
        if np.count_nonzero(present) < 2:
            continue
        table = kinds[which], corners[which], shapes[which]
        if before is None or not all(map(np.array_equal, table, before[0])):
            world = here(*table, np.zeros(len(present)))
            if dim == 2 and here is RoundObstacles:
                close_disc_seams(world)
            else:
                close_seams(world, dim)
            before = table, world.skins
        skins[which] = before[1]
    return skins


def table_of(world: Any) -> NDArray[np.float64]:
    """Set as tables (..., M, width)."""
    ahead = (np.asarray(world.kinds)[..., None], np.asarray(world.corners)[..., None])
    return np.concatenate([*ahead, world.shapes], axis=-1)


def check_outside(field: str, positions: NDArray[np.float64], value: Sequence[Obstacle]) -> None:
    """Reject positions, (n, d), m, inside obstacles, or without room between two of them.

    The error gives the first robot and its obstacle.
    """
    world = world_of(pack(value, len(value)), dim=positions.shape[1])
    for i, position in enumerate(positions):
        point = (*position.tolist(), 0.0)[:3]
        if not world.skins.any() and clear_of_obstacles(point, world, 0.0):
            continue
        for m, obstacle in enumerate(value):
            if (distance := distance_to(world, m, point)) < 0:
                depth = f"{-distance:.6g} m inside {short_repr(obstacle)}; it must be outside"
                raise ValueError(f"{field}: robot_{i} at {position.tolist()} is {depth}")
        if not push_out(point, world, -CONTACT_DEPTH)[0]:
            raise ValueError(
                f"{field}: robot_{i} at {position.tolist()} is between obstacles without free "
                "space; it must be outside"
            )


def outlines(table: NDArray[np.float64], dim: int) -> list[shape.Outline]:
    """Outlines of all obstacles of a table (M, width): discs and polygons, in 3-D balls."""
    return [
        outline
        for row in table[table[:, KIND] != ABSENT]
        for outline in _KINDS[int(row[KIND])].outlines(row[AHEAD:], int(row[shape.CORNERS]), dim)
    ]
