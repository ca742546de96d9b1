"""Discs and spheres: distance, way in, silhouette."""

import math

import numpy as np

from ...compilation import kernel
from ..vectors import X_AXIS, combine, cross, dot, norm, subtract
from .crossings import first_crossing

NEARLY_ZERO = 1e-9
"""m, or m/s: a shorter vector has no direction worth the name."""
_AZIMUTHS = 0.25 * math.pi * np.arange(8)
COS_AZIMUTH = tuple(np.cos(_AZIMUTHS).tolist())
SIN_AZIMUTH = tuple(np.sin(_AZIMUTHS).tolist())
"""Of the eight azimuths at which the cone of an obstacle in space is seen, k · 45°."""


@kernel
def ball_surface(point, centre, radius):
    """Signed distance of a point from a ball, and the unit normal there.

        ‖p − c‖ − R,   (p − c)/‖p − c‖

    Args:
        point: p, a triple, m.
        centre: c, a triple, m.
        radius: R, m.

    Returns:
        The distance, m, negative inside; and the outward normal, a unit triple, at the centre the x
        axis.
    """
    offset = subtract(point, centre)
    distance = norm(offset)
    if distance == 0.0:
        return -radius, X_AXIS
    normal = (offset[0] / distance, offset[1] / distance, offset[2] / distance)
    return distance - radius, normal


@kernel
def ball_entry(point, way, centre, radius, depth):
    """Where a straight way meets a ball that it goes deeper than ``depth`` into.

        least s in [0, 1] with ‖p + s w − c‖ ≤ R + max(0, −depth),
        if ‖p + s w − c‖ ≤ R − depth somewhere on the way

    Args:
        point: p, where the way begins, a triple, m.
        way: w, a triple, m.
        centre: c, a triple, m.
        radius: R, m.
        depth: m; a negative one makes the ball fatter by so much.

    Returns:
        s, a fraction of the way; inf if there is none.
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
        Five numbers: x and y of the counter-clockwise edge and of the clockwise edge, unit vectors,
        and the distance of the centre, m.
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
    """Unit vector u = (c − p)/‖c − p‖ from a point towards a centre, and their distance.

    Args:
        point: p, a triple, m.
        centre: c, a triple, m.

    Returns:
        u, a unit triple, the x axis at the centre itself; and ‖c − p‖, m.
    """
    offset = subtract(centre, point)
    distance = norm(offset)
    if distance == 0.0:
        return X_AXIS, 0.0
    return (offset[0] / distance, offset[1] / distance, offset[2] / distance), distance


@kernel
def half_angle(distance, radius):
    """Half the angle under which a ball is seen: sin α = R/distance.

    Args:
        distance: of its centre, m.
        radius: R, m.

    Returns:
        cos α and sin α, two numbers without unit; (0, 1) on the ball and inside.
    """
    if distance <= radius:
        return 0.0, 1.0
    return math.sqrt((distance - radius) * (distance + radius)) / distance, radius / distance


@kernel
def azimuth_axes(towards, net_bearing, axis_x, axis_y):
    """The unit vectors e (azimuth 0) and u × e across the direction u.

        e = (f − (fᵀu) u)/‖f − (fᵀu) u‖

    If that vanishes, axis_x takes the place of f, and then axis_y.

    Args:
        towards: u, a unit triple.
        net_bearing: f, a triple, m/s, in the same frame.
        axis_x: the robot's local x axis, a unit triple.
        axis_y: its y axis.

    Returns:
        e and u × e, two unit triples.
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

    Returns:
        The ray, a unit triple.
    """
    aside = combine(sine * COS_AZIMUTH[k], e, sine * SIN_AZIMUTH[k], w)
    return combine(cosine, towards, 1.0, aside)
