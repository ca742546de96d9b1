"""What one robot is shown, made from what it sees and remembers: kernels over robots.

Everything is written in the frame with x along f.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import kernel
from rendezvous_env.physics.neighbour_rows import degree_of, net_bearing_of
from rendezvous_env.physics.vectors import X_AXIS, load, scaled
from rendezvous_env.safety.heading import scale_of_step

from ..obstacle_rules.merged_silhouettes_2d import TWO_PI, joined_interval_2d
from .wall_memory import show_wall

NEIGHBOUR_COLUMNS = 3
"""Unit bearing x, y; gain a_ij, m/s."""
OBSTACLE_COLUMNS = 6
"""Counter-clockwise edge x, y; clockwise edge x, y; how fast each turns, rad/s."""
CONTEXT_COLUMNS = 22
"""‖f‖/D; ‖f‖, m/s, at most 2; 1/number of neighbours; time since the start, min, and how fresh it
is; own velocity and direction of f, averaged over a short and a long time, x, y each; how fast f
turns, rad/s; the carried heading, x, y; of the silhouettes joined before f whether they leave
nothing free, whether any is seen, both edges and the gaps beyond them, rad."""
FASTEST = 3.0
"""Turn rates are cut off here, rad/s."""
SHORT, LONG = 1.0, 5.0
"""Times over which is averaged, s."""
_FRESH = 8.0  # s
BLOCKED = 16
"""Of the context: whether the joined silhouettes leave nothing free; then, whether any is seen."""


class Memory(NamedTuple):
    """What robots remember from decision to decision, in their local frames."""

    edges: NDArray[np.float64]
    """(B, n, M, 2, 2), edges of obstacles at the last decision; zero where none was seen."""
    towards: NDArray[np.float64]
    """(B, n, 2), direction of f then; zero before the first decision."""
    averages: NDArray[np.float64]
    """(B, n, 4, 2), of the velocity over SHORT and LONG, of the direction of f over both."""
    time: NDArray[np.float64]
    """(B, n), s from the first decision to the last."""


class Constants(NamedTuple):
    """What the kernels need to know of a scenario."""

    neighbour_slots: int
    context: int
    """Number of columns before the context."""
    merge_radius: float
    duration: float
    speed_limit: float


@kernel
def law_velocity(f, degree, h, constants):
    """With what velocity law (4) drives a robot along its heading (2,), a triple, m/s."""
    speed = h[0] * f[0] + h[1] * f[1]
    speed *= scale_of_step(degree, constants.merge_radius, constants.duration)
    speed = min(max(speed, -constants.speed_limit), constants.speed_limit)
    return speed * h[0], speed * h[1], 0.0


@kernel
def _velocity(robot, velocities, f, degree, heading, constants):
    """That of a robot, or where there are none that of law (4)."""
    if velocities is None:
        return law_velocity(f, degree, heading, constants)
    return load(velocities[robot])


@kernel
def show(part, which, observations, moving, constants, memory, tanks, shown):
    """Fill the rows of ``shown`` (B, n, size) that belong to some teams, and bring their memory up
    to date.

    Args:
        part: which of these teams, from the first to the one before the second.
        which: teams, and how many s they have not decided for, (B,).
        observations: (B, n, rows, 2).
        moving: headings and velocities as in ``Features.see``, None being those of law (4).
        constants: Constants.
        memory: Memory, and room for the intervals of silhouettes, (M, 2).
        tanks: levels as in ``Features.see`` and Walls, either may be None.
        shown: see above.
    """
    (teams, elapsed), (memory, intervals), (headings, velocities) = which, memory, moving
    for k in range(part[0], part[1]):
        team = teams[k]
        time = elapsed[team]
        kept = math.exp(-time / SHORT), math.exp(-time / LONG)
        for i in range(observations.shape[1]):
            rows, out, h = observations[team, i], shown[team, i], headings[team, i]
            out[:] = 0.0
            count = _count(rows, constants.neighbour_slots)
            if count == 0:
                continue
            f = net_bearing_of(rows, constants.neighbour_slots)
            degree = degree_of(rows, constants.neighbour_slots)
            strength = math.sqrt(f[0] * f[0] + f[1] * f[1])
            u = (f[0] / strength, f[1] / strength, 0.0) if strength > 0.0 else X_AXIS
            velocity = _velocity((team, i), velocities, f, degree, h, constants)
            context = out[constants.context :]
            context[0], context[1] = strength / degree, min(strength, 2.0)
            context[2] = 1.0 / count
            _show_neighbours(rows, u, constants, out)
            _show_obstacles(rows, u, memory.edges[team, i], time, constants, out)
            _show_motion((team, i), u, (h, velocity), (time, kept), memory, context[3:16])
            K, M = constants.neighbour_slots, intervals.shape[0]
            silhouettes = rows[K : K + 2 * M].reshape((M, 2, 2))
            _show_joined(joined_interval_2d(u, silhouettes, intervals), context[16:])
            towards = scaled(u, 1.0 if strength > 0.0 else 0.0)
            _show_tank((team, i), towards, (h, velocity), time, tanks[0], tanks[1], context)


@kernel
def _count(rows, neighbour_slots):
    """How many neighbours there are."""
    count = 0
    for k in range(neighbour_slots):
        if rows[k, 0] != 0.0 or rows[k, 1] != 0.0:
            count += 1
    return count


@kernel
def _along(vector, u, out):
    """Write a vector in the frame with x along u."""
    out[0] = vector[0] * u[0] + vector[1] * u[1]
    out[1] = vector[1] * u[0] - vector[0] * u[1]


@kernel
def _turn_rate(before, now, time):
    """From one direction to another, rad/s counter-clockwise, cut off at FASTEST."""
    across = before[0] * now[1] - before[1] * now[0]
    rate = math.atan2(across, before[0] * now[0] + before[1] * now[1]) / time
    return min(max(rate, -FASTEST), FASTEST)


@kernel
def _show_neighbours(rows, u, constants, out):
    for k in range(constants.neighbour_slots):
        gain = math.sqrt(np.float64(rows[k, 0]) ** 2 + np.float64(rows[k, 1]) ** 2)
        if gain > 0.0:
            place = out[k * NEIGHBOUR_COLUMNS : (k + 1) * NEIGHBOUR_COLUMNS]
            _along((rows[k, 0] / gain, rows[k, 1] / gain), u, place)
            place[2] = gain


@kernel
def _show_obstacles(rows, u, before, time, constants, out):
    """Write both edges of each obstacle and how fast they turned since the last decision, of which
    ``before`` (M, 2, 2) are the edges.
    """
    for m in range(before.shape[0]):
        row, column = constants.neighbour_slots + 2 * m, m * OBSTACLE_COLUMNS
        column += constants.neighbour_slots * NEIGHBOUR_COLUMNS
        known = before[m, 0, 0] != 0.0 or before[m, 0, 1] != 0.0
        if rows[row, 0] == 0.0 and rows[row, 1] == 0.0:
            if known:
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
    out[0] = memory.time[robot] / 60.0
    out[1] = math.exp(-memory.time[robot] / _FRESH)
    for k in range(4):
        _along(averages[k], u, out[2 + 2 * k : 4 + 2 * k])
    if not first:
        out[10] = _turn_rate(towards, u, time)
    _along(heading, u, out[11:13])
    towards[0], towards[1] = u[0], u[1]


@kernel
def _show_joined(joined, out):
    """Write the interval of silhouettes before f."""
    low, high, gap_below, gap_above = joined
    if high < low:
        return
    if high - low >= TWO_PI:
        out[0] = 1.0
        return
    out[1], out[2], out[3], out[4], out[5] = 1.0, high, low, gap_above, gap_below


@kernel
def _show_tank(robot, u, moving, time, levels, walls, context):
    """Write what a tank adds to the context: its level, and what is remembered of a wall."""
    if levels is not None:
        context[CONTEXT_COLUMNS] = math.log1p(levels[robot])
    if walls is not None:
        blocked = context[BLOCKED] != 0.0 or context[BLOCKED + 1] != 0.0
        seen = blocked, math.log1p(levels[robot])
        show_wall(robot, u, moving, time, seen, walls, context[CONTEXT_COLUMNS + 1 :])
