"""Sensor imperfections, and their effect on individual rows.

An imperfection is a setting in ``sensing.py``. Here it has a field of ``Imperfections``, its value
in ``imperfections_of`` and its equation. ``neighbour_seen`` combines them. The stage
``apply_noise`` applies range, field of view and noise over lanes.

Rows are a_ij g_ij or unit bearings in the robot's own frame, pairs or triples; rotations keep their
length.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import inner_kernel, kernel
from ..obstacles.obstacle_set import is_hidden_by_obstacles
from ..physics.vectors import (
    ORIGIN,
    X_AXIS,
    combine,
    cross,
    dot,
    load,
    norm,
    subtract,
    to_local,
    triple,
)
from .effects import draws_detection, has_memory
from .sensing import Sensing

_NEARLY_PARALLEL = 1e-9  # sine of the angle below which two directions are parallel


class Imperfections(NamedTuple):
    """Sensor imperfections of one robot for kernels; see ``Sensing`` for their meaning.

    A team has a table of them, (n, fields) float64, with a row for each robot.
    """

    reach: float  # range, m; inf without a limit
    half_field: float  # half the field of view, rad; at most π
    view_cosine: float  # its cosine
    noise: float  # white, rad
    bias: float
    error: float
    dropout: float  # where no other effect decides on detection
    sectors: float  # 0 disables quantisation
    obstacles_hide: float  # 1 if obstacles occlude robots, else 0
    robots_hide: float  # likewise for other robots


def imperfections_of(sensing: Sensing, n_robots: int) -> NDArray[np.float64] | None:
    """Table of ``Imperfections`` of a team; None if sensors are exact but for custom ones."""
    if sensing.built_in_exact:
        return None
    n, columns = n_robots, dict[str, Any]()
    columns["reach"] = sensing.each("range", n)
    columns["half_field"] = 0.5 * sensing.each("field_of_view", n)
    columns["view_cosine"] = np.cos(columns["half_field"])
    columns["noise"] = np.where(has_memory(sensing, n), 0.0, sensing.each("noise", n))
    columns["dropout"] = np.where(draws_detection(sensing, n), 0.0, sensing.each("dropout", n))
    columns["obstacles_hide"] = sensing.among("occlusion", n, "obstacles", "both")
    columns["robots_hide"] = sensing.among("occlusion", n, "robots", "both")
    columns |= {name: sensing.each(name, n) for name in ("bias", "error", "sectors")}
    return table_of(Imperfections(**columns))


def table_of(columns: Any) -> NDArray[np.float64]:
    """Table, (n, fields), of ``Imperfections`` whose fields are arrays (n,)."""
    return np.stack(columns, axis=1, dtype=np.float64)


def columns_of(table: NDArray[np.float64]) -> Any:
    """``Imperfections`` whose fields are the columns of a table, arrays (n,)."""
    return Imperfections(*table.T)


def changes_lanes(table: NDArray[np.float64]) -> bool:
    """True if range, field of view or noise changes the rows of neighbours."""
    own = columns_of(table)
    limited = np.isfinite(own.reach) | (own.half_field < math.pi)
    return bool(limited.any() or max(map(np.max, (own.noise, own.bias, own.dropout))) > 0.0)


def changes_singles(table: NDArray[np.float64]) -> bool:
    """True if other imperfections apply, which process one environment at a time."""
    own = columns_of(table)
    return any(part.any() for part in (own.obstacles_hide, own.robots_hide, own.error, own.sectors))


def changes_silhouettes(table: NDArray[np.float64]) -> bool:
    """True if field of view or noise changes the rows of obstacles."""
    own = columns_of(table)
    return bool((own.half_field < math.pi).any() or own.noise.any() or own.bias.any())


@inner_kernel(inline="code")
def errors_of(table, i):
    """``Imperfections`` of robot i, from its row of a table."""
    own = table[i]
    return Imperfections(
        own[0], own[1], own[2], own[3], own[4], own[5], own[6], own[7], own[8], own[9]
    )


@inner_kernel(inline="code")  # passing all its arguments would take longer than its work
def neighbour_seen(pair, row, frame, sensor, places, scene):
    """Row of neighbour j as observed by robot i, zero if j is hidden.

    Given are i and j, and the row after range, field of view and noise, in the frame of robot i.
    ``places`` are positions (n, d), m, and for each robot the direction (n, d) that increases the
    hull perimeter most. ``scene`` is obstacles, merged_into (n,) and the radii of robots, (n,), m.
    """
    (i, j), (positions, outward) = pair, places
    offset = subtract(load(positions[j]), load(positions[i]))
    if _is_hidden(pair, offset, sensor, scene[0], scene[1], scene[2], positions):
        return _like(row, ORIGIN)
    if sensor.error > 0.0:
        row = turned_towards(row, sensor.error, to_local(frame, _like(row, load(outward[i]))))
    if sensor.sectors > 0:
        row = in_sectors(row, sensor.sectors)
    return row


@inner_kernel
def _is_hidden(pair, offset, sensor, obstacles, merged_into, radii, positions):
    """True if an obstacle or another robot, of its radius (m), is between robots i and j."""
    i, j = pair
    if obstacles is not None:
        if sensor.obstacles_hide > 0.0 and is_hidden_by_obstacles(
            obstacles, load(positions[i]), offset
        ):
            return True
    if sensor.robots_hide > 0.0:
        for k in range(positions.shape[0]):
            if k != i and k != j and merged_into[k] == k:
                other = subtract(load(positions[k]), load(positions[i]))
                if is_hidden_by_robot(offset, other, radii[k]):
                    return True
    return False


@inner_kernel(inline="code")
def _like(row, v):
    """Convert a triple to a pair if rows are pairs, in 2-D."""
    if len(row) == 2:
        return v[0], v[1]
    return v


@kernel(inline="code")
def is_seen(offset, frame, reach, half_field):
    """True if a point at an offset, m, from a robot with this frame is in range and in view.

    ‖offset‖ ≤ range (inf without a limit)   and   ∠(Rᵀ offset, x) ≤ field of view/2

    The length is that of the unrotated offset, which is bitwise equal for both robots. So both are
    in range of each other, or neither (theorem R). In two frames it would be rounded differently.
    """
    if dot(offset, offset) > reach * reach:
        return False
    return is_in_view(to_local(frame, offset), half_field)


@kernel(inline="code")
def is_in_view(direction, half_field):
    """True if a direction, of any length, in a robot's own frame is in its field of view.

    A half angle of π is the full circle.
    """
    x, y, z = triple(direction)
    # computing the angle takes as long as a step of a robot with an exact sensor
    return half_field >= math.pi or math.atan2(math.sqrt(y * y + z * z), x) <= half_field


@kernel
def is_hidden_by_robot(offset, other, radius):
    """True if a nearer robot, a disc or sphere, occludes another robot.

    The former has a radius (m) and the offset ``other``, the latter ``offset``, triples, m. The
    nearest robot is always visible.
    """
    distance_squared, other_squared = dot(offset, offset), dot(other, other)
    along = dot(offset, other)
    if along <= 0.0 or other_squared >= distance_squared:
        return False
    return other_squared - along * along / distance_squared < radius * radius


@kernel(inline="code")
def turned(row, angle, axis):
    """Row rotated by an angle α, rad, counterclockwise in 2-D.

    In 3-D the rotation is about the component of an axis (a triple) that is perpendicular to the
    row. The x or y axis replaces an axis along the row.

        R(α) g,   or   cos α g + sin α (e × g),  e ∥ axis − (axis·g) g
    """
    c, s = math.cos(angle), math.sin(angle)
    if len(row) == 2:
        return c * row[0] - s * row[1], s * row[0] + c * row[1]
    return combine(c, row, s, cross(_across(axis, row), row))


@kernel
def _across(axis, row):
    """Unit vector along the component of an axis that is perpendicular to a row, triples."""
    for candidate in (axis, X_AXIS, (0.0, 1.0, 0.0)):
        part = cross(row, cross(candidate, row))
        length = norm(part)
        if length > _NEARLY_PARALLEL * norm(candidate) * dot(row, row):
            return part[0] / length, part[1] / length, part[2] / length
    return 0.0, 0.0, 1.0  # the row is zero: no rotation


@kernel(inline="code")
def turned_towards(row, angle, target):
    """Row rotated by exactly an angle, rad, towards ``target`` as far as possible.

    In 2-D counterclockwise if both senses are equally good.
    """
    if len(row) == 2:
        to_the_left = row[0] * target[1] - row[1] * target[0] >= 0.0
        return turned(row, angle if to_the_left else -angle, X_AXIS)
    return turned(row, angle, cross(row, target))


@kernel(inline="code")
def in_sectors(row, sectors):
    """Row rotated to the middle of its sector.

    That is the nearest multiple of 2π/sectors from the x axis. In 3-D, in yaw and, within ± π/2, in
    elevation.
    """
    width = 2.0 * math.pi / sectors
    yaw = width * math.floor(math.atan2(row[1], row[0]) / width + 0.5)
    if len(row) == 2:
        length = norm(row)
        return length * math.cos(yaw), length * math.sin(yaw)
    length, level = norm(row), math.sqrt(row[0] * row[0] + row[1] * row[1])
    highest = math.floor(0.5 * math.pi / width + 1e-9)
    steps = math.floor(math.atan2(row[2], level) / width + 0.5)
    pitch = width * min(max(steps, -highest), highest)
    level = length * math.cos(pitch)
    return level * math.cos(yaw), level * math.sin(yaw), length * math.sin(pitch)
