"""What a sensor gets wrong, and what that makes of one row at a time.

An imperfection is a setting in ``sensing.py`` and, here, a constant of ``Imperfections`` and its
value in ``imperfections_of``. What a robot makes of one neighbour is in ``neighbour_seen``; range,
view and chance, that are over lanes, in ``engine/stages/sense_by_chance.py``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..compilation import inner_kernel
from ..physics.vectors import ORIGIN, load, subtract, to_local
from .line_of_sight import is_hidden_by_obstacles, is_hidden_by_robot
from .sensing import Sensing
from .sensor_equations import in_sectors, turned_towards


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

    @property
    def over_lanes(self) -> bool:
        """Whether range, field of view or chance change the rows of neighbours."""
        limited = math.isfinite(self.reach) or self.half_field < math.pi
        return limited or max(self.noise, self.bias, self.dropout) > 0.0

    @property
    def one_by_one(self) -> bool:
        """Whether anything else does, that looks at one team at a time."""
        return self.obstacles_hide or self.robots_hide or self.error > 0.0 or self.sectors > 0


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
def neighbour_seen(pair, row, frame, sensor, places, scene):
    """What robot i makes of the row of its neighbour j, in sight and turned by chance; zero if
    something hides it.

    Args:
        pair: i and j.
        row: about a_ij g_ij in the frame of robot i, a pair or triple, m/s; zero if it is missing.
        frame: of robot i, row by row.
        sensor: Imperfections.
        places: positions (n, d), m, and where each robot raises the hull's perimeter most (n, d).
        scene: obstacles of the team, who is part of whom (n,), radius of robots that hide, m.
    """
    (i, j), (positions, outward) = pair, places
    offset = subtract(load(positions[j]), load(positions[i]))
    if (sensor.obstacles_hide or sensor.robots_hide) and _is_hidden(
        pair, offset, sensor, scene[0], scene[1], scene[2], positions
    ):
        return _like(row, ORIGIN)
    if sensor.error > 0.0:
        row = turned_towards(row, sensor.error, to_local(frame, _like(row, load(outward[i]))))
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
def _like(row, v):
    """A triple as a pair in the plane, where rows are pairs."""
    if len(row) == 2:
        return v[0], v[1]
    return v
