"""Capsules, all points within a radius of a segment: shape, distance, entry, edges, outline."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from ..checks import is_sequence, raise_invalid
from ..compilation import kernel
from ..field_checks import names_unknown_fields
from ..physics.crossings import capsule_crossing
from ..physics.vectors import combine, dot, norm, perpendicular, split, store, subtract, without
from . import shape
from .disc import disc_edges
from .shape import BOUND, COS_AZIMUTH, MIDDLE, OWN, SIN_AZIMUTH, Thickness, centre_of_row

CAPSULE = 3
"""Kind number of capsules. Their row has the half axis x, y, z and the radius after the bounding
ball."""
AXIS, THICKNESS = OWN, OWN + 3
"""Columns of half axis and radius in kernel rows."""
_HALVINGS = 52  # bisection steps of a boundary ray: the bits of a float64
# angles of the vertices that approximate the half circle at an end
_ROUND_END = np.linspace(-math.pi / 2, math.pi / 2, 17)
_MOST_BEADS = 99  # maximum number of balls drawn for a capsule; a very thin one is dotted


@names_unknown_fields("Capsule")
@dataclass(frozen=True)
class Capsule(shape.Shape):
    """All points within a radius of a segment, in 2-D or 3-D, such as a wall with round ends."""

    ends: Annotated[tuple[tuple[float, ...], tuple[float, ...]], _check_ends]
    """End points of the segment, m."""
    radius: Thickness
    """Radius, m."""

    @property
    def dim(self) -> int:
        """Dimension of its points."""
        return len(self.ends[0])

    def packed(self) -> list[float]:
        """Table row; the radius of the bounding ball is half the capsule's length."""
        first, second = np.array(self.ends)
        reach = float(np.linalg.norm(second - first)) / 2 + self.radius
        middle, half = (
            [*vector.tolist(), 0.0][:3] for vector in ((first + second) / 2, (second - first) / 2)
        )
        return [CAPSULE, 0, reach, *middle, *half, self.radius]


def _check_ends(field: str, value: Any) -> tuple[tuple[float, ...], ...]:
    """End points of a segment, validated as 2-D or 3-D points."""
    pair = tuple(value) if is_sequence(value) else ()
    if len(pair) != 2:
        raise_invalid(field, value, "two points, m")
    dim = 3 if is_sequence(pair[0]) and len(pair[0]) == 3 else 2
    return tuple(shape.check_point(f"{field}[{k}]", end, dim) for k, end in enumerate(pair))


@kernel(inline="code")
def _axis(row):
    return row[AXIS], row[AXIS + 1], row[AXIS + 2]


@kernel
def _nearest_share(offset, half):
    """Position on a segment of its point nearest to ``offset``, as a fraction of ``half``.

    The segment has its middle at the origin and the ends ± half; the fraction is in [−1, 1].
    """
    square = dot(half, half)
    if square == 0.0:
        return 0.0
    return min(max(dot(offset, half) / square, -1.0), 1.0)


@kernel
def _surface(row, corners, point):
    """Signed distance and normal of a capsule around the segment from c − h to c + h.

        ‖o − s h‖ − R,   o = p − c,   s = clip(oᵀh/‖h‖², −1, 1)

    On the segment itself the normal is any perpendicular direction.
    """
    half, radius = _axis(row), row[THICKNESS]
    offset = subtract(point, centre_of_row(row))
    aside = combine(1.0, offset, -_nearest_share(offset, half), half)
    distance = norm(aside)
    if distance > 0.0:
        return distance - radius, (aside[0] / distance, aside[1] / distance, aside[2] / distance)
    return -radius, split(perpendicular(split(half)[1]))[1]


@kernel
def _entry(row, corners, point, way, depth, skin=0.0):
    """Least s at which p + s w is within R + max(0, −depth) of the segment.

    Only if the path comes within R − depth of it; R is the radius including the skin.
    """
    half, radius = _axis(row), row[THICKNESS] + skin
    offset = subtract(point, centre_of_row(row))
    if capsule_crossing(offset, way, half, radius - depth) > 1.0:
        return np.inf
    return capsule_crossing(offset, way, half, radius + max(0.0, -depth))


@kernel
def _edges(row, corners, point):
    """Edges of the hull of the two end discs: for each side, the outer of theirs."""
    centre, half, radius = centre_of_row(row), _axis(row), row[THICKNESS]
    x, y = centre[0] - point[0], centre[1] - point[1]
    ax, ay, bx, by, _ = disc_edges(x - half[0], y - half[1], radius)
    cx, cy, dx, dy, _ = disc_edges(x + half[0], y + half[1], radius)
    if ax * cy - ay * cx > 0.0:
        ax, ay = cx, cy
    if bx * dy - by * dx < 0.0:
        bx, by = dx, dy
    return (ax, ay, 0.0), (bx, by, 0.0)


@kernel
def _cone(row, corners, point, axes, out):
    """Boundary rays of the visibility cone of a capsule.

    The cone is convex. Of the rays cos θ u + sin θ (cos φ e + sin φ w), φ = k · 45°, those up to
    some θ hit the capsule; bisection finds θ.
    """
    towards, e, w = axes
    half, radius = _axis(row), row[THICKNESS]
    offset = subtract(centre_of_row(row), point)
    for k in range(8):
        aside = combine(COS_AZIMUTH[k], e, SIN_AZIMUTH[k], w)
        hits, misses = 0.0, math.pi
        for _ in range(_HALVINGS):
            angle = 0.5 * (hits + misses)
            ray = combine(math.cos(angle), towards, math.sin(angle), aside)
            if _is_hit(ray, offset, half, radius):
                hits = angle
            else:
                misses = angle
        store(combine(math.cos(hits), towards, math.sin(hits), aside), out[k])


@kernel
def _is_hit(ray, offset, half, radius):
    """True if a half-line from the origin along a unit vector intersects a capsule."""
    across, half_across = without(offset, ray), without(half, ray)
    share = _nearest_share(combine(-1.0, across, 0.0, across), half_across)
    if dot(combine(1.0, offset, share, half), ray) < 0.0:
        return False  # the nearest point is behind, and the origin is outside
    return norm(combine(1.0, across, share, half_across)) <= radius


def _outlines(row: NDArray[np.float64], _: int, dim: int) -> list[shape.Outline]:
    """Two half circles and their connection; in 3-D, balls along the segment."""
    half, centre = row[AXIS : AXIS + dim], row[MIDDLE : MIDDLE + dim]
    if dim == 3:
        count = 1 + 2 * math.ceil(2 * float(np.linalg.norm(half)) / row[THICKNESS])
        shares = np.linspace(-1.0, 1.0, min(count, _MOST_BEADS)) if count > 1 else (0.0,)
        return shape.round_outlines((centre + share * half for share in shares), row[THICKNESS])
    bearing = math.atan2(half[1], half[0])
    ends = [
        centre + end * half + row[THICKNESS] * np.stack([np.cos(around), np.sin(around)], axis=-1)
        for end, around in ((1.0, bearing + _ROUND_END), (-1.0, bearing + math.pi + _ROUND_END))
    ]
    return [shape.Outline(centre, float(row[BOUND]), np.concatenate(ends))]


CAPSULES = shape.ShapeKind(
    kind=CAPSULE,
    surface=_surface,
    entry=_entry,
    normals=shape.one_normal(_surface),
    edges=_edges,
    cone=_cone,
    numbers=4,
    outlines=_outlines,
)
