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
    """Edge k of a polygon: its first vertex, unit direction (ex, ey) and length.

        e = (v_{k+1} − v_k)/‖v_{k+1} − v_k‖

    The outward normal is (ey, −ex), because the vertices go round counter-clockwise.

    Args:
        shape: row (width,) of the obstacle, m.
        first: column of the first vertex.
        corners: number of vertices.
        k: index of the edge.

    Returns:
        Five numbers: x and y of v_k, m, ex and ey, without unit, and the length, m.
    """
    here = first + 2 * k
    there = here + 2 if k + 1 < corners else first
    x, y = shape[here], shape[here + 1]
    dx, dy = shape[there] - x, shape[there + 1] - y
    length = math.sqrt(dx * dx + dy * dy)
    return x, y, dx / length, dy / length, length


@kernel
def polygon_surface(point, shape, first, corners):
    """Signed distance of a point from a convex polygon, and its unit normal there.

        max_k n_kᵀ(p − v_k) inside,   min_q ‖p − q‖ over the edges outside

    The plane falls into the inside, one strip before each edge and one wedge before each vertex. On
    a vertex, where there is no one normal, it is that of an adjacent edge.

    Args:
        point: p, a triple, m.
        shape: row (width,) of the obstacle, m.
        first: column of the first vertex.
        corners: number of vertices.

    Returns:
        The distance, m, negative inside; and the outward normal, a unit triple with z = 0.
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
    """Normals n_k of the edges that a point on the surface has behind it: n_kᵀ(p − v_k) ≥ 0.

    But for rounding. Two that differ only on a vertex, where either edge may be slid along.

    Args:
        point: p, a triple, m.
        shape: row (width,) of the obstacle, m.
        first: column of the first vertex.
        corners: number of vertices.
        normal: a unit triple, to return where no edge qualifies.

    Returns:
        The last two of the normals, unit triples.
    """
    one, other = normal, normal
    for k in range(corners):
        x, y, ex, ey, _ = polygon_edge(shape, first, corners, k)
        if (point[0] - x) * ey - (point[1] - y) * ex > -_VERTEX_TOLERANCE:
            one, other = other, (ey, -ex, 0.0)
    return one, other


@kernel
def polygon_entry(point, way, shape, first, corners, depth):
    """Where a straight way meets a polygon that it goes deeper than ``depth`` into.

        max_k of the s with n_kᵀ(p + s w − v_k) = max(0, −depth), at the edges that it comes in by,

    if the way, clipped by all edges moved inwards by ``depth``, leaves something.

    Args:
        point: p, where the way begins, a triple, m.
        way: w, a triple, m.
        shape: row (width,) of the obstacle, m.
        first: column of the first vertex.
        corners: number of vertices.
        depth: m; a negative one makes the polygon fatter by so much.

    Returns:
        s, a fraction of the way; inf if there is none.
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
    """Bearings (v − p)/‖v − p‖ of the vertices farthest left and right of a direction inside.

    Args:
        point: p, a triple, m, outside the polygon or on it.
        towards: unit vector to the centroid.
        shape: row (width,) of the obstacle, m.
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
