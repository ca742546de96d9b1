"""Discs and spheres: shape, distance, entry, edges, outline."""

import math
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from ..compilation import kernel
from ..field_checks import names_unknown_fields
from ..physics.crossings import first_crossing
from ..physics.vectors import X_AXIS, combine, norm, store, subtract
from . import shape
from .shape import BOUND, COS_AZIMUTH, MIDDLE, SIN_AZIMUTH, Thickness, centre_of_row, check_point

BALL = 1
"""Kind number of discs and spheres. Their row is only the bounding ball."""


@dataclass(frozen=True)
class _Round(shape.Shape):
    """Base class of discs and spheres."""

    centre: tuple[float, ...]
    radius: Thickness
    """Radius, m."""

    def packed(self) -> list[float]:
        """Table row."""
        return [BALL, 0, self.radius, *self.centre, 0.0][: shape.DETAILS]


@names_unknown_fields("Disc")
@dataclass(frozen=True)
class Disc(_Round):
    """Round obstacle in 2-D."""

    centre: Annotated[tuple[float, ...], partial(check_point, dim=2)]
    """Centre, m."""
    dim = 2


@names_unknown_fields("Sphere")
@dataclass(frozen=True)
class Sphere(_Round):
    """Round obstacle in 3-D."""

    centre: Annotated[tuple[float, ...], partial(check_point, dim=3)]
    """Centre, m."""
    dim = 3


@kernel
def _surface(row, corners, point):
    """Signed distance ‖p − c‖ − R and normal (p − c)/‖p − c‖, at the centre the x axis."""
    offset = subtract(point, centre_of_row(row))
    distance = norm(offset)
    if distance == 0.0:
        return -row[BOUND], X_AXIS
    normal = (offset[0] / distance, offset[1] / distance, offset[2] / distance)
    return distance - row[BOUND], normal


@kernel
def _entry(row, corners, point, way, depth, skin=0.0):
    """Least s with ‖p + s w − c‖ ≤ R + max(0, −depth), if ‖p + s w − c‖ ≤ R − depth somewhere.

    R is the radius including the skin.
    """
    offset, radius = subtract(point, centre_of_row(row)), row[BOUND] + skin
    if first_crossing(offset, way, radius - depth) > 1.0:
        return np.inf
    return first_crossing(offset, way, radius + max(0.0, -depth))


@kernel
def disc_edges(x, y, radius):
    """Bearings of both edges of a disc: the offset o = (x, y) of its centre, rotated by ± α.

        (√(o² − R²) o ± R o^⊥) / o²

    On the surface or inside, they are the two directions perpendicular to o, or the x axis if o is
    zero. Returns x and y of the counterclockwise and of the clockwise edge, and the distance of the
    centre, m. It has no branches, for lanes.
    """
    distance = math.sqrt(x * x + y * y)
    along = distance if distance > 0.0 else radius
    x = x if distance > 0.0 else radius
    square = (along - radius) * (along + radius)
    per_square = 1.0 / (along * along)
    c = math.sqrt(square if square > 0.0 else 0.0) * per_square
    s = (radius if radius < along else along) * per_square
    return c * x - s * y, s * x + c * y, c * x + s * y, c * y - s * x, distance


@kernel
def _edges(row, corners, point):
    centre = centre_of_row(row)
    ax, ay, bx, by, _ = disc_edges(centre[0] - point[0], centre[1] - point[1], row[BOUND])
    return (ax, ay, 0.0), (bx, by, 0.0)


@kernel
def _cone(row, corners, point, axes, out):
    """Rays cos α u + sin α (cos φ e + sin φ (u × e)),  sin α = R/‖c − p‖ or 1,  φ = k · 45°."""
    towards, e, w = axes
    distance, radius = norm(subtract(centre_of_row(row), point)), row[BOUND]
    cosine, sine = 0.0, 1.0
    if distance > radius:
        cosine = math.sqrt((distance - radius) * (distance + radius)) / distance
        sine = radius / distance
    for k in range(8):
        aside = combine(sine * COS_AZIMUTH[k], e, sine * SIN_AZIMUTH[k], w)
        store(combine(cosine, towards, 1.0, aside), out[k])


BALLS = shape.ShapeKind(
    kind=BALL,
    surface=_surface,
    entry=_entry,
    normals=shape.one_normal(_surface),
    edges=_edges,
    cone=_cone,
    outlines=lambda row, _, d: shape.round_outlines([row[MIDDLE : MIDDLE + d]], row[BOUND]),
)
