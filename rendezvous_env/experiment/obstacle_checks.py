"""What makes the numbers of an obstacle acceptable; every refusal says what would be right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from ..equations.contact import CONTACT_DEPTH
from .checks import is_whole, real, shown
from .limits import LARGEST, MOST_OBSTACLES, MOST_VERTICES

_LEAST_THICKNESS = 10 * CONTACT_DEPTH
_ROUNDING = 1e-12
"""Of coordinates that were computed, as a share of the largest; so deep is no vertex a dent."""


def check_point(kind: str, field: str, value: Any, dim: int) -> tuple[float, ...]:
    """A point of d finite numbers, as a tuple."""
    point = tuple(value) if _is_sequence(value) else ()
    if len(point) != dim or not all(abs(real(x)) <= LARGEST for x in point):
        raise ValueError(
            f"obstacles: {field} {shown(value)} of a {kind} must be {dim} finite numbers, from "
            f"{-LARGEST:g} to {LARGEST:g} m"
        )
    return tuple(real(x) for x in point)


def check_ends(value: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Both ends of a capsule's segment, points of the plane or of space."""
    pair = tuple(value) if isinstance(value, Sequence | np.ndarray) else ()
    if len(pair) != 2:
        raise ValueError(f"obstacles: ends {value!r} of a Capsule must be two points, m")
    dim = 3 if isinstance(pair[0], Sequence | np.ndarray) and len(pair[0]) == 3 else 2
    first, second = (check_point("Capsule", f"ends[{k}]", end, dim) for k, end in enumerate(pair))
    return first, second


def check_radius(kind: str, value: Any, field: str = "radius") -> float:
    """A radius, or another thickness, that a contact 1 µm deep cannot pass through."""
    if not _LEAST_THICKNESS <= real(value) <= LARGEST:
        raise ValueError(
            f"obstacles: {field} {shown(value)} of a {kind} must be finite and at least "
            f"{_LEAST_THICKNESS:g} m, at most {LARGEST:g} m"
        )
    return float(value)


def check_range(kind: str, field: str, value: Any) -> tuple[float, float]:
    """Least and largest radius, or other length above zero, of a field."""
    pair = tuple(value) if _is_sequence(value) else (value, value)
    if len(pair) != 2 or not real(pair[0]) <= real(pair[1]) <= LARGEST:
        raise ValueError(
            f"obstacles: {field} {shown(value)} of {_article(kind)} must be a pair (low, high), m, "
            f"with low <= high <= {LARGEST:g}"
        )
    return check_radius(kind, pair[0], field), float(pair[1])


def check_count(value: Any) -> tuple[int, int]:
    """Least and largest number of obstacles of a field."""
    pair = tuple(value) if _is_sequence(value) else (value, value)
    whole = len(pair) == 2 and all(map(is_whole, pair))
    if not whole or not 0 <= pair[0] <= pair[1] <= MOST_OBSTACLES:
        raise ValueError(
            f"obstacles: count {shown(value)} of an ObstacleField must be a whole number, or a "
            f"pair (low, high) with 0 <= low <= high <= {MOST_OBSTACLES}"
        )
    return int(pair[0]), int(pair[1])


def check_length(kind: str, field: str, value: Any) -> float:
    """A length that may be zero."""
    if not 0 <= real(value) <= LARGEST:
        raise ValueError(
            f"obstacles: {field} {shown(value)} of {_article(kind)} must be finite and at least "
            f"0 m, at most {LARGEST:g} m"
        )
    return float(value)


def _article(kind: str) -> str:
    return f"an {kind}" if kind[0] in "AEIO" else f"a {kind}"


def _is_sequence(value: Any) -> bool:
    """Whether it is a sequence of anything but letters."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def twice_area(vertices: Sequence[tuple[float, ...]]) -> float:
    """Twice the area, m²; negative if the vertices go round clockwise."""
    x0, y0 = vertices[0]
    return sum(
        (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        for (x1, y1), (x2, y2) in pairwise(vertices[1:])
    )


def check_polygon(value: Any) -> tuple[tuple[float, ...], ...]:
    """The vertices of a convex polygon; of several faults the plainest is named."""
    import shapely  # slow to import, and only polygons need it

    if not _is_sequence(value) or not 3 <= len(value) <= MOST_VERTICES:
        raise ValueError(
            f"obstacles: vertices {shown(value)} of a Polygon must be at least 3 points, at most "
            f"{MOST_VERTICES}"
        )
    vertices = tuple(
        check_point("Polygon", f"vertices[{k}]", vertex, 2) for k, vertex in enumerate(value)
    )
    for k, vertex in enumerate(vertices):
        if any(math.dist(vertex, earlier) < _LEAST_THICKNESS for earlier in vertices[:k]):
            raise ValueError(
                f"obstacles: vertices[{k}] {vertex} of a Polygon repeats another; leave it out"
            )
    polygon = shapely.Polygon(vertices)
    hull = polygon.convex_hull
    if hull.buffer(-_LEAST_THICKNESS).is_empty:
        raise ValueError(
            f"obstacles: vertices {shown(vertices)} of a Polygon are degenerate: it must be "
            f"thicker than {2 * _LEAST_THICKNESS:g} m"
        )
    if not polygon.is_valid:
        raise ValueError(
            f"obstacles: vertices {shown(vertices)} of a Polygon cross over; list them in order "
            "round it"
        )
    largest = max(abs(x) for vertex in vertices for x in vertex)
    dents = shapely.distance(hull.exterior, shapely.points(vertices))
    if dents.max() > _ROUNDING * largest:
        raise ValueError(
            f"obstacles: vertices {shown(vertices)} of a Polygon are not convex; compose it of "
            "convex ones"
        )
    return vertices
