"""What one robot is shown, made from what it sees and remembers: kernels over robots.

Everything is written in the frame with x along f.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import kernel
from rendezvous_env.physics.neighbour_rows import degree_of, net_bearing_of
from rendezvous_env.safety.heading import scale_of_step

from ..obstacle_rules.merged_silhouettes_2d import TWO_PI, joined_interval_2d

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
def law_velocities(observations, headings, constants, velocities):
    """With what velocities law (4) drives robots along their headings, (B, n, 2) each, m/s."""
    K = constants.neighbour_slots
    for team in range(observations.shape[0]):
        for i in range(observations.shape[1]):
            rows, h = observations[team, i], headings[team, i]
            f, degree = net_bearing_of(rows, K), degree_of(rows, K)
            speed = h[0] * f[0] + h[1] * f[1]
            speed *= scale_of_step(degree, constants.merge_radius, constants.duration)
            speed = min(max(speed, -constants.speed_limit), constants.speed_limit)
            velocities[team, i, 0], velocities[team, i, 1] = speed * h[0], speed * h[1]


@kernel(allocates=True)
def show(teams, elapsed, observations, headings, velocities, constants, memory, shown):
    """Fill the rows of ``shown`` (B, n, size) that belong to teams, and bring their memory up to
    date; arguments as ``Features.see``.
    """
    K, M = constants.neighbour_slots, memory.edges.shape[2]
    intervals = np.empty((M, 2))
    for k in range(len(teams)):
        team = teams[k]
        for i in range(observations.shape[1]):
            rows, out = observations[team, i], shown[team, i]
            count = _count(rows[:K])
            if count == 0:
                continue
            f, degree = net_bearing_of(rows, K), degree_of(rows, K)
            strength = math.hypot(f[0], f[1])
            u = (f[0] / strength, f[1] / strength, 0.0) if strength > 0.0 else (1.0, 0.0, 0.0)
            _show_neighbours(rows[:K], u, out)
            for m in range(M):
                first = K * NEIGHBOUR_COLUMNS + m * OBSTACLE_COLUMNS
                edges, before = rows[K + 2 * m : K + 2 * m + 2], memory.edges[team, i, m]
                _show_obstacle(
                    edges, u, before, elapsed[team], out[first : first + OBSTACLE_COLUMNS]
                )
            context = out[constants.context :]
            context[0], context[1] = strength / degree, min(strength, 2.0)
            context[2] = 1.0 / count
            moving = headings[team, i], velocities[team, i]
            _show_motion(team, i, u, moving, elapsed[team], memory, context[3:16])
            silhouettes = rows[K : K + 2 * M].reshape((M, 2, 2))
            _show_joined(joined_interval_2d(u, silhouettes, intervals), context[16:])


@kernel
def _count(rows):
    """How many neighbours there are."""
    count = 0
    for k in range(rows.shape[0]):
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
def _show_neighbours(rows, u, out):
    for k in range(rows.shape[0]):
        gain = math.hypot(rows[k, 0], rows[k, 1])
        if gain > 0.0:
            place = out[k * NEIGHBOUR_COLUMNS : (k + 1) * NEIGHBOUR_COLUMNS]
            _along((rows[k, 0] / gain, rows[k, 1] / gain), u, place)
            place[2] = gain


@kernel
def _show_obstacle(edges, u, before, time, out):
    """Write both edges of an obstacle and how fast they turned since the last decision."""
    if edges[0, 0] == 0.0 and edges[0, 1] == 0.0:
        before[:] = 0.0
        return
    known = before[0, 0] != 0.0 or before[0, 1] != 0.0
    for s in range(2):
        _along(edges[s], u, out[2 * s : 2 * s + 2])
        if known:
            out[4 + s] = _turn_rate(before[s], edges[s], time)
        before[s, 0], before[s, 1] = edges[s, 0], edges[s, 1]


@kernel
def _show_motion(team, i, u, moving, elapsed, memory, out):
    """Write and remember what only time tells: own motion, turning of f, the carried heading."""
    heading, velocity = moving
    towards, averages = memory.towards[team, i], memory.averages[team, i]
    first = towards[0] == 0.0 and towards[1] == 0.0
    for axis in range(2):
        for k in range(4):
            now = velocity[axis] if k < 2 else u[axis]
            before = averages[k, axis] if not first else (0.0 if k < 2 else now)
            kept = math.exp(-elapsed / (SHORT if k % 2 == 0 else LONG))
            averages[k, axis] = kept * before + (1.0 - kept) * now
    if not first:
        memory.time[team, i] += elapsed
    out[0] = memory.time[team, i] / 60.0
    out[1] = math.exp(-memory.time[team, i] / _FRESH)
    for k in range(4):
        _along(averages[k], u, out[2 + 2 * k : 4 + 2 * k])
    if not first:
        out[10] = _turn_rate(towards, u, elapsed)
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
