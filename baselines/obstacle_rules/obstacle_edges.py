"""Headings at the edges of obstacles, as kernels over robots.

The angular extent of an obstacle is given by S unit vectors in the robot's own frame. In the plane
they are the counter-clockwise and the clockwise edge, in 3-D eight boundary rays of a cone. An
obstacle whose first vector is exactly zero is not visible. All kernels take net bearings (N, d)
float64 and angular extents (N, M, S, d) of any float type, and write unit headings (N, d). Without
a net bearing, the heading is the robot's x axis. Overlapping extents are merged in
``merged_intervals_2d`` and ``merged_cones_3d``.
"""

import math

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.physics.vectors import X_AXIS, combine, cross, dot, load, split, store

STRAIGHT_AHEAD = -1
"""Obstacle index for an unobstructed f."""
TOUCHED = 1e-4
"""Sum of opposite points below which rounding to float32 would determine their middle."""

NO_SIGNS = 0x7FFFFFFF7FFFFFFF
"""Bit mask of two float32 without their signs, since zeros have either sign."""


@kernel
def tangent_headings(net_bearing, silhouettes, only_blocking, out):
    """Headings towards the edge nearest to f of the most prominent obstacle, or along f.

    With ``only_blocking`` the rule considers obstacles that f points into (section IV-C). Of equal
    obstacles the first one counts.
    """
    for i in range(out.shape[0]):
        heading = direction_of(net_bearing[i])
        prominent = _most_prominent(heading, silhouettes[i], only_blocking)
        if prominent != STRAIGHT_AHEAD:
            heading = _nearest_point(heading, silhouettes[i, prominent])
        store(heading, out[i])


@inner_kernel
def direction_of(net_bearing):
    """Unit vector along a net bearing, as a triple; the x axis for zero."""
    length, direction = split(load(net_bearing))
    return direction if length > 0.0 else X_AXIS


@inner_kernel
def is_seen(points):
    """True if the obstacle with these silhouette points is visible."""
    for k in range(points.shape[1]):
        if points[0, k] != 0.0:
            return True
    return False


@inner_kernel
def list_seen(bits, first, obstacles, listed):
    """List the first rows of visible obstacles of a robot in the plane; returns their number.

    ``bits`` are its rows, pairs of float32 as int64, (rows, 1); row ``first`` is the first of an
    obstacle. It has no branch: which obstacles are visible is hard to predict.
    """
    count = 0
    for m in range(obstacles):
        row = first + 2 * m
        listed[count] = row
        count += (bits[row, 0] & NO_SIGNS) != 0
    return count


@inner_kernel
def unit(point):
    """Silhouette point as a unit triple."""
    return split(load(point))[1]


@inner_kernel
def opposite(points):
    """Two opposite points of the silhouette: both edges in the plane, rays 0 and 4 in 3-D."""
    return unit(points[0]), unit(points[points.shape[0] // 2])


@inner_kernel
def middle_of(points):
    """Unit triple towards the middle of a silhouette: along the sum of two opposite points.

    At contact their sum vanishes. The middle is then to the right of the counter-clockwise edge, or
    along the axis of the rays.
    """
    first, second = opposite(points)
    length, middle = split(combine(1.0, first, 1.0, second))
    if length >= TOUCHED:
        return middle
    if points.shape[1] == 2:
        return first[1], -first[0], 0.0
    return split(cross(first, unit(points[2])))[1]


@inner_kernel
def _most_prominent(towards, silhouettes, only_blocking):
    """Index of the widest obstacle; it blocks directions as near to its middle as its edges."""
    prominent, least_cosine = STRAIGHT_AHEAD, math.inf
    for m in range(silhouettes.shape[0]):
        if not is_seen(silhouettes[m]):
            continue
        first, second = opposite(silhouettes[m])
        if dot(first, second) >= least_cosine:
            continue
        middle = middle_of(silhouettes[m])
        if not only_blocking or dot(towards, middle) >= dot(first, middle):
            prominent, least_cosine = m, dot(first, second)
    return prominent


@inner_kernel
def _nearest_point(towards, points):
    """Silhouette point nearest in angle, the first of equals."""
    nearest, best = unit(points[0]), -math.inf
    for s in range(points.shape[0]):
        point = unit(points[s])
        if dot(towards, point) > best:
            nearest, best = point, dot(towards, point)
    return nearest
