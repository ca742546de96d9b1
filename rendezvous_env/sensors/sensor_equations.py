"""How a sensor turns the bearings of what it sees: by an adversary, into sectors.

Rows are a_ij g_ij or unit bearings in the robot's own frame, pairs of the plane or triples of
space; what turns them keeps their length.
"""

import math

from ..compilation import kernel
from ..physics.vectors import X_AXIS, combine, cross, dot, norm, square

_NEARLY_PARALLEL = 1e-9
"""Sine of an angle between two directions below which they span no plane worth the name."""

# ---- what is turned -----------------------------------------------------------------------------


@kernel(inline="code")
def turned(row, angle, axis):
    """A row turned by an angle: in the plane counter-clockwise, in 3-D about the part of an axis
    that is perpendicular to it.

        R(α) g,   or   cos α g + sin α (e × g),  e ∥ axis − (axis·g) g

    Args:
        row: a pair or triple.
        angle: α, rad.
        axis: a triple, not used in the plane. Nearly along the row it counts as the x axis, and
            then as the y axis.
    """
    c, s = math.cos(angle), math.sin(angle)
    if len(row) == 2:
        return c * row[0] - s * row[1], s * row[0] + c * row[1]
    return combine(c, row, s, cross(_across(axis, row), row))


@kernel
def _across(axis, row):
    """Unit vector along the part of an axis that is perpendicular to a row, triples."""
    for candidate in (axis, X_AXIS, (0.0, 1.0, 0.0)):
        part = cross(row, cross(candidate, row))
        length = norm(part)
        if length > _NEARLY_PARALLEL * norm(candidate) * dot(row, row):
            return part[0] / length, part[1] / length, part[2] / length
    return 0.0, 0.0, 1.0  # the row is zero: nothing is turned


@kernel(inline="code")
def turned_towards(row, angle, target):
    """A row turned by exactly an angle, so that it points as far along a direction as it then can.

    Args:
        row: a pair or triple.
        angle: rad; in the plane one of the two senses is chosen, counter-clockwise if they are
            equally good, in 3-D the plane of row and target.
        target: a pair or triple.
    """
    if len(row) == 2:
        to_the_left = row[0] * target[1] - row[1] * target[0] >= 0.0
        return turned(row, angle if to_the_left else -angle, X_AXIS)
    return turned(row, angle, cross(row, target))


@kernel(inline="code")
def in_sectors(row, sectors):
    """A row turned into the middle of its sector: the nearest of some directions, evenly spaced.

    In the plane the directions are the multiples of 2π/sectors from the x axis. In space the yaw
    is rounded to them, and so is the elevation, as far as ± π/2.

    Args:
        row: a pair or triple.
        sectors: how many.
    """
    width = 2.0 * math.pi / sectors
    yaw = width * math.floor(math.atan2(row[1], row[0]) / width + 0.5)
    if len(row) == 2:
        length = math.sqrt(square(row))
        return length * math.cos(yaw), length * math.sin(yaw)
    length, level = norm(row), math.sqrt(row[0] * row[0] + row[1] * row[1])
    highest = math.floor(0.5 * math.pi / width + 1e-9)
    steps = math.floor(math.atan2(row[2], level) / width + 0.5)
    pitch = width * min(max(steps, -highest), highest)
    level = length * math.cos(pitch)
    return level * math.cos(yaw), level * math.sin(yaw), length * math.sin(pitch)
