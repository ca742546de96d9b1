"""Shapes over arrays: distances, entries, normals of all obstacles at once.

Arrays have the environment axis last. Points are tuples of 2 or 3 arrays (*batch); results have the
obstacles first, (M, *batch). The equations are those of ``obstacles.disc`` and
``obstacles.capsule``; those of polygons, whose loops end early, are repeated here.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...obstacles import capsule, polygon
from ...obstacles.capsule import CAPSULES
from ...obstacles.obstacle_set import KINDS
from ...obstacles.polygon import POLYGONS
from ...obstacles.shape import (
    BOUND,
    CONTACT_DEPTH,
    COS_AZIMUTH,
    MIDDLE,
    NEARLY_ZERO,
    OWN,
    SIN_AZIMUTH,
    azimuth_axes,
    centre_direction,
    centre_of_row,
)
from ...physics.crossings import capsule_crossing
from ...physics.vectors import combine, cross, dot
from ..arrays.array_form import Array, array_form, norm_of, replaces, select, square_root
from ..arrays.selection import divided

Point = Any  # a tuple of d arrays (*batch), m


class World(NamedTuple):
    """Obstacles of environments; arrays (…, *batch), or with axes of length 1 if they are equal."""

    present: Array  # (M, *batch), bool
    shapes: Array  # (M, width, *batch), see ``obstacles.shape``
    skins: Array  # (M, *batch), m
    edges: Any = None  # ``PolygonEdges`` of polygons, see ``Shapes.with_edges``


class PolygonEdges(NamedTuple):
    """Edges of polygons in order, (P, K, *batch): see ``polygon._edge``."""

    x: Array
    y: Array
    ex: Array
    ey: Array
    length: Array


class Tolerances(NamedTuple):
    """Lengths within which contact is decided, m, and ratios; see ``obstacles.contact``."""

    depth: float  # from which a path is a contact
    touching: float  # rounding error of the distance of a resting robot, negative
    touched_skin: float  # contact distance of a skin
    vertex: float  # of points on a vertex
    into: float  # share of a velocity that may point into a surface
    parallel: float  # squared sine of the angle below which two planes are parallel


EXACT = Tolerances(CONTACT_DEPTH, -1e-13, 1e-8, 1e-9, 1e-12, 1e-24)
COARSE = Tolerances(1e-4, -1e-5, 1e-5, 1e-5, 1e-6, 1e-10)
"""Those of float32, in which places at 10 m are 1 µm apart."""


class _Rows:
    """Rows (M, width, *batch) as the row of a kernel: entry k is an array (M, *batch)."""

    def __init__(self, rows: Array, edges: PolygonEdges | None) -> None:
        self._rows, self.edges = rows, edges

    def __getitem__(self, k: int) -> Array:
        return self._rows[:, k]


class Shapes:
    """Equations of the obstacles of a scenario: kinds and corners of each slot are fixed.

    Args:
        kinds: kind of each slot, (M,).
        corners: number of corners of each slot, (M,).
        dim: 2 or 3.
        tolerances: of contact.
        has_skins: whether a skin may occur.
    """

    def __init__(
        self, kinds: Any, corners: Any, dim: int, tolerances: Tolerances, has_skins: bool
    ) -> None:
        self.count, self.dim, self.tolerances = len(kinds), dim, tolerances
        self.corners: tuple[int, ...] = tuple(int(one) for one in corners)
        self.has_skins = has_skins
        self._groups = []
        for kind in KINDS:
            (slots,) = np.nonzero(np.asarray(kinds) == kind.kind)
            if len(slots):
                counts = np.asarray(corners, np.int64)[slots]
                self._groups.append((kind, slots, counts))
        order = np.concatenate([slots for _, slots, _ in self._groups])
        self._order = np.argsort(order)

    def _ask(self, world: World, ask: Callable[..., Any]) -> Any:
        """Result of ``ask(kind, rows, corners, slots)`` for every obstacle, in order."""
        parts = [
            ask(kind, _Rows(world.shapes[slots], world.edges), counts, slots)
            for kind, slots, counts in self._groups
        ]
        if len(parts) == 1:
            return parts[0]
        return jax.tree.map(lambda *each: jnp.concatenate(each)[self._order], *parts)

    def with_edges(self, world: World) -> World:
        """A world with the edges of its polygons, which all equations of polygons need."""
        for kind, slots, counts in self._groups:
            if kind.kind == POLYGONS.kind:
                rows = _Rows(world.shapes[slots], None)
                return world._replace(edges=_edges_of(rows, counts))
        return world

    def _triple(self, point: Point) -> Any:
        """A point as kernels take it; z is a constant in 2-D."""
        return (*point, 0.0)[:3]

    def _filled(self, world: World, value: Any, slots: Any, point: Point) -> Any:
        shape = (len(slots), *np.broadcast_shapes(world.present.shape[1:], point[0].shape))
        return jax.tree.map(lambda one: jnp.broadcast_to(one, shape), value)

    def surface(self, world: World, point: Point) -> tuple[Array, Any]:
        """Signed distances (M, *batch), m, inf for absent slots, and unit normals, a tuple."""

        def ask(kind: Any, rows: Any, corners: Any, slots: Any) -> Any:
            found, normal = array_form(kind.surface)(rows, corners, self._triple(point))
            return self._filled(world, (found, tuple(normal)[: self.dim]), slots, point)

        distance, normal = self._ask(world, ask)
        return jnp.where(world.present, distance, jnp.inf), normal

    def distances(self, world: World, point: Point) -> Array:
        """Signed distances, (M, *batch), m; inf for absent slots."""
        return self.surface(world, point)[0]

    def entry(self, world: World, point: Point, way: Point, depth: Any) -> Array:
        """Fraction of a path at which it meets each obstacle or its skin, (M, *batch), or inf."""

        def ask(kind: Any, rows: Any, corners: Any, slots: Any) -> Any:
            skin = world.skins[slots] if self.has_skins else 0.0
            path = self._triple(point), self._triple(way)
            found = array_form(kind.entry)(rows, corners, *path, depth, skin)
            return self._filled(world, found, slots, point)

        return jnp.where(world.present, self._ask(world, ask), jnp.inf)

    def normals(self, world: World, point: Point, normal: Any) -> tuple[Any, Any]:
        """Two unit normals of each obstacle at a touching point, tuples (M, *batch).

        ``normal`` is that of ``surface``.
        """
        if all(kind.kind != POLYGONS.kind for kind, *_ in self._groups):
            return normal, normal

        def ask(kind: Any, rows: Any, corners: Any, slots: Any) -> Any:
            one = tuple(part[slots] for part in normal)
            if kind.kind == POLYGONS.kind:
                found = _polygon_normals(rows, corners, point, one, self.tolerances.vertex)
            else:
                found = one, one
            return self._filled(world, found, slots, point)

        one, other = self._ask(world, ask)
        skin = world.skins > 0.0
        return select(skin, normal, one), select(skin, normal, other)

    def within(self, world: World, point: Point, reach: Any) -> Array:
        """True where the bounding balls with skins are nearer than ``reach``, m, (M, *batch)."""
        square: Any = sum((point[k] - world.shapes[:, MIDDLE + k]) ** 2 for k in range(self.dim))
        bound = world.shapes[:, BOUND] + world.skins + reach
        return world.present & (square <= bound * bound)

    def is_clear(self, world: World, point: Point, margin: Any) -> Array:
        """True where a point is ``margin``, m, from all obstacles and skins, (*batch)."""
        return jnp.all(self.distances(world, point) >= margin + world.skins, axis=0)

    def hides(self, world: World, point: Point, way: Point) -> Array:
        """True where a straight path goes into an obstacle beyond contact, (*batch)."""
        entries = self.entry(world, point, way, self.tolerances.depth)
        return jnp.any(entries <= 1.0, axis=0)

    def silhouettes(self, world: World, point: Point, net_bearing: Any, axes: Any) -> list[Any]:
        """Unit bearings of the edge points of each obstacle, 2 or 8 tuples (M, *batch).

        In 3-D ``net_bearing``, m/s, and the robot's x and y axis define the azimuths.
        """

        def ask(kind: Any, rows: Any, corners: Any, slots: Any) -> Any:
            if self.dim == 2:
                found = list(array_form(kind.edges)(rows, corners, self._triple(point)))
            else:
                towards = array_form(centre_direction)(point, array_form(centre_of_row)(rows))
                e, w = array_form(azimuth_axes)(towards, net_bearing, *axes)
                found = [[None] * 3 for _ in range(8)]
                array_form(kind.cone)(rows, corners, point, (towards, e, w), found)
            return [self._filled(world, tuple(one)[: self.dim], slots, point) for one in found]

        made: list[Any] = self._ask(world, ask)
        return made


@replaces(azimuth_axes)
def _azimuth_axes(towards: Any, net_bearing: Any, axis_x: Any, axis_y: Any) -> Any:
    chosen = None
    for vector in (axis_y, axis_x, net_bearing):
        along = array_form(dot)(vector, towards)
        across = array_form(combine)(1.0, vector, -along, towards)
        length = norm_of(across)
        unit = tuple(divided(part, length) for part in across)
        above = length > NEARLY_ZERO * jnp.maximum(1.0, norm_of(vector))
        chosen = unit if chosen is None else select(above, unit, chosen)
    return chosen, array_form(cross)(towards, chosen)


@replaces(CAPSULES.cone)
def _capsule_cone(rows: Any, corners: Any, point: Any, axes: Any, out: Any) -> None:
    towards, e, w = axes
    half = tuple(rows[capsule.AXIS + k] for k in range(3))
    radius, centre = rows[capsule.THICKNESS], array_form(centre_of_row)(rows)
    offset = tuple(c - p for c, p in zip(centre, point, strict=True))
    cosines, sines = (
        np.reshape(values, (8, *[1] * e[0].ndim)).astype(e[0].dtype)
        for values in (COS_AZIMUTH, SIN_AZIMUTH)
    )
    aside = array_form(combine)(cosines, e, sines, w)  # (8, M, …), of all azimuths

    def ray_at(angle: Any) -> Any:
        return array_form(combine)(jnp.cos(angle), towards, jnp.sin(angle), aside)

    def halve(_: Any, angles: Any) -> Any:
        hits, misses = angles
        angle = 0.5 * (hits + misses)
        is_hit = array_form(capsule._is_hit)(ray_at(angle), offset, half, radius)
        return jnp.where(is_hit, angle, hits), jnp.where(is_hit, misses, angle)

    none = jnp.zeros(jnp.broadcast_shapes(offset[0].shape, aside[0].shape), offset[0].dtype)
    hits, _ = jax.lax.fori_loop(0, capsule._HALVINGS, halve, (none, none + np.pi))
    rays = ray_at(hits)
    for k in range(8):
        out[k][:] = tuple(part[k] for part in rays)


def _edges_of(rows: Any, corners: Any) -> PolygonEdges:
    """Edges of polygons in order; those beyond the corners of a polygon do not exist."""
    most = int(np.max(corners))
    following = np.arange(1, most + 1) % np.asarray(corners)[:, None]
    chosen = np.arange(len(corners))[:, None], following
    x, y = (jnp.stack([rows[OWN + 2 * k + axis] for k in range(most)], axis=1) for axis in (0, 1))
    dx, dy = x[chosen] - x, y[chosen] - y
    length = square_root(dx * dx + dy * dy)
    return PolygonEdges(x, y, divided(dx, length), divided(dy, length), length)


def _exist(edges: PolygonEdges, corners: Any) -> Any:
    """Whether edges exist, (P, K, 1, …)."""
    counts, most = np.asarray(corners)[:, None], edges.x.shape[1]
    return (np.arange(most) < counts).reshape(len(counts), most, *[1] * (edges.x.ndim - 2))


def _at(first: Any, values: Any) -> Any:
    """Values (M, K, *batch) of the edge with an index (M, 1, *batch)."""
    shape = (1, -1, *[1] * (np.ndim(first) - 2))
    chosen = jnp.arange(values[0].shape[1]).reshape(shape) == first
    return tuple(jnp.sum(jnp.where(chosen, value, 0.0), axis=1) for value in values)


@replaces(POLYGONS.surface)
def _polygon_surface(rows: Any, corners: Any, point: Any) -> Any:
    (x, y, ex, ey, length), exist = rows.edges, _exist(rows.edges, corners)
    dx, dy = point[0] - x, point[1] - y
    along, height = dx * ex + dy * ey, dx * ey - dy * ex
    beside = exist & (height > 0.0) & (along >= 0.0) & (along <= length)
    is_beside, squared = jnp.any(beside, axis=1), dx * dx + dy * dy
    heights, squares = jnp.where(exist, height, -jnp.inf), jnp.where(exist, squared, jnp.inf)
    highest, nearest = jnp.max(heights, axis=1), jnp.min(squares, axis=1)
    first = jnp.where(
        jnp.any(beside, axis=1, keepdims=True),
        jnp.argmax(beside, axis=1, keepdims=True),
        jnp.argmax(heights, axis=1, keepdims=True),
    )
    level, *normal = _at(first, (height, ey, -ex))
    vertex = _at(jnp.argmin(squares, axis=1, keepdims=True), (dx, dy))
    inside, to_vertex = highest <= 0.0, square_root(nearest)
    has_direction = ~is_beside & ~inside & (to_vertex > NEARLY_ZERO)
    outward = tuple(divided(part, to_vertex) for part in vertex)
    normal = select(has_direction, outward, normal)
    distance = jnp.where(is_beside, level, jnp.where(inside, highest, to_vertex))
    return distance, (*normal, 0.0)


def _polygon_normals(rows: Any, corners: Any, point: Any, normal: Any, tolerance: float) -> Any:
    """``polygon._normals`` of a point with this ``surface`` normal, with a tolerance, m."""
    (x, y, ex, ey, _), exist = rows.edges, _exist(rows.edges, corners)
    ahead = exist & ((point[0] - x) * ey - (point[1] - y) * ex > -tolerance)
    after = jnp.cumsum(ahead[:, ::-1], axis=1)[:, ::-1]  # of the last ones
    found = []
    for count in (2, 1):
        mine = ahead & (after == count)
        edge = tuple(jnp.sum(jnp.where(mine, part, 0.0), axis=1) for part in (ey, -ex))
        found.append(select(jnp.any(mine, axis=1), edge, normal))
    return tuple(found)


@replaces(POLYGONS.entry)
def _polygon_entry(
    rows: Any, corners: Any, point: Any, way: Any, depth: Any, skin: Any = 0.0
) -> Any:
    (x, y, ex, ey, _), exist = rows.edges, _exist(rows.edges, corners)
    fatter = jnp.maximum(0.0, -depth)
    height = (point[0] - x) * ey - (point[1] - y) * ex
    rate = way[0] * ey - way[1] * ex
    into, out = exist & (rate < 0.0), exist & (rate > 0.0)
    at = divided(-(height + depth), rate)
    outer = jnp.where(into, divided(fatter - height, rate), 0.0)
    surface = jnp.maximum(jnp.max(outer, axis=1), 0.0)
    entered = jnp.maximum(jnp.max(jnp.where(into, at, 0.0), axis=1), 0.0)
    left = jnp.minimum(jnp.min(jnp.where(out, at, 1.0), axis=1), 1.0)
    misses = jnp.any(exist & (rate == 0.0) & (height > -depth), axis=1)
    plain = jnp.where((entered < left) & ~misses, surface, jnp.inf)
    if isinstance(skin, float):
        return plain
    far = _nears(rows, corners, point, way, skin - depth)
    near = _nears(rows, corners, point, way, skin + fatter)
    return jnp.where(skin > 0.0, jnp.where(far > 1.0, jnp.inf, near), plain)


@replaces(polygon._nears)
def _nears(rows: Any, corners: Any, point: Any, way: Any, reach: Any) -> Any:
    distance, _ = _polygon_surface(rows, corners, point)
    (x, y, ex, ey, length), exist = rows.edges, _exist(rows.edges, corners)
    half = 0.5 * length * ex, 0.5 * length * ey, jnp.zeros_like(length)
    offset = point[0] - x - half[0], point[1] - y - half[1], point[2] + half[2]
    crossing = array_form(capsule_crossing)(offset, way, half, reach[:, None])
    first = jnp.min(jnp.where(exist, crossing, jnp.inf), axis=1)
    return jnp.where(distance <= reach, 0.0, first)


@replaces(POLYGONS.edges)
def _polygon_edges(rows: Any, corners: Any, point: Any) -> Any:
    towards = array_form(centre_direction)(point, array_form(centre_of_row)(rows))
    left = right = towards[:2]
    counts = np.asarray(corners).reshape(-1, *[1] * (np.ndim(rows[OWN]) - 1))
    for k in range(int(np.max(corners))):
        x, y = rows[OWN + 2 * k] - point[0], rows[OWN + 2 * k + 1] - point[1]
        there = (k < counts) & (x * x + y * y >= NEARLY_ZERO * NEARLY_ZERO)
        is_left = towards[0] * y - towards[1] * x > 0.0
        further_left = there & is_left & (left[0] * y - left[1] * x > 0.0)
        further_right = there & ~is_left & (right[0] * y - right[1] * x < 0.0)
        left = select(further_left, (x, y), left)
        right = select(further_right, (x, y), right)
    return tuple((*(divided(part, norm_of(side)) for part in side), 0.0) for side in (left, right))
