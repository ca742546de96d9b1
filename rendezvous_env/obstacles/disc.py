"""Discs and spheres: what a user sets, distance, way in, silhouette, picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from ..physics.crossings import first_crossing
from ..physics.vectors import X_AXIS, combine, norm, subtract
from .shape import (
    CENTRE,
    COS_AZIMUTH,
    RADIUS,
    SIN_AZIMUTH,
    Ball,
    Outline,
    Packed,
    check_point,
    check_radius,
)

BALL = 1
"""Kind of a disc or sphere; its row needs no more than the bounding ball."""


@dataclass(frozen=True)
class Disc:
    """A round obstacle in the plane."""

    centre: tuple[float, float]
    """m."""
    radius: float
    """m."""
    dim = 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", check_point("Disc", "centre", self.centre, 2))
        object.__setattr__(self, "radius", check_radius("Disc", self.radius))

    def packed(self) -> Packed:
        """Its row."""
        return Packed(BALL, 0, self.centre, self.radius, [])


@dataclass(frozen=True)
class Sphere:
    """A round obstacle in space."""

    centre: tuple[float, float, float]
    """m."""
    radius: float
    """m."""
    dim = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", check_point("Sphere", "centre", self.centre, 3))
        object.__setattr__(self, "radius", check_radius("Sphere", self.radius))

    def packed(self) -> Packed:
        """Its row."""
        return Packed(BALL, 0, self.centre, self.radius, [])


def outline(row: NDArray[np.float64]) -> Outline:
    """Of a disc's row."""
    return Outline(row[CENTRE : CENTRE + 2], float(row[RADIUS]), np.empty((0, 2)))


def beads(row: NDArray[np.float64]) -> list[Ball]:
    """Of a sphere's row."""
    return [Ball(row[CENTRE : CENTRE + 3], float(row[RADIUS]))]


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
