"""What robots are shown, in the frame with x along f, made from what they see and remember."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import kernel
from rendezvous_env.physics.neighbour_rows import degree_of, net_bearing_of
from rendezvous_env.physics.vectors import X_AXIS, load, scaled
from rendezvous_env.safety.heading import scale_of_step

from ..obstacle_rules.merged_silhouettes_2d import TWO_PI, joined_interval_2d

Array = NDArray[np.float64]
NEIGHBOUR_COLUMNS = 3
"""Unit bearing x, y; gain a_ij, m/s."""
OBSTACLE_COLUMNS = 6
"""Counter-clockwise edge x, y; clockwise edge x, y; how fast each turns, rad/s."""
CONTEXT_COLUMNS = 22
"""‖f‖/D; ‖f‖, m/s, at most 2; 1/number of neighbours; time since the start, min, and how fresh it
is; own velocity and direction of f, averaged over a short and a long time, x, y each; how fast f
turns, rad/s; the carried heading, x, y; of the silhouettes joined before f whether they leave
nothing free, whether any is seen, both edges and the gaps beyond them, rad."""
LEVEL_COLUMNS = 1
"""After the context, with a tank: log(1 + A/(r D̄)). With a memory of walls WALL_COLUMNS follow."""
WALL_COLUMNS = 12
"""Whether at a wall; log(1 + A/(r D̄)) when it was met; time at it, and how fresh it is; by how much
f and the heading have turned since, half turns; cos and sin of the angle last chosen; velocity and
direction of f, averaged over a long time, along and across f each."""
_FASTEST = 3.0  # rad/s; turn rates are cut off here
_SHORT, _LONG, _LONG_AT_WALLS = 1.0, 5.0, 20.0  # s over which is averaged
_FRESH = 8.0  # s
_SLOW = 30.0  # s; unit of the time at a wall
_LEFT = 2.0  # s without a wall before f after which it is left behind
_BLOCKED = 16
"""Of the context: whether the joined silhouettes leave nothing free; then, whether any is seen."""


class Memory(NamedTuple):
    """What robots remember from decision to decision, in their local frames, (B, n, ...)."""

    edges: Array  # (M, 2, 2), of obstacles at the last decision; zero where none was seen
    towards: Array  # (2,), direction of f then; zero before the first decision
    averages: Array  # (4, 2), of the velocity over a short and a long time, and of f's direction
    time: Array  # s from the first decision to the last


class Walls(NamedTuple):
    """What robots with a tank remember of the wall that they are at, (B, n, ...)."""

    since: Array  # s at the wall; 0 at none
    clear: Array  # s for which nothing was before f
    level: Array  # log(1 + A/(r D̄)) when it was met
    turned: Array  # by how much f has turned since, rad
    wound: Array  # and the heading
    angle: Array  # last chosen, rad
    towards: Array  # (2,), f/‖f‖; zero before the first decision
    heading: Array  # (2,)
    averages: Array  # (2, 2), of velocity and direction of f


@kernel
def _velocity(place, velocities, f, degree, h, robot):
    """That of a robot, a triple, m/s, or where there are none law (4)'s along its heading (2,)."""
    if velocities is not None:
        return load(velocities[place])
    speed = h[0] * f[0] + h[1] * f[1]
    speed *= scale_of_step(degree, robot.merge_radius, robot.gate.duration)
    speed = min(max(speed, -robot.speed_limit), robot.speed_limit)
    return speed * h[0], speed * h[1], 0.0


@kernel
def show(part, which, observations, moving, known, memory, tanks, shown):
    """Fill the rows of ``shown`` (B, n, size) of some teams, and update their memory.

    ``which`` are teams and the s since they decided, (B,), ``part`` a range of these; ``moving``
    headings and velocities, ``tanks`` levels or None, as in ``Features.see``, and Walls or None.
    ``known`` are a Robot and the number of columns before the context. With the memory comes
    working memory for intervals, (M, 2).
    """
    (teams, elapsed), (memory, intervals), (headings, velocities) = which, memory, moving
    robot, before_context = known
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
            velocity = _velocity((team, i), velocities, f, degree, h, robot)
            context = out[before_context:]
            context[0], context[1] = strength / degree, min(strength, 2.0)
            context[2] = 1.0 / count
            _show_neighbours(rows, u, K, out)
            _show_obstacles(rows, u, memory.edges[team, i], time, K, out)
            _show_motion((team, i), u, (h, velocity), (time, kept), memory, context[3:16])
            silhouettes = rows[K : K + 2 * M].reshape((M, 2, 2))
            _show_joined(joined_interval_2d(u, silhouettes, intervals), context[_BLOCKED:])
            towards = scaled(u, 1.0 if strength > 0.0 else 0.0)
            _show_tank((team, i), towards, (h, velocity), time, tanks[0], tanks[1], context)


@kernel
def _along(vector, u, out):
    """Write a vector in the frame with x along u."""
    out[0] = vector[0] * u[0] + vector[1] * u[1]
    out[1] = vector[1] * u[0] - vector[0] * u[1]


@kernel
def _turn(before, now):
    """From one vector to another, rad counter-clockwise in (−π, π]; 0 where one is zero."""
    across = before[0] * now[1] - before[1] * now[0]
    ahead = 0.0 + before[0] * now[0] + before[1] * now[1]  # 0.0: never −0.0, half a turn
    return math.atan2(across, ahead)


@kernel
def _turn_rate(before, now, time):
    """From one direction to another, rad/s counter-clockwise, cut off."""
    return min(max(_turn(before, now) / time, -_FASTEST), _FASTEST)


@kernel
def _show_neighbours(rows, u, neighbour_slots, out):
    for k in range(neighbour_slots):
        gain = math.sqrt(np.float64(rows[k, 0]) ** 2 + np.float64(rows[k, 1]) ** 2)
        if gain > 0.0:
            place = out[k * NEIGHBOUR_COLUMNS : (k + 1) * NEIGHBOUR_COLUMNS]
            _along((rows[k, 0] / gain, rows[k, 1] / gain), u, place)
            place[2] = gain


@kernel
def _show_obstacles(rows, u, before, time, neighbour_slots, out):
    """Write both edges of each obstacle, and how fast they turned since ``before``, (M, 2, 2)."""
    for m in range(before.shape[0]):
        row, column = neighbour_slots + 2 * m, m * OBSTACLE_COLUMNS
        column += neighbour_slots * NEIGHBOUR_COLUMNS
        known = before[m, 0, 0] != 0.0 or before[m, 0, 1] != 0.0
        if rows[row, 0] == 0.0 and rows[row, 1] == 0.0:
            before[m, :] = 0.0
            continue
        for s in range(2):
            edge, first = rows[row + s], column + 2 * s
            _along(edge, u, out[first : first + 2])
            if known:
                out[column + 4 + s] = _turn_rate(before[m, s], edge, time)
            before[m, s, 0], before[m, s, 1] = edge[0], edge[1]


@kernel
def _show_motion(robot, u, moving, elapsed, memory, out):
    """Write and remember what only time tells: own motion, turning of f, the carried heading."""
    (heading, velocity), (time, kept) = moving, elapsed
    towards, averages = memory.towards[robot], memory.averages[robot]
    first = towards[0] == 0.0 and towards[1] == 0.0
    for axis in range(2):
        for k in range(4):
            now = velocity[axis] if k < 2 else u[axis]
            before = averages[k, axis] if not first else (0.0 if k < 2 else now)
            averages[k, axis] = kept[k % 2] * before + (1.0 - kept[k % 2]) * now
    if not first:
        memory.time[robot] += time
        out[10] = _turn_rate(towards, u, time)
    out[0] = memory.time[robot] / 60.0
    out[1] = math.exp(-memory.time[robot] / _FRESH)
    for k in range(4):
        _along(averages[k], u, out[2 + 2 * k : 4 + 2 * k])
    _along(heading, u, out[11:13])
    towards[0], towards[1] = u[0], u[1]


@kernel
def _show_joined(joined, out):
    """Write the interval of silhouettes before f."""
    low, high, gap_below, gap_above = joined
    if high - low >= TWO_PI:
        out[0] = 1.0
    elif not high < low:
        out[1], out[2], out[3], out[4], out[5] = 1.0, high, low, gap_above, gap_below


@kernel
def _show_tank(robot, towards, moving, time, levels, walls, context):
    """Write what a tank adds to the context: its level, and what is remembered of a wall."""
    if levels is not None:
        context[CONTEXT_COLUMNS] = math.log1p(levels[robot])
    if walls is not None:
        blocked = context[_BLOCKED] != 0.0 or context[_BLOCKED + 1] != 0.0
        seen = blocked, math.log1p(levels[robot])
        _show_wall(robot, towards, moving, time, seen, walls, context[CONTEXT_COLUMNS + 1 :])


@kernel
def _show_wall(robot, towards, moving, elapsed, seen, walls, out):
    """Update and write what a robot remembers of a wall."""
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
    known, kept = before[0] != 0.0 or before[1] != 0.0, math.exp(-elapsed / _LONG_AT_WALLS)
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
        _along(averages[k], towards, out[8 + 2 * k : 10 + 2 * k])
