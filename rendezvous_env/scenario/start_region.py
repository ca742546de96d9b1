"""Region of initial positions: convex polygons, and their triangles for kernels."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import format_limit, is_sequence, raise_invalid
from ..limits import MAX_OBSTACLES
from ..obstacles.polygon import Polygon

Region = tuple[Polygon, ...]


def starts_in(field: str, value: Any) -> Region:
    """Validated region: polygons, lists of their vertices, or their plain data."""
    if isinstance(value, Polygon):
        value = (value,)
    if not is_sequence(value) or not 1 <= len(value) <= MAX_OBSTACLES:
        raise_invalid(field, value, f"1 to {MAX_OBSTACLES} convex polygons, or None")
    return tuple(_polygon(f"{field}[{k}]", one) for k, one in enumerate(value))


def _polygon(field: str, value: Any) -> Polygon:
    if isinstance(value, Polygon):
        return value
    vertices: Any = value.get("vertices") if isinstance(value, Mapping) else value
    if not is_sequence(vertices):
        raise_invalid(field, value, "a convex polygon, or the list of its vertices")
    try:
        return Polygon(vertices)
    except ValueError as error:
        raise ValueError(str(error).replace("obstacles: Polygon.vertices", field)) from error


def check_region(scenario: Any) -> None:
    """Reject a region in 3-D, or one that exceeds the spawn square, on which bounds rely."""
    region = scenario.start_region
    if region is None:
        return
    if scenario.dim != 2:
        raise ValueError("start_region: polygons are 2-D; it must be None where dim is 3")
    extents = zip(*(vertex for one in region for vertex in one.vertices), strict=True)
    edges = [2.0 * max(map(abs, along)) for along in extents]
    if any(edge > limit for edge, limit in zip(edges, scenario.spawn_edges, strict=True)):
        needed = max(edges)
        wanted = f"at least {format_limit(needed)} m, to contain the start_region"
        raise_invalid("spawn_size", scenario.spawn_size, wanted)


def triangles_of(region: Region) -> NDArray[np.float64]:
    """Triangles of a region, (m, 7).

    The first number is the area of a triangle and those before it, as a fraction of all; then its
    vertices x0, y0, x1, y1, x2, y2, m.
    """
    corners = []
    for polygon in region:
        first, *others = polygon.vertices
        corners += [(*first, *a, *b) for a, b in pairwise(others)]
    table = np.array(corners)
    one, other = table[:, 2:4] - table[:, :2], table[:, 4:] - table[:, :2]
    areas = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    shares = np.cumsum(areas) / areas.sum()
    return np.column_stack([shares, table])
