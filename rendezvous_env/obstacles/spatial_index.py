"""Spatial index of many obstacles in 2-D: bounding boxes in groups of neighbouring shapes.

The groups have about √M shapes each, and a bounding box. A query visits the groups, and the shapes
of those that are near. It omits only shapes that are too far away to matter, so results are bitwise
equal with and without an index.

Environments with the obstacles of the scenario share one table of obstacles and one index, which
then stay in the cache.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import by_type, inner_kernel, kernel
from .capsule import Capsule
from .disc import Disc
from .obstacle_set import ObstacleSet
from .polygon import POLYGON, Polygon
from .shape import ABSENT, BOUND, MIDDLE, OWN

INDEX_FROM = 64
"""Number of obstacles from which an index is faster than a visit of all."""
SHAPES = Disc, Polygon, Capsule
"""Shapes that an index supports; they do not move."""
_MARGIN = 1e-6  # m, plus rounding; boxes exceed their shapes by this, more than a skin
_ROUNDING = 1e-12  # of the largest coordinate


class SpatialIndex(NamedTuple):
    """Index of T tables of obstacles; G groups of S places."""

    source: NDArray[np.int64]  # (B,), table of each environment
    order: NDArray[np.int64]  # (T, G, S), obstacle of each place, −1 for none
    boxes: NDArray[np.float64]  # (T, G, S, 4), least x and y, largest x and y of each place, m
    groups: NDArray[np.float64]  # (T, G, 4), of all places of a group


def shape_of(slots: int) -> tuple[int, int]:
    """Numbers of groups and of places in each, for a number of obstacle slots."""
    places = math.isqrt(max(slots - 1, 0)) + 1
    return -(-slots // places), places


def empty(tables: int, slots: int) -> SpatialIndex:
    """Index of tables without obstacles, one for each environment."""
    groups, places = shape_of(slots)
    boxes, around = np.empty((tables, groups, places, 4)), np.empty((tables, groups, 4))
    boxes[..., :2], boxes[..., 2:] = np.inf, -np.inf
    around[..., :2], around[..., 2:] = np.inf, -np.inf
    order = np.full((tables, groups, places), -1)
    return SpatialIndex(np.arange(tables), order, boxes, around)


def index_of(world: ObstacleSet) -> SpatialIndex:
    """Index of tables of obstacles, one for each environment."""
    count, slots = world.kinds.shape
    index = empty(count, slots)
    for b in range(count):
        boxes = _boxes_of(world.kinds[b], world.corners[b], world.shapes[b])
        order = _neighbouring(boxes, index.order.shape[1:])
        index.order[b].reshape(-1)[:slots] = order
        index.boxes[b].reshape(-1, 4)[:slots] = boxes[order]
        index.groups[b, :, :2] = index.boxes[b, :, :, :2].min(axis=1)
        index.groups[b, :, 2:] = index.boxes[b, :, :, 2:].max(axis=1)
    return index


def _boxes_of(kinds: Any, corners: Any, shapes: Any) -> NDArray[np.float64]:
    """Bounding boxes (M, 4), m; empty for absent shapes."""
    centres, radii = shapes[:, MIDDLE : MIDDLE + 2], shapes[:, BOUND : BOUND + 1]
    low, high = centres - radii, centres + radii
    for m in np.flatnonzero(kinds == POLYGON):
        vertices = shapes[m, OWN : OWN + 2 * corners[m]].reshape(-1, 2)
        low[m], high[m] = vertices.min(axis=0), vertices.max(axis=0)
    margin = 4.0 * _MARGIN + _ROUNDING * max(abs(low).max(), abs(high).max())
    low, high = low - margin, high + margin
    low[kinds == ABSENT], high[kinds == ABSENT] = np.inf, -np.inf
    return np.concatenate([low, high], axis=1)


def _neighbouring(boxes: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Order in which neighbours are near each other: sorted by x, and in strips by y."""
    groups, places = shape
    present = np.isfinite(boxes).all(axis=1)
    middles = np.full((len(boxes), 2), np.inf)
    middles[present] = boxes[present, :2] + boxes[present, 2:]
    strip = places * (math.isqrt(max(groups - 1, 0)) + 1)
    by_x = np.argsort(middles[:, 0], kind="stable")
    strips = [by_x[k : k + strip] for k in range(0, len(by_x), strip)]
    return np.concatenate([one[np.argsort(middles[one, 1], kind="stable")] for one in strips])


@inner_kernel(inline="code")
def square_distance(box, point):
    """Square distance from a point to a box, m²; 0 inside, infinite for an empty box."""
    dx = max(box[0] - point[0], point[0] - box[2], 0.0)
    dy = max(box[1] - point[1], point[1] - box[3], 0.0)
    return dx * dx + dy * dy


@inner_kernel
def gather(world, index, table, point, reach, near, listed):
    """Copy the obstacles of a table within reach of a point, m, to ``near`` in their order.

    Returns their number. ``listed``, (M,), is working memory.
    """
    order, boxes, groups = index.order[table], index.boxes[table], index.groups[table]
    limit, count = reach * reach, 0
    for g in range(groups.shape[0]):
        if not square_distance(groups[g], point) <= limit:
            continue
        for k in range(order.shape[1]):
            m = order[g, k]
            if m >= 0 and square_distance(boxes[g, k], point) <= limit:
                place = count
                while place > 0 and listed[place - 1] > m:
                    listed[place] = listed[place - 1]
                    place -= 1
                listed[place] = m
                count += 1
    for k in range(count):
        m = listed[k]
        near.kinds[k], near.corners[k] = world.kinds[m], world.corners[m]
        near.skins[k] = world.skins[m]
        for number in range(world.shapes.shape[1]):
            near.shapes[k, number] = world.shapes[m, number]
    return count


def _beginning(kind: type) -> Any:
    names = "kinds", "corners", "shapes", "skins"
    parts = ", ".join(f"near.{name}[:count]" for name in names)
    return eval(f"lambda near, count: kind({parts})", {"kind": kind, "__name__": __name__})


@by_type("near", _beginning)
def _first_of(near, count):
    """First obstacles of a set."""


def _within_reach(kind: type) -> Any:
    if kind is type(None):
        return lambda world, index, table, point, reach, near, listed: world

    def found(world, index, table, point, reach, near, listed):
        return _first_of(near, gather(world, index, table, point, reach, near, listed))

    return found


@by_type("near", _within_reach)
def obstacles_within(world, index, table, point, reach, near, listed):
    """Obstacles of a table within reach of a point, m; all without an index.

    ``near``, a set of M obstacles, is working memory; None without an index. Arguments as
    ``gather``.
    """


def _table_of(kind: type) -> Any:
    if kind is type(None):
        return lambda index, b: b
    return lambda index, b: index.source[b]


@by_type("index", _table_of)
def table_of(index, b):
    """Table with the obstacles of environment b; its own without an index."""


@kernel
def nearest_group(index, table, point):
    """Group with the nearest bounding box."""
    groups = index.groups[table]
    nearest, found = np.inf, 0
    for g in range(groups.shape[0]):
        square = square_distance(groups[g], point)
        if square < nearest:
            nearest, found = square, g
    return found
