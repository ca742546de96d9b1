"""What a sensor makes of one exact row: whether it is there, how far it is turned, how rounded.

An imperfection is a setting in ``sensing.py`` and, all else, here: a constant of ``Imperfections``,
its value in ``imperfections_of``, and its equation in ``neighbour_seen`` or ``point_seen``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..compilation import inner_kernel
from ..physics.random_streams import uniform
from ..physics.vectors import ORIGIN, load, subtract, to_local
from .line_of_sight import is_hidden_by_obstacles, is_hidden_by_robot, is_seen
from .sensing import Sensing
from .sensor_equations import DRAWS, gaussian, in_sectors, random_axis, turned, turned_towards


class Imperfections(NamedTuple):
    """Those of a team's sensors, as kernels take them; see ``Sensing`` for what they are."""

    reach: float
    """Range, m; inf without a limit."""
    half_field: float
    """Half the field of view, rad."""
    noise: float
    bias: float
    error: float
    dropout: float
    sectors: int
    """0 leaves bearings as they are."""
    obstacles_hide: bool
    robots_hide: bool


def imperfections_of(sensing: Sensing) -> Imperfections | None:
    """What kernels need to know of a sensor; None if it is exact but for custom imperfections."""
    if sensing.built_in_exact:
        return None
    return Imperfections(
        reach=math.inf if sensing.range is None else sensing.range,
        half_field=0.5 * sensing.field_of_view,
        noise=sensing.noise,
        bias=sensing.bias,
        error=sensing.error,
        dropout=sensing.dropout,
        sectors=sensing.sectors or 0,
        obstacles_hide=sensing.occlusion in ("obstacles", "both"),
        robots_hide=sensing.occlusion in ("robots", "both"),
    )


@inner_kernel(inline="code")  # to hand all its arguments over would take longer than what it does
def neighbour_seen(pair, row, frame, sensor, keys, places, scene):
    """What robot i makes of the exact row of its neighbour j; zero if it does not see it.

    Args:
        pair: i and j.
        row: a_ij g_ij in the frame of robot i, a pair or triple, m/s.
        frame: of robot i, row by row.
        sensor: Imperfections.
        keys: of the team's stream of sensing: of the episode, and of the step.
        places: positions (n, d), m, and where each robot raises the hull's perimeter most (n, d).
        scene: obstacles of the team, who is part of whom (n,), radius of robots that hide, m.
    """
    (i, j), (positions, outward) = pair, places
    counter = (i * positions.shape[0] + j) * DRAWS
    offset = subtract(load(positions[j]), load(positions[i]))
    if (
        not is_seen(to_local(frame, _like(row, offset)), sensor.reach, sensor.half_field)
        or (sensor.dropout > 0.0 and uniform(keys[1], counter + 4) < sensor.dropout)
        or (
            (sensor.obstacles_hide or sensor.robots_hide)
            and _is_hidden(pair, offset, sensor, scene[0], scene[1], scene[2], positions)
        )
    ):
        return _like(row, ORIGIN)
    row = _turned_by_chance(row, keys, counter, sensor)
    if sensor.error > 0.0:
        row = turned_towards(row, sensor.error, to_local(frame, _like(row, load(outward[i]))))
    if sensor.sectors > 0:
        row = in_sectors(row, sensor.sectors)
    return row


@inner_kernel(inline="code")
def point_seen(row, sensor, keys, counter):
    """What a robot makes of a silhouette point that is in its field of view.

    Args:
        row: its bearing in the robot's frame, a pair or triple; zero if the point is absent.
        sensor: Imperfections.
        keys: as ``neighbour_seen``.
        counter: index of the first of this point's DRAWS numbers of the stream.
    """
    row = _turned_by_chance(row, keys, counter, sensor)
    if sensor.sectors > 0:
        row = in_sectors(row, sensor.sectors)
    return row


@inner_kernel
def _is_hidden(pair, offset, sensor, obstacles, merged_into, radius, positions):
    """Whether an obstacle or another robot, of this radius (m), stands between robots i and j."""
    i, j = pair
    if obstacles is not None:
        if sensor.obstacles_hide and is_hidden_by_obstacles(obstacles, load(positions[i]), offset):
            return True
    if sensor.robots_hide:
        for k in range(positions.shape[0]):
            if k != i and k != j and merged_into[k] == k:
                other = subtract(load(positions[k]), load(positions[i]))
                if is_hidden_by_robot(offset, other, radius):
                    return True
    return False


@inner_kernel(inline="code")
def _turned_by_chance(row, keys, counter, sensor):
    """A row turned by its bias of the episode and by its noise of the step."""
    if sensor.bias > 0.0:
        angle = sensor.bias * gaussian(keys[0], counter)
        row = turned(row, angle, _axis(row, keys[0], counter + 2))
    if sensor.noise > 0.0:
        angle = sensor.noise * gaussian(keys[1], counter)
        row = turned(row, angle, _axis(row, keys[1], counter + 2))
    return row


@inner_kernel(inline="code")
def _axis(row, key, counter):
    """About which a row is turned; the plane has but one."""
    if len(row) == 2:
        return ORIGIN
    return random_axis(key, counter)


@inner_kernel(inline="code")
def _like(row, v):
    """A triple as a pair in the plane, where rows are pairs."""
    if len(row) == 2:
        return v[0], v[1]
    return v
