"""Convex polygons of the plane: distance, way in, silhouette.

A polygon is the row ``shape`` of its obstacle and the column of its first vertex; the vertices
x0, y0, x1, y1, … go round counter-clockwise.
"""

import math

import numpy as np

from ..compilation import kernel
from .balls import NEARLY_ZERO

_VERTEX_TOLERANCE = 1e-9  # m; on a vertex are points that are no deeper behind either edge


@kernel
def polygon_edge(shape, first, corners, k):
    """Edge k of a polygon: its first vertex (x, y), unit direction (ex, ey) and length, m.

    The outward normal is (ey, −ex), because the vertices go round counter-clockwise.
    """
    here = first + 2 * k
    there = here + 2 if k + 1 < corners else first
    x, y = shape[here], shape[here + 1]
    dx, dy = shape[there] - x, shape[there + 1] - y
    length = math.sqrt(dx * dx + dy * dy)
    return x, y, dx / length, dy / length, length


@kernel
def polygon_surface(point, shape, first, corners):
    """Signed distance (m) of a point from a convex polygon, and its unit normal there.

    The plane falls into the inside, one strip before each edge and one wedge before each vertex. On
    a vertex, where there is no one normal, it is that of an adjacent edge.
    """
    highest, normal_x, normal_y = -np.inf, 0.0, 0.0
    nearest, vertex_x, vertex_y = np.inf, 0.0, 0.0
    for k in range(corners):
        x, y, ex, ey, length = polygon_edge(shape, first, corners, k)
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
def edges_touched(point, shape, first, corners, normal):
    """The normals of the edges that a point on the surface has behind it, the last two of them.

    Two that differ only on a vertex, where either edge may be slid along; ``normal`` where no edge
    qualifies.
    """
    one, other = normal, normal
    for k in range(corners):
        x, y, ex, ey, _ = polygon_edge(shape, first, corners, k)
        if (point[0] - x) * ey - (point[1] - y) * ex > -_VERTEX_TOLERANCE:
            one, other = other, (ey, -ex, 0.0)
    return one, other


@kernel
def polygon_entry(point, way, shape, first, corners, depth):
    """Fraction of a straight way at which it meets a polygon that it goes deeper than ``depth`` (m)
    into: the way is clipped by the edges, moved inwards by so much; inf if it does not.
    """
    fatter = max(0.0, -depth)
    surface, entered, left = 0.0, 0.0, 1.0
    for k in range(corners):
        x, y, ex, ey, _ = polygon_edge(shape, first, corners, k)
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


@kernel
def polygon_silhouette(point, towards, shape, first, corners):
    """Bearings of the vertices farthest to the left and to the right of a direction inside.

    Args:
        point: a triple, m, outside the polygon or on it.
        towards: unit vector to the centroid.
        shape: row of the obstacle.
        first: column of the first vertex.
        corners: number of vertices.

    Returns:
        The counter-clockwise edge and the clockwise one, unit triples.
    """
    left_x, left_y = towards[0], towards[1]
    right_x, right_y = towards[0], towards[1]
    for k in range(corners):
        x, y = shape[first + 2 * k] - point[0], shape[first + 2 * k + 1] - point[1]
        if x * x + y * y < NEARLY_ZERO * NEARLY_ZERO:
            continue  # the robot stands on this vertex: its neighbours are the silhouette
        if towards[0] * y - towards[1] * x > 0.0:
            if left_x * y - left_y * x > 0.0:
                left_x, left_y = x, y
        elif right_x * y - right_y * x < 0.0:
            right_x, right_y = x, y
    left = math.sqrt(left_x * left_x + left_y * left_y)
    right = math.sqrt(right_x * right_x + right_y * right_y)
    return (left_x / left, left_y / left, 0.0), (right_x / right, right_y / right, 0.0)
