"""What a robot with a tank remembers of the wall that it is at, and is shown of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import kernel

Array = NDArray[np.float64]
WALL_COLUMNS = 12
"""Whether at a wall; log(1 + A/(r D̄)) when it was met; time at it, and how fresh it is; by how much
f and the heading have turned since, half turns; cos and sin of the angle last chosen; velocity and
direction of f, averaged over a long time, along and across f each."""
_LEFT = 2.0
"""Time without a wall before f after which it is left behind, s."""
_LONG = 20.0
"""Over which velocity and direction of f are averaged, s."""
_FRESH, _SLOW = 8.0, 30.0
"""Units of the time at a wall, s."""


class Walls(NamedTuple):
    """What the robots of B teams remember of walls, (B, n, ...) each."""

    since: Array
    """s at the wall; 0 at none."""
    clear: Array
    """s for which nothing was before f."""
    level: Array
    """log(1 + A/(r D̄)) when it was met."""
    turned: Array
    """By how much f has turned since, rad."""
    wound: Array
    """And the heading."""
    angle: Array
    """Last chosen, rad."""
    towards: Array
    """(B, n, 2), f/‖f‖; zero before the first decision."""
    heading: Array
    averages: Array
    """(B, n, 2, 2), of velocity and direction of f."""


def no_walls(num_envs: int, n_robots: int) -> Walls:
    """Of robots that have met none."""
    robots = num_envs, n_robots
    shapes = [robots] * 6 + [(*robots, 2)] * 2 + [(*robots, 2, 2)]
    return Walls._make(np.zeros(shape) for shape in shapes)


@kernel
def show_wall(robot, towards, moving, elapsed, seen, walls, out):
    """Bring the memory of one robot up to date, and write WALL_COLUMNS numbers.

    Args:
        robot: its team and its index.
        towards: f/‖f‖, or any direction where there is no f.
        moving: its heading and its velocity, m/s.
        elapsed: since the decision before, s.
        seen: whether silhouettes are before f, and log(1 + A/(r D̄)).
        walls: Walls.
        out: see above.
    """
    (heading, velocity), (blocked, level) = moving, seen
    before, last, averages = walls.towards[robot], walls.heading[robot], walls.averages[robot]
    walls.clear[robot] = 0.0 if blocked else walls.clear[robot] + elapsed
    if walls.since[robot] > 0.0 and walls.clear[robot] <= _LEFT:
        walls.since[robot] += elapsed
        walls.turned[robot] += _turn(before, towards)
        walls.wound[robot] += _turn(last, heading)
    else:
        walls.since[robot] = elapsed if blocked else 0.0
        walls.level[robot] = level if blocked else 0.0
        walls.turned[robot] = walls.wound[robot] = 0.0
    known, kept = before[0] != 0.0 or before[1] != 0.0, math.exp(-elapsed / _LONG)
    for axis in range(2):
        if not known:
            averages[0, axis], averages[1, axis] = 0.0, towards[axis]
        averages[0, axis] = kept * averages[0, axis] + (1.0 - kept) * velocity[axis]
        averages[1, axis] = kept * averages[1, axis] + (1.0 - kept) * towards[axis]
        before[axis], last[axis] = towards[axis], heading[axis]
    since = walls.since[robot]
    out[0], out[1], out[2] = 1.0 if since > 0.0 else 0.0, walls.level[robot], since / _SLOW
    out[3] = math.exp(-since / _FRESH) if since > 0.0 else 0.0
    out[4], out[5] = walls.turned[robot] / math.pi, walls.wound[robot] / math.pi
    out[6], out[7] = math.cos(walls.angle[robot]), math.sin(walls.angle[robot])
    for k in range(2):
        x, y = averages[k, 0], averages[k, 1]
        out[8 + 2 * k] = x * towards[0] + y * towards[1]
        out[9 + 2 * k] = y * towards[0] - x * towards[1]


@kernel
def _turn(before, now):
    """From one vector to another, rad counter-clockwise in (−π, π]; 0 where one is zero."""
    across = before[0] * now[1] - before[1] * now[0]
    ahead = 0.0 + before[0] * now[0] + before[1] * now[1]  # 0.0: never −0.0, half a turn
    return math.atan2(across, ahead)
