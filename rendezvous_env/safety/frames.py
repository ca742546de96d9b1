"""Observation frames with x along the net bearing f, for rotation equivariance (theory 7)."""

import numpy as np

from ..compilation import inner_kernel, kernel
from ..engine.memory import read, write
from ..physics.neighbour_rows import net_bearing_of
from ..physics.vectors import cross, dot, load, load_pair, split, store, without
from .robot_lanes import LANES, keep_sums, lanes_of, sum_rows, weigh_rows

FRAMES = ("net_bearing", "local")
_1, _2, _3, _4, _5, _6, _7 = map(np.uint64, range(1, 8))
"""Unsigned, so that the compiler has no negative index to handle and finds adjacent numbers."""
_NEARLY_ALONG = 1e-6
"""Minimum component of a row across f that may define the second axis of a frame, m/s."""
_CLEARLY_LONGER = 1.001
"""Minimum ratio for a row to replace another, so that rounding does not choose between ties."""


@kernel
def look_along_net_bearing(axes, robots, robot, arrays, work):
    """Rotate observations (B, n, rows, d), m/s, into frames with x along f (theory 7).

        row ← Fᵀ row,   F = (f/‖f‖, …)

    Where ‖f‖ < δ the last frame is kept. In the plane f is stored for ``recall_sums``, if wanted.
    """
    observations, frames, seen = arrays
    if len(axes) == 2:
        size, wide = 2 * observations.shape[1], 2 * seen.shape[1]  # numbers of a robot
        numbers, shown = observations.reshape(-1), seen.reshape(-1)
        for first in range(robots[0], robots[1], LANES):
            stop = min(first + LANES, robots[1])
            _aim_in_plane(axes, observations, robot, frames, first, stop, work)
            rows, into = numbers[first * size : stop * size], shown[first * wide : stop * wide]
            _turn_in_plane(rows, frames[first:stop], size, into, wide)
    else:
        for i in range(robots[0], robots[1]):
            _aim_in_space(observations[i], robot, frames[i])
            x, y, z = load(frames[i, :, 0]), load(frames[i, :, 1]), load(frames[i, :, 2])
            for row in range(observations.shape[1]):
                v = load(observations[i, row])
                store((0.0 + dot(x, v), 0.0 + dot(y, v), 0.0 + dot(z, v)), seen[i, row])


@inner_kernel(slp=True)
def _turn_in_plane(numbers, frames, size, shown, wide):
    """Rows ← Fᵀ row of robots, flat, ``size`` numbers of each, in their frames (N, 2, 2).

    ``shown`` has ``wide`` numbers of each robot: one row more with a stored level. Four rows at a
    time become SIMD; the last four of a robot may repeat some of its rows.
    """
    for i in range(len(frames)):
        x, y = load_pair(frames[i, :, 0]), load_pair(frames[i, :, 1])
        begin, last = i * size, (i + 1) * size - 8
        skipped = np.uint64(i * (wide - size))
        if size >= 8:
            for k in range(begin, last + 8, 8):
                _turn_four(numbers, x, y, np.uint64(min(k, last)), shown, skipped)
        else:
            for k in range(begin, begin + size, 2):
                at, to = np.uint64(k), np.uint64(k) + skipped
                shown[to], shown[to + _1] = _turned(numbers[at], numbers[at + _1], x, y)


@inner_kernel(inline="code")
def _turn_four(numbers, x, y, k, shown, skipped):
    """Turn four rows from number k on; all are read before any is written, ``skipped`` later."""
    one = _turned(numbers[k], numbers[k + _1], x, y)
    two = _turned(numbers[k + _2], numbers[k + _3], x, y)
    three = _turned(numbers[k + _4], numbers[k + _5], x, y)
    four = _turned(numbers[k + _6], numbers[k + _7], x, y)
    to = k + skipped
    shown[to], shown[to + _1] = one
    shown[to + _2], shown[to + _3] = two
    shown[to + _4], shown[to + _5] = three
    shown[to + _6], shown[to + _7] = four


@inner_kernel(inline="code")
def _turned(along, across, x, y):
    """A row of float32 in a frame with axes x and y, a pair of float32."""
    v = np.float64(along), np.float64(across)
    return np.float32(0.0 + dot(x, v)), np.float32(0.0 + dot(y, v))  # 0.0: never −0.0


@inner_kernel(inline="code")
def _aim_in_plane(axes, observations, robot, frames, first, stop, work):
    """Right-handed planar frames with x along f; columns are axes in the local frame."""
    numbers, room, sums = work
    if numbers.shape[1] != LANES:  # always true; tells the compiler the row stride
        return
    lanes = lanes_of(numbers)
    rows, slots = observations[first:stop], robot.neighbour_slots
    if len(sums) == 3 and sums.shape[1] > 0:
        weigh_rows(axes, rows, slots, room, lanes.f, lanes.degree)
    else:
        sum_rows(axes, rows, slots, lanes.f)
    if sums.shape[1] > 0:
        keep_sums(lanes, first, stop, sums)
    for lane in range(LANES):
        strength, towards = split(read(lanes.f, lane, axes))
        write(towards, lanes.heading, lane)
        lanes.level[lane] = strength
    turned = frames[first:stop]
    for lane in range(len(turned)):
        if lanes.level[lane] >= robot.gate.dead_zone:
            x, y = lanes.heading[0, lane], lanes.heading[1, lane]
            turned[lane, 0, 0], turned[lane, 0, 1] = x, 0.0 - y
            turned[lane, 1, 0], turned[lane, 1, 1] = y, x


@inner_kernel(inline="code")
def _aim_in_space(rows, robot, frame):
    """Right-handed 3-D frame with x along f; columns are axes in the local frame.

    y is the longest component across x of any row (the first of ties), or of a local axis.
    """
    strength, towards = split(net_bearing_of(rows, robot.neighbour_slots))
    if strength < robot.gate.dead_zone:
        return
    store(towards, frame[:, 0])
    longest, across = _NEARLY_ALONG, (0.0, 0.0, 0.0)
    for k in range(robot.gravity_row):  # of neighbours and obstacles
        length, direction = split(without(load(rows[k]), towards))
        if length > _CLEARLY_LONGER * longest + _NEARLY_ALONG:
            longest, across = length, direction
    if longest == _NEARLY_ALONG:
        axis = (1.0, 0.0, 0.0) if abs(towards[0]) < 0.9 else (0.0, 1.0, 0.0)
        _, across = split(without(axis, towards))
    store(across, frame[:, 1])
    store(cross(towards, across), frame[:, 2])
