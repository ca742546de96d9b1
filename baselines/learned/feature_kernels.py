"""Kernels that compute features from observations and memory, in the frame with x along f."""

import math

import numpy as np

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.physics.neighbour_rows import degree_of, net_bearing_of
from rendezvous_env.physics.vectors import X_AXIS
from rendezvous_env.safety.heading import scale_of_step

from ..obstacle_rules.merged_intervals_2d import TWO_PI, interval_around, merged_interval
from ..obstacle_rules.obstacle_edges import list_seen

NEIGHBOUR_COLUMNS = 3
"""Number of features of a neighbour: unit bearing x, y; edge weight a_ij, m/s."""
OBSTACLE_COLUMNS = 6
"""Number of features of an obstacle.

Counter-clockwise edge x, y; clockwise edge x, y; rotation rate of each edge, rad/s."""
CONTEXT_COLUMNS = 22
"""Number of context features.

‖f‖/D; ‖f‖, m/s, at most 2; 1/number of neighbours. Time since the first decision, min, and its
recency. Own velocity and direction of f, each averaged over a short and a long time, x, y each.
Turn rate of f, rad/s; carried heading, x, y. Of the merged interval in the direction of f: whether
it covers all directions, whether it exists, both edges and the gaps beyond them, rad."""
LEVEL_COLUMNS = 1
"""Number of features with a tank, after the context: log(1 + A/(r D̄)).

With a memory of walls, WALL_COLUMNS follow."""
WALL_COLUMNS = 12
"""Number of features of the memory of walls.

Whether at a wall; log(1 + A/(r D̄)) on reaching it; time at it, and its recency. Rotation of f and
of the heading since, half turns; cos and sin of the angle chosen last. Velocity and direction of f,
averaged over a long time, each along and across f."""
_FASTEST = 3.0  # rad/s; bound of rotation rates
_SHORT, _LONG, _LONG_AT_WALLS = 1.0, 5.0, 20.0  # averaging times, s
_FRESH = 8.0  # s
_SLOW = 30.0  # s; unit of the time at a wall
_LEFT = 2.0  # s without a wall in the direction of f after which the wall is forgotten
_BLOCKED = 16
"""Context columns: whether merged intervals cover all directions; whether one exists."""


MEMORY = {"time": (1,), "towards": (2,), "averages": (4, 2)}
"""Memory of a robot between decisions, in its local frame.

Time since its first decision, s; direction of f at the last one, zero before the first. Averages
over a short and a long time of its velocity and of the direction of f."""
_TOWARDS, _AVERAGES = 1, 3
WALLS = {
    **{name: (1,) for name in ("since", "clear", "level", "turned", "wound", "angle")},
    **{"towards": (2,), "heading": (2,), "averages": (2, 2)},
}
"""Memory of a robot with a tank about the current wall.

Time at it, s, 0 without a wall; time without an obstacle in the direction of f, s; log(1 + A/(r
D̄)) on reaching it. Rotation of f and of the heading since, rad; the angle chosen last, rad. f/‖f‖,
zero before the first decision, and the heading; averages of velocity and direction of f."""
_SINCE, _CLEAR, _LEVEL, _TURNED, _WOUND, _ANGLE, _WALL_F, _HEADING, _WALL_AVERAGES = (
    *range(7), 8, 10,
)  # fmt: skip


@inner_kernel
def _velocity(given, f, degree, h, robot):
    """Velocity of a robot, (2,), m/s; by default that of law (4) along its heading (2,)."""
    if len(given) > 0:
        return given[0], given[1]
    speed = h[0] * f[0] + h[1] * f[1]
    speed *= scale_of_step(degree, robot.merge_radius, robot.gate.duration)
    speed = min(max(speed, -robot.speed_limit), robot.speed_limit)
    return speed * h[0], speed * h[1]


@kernel(unroll=False)
def show(part, which, seen, moving, known, memory, tanks, shown):
    """Fill the feature rows (B, n, size) of some environments, and update their memory.

    ``seen`` are observations (B, n, rows, 2) and their pairs of float32 as int64, (B, n, rows, 1).

    ``which`` are environments and the s since their last decision, (B,); ``part`` is a range of
    these. ``moving`` are headings and velocities, (B, n, 2), or (B, n, 0). ``tanks`` are stored
    energies (B, n, 1) or (B, n, 0), and the memory of walls, (B, n, 14) or (B, n, 0). ``known`` are
    a Robot and the number of columns before the context. ``memory`` consists of the edges at the
    last decision, (B, n, M, 2, 2), zero if not visible, and of MEMORY, (B, n, 11). Its last part is
    working memory, (M, 2) and (M + 1,).
    """
    (teams, elapsed), (edges, memories, room), (headings, velocities) = which, memory, moving
    (observations, bits), (intervals, listed) = seen, room
    (robot, before_context), (levels, walls) = known, tanks
    K, M = robot.neighbour_slots, intervals.shape[0]
    for k in range(part[0], part[1]):
        team = teams[k]
        time = elapsed[team]
        kept = math.exp(-time / _SHORT), math.exp(-time / _LONG)
        for i in range(observations.shape[1]):
            rows, out, h = observations[team, i], shown[team, i], headings[team, i]
            out[:], count = 0.0, 0
            for slot in range(K):
                count += rows[slot, 0] != 0.0 or rows[slot, 1] != 0.0
            if count == 0:
                continue
            f, degree = net_bearing_of(rows, K), degree_of(rows, K)
            strength = math.sqrt(f[0] * f[0] + f[1] * f[1])
            u = (f[0] / strength, f[1] / strength, 0.0) if strength > 0.0 else X_AXIS
            velocity = _velocity(velocities[team, i], f, degree, h, robot)
            heading, context = (h[0], h[1]), out[before_context:]
            context[0], context[1] = strength / degree, min(strength, 2.0)
            context[2] = 1.0 / count
            _show_neighbours(rows, u, K, out)
            visible = listed[: list_seen(bits[team, i], K, M, listed)]
            _show_obstacles(rows, u, edges[team, i], time, visible, K, out)
            _show_motion(memories[team, i], u, heading, velocity, time, kept, context[3:16])
            for m in range(len(visible)):
                interval_around(u, rows[visible[m] : visible[m] + 2], intervals[m])
            _show_merged(merged_interval(intervals[: len(visible)]), context[_BLOCKED:])
            if levels.shape[2] > 0:
                level = math.log1p(levels[team, i, 0])
                context[CONTEXT_COLUMNS] = level
                if walls.shape[2] > 0:
                    blocked = context[_BLOCKED] != 0.0 or context[_BLOCKED + 1] != 0.0
                    sure = 1.0 if strength > 0.0 else 0.0
                    f_now, wall = (sure * u[0], sure * u[1]), context[CONTEXT_COLUMNS + 1 :]
                    _update_wall(walls[team, i], f_now, heading, velocity, time, (blocked, level))
                    _show_wall(walls[team, i], f_now, wall)


@inner_kernel
def _along(x, y, u, out):
    """Write a vector (x, y) in the frame with x along u."""
    out[0] = x * u[0] + y * u[1]
    out[1] = y * u[0] - x * u[1]


@inner_kernel
def _turn(before, now):
    """Angle between two pairs, rad counter-clockwise in (−π, π]; 0 if one is zero."""
    across = before[0] * now[1] - before[1] * now[0]
    ahead = 0.0 + before[0] * now[0] + before[1] * now[1]  # 0.0: never −0.0, half a turn
    return math.atan2(across, ahead)


@inner_kernel
def _turn_rate(before, now, time):
    """Rotation rate between two directions, rad/s counter-clockwise, clipped."""
    return min(max(_turn(before, now) / time, -_FASTEST), _FASTEST)


@inner_kernel
def _show_neighbours(rows, u, neighbour_slots, out):
    for k in range(neighbour_slots):
        gain = math.sqrt(np.float64(rows[k, 0]) ** 2 + np.float64(rows[k, 1]) ** 2)
        if gain > 0.0:
            place = out[k * NEIGHBOUR_COLUMNS : (k + 1) * NEIGHBOUR_COLUMNS]
            _along(rows[k, 0] / gain, rows[k, 1] / gain, u, place)
            place[2] = gain


@inner_kernel
def _show_obstacles(rows, u, before, time, visible, neighbour_slots, out):
    """Write both edges of each obstacle, and their rotation rates since ``before``, (M, 2, 2).

    Obstacles whose first rows are ``visible`` are stored there for the next decision, others as 0.
    """
    for row in visible:
        m = (row - neighbour_slots) // 2
        column = neighbour_slots * NEIGHBOUR_COLUMNS + m * OBSTACLE_COLUMNS
        known = before[m, 0, 0] != 0.0 or before[m, 0, 1] != 0.0
        for s in range(2):
            x, y, first = np.float64(rows[row + s, 0]), np.float64(rows[row + s, 1]), column + 2 * s
            _along(x, y, u, out[first : first + 2])
            if known:
                last = before[m, s, 0], before[m, s, 1]
                out[column + 4 + s] = _turn_rate(last, (x, y), time)
    before[:] = 0.0
    for row in visible:
        m = (row - neighbour_slots) // 2
        for s in range(2):
            before[m, s, 0], before[m, s, 1] = rows[row + s, 0], rows[row + s, 1]


@inner_kernel
def _show_motion(memory, u, heading, velocity, time, kept, out):
    """Write and store motion features: own velocity, turn rate of f, carried heading."""
    towards = memory[_TOWARDS], memory[_TOWARDS + 1]
    first = towards[0] == 0.0 and towards[1] == 0.0
    for axis in range(2):
        for k in range(4):
            now, place = velocity[axis] if k < 2 else u[axis], _AVERAGES + 2 * k + axis
            before = memory[place] if not first else (0.0 if k < 2 else now)
            memory[place] = kept[k % 2] * before + (1.0 - kept[k % 2]) * now
    if not first:
        memory[0] += time
        out[10] = _turn_rate(towards, (u[0], u[1]), time)
    out[0] = memory[0] / 60.0
    out[1] = math.exp(-memory[0] / _FRESH)
    for k in range(4):
        x, y = memory[_AVERAGES + 2 * k], memory[_AVERAGES + 2 * k + 1]
        _along(x, y, u, out[2 + 2 * k : 4 + 2 * k])
    _along(heading[0], heading[1], u, out[11:13])
    memory[_TOWARDS], memory[_TOWARDS + 1] = u[0], u[1]


@inner_kernel
def _show_merged(joined, out):
    """Write the merged interval in the direction of f."""
    low, high, gap_below, gap_above = joined
    if high - low >= TWO_PI:
        out[0] = 1.0
    elif not high < low:
        out[1], out[2], out[3], out[4], out[5] = 1.0, high, low, gap_above, gap_below


@inner_kernel
def _update_wall(wall, towards, heading, velocity, elapsed, seen):
    """Update a robot's memory of a wall, (14,).

    ``seen`` is whether a wall blocks f; the stored energy is log(1 + A/(r D̄)).
    """
    blocked, level = seen
    before, last = (wall[_WALL_F], wall[_WALL_F + 1]), (wall[_HEADING], wall[_HEADING + 1])
    wall[_CLEAR] = 0.0 if blocked else wall[_CLEAR] + elapsed
    if wall[_SINCE] > 0.0 and wall[_CLEAR] <= _LEFT:
        wall[_SINCE] += elapsed
        wall[_TURNED] += _turn(before, towards)
        wall[_WOUND] += _turn(last, heading)
    else:
        wall[_SINCE] = elapsed if blocked else 0.0
        wall[_LEVEL] = level if blocked else 0.0
        wall[_TURNED] = wall[_WOUND] = 0.0
    known, kept = before[0] != 0.0 or before[1] != 0.0, math.exp(-elapsed / _LONG_AT_WALLS)
    for axis in range(2):
        moved, along = _WALL_AVERAGES + axis, _WALL_AVERAGES + 2 + axis
        if not known:
            wall[moved], wall[along] = 0.0, towards[axis]
        wall[moved] = kept * wall[moved] + (1.0 - kept) * velocity[axis]
        wall[along] = kept * wall[along] + (1.0 - kept) * towards[axis]
        wall[_WALL_F + axis], wall[_HEADING + axis] = towards[axis], heading[axis]


@inner_kernel
def _show_wall(wall, towards, out):
    """Write a robot's memory of a wall."""
    since = wall[_SINCE]
    out[0], out[1], out[2] = 1.0 if since > 0.0 else 0.0, wall[_LEVEL], since / _SLOW
    out[3] = math.exp(-since / _FRESH) if since > 0.0 else 0.0
    out[4], out[5] = wall[_TURNED] / math.pi, wall[_WOUND] / math.pi
    out[6], out[7] = math.cos(wall[_ANGLE]), math.sin(wall[_ANGLE])
    for k in range(2):
        x, y = wall[_WALL_AVERAGES + 2 * k], wall[_WALL_AVERAGES + 2 * k + 1]
        _along(x, y, towards, out[8 + 2 * k : 10 + 2 * k])
