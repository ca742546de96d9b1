"""What makes the numbers of an obstacle acceptable; every refusal says what would be right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from ..equations.contact import CONTACT_DEPTH

_LEAST_THICKNESS = 10 * CONTACT_DEPTH


def check_point(kind: str, field: str, value: Any, dim: int) -> tuple[float, ...]:
    """A point of d finite numbers, as a tuple."""
    try:
        point = tuple(float(x) for x in value)
    except (TypeError, ValueError):
        point = ()
    if len(point) != dim or not all(math.isfinite(x) for x in point):
        raise ValueError(
            f"obstacles: {field} {value!r} of a {kind} must be {dim} finite numbers, m"
        )
    return point


def check_ends(value: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Both ends of a capsule's segment, points of the plane or of space."""
    pair = tuple(value) if isinstance(value, Sequence | np.ndarray) else ()
    if len(pair) != 2:
        raise ValueError(f"obstacles: ends {value!r} of a Capsule must be two points, m")
    dim = 3 if isinstance(pair[0], Sequence | np.ndarray) and len(pair[0]) == 3 else 2
    first, second = (check_point("Capsule", f"ends[{k}]", end, dim) for k, end in enumerate(pair))
    return first, second


def check_radius(kind: str, value: Any) -> float:
    """A radius that a contact 1 µm deep cannot pass through."""
    if not _is_number(value) or value < _LEAST_THICKNESS:
        raise ValueError(
            f"obstacles: radius {value!r} of a {kind} must be finite and at least "
            f"{_LEAST_THICKNESS:g} m"
        )
    return float(value)


def check_radius_range(value: Any) -> tuple[float, float]:
    """Least and largest radius of a field."""
    pair = tuple(value) if isinstance(value, Sequence) else (value, value)
    if len(pair) != 2 or not all(map(_is_number, pair)) or pair[0] > pair[1]:
        raise ValueError(
            f"obstacles: radius {value!r} of an ObstacleField must be a pair (low, high), m, "
            "with low <= high"
        )
    return check_radius("ObstacleField", pair[0]), float(pair[1])


def check_count(value: Any) -> tuple[int, int]:
    """Least and largest number of obstacles of a field."""
    pair = tuple(value) if isinstance(value, Sequence) else (value, value)
    whole = all(isinstance(n, int) and not isinstance(n, bool) for n in pair)
    if len(pair) != 2 or not whole or not 0 <= pair[0] <= pair[1]:
        raise ValueError(
            f"obstacles: count {value!r} of an ObstacleField must be a whole number, or a pair "
            "(low, high) with 0 <= low <= high"
        )
    return pair[0], pair[1]


def check_length(field: str, value: Any) -> float:
    """A length that may be zero."""
    if not _is_number(value) or value < 0:
        raise ValueError(
            f"obstacles: {field} {value!r} of an ObstacleField must be finite and at least 0 m"
        )
    return float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and math.isfinite(value)


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

    if not isinstance(value, Sequence | np.ndarray) or len(value) < 3:
        raise ValueError(f"obstacles: vertices {value!r} of a Polygon must be at least 3 points")
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
            f"obstacles: vertices {vertices} of a Polygon are degenerate: it must be thicker than "
            f"{2 * _LEAST_THICKNESS:g} m"
        )
    if not polygon.is_valid:
        raise ValueError(
            f"obstacles: vertices {vertices} of a Polygon cross over; list them in order round it"
        )
    if hull.area - polygon.area > 1e-12 * hull.area:
        raise ValueError(
            f"obstacles: vertices {vertices} of a Polygon are not convex; compose it of convex ones"
        )
    return vertices
