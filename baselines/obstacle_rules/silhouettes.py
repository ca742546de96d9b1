"""Headings at the edges of obstacles: the rules, as kernels over robots.

Silhouette points of an obstacle are S unit vectors in the robot's own frame: the counter-clockwise
and the clockwise edge in the plane, eight boundary rays of a cone in 3-D. An obstacle whose first
point is exactly zero is not seen. All kernels take net bearings (N, d) float64 and silhouettes
(N, M, S, d) of any float type, and write unit headings (N, d); a robot without a net bearing heads
along its x axis. Overlapping silhouettes are joined in ``merged_silhouettes_2d`` and ``_3d``.
"""

import math

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.physics.vectors import X_AXIS, combine, cross, dot, load, split, store

STRAIGHT_AHEAD = -1
"""In place of the index of an obstacle: none is in the way."""
TOUCHED = 1e-4
"""Sum of opposite points below which rounding to float32 would choose their middle."""


@kernel
def tangent_headings(net_bearing, silhouettes, only_blocking, out):
    """Head for the edge nearest to f of the most prominent obstacle, along f if there is none; if
    ``only_blocking`` of those that f points into (section IV-C). Of equals it is the first.
    """
    for i in range(out.shape[0]):
        heading = direction_of(net_bearing[i])
        prominent = _most_prominent(heading, silhouettes[i], only_blocking)
        if prominent != STRAIGHT_AHEAD:
            heading = _nearest_point(heading, silhouettes[i, prominent])
        store(heading, out[i])


@inner_kernel
def direction_of(net_bearing):
    """Unit vector along a net bearing, the x axis where there is none, as a triple."""
    length, direction = split(load(net_bearing))
    return direction if length > 0.0 else X_AXIS


@inner_kernel
def is_seen(points):
    """Whether the obstacle with these silhouette points is in sight."""
    for k in range(points.shape[1]):
        if points[0, k] != 0.0:
            return True
    return False


@inner_kernel
def unit(point):
    """A silhouette point as a unit triple."""
    return split(load(point))[1]


@inner_kernel
def opposite(points):
    """Two points across the silhouette: both edges in the plane, rays 0 and 4 in 3-D."""
    return unit(points[0]), unit(points[points.shape[0] // 2])


@inner_kernel
def middle_of(points):
    """Unit triple towards the middle of a silhouette: along the sum of two points across it; of an
    obstacle that is touched, whose points add up to nothing, to the right of the counter-clockwise
    edge, or along the axis that the rays go round.
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
    """Index of the widest obstacle; one blocks what is as near to its middle as its edges are."""
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
    """The silhouette point nearest in angle, the first of equals."""
    nearest, best = unit(points[0]), -math.inf
    for s in range(points.shape[0]):
        point = unit(points[s])
        if dot(towards, point) > best:
            nearest, best = point, dot(towards, point)
    return nearest
