"""Convex polygons in 2-D: shape, distance, entry, edges, outline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from ..checks import is_sequence, raise_invalid, short_repr
from ..compilation import inner_kernel, kernel
from ..field_checks import names_unknown_fields
from ..limits import MAX_VERTICES
from ..physics.crossings import capsule_crossing
from ..physics.vectors import combine
from . import shape
from .shape import BOUND, LEAST_THICKNESS, MIDDLE, NEARLY_ZERO, OWN, centre_direction, centre_of_row

POLYGON = 2
"""Kind number of polygons. Their row has the vertices x0, y0, x1, y1, … in counterclockwise
order after the bounding ball."""
# relative to the largest coordinate; a dent of this depth is no concave vertex
_ROUNDING = 1e-12
_VERTEX_TOLERANCE = 1e-9  # m; points on a vertex are no deeper behind either edge


@names_unknown_fields("Polygon")
@dataclass(frozen=True)
class Polygon(shape.Shape):
    """Convex obstacle in 2-D; nonconvex obstacles are composed of overlapping ones."""

    vertices: Annotated[tuple[tuple[float, float], ...], _check_vertices]
    """Corners in counterclockwise order, m; the last connects to the first."""
    dim = 2

    @property
    def centroid(self) -> tuple[float, float]:
        """Centroid of the area, m."""
        (x0, y0), doubled = self.vertices[0], _twice_area(self.vertices)
        x = y = 0.0
        for (x1, y1), (x2, y2) in pairwise(self.vertices[1:]):
            triangle = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
            x += triangle * (x1 - x0 + x2 - x0)
            y += triangle * (y1 - y0 + y2 - y0)
        return x0 + x / (3 * doubled), y0 + y / (3 * doubled)

    def packed(self) -> list[float]:
        """Table row; the bounding ball is centred at the centroid."""
        centre, vertices = self.centroid, np.array(self.vertices)
        radius = float(np.linalg.norm(vertices - np.array(centre), axis=1).max())
        return [POLYGON, len(vertices), radius, *centre, 0.0, *vertices.ravel().tolist()]


def _twice_area(vertices: Sequence[tuple[float, ...]]) -> float:
    """Twice the signed area, m²; negative for clockwise vertices."""
    x0, y0 = vertices[0]
    return sum(
        (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        for (x1, y1), (x2, y2) in pairwise(vertices[1:])
    )


def _check_vertices(field: str, value: Any) -> tuple[tuple[float, ...], ...]:
    """Validated vertices of a convex polygon, counterclockwise; errors give the simplest fault."""
    import shapely  # slow to import, and only polygons need it

    if not is_sequence(value) or not 3 <= len(value) <= MAX_VERTICES:
        raise_invalid(field, value, f"at least 3 points, at most {MAX_VERTICES}")
    vertices = tuple(shape.check_point(f"{field}[{k}]", one, 2) for k, one in enumerate(value))
    points = shapely.points(vertices)
    near = shapely.STRtree(points).query(points, predicate="dwithin", distance=LEAST_THICKNESS)
    if len(repeated := near[1][near[0] < near[1]]):
        k = int(repeated.min())
        raise ValueError(f"{field}[{k}] is {vertices[k]}, which repeats another vertex; remove it")
    polygon = shapely.Polygon(vertices)
    hull = polygon.convex_hull
    largest = max(abs(x) for vertex in vertices for x in vertex)
    if hull.buffer(-LEAST_THICKNESS).is_empty:
        fault = f"are degenerate; the polygon must be thicker than {2 * LEAST_THICKNESS:g} m"
    elif not polygon.is_valid:
        fault = "cross; list them in order around the polygon"
    elif shapely.distance(hull.exterior, points).max() > _ROUNDING * largest:
        fault = "are not convex; compose the obstacle of convex polygons"
    else:
        return vertices if _twice_area(vertices) > 0 else (vertices[0], *reversed(vertices[1:]))
    raise ValueError(f"{field}: {short_repr(vertices)} {fault}")


@kernel
def _edge(row, corners, k):
    """Edge k: x and y of its first vertex v_k, m, its unit direction e, and its length, m.

    The outward normal is (e_y, −e_x), because the vertices are counterclockwise.
    """
    here = OWN + 2 * k
    there = here + 2 if k + 1 < corners else OWN
    x, y = row[here], row[here + 1]
    dx, dy = row[there] - x, row[there + 1] - y
    length = math.sqrt(dx * dx + dy * dy)
    return x, y, dx / length, dy / length, length


@kernel
def _surface(row, corners, point):
    """Signed distance, max_k n_kᵀ(p − v_k) inside and min_q ‖p − q‖ outside, and normal.

    Outside, the nearest point lies on an edge or on a vertex. On a vertex the normal is that of an
    adjacent edge.
    """
    highest, normal_x, normal_y = -np.inf, 0.0, 0.0
    nearest, vertex_x, vertex_y = np.inf, 0.0, 0.0
    for k in range(corners):
        x, y, ex, ey, length = _edge(row, corners, k)
        dx, dy = point[0] - x, point[1] - y
        along, height = dx * ex + dy * ey, dx * ey - dy * ex
        if height > 0.0 and 0.0 <= along <= length:
            return height, (ey, -ex, 0.0)
        if height > highest:
            highest, normal_x, normal_y = height, ey, -ex
        squared = dx * dx + dy * dy
        if squared < nearest:
            nearest, vertex_x, vertex_y = squared, dx, dy
    if highest <= 0.0:
        return highest, (normal_x, normal_y, 0.0)
    distance = math.sqrt(nearest)
    if distance > NEARLY_ZERO:
        normal_x, normal_y = vertex_x / distance, vertex_y / distance
    return distance, (normal_x, normal_y, 0.0)


@kernel
def _normals(row, corners, point):
    """Last two normals n_k with n_kᵀ(p − v_k) ≥ 0, up to rounding, for a point on the surface."""
    _, normal = _surface(row, corners, point)
    one, other = normal, normal
    for k in range(corners):
        x, y, ex, ey, _ = _edge(row, corners, k)
        if (point[0] - x) * ey - (point[1] - y) * ex > -_VERTEX_TOLERANCE:
            one, other = other, (ey, -ex, 0.0)
    return one, other


@kernel
def _entry(row, corners, point, way, depth, skin=0.0):
    """Largest s with n_kᵀ(p + s w − v_k) = max(0, −depth) at the edges of entry.

    Only if clipping the path by all edges, moved inwards by ``depth``, leaves something. A skin is
    round at the vertices.
    """
    fatter = max(0.0, -depth)
    if skin > 0.0:
        if _nears(row, corners, point, way, skin - depth) > 1.0:
            return np.inf
        return _nears(row, corners, point, way, skin + fatter)
    surface, entered, left = 0.0, 0.0, 1.0
    for k in range(corners):
        x, y, ex, ey, _ = _edge(row, corners, k)
        height = (point[0] - x) * ey - (point[1] - y) * ex
        rate = way[0] * ey - way[1] * ex
        if rate < 0.0:
            surface = max(surface, (fatter - height) / rate)
            entered = max(entered, -(height + depth) / rate)
        elif rate > 0.0:
            left = min(left, -(height + depth) / rate)
        elif height > -depth:
            return np.inf
    return surface if entered < left else np.inf


@inner_kernel
def _nears(row, corners, point, way, reach):
    """Least s at which a path comes within reach, m, of an edge, unless it starts inside."""
    distance, _ = _surface(row, corners, point)
    if distance <= reach:
        return 0.0
    first = np.inf
    for k in range(corners):
        x, y, ex, ey, length = _edge(row, corners, k)
        half = (0.5 * length * ex, 0.5 * length * ey, 0.0)
        offset = combine(1.0, (point[0] - x, point[1] - y, 0.0), -1.0, half)
        first = min(first, capsule_crossing(offset, way, half, reach))
    return first


@kernel
def _edges(row, corners, point):
    """Bearings (v − p)/‖v − p‖ of the leftmost and rightmost vertices, relative to the centre."""
    towards = centre_direction(point, centre_of_row(row))
    left_x, left_y = towards[0], towards[1]
    right_x, right_y = towards[0], towards[1]
    for k in range(corners):
        x, y = row[OWN + 2 * k] - point[0], row[OWN + 2 * k + 1] - point[1]
        if x * x + y * y < NEARLY_ZERO * NEARLY_ZERO:
            continue  # the robot is on this vertex: its neighbours are the edges
        if towards[0] * y - towards[1] * x > 0.0:
            if left_x * y - left_y * x > 0.0:
                left_x, left_y = x, y
        elif right_x * y - right_y * x < 0.0:
            right_x, right_y = x, y
    left = math.sqrt(left_x * left_x + left_y * left_y)
    right = math.sqrt(right_x * right_x + right_y * right_y)
    return (left_x / left, left_y / left, 0.0), (right_x / right, right_y / right, 0.0)


def _outlines(row: NDArray[np.float64], corners: int, _: int) -> list[shape.Outline]:
    vertices = row[OWN : OWN + 2 * corners].reshape(-1, 2)
    return [shape.Outline(row[MIDDLE : MIDDLE + 2], float(row[BOUND]), vertices)]


POLYGONS = shape.ShapeKind(
    kind=POLYGON,
    surface=_surface,
    entry=_entry,
    edges=_edges,
    normals=_normals,
    least_corners=3,
    outlines=_outlines,
)
