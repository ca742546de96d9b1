"""Discs and spheres: distance, way in, silhouette."""

import math

import numpy as np

from ..compilation import kernel
from .crossings import first_crossing
from .vectors import ORIGIN, X_AXIS, combine, cross, dot, norm, subtract

NEARLY_ZERO = 1e-9
"""m, or m/s: a shorter vector has no direction worth the name."""
_AZIMUTHS = 0.25 * math.pi * np.arange(8)
COS_AZIMUTH = tuple(np.cos(_AZIMUTHS).tolist())
SIN_AZIMUTH = tuple(np.sin(_AZIMUTHS).tolist())
"""Of the eight azimuths at which the cone of an obstacle in space is seen, k · 45°."""


@kernel
def ball_surface(point, centre, radius):
    """Signed distance (m) of a point from a ball, negative inside, and the unit normal there.

    At the centre the normal is the x axis.
    """
    offset = subtract(point, centre)
    distance = norm(offset)
    if distance == 0.0:
        return -radius, X_AXIS
    normal = (offset[0] / distance, offset[1] / distance, offset[2] / distance)
    return distance - radius, normal


@kernel
def ball_entry(point, way, centre, radius, depth):
    """Fraction of a straight way at which it meets the surface of a ball that it goes deeper than
    ``depth`` (m) into; inf if it does not. A negative depth makes the ball fatter by so much.
    """
    offset = subtract(point, centre)
    if first_crossing(offset, way, radius - depth) > 1.0:
        return np.inf
    return first_crossing(offset, way, radius + max(0.0, -depth))


@kernel
def disc_edges(x, y, radius):
    """Bearings of both edges of a disc: the offset o of its centre turned by ± α.

        (√(o² − R²) o ± R o^⊥) / o²

    On the surface, or inside, they are the two directions across o. Written without branches, for
    loops over lanes.

    Args:
        x: of the centre, seen from the robot, m.
        y: likewise.
        radius: R, m.

    Returns:
        x and y of the counter-clockwise edge, of the clockwise edge, and the distance of the
        centre, m.
    """
    distance = math.sqrt(x * x + y * y)
    along = distance if distance > 0.0 else 1.0
    x = x if distance > 0.0 else 1.0
    square = (along - radius) * (along + radius)
    per_square = 1.0 / (along * along)
    c = math.sqrt(square if square > 0.0 else 0.0) * per_square
    s = (radius if radius < along else along) * per_square
    return c * x - s * y, s * x + c * y, c * x + s * y, c * y - s * x, distance


@kernel
def centre_direction(point, centre):
    """Unit vector from a point towards a centre, and the distance (m); the x axis at the centre."""
    offset = subtract(centre, point)
    distance = norm(offset)
    if distance == 0.0:
        return X_AXIS, 0.0
    return (offset[0] / distance, offset[1] / distance, offset[2] / distance), distance


@kernel
def half_angle(distance, radius):
    """Cosine and sine of half the angle under which a ball is seen: sin α = R/distance."""
    if distance <= radius:
        return 0.0, 1.0
    return math.sqrt((distance - radius) * (distance + radius)) / distance, radius / distance


@kernel
def azimuth_axes(towards, net_bearing, axis_x, axis_y):
    """The unit vectors e (azimuth 0) and u × e across the direction u = ``towards``.

    e is the part of the net bearing that is perpendicular to u; if that vanishes, of axis_x, and
    then of axis_y.
    """
    across = _across(net_bearing, towards)
    if norm(across) <= NEARLY_ZERO:
        across = _across(axis_x, towards)
    if norm(across) <= NEARLY_ZERO:
        across = _across(axis_y, towards)
    length = norm(across)
    e = (across[0] / length, across[1] / length, across[2] / length)
    return e, cross(towards, e)


@kernel
def _across(vector, direction):
    return combine(1.0, vector, -dot(vector, direction), direction)


@kernel
def sphere_ray(towards, e, w, cosine, sine, k):
    """Boundary ray k of the cone under which a sphere is seen.

        ray = cos α u + sin α (cos φ e + sin φ w),   φ = k · 45°

    Args:
        towards: u, unit vector to the centre.
        e: azimuth 0, a unit vector across u.
        w: u × e.
        cosine: cos α, from ``half_angle``.
        sine: sin α.
        k: 0 … 7.
    """
    aside = combine(sine * COS_AZIMUTH[k], e, sine * SIN_AZIMUTH[k], w)
    return combine(cosine, towards, 1.0, aside)


NOWHERE = ORIGIN
"""A bearing of nothing."""
