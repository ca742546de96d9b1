"""Capsules, all points within a radius of a segment: what a user sets, distance, way in,
silhouette, picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import shown
from ..compilation import kernel
from ..physics.crossings import capsule_crossing
from ..physics.vectors import ORIGIN, X_AXIS, add, combine, dot, norm, subtract, without
from .disc import disc_edges
from .shape import (
    CENTRE,
    COS_AZIMUTH,
    DETAILS,
    RADIUS,
    SIN_AZIMUTH,
    Ball,
    Outline,
    Packed,
    check_point,
    check_radius,
    is_sequence,
)

CAPSULE = 3
"""Kind of a capsule; its row goes on with the half axis x, y, z and its own radius."""
AXIS, THICKNESS = DETAILS, DETAILS + 3
"""Columns of these."""
_HALVINGS = 52
"""Of the interval in which a boundary ray is looked for: as many as a float64 has digits."""
_ROUND_END = np.linspace(-math.pi / 2, math.pi / 2, 17)
"""Angles of the corners that stand for the half circle at an end of a capsule."""
_MOST_BEADS = 99
"""Balls drawn for a capsule; a very thin one is dotted."""


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a segment, in the plane or in space: a wall with round ends, a
    fallen trunk.
    """

    ends: tuple[tuple[float, ...], tuple[float, ...]]
    """Both ends of the segment, m."""
    radius: float
    """m."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends", _check_ends(self.ends))
        object.__setattr__(self, "radius", check_radius("Capsule", self.radius))

    @property
    def dim(self) -> int:
        """Dimension of the space it is in."""
        return len(self.ends[0])

    def packed(self) -> Packed:
        """Its row; the radius of the bounding ball is half its length."""
        first, second = np.array(self.ends)
        half = [*((second - first) / 2).tolist(), 0.0][:3]
        reach = float(np.linalg.norm(second - first)) / 2 + self.radius
        return Packed(CAPSULE, 0, tuple((first + second) / 2), reach, [*half, self.radius])


def _check_ends(value: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Both ends of a capsule's segment, points of the plane or of space."""
    pair = tuple(value) if is_sequence(value) else ()
    if len(pair) != 2:
        raise ValueError(f"obstacles: ends {shown(value)} of a Capsule must be two points, m")
    dim = 3 if is_sequence(pair[0]) and len(pair[0]) == 3 else 2
    first, second = (check_point("Capsule", f"ends[{k}]", end, dim) for k, end in enumerate(pair))
    return first, second


def outline(row: NDArray[np.float64]) -> Outline:
    """Of the row of a capsule of the plane: two half circles, joined."""
    half, centre = row[AXIS : AXIS + 2], row[CENTRE : CENTRE + 2]
    bearing = math.atan2(half[1], half[0])
    ends = [
        centre + end * half + row[THICKNESS] * np.stack([np.cos(around), np.sin(around)], axis=-1)
        for end, around in ((1.0, bearing + _ROUND_END), (-1.0, bearing + math.pi + _ROUND_END))
    ]
    return Outline(centre, float(row[RADIUS]), np.concatenate(ends))


def beads(row: NDArray[np.float64]) -> list[Ball]:
    """Of the row of a capsule in space: balls along it."""
    centre, half, thickness = row[CENTRE : CENTRE + 3], row[AXIS : AXIS + 3], float(row[THICKNESS])
    count = min(1 + 2 * math.ceil(2 * float(np.linalg.norm(half)) / thickness), _MOST_BEADS)
    shares = np.linspace(-1.0, 1.0, count) if count > 1 else (0.0,)
    return [Ball(centre + share * half, thickness) for share in shares]


@kernel
def _nearest_share(offset, half):
    """Where on a segment (middle at the origin, ends ± half) the point nearest to ``offset`` lies,
    as a share of ``half`` in [−1, 1].
    """
    square = dot(half, half)
    if square == 0.0:
        return 0.0
    return min(max(dot(offset, half) / square, -1.0), 1.0)


@kernel
def capsule_surface(point, centre, half, radius):
    """Signed distance of a point from a capsule, and the unit normal there.

        ‖o − s h‖ − R,   o = p − c,   s = clip(oᵀh/‖h‖², −1, 1)

    On the segment itself the normal is any direction across it.

    Args:
        point: p, a triple, m.
        centre: c, middle of the segment, a triple, m.
        half: h, from there to one end, a triple, m.
        radius: R, m.

    Returns:
        The distance, m, negative inside; and the outward normal, a unit triple.
    """
    offset = subtract(point, centre)
    aside = add(offset, -_nearest_share(offset, half), half)
    distance = norm(aside)
    if distance > 0.0:
        return distance - radius, (aside[0] / distance, aside[1] / distance, aside[2] / distance)
    length = norm(half)
    if length == 0.0:
        return -radius, X_AXIS
    normal = (-half[1], half[0], 0.0) if half[0] != 0.0 or half[1] != 0.0 else X_AXIS
    size = norm(normal)
    return -radius, (normal[0] / size, normal[1] / size, normal[2] / size)


@kernel
def capsule_entry(point, way, centre, half, radius, depth):
    """Where a straight way meets a capsule that it goes deeper than ``depth`` into.

        least s in [0, 1] at which p + s w is within R + max(0, −depth) of the segment c ± h,
        if it comes within R − depth of it somewhere on the way

    Args:
        point: p, where the way begins, a triple, m.
        way: w, a triple, m.
        centre: c, middle of the segment, a triple, m.
        half: h, from there to one end, a triple, m.
        radius: R, m.
        depth: m; a negative one makes the capsule fatter by so much.

    Returns:
        s, a fraction of the way; inf if there is none.
    """
    offset = subtract(point, centre)
    if capsule_crossing(offset, way, half, radius - depth) > 1.0:
        return np.inf
    return capsule_crossing(offset, way, half, radius + max(0.0, -depth))


@kernel
def capsule_silhouette(point, centre, half, radius):
    """Bearings of the counter-clockwise and the clockwise edge of a capsule of the plane.

    It is the hull of the discs about its ends c ± h, so each edge is the outer one of theirs.

    Args:
        point: the robot, a triple, m, outside the capsule or on it.
        centre: c, middle of the segment, a triple, m.
        half: h, from there to one end, a triple, m.
        radius: m.

    Returns:
        Two unit triples with z = 0.
    """
    x, y = centre[0] - point[0], centre[1] - point[1]
    ax, ay, bx, by, _ = disc_edges(x - half[0], y - half[1], radius)
    cx, cy, dx, dy, _ = disc_edges(x + half[0], y + half[1], radius)
    if ax * cy - ay * cx > 0.0:
        ax, ay = cx, cy
    if bx * dy - by * dx < 0.0:
        bx, by = dx, dy
    return (ax, ay, 0.0), (bx, by, 0.0)


@kernel
def capsule_ray(point, centre, half, radius, towards, e, w, k):
    """Boundary ray k of the cone under which a capsule is seen, at azimuth φ = k · 45°.

    The cone is convex, so of the rays cos θ u + sin θ (cos φ e + sin φ w), θ in [0, π], the first
    ones hit the capsule and the others miss it; θ is halved in.

    Args:
        point: the robot, a triple, m, outside the capsule or on it.
        centre: middle of the segment, a triple, m.
        half: from there to one end, a triple, m.
        radius: m.
        towards: u, unit vector to the centre.
        e: azimuth 0, a unit vector across u.
        w: u × e.
        k: 0 … 7.

    Returns:
        The ray, a unit triple.
    """
    offset = subtract(centre, point)
    aside = combine(COS_AZIMUTH[k], e, SIN_AZIMUTH[k], w)
    hits, misses = 0.0, math.pi
    for _ in range(_HALVINGS):
        angle = 0.5 * (hits + misses)
        if _is_hit(combine(math.cos(angle), towards, math.sin(angle), aside), offset, half, radius):
            hits = angle
        else:
            misses = angle
    return combine(math.cos(hits), towards, math.sin(hits), aside)


@kernel
def _is_hit(ray, offset, half, radius):
    """Whether a half-line from the origin along a unit vector comes within a capsule."""
    across, half_across = without(offset, ray), without(half, ray)
    share = _nearest_share(combine(-1.0, across, 0.0, ORIGIN), half_across)
    if dot(add(offset, share, half), ray) < 0.0:
        return False  # the nearest point lies behind, and the origin is outside the capsule
    return norm(add(across, share, half_across)) <= radius
