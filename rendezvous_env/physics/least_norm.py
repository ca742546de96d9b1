"""Point q_i of least norm in the convex hull of a robot's bearings (guarantees, lemma 2).

    q_i = argmin ‖q‖,   q ∈ conv{g_ij : j visible}

All bearings satisfy q_i·g_ij ≥ ‖q_i‖². It is zero if neighbours surround the robot.
"""

import math

from ..compilation import inner_kernel
from .vectors import ORIGIN, add, combine, cross, cross_in_plane, dot, load, scaled, split, subtract

_ROUNDING = 4e-16  # Of a scalar product of unit vectors
_SURROUNDED = 1e-14  # Norm of a point that would be zero without rounding
_SURROUNDED_THINLY = 1e-10  # The same inside of a thin tetrahedron, whose weights are less exact
_MOST_ROUNDS = 64
"""Maximum number of iterations; a few suffice for any number of bearings."""


@inner_kernel
def min_norm_of(rows, neighbour_slots):
    """q_i, a triple without unit, ‖q_i‖ ≤ 1, from the first K rows (rows, d) of one robot.

    Lengths of rows are ignored; zero without a visible neighbour.
    """
    if rows.shape[1] == 2:
        right, left = cone_of(rows, neighbour_slots)
        return combine(0.5, right, 0.5, left)
    return _least_in_space(rows, neighbour_slots)


@inner_kernel
def cone_of(rows, neighbour_slots):
    """Clockwise and counter-clockwise end, unit triples, of the smallest sector ≤ π of bearings.

    q bisects it. Both are zero without a visible neighbour, or if neighbours surround the robot.
    Arguments as ``min_norm_of``.
    """
    right, left = ORIGIN, ORIGIN
    nobody = True
    for k in range(neighbour_slots):
        length, g = split(load(rows[k]))
        if length == 0.0:
            continue
        if nobody:
            right, left, nobody = g, g, False
            continue
        from_right, to_left = cross_in_plane(right, g), cross_in_plane(g, left)
        if from_right >= 0.0 and to_left >= 0.0:
            if dot(g, right) + dot(g, left) < 0.0:  # right = left = −g
                return ORIGIN, ORIGIN
        elif from_right >= 0.0:
            left = g
        elif to_left >= 0.0:
            right = g
        else:
            return ORIGIN, ORIGIN
    return right, left


@inner_kernel
def _least_in_space(rows, neighbour_slots):
    """``min_norm_of`` in 3-D by the algorithm of Gilbert, Johnson and Keerthi (1988).

    The nearest point of a triangle of bearings is updated while some bearing has q·g < ‖q‖². If
    rounding prevents an update, q is shortened until no bearing violates this.
    """
    a = min_along(rows, neighbour_slots, ORIGIN)
    b, c, q = a, a, a
    for _ in range(_MOST_ROUNDS):
        square = dot(q, q)
        g = min_along(rows, neighbour_slots, q)
        if dot(q, subtract(q, g)) <= _ROUNDING * math.sqrt(square):
            break
        if _holds_origin(g, a, b, c):
            return ORIGIN
        nearer, kept = _nearest_of_triangle(g, a, b), (a, b)
        for first, second in ((b, c), (c, a)):
            point = _nearest_of_triangle(g, first, second)
            if dot(point, point) < dot(nearer, nearer):
                nearer, kept = point, (first, second)
        if dot(nearer, nearer) >= square:
            q = scaled(q, max(dot(q, g), 0.0) / square)
            break
        q, a, b, c = nearer, g, kept[0], kept[1]
    else:
        g = min_along(rows, neighbour_slots, q)
        q = scaled(q, min(max(dot(q, g), 0.0) / dot(q, q), 1.0))
    return q if dot(q, q) > _SURROUNDED * _SURROUNDED else ORIGIN


@inner_kernel
def min_along(rows, neighbour_slots, direction):
    """Bearing g = argmin g·u for a triple u, a unit triple; zero without a visible neighbour.

    Rows as ``min_norm_of``.
    """
    least, bearing = math.inf, ORIGIN
    for k in range(neighbour_slots):
        length, g = split(load(rows[k]))
        if length > 0.0 and dot(direction, g) < least:
            least, bearing = dot(direction, g), g
    return bearing


@inner_kernel
def _nearest_of_triangle(a, b, c):
    """Nearest point of a triangle, possibly degenerate, to the origin."""
    normal = cross(subtract(b, a), subtract(c, a))
    u = dot(normal, cross(b, subtract(c, b)))
    v = dot(normal, cross(c, subtract(a, c)))
    w = dot(normal, cross(a, subtract(b, a)))
    if min(u, v, w) > 0.0:
        return scaled(add(combine(u, a, v, b), w, c), 1.0 / (u + v + w))
    nearest = _nearest_of_segment(a, b)
    for point in (_nearest_of_segment(b, c), _nearest_of_segment(c, a)):
        if dot(point, point) < dot(nearest, nearest):
            nearest = point
    return nearest


@inner_kernel
def _nearest_of_segment(a, b):
    """Nearest point of a segment to the origin."""
    along = subtract(b, a)
    length = dot(along, along)
    if length == 0.0:
        return a
    return add(a, min(max(-dot(a, along) / length, 0.0), 1.0), along)


@inner_kernel
def _holds_origin(a, b, c, d):
    """True if the origin lies inside a tetrahedron, with a margin for rounding."""
    weights = (
        dot(b, cross(c, d)),
        -dot(a, cross(c, d)),
        dot(a, cross(b, d)),
        -dot(a, cross(b, c)),
    )
    total = weights[0] + weights[1] + weights[2] + weights[3]
    if min(weights) <= 0.0 <= max(weights):
        return False
    point = add(combine(weights[0], a, weights[1], b), weights[2], c)
    point = scaled(add(point, weights[3], d), 1.0 / total)
    return dot(point, point) <= _SURROUNDED_THINLY * _SURROUNDED_THINLY
