"""Stages that write observations: rows of all lanes, and the proprioceptive row."""

import numpy as np

from ...compilation import inner_kernel, kernel
from ...robots.motion import constants_of_robot, proprioception
from ..memory import lane_count, load_fields

_MANY_ROWS = 256  # rows that, with those of the other lanes, exceed the L1 cache


@kernel
def write_observations(width, axes, first, last, rows, observations):
    """Copy rows, (blocks, n, rows, L·d), to observations, (B, n, rows, d)."""
    if len(axes) == 2:  # copy both numbers of a row at once
        _copy_rows(width, 1, first, last, rows.view(np.float64), observations.view(np.float64))
    else:
        _copy_rows(width, 3, first, last, rows, observations)


@inner_kernel(inline="code")
def _copy_rows(width, parts, first, last, rows, observations):
    lanes, n_rows = lane_count(width), rows.shape[1] * rows.shape[2]
    source = rows.reshape(rows.shape[0], n_rows, rows.shape[3])
    target = observations.reshape(observations.shape[0], n_rows * parts)
    for block in range(first, last):
        start = block * lanes
        some = target[start : start + lanes]
        if n_rows < _MANY_ROWS:
            _copy_four(source[block - first], some, parts)
        else:
            _copy_together(source[block - first], some, parts, 32)


@inner_kernel(inline="code")
def _copy_four(source, target, parts):
    """Copy four adjacent rows of a lane at a time, written out, and the remaining ones."""
    whole = len(source) - len(source) % 4
    for k in range(0, whole, 4):
        one, two, three, four = source[k], source[k + 1], source[k + 2], source[k + 3]
        for lane in range(len(target)):
            out = target[lane]
            for part in range(parts):
                own = lane * parts + part
                out[k * parts + part] = one[own]
                out[(k + 1) * parts + part] = two[own]
                out[(k + 2) * parts + part] = three[own]
                out[(k + 3) * parts + part] = four[own]
    _copy_singly(whole, source, target, parts)


@inner_kernel(inline="code")
def _copy_together(source, target, parts, count):
    """Copy several adjacent rows of a lane at a time, and the remaining ones individually."""
    whole = len(source) - len(source) % count
    for k in range(0, whole, count):
        for lane in range(len(target)):
            for row in range(k, k + count):
                for part in range(parts):
                    target[lane, row * parts + part] = source[row, lane * parts + part]
    _copy_singly(whole, source, target, parts)


@inner_kernel(inline="code")
def _copy_singly(first, source, target, parts):
    """Copy the rows from ``first`` on, one after another."""
    for row in range(first, len(source)):
        for lane in range(len(target)):
            for part in range(parts):
                target[lane, row * parts + part] = source[row, lane * parts + part]


@kernel
def write_packed(lanes, first, last, slots, links, rows, counts, observations, over):
    """Copy rows if there are fewer neighbour rows, ``slots``, than other robots.

    Rows of present neighbours come first, in index order, followed by the other rows. ``over``,
    (B,), receives a robot with more neighbours; ``counts``, (n,), is working memory.
    """
    n, d, others = rows.shape[1], observations.shape[3], observations.shape[2] - slots
    for block in range(first, last):
        row = rows[block - first]
        for lane in range(min(lanes, len(observations) - block * lanes)):
            b = block * lanes + lane
            seen = observations[b]
            seen[:] = 0.0
            counts[:] = 0
            for pair in range(links.first.shape[1]):
                if links.weights[block, pair, lane] > 0.0:
                    for end in range(2):
                        i, j = links.first[0, pair], links.second[0, pair]
                        robot, own = (j, i) if end else (i, j - 1)
                        slot = counts[robot]
                        counts[robot] = slot + 1
                        if slot >= slots:
                            over[b] = robot
                            continue
                        for k in range(d):
                            seen[robot, slot, k] = row[robot, own, d * lane + k]
            for robot in range(n):
                for other in range(others):
                    for k in range(d):
                        value = row[robot, n - 1 + other, d * lane + k]
                        seen[robot, slots + other, k] = value


@kernel
def sense_oneself(robot, lanes, first, last, robots, merged_into, observations):
    """Last row of models with proprioception; zero for inactive robots."""
    d = len(robot.axes)
    for block in range(first, last):
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            b = block * lanes + lane
            for i in range(robots.shape[1]):
                state = robots[block, i]
                seen = proprioception(
                    constants_of_robot(robot.model, robot.limits, i),
                    load_fields(state, d, lane, lanes, robot.entries),
                    load_fields(state, d + d * d, lane, lanes, robot.memories),
                )
                active, last_row = merged_into[b, i] == i, observations.shape[2] - 1
                for k in range(len(seen)):
                    observations[b, i, last_row, k] = seen[k] if active else 0.0
